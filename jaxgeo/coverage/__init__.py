"""Where a camera will look: footprints, overlap, pointing and the time of the next image."""

from jaxgeo.coverage.exposure import Exposure, Image, own_map
from jaxgeo.coverage.footprint import Footprint, GroundSampling, footprint, ground_sampling
from jaxgeo.coverage.overlap import Overlap, flight_direction, overlap
from jaxgeo.coverage.pointing import Pointing, compensate, line_of_sight, point
from jaxgeo.coverage.timing import FixedPeriod, GroundShared, Plan, VelocityHeight, plan
from jaxgeo.sensor.pointing import LineOfSight

__all__ = [
    "Exposure",
    "FixedPeriod",
    "Footprint",
    "GroundSampling",
    "GroundShared",
    "Image",
    "LineOfSight",
    "Overlap",
    "Plan",
    "Pointing",
    "VelocityHeight",
    "compensate",
    "flight_direction",
    "footprint",
    "ground_sampling",
    "line_of_sight",
    "overlap",
    "own_map",
    "plan",
    "point",
]

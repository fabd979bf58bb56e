"""Where a camera will look: footprints, overlap, pointing and the time of the next image."""

from jaxgeo.coverage.clock import ExposureClock
from jaxgeo.coverage.exposure import Exposure, Image, near_end, own_map
from jaxgeo.coverage.flight import Compensation, FlightNoise, Strip
from jaxgeo.coverage.footprint import Footprint, GroundSampling, footprint, ground_sampling
from jaxgeo.coverage.gaps import Flights, LinearGaps, fly, linear_gaps, overlap_to_plan, trusts_linear
from jaxgeo.coverage.overlap import Overlap, flight_direction, overlap
from jaxgeo.coverage.pointing import Pointing, compensate, line_of_sight, point
from jaxgeo.coverage.polygons import GroundSeen, polygon_overlap, seen_ground
from jaxgeo.coverage.timing import FixedPeriod, GroundShared, Plan, VelocityHeight, plan
from jaxgeo.sensor.aiming import LineOfSight
from jaxgeo.sensor.root_finder import FixedNewton

__all__ = [
    "Compensation",
    "Exposure",
    "ExposureClock",
    "FixedNewton",
    "FixedPeriod",
    "FlightNoise",
    "Flights",
    "Footprint",
    "GroundSampling",
    "GroundSeen",
    "GroundShared",
    "Image",
    "LineOfSight",
    "LinearGaps",
    "Overlap",
    "Plan",
    "Pointing",
    "Strip",
    "VelocityHeight",
    "compensate",
    "flight_direction",
    "fly",
    "footprint",
    "ground_sampling",
    "line_of_sight",
    "linear_gaps",
    "near_end",
    "overlap",
    "overlap_to_plan",
    "own_map",
    "plan",
    "point",
    "polygon_overlap",
    "seen_ground",
    "trusts_linear",
]

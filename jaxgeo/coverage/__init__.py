"""Image coverage planning: footprints, overlap, pointing and exposure timing."""

from jaxgeo._renamed import renamed
from jaxgeo.coverage._checks import SeesNoGround
from jaxgeo.coverage._covered import CoveredPart, covered_part
from jaxgeo.coverage._footprint import Footprint, GroundSampleDistance, footprint, ground_sample_distance
from jaxgeo.coverage._overlap import Overlap, flight_direction, overlap
from jaxgeo.coverage.clock import ExposureClock
from jaxgeo.coverage.exposure import Image, MovingExposure, local_projection, near_edge
from jaxgeo.coverage.flight import Compensation, FlightNoise, Strip
from jaxgeo.coverage.gaps import Flights, LinearGaps, fly, linear_gaps, linear_is_valid, required_overlap
from jaxgeo.coverage.pointing import Pointing, compensate, line_of_sight, point_gimbal
from jaxgeo.coverage.polygons import VisibleGround, polygon_overlap, visible_ground
from jaxgeo.coverage.strips import (
    SideOverlap,
    StripOutline,
    StripSpacing,
    neighbouring_strips,
    side_overlap,
    split_strips,
    strip_outline,
    strip_spacing,
)
from jaxgeo.coverage.timing import FixedPeriod, GroundShared, Plan, VelocityHeight, plan
from jaxgeo.sensor.line_of_sight import LineOfSight
from jaxgeo.sensor.root_finder import FixedNewton

__all__ = [
    "Compensation",
    "CoveredPart",
    "ExposureClock",
    "FixedNewton",
    "FixedPeriod",
    "FlightNoise",
    "Flights",
    "Footprint",
    "GroundSampleDistance",
    "GroundShared",
    "Image",
    "LineOfSight",
    "LinearGaps",
    "MovingExposure",
    "Overlap",
    "Plan",
    "Pointing",
    "SeesNoGround",
    "SideOverlap",
    "Strip",
    "StripOutline",
    "StripSpacing",
    "VelocityHeight",
    "VisibleGround",
    "compensate",
    "covered_part",
    "flight_direction",
    "fly",
    "footprint",
    "ground_sample_distance",
    "line_of_sight",
    "linear_gaps",
    "linear_is_valid",
    "local_projection",
    "near_edge",
    "neighbouring_strips",
    "overlap",
    "plan",
    "point_gimbal",
    "polygon_overlap",
    "required_overlap",
    "side_overlap",
    "split_strips",
    "strip_outline",
    "strip_spacing",
    "visible_ground",
]

DEPRECATED = {
    "Exposure": "MovingExposure",
    "GroundSampling": "GroundSampleDistance",
    "GroundSeen": "VisibleGround",
    "ground_sampling": "ground_sample_distance",
    "near_end": "near_edge",
    "overlap_to_plan": "required_overlap",
    "own_map": "local_projection",
    "point": "point_gimbal",
    "seen_ground": "visible_ground",
    "trusts_linear": "linear_is_valid",
}
__getattr__ = renamed(__name__, DEPRECATED)

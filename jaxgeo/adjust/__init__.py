"""Multi-image adjustment: forward intersection, bundle adjustment, boresight and sensor calibration."""

from jaxgeo._renamed import renamed
from jaxgeo.adjust._calibration import Calibration, calibration
from jaxgeo.adjust._reliability import Blunder, Reliability, blunders, reliability
from jaxgeo.adjust.adjustment import Adjustment, Parameter
from jaxgeo.adjust.block import Block, Images
from jaxgeo.adjust.boresight import TwoStep, two_step_boresight
from jaxgeo.adjust.bundle import BehindCamera, InnerConstraints, NotConverged, adjust
from jaxgeo.adjust.diagnosis import Diagnosis, Misfit, Move
from jaxgeo.adjust.exposures import share_exposures
from jaxgeo.adjust.frame import Cartesian, LocalFrame
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.intersection import Intersection, forward_intersection
from jaxgeo.adjust.losses import AbstractLoss, Cauchy, Huber, LeastSquares, Tukey
from jaxgeo.adjust.motion import motion_by_differences, motion_on_trajectory
from jaxgeo.adjust.navigation import Navigation
from jaxgeo.adjust.pose_rows import PoseRows
from jaxgeo.adjust.rank_defects import DeficientBlock, Direction
from jaxgeo.adjust.records import ImagePoints
from jaxgeo.adjust.resection import resect_block, resect_image
from jaxgeo.adjust.screening import ControlElsewhere, Screen, Screened, screen
from jaxgeo.adjust.snooping import without_blunders
from jaxgeo.adjust.solve import Iteration, Solver
from jaxgeo.adjust.terrain_heights import HeightObservations
from jaxgeo.adjust.unknowns import Fixed, Free, Prior, Unknowns

__all__ = [
    "AbstractLoss",
    "Adjustment",
    "BehindCamera",
    "Block",
    "Blunder",
    "Calibration",
    "Cartesian",
    "Cauchy",
    "ControlElsewhere",
    "DeficientBlock",
    "Diagnosis",
    "Direction",
    "Fixed",
    "Free",
    "GroundPoints",
    "HeightObservations",
    "Huber",
    "ImagePoints",
    "Images",
    "InnerConstraints",
    "Intersection",
    "Iteration",
    "LeastSquares",
    "LocalFrame",
    "Misfit",
    "Move",
    "Navigation",
    "NotConverged",
    "Parameter",
    "PoseRows",
    "Prior",
    "Reliability",
    "Screen",
    "Screened",
    "Solver",
    "Tukey",
    "TwoStep",
    "Unknowns",
    "adjust",
    "blunders",
    "calibration",
    "forward_intersection",
    "motion_by_differences",
    "motion_on_trajectory",
    "reliability",
    "resect_block",
    "resect_image",
    "screen",
    "share_exposures",
    "two_step_boresight",
    "without_blunders",
]

DEPRECATED = {
    "OnTerrain": "HeightObservations",
    "intersect_images": "forward_intersection",
    "resect": "resect_block",
    "resected": "resect_image",
}
__getattr__ = renamed(__name__, DEPRECATED)

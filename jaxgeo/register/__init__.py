"""Image registration to a reference map: rectification, block matching, orientation update, covariance."""

from jaxgeo._renamed import renamed
from jaxgeo.register.affine import AffineCheck
from jaxgeo.register.blocks import BlockOutcome, Matches, blocks_of, count_outcomes
from jaxgeo.register.chance import false_alarms, second_best
from jaxgeo.register.choice import AbstractChoice, Chosen
from jaxgeo.register.clusters import Clusters
from jaxgeo.register.consensus import PoseConsensus
from jaxgeo.register.flattening import remove_illumination
from jaxgeo.register.interpolation import AbstractInterpolation, Bilinear, Cubic, Nearest
from jaxgeo.register.matching import match_blocks
from jaxgeo.register.orientation_update import update_orientation
from jaxgeo.register.orthoimage import Orthoimage
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.passes import Pass
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior
from jaxgeo.register.rectify import Rectified, Rectifier, rectify
from jaxgeo.register.registration import Limits, Registration, register_image
from jaxgeo.register.render import Rendered, render
from jaxgeo.register.sequence import propagate_prior
from jaxgeo.register.tie_errors import FullJacobian, LevelGround, TieErrors
from jaxgeo.register.ties import TiePoints

__all__ = [
    "AbstractChoice",
    "AbstractInterpolation",
    "AffineCheck",
    "Bilinear",
    "BlockOutcome",
    "Chosen",
    "Clusters",
    "Cubic",
    "FullJacobian",
    "LevelGround",
    "Limits",
    "Matches",
    "Nearest",
    "Orthoimage",
    "Outcome",
    "Pass",
    "PoseConsensus",
    "Prior",
    "Rectified",
    "Rectifier",
    "Registration",
    "Rendered",
    "TieErrors",
    "TiePoints",
    "Update",
    "blocks_of",
    "count_outcomes",
    "false_alarms",
    "match_blocks",
    "propagate_prior",
    "rectify",
    "register_image",
    "remove_illumination",
    "render",
    "second_best",
    "update_orientation",
]

DEPRECATED = {
    "flattened": "remove_illumination",
    "match": "match_blocks",
    "next_prior": "propagate_prior",
    "register": "register_image",
    "runner_up": "second_best",
    "update": "update_orientation",
}
__getattr__ = renamed(__name__, DEPRECATED)

"""Image registration to a reference map: block matching, orientation update, covariance."""

from jaxgeo._renamed import renamed
from jaxgeo.register.affine import AffineCheck
from jaxgeo.register.blocks import BlockOutcome, Matches, blocks_of, count_outcomes
from jaxgeo.register.chance import false_alarms, second_best
from jaxgeo.register.choice import AbstractChoice, Chosen
from jaxgeo.register.clusters import Clusters
from jaxgeo.register.consensus import PoseConsensus
from jaxgeo.register.flattening import remove_illumination
from jaxgeo.register.gradient_orientation import orientation_channels
from jaxgeo.register.matching import match_blocks
from jaxgeo.register.orientation_update import update_orientation
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.passes import Pass
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior
from jaxgeo.register.registration import Limits, Registration, register_image
from jaxgeo.register.sequence import propagate_prior
from jaxgeo.register.tie_errors import FullJacobian, LevelGround, TieErrors
from jaxgeo.register.ties import TiePoints

__all__ = [
    "AbstractChoice",
    "AffineCheck",
    "BlockOutcome",
    "Chosen",
    "Clusters",
    "FullJacobian",
    "LevelGround",
    "Limits",
    "Matches",
    "Outcome",
    "Pass",
    "PoseConsensus",
    "Prior",
    "Registration",
    "TieErrors",
    "TiePoints",
    "Update",
    "blocks_of",
    "count_outcomes",
    "false_alarms",
    "match_blocks",
    "orientation_channels",
    "propagate_prior",
    "register_image",
    "remove_illumination",
    "second_best",
    "update_orientation",
]

DEPRECATED = {
    "AbstractInterpolation": "jaxgeo.ortho.AbstractInterpolation",
    "Bilinear": "jaxgeo.ortho.Bilinear",
    "Cubic": "jaxgeo.ortho.Cubic",
    "Nearest": "jaxgeo.ortho.Nearest",
    "Orthoimage": "jaxgeo.ortho.Orthoimage",
    "Rectified": "jaxgeo.ortho.Rectified",
    "Rectifier": "jaxgeo.ortho.Rectifier",
    "Rendered": "jaxgeo.ortho.Rendered",
    "flattened": "remove_illumination",
    "match": "match_blocks",
    "next_prior": "propagate_prior",
    "rectify": "jaxgeo.ortho.rectify",
    "register": "register_image",
    "render": "jaxgeo.ortho.render",
    "runner_up": "second_best",
    "update": "update_orientation",
}
__getattr__ = renamed(__name__, DEPRECATED)

"""Tie points between images, and the mutual correction of their orientations without a map."""

from jaxgeo.ties.block import MatchedPair, Ties, find_ties
from jaxgeo.ties.control import Control, check_control
from jaxgeo.ties.control_residuals import ControlResiduals
from jaxgeo.ties.correction import Correction, correct
from jaxgeo.ties.feature_matching import match_keypoints
from jaxgeo.ties.features import AbstractFeatures, ImageKeypoints, Keypoints
from jaxgeo.ties.kept import KeptMatches
from jaxgeo.ties.map_control import MapControl
from jaxgeo.ties.matching import Matching, PairMatches, TieOutcome, match_pair
from jaxgeo.ties.opencv_features import OrbFeatures, SiftFeatures
from jaxgeo.ties.pairs import Pair, candidate_pairs
from jaxgeo.ties.pictures import Pictures
from jaxgeo.ties.recursive import FrameEstimate, RecursiveCorrection
from jaxgeo.ties.relative import RelativeOrientation
from jaxgeo.ties.tracks import connected
from jaxgeo.ties.views import Views

__all__ = [
    "AbstractFeatures",
    "Control",
    "ControlResiduals",
    "Correction",
    "FrameEstimate",
    "ImageKeypoints",
    "KeptMatches",
    "Keypoints",
    "MapControl",
    "MatchedPair",
    "Matching",
    "OrbFeatures",
    "Pair",
    "PairMatches",
    "Pictures",
    "RecursiveCorrection",
    "RelativeOrientation",
    "SiftFeatures",
    "TieOutcome",
    "Ties",
    "Views",
    "candidate_pairs",
    "check_control",
    "connected",
    "correct",
    "find_ties",
    "match_keypoints",
    "match_pair",
]

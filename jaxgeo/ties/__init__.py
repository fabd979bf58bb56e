"""Tie points between images, and the mutual correction of their orientations without a map."""

from jaxgeo.ties.block import MatchedPair, Ties, find_ties
from jaxgeo.ties.control import Control, check_control
from jaxgeo.ties.control_residuals import ControlResiduals
from jaxgeo.ties.correction import Correction, correct
from jaxgeo.ties.kept import KeptMatches
from jaxgeo.ties.map_control import MapControl
from jaxgeo.ties.matching import Matching, PairMatches, TieOutcome, match_pair
from jaxgeo.ties.pairs import Pair, candidate_pairs
from jaxgeo.ties.pictures import Pictures
from jaxgeo.ties.recursive import FrameEstimate, RecursiveCorrection
from jaxgeo.ties.tracks import connected
from jaxgeo.ties.views import Views

__all__ = [
    "Control",
    "ControlResiduals",
    "Correction",
    "FrameEstimate",
    "KeptMatches",
    "MapControl",
    "MatchedPair",
    "Matching",
    "Pair",
    "PairMatches",
    "Pictures",
    "RecursiveCorrection",
    "TieOutcome",
    "Ties",
    "Views",
    "candidate_pairs",
    "check_control",
    "connected",
    "correct",
    "find_ties",
    "match_pair",
]

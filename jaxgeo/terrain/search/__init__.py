"""Ray-terrain intersection searches with a common interface."""

from jaxgeo.terrain.search.base import AbstractSearch
from jaxgeo.terrain.search.bisection import Bisection
from jaxgeo.terrain.search.exhaustive import ExhaustiveFirst, ExhaustiveNearest
from jaxgeo.terrain.search.fast_iteration import FastIteration
from jaxgeo.terrain.search.first_hit import FirstHit
from jaxgeo.terrain.search.improved import ImprovedLiteral, ImprovedSecant
from jaxgeo.terrain.search.photogrammetric import Photogrammetric
from jaxgeo.terrain.search.run import Ending, Outcome, Run, outcome_of
from jaxgeo.terrain.search.segmented import Segmented
from jaxgeo.terrain.search.studied import AbstractStudiedSearch
from jaxgeo.terrain.search.window import AbstractWindow, HeightsBetween, TargetArea, WholeTerrain

__all__ = [
    "AbstractSearch",
    "AbstractStudiedSearch",
    "AbstractWindow",
    "Bisection",
    "Ending",
    "ExhaustiveFirst",
    "ExhaustiveNearest",
    "FastIteration",
    "FirstHit",
    "HeightsBetween",
    "ImprovedLiteral",
    "ImprovedSecant",
    "Outcome",
    "Photogrammetric",
    "Run",
    "Segmented",
    "TargetArea",
    "WholeTerrain",
    "outcome_of",
]

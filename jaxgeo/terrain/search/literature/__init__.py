"""Searches of the literature, for study and comparison: over heights, counted, with their faults."""

from jaxgeo.terrain.search.literature.bisection import Bisection
from jaxgeo.terrain.search.literature.exhaustive import ExhaustiveFirst, ExhaustiveNearest
from jaxgeo.terrain.search.literature.fast_iteration import FastIteration
from jaxgeo.terrain.search.literature.improved import ImprovedLiteral, ImprovedSecant
from jaxgeo.terrain.search.literature.photogrammetric import Photogrammetric
from jaxgeo.terrain.search.literature.run import Ending, Outcome, Run, outcome_of
from jaxgeo.terrain.search.literature.segmented import Segmented
from jaxgeo.terrain.search.literature.studied import AbstractStudiedSearch
from jaxgeo.terrain.search.literature.window import AbstractWindow, HeightsBetween, TargetArea, WholeTerrain

__all__ = [
    "AbstractStudiedSearch",
    "AbstractWindow",
    "Bisection",
    "Ending",
    "ExhaustiveFirst",
    "ExhaustiveNearest",
    "FastIteration",
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

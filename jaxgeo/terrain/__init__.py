"""Terrain models: elevation models, their grids, and searches for ray intersections."""

from jaxgeo.terrain.constant import ConstantHeight
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.field import AbstractField, ConstantField, LineField, SumField
from jaxgeo.terrain.grid import AbstractGrid, FittedGrid, GeographicGrid, TangentGrid, TransverseMercatorGrid
from jaxgeo.terrain.height_function import HeightFunction
from jaxgeo.terrain.interface import AbstractTerrain, Bracket
from jaxgeo.terrain.search import (
    AbstractSearch,
    AbstractStudiedSearch,
    AbstractWindow,
    Bisection,
    Ending,
    ExhaustiveFirst,
    ExhaustiveNearest,
    FastIteration,
    FirstHit,
    HeightsBetween,
    ImprovedLiteral,
    ImprovedSecant,
    Outcome,
    Photogrammetric,
    Run,
    Segmented,
    TargetArea,
    WholeTerrain,
    outcome_of,
)

__all__ = [
    "AbstractField",
    "AbstractGrid",
    "AbstractSearch",
    "AbstractStudiedSearch",
    "AbstractTerrain",
    "AbstractWindow",
    "Bisection",
    "Bracket",
    "ConstantField",
    "ConstantHeight",
    "Dem",
    "Ending",
    "ExhaustiveFirst",
    "ExhaustiveNearest",
    "FastIteration",
    "FirstHit",
    "FittedGrid",
    "GeographicGrid",
    "HeightFunction",
    "HeightsBetween",
    "ImprovedLiteral",
    "ImprovedSecant",
    "LineField",
    "Outcome",
    "Photogrammetric",
    "Run",
    "Segmented",
    "SumField",
    "TangentGrid",
    "TargetArea",
    "TransverseMercatorGrid",
    "WholeTerrain",
    "outcome_of",
]

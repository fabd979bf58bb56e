"""Terrain models: elevation models, their grids, and searches for ray intersections."""

import importlib
from typing import TYPE_CHECKING, Any

from jaxgeo.terrain.constant import ConstantHeight
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.field import AbstractField, ConstantField, LineField, SumField
from jaxgeo.terrain.grid import AbstractGrid, FittedGrid, GeographicGrid, TangentGrid, TransverseMercatorGrid
from jaxgeo.terrain.height_function import HeightFunction
from jaxgeo.terrain.interface import AbstractTerrain, Bracket
from jaxgeo.terrain.search import AbstractSearch, FirstHit

if TYPE_CHECKING:
    from jaxgeo.terrain.search.literature import (
        AbstractStudiedSearch,
        AbstractWindow,
        Bisection,
        Ending,
        ExhaustiveFirst,
        ExhaustiveNearest,
        FastIteration,
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


def __getattr__(name: str) -> Any:
    """The searches of the literature, loaded when first used."""
    if name in __all__:
        return getattr(importlib.import_module("jaxgeo.terrain.search.literature"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""Ray-terrain intersection searches with a common interface.

`FirstHit` is the default of jaxgeo; the searches of the literature are for study and comparison.
"""

from jaxgeo.terrain.interface import AbstractSearch
from jaxgeo.terrain.search.first_hit import FirstHit
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

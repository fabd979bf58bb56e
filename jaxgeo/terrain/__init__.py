"""Terrain: elevation models, their grids, and the searches that find where a ray meets them."""

from jaxgeo.terrain.constant import ConstantHeight
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.grid import AbstractGrid, FittedGrid, GeographicGrid, TangentGrid, TransverseMercatorGrid
from jaxgeo.terrain.interface import AbstractTerrain, Bracket
from jaxgeo.terrain.search import AbstractSearch, Bisection, FirstHit

__all__ = [
    "AbstractGrid",
    "AbstractSearch",
    "AbstractTerrain",
    "Bisection",
    "Bracket",
    "ConstantHeight",
    "Dem",
    "FirstHit",
    "FittedGrid",
    "GeographicGrid",
    "TangentGrid",
    "TransverseMercatorGrid",
]

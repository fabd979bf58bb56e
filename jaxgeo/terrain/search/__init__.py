"""Searches for the crossing of a ray and a terrain, all behind one interface."""

from jaxgeo.terrain.search.base import AbstractSearch
from jaxgeo.terrain.search.bisection import Bisection
from jaxgeo.terrain.search.first_hit import FirstHit

__all__ = ["AbstractSearch", "Bisection", "FirstHit"]

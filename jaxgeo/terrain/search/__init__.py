"""Ray-terrain intersection searches with a common interface.

`FirstHit` is the default of jaxgeo; the searches of the literature (`literature`) are for study and comparison.
"""

from jaxgeo.terrain.interface import AbstractSearch
from jaxgeo.terrain.search.first_hit import FirstHit

__all__ = ["AbstractSearch", "FirstHit"]

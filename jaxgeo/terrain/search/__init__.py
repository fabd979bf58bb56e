"""Ray-terrain intersection searches with a common interface.

`FirstHit` is the default of jaxgeo; the searches of the literature are for study and comparison.
"""

from jaxgeo.terrain.interface import AbstractSearch
from jaxgeo.terrain.search import literature
from jaxgeo.terrain.search.first_hit import FirstHit
from jaxgeo.terrain.search.literature import *  # noqa: F403

__all__ = ["AbstractSearch", "FirstHit"]
__all__ += literature.__all__

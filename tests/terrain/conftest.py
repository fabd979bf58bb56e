"""The rough mountains that the searches are tried on."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import Sight, TangentTerrain, Walked, fractal_posts, grazing_sights, random_sights, walk_every_cell

from jaxgeo import Dem, Geodetic, Ray
from jaxgeo.terrain import TangentGrid

SPACING = 30.0
SIGHT = ("origin", "direction", "start", "target")


@dataclass(frozen=True)
class Mountains:
    """One terrain, twice: as jaxgeo's, and in NumPy; and rays over it."""

    numpy: TangentTerrain
    dem: Dem
    rays: Ray
    sight: Sight

    def walked(self, count: int) -> list[Walked]:
        """What the exhaustive walk says of the first rays, at some 12 ms each."""
        each = zip(*(getattr(self.sight, name)[:count] for name in SIGHT), strict=True)
        return [
            walk_every_cell(self.numpy, origin, direction, start, target + 3000.0)
            for origin, direction, start, target in each
        ]


@pytest.fixture(scope="session")
def mountains() -> Mountains:
    posts = fractal_posts(2001, spacing=SPACING, relief=3000.0, exponent=3.39, seed=1)
    terrain = TangentTerrain(posts, np.deg2rad(40.0), np.deg2rad(10.0), SPACING)
    centre = Geodetic.from_degrees(lat=40.0, lon=10.0, height=0.0)
    dem = Dem.from_array(posts, TangentGrid.centred(centre, spacing=(SPACING, SPACING), shape=posts.shape))
    parts = [random_sights(terrain, 1700, seed=2), grazing_sights(terrain, 400, seed=3)]
    sight = Sight(*(np.concatenate([getattr(part, name) for part in parts]) for name in SIGHT))
    return Mountains(terrain, dem, Ray(jnp.asarray(sight.origin), jnp.asarray(sight.direction)), sight)

"""The rough mountains that the searches are tried on, and the exhaustive walk's answers."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import Sight, TangentTerrain, Walked, fractal_posts, grazing_sights, random_sights, walk_every_cell

from jaxgeo import Dem, Geodetic, Ray
from jaxgeo.terrain import TangentGrid

SPACING = 30.0


@dataclass(frozen=True)
class Mountains:
    """One terrain, twice: as jaxgeo's, and in NumPy; rays over it, and what the exhaustive walk says of them."""

    numpy: TangentTerrain
    dem: Dem
    rays: Ray
    walked: list[Walked]


@pytest.fixture(scope="session")
def mountains() -> Mountains:
    posts = fractal_posts(2001, spacing=SPACING, relief=3000.0, exponent=3.39, seed=1)
    terrain = TangentTerrain(posts, np.deg2rad(40.0), np.deg2rad(10.0), SPACING)
    centre = Geodetic.from_degrees(lat=40.0, lon=10.0, height=0.0)
    dem = Dem.from_array(posts, TangentGrid.centred(centre, spacing=(SPACING, SPACING), shape=posts.shape))
    parts = [random_sights(terrain, 1700, seed=2), grazing_sights(terrain, 400, seed=3)]
    origin, direction, start, target = (
        np.concatenate([getattr(part, name) for part in parts]) for name in Sight.__dataclass_fields__
    )
    walked = [
        walk_every_cell(terrain, origin[k], direction[k], start[k], target[k] + 3000.0) for k in range(start.size)
    ]
    return Mountains(terrain, dem, Ray(jnp.asarray(origin), jnp.asarray(direction)), walked)

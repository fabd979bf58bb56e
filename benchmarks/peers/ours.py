"""jaxgeo: complete fixes (polished, with status and geodetic position) from ECEF rays."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from support.fractal import Sight, TangentTerrain

import jaxgeo
from jaxgeo.terrain import TangentGrid
from peers import Facts, Peer


def dem_of(terrain: TangentTerrain, dtype: Any = np.float64) -> jaxgeo.Dem:
    """The terrain as a jaxgeo `Dem`, its posts stored in `dtype`."""
    jaxgeo.enable_x64()
    centre = jaxgeo.Geodetic(lat=terrain.lat, lon=terrain.lon, height=0.0)
    spacing = (terrain.spacing, terrain.spacing)
    grid = TangentGrid.centred(centre, spacing=spacing, shape=terrain.posts.shape)
    return jaxgeo.Dem.from_array(terrain.posts.astype(dtype, copy=False), grid)


def rays_of(sight: Sight) -> jaxgeo.Ray:
    """The rays as a batch."""
    jaxgeo.enable_x64()
    return jaxgeo.Ray(jnp.asarray(sight.origin), jnp.asarray(sight.direction))


# One function for all, so that nothing is compiled twice.
answers = jax.jit(jax.vmap(jaxgeo.intersect, in_axes=(0, None)))


class Jaxgeo(Peer):
    """`jax.jit(jax.vmap(jaxgeo.intersect, in_axes=(0, None)))`."""

    facts = Facts(
        package="jaxgeo",
        input="ECEF rays",
        frame="ECEF, WGS 84 ellipsoid; exact map to (row, col, height)",
        precision="float64",
        surface="bilinear",
        threads="as XLA likes",
        notes="every answer polished, with status, position and angles",
    )

    def prepare(self, terrain: TangentTerrain) -> None:
        self.dem = jax.block_until_ready(dem_of(terrain))

    def load(self, sight: Sight) -> None:
        self.rays = jax.block_until_ready(rays_of(sight))

    def run(self) -> jaxgeo.Fix:
        return jax.block_until_ready(answers(self.rays, self.dem))

    def ranges(self, answer: Any) -> np.ndarray:
        return np.asarray(answer.slant_range)

"""Height windows of a search: the whole terrain, or the target's area."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import Descent


class AbstractWindow(Record):
    """Choice of the lowest and the highest height considered by a search."""

    @abstractmethod
    def heights(self, descent: Descent) -> tuple[Scalar, Scalar]:
        """Lowest and highest height in m. Reading posts for it does not count as evaluations of h(Z)."""


class WholeTerrain(AbstractWindow):
    """All heights of the DEM as loaded."""

    def heights(self, descent: Descent) -> tuple[Scalar, Scalar]:
        return descent.dem.floor, descent.dem.ceiling


class HeightsBetween(AbstractWindow):
    """Heights in m given by the caller."""

    lowest: ScalarField
    highest: ScalarField

    def heights(self, descent: Descent) -> tuple[Scalar, Scalar]:
        return jnp.asarray(self.lowest, jnp.float64), jnp.asarray(self.highest, jnp.float64)


class TargetArea(AbstractWindow):
    """Heights of the posts around the ray's intersection with a constant-height ellipsoid model.

    Step 1 of Li et al. (2023), section 4.2: estimate the target's place with the ellipsoid model, take the heights of
    that area. The paper gives neither: `height` in m is that of the ellipsoid model (the paper uses a mean height; the
    middle between lowest and highest if None), and the area is `half` posts to each side of the place, moved inward at
    an edge of the terrain. 100 posts of 30 m compensate 600 m of error in that height at a depression of 11.2 degrees.
    Peaks outside the area are not considered.
    """

    height: ScalarField | None = None
    half: int = eqx.field(static=True, default=100)

    def heights(self, descent: Descent) -> tuple[Scalar, Scalar]:
        dem = descent.dem
        lowest, highest = dem.known_heights
        height = 0.5 * (lowest + highest) if self.height is None else jnp.asarray(self.height)
        rowcol, _ = dem.over(descent.ray.at(descent.range_at(height)))
        extent = jnp.asarray(dem.extent)
        stored = jnp.shape(dem.posts)
        rows, cols = min(2 * self.half + 1, stored[0]), min(2 * self.half + 1, stored[1])
        middle = jnp.clip(jnp.round(rowcol), 0, extent - 1).astype(jnp.int32)
        first = jnp.clip(middle - self.half, 0, jnp.maximum(extent - jnp.array([rows, cols]), 0))

        def strip(offset: Index, heights: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            corner = (first[0] + offset, first[1])
            posts = jax.lax.dynamic_slice(jnp.asarray(dem.posts), corner, (1, cols)).astype(jnp.float64)
            if dem.field is not None:
                along = (first[1] + jnp.arange(cols)).astype(jnp.float64)
                posts = posts + jax.vmap(dem.field.at, (None, 0))(corner[0].astype(jnp.float64), along)[None, :]
            void = jax.lax.dynamic_slice(jnp.asarray(dem.void), corner, (1, cols))
            exists = (first[1] + jnp.arange(cols) < extent[1])[None, :] & (first[0] + offset < extent[0])
            lowest = jnp.min(jnp.where(exists & ~void, posts, jnp.inf))
            highest = jnp.max(jnp.where(exists, jnp.where(void, dem.void_top, posts), -jnp.inf))
            return jnp.minimum(heights[0], lowest), jnp.maximum(heights[1], highest)

        none = jnp.asarray(jnp.inf), jnp.asarray(-jnp.inf)
        lowest, highest = jax.lax.fori_loop(0, rows, strip, none)
        return jnp.minimum(lowest, highest), highest

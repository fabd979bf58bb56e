"""Interfaces of terrains and of searches for ray intersections."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Scalar, ScalarField, StatusField, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.field import AbstractField


class Bracket(Record):
    """Range interval of a ray's crossing of the surface, found without gradients.

    The crossing is between the ranges `lower` and `upper` in m, at `near` as far as the search can determine; `cell` is
    the (row, col) of the cell's first post, `status` an int8 `Status`. Without a crossing the ranges are zero and the
    cell is (0, 0).
    """

    lower: ScalarField
    upper: ScalarField
    near: ScalarField
    cell: Int[Array, "... 2"]
    status: StatusField


class AbstractSearch(Record):
    """Base class of searches for a ray's crossing of a DEM surface; inputs and bracket carry no derivatives."""

    @abstractmethod
    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        """The crossing of `ray` (ECEF) and `dem` that this search finds, with its cell and status."""


class AbstractTerrain(Record):
    """Base class of terrains.

    A subclass implements the five abstract methods. The others are derived from them; override them where the terrain
    has a faster way to its heights. `accuracy` and related functions sample the ground through `ground_above`.
    """

    @abstractmethod
    def bracket(self, ray: Ray, search: AbstractSearch) -> Bracket:
        """The crossing found by `search`, without derivatives."""

    @abstractmethod
    def clearance(self, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
        """Height in m of an ECEF point above the surface of one fixed cell, smooth in every input."""

    @abstractmethod
    def with_field(self, field: AbstractField) -> AbstractTerrain:
        """The terrain with a field of heights added, on top of any earlier field."""

    @abstractmethod
    def made_safe(self) -> tuple[AbstractTerrain, Flag]:
        """The terrain with finite numbers throughout, so that no NaN enters a gradient, and whether it was finite."""

    @abstractmethod
    def safe_ray(self) -> Ray:
        """A ray with finite clearance of slope -1, a placeholder for rays without a hit."""

    def height_at(self, position: Geodetic) -> Scalar:
        """Height of the ground in m at a latitude and longitude (the height of `position` is ignored).

        The highest surface there: the first hit of a plumb line from above; NaN without a hit.
        """
        from jaxgeo.terrain.plumb import height_by_plumb_line  # circular: the searches import this module

        return height_by_plumb_line(self, position)

    def ground_above(self, p_ecef: Vector3) -> tuple[Scalar, Flag]:
        """(height in m of an ECEF point above the ground, negative below it; whether the ground is known there)."""
        position = WGS84.to_geodetic(p_ecef)
        height = self.height_at(position)
        is_known = jnp.isfinite(height)
        return jnp.where(is_known, height - position.height, 0.0), is_known

    def spacing(self) -> Scalar | None:
        """Length in m below which the ground is smooth, such as the post spacing of a grid; None if unknown."""
        return None

    def spacing_at(self, p_ecef: Vector3) -> Scalar | None:
        """`spacing` at a point (ECEF, m), which does not depend on how far the terrain extends."""
        del p_ecef
        return self.spacing()

    @property
    def void_top(self) -> Scalar | None:
        """Ellipsoidal height in m below which lines of sight do not pass unknown ground; None if they do."""
        return None

    def known_along(self, path: Float[Array, "3 3"], share: Float[Array, " places"]) -> Bool[Array, " places"]:
        """Whether the ground is known below a nearly straight path, at growing shares of its length.

        `path` is its start, middle and end (ECEF, m). Terrain of cells also looks up to the next share, if that is no
        farther than a cell.
        """
        return jax.vmap(lambda place: self.ground_above(place)[1])(along_path(path, share))


def along_path(path: Float[Array, "3 n"], share: Float[Array, " places"]) -> Float[Array, "places n"]:
    """Places of a parabola through start, middle and end of a path, at shares of its length."""
    start, middle, end = (1.0 - share) * (1.0 - 2.0 * share), 4.0 * share * (1.0 - share), share * (2.0 * share - 1.0)
    return jnp.stack([start, middle, end], axis=1) @ path

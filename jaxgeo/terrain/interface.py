"""What a terrain is to a ray."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Scalar, ScalarField, StatusField, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.field import AbstractField
    from jaxgeo.terrain.search.base import AbstractSearch


class Bracket(Record):
    """Where along a ray the surface is crossed, found without gradients.

    It lies between the ranges `lower` and `upper` in m, as far as the search can tell at `near`; `cell` is the
    (row, col) of the cell's first post, `status` an int8 `Status`. Where there is no crossing the ranges are zero and
    the cell is (0, 0).
    """

    lower: ScalarField
    upper: ScalarField
    near: ScalarField
    cell: Int[Array, "... 2"]
    status: StatusField


class AbstractTerrain(Record):
    """A surface that rays can meet.

    A subclass gives the five abstract methods. The others follow from them, and are overridden where the terrain knows
    its heights in a quicker way: `accuracy` and its like probe the ground through `ground_above`.
    """

    @abstractmethod
    def bracket(self, ray: Ray, search: AbstractSearch) -> Bracket:
        """The crossing that `search` finds; it carries no derivatives."""

    @abstractmethod
    def clearance(self, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
        """Height in m of an ECEF point above the surface of one frozen cell, smooth in every input."""

    @abstractmethod
    def with_field(self, field: AbstractField) -> AbstractTerrain:
        """The terrain with a field of heights added, on top of any that it has already."""

    @abstractmethod
    def made_safe(self) -> tuple[AbstractTerrain, Flag]:
        """The terrain with finite numbers throughout, so that no NaN enters a gradient, and whether it had them."""

    @abstractmethod
    def safe_ray(self) -> Ray:
        """A ray whose clearance is finite with a slope of -1, to stand in for rays that have no answer."""

    def height_at(self, position: Geodetic) -> Scalar:
        """Height of the ground in m at a latitude and longitude (the height of `position` is ignored).

        That of the highest surface there, where a plumb line of sight from above meets it; NaN where it meets none.
        """
        from jaxgeo.terrain.plumb import height_by_plumb_line  # which knows the searches, and they this module

        return height_by_plumb_line(self, position)

    def ground_above(self, p_ecef: Vector3) -> tuple[Scalar, Flag]:
        """(height in m of the ground over an ECEF point, negative if it lies below; whether it is known there)."""
        position = WGS84.to_geodetic(p_ecef)
        height = self.height_at(position)
        is_known = jnp.isfinite(height)
        return jnp.where(is_known, height - position.height, 0.0), is_known

    def spacing(self) -> Scalar | None:
        """Length in m below which the ground is smooth, as between the posts of a grid; None if there is none known."""
        return None

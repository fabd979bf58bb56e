"""Height fields added to an elevation model: sampled or assumed DEM errors."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Num

from jaxgeo._checks import as_float64, check_is
from jaxgeo._numerics import dot, within
from jaxgeo._record import Record
from jaxgeo._typing import Index, PixelField, Scalar, ScalarField

if TYPE_CHECKING:
    NodesField: TypeAlias = Any
else:
    NodesField: TypeAlias = Num[ArrayLike, "... nodes"]

Bounds: TypeAlias = tuple[Scalar, Scalar]


class AbstractField(Record):
    """Heights in m added to the posts of a terrain (`Dem.with_field`), with bounds."""

    @abstractmethod
    def at(self, row: Scalar, col: Scalar) -> Scalar:
        """Height in m added to the post at (row, col), both integers: the surface stays bilinear."""

    @abstractmethod
    def bounds(self) -> Bounds:
        """Lowest and highest height in m of the field; tight bounds make searches fast."""

    def frozen_bounds(self) -> Bounds:
        """The bounds without derivatives, like those of posts."""
        return jax.lax.stop_gradient(self.bounds())

    def at_corners(self, row: Index, col: Index) -> list[Scalar]:
        """Heights at the four posts of a cell, given by its first post, in the order of `Patch`."""
        rows, cols = ((first.astype(jnp.float64), (first + 1).astype(jnp.float64)) for first in (row, col))
        return [self.at(row, col) for row in rows for col in cols]


class ConstantField(AbstractField):
    """The same `height` in m everywhere: a bias."""

    height: ScalarField

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        return jnp.asarray(self.height)

    def bounds(self) -> Bounds:
        return jnp.asarray(self.height), jnp.asarray(self.height)


class LineField(AbstractField):
    """Heights in m that vary along one grid direction: `values` (nodes,) at equal steps, linear between them.

    The first node is at `first` (row, col), each next one `step` (rows, cols) farther. A post has the height of its
    projection onto that axis; heights are constant beyond the ends. Laid along the approach of a line of sight, the
    field represents a random field with the nodes' correlation for that line, at little more than the cost of a bias.
    """

    values: NodesField
    first: PixelField
    step: PixelField

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        values = jnp.asarray(self.values)
        count = values.shape[0]
        if count == 0:
            raise ValueError("values of a LineField must hold at least one node; got none.")
        squared = dot(self.step, self.step)
        squared = jnp.where(squared > 0.0, squared, 1.0)
        along = dot((row - self.first[0], col - self.first[1]), self.step) / squared
        along = within(along, 0.0, count - 1.0)
        node = jnp.clip(along.astype(jnp.int32), 0, max(count - 2, 0))
        near = values.at[node].get(mode="promise_in_bounds")
        far = values.at[jnp.minimum(node + 1, count - 1)].get(mode="promise_in_bounds")
        return near + (far - near) * (along - node)

    def bounds(self) -> Bounds:
        return jnp.min(jnp.asarray(self.values)), jnp.max(jnp.asarray(self.values))


class SumField(AbstractField):
    """Sum of two fields."""

    a: AbstractField
    b: AbstractField

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        return self.a.at(row, col) + self.b.at(row, col)

    def bounds(self) -> Bounds:
        (low, high), (lower, higher) = self.a.bounds(), self.b.bounds()
        return low + lower, high + higher


class BoundedField(AbstractField):
    """A field with precomputed bounds in m, so that a search does not recompute them at every step."""

    field: AbstractField
    lowest: ScalarField
    highest: ScalarField

    @classmethod
    def of(cls, field: AbstractField) -> BoundedField:
        return cls(field, *field.bounds())

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        return self.field.at(row, col)

    def bounds(self) -> Bounds:
        return jnp.asarray(self.lowest), jnp.asarray(self.highest)


def checked_field(field: Any) -> AbstractField:
    """A field in float64.

    Raises `TypeError` for anything else and for float32, `ValueError` unless it gives one height per post.
    """
    check_is(field, AbstractField, "field", "Make one with ConstantField(height) or LineField(values, first, step).")
    field = as_float64(field, "field")
    shape = jax.eval_shape(lambda field: field.at(jnp.zeros(()), jnp.zeros(())), field).shape
    if shape != ():
        raise ValueError(
            f"field must give one height in m at a post; got heights of shape {shape}. For a field of its own for "
            "every ray call with_field inside the function that jax.vmap maps, with the fields among its arguments."
        )
    return field

"""Base class of lens distortions: a map of the image plane, its inverse, its field and its coefficients."""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64
from jaxgeo._record import Record
from jaxgeo._typing import Flag, StatusCode
from jaxgeo.sensor._newton import PlanePoint
from jaxgeo.status import Status, status_where

if TYPE_CHECKING:
    from typing import Self
else:
    Self: TypeAlias = Any  # run-time type checks cannot resolve it through a decorated method


class AbstractDistortion(Record):
    """A smooth map of the image plane, invertible around the centre.

    Its field is the region around the centre without a fold: where the determinant of its Jacobian is positive all the
    way from the centre.
    """

    names: ClassVar[tuple[str, ...]]  # of the coefficients, in order
    interior: ClassVar[tuple[str, ...]] = ()  # those equivalent to focal length and principal point

    @abc.abstractmethod
    def distort(self, ideal: PlanePoint) -> PlanePoint:
        """Distorted image coordinates of ideal ones, by the formula alone, inside the field or not."""

    @abc.abstractmethod
    def in_field(self, ideal: PlanePoint) -> Flag:
        """Whether ideal image coordinates are in the field; not differentiable."""

    def nearest_image(self, ideal: PlanePoint) -> PlanePoint:
        """Approximate edge of the field, in distorted coordinates, towards ideal coordinates beyond it; not
        differentiable. By default the ideal coordinates, which is right for small distortion."""
        return jax.lax.stop_gradient(ideal)

    @abc.abstractmethod
    def undistort(self, distorted: PlanePoint) -> tuple[PlanePoint, StatusCode]:
        """Ideal coordinates in the field of distorted ones, and a status; (0, 0) unless the status is `hit`."""

    @abc.abstractmethod
    def coefficients(self) -> Float[Array, "... n"]:
        """Coefficient vector in the order of `names`, after the batch axes if the lens has any."""

    @abc.abstractmethod
    def with_coefficients(self, vector: Any) -> Self:
        """The same lens with other coefficients, in the order of `names`. Raises `ValueError` for a wrong number."""


class AbstractFormula(AbstractDistortion):
    """A distortion whose coefficients are its fields, in the order of `names`."""

    def coefficients(self) -> Float[Array, "... n"]:
        lens = as_float64(self, "coefficients")
        return jnp.stack(jnp.broadcast_arrays(*(getattr(lens, name) for name in self.names)), axis=-1)

    def with_coefficients(self, vector: Any) -> Self:
        vector = as_coefficients(vector, type(self))
        return type(self)(*(vector[..., k] for k in range(len(self.names))))


class NoDistortion(AbstractDistortion):
    """Lens without distortion."""

    names: ClassVar = ()

    def distort(self, ideal: PlanePoint) -> PlanePoint:
        return ideal

    def in_field(self, ideal: PlanePoint) -> Flag:
        return jnp.all(jnp.isfinite(ideal))

    def undistort(self, distorted: PlanePoint) -> tuple[PlanePoint, StatusCode]:
        valid = jnp.all(jnp.isfinite(distorted))
        return jnp.where(valid, distorted, 0.0), status_where(~valid, Status.invalid_input, Status.hit.code)

    def coefficients(self) -> Float[Array, "... n"]:
        return jnp.zeros(0)

    def with_coefficients(self, vector: Any) -> Self:
        as_coefficients(vector, type(self))
        return self


def as_coefficients(vector: Any, lens: type[AbstractDistortion]) -> Float[Array, "... n"]:
    """`vector` as float64; raises `ValueError` unless its last axis has one number per coefficient of the lens."""
    vector = as_float64(as_array(vector, "coefficients"), "coefficients")
    if jnp.shape(vector)[-1:] != (len(lens.names),):
        raise ValueError(
            f"{lens.__name__} has {len(lens.names)} coefficients, {' '.join(lens.names) or 'none at all'}; got an "
            f"array of shape {jnp.shape(vector)}. Give one number for each, in this order, 0 for those not in use."
        )
    return vector

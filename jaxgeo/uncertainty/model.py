"""Error model: the independent error sources of an observation and their joint error vector."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64
from jaxgeo._record import Record
from jaxgeo._typing import StatusCode, Vector3
from jaxgeo.terrain import AbstractSearch
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sweep, Tangents
from jaxgeo.uncertainty.sources.base import AbstractSource, Covariance, Error

Root: TypeAlias = Float[Array, "..."]


class ErrorModel(Record):
    """Tuple of mutually independent error sources; correlated errors are combined in one `Correlated` source.

    The error vector e concatenates those of the sources. Every propagation method maps e through `fix_offset`.

    >>> from jaxgeo.uncertainty import sources
    >>> errors = jaxgeo.ErrorModel((
    ...     sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.02),
    ...     sources.Position.from_ned(north=1.5, east=1.5, down=3.0),
    ... ))
    >>> print(errors.size, errors.axes[0], errors.axes[-1])
    6 attitude: heading position: down
    """

    sources: tuple[AbstractSource, ...] = eqx.field(converter=tuple)

    @property
    def size(self) -> int:
        """Length of the error vector."""
        return sum(len(source.axes) for source in self.sources)

    @property
    def axes(self) -> tuple[str, ...]:
        """Name of every axis of the error vector."""
        return tuple(f"{source.label}: {axis}" for source in self.sources for axis in source.axes)

    def parts(self) -> Iterator[tuple[AbstractSource, slice]]:
        """Every source and its slice of the error vector."""
        first = 0
        for source in self.sources:
            yield source, slice(first, first + len(source.axes))
            first += len(source.axes)

    def at(self, inputs: ModelInputs, nominal: NominalFix) -> ErrorModel:
        """The model evaluated at an observation."""
        return ErrorModel(tuple(source.at(inputs, nominal) for source in self.sources))

    def covariance(self) -> Covariance:
        """Covariance of the error vector, block diagonal by source; call on a model evaluated `at` an observation."""
        total = jnp.zeros((self.size, self.size))
        for source, place in self.parts():
            total = total.at[place, place].set(source.covariance())
        return total

    def roots(self) -> tuple[Root, ...]:
        """Square root of each source's covariance, which may be singular; a vector if its axes are independent."""
        return tuple(_root(source) for source in self.sources)

    def factor(self) -> Covariance:
        """L with L z ~ N(0, covariance) for standard normal z: the block diagonal of `roots`."""
        total = jnp.zeros((self.size, self.size))
        for root, (_, place) in zip(self.roots(), self.parts(), strict=True):
            total = total.at[place, place].set(jnp.diag(root) if root.ndim == 1 else root)
        return total

    def draw(self, roots: tuple[Root, ...], normal: Error) -> Error:
        """Error vector L z for a standard normal vector z, as with `factor`, without multiplying its zeros."""
        if all(root.ndim == 1 for root in roots):
            return jnp.concatenate(roots) * normal  # one product; many short loops are slow
        return jnp.concatenate(
            [_times_root(root, normal[place]) for root, (_, place) in zip(roots, self.parts(), strict=True)]
        )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        """The forward-model inputs perturbed by an error vector."""
        for source, place in self.parts():
            inputs = source.moved(inputs, error[place])
        return inputs

    def fix_offset(
        self, inputs: ModelInputs, nominal: NominalFix, error: Error, search: AbstractSearch
    ) -> tuple[Vector3, StatusCode]:
        """(offset in m of the perturbed fix from `nominal`, in east, north, up at `nominal`; status)."""
        return self.moved(inputs, error).fix_offset(nominal, search)

    def linear_offset(self, inputs: ModelInputs, nominal: NominalFix, error: Error) -> Vector3:
        """`fix_offset` for errors that leave the fix in its terrain cell; has the same derivatives at zero error."""
        return self.moved(inputs, error).linear_offset(nominal)

    def sweep(self, inputs: ModelInputs, nominal: NominalFix) -> Sweep:
        """Derivatives of `ModelInputs.sweep` with respect to the error vector, at zero error."""
        return jax.jacfwd(lambda error: self.moved(inputs, error).sweep(nominal))(jnp.zeros(self.size))

    def tangents(self, inputs: ModelInputs, nominal: NominalFix) -> Tangents:
        """Derivatives of what `ModelInputs.sweep` depends on with respect to the error vector, at zero error."""

        def reached(error: Error) -> Tangents:
            moved = self.moved(inputs, error)
            air = jax.tree.map(jnp.asarray, moved.air)
            return Tangents(moved.ray(), air, -moved.terrain.clearance(nominal.p_ecef, nominal.cell))

        return jax.jacfwd(reached)(jnp.zeros(self.size))

    def check(self, inputs: ModelInputs) -> None:
        """Raise as the sources do for invalid values, and for a source that does not apply to the observation."""
        for source in self.sources:
            source.check_numbers()
            source.check(inputs)


def checked_model(errors: object, inputs: ModelInputs) -> ErrorModel:
    """The model in float64, checked against an observation.

    Raises `TypeError` for anything but a model, a source or a tuple or list of sources; `ValueError` if there is none;
    and as `ErrorModel.check`.
    """
    sources = errors.sources if isinstance(errors, ErrorModel) else errors
    if isinstance(sources, AbstractSource):
        sources = (sources,)
    if not isinstance(sources, tuple | list):
        got = f"the class {errors.__name__}: did you forget its arguments?" if isinstance(errors, type) else None
        got = got or f"{type(errors).__name__}."
        raise TypeError(f"errors must be a jaxgeo ErrorModel or a tuple of error sources; got {got}")
    for number, source in enumerate(sources):
        if not isinstance(source, AbstractSource):
            hint = f" Did you mean {source.__name__}(...)?" if isinstance(source, type) else ""
            raise TypeError(
                f"errors[{number}] is no error source known here, but a {type(source).__name__}; they are in "
                f"jaxgeo.uncertainty.sources.{hint}"
            )
    if not sources:
        raise ValueError("errors has no source: without any, a fix is as exact as its input.")
    model = as_float64(ErrorModel(tuple(sources)), "errors")
    model.check(inputs)
    return model


def _root(source: AbstractSource) -> Root:
    """Square root of a source's covariance; its diagonal as a vector if the axes are independent."""
    if source.correlation is None and len(source.sigma_axes) == len(source.axes):
        return jnp.asarray(source.sigma)
    values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(source.covariance()))
    return (vectors * jnp.sqrt(jnp.maximum(values, 0.0))[None, :])[:, ::-1]  # largest variance first


def _times_root(root: Root, normal: Error) -> Error:
    # rounding of a matrix product depends on the batch size
    return root * normal if root.ndim == 1 else jnp.sum(root * normal[None, :], axis=1)

"""Error model: the independent error sources of an observation and their joint error vector."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, is_known
from jaxgeo._numerics import covariance_root
from jaxgeo._record import Record
from jaxgeo._typing import Numbers, StatusCode, Vector3
from jaxgeo.terrain import AbstractSearch
from jaxgeo.uncertainty.copula import Shape, normal_correlation, root_of_correlation
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sweep, Tangents
from jaxgeo.uncertainty.sources.base import AbstractSource, Covariance, Error


class ShapedRoot(NamedTuple):
    """Root of a source that is not normal: standard deviations, distributions, and a root of the correlation of the
    normal numbers; None if the axes are independent."""

    sigma: Float[Array, " axes"]
    shapes: tuple[Shape, ...] | Shape
    latent: Float[Array, "axes axes"] | None

    @classmethod
    def of(cls, source: AbstractSource) -> ShapedRoot:
        """The root of a source that is evaluated `at` an observation."""
        given = source.distribution
        prepare = lambda shape: None if shape is None else shape.prepared()  # noqa: E731
        shapes = tuple(map(prepare, given)) if isinstance(given, tuple) else prepare(given)
        if source.is_independent:
            return cls(jnp.asarray(source.sigma), shapes, None)
        covariance = source.covariance()
        sigma = jnp.sqrt(jnp.diagonal(covariance))
        safe = jnp.where(sigma > 0.0, sigma, 1.0)
        unit = jnp.where(jnp.eye(len(sigma)) > 0.0, 1.0, covariance / (safe[:, None] * safe[None, :]))
        return cls(sigma, shapes, root_of_correlation(normal_correlation(unit, source.shapes)[0]))

    def error(self, normal: Error) -> Error:
        """Error vector for a standard normal vector."""
        if self.latent is not None:
            normal = jnp.sum(self.latent * normal[None, :], axis=1)
        if isinstance(self.shapes, tuple):
            return self.sigma * jnp.stack([_shaped(one, z) for one, z in zip(self.shapes, normal, strict=True)])
        return self.sigma * _shaped(self.shapes, normal)

    def matrix(self) -> Float[Array, "axes axes"]:
        """Derivative of the error by the normal vector, as if all axes were normal."""
        return jnp.diag(self.sigma) if self.latent is None else self.sigma[:, None] * self.latent


def _shaped(shape: Shape, normal: Numbers) -> Numbers:
    return normal if shape is None else shape.standardised(normal)


Root: TypeAlias = Float[Array, "..."] | ShapedRoot


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

    @property
    def is_normal(self) -> bool:
        """Whether the errors of all sources are normal."""
        return all(source.is_normal for source in self.sources)

    @property
    def is_exact(self) -> bool:
        """Whether all standard deviations are zero, and not traced: a fix is then as exact as its input."""
        sigmas = [source.sigma for source in self.sources]
        return is_known(sigmas) and not any(np.any(np.asarray(sigma)) for sigma in sigmas)

    def require_errors(self, function: str) -> None:
        """Raise `ValueError` if all standard deviations are zero."""
        if self.is_exact:
            raise ValueError(
                f"{function}: all standard deviations of the errors are zero, and there is nothing to do: the fix is "
                "as exact as its input. State at least one that is not."
            )

    @property
    def finite_orders(self) -> float:
        """Moments of the errors of orders below this one are finite."""
        shapes = [shape for source in self.sources for shape in source.shapes if shape is not None]
        return min((shape.finite_orders for shape in shapes), default=math.inf)

    @property
    def left_out(self) -> str | None:
        """What a method leaves out that uses only variances, as a sentence; None if all errors are normal."""
        names = [f"{source.label} ({_words(source)})" for source in self.sources if not source.is_normal]
        if not names:
            return None
        which = "1 source that is not normal" if len(names) == 1 else f"{len(names)} sources that are not normal"
        return f"Linear propagation uses the variance of {which}: {', '.join(names)}; samples use the distribution."

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
        """Square root of each source's covariance, which may be singular; a vector if its axes are independent. Of
        sources that are not normal what `draw` needs."""
        return tuple(_root(source) if source.is_normal else ShapedRoot.of(source) for source in self.sources)

    def factor(self) -> Covariance:
        """L with L L' = covariance, block diagonal by source; L z is an error vector if all sources are normal."""
        return self._block_diagonal(tuple(_root(source) for source in self.sources))

    def linear_draw(self, roots: tuple[Root, ...]) -> Covariance:
        """Derivative of `draw` by the normal vector, as if all sources were normal."""
        return self._block_diagonal(roots)

    def _block_diagonal(self, roots: tuple[Root, ...]) -> Covariance:
        total = jnp.zeros((self.size, self.size))
        for root, (_, place) in zip(roots, self.parts(), strict=True):
            block = root.matrix() if isinstance(root, ShapedRoot) else jnp.diag(root) if root.ndim == 1 else root
            total = total.at[place, place].set(block)
        return total

    def draw(self, roots: tuple[Root, ...], normal: Error) -> Error:
        """Error vector for a standard normal vector z: L z for normal sources, without multiplying the zeros of L."""
        plain = [root for root in roots if not isinstance(root, ShapedRoot) and root.ndim == 1]
        if len(plain) == len(roots):
            return jnp.concatenate(plain) * normal  # one product; many short loops are slow
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

    def tangents(self, inputs: ModelInputs, nominal: NominalFix) -> tuple[Tangents, Tangents]:
        """(what `ModelInputs.sweep` depends on, its derivatives by the error vector), at zero error."""

        def reached(error: Error) -> tuple[Tangents, Tangents]:
            moved = self.moved(inputs, error)
            air = jax.tree.map(jnp.asarray, moved.air)
            found = Tangents(moved.ray(), air, -moved.terrain.clearance(nominal.p_ecef, nominal.cell))
            return found, found

        by_error, base = jax.jacfwd(reached, has_aux=True)(jnp.zeros(self.size))
        return base, by_error

    def check_at(self, nominal: NominalFix) -> None:
        """Raise `ValueError` for a source that is unknown at a fix; traced fixes pass."""
        for source in self.sources:
            source.check_at(nominal)

    def check(self, inputs: ModelInputs) -> None:
        """Raise as the sources do for invalid values, and for a source that does not apply to the observation."""
        for source in self.sources:
            source.check_numbers()
            source.check(inputs)


def checked_model(errors: object, inputs: ModelInputs, *, moments: int = 2) -> ErrorModel:
    """The model in float64, checked against an observation.

    `moments` is the order of the moments that the caller uses, 0 for samples. Raises `TypeError` for anything but a
    model, a source or a tuple or list of sources; `ValueError` if there is none, or if a distribution lacks these
    moments; and as `ErrorModel.check`.
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
    for source in model.sources:
        _check_moments(source, moments)
    return model


def _check_moments(source: AbstractSource, order: int) -> None:
    for shape in source.shapes:
        if shape is not None and order and not shape.finite_orders > order:
            what = "variance, which linear propagation, budgets and fits need"
            if order > 2:
                what = "fourth moment, which sigma points and second order need"
            raise ValueError(
                f"{source.label}: {shape.words} has no finite {what}. Draw samples with jaxgeo.sample, which need "
                f"none, or take a distribution with lighter tails (StudentT with df above {order})."
            )


def _words(source: AbstractSource) -> str:
    return ", ".join(dict.fromkeys("normal" if shape is None else shape.words for shape in source.shapes))


def _root(source: AbstractSource) -> Float[Array, "..."]:
    """Square root of a source's covariance; its diagonal as a vector if the axes are independent."""
    if source.is_independent:
        return jnp.asarray(source.sigma)
    return covariance_root(source.covariance())


def _times_root(root: Root, normal: Error) -> Error:
    if isinstance(root, ShapedRoot):
        return root.error(normal)
    # rounding of a matrix product depends on the batch size
    return root * normal if root.ndim == 1 else jnp.sum(root * normal[None, :], axis=1)

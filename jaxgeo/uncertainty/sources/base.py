"""Base class of error sources: standard deviations, correlation, and the perturbation of an observation."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Num

from jaxgeo._checks import as_array, as_float64, by_numpy_if_known, check_finite, concrete, require_x64
from jaxgeo._record import Record
from jaxgeo.uncertainty.copula import Shape, normal_correlation
from jaxgeo.uncertainty.datasheet import Stated
from jaxgeo.uncertainty.distributions import AbstractDistribution
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sharing import AbstractSharing, Occasion, TimeCorrelated

SourceT = TypeVar("SourceT", bound="AbstractSource")
Error: TypeAlias = Float[Array, " axes"]
Covariance: TypeAlias = Float[Array, "axes axes"]
if TYPE_CHECKING:
    Sigma: TypeAlias = Any
    Correlation: TypeAlias = Any
else:
    Sigma: TypeAlias = Num[ArrayLike, " axes"]
    Correlation: TypeAlias = Num[ArrayLike, "axes axes"] | None

REACHED = 1e-3  # tolerance of a correlation that distributions can just have
NEGATIVE = 1e-9  # of the largest eigenvalue: rounding tolerance for negative eigenvalues


class AbstractSource(Record):
    """One error source: a vector e with zero mean and covariance D R D, D of `sigma`, R the `correlation`, that
    perturbs an observation.

    `sigma` holds standard deviations in rad, m, px, s, K or Pa, one for each of `names`; without a `correlation` the
    axes are independent. `sharing` is the correlation of the error between two measurements. The errors are normal, or
    have a `distribution` of `jaxgeo.uncertainty.distributions`: one for all axes, or a tuple with one for each (None:
    normal). The correlation is that of the errors; they are drawn by a Gaussian copula, which keeps the distribution
    of each axis. Linear propagation, adjustment and registration use the covariance alone.
    """

    distribution: Any = eqx.field(default=None, kw_only=True)
    sigma: eqx.AbstractVar[Sigma]
    correlation: eqx.AbstractVar[Correlation]
    sharing: eqx.AbstractVar[AbstractSharing]
    names: ClassVar[tuple[str, ...]]
    unit: ClassVar[str]

    @property
    def label(self) -> str:
        """Name in error budgets."""
        words = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in type(self).__name__)
        return words.strip()

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes of the error vector."""
        return self.names

    @property
    def sigma_axes(self) -> tuple[str, ...]:
        """Names of the entries of `sigma`."""
        return self.axes

    @property
    def is_normal(self) -> bool:
        """Whether the errors of all axes are normal."""
        shapes = self.distribution if isinstance(self.distribution, tuple) else (self.distribution,)
        return all(shape is None for shape in shapes)

    @property
    def is_independent(self) -> bool:
        """Whether the errors of the axes are independent, each with its own sigma."""
        return self.correlation is None and len(self.sigma_axes) == len(self.axes)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Distribution of each axis; None is normal."""
        given = self.distribution
        return given if isinstance(given, tuple) else (given,) * len(self.axes)

    def at(self: SourceT, inputs: ModelInputs, nominal: NominalFix) -> SourceT:
        """The source evaluated at an observation; only sources that vary over the ground change."""
        del inputs, nominal
        return self

    def covariance(self) -> Covariance:
        """Covariance of the error vector."""
        sigma = jnp.asarray(self.sigma)
        unit = jnp.eye(sigma.shape[0]) if self.correlation is None else jnp.asarray(self.correlation)
        return sigma[:, None] * unit * sigma[None, :]

    def cross_covariance(self, there: Any, when: tuple[Occasion, Occasion]) -> Covariance:
        """Covariance between this error vector (rows) and that of the same source at another observation (columns)."""
        sigma, other = jnp.asarray(self.sigma), jnp.asarray(there.sigma)
        unit = jnp.eye(sigma.shape[0]) if self.correlation is None else jnp.asarray(self.correlation)
        return self.sharing.correlation(*when) * (sigma[:, None] * unit * other[None, :])

    @abstractmethod
    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        """The observation perturbed by an error."""

    def check(self, inputs: ModelInputs) -> None:
        """Raise `ValueError` if the source cannot act on an observation, `TypeError` if it does not apply to it."""
        del inputs

    def check_at(self, nominal: NominalFix) -> None:
        """Raise `ValueError` if the source is unknown at a fix that is not traced."""
        del nominal

    def check_numbers(self) -> None:
        """Raise `ValueError` for a sigma that is negative or not finite, an invalid correlation or distribution, and
        `TypeError` for anything else as a distribution.
        """
        check_sigma(self.sigma, self.sigma_axes, self.label, self.unit)
        if self.correlation is not None:
            check_correlation(self.correlation, len(self.axes), self.label)
        if self.distribution is not None:
            check_distribution(self)
        if isinstance(self.sharing, TimeCorrelated):
            self.sharing.check()

    @classmethod
    def from_covariance(cls: type[SourceT], covariance: ArrayLike, **options: Any) -> SourceT:
        """Source from a covariance matrix (axes, axes), in the squared units of `sigma`.

        Raises `ValueError` if it is not symmetric and positive semi-definite.
        """
        given: Any = as_float64(as_array(covariance, "covariance"), "covariance")
        check_covariance(given, f"covariance of {cls.__name__}")
        sigma = jnp.sqrt(jnp.maximum(jnp.diagonal(given), 0.0))
        safe = jnp.where(sigma > 0.0, sigma, 1.0)
        correlation = jnp.where(jnp.eye(sigma.shape[0]) > 0.0, 1.0, given / (safe[:, None] * safe[None, :]))
        return cls(sigma=sigma, correlation=correlation, **options)


def sigmas(*values: ArrayLike, degrees: bool = False) -> Array:
    """Standard deviations as one vector, converted from degrees if `degrees` is set."""
    require_x64()
    parts: Any = as_float64(list(values), "sigma")

    def together(xp: Any, parts: list[Any]) -> Any:
        stacked = xp.stack([xp.asarray(part) for part in parts])
        return xp.deg2rad(stacked) if degrees else stacked

    return by_numpy_if_known(together, parts)


Axis: TypeAlias = ArrayLike | Stated  # standard deviation of an axis


def stated(values: Sequence[Axis], options: Mapping[str, Any], *, degrees: bool = False) -> dict[str, Any]:
    """Arguments of a source: `sigma` and `distribution` from one value per axis (see `sigmas`), and its `options`.

    Raises `ValueError` if both a value and the options have a distribution.
    """
    numbers = [value.sigma if isinstance(value, Stated) else value for value in values]
    shapes = tuple(value.distribution if isinstance(value, Stated) else None for value in values)
    found: dict[str, Any] = {"sigma": sigmas(*numbers, degrees=degrees), **options}
    if all(shape is None for shape in shapes):
        return found
    if options.get("distribution") is not None:
        raise ValueError(
            "distribution is stated twice: with a value of datasheet, and by distribution=; leave one out."
        )
    return {**found, "distribution": shapes}


def check_sigma(sigma: Any, axes: tuple[str, ...], label: str, unit: str) -> None:
    """Raise `ValueError` for standard deviations that are negative, not finite, or not one for each axis."""
    if np.shape(sigma) != (len(axes),):
        raise ValueError(
            f"{label}: sigma must be one number for each of {', '.join(axes)}; got shape {np.shape(sigma)}."
        )
    check_finite(sigma, f"{label}: sigma", "rad, m, px, s, K or Pa")
    known = concrete(sigma)
    if known is not None and np.any(known < 0.0):
        axis = int(np.argmax(known < 0.0))
        value = float(known[axis])
        shown = f"{math.degrees(value):.6g} deg" if unit == "rad" else f"{value:.6g} {unit}"
        raise ValueError(f"{label}: sigma of {axes[axis]} must not be negative; got {shown}.")


def check_distribution(source: AbstractSource) -> None:
    """Raise for a distribution that is none, does not match the axes, or cannot have the correlation of the source."""
    shapes = source.distribution if isinstance(source.distribution, tuple) else (source.distribution,)
    for shape in shapes:
        if shape is not None and not isinstance(shape, AbstractDistribution):
            hint = f" Did you mean {shape.__name__}(...)?" if isinstance(shape, type) else ""
            raise TypeError(
                f"{source.label}: distribution must be one of jaxgeo.uncertainty.distributions, such as Uniform(), a "
                f"tuple with one for each axis, or None for normal errors; got {shape!r}.{hint}"
            )
    if len(shapes) not in (1, len(source.axes)) or (len(shapes) != len(source.axes) and shapes is source.distribution):
        raise ValueError(
            f"{source.label}: distribution must be one for all axes or a tuple with one for each of "
            f"{', '.join(source.axes)}; got {len(shapes)}."
        )
    for shape in shapes:
        if shape is not None:
            shape.check(source.label)
    if not source.is_normal and source.correlation is not None:
        _check_reachable(source)


def _check_reachable(source: AbstractSource) -> None:
    """Raise `ValueError` if no correlation of normal numbers gives the errors theirs."""
    for shape in source.shapes:
        if shape is not None and shape.finite_orders <= 2.0:
            raise ValueError(
                f"{source.label}: {shape.words} has no variance, so that its errors have no correlation; leave "
                "correlation out."
            )
    wanted = concrete(source.correlation)
    if wanted is None:
        return
    found = normal_correlation(jnp.asarray(wanted, jnp.float64), source.shapes)
    if any(concrete(part) is None for part in found):
        return
    of_normals, low, high = map(np.asarray, found)
    apart = ~np.eye(len(wanted), dtype=bool)
    beyond = apart & ((wanted > high + REACHED) | (wanted < low - REACHED))
    if np.any(beyond):
        i, j = (int(k) for k in np.argwhere(beyond)[0])
        names = [shape.words if shape is not None else "normal" for shape in source.shapes]
        raise ValueError(
            f"{source.label}: {source.axes[i]} ({names[i]}) and {source.axes[j]} ({names[j]}) cannot have the "
            f"correlation {wanted[i, j]:.6g}: with these distributions it is from {low[i, j]:.4g} to {high[i, j]:.4g}."
        )
    lowest = float(np.linalg.eigvalsh(of_normals)[0])
    if lowest < -REACHED:
        raise ValueError(
            f"{source.label}: no Gaussian copula gives errors of these distributions this correlation: that of the "
            f"normal numbers would have the eigenvalue {lowest:.3g}. Correlate the axes by less."
        )


def check_covariance(covariance: Any, name: str) -> None:
    """Raise `ValueError` unless a concrete matrix is symmetric and positive semi-definite."""
    if np.ndim(covariance) != 2 or np.shape(covariance)[0] != np.shape(covariance)[1]:
        raise ValueError(f"{name} must be a square matrix; got shape {np.shape(covariance)}.")
    check_finite(covariance, name, "squared units")
    known = concrete(covariance)
    if known is None:
        return
    largest = float(np.max(np.abs(known), initial=0.0))
    if np.max(np.abs(known - known.T), initial=0.0) > NEGATIVE * largest:
        row, col = np.unravel_index(np.argmax(np.abs(known - known.T)), known.shape)
        raise ValueError(
            f"{name} must be symmetric; entry ({row}, {col}) is {known[row, col]:.9g}, but ({col}, {row}) is "
            f"{known[col, row]:.9g}."
        )
    lowest = float(np.linalg.eigvalsh(0.5 * (known + known.T))[0]) if known.size else 0.0
    if lowest < -NEGATIVE * largest:
        raise ValueError(
            f"{name} is not positive semi-definite: its lowest eigenvalue is {lowest:.6g}. Its axes are correlated by "
            "more than their variances allow."
        )


def check_correlation(correlation: Any, count: int, label: str) -> None:
    """Raise `ValueError` unless a concrete matrix is a correlation matrix of `count` axes."""
    if np.shape(correlation) != (count, count):
        raise ValueError(f"{label}: correlation must have the shape ({count}, {count}); got {np.shape(correlation)}.")
    check_covariance(correlation, f"{label}: correlation")
    known = concrete(correlation)
    if known is not None and np.any(np.abs(np.diagonal(known) - 1.0) > 1e-9):
        raise ValueError(f"{label}: correlation must have ones on its diagonal; got {np.diagonal(known).tolist()}.")

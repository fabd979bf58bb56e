"""Error budget of a fix: contribution of each standard deviation of each error source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import by_numpy_if_known, check_is
from jaxgeo._compile import quick_filter_jit, quick_jit
from jaxgeo._record import Record
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.status import Status
from jaxgeo.uncertainty.accuracy_record import Accuracy
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.method_selection import Method
from jaxgeo.uncertainty.metrics import circular_error
from jaxgeo.uncertainty.metrics._host import host_slopes
from jaxgeo.uncertainty.metrics.exact import check_probability
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.slopes import Surface, along_plane
from jaxgeo.uncertainty.sources import Correlated
from jaxgeo.uncertainty.sources.base import AbstractSource

Sigmas = Float[Array, " sigmas"]
Covariances = Float[Array, "causes 3 3"]
READ_AS = {"rad": ("deg", 180.0 / math.pi)}  # display unit and factor
ROUGHNESS = "roughness of the ground"
NOT_LINEAR = "Linear propagation is not valid at this fix: the shares are those of small errors."


class Variance(NamedTuple):
    """Horizontal variance (east plus north) and vertical variance, m2."""

    horizontal: float
    vertical: float


class SigmaShare(NamedTuple):
    """Contribution of one standard deviation to a budget.

    `sigma` in `unit`; `variance` is its contribution, None in a correlated block, whose axes have no separate shares;
    `without` is the circular error in m without it, `slope` the derivative of the circular error by it, m per unit.
    """

    name: str
    sigma: float
    unit: str
    variance: Variance | None
    without: float
    slope: float


class SourceShare(NamedTuple):
    """Contribution of one source to a budget; `is_block` if only the whole has a share (its axes are correlated)."""

    label: str
    variance: Variance
    without: float
    is_block: bool
    sigmas: tuple[SigmaShare, ...]


class Budget(Record):
    """Error budget of one observation by linear propagation; print it for a table.

    `total` is the variance of the fix, the sum of `shares()`; `circular_error` in m is that at `probability`, of an
    accuracy the same that it states. With a footprint slope the last of `sources` is the roughness of the ground, which
    has no sigma. With a `status` other than `hit`, its message limits the validity of the budget. `note` says what it
    leaves out.
    """

    sources: tuple[SourceShare, ...]
    total: Variance
    circular_error: float
    probability: float
    status: Status
    note: str | None = None

    def shares(self) -> dict[str, Variance]:
        """Shares that add up to `total`: independent standard deviations, correlated blocks, ground roughness."""
        return {row.name: row.variance for row in self._rows() if row.variance is not None}

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings; standard deviations in display units: deg, m, px, s."""
        said = {} if self.note is None else {"note": self.note}
        return {
            "probability": self.probability,
            "circular_error_m": self.circular_error,
            "variance_m2": self.total._asdict(),
            "status": self.status.name,
            "sources": [_source_as_dict(source) for source in self.sources],
            **said,
        }

    def __str__(self) -> str:
        percent = f"CE{100.0 * self.probability:g}"
        rows = [("error", "sigma", "horizontal", "vertical", f"{percent} without", f"d{percent}/dsigma")]
        for row in sorted(self._rows(), key=lambda row: row.order):
            sigma, slope = ("", "") if row.line is None else _as_read(row.line)
            without = f"{row.without:.3f} m" if math.isfinite(row.without) else ""
            rows.append((row.name, sigma, *self._percent(row.variance), without, slope))
        total = (f"{math.sqrt(self.total.horizontal):.3f} m", f"{math.sqrt(self.total.vertical):.3f} m")
        rows.append(("total standard deviation", "", *total, f"{percent} {self.circular_error:.3f} m", ""))
        notes = [] if self.status == Status.hit else [f"{self.status.name}: {self.status.message}"]
        return "\n".join([_table(rows), *notes, *([] if self.note is None else [self.note])])

    def _rows(self) -> Iterator[_Row]:
        for source in self.sources:
            of_source = (-source.variance.horizontal, -source.variance.vertical)
            if source.is_block:
                yield _Row(source.label, source.variance, source.without, None, (*of_source, 0))
            for line in source.sigmas:
                own = of_source if line.variance is None else (-line.variance.horizontal, -line.variance.vertical)
                yield _Row(line.name, line.variance, line.without, line, (*own, 1))

    def _percent(self, variance: Variance | None) -> tuple[str, str]:
        if variance is None:
            return "in block", "in block"
        whole = zip(variance, self.total, strict=True)
        across, up = (f"{100.0 * part / total:.2f} %" if total > 0.0 else "0 %" for part, total in whole)
        return across, up


class _Row(NamedTuple):
    """Row of a budget table; `line` is its sigma, if any; `order` sorts the axes of a block after the block."""

    name: str
    variance: Variance | None
    without: float
    line: SigmaShare | None
    order: tuple[float, float, int]


class Linear(Record):
    """Covariance of a fix as a function of the standard deviations of all error sources."""

    jacobian: Float[Array, "3 axes"]
    rough_enu: Matrix3
    bias_enu: Vector3
    model: ErrorModel

    @classmethod
    def of(cls, propagation: Any, what: str) -> Linear:
        """From a checked propagation; `what` names the purpose in messages.

        Raises `TypeError` for another type or a traced propagation, `ValueError` for a batch or one without a fix.
        """
        check_is(propagation, Propagation, "propagation", "Make one with jaxgeo.uncertainty.propagate.")
        if isinstance(propagation.fix.status, jax.core.Tracer):
            raise TypeError(f"{what} is plain numbers and cannot be traced; call it outside jit and vmap.")
        if jnp.ndim(propagation.fix.status) != 0:
            raise ValueError(
                f"{what} is of one observation; this propagation has the shape {jnp.shape(propagation.fix.status)}. "
                "Take one: jax.tree.map(lambda x: x[0], propagation)."
            )
        if not all(map(math.isfinite, jax.device_get(propagation.cov_enu).ravel())):
            status = Status(int(propagation.fix.status))
            raise ValueError(f"{what} needs a fix, and there is none: {status.name}: {status.message}")
        rough = _of_roughness(propagation.surface, propagation.nominal.direction_enu)
        return cls(propagation.jacobian, rough, propagation.bias_enu, propagation.model)

    def swept(self, sigma: Sigmas) -> Matrix3:
        """Contribution of the errors to the covariance of the fix, m2."""
        cov = self.jacobian @ with_sigmas(self.model, sigma).covariance() @ self.jacobian.T
        return 0.5 * (cov + cov.T)

    def on_level(self, sigma: Sigmas) -> Float[Array, "2 2"]:
        """Horizontal covariance of the fix, m2, including ground roughness."""
        return (self.swept(sigma) + self.rough_enu)[:2, :2]


def _of_roughness(surface: Surface, direction_enu: Vector3) -> Matrix3:
    """Contribution of the ground's roughness to the covariance of the fix, m2."""
    if float(surface.roughness) == 0.0:  # of a facet
        return jax.device_put(np.zeros((3, 3)))
    return _of_rough_ground(surface, direction_enu)


@quick_filter_jit
def _of_rough_ground(surface: Surface, direction_enu: Vector3) -> Matrix3:
    along = direction_enu / along_plane(surface.normal, direction_enu)
    return jnp.outer(along, along) * surface.roughness**2


def error_and_slopes(linear: Linear, sigma: Sigmas, probability: Scalar) -> tuple[Scalar, Sigmas]:
    """(circular error in m, its derivative by each standard deviation, m per unit).

    The chain rule over the covariance keeps the part that is slow to compile the same for all error models.
    """
    cov, by_sigma = jax.device_get(_level_and_slopes(linear, sigma))  # a program for each operation would follow
    bias = jax.device_get(linear.bias_enu)[:2]
    error: Any = circular_error(cov, probability, bias)
    by_cov = host_slopes(cov, error, bias)
    if by_cov is None:
        error, by_cov = _error_and_slopes(cov, probability, bias)
    return error, jax.device_put((by_cov[:, :, None] * by_sigma).sum(axis=(0, 1)))


_error_and_slopes = quick_jit(jax.value_and_grad(circular_error))


@quick_filter_jit
def _level_and_slopes(linear: Linear, sigma: Sigmas) -> tuple[Float[Array, "2 2"], Float[Array, "2 2 sigmas"]]:
    return linear.on_level(sigma), jax.jacfwd(linear.on_level)(sigma)


def budget(propagation: Propagation | Accuracy, probability: ArrayLike | None = None) -> Budget:
    """Error budget: contribution of each standard deviation to the covariance and circular error of a fix.

    Of errors that are not normal only the variance counts; `sobol_indices` uses their distributions. Variances add up;
    circular errors do not. Each row therefore also has the circular error without that contribution,
    all others unchanged, and the derivative by the sigma, both of the exact quantile. Correlated axes have a share only
    as a block; one of them may reduce the error if it cancels another. With a footprint slope the plane is held fixed.

    From the `jaxgeo.accuracy` of one fix, circular errors are scaled to the one that it states, which follows the
    terrain profile. If that is of samples, linear propagation is not valid, and there is no circular error without a
    source, nor a derivative (NaN).

    `probability` is 0.9, or that of the accuracy. Raises `ValueError` for a propagation without a fix, a batch, a
    probability outside (0, 1) or other than that of the accuracy; `TypeError` for another type or traced values.

    >>> from jaxgeo.uncertainty import sources
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> errors = jaxgeo.ErrorModel((
    ...     sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
    ...     sources.GimbalAngles.from_degrees(yaw=1.0, pitch=0.5, roll=0.5),
    ...     sources.TerrainHeight.from_metres(2.0),
    ... ))
    >>> scene = sensor, shot, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0), errors
    ...
    >>> shares = jaxgeo.uncertainty.budget(jaxgeo.propagate(*scene))
    >>> for source in shares.sources:
    ...     print(f"{source.label}: CE90 without it {source.without:.2f} m of {shares.circular_error:.2f} m")
    position: CE90 without it 5.45 m of 11.52 m
    gimbal angles: CE90 without it 10.67 m of 11.52 m
    terrain height: CE90 without it 11.06 m of 11.52 m
    """
    stated = propagation if isinstance(propagation, Accuracy) else None
    level: ArrayLike = 0.9 if probability is None else probability
    if isinstance(propagation, Accuracy):
        propagation, level = _propagation_of(propagation, probability)
    linear = Linear.of(propagation, "An error budget")
    probability = check_probability(level)
    covs, others, bias = jax.device_get((*_causes(linear), linear.bias_enu))
    without = [float(circular_error(cov[:2, :2], probability, bias[:2])) for cov in others]
    error, slopes = error_and_slopes(linear, sigmas_of(linear.model), probability)
    radius, slopes, note = float(error), np.asarray(slopes), propagation.note
    if stated is not None:
        radius, times = float(stated.circular), float(stated.circular) / radius if radius > 0.0 else 1.0
        if int(stated.method) == Method.samples:
            times, note = math.nan, NOT_LINEAR if note is None else f"{NOT_LINEAR} {note}"
        without, slopes = [times * one for one in without], times * slopes
    variances = [_variance(cov) for cov in covs]
    sources = _of_sources(linear.model, variances, without, slopes.tolist())
    if float(propagation.surface.roughness) > 0.0:
        sources = (*sources, SourceShare(ROUGHNESS, variances[-1], without[-1], True, ()))
    status = Status(int(propagation.fix.status))
    return Budget(sources, _variance(jax.device_get(propagation.cov_enu)), radius, float(probability), status, note)


def _propagation_of(accuracy: Accuracy, probability: ArrayLike | None) -> tuple[Propagation, float]:
    """(linear propagation, probability) of the accuracy of one fix; `probability` is that asked for, if any."""
    if accuracy.propagation is None:
        raise ValueError(
            "An error budget is of one fix, and of an accuracy that was not computed under jit or vmap: "
            "jaxgeo.accuracy(sensor, shot, uv, terrain, errors) of one pixel, or jaxgeo.propagate."
        )
    level = accuracy.level()
    if probability is not None and float(check_probability(probability)) != level:
        asked = float(jnp.asarray(probability))
        raise ValueError(f"the accuracy is of probability {level:g}; for {asked:g}, pass it to jaxgeo.accuracy.")
    return accuracy.propagation, level


@quick_filter_jit
def _causes(linear: Linear) -> tuple[Covariances, Covariances]:
    """(covariances of the fix from each cause alone, from all others), m2.

    Order of causes: sigmas, sources, ground roughness.
    """
    sigma = sigmas_of(linear.model)
    alone = jnp.concatenate([jnp.eye(sigma.shape[0]), _membership(linear.model)])
    covs = jax.vmap(linear.swept)(alone * sigma[None, :])
    others = jax.vmap(linear.swept)((1.0 - alone) * sigma[None, :]) + linear.rough_enu[None]
    return jnp.append(covs, linear.rough_enu[None], 0), jnp.append(others, linear.swept(sigma)[None], 0)


def _of_sources(
    model: ErrorModel, variances: Sequence[Variance], without: Sequence[float], slopes: Sequence[float]
) -> tuple[SourceShare, ...]:
    """Shares of all sources, with names and units."""
    sigmas, names, units = sigmas_of(model).tolist(), sigma_names(model), sigma_units(model)
    sources, first = [], 0
    for number, (source, label) in enumerate(zip(model.sources, source_names(model), strict=True)):
        is_block = source.correlation is not None
        lines = tuple(
            SigmaShare(names[k], sigmas[k], units[k], None if is_block else variances[k], without[k], slopes[k])
            for k in range(first, first + _count(source))
        )
        whole = len(sigmas) + number
        sources.append(SourceShare(label, variances[whole], without[whole], is_block, lines))
        first += _count(source)
    return tuple(sources)


def _variance(cov_enu: Any) -> Variance:
    return Variance(float(cov_enu[0, 0] + cov_enu[1, 1]), float(cov_enu[2, 2]))


def sigmas_of(model: ErrorModel) -> Sigmas:
    """Standard deviations of all sources, concatenated."""
    return by_numpy_if_known(lambda xp, all: xp.concatenate(all), [jnp.asarray(one.sigma) for one in model.sources])


def with_sigmas(model: ErrorModel, sigma: Sigmas) -> ErrorModel:
    """The model with other standard deviations, in the order of `sigmas_of`."""
    return ErrorModel(_with_sigmas(model.sources, sigma))


def sigma_names(model: ErrorModel) -> tuple[str, ...]:
    """Unique name of each standard deviation in `sigmas_of`."""
    pairs = zip(source_names(model), model.sources, strict=True)
    return tuple(f"{name}: {axis}" for name, source in pairs for axis in source.sigma_axes)


def source_names(model: ErrorModel) -> tuple[str, ...]:
    """Unique name of each source; sources of the same type are numbered from the second on."""
    labels = [source.label for source in model.sources]
    earlier = [labels[:number].count(label) for number, label in enumerate(labels)]
    return tuple(label if n == 0 else f"{label} ({n + 1})" for label, n in zip(labels, earlier, strict=True))


def sigma_units(model: ErrorModel) -> tuple[str, ...]:
    """Unit of each standard deviation in `sigmas_of`."""
    return tuple(unit for source in model.sources for unit in _units(source))


def _units(source: AbstractSource) -> list[str]:
    if isinstance(source, Correlated):
        return [unit for part in source.parts for unit in _units(part)]
    each = source.unit.split(" and ")
    return each if len(each) == _count(source) else [source.unit] * _count(source)


def _count(source: AbstractSource) -> int:
    return jnp.shape(source.sigma)[0]


def _with_sigmas(sources: tuple[AbstractSource, ...], sigma: Sigmas) -> tuple[AbstractSource, ...]:
    after, first = [], 0
    for source in sources:
        own = sigma[first : first + _count(source)]
        moved = eqx.tree_at(lambda source: source.sigma, source, own)
        if isinstance(moved, Correlated):
            moved = eqx.tree_at(lambda block: block.parts, moved, _with_sigmas(moved.parts, own))
        after.append(moved)
        first += _count(source)
    return tuple(after)


def _membership(model: ErrorModel) -> Float[Array, "sources sigmas"]:
    """Indicator matrix: 1 if a standard deviation belongs to a source, else 0."""
    owner = jnp.concatenate([jnp.full(_count(source), number) for number, source in enumerate(model.sources)])
    return (owner[None, :] == jnp.arange(len(model.sources))[:, None]).astype(jnp.float64)


def _as_read(line: SigmaShare) -> tuple[str, str]:
    unit, factor = READ_AS.get(line.unit, (line.unit, 1.0))
    one = f"({unit})" if "/" in unit else unit
    slope = f"{line.slope / factor:.4g} m/{one}" if math.isfinite(line.slope) else ""
    return f"{line.sigma * factor:.4g} {unit}", slope


def _source_as_dict(source: SourceShare) -> dict[str, Any]:
    sigmas = []
    for line in source.sigmas:
        unit, factor = READ_AS.get(line.unit, (line.unit, 1.0))
        share = None if line.variance is None else line.variance._asdict()
        read = {"sigma": line.sigma * factor, "unit": unit, "circular_error_slope": line.slope / factor}
        sigmas.append({"name": line.name, **read, "variance_m2": share, "circular_error_without_m": line.without})
    whole = {"variance_m2": source.variance._asdict(), "circular_error_without_m": source.without}
    return {"source": source.label, "is_block": source.is_block, **whole, "sigmas": sigmas}


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    """Text table, first column left-aligned, others right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        right = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *right]).rstrip())
    return "\n".join(lines)

"""Sobol sensitivity indices of the fix error: variance share of each source, alone and with interactions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit, quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._budget import source_names
from jaxgeo.uncertainty.batched_rays import (
    BLOCK,
    FixOffsets,
    block_size,
    common_ground,
    in_blocks,
    offsets_of_lines,
    perturbed_lines,
    places_of_ground,
)
from jaxgeo.uncertainty.draws import AbstractDraws, Sobol
from jaxgeo.uncertainty.intervals import LEAST_SCRAMBLES
from jaxgeo.uncertainty.model import ErrorModel, Root, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampling import Sampling, accepts_sampling_options, resolve_sampling

CHUNK = BLOCK  # rows at a time: one size for every count
FEW = 0.1  # share of excluded rows above which the indices no longer describe the observation's error
COMPONENTS = ("east", "north", "up", "horizontal")
SUMS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
SAMPLES = 4096
SOBOL = Sobol()
SAMPLING = Sampling()

Normals = Float[Array, "rows axes"]
Offsets = Float[Array, "rows 3"]


class Estimate(NamedTuple):
    """First-order and total indices (groups, components), half-widths of their intervals, variances (components,).

    NaN for a component that does not vary.
    """

    first: np.ndarray
    total: np.ndarray
    first_half: np.ndarray
    total_half: np.ndarray
    variance: np.ndarray


class SobolIndex(NamedTuple):
    """Variance share of one group in one component: first order (alone) and total (including interactions)."""

    first: float
    first_low: float
    first_high: float
    total: float
    total_low: float
    total_high: float


class SobolIndices(Record):
    """Sobol indices of the fix error by groups of errors, for east, north, up and the horizontal plane.

    `estimate` uses the rows with a fix in every evaluation; `left_out` is the share of the others. `confidence` is that
    of the intervals, `variance` in m2 in the order of the components.
    """

    groups: tuple[str, ...]
    estimate: Estimate
    rows: int
    left_out: float
    confidence: float

    @property
    def variance(self) -> dict[str, float]:
        """Variance of each component in m2; for the horizontal plane the sum of east and north."""
        return dict(zip(COMPONENTS, self.estimate.variance.tolist(), strict=True))

    @property
    def warning(self) -> str | None:
        """Warning if too many rows have no fix for the indices to describe the observation's error; else None."""
        if self.left_out <= FEW:
            return None
        return (
            f"{100.0 * self.left_out:.3g} % of the rows were left out, since the errors drawn leave no fix: the "
            "indices are of the errors that do, and not of all."
        )

    def of(self, group: str, component: str = "horizontal") -> SobolIndex:
        """Indices of a group. Raises `ValueError` for an unknown name."""
        for name, names, kind in ((group, self.groups, "group"), (component, COMPONENTS, "component")):
            if name not in names:
                raise ValueError(f"{kind} must be one of {', '.join(names)}; got {name!r}.")
        place = self.groups.index(group), COMPONENTS.index(component)
        first, total, first_half, total_half = (float(part[place]) for part in self.estimate[:4])
        first_bounds = first, first - first_half, first + first_half
        return SobolIndex(*first_bounds, total, total - total_half, total + total_half)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words."""
        indices = {g: {c: self.of(g, c)._asdict() for c in COMPONENTS} for g in self.groups}
        kept = {"rows": self.rows, "left_out": self.left_out, "warning": self.warning}
        return {"indices": indices, "variance_m2": self.variance, "confidence": self.confidence, **kept}

    def __str__(self) -> str:
        width = max(map(len, self.groups))
        lines = [f"{'horizontal':{width}}  {'first order':>16}  {'total':>16}"]
        order = np.argsort(-self.estimate.total[:, COMPONENTS.index("horizontal")], kind="stable")
        for group in (self.groups[k] for k in order):
            index = self.of(group)
            half = index.first_high - index.first, index.total_high - index.total
            lines.append(f"{group:{width}}  {index.first:7.4f} ± {half[0]:.4f}  {index.total:7.4f} ± {half[1]:.4f}")
        lines.append(f"{self.rows} rows, {100.0 * self.left_out:.3g} % of them left out")
        return "\n".join(lines if self.warning is None else [*lines, self.warning])


class Plan(NamedTuple):
    """Inputs of the map from standard normal numbers to fix offsets; `roots` if some errors are not normal."""

    inputs: ModelInputs
    nominal: NominalFix
    model: ErrorModel
    factor: Float[Array, "axes axes"] | None
    roots: tuple[Root, ...] = ()


@accepts_sampling_options
@accepts_observation
def sobol_indices(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    sampling: Sampling = SAMPLING,
    by_axis: bool = False,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    confidence: float = 0.95,
    resamples: int = 500,
) -> SobolIndices:
    """Share of the variance of a fix due to each source, alone (first order) and with interactions (total).

    Every source is a group; with `by_axis` so is every axis of sources with independent axes. Uses 4096 rows, or as
    many as `sampling` says, of two independent error vectors, A and B (Sobol points by default), and of A with one
    group from B: (groups + 2) evaluations per row, `chunk` rows at a time. First order by Saltelli et al. (2010), total
    by Jansen (1999); for the horizontal plane the sums over east and north (Lamboni et al. 2011; Gamboa et al. 2014).
    Intervals by bootstrap with `resamples` resamples of rows, or of the scrambles of Sobol points, at least 16. A row
    with an evaluation without a fix is excluded and counted. Raises as `sample`.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs)
    model.require_errors("sobol_indices")
    options: Any = resolve_sampling(sampling, SAMPLES, least=2, draws=SOBOL, chunk=CHUNK)
    count, draws, key = options.count, options.draws, options.random_key
    _check_request(options, confidence, resamples)
    plan = make_plan(inputs, inputs.nominal_fix(search), model)
    plan.nominal.require_fix(inputs)
    model.check_at(plan.nominal)
    names, members = groups_of(model, by_axis)
    push = lambda normals: offsets_of(plan, normals, search)  # noqa: E731
    offsets, found = evaluate(push, draws, key, members, count, options.chunk)
    kept = np.all(found, axis=0)
    estimate = sobol_estimate(
        *(offsets[0, kept], offsets[1, kept], offsets[2:, kept]),
        sums=SUMS, units=_units(count, draws)[kept], confidence=confidence, resamples=resamples,
        seed=np.asarray(jax.random.key_data(key)).tolist(),
    )  # fmt: skip
    return SobolIndices(names, estimate, count, 1.0 - float(np.mean(kept)), confidence)


def groups_of(model: ErrorModel, by_axis: bool) -> tuple[tuple[str, ...], np.ndarray]:
    """(group names, mask (groups, axes) of the error vector's axes in each)."""
    names, members = [], []
    for name, (source, place) in zip(source_names(model), model.parts(), strict=True):
        axes = np.arange(model.size)[place]
        independent = source.correlation is None and len(source.sigma_axes) == len(source.axes)
        split = by_axis and independent and len(axes) > 1
        names += [f"{name}: {axis}" for axis in source.axes] if split else [name]
        members += [[axis] for axis in axes] if split else [axes]
    return tuple(names), np.array([np.isin(np.arange(model.size), axes) for axes in members])


def sobol_estimate(
    base: np.ndarray,
    other: np.ndarray,
    mixed: np.ndarray,
    *,
    sums: np.ndarray | None = None,
    units: np.ndarray | None = None,
    confidence: float = 0.95,
    resamples: int = 500,
    seed: Any = 0,
) -> Estimate:
    """Sobol indices from values (rows, outputs) at A and B, and (groups, rows, outputs) at A with a group from B.

    `sums` (components, outputs) selects the outputs whose variances add up to each component (default: one each),
    `units` (rows,) numbers the independent units that the bootstrap resamples (default: every row). First order, mean
    of f(B) (f(AB) - f(A)): Saltelli et al. 2010, "Variance based sensitivity analysis of model output". Total, half the
    mean of (f(A) - f(AB))^2: Jansen 1999, "Analysis of variance designs for model output".
    """
    rows, outputs = base.shape
    sums = np.eye(outputs) if sums is None else sums
    if rows < 2:
        nothing = np.full((mixed.shape[0], sums.shape[0]), np.nan)
        return Estimate(nothing, nothing, nothing, nothing, np.full(sums.shape[0], np.nan))
    centre = 0.5 * (base.mean(axis=0) + other.mean(axis=0))
    a, b, m = base - centre, other - centre, mixed - centre
    parts = np.concatenate([(0.5 * (a + b))[None], (0.5 * (a**2 + b**2))[None], b * (m - a), 0.5 * (a - m) ** 2])
    table = parts.transpose(1, 0, 2).reshape(rows, -1)

    def indices(means: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        middle, square, *causes = means.reshape(-1, outputs)
        variance = sums @ (square - middle**2)
        shares = np.array(causes) @ sums.T / np.where(variance > 0.0, variance, np.nan)
        return shares[: len(shares) // 2], shares[len(shares) // 2 :], variance

    first, total, variance = indices(table.mean(axis=0))
    again = [indices(means)[:2] for means in _resample(table, units, resamples, seed)]
    independent = rows if units is None else len(np.unique(units))
    first_half, total_half = _half_width(confidence, independent) * np.std(again, axis=0)
    return Estimate(first, total, first_half, total_half, variance)


def _resample(table: np.ndarray, units: np.ndarray | None, resamples: int, seed: Any) -> Iterator[np.ndarray]:
    """Column means of a table over units resampled with replacement."""
    rng = np.random.default_rng(seed)
    sums, rows = table, np.ones(len(table))
    if units is not None:
        _, owner, rows = np.unique(units, return_inverse=True, return_counts=True)
        sums = np.zeros((len(rows), table.shape[1]))
        np.add.at(sums, owner, table)
    for _ in range(resamples):
        weight = np.bincount(rng.integers(len(rows), size=len(rows)), minlength=len(rows))
        yield weight @ sums / (weight @ rows)


def _half_width(confidence: float, units: int) -> float:
    """Half-width of Student's interval for `units` units, in bootstrap standard deviations."""
    student = float(scipy.special.stdtrit(units - 1, 0.5 * (1.0 + confidence)))
    return student * math.sqrt(units / (units - 1)) if units > 1 else math.nan


def _units(count: int, draws: AbstractDraws) -> np.ndarray:
    """Number of the independent unit of each row: its scramble for Sobol points, otherwise the row itself."""
    numbers = np.arange(count)
    return numbers % draws.scrambles if isinstance(draws, Sobol) else numbers


@quick_filter_jit
def make_plan(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Plan:
    """The model at an observation, with a factor that keeps sources and independent axes separate."""
    model = model.at(inputs, nominal)
    if model.is_normal:
        return Plan(inputs, nominal, model, model.factor())
    return Plan(inputs, nominal, model, None, model.roots())


@batch_filter_jit
def offsets_of(
    plan: Plan, normals: Normals, search: AbstractSearch
) -> tuple[Float[Array, "rows 3"], Bool[Array, " rows"]]:
    """(fix offsets in m for standard normal errors, whether there is a fix)."""

    def error_of(normal: Float[Array, " axes"]) -> Float[Array, " axes"]:
        if plan.factor is None:
            return plan.model.draw(plan.roots, normal)
        return jnp.sum(plan.factor * normal[None, :], axis=1)  # rounding of a matrix product depends on the batch

    places = places_of_ground(plan.model, plan.inputs)
    common = common_ground(plan.inputs, places)

    def some(normals: Normals) -> FixOffsets:
        lines = perturbed_lines(plan.model, plan.inputs, places, (error_of,), normals)
        return offsets_of_lines(plan.nominal, search, lines, common)

    offset, status = in_blocks(some, normals, block_size())
    return offset, counts_as_fix(status)


@eqx.filter_jit
def _draw(draws: AbstractDraws, key: Any, first: Array, rows: int, axes: int) -> tuple[Normals, Normals]:
    """A and B for `rows` rows from `first` on."""
    both = jax.vmap(lambda number: draws.standard_normal(key, number, 2 * axes))(first + jnp.arange(rows))
    return both[:, :axes], both[:, axes:]


def evaluate(
    push: Callable[[Normals], tuple[Array, Array]],
    draws: AbstractDraws,
    key: Any,
    members: np.ndarray,
    count: int,
    size: int,
) -> tuple[np.ndarray, np.ndarray]:
    """(fix offsets (groups + 2, rows, 3), whether there is a fix) for A, B, and A with each group from B.

    `push` computes both from standard normal errors, `size` rows at a time.
    """
    axes = members.shape[1]
    from_other = np.concatenate([np.zeros((1, axes), bool), np.ones((1, axes), bool), members])
    offsets, found = np.empty((len(from_other), count, 3)), np.empty((len(from_other), count), bool)
    for first in range(0, count, size):
        a, b = _draw(draws, key, jnp.asarray(first), size, axes)
        rows = slice(first, min(first + size, count))
        for number, from_b in enumerate(from_other):
            offset, fix = push(jnp.where(jnp.asarray(from_b)[None, :], b, a))
            offsets[number, rows] = offset[: rows.stop - first]
            found[number, rows] = fix[: rows.stop - first]
    return offsets, found


def _check_request(sampling: Sampling, confidence: Any, resamples: Any) -> None:
    """Raise `ValueError` for options that do not apply to indices; those of the sampling are checked by themselves."""
    if not isinstance(resamples, int | np.integer) or resamples < 2:
        raise ValueError(f"resamples must be a whole number of at least 2; got {resamples!r}.")
    if 0 < sampling.scrambles < LEAST_SCRAMBLES:
        raise ValueError(f"Sobol needs {LEAST_SCRAMBLES} scrambles or more for intervals; got {sampling.scrambles}.")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must lie between 0 and 1, such as 0.95; got {confidence!r}.")
    if sampling.half_width is not None or sampling.devices is not None:
        raise ValueError("half_width and devices are options of sample; indices take count, key, draws and chunk.")

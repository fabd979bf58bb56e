"""Monte Carlo propagation of errors through the forward model, in chunks of constant memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._locate import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.chunks import Drawn, Plan, Size, chunks, make_plan, one_ahead
from jaxgeo.uncertainty.draws import AbstractDraws
from jaxgeo.uncertainty.host_arrays import with_bar
from jaxgeo.uncertainty.intervals import (
    Interval,
    quantile_interval,
    relative_half_width,
    scramble_quantile,
    scrambled_interval,
)
from jaxgeo.uncertainty.method_selection import Method
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampling import Sampling, merge_sampling, resolve_sampling

SAMPLES = 10_000
FIGURES = ("CE", "LE", "SE")


class Quantile(NamedTuple):
    """Accuracy figure from samples, m: `value`, and its confidence interval from `low` to `high`.

    All samples count, those without a fix as infinitely far; infinite if too many fail. `conditional` is the figure of
    the samples with a fix only, and `share` their share.
    """

    value: float
    low: float
    high: float
    conditional: float
    share: float


class Sampled(Record):
    """Accuracy of a fix from samples.

    `found` of `count` samples have a fix; `statuses` counts all of them by status. `mean_enu` in m and `cov_enu` in m2
    are those of the samples with a fix. `errors_enu` (count, 3) in m, NaN without a fix, and the status `codes`
    (count,) are set with `keep`. Errors are relative to `centre_enu`: the nominal fix (0, 0, 0), or the mean.
    """

    fix: Fix
    count: int
    found: int
    statuses: dict[Status, int]
    mean_enu: np.ndarray
    cov_enu: np.ndarray
    centre_enu: np.ndarray
    radii: dict[str, np.ndarray]
    scrambles: int
    confidence: float
    errors_enu: np.ndarray | None = None
    codes: np.ndarray | None = None

    def circular_error(self, probability: float) -> Quantile:
        """Radius of the horizontal circle about the centre that contains this share of the samples."""
        return self._checked_quantile("CE", probability)

    def linear_error(self, probability: float) -> Quantile:
        """Half-height of the vertical interval about the centre that contains this share of the samples."""
        return self._checked_quantile("LE", probability)

    def spherical_error(self, probability: float) -> Quantile:
        """Radius of the sphere about the centre that contains this share of the samples."""
        return self._checked_quantile("SE", probability)

    @property
    def failed(self) -> float:
        """Share of the samples without a fix."""
        return 1.0 - self.found / self.count

    def _checked_quantile(self, figure: str, probability: float) -> Quantile:
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability must lie between 0 and 1; got {probability!r}.")
        if figure not in self.radii:
            kept = ", ".join(self.radii) or "none"
            raise ValueError(f"{figure} was not asked for; figures: {kept}. Sample again with it.")
        return self.quantile(figure, probability)

    def quantile(self, figure: str, probability: float) -> Quantile:
        """One of the figures "CE", "LE" and "SE", for arguments that are known to be valid."""
        radii = self.radii[figure]
        value, low, high = _interval(radii, probability, self.confidence, self.scrambles)
        known = radii if self.found == self.count else radii[np.isfinite(radii)]
        conditional = value if known is radii else (quantile_interval(known, probability)[0] if known.size else np.nan)
        return Quantile(float(value), float(low), float(high), float(conditional), self.found / self.count)


@accepts_observation
def sample(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    sampling: Sampling | None = None,
    key: Any = None,
    count: int | None = None,
    draws: AbstractDraws | None = None,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    about_mean: bool = False,
    figures: Sequence[str] = FIGURES,
    half_width: float | None = None,
    confidence: float | None = None,
    keep: bool = False,
    chunk: int | None = None,
    devices: Sequence[Any] | None = None,
    progress: bool = False,
) -> Sampled:
    """Monte Carlo errors of the fix that `locate` returns for the same arguments, from `count` samples (10 000).

    `key` is a `jax.random.key`. `key`, `count`, `draws`, `half_width`, `confidence`, `chunk`, `devices` and `progress`
    are the options of `Sampling`; give them here, or as `sampling`. Each of the `figures` "CE", "LE" and "SE" takes
    8 bytes per sample. `about_mean` measures errors about their mean and draws all samples twice; `keep` returns the
    samples. Raises as `propagate`, and `ValueError` for a count that is not positive, if there is no fix, or if `count`
    is not a multiple of the Sobol scrambles; `TypeError` for options given twice.
    """
    options = {"key": key, "count": count, "draws": draws, "half_width": half_width, "confidence": confidence}
    options |= {"chunk": chunk, "devices": devices, "progress": progress or None}
    given = {name: value for name, value in options.items() if value is not None}
    resolved = resolve_sampling(merge_sampling("sample", sampling, given), SAMPLES)
    unknown = [figure for figure in figures if figure not in FIGURES]
    if unknown:
        raise ValueError(f"figures are {', '.join(FIGURES)}; got {', '.join(map(str, unknown))}.")
    if resolved.half_width is not None and not figures:
        raise ValueError("half_width is that of the first of the figures; figures are empty.")
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs)
    nominal = inputs.nominal_fix(search)
    nominal.require_fix()
    return draw_errors(inputs, nominal, model, search, resolved, figures, about_mean=about_mean, keep=keep)


def draw_errors(
    inputs: ModelInputs,
    nominal: NominalFix,
    model: ErrorModel,
    search: AbstractSearch,
    sampling: Sampling,
    figures: Sequence[str] = FIGURES,
    *,
    about_mean: bool = False,
    keep: bool = False,
) -> Sampled:
    """`sample` of checked inputs, model and options, about a nominal fix."""
    options: Any = sampling
    devices = tuple(jax.devices() if sampling.devices is None else sampling.devices)
    size = Size.of(options.count, options.chunk, options.scrambles, devices)
    plan, size = make_plan(inputs, nominal, model, options.draws, search, options.random_key, size)
    centre = np.zeros(3)
    if about_mean:
        centre = _gather(plan, size, dataclasses.replace(sampling, half_width=None), (), False, centre).mean_enu
    return _gather(plan, size, sampling, tuple(figures), keep, centre)


def sample_where_needed(
    method: np.ndarray,
    radii: Sequence[np.ndarray],
    observation_at: Callable[[int], tuple[ModelInputs, NominalFix, ErrorModel]],
    search: AbstractSearch,
    sampling: Sampling,
    probability: float,
) -> tuple[np.ndarray, ...]:
    """(circular, linear, spherical error, share of failed samples) of many fixes, by samples where `method` says so.

    `radii` are the first three from linear propagation; `observation_at` gives the observation of an index.
    """
    columns = (*map(np.array, radii), np.full(method.shape, np.nan))
    index = np.flatnonzero(method == Method.samples)
    if not sampling.count or not index.size:
        return columns
    quiet = dataclasses.replace(sampling, progress=False)
    for number in with_bar(index.tolist(), index.size, "sampling", sampling.progress):
        inputs, nominal, model = observation_at(number)
        found = draw_errors(inputs, nominal, model, search, quiet)
        values = (*(found.quantile(figure, probability).value for figure in FIGURES), found.failed)
        for column, value in zip(columns, values, strict=True):
            column[number] = value
    return columns


def _gather(plan: Plan, size: Size, sampling: Any, figures: tuple[str, ...], keep: bool, centre: np.ndarray) -> Sampled:
    """Draw all chunks and collect the requested results."""
    tally = _Tally(sampling.count, figures, keep)
    unit, width = max(sampling.scrambles, 1), sampling.half_width
    parts = chunks(sampling.count, min(sampling.chunk, size.capacity * len(size.devices)), unit, sampling.progress)
    for first, count, drawn in one_ahead(plan, parts, jnp.asarray(centre), size, keep):
        tally.add(first, count, drawn)
        if width is not None and tally.is_sharp(width, sampling.confidence, sampling.scrambles):
            break
    return tally.result(plan.fixes.nominal.fix, centre, sampling.scrambles, sampling.confidence)


class _Tally:
    """Results accumulated over chunks: sums, statuses, radii, and samples if requested."""

    def __init__(self, count: int, figures: tuple[str, ...], keep: bool) -> None:
        self.count, self.found = 0, 0
        self.checked_at = 0
        self.sum, self.squares = np.zeros(3), np.zeros((3, 3))
        self.codes = np.zeros(len(Status), int)
        self.radii = {figure: np.empty(count) for figure in figures}
        self.kept = (np.empty((count, 3)), np.empty(count, np.int8)) if keep else None

    def add(self, first: int, count: int, drawn: Drawn) -> None:
        drawn = drawn.of_samples(count)
        place = slice(first, first + count)
        self.count += count
        moments = drawn.moments.sum(axis=0)
        self.found += round(float(moments[3, 3]))
        self.sum += moments[:3, 3]
        self.squares += moments[:3, :3]
        if np.any(drawn.statuses):
            self.codes += np.bincount(drawn.statuses, minlength=len(Status))
        else:  # all `hit`, the usual case: faster than bincount
            self.codes[Status.hit] += count
        for figure, kept in self.radii.items():
            kept[place] = drawn.radii[FIGURES.index(figure)]
        if self.kept is not None:
            self.kept[0][place], self.kept[1][place] = drawn.errors, drawn.statuses

    def is_sharp(self, half_width: float, confidence: float, scrambles: int) -> bool:
        """Whether the first figure's interval at 90 % is narrow enough; checked after every 25 % more samples."""
        if self.count < 1.25 * self.checked_at:
            return False
        self.checked_at = self.count
        radii = next(iter(self.radii.values()))[: self.count]
        return relative_half_width(_interval(radii, 0.9, confidence, scrambles)) <= half_width

    def result(self, fix: Fix, centre: np.ndarray, scrambles: int, confidence: float) -> Sampled:
        mean = self.sum / self.found if self.found else np.full(3, np.nan)
        fewer = max(self.found - 1, 1)
        cov = (self.squares - self.found * np.outer(mean, mean)) / fewer if self.found > 1 else np.full((3, 3), np.nan)
        kept = (None, None) if self.kept is None else tuple(part[: self.count] for part in self.kept)
        return Sampled(
            fix=fix,
            count=self.count,
            found=self.found,
            statuses={Status(code): int(number) for code, number in enumerate(self.codes) if number},
            mean_enu=mean + centre,
            cov_enu=cov,
            centre_enu=centre,
            radii={figure: radii[: self.count] for figure, radii in self.radii.items()},
            scrambles=scrambles,
            confidence=confidence,
            errors_enu=kept[0],
            codes=kept[1],
        )


def _interval(radii: np.ndarray, probability: float, confidence: float, scrambles: int) -> Interval:
    """Quantile and its confidence interval, from independent draws or from independent scrambles."""
    if not scrambles:
        return quantile_interval(radii, probability, confidence)
    each = [scramble_quantile(radii[number::scrambles], probability) for number in range(scrambles)]
    return scrambled_interval(np.array(each), confidence)

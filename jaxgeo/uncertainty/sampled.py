"""Monte Carlo propagation of errors through the forward model, in chunks of constant memory."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._accelerator import by_device
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._second_order import Moments, axis_moments, moments_of_points, sigma_moments, sigma_points_of
from jaxgeo.uncertainty.chunks import (
    Drawn,
    Plan,
    Size,
    blocks_per_device,
    chunks,
    fixes_of_points,
    make_plan,
    one_ahead,
)
from jaxgeo.uncertainty.device_counts import DeviceCounts
from jaxgeo.uncertainty.draws import AbstractDraws
from jaxgeo.uncertainty.histogram import Counter, RadiusHistogram
from jaxgeo.uncertainty.host_arrays import with_bar
from jaxgeo.uncertainty.intervals import relative_half_width
from jaxgeo.uncertainty.method_selection import Method
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.origin import Origin
from jaxgeo.uncertainty.processes import TIMEOUT, check_timeout, drawn_together, until_sharp
from jaxgeo.uncertainty.sampled_record import Quantile as Quantile
from jaxgeo.uncertainty.sampled_record import Sampled, SampleRun, interval_of_radii, moments_of
from jaxgeo.uncertainty.sampling import Sampling, check_numbers, merge_sampling, refuse_traced, resolve_sampling

SAMPLES = 10_000
FIGURES = ("CE", "LE", "SE")


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
    summary: bool = False,
    first: int = 0,
    chunk: int | None = None,
    devices: Sequence[Any] | None = None,
    progress: bool = False,
    timeout: float = TIMEOUT,
) -> Sampled:
    """Monte Carlo errors of the fix that `locate` returns for the same arguments, from `count` samples (10 000).

    `key` is a `jax.random.key`. `key`, `count`, `draws`, `half_width`, `confidence`, `chunk`, `devices` and `progress`
    are the options of `Sampling`; give them here, or as `sampling`. Each of the `figures` "CE", "LE" and "SE" takes
    8 bytes per sample. `about_mean` measures errors about their mean and draws all samples twice; `keep` returns the
    samples.

    - Parts: samples `first` to `first + count - 1` of the key are drawn, the same ones to the last digit whatever the
      part and the chunk, so that `sample(..., count=100).merge(sample(..., first=100, count=100))` is
      `sample(..., count=200)`. They may differ by rounding, 1e-8 m, between numbers of devices, and between calls for
      up to 67 840 samples per device and for more, which have programs of their own.
    - `summary` keeps counts of radii in bins in place of the radii: memory is constant, and quantiles are off by less
      than 0.0061 % (see `RadiusHistogram`).
    - Several processes of `jax.distributed` share the samples, unless `devices` are given: each draws a part on its
      own devices, and all return the whole. All call `sample` with the same arguments. If another process fails, or
      does not deliver its part within `timeout` seconds after this one has drawn its own, `RuntimeError` is raised.

    Raises as `propagate`, and `ValueError` for a count that is not positive, or if there is no fix; `TypeError` for
    options given twice, and under `jit`, `vmap` and derivatives, where `error_samples` serves.
    """
    options = {"key": key, "count": count, "draws": draws, "half_width": half_width, "confidence": confidence}
    options |= {"chunk": chunk, "devices": devices, "progress": progress or None}
    given = {name: value for name, value in options.items() if value is not None}
    merged_options = merge_sampling("sample", sampling, given)
    refuse_traced("sample", (sensor, shot, uv, terrain, errors, time, atmosphere, given, first))
    resolved = resolve_sampling(merged_options, SAMPLES)
    first = check_numbers(first, resolved)
    unknown = [figure for figure in figures if figure not in FIGURES]
    if unknown:
        raise ValueError(f"figures are {', '.join(FIGURES)}; got {', '.join(map(str, unknown))}.")
    if resolved.half_width is not None and not figures:
        raise ValueError("half_width is that of the first of the figures; figures are empty.")
    if keep and summary:
        raise ValueError("keep returns every sample, and summary none; leave one of them out.")
    timeout = check_timeout(timeout)
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs, moments=0)
    nominal = inputs.nominal_fix(search)
    refuse_traced("sample", nominal)  # inside of jit, if all arguments are constants of its program
    nominal.require_fix(inputs)
    model.check_at(nominal)
    wanted = Wanted(tuple(figures), keep, summary)
    is_shared = resolved.devices is None and jax.process_count() > 1
    draw = _draw_together if is_shared else _draw
    return draw(Sampler.of(inputs, nominal, model, search, resolved), wanted, first, about_mean, timeout)


class Wanted(NamedTuple):
    """What is collected of samples: the radii of some figures, each sample, or a summary of the radii."""

    figures: tuple[str, ...] = FIGURES
    keep: bool = False
    summary: bool = False


def draw_errors(
    inputs: ModelInputs,
    nominal: NominalFix,
    model: ErrorModel,
    search: AbstractSearch,
    sampling: Sampling,
    *,
    keep: bool = False,
) -> Sampled:
    """`sample` of checked inputs, model and options, about a nominal fix, by this process alone."""
    return Sampler.of(inputs, nominal, model, search, sampling).drawn(keep=keep)


class Sampler(NamedTuple):
    """A sampling that is ready to draw: plan and size of its programs, options, and values that identify it."""

    plan: Plan
    size: Size
    options: Any
    values: dict[str, Any]

    @classmethod
    def of(
        cls, inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, search: AbstractSearch, sampling: Any
    ) -> Sampler:
        devices = tuple(jax.local_devices() if sampling.devices is None else sampling.devices)
        size = Size.of(sampling.count, sampling.chunk, devices)
        key = sampling.random_key
        plan, size = make_plan(inputs, nominal, model, sampling.draws, search, key, size)
        values = {"sensor": inputs.sensor, "shot": inputs.motion, "time": inputs.time, "uv": inputs.uv}
        values |= {"terrain": inputs.terrain, "atmosphere": inputs.air, "errors": model, "search": search}
        return cls(plan, size, sampling, values | {"draws": sampling.draws, "key": key})

    def drawn(self, *, keep: bool) -> Sampled:
        """All samples, drawn by this process alone."""
        return _draw(self, Wanted(keep=keep))

    def moments_of_sigma_points(self) -> Moments:
        """`sigma_points`, whose fixes are found by the program of the samples."""
        inputs, model = self.plan.lines.inputs, self.plan.lines.model
        nominal = self.plan.fixes.nominal
        order = axis_moments(model)
        fixes = fixes_of_points(self.plan, sigma_points_of(model.size, order), self.size)
        if fixes is None:
            return sigma_moments(inputs, nominal, model, self.values["search"])
        offsets, statuses = map(jnp.asarray, fixes)
        return moments_of_points(nominal, offsets, statuses, order)

    def draw(
        self, first: int, count: int, wanted: Wanted, centre: np.ndarray, half_width: float | None = None
    ) -> Sampled:
        """Samples from number `first` on, until the first figure is known to `half_width`."""
        options = self.options
        tally = _Tally(first, count, options.scrambles, wanted, self.size)
        parts = chunks(first, count, self.size, options.progress)
        for start, number, drawn in one_ahead(self.plan, parts, jax.device_put(centre), self.size, wanted.keep):
            tally.add(start, number, drawn)
            if half_width is not None and tally.is_sharp(half_width, options.confidence):
                break
        origin = Origin(**self.values, centre_enu=centre)
        found = tally.result(self.plan.fixes.nominal.fix, centre, options.confidence, origin)
        return found.without_rounding() if self.plan.lines.model.is_exact else found


def _draw(
    sampler: Sampler, wanted: Wanted, first: int = 0, about_mean: bool = False, timeout: float = TIMEOUT
) -> Sampled:
    """Samples that this process draws alone."""
    count, centre = sampler.options.count, np.zeros(3)
    if about_mean:
        centre = sampler.draw(first, count, Wanted(()), centre).mean_enu
    return sampler.draw(first, count, wanted, centre, sampler.options.half_width)


def _draw_together(sampler: Sampler, wanted: Wanted, first: int, about_mean: bool, timeout: float) -> Sampled:
    """Samples that all processes of `jax.distributed` draw, each its part."""
    options, size = sampler.options, sampler.size

    def draw(wanted: Wanted, centre: np.ndarray, first: int, count: int) -> Sampled:
        own = lambda first, count: sampler.draw(first, count, wanted, centre)  # noqa: E731
        return drawn_together(own, first, count, timeout)

    centre = np.zeros(3)
    if about_mean:
        centre = draw(Wanted(()), centre, first, options.count).mean_enu
    if options.half_width is None:
        return draw(wanted, centre, first, options.count)
    step = size.capacity * len(size.devices) * jax.process_count()
    return until_sharp(functools.partial(draw, wanted, centre), first, options, step)


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


class _Tally:
    """Results accumulated over chunks of a run: sums, statuses, radii or their counts, and samples if requested."""

    def __init__(self, first: int, count: int, scrambles: int, wanted: Wanted, size: Size) -> None:
        self.first, self.count, self.scrambles, self.size = first, 0, scrambles, size
        self.checked_at = 0
        self.sums = np.zeros((4, 4))
        self.codes = np.zeros(len(Status), int)
        groups = max(scrambles, 1)
        self.figures = wanted.figures
        is_on_device = wanted.summary and by_device(False, True, size.devices)
        radii = [FIGURES.index(figure) for figure in wanted.figures]
        self.on_device = DeviceCounts(radii, groups, size) if is_on_device else None
        is_counted = wanted.summary and not is_on_device
        self.counters = {figure: Counter(groups) for figure in wanted.figures} if is_counted else None
        self.radii = {} if wanted.summary else {figure: np.empty(count) for figure in wanted.figures}
        self.kept = (np.empty((count, 3)), np.empty(count, np.int8)) if wanted.keep else None

    def add(self, first: int, count: int, drawn: Drawn) -> None:
        if self.on_device is not None:
            share = self.size.block * blocks_per_device(first, count, self.size)
            self.on_device.add(first, count, share, drawn)
            self.count += count
            self.sums += np.asarray(drawn.moments).sum(axis=0)
            return
        drawn = drawn.of_samples(first, count, self.size)
        place = slice(first - self.first, first - self.first + count)
        self.count += count
        self.sums += drawn.moments.sum(axis=0)
        if np.any(drawn.statuses):
            self.codes += np.bincount(drawn.statuses, minlength=len(Status))
        else:  # all `hit`, the usual case: faster than bincount
            self.codes[Status.hit] += count
        for figure, kept in self.radii.items():
            kept[place] = drawn.radii[FIGURES.index(figure)]
        for figure, counter in (self.counters or {}).items():
            counter.add(np.asarray(drawn.radii[FIGURES.index(figure)]), first)
        if self.kept is not None:
            self.kept[0][place], self.kept[1][place] = drawn.errors, drawn.statuses

    def is_sharp(self, half_width: float, confidence: float) -> bool:
        """Whether the first figure's interval at 90 % is narrow enough; checked after every 25 % more samples."""
        if self.count < 1.25 * self.checked_at:
            return False
        self.checked_at = self.count
        histograms = self.histograms(self.figures[:1])
        if histograms is not None:
            interval = histograms[self.figures[0]].interval(0.9, confidence)
        else:
            radii = next(iter(self.radii.values()))[: self.count]
            interval = interval_of_radii(radii, 0.9, confidence, self.scrambles)
        return relative_half_width(interval) <= half_width

    def histograms(self, figures: Sequence[str]) -> dict[str, RadiusHistogram] | None:
        """Histograms of some figures so far; None if the radii are kept."""
        if self.on_device is not None:
            found = dict(zip(self.figures, self.on_device.histograms(), strict=True))
            return {figure: found[figure] for figure in figures}
        return None if self.counters is None else {figure: self.counters[figure].histogram() for figure in figures}

    def result(self, fix: Fix, centre: np.ndarray, confidence: float, origin: Origin) -> Sampled:
        runs = (SampleRun(self.first, self.count, self.sums),)
        found, mean, cov = moments_of(runs, centre)
        kept = (None, None) if self.kept is None else tuple(part[: self.count] for part in self.kept)
        codes = self.codes if self.on_device is None else self.on_device.codes()
        return Sampled(
            fix=fix,
            count=self.count,
            found=found,
            statuses={Status(code): int(number) for code, number in enumerate(codes) if number},
            mean_enu=mean,
            cov_enu=cov,
            centre_enu=centre,
            radii={figure: radii[: self.count] for figure, radii in self.radii.items()},
            scrambles=self.scrambles,
            confidence=confidence,
            errors_enu=kept[0],
            codes=kept[1],
            histograms=self.histograms(self.figures),
            runs=runs,
            origin=origin,
        )

"""Monte Carlo propagation of errors through the forward model, in chunks of constant memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import check_countable
from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.batched_rays import PART
from jaxgeo.uncertainty.chunks import Drawn, Plan, chunks, one_ahead, planned
from jaxgeo.uncertainty.draws import MORE, AbstractDraws, Random, Sobol
from jaxgeo.uncertainty.intervals import (
    Interval,
    quantile_interval,
    relative_half_width,
    scramble_quantile,
    scrambled_interval,
)
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

CHUNK = 62 * PART  # four chunks make about a million samples; no padding on one, two or four devices
BETWEEN_LOOKS = 12 * PART  # samples, at most, between checks of `half_width`
RANDOM = Random()
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
        return self._quantile("CE", probability)

    def linear_error(self, probability: float) -> Quantile:
        """Half-height of the vertical interval about the centre that contains this share of the samples."""
        return self._quantile("LE", probability)

    def spherical_error(self, probability: float) -> Quantile:
        """Radius of the sphere about the centre that contains this share of the samples."""
        return self._quantile("SE", probability)

    def _quantile(self, figure: str, probability: float) -> Quantile:
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability must lie between 0 and 1; got {probability!r}.")
        if figure not in self.radii:
            kept = ", ".join(self.radii) or "none"
            raise ValueError(f"{figure} was not asked for; figures: {kept}. Sample again with it.")
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
    key: Any,
    count: int = 10_000,
    draws: AbstractDraws = RANDOM,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    about_mean: bool = False,
    figures: Sequence[str] = FIGURES,
    half_width: float | None = None,
    confidence: float = 0.95,
    keep: bool = False,
    chunk: int = CHUNK,
    devices: Sequence[Any] | None = None,
    progress: bool = False,
) -> Sampled:
    """Monte Carlo errors of the fix that `locate` returns for the same arguments, from `count` samples.

    `key` is a `jax.random.key`; up to rounding (about 1e-8 m) a sample depends on the key and its index only, not on
    `chunk` (samples at a time, which bounds the memory) or `devices` (default: all JAX devices). `draws` is `Random()`
    or `Sobol()`, whose points are rotated so that the directions that displace the fix most come first. Each of the
    `figures` "CE", "LE" and "SE" takes 8 bytes per sample. With a `half_width`, sampling stops when the confidence
    interval of the first figure at 90 % is within that fraction of it on either side (JCGM 101:2008, 7.9), or at
    `count` samples. `about_mean` measures errors about their mean and draws all samples twice; `keep` returns the
    samples. Raises as `propagate`, and `ValueError` for a count that is not positive, if there is no fix, or if `count`
    is not a multiple of the Sobol scrambles.
    """
    look = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    given = (key, count, draws, about_mean, figures, half_width, confidence, keep, chunk, devices, progress)
    return sampled_at(look, checked_model(errors, look), search, Sampling(*given))


class Sampling(NamedTuple):
    """Sampling options: see `sample`."""

    key: Any
    count: int
    draws: AbstractDraws = RANDOM
    about_mean: bool = False
    figures: Sequence[str] = FIGURES
    half_width: float | None = None
    confidence: float = 0.95
    keep: bool = False
    chunk: int = CHUNK
    devices: Sequence[Any] | None = None
    progress: bool = False

    @property
    def scrambles(self) -> int:
        """Number of Sobol scrambles; 0 for independent draws."""
        return self.draws.scrambles if isinstance(self.draws, Sobol) else 0

    def check(self) -> None:
        """Raise `ValueError` or `TypeError` for invalid options."""
        for value, name in ((self.count, "count"), (self.chunk, "chunk")):
            if not isinstance(value, int | np.integer) or value < 1:
                raise ValueError(f"{name} must be a whole number of samples, 1 or more; got {value!r}.")
        check_countable(int(self.count), f"{self.count} samples", MORE)
        if not isinstance(self.key, jax.Array):
            raise TypeError(f"key must be one of jax.random.key(seed); got {self.key!r}.")
        devices = self.devices
        if devices is not None and not (len(devices) and all(isinstance(one, jax.Device) for one in devices)):
            raise ValueError(f"devices must be some of jax.devices(), or None for all of them; got {devices!r}.")
        if not isinstance(self.draws, AbstractDraws):
            raise TypeError(f"draws must be Random() or Sobol(); got {type(self.draws).__name__}.")
        if self.scrambles and self.count % self.scrambles:
            raise ValueError(f"count must be a multiple of the {self.scrambles} scrambles of Sobol; got {self.count}.")
        unknown = [figure for figure in self.figures if figure not in FIGURES]
        if unknown:
            raise ValueError(f"figures are {', '.join(FIGURES)}; got {', '.join(map(str, unknown))}.")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence must lie between 0 and 1; got {self.confidence!r}.")
        width = self.half_width
        if width is not None and (not width > 0.0 or not self.figures):
            raise ValueError(f"half_width must be a positive share of the first of the figures; got {width!r}.")


def sampled_at(
    look: ModelInputs, model: ErrorModel, search: AbstractSearch, sampling: Sampling, aim: NominalFix | None = None
) -> Sampled:
    """`sample` of checked inputs and model; `aim` is the nominal fix, if already computed."""
    sampling.check()
    aim = look.nominal_fix(search) if aim is None else aim
    aim.require_fix()
    plan = planned(look, aim, model, sampling.draws, search, sampling.key)
    centre = np.zeros(3)
    if sampling.about_mean:
        centre = _gather(plan, sampling._replace(figures=(), half_width=None, keep=False), centre).mean_enu
    return _gather(plan, sampling, centre)


def _gather(plan: Plan, sampling: Sampling, centre: np.ndarray) -> Sampled:
    """Draw all chunks and collect the requested results."""
    devices = tuple(jax.devices() if sampling.devices is None else sampling.devices)
    tally = _Tally(sampling.count, tuple(sampling.figures), sampling.keep)
    unit = max(sampling.scrambles, 1)
    chunk = sampling.chunk if sampling.half_width is None else min(sampling.chunk, BETWEEN_LOOKS)
    parts = chunks(sampling.count, chunk, len(devices), unit, sampling.progress)
    for first, size, drawn in one_ahead(plan, parts, jnp.asarray(centre), devices, sampling.keep):
        tally.add(first, size, drawn)
        width = sampling.half_width
        if width is not None and tally.is_sharp(width, sampling.confidence, sampling.scrambles):
            break
    return tally.result(plan.aim.fix, centre, sampling.scrambles, sampling.confidence)


class _Tally:
    """Results accumulated over chunks: sums, statuses, radii, and samples if requested."""

    def __init__(self, count: int, figures: tuple[str, ...], keep: bool) -> None:
        self.count, self.found = 0, 0
        self.checked_at = 0
        self.sum, self.squares = np.zeros(3), np.zeros((3, 3))
        self.codes = np.zeros(len(Status), int)
        self.radii = {figure: np.empty(count) for figure in figures}
        self.kept = (np.empty((count, 3)), np.empty(count, np.int8)) if keep else None

    def add(self, first: int, size: int, drawn: Drawn) -> None:
        statuses = np.asarray(drawn.statuses)[:size]
        self.count += size
        moments = np.asarray(drawn.moments).sum(axis=0)
        self.found += round(moments[3, 3])
        self.sum += moments[:3, 3]
        self.squares += moments[:3, :3]
        if np.any(statuses):
            self.codes += np.bincount(statuses, minlength=len(Status))
        else:  # all `hit`, the usual case: faster than bincount
            self.codes[Status.hit] += size
        for figure, kept in self.radii.items():
            kept[first : first + size] = np.asarray(drawn.radii[FIGURES.index(figure)])[:size]
        if self.kept is not None:
            for all_, some in zip(self.kept, (drawn.errors, drawn.statuses), strict=True):
                all_[first : first + size] = np.asarray(some)[:size]

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

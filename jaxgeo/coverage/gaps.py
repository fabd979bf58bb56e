"""Gap probability of a strip, its sensitivity to each noise source, and the overlap required to avoid gaps."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its submodules on demand
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Bool, Float, Int8

from jaxgeo._checks import check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo._record import Record, has_numbers
from jaxgeo._typing import Scalar
from jaxgeo.coverage.exposure import end_places
from jaxgeo.coverage.flight import SPECS, Compensation, FlightNoise, Strip, flown, normals_of, shots_of, specs_of
from jaxgeo.status import Status
from jaxgeo.uncertainty._accuracy import accuracy
from jaxgeo.uncertainty.draws import Random
from jaxgeo.uncertainty.method_selection import Method
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources import Attitude, GimbalAngles, Position

CHUNK = 512  # flights at a time
LATTICE = 4096  # points of the orthant integral of a normal distribution
NUGGET = 1e-10  # share of the largest variance added to all, so that the covariance of dependent margins is regular
LEAST, MOST = 0.0, 0.95  # range of overlaps searched for a plan
FEWEST_GAPS = 5  # flights with a gap required to support a quantile
CLOSE = 1e-4  # tolerance of the overlap

Derivatives = dict[str, tuple[float, float]]


class Flights(Record):
    """Sampled flights of a strip: overlaps of consecutive images (flights, images - 1), see `Overlap`.

    `gap` states whether any ground along the strip is left out (also where an image sees no ground, or none beside that
    of the one before). `squares` are sums of squares of the normal numbers of each standard deviation in `SPECS`.
    """

    near: Float[Array, "flights pairs"]
    far: Float[Array, "flights pairs"]
    least: Float[Array, "flights pairs"]
    status: Int8[Array, "flights pairs"]
    squares: Float[Array, "flights specs"]
    strip: Strip
    noise: FlightNoise

    @property
    def gap(self) -> Bool[Array, "flights pairs"]:
        """Whether a pair of images leaves a gap."""
        return ~(self.least >= 0.0)

    @property
    def gap_of_strip(self) -> Bool[Array, " flights"]:
        """Whether a flight leaves any gap."""
        return jnp.any(self.gap, axis=1)

    def gap_probability(self, confidence: float = 0.95) -> tuple[float, tuple[float, float]]:
        """Share of flights with a gap, and its confidence interval (Clopper and Pearson 1934)."""
        bad = np.asarray(self.gap_of_strip)
        interval = scipy.stats.binomtest(int(bad.sum()), bad.size).proportion_ci(confidence, "exact")
        return float(bad.mean()), (float(interval.low), float(interval.high))

    def gap_derivatives(self) -> Derivatives:
        """d P(gap) / d sigma, with its standard error, for each standard deviation that is not zero.

        By the score of the normal density: no new flights, no assumption on the terrain. The unit is one over that of
        the standard deviation (rad, m, m/s, s).
        """
        bad = np.asarray(self.gap_of_strip, float)
        counts = np.bincount(specs_of(self.strip), minlength=len(SPECS))
        sigmas, found = np.asarray(self.noise.sigmas), {}
        for k, name in enumerate(SPECS):
            if sigmas[k] > 0.0:
                terms = (bad - bad.mean()) * (np.asarray(self.squares)[:, k] - counts[k]) / sigmas[k]
                found[name] = float(terms.mean()), float(terms.std(ddof=1) / math.sqrt(terms.size))
        return found


class LinearGaps(Record):
    """Gap probability by linear propagation about the planned flight.

    `margins` (4 pairs,) are the overlaps there at the near ends, then at the far ends, then the distances by which each
    image's far end is beyond the other's near end (`Overlap.sideways`); `cov` (specs, 4 pairs, 4 pairs) are the
    contributions of the standard deviations in `SPECS` to their covariance; `free` is the probability of a strip
    without gaps, `of_pair` the probabilities of a gap at each pair's near end.
    """

    margins: Float[Array, " ends"]
    cov: Float[Array, "specs ends ends"]
    free: Scalar
    of_pair: Float[Array, " pairs"]
    slopes: Float[Array, " specs"]
    noise: FlightNoise

    def __repr__(self) -> str:
        """Probability of a gap in the strip, and the pair where it is largest; fields if they are traced."""
        if not has_numbers(self.free, self.of_pair) or np.ndim(self.of_pair) != 1:
            return super().__repr__()
        each = np.asarray(self.of_pair)
        worst = int(np.argmax(each))
        return (
            f"LinearGaps(probability of a gap {self.gap_probability:.4g} in {len(each)} pairs, largest at pair "
            f"{worst}: {each[worst]:.4g})"
        )

    @property
    def gap_probability(self) -> float:
        """Probability of a strip with a gap."""
        return 1.0 - float(self.free)

    def gap_derivatives(self) -> dict[str, float]:
        """d P(gap) / d sigma for each standard deviation that is not zero (1/rad, 1/m, s/m, 1/s)."""
        sigmas = np.asarray(self.noise.sigmas)
        slopes = np.asarray(self.slopes).tolist()
        return {name: -slopes[k] / sigmas[k] for k, name in enumerate(SPECS) if sigmas[k] > 0.0}


def fly(
    strip: Strip,
    noise: FlightNoise,
    *,
    key: Any,
    flights: int = 2000,
    compensation: Compensation = Compensation(),
) -> Flights:
    """Sampled flights of a strip with noise; reproducible for a key and a flight number.

    Raises `ValueError` for fewer than two flights.
    """
    if flights < 2:
        raise ValueError(f"flights must be at least 2; got {flights}.")
    check_is(strip, Strip, "strip")
    check_is(noise, FlightNoise, "noise")
    parts = []
    for first in range(0, flights, CHUNK):
        overlaps = _flown(strip, noise, key, first + jnp.arange(CHUNK), compensation)
        parts.append(jax.tree.map(lambda x, count=min(CHUNK, flights - first): np.asarray(x)[:count], overlaps))
    near, far, least, status, squares = jax.tree.map(lambda *leaves: jnp.asarray(np.concatenate(leaves)), *parts)
    return Flights(near, far, least, status, squares, strip, noise)


def linear_gaps(strip: Strip, noise: FlightNoise, *, compensation: Compensation = Compensation()) -> LinearGaps:
    """Gap probability from the derivatives of all overlaps about the planned flight.

    The overlaps at the near and far ends, and the sideways margins, are treated as jointly normal; the probability that
    all are positive is Genz's (1992) integral on a lattice. `linear_is_valid` checks whether linearisation is valid on
    the terrain. Raises `ValueError` where the planned flight sees no ground.
    """
    margins, cov = _ends_of(strip, noise, compensation)
    free, slopes = _free_with_slopes(margins, cov)
    pairs = strip.images - 1
    spread = np.sqrt(np.diagonal(np.sum(cov, axis=0)))[:pairs]
    of_pair = scipy.special.ndtr(-np.asarray(margins)[:pairs] / np.where(spread > 0.0, spread, 1e-12))
    return LinearGaps(margins, cov, free, jnp.asarray(of_pair), slopes, noise)


def linear_is_valid(
    strip: Strip, noise: FlightNoise, *, compensation: Compensation = Compensation()
) -> Bool[Array, "images ends"]:
    """Whether linear propagation is valid at the ends (near and far, in either order) of all planned images.

    By the test of `accuracy` on the fixes there, with the noise as errors of attitude, position and gimbal.
    """
    noise_free = eqx.tree_at(lambda n: [getattr(n, name) for name in SPECS], noise, [jnp.zeros(())] * len(SPECS))
    shots = _shots_as_planned(strip, noise_free)
    c, s = jnp.cos(strip.course), jnp.sin(strip.course)
    along = jnp.hypot(noise.speed * strip.period, noise.timing * strip.speed)
    north, east = jnp.hypot(c * along, s * noise.across), jnp.hypot(s * along, c * noise.across)
    position = Position.from_ned(north=north, east=east, down=noise.height)
    gimbal = GimbalAngles.of(strip.sensor.gimbal, noise.gimbal)
    attitude = Attitude(jnp.stack([noise.heading, noise.pitch, noise.roll]))
    errors = ErrorModel((position, gimbal) if np.all(compensation.attitude) else (attitude, position, gimbal))

    def trusted(shot: Any, uv: Any) -> Any:
        found = accuracy(strip.sensor, shot, uv, strip.terrain, errors, sampling=None, atmosphere=strip.air)
        return (found.method == Method.facet) | (found.method == Method.footprint)

    ends = jnp.clip(end_places(strip.sensor, strip.along), 0.0, None)
    over_ends = jax.vmap(trusted, (None, 0))
    return eqx.filter_jit(jax.vmap(over_ends, (0, None)))(shots, ends)


def required_overlap(
    strip: Strip,
    noise: FlightNoise,
    *,
    free: float = 0.99,
    compensation: Compensation = Compensation(),
    key: Any = None,
    flights: int = 2000,
) -> float:
    """Overlap to plan so that a share `free` of strips has no gap: from samples with a `key`, linearly without one.

    The margin is that overlap itself: without noise none would be needed. Raises `ValueError` for a share outside
    (0, 1), and where not even an overlap of 0.95 is enough.
    """
    if not 0.0 < free < 1.0:
        raise ValueError(f"free must lie in (0, 1), a share of strips without a gap; got {free}.")
    if key is not None and flights * (1.0 - free) < FEWEST_GAPS:
        raise ValueError(
            f"{flights} flights say too little of {free:.9g}: of them at least {FEWEST_GAPS} should have a gap. Fly "
            f"{math.ceil(FEWEST_GAPS / (1.0 - free))} or more."
        )

    def short(overlap: float) -> float:
        """Positive where the overlap is sufficient; continuous, unlike a share of flights."""
        there = strip.with_overlap(overlap)
        if key is None:
            return float(_free(*_ends_of(there, noise, compensation))) - free
        sampled = fly(there, noise, key=key, flights=flights, compensation=compensation)
        worst = np.where(np.isnan(sampled.least), -np.inf, sampled.least).min(axis=1)
        return float(np.clip(np.quantile(worst, 1.0 - free, method="lower"), -1e3, None))

    if short(MOST) < 0.0:
        raise ValueError(
            f"not even an overlap of {MOST} leaves {free:.1%} of the strips without a gap: make the noise smaller, or "
            "compensate for more of it."
        )
    if short(LEAST) >= 0.0:
        return LEAST
    return float(scipy.optimize.brentq(short, LEAST, MOST, xtol=CLOSE))  # pyright: ignore[reportArgumentType]


@quick_filter_jit
def _flown(strip: Strip, noise: FlightNoise, key: Any, numbers: Any, compensation: Compensation) -> Any:
    size, spec = normals_of(strip), jnp.asarray(specs_of(strip))

    def one(number: Any) -> Any:
        normals = Random().standard_normal(key, number, size)
        overlap = flown(strip, noise, normals, compensation)
        squares = jnp.zeros(len(SPECS)).at[spec].add(normals * normals)
        return overlap.near, overlap.far, overlap.least, overlap.status, squares

    return jax.vmap(one)(numbers)


def _ends_of(strip: Strip, noise: FlightNoise, compensation: Compensation) -> tuple[Any, Any]:
    """(margins, covariance by standard deviation) as of `LinearGaps`; raises `ValueError` where there is no ground."""
    check_is(strip, Strip, "strip")
    check_is(noise, FlightNoise, "noise")
    margins, cov, status = _linear(strip, noise, compensation)
    code = np.asarray(status)
    if np.any(code != Status.hit):
        wrong = int(np.argmax(code != Status.hit))
        raise ValueError(f"images {wrong} and {wrong + 1} of the planned flight: {Status(int(code[wrong])).message}")
    return margins, cov


@quick_filter_jit
def _linear(strip: Strip, noise: FlightNoise, compensation: Compensation) -> Any:
    def ends(normals: Float[Array, " normals"]) -> Any:
        overlap = flown(strip, noise, normals, compensation)
        margins = jnp.concatenate([overlap.near, overlap.far, overlap.sideways[:, 0], overlap.sideways[:, 1]])
        return margins, (margins, overlap.status)

    J, (margins, status) = jax.jacfwd(ends, has_aux=True)(jnp.zeros(normals_of(strip)))
    spec = np.asarray(specs_of(strip))
    parts = [J[:, spec == k] for k in range(len(SPECS))]
    return margins, jnp.stack([part @ part.T for part in parts]), status


@quick_filter_jit
def _free_with_slopes(margins: Float[Array, " ends"], cov: Float[Array, "specs ends ends"]) -> tuple[Any, Any]:
    """(probability of a strip without a gap, its derivatives by the logarithm of each standard deviation)."""

    def free(scales: Float[Array, " specs"]) -> Scalar:
        return orthant(margins, jnp.tensordot(scales**2, cov, 1))

    return jax.value_and_grad(free)(jnp.ones(len(SPECS)))


@quick_filter_jit
def _free(margins: Float[Array, " ends"], cov: Float[Array, "specs ends ends"]) -> Scalar:
    return orthant(margins, cov.sum(axis=0))


def orthant(mean: Float[Array, " n"], cov: Float[Array, "n n"], points: int = LATTICE) -> Scalar:
    """Probability that normal variables are all positive: Genz (1992), conditional on those before, over a lattice.

    Differentiable. A variance of 1e-10 of the largest is added, so that fully dependent variables stay separable.
    """
    n = mean.shape[0]
    nugget = NUGGET * jnp.maximum(jnp.max(jnp.diagonal(cov)), 1e-20)
    factor = jnp.linalg.cholesky(cov + nugget * jnp.eye(n))
    # Richtmyer's lattice, by roots of primes, made periodic and symmetric by the baker's map.
    generator = jnp.sqrt(jnp.asarray(_primes(n), jnp.float64))
    lattice = jnp.abs(2.0 * jnp.mod((jnp.arange(points)[:, None] + 0.5) * generator[None, :], 1.0) - 1.0)
    lattice = jnp.clip(lattice, 1e-12, 1.0 - 1e-12)

    def one(w: Float[Array, " n"]) -> Scalar:
        def given(k: Any, state: Any) -> Any:
            y, chance = state
            share = ndtr((mean[k] + factor[k] @ y) / factor[k, k])
            at = -ndtri(jnp.clip(share * w[k], 1e-300, 1.0 - 1e-16))
            return y.at[k].set(at), chance * share

        state = jnp.zeros(n), jnp.ones(())
        (_, chance), _ = jax.lax.scan(lambda state, k: (given(k, state), None), state, jnp.arange(n))
        return chance

    return jnp.mean(jax.vmap(one)(lattice))


def _primes(count: int) -> list[int]:
    found: list[int] = []
    number = 2
    while len(found) < count:
        if all(number % prime for prime in found):
            found.append(number)
        number += 1
    return found


@quick_filter_jit
def _shots_as_planned(strip: Strip, noise: FlightNoise) -> Any:
    return shots_of(strip, noise, jnp.zeros(normals_of(strip)), Compensation())

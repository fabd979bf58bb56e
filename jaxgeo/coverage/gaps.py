"""How likely a strip has gaps, what each part of the noise does to that, and the overlap to plan against it."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are asked for
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Bool, Float, Int8

from jaxgeo._checks import check_is
from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.coverage.exposure import end_places
from jaxgeo.coverage.flight import SPECS, Compensation, FlightNoise, Strip, flown, normals_of, shots_of, specs_of
from jaxgeo.status import Status
from jaxgeo.uncertainty.assess import assess
from jaxgeo.uncertainty.draws import Random
from jaxgeo.uncertainty.method_selection import Method
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources import Attitude, GimbalAngles, Position

CHUNK = 512  # flights at a time
LATTICE = 4096  # points of the integral of a normal distribution over an orthant
NUGGET = 1e-10  # share of the largest variance that is added to all, so that margins that go together can be told apart
LEAST, MOST = 0.0, 0.95  # overlaps between which a plan is looked for
FEWEST_GAPS = 5  # flights with a gap that a quantile should rest on
CLOSE = 1e-4  # of overlap, to which it is found

Derivatives = dict[str, tuple[float, float]]


class Flights(Record):
    """Sampled flights of a strip: what each image shares with the one before (flights, images - 1), see `Overlap`.

    `gap` says whether anything along the strip is left out (also where an image sees no ground, or none beside that
    of the one before). `squares` are sums of squares of the normal numbers behind each standard deviation in `SPECS`.
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
        """Share of flights with a gap, and the interval in which the probability lies (Clopper and Pearson 1934)."""
        bad = np.asarray(self.gap_of_strip)
        interval = scipy.stats.binomtest(int(bad.sum()), bad.size).proportion_ci(confidence, "exact")
        return float(bad.mean()), (float(interval.low), float(interval.high))

    def gap_derivatives(self) -> Derivatives:
        """d P(gap) / d sigma, with its standard error, for each standard deviation that is not zero.

        By the score of the normal density: no flight is flown again, and nothing is assumed of the terrain. The unit is
        one over that of the standard deviation (rad, m, m/s, s).
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
    """The same by linear propagation about the flight as planned.

    `margins` (4 pairs,) are the overlaps there at the near ends, then at the far ends, then by how much each image's
    far end lies beyond the other's near end (`Overlap.sideways`); `cov` (specs, 4 pairs, 4 pairs) the part of their
    covariance that each standard deviation in `SPECS` has; `free` is the probability of a strip without gaps there,
    `of_pair` those of a gap at each pair's near end.
    """

    margins: Float[Array, " ends"]
    cov: Float[Array, "specs ends ends"]
    free: Scalar
    of_pair: Float[Array, " pairs"]
    slopes: Float[Array, " specs"]
    noise: FlightNoise

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
    """Flights of a strip in noise: the same for a key and a number, whatever is flown beside it.

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
    """The probability of gaps by the derivatives of all overlaps about the planned flight.

    The overlaps at the near and far ends, and the margins by which images still meet sideways, are taken as jointly
    normal; the probability that all are positive is Genz's
    (1992) integral on a lattice. `linear_is_valid` says whether the terrain lets such derivatives be trusted.
    Raises `ValueError` where the flight as planned sees no ground.
    """
    check_is(strip, Strip, "strip")
    check_is(noise, FlightNoise, "noise")
    margins, cov, free, of_pair, slopes, status = _linear(strip, noise, compensation)
    code = np.asarray(status)
    if np.any(code != Status.hit):
        wrong = int(np.argmax(code != Status.hit))
        raise ValueError(f"images {wrong} and {wrong + 1} of the planned flight: {Status(int(code[wrong])).message}")
    return LinearGaps(margins, cov, free, of_pair, slopes, noise)


def linear_is_valid(
    strip: Strip, noise: FlightNoise, *, compensation: Compensation = Compensation()
) -> Bool[Array, "images ends"]:
    """Whether the error engine trusts derivatives at the ends (near and far, in some order) of all planned images.

    Its verdict on the fix there, with the noise as errors of attitude, position and gimbal.
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
        found = assess(strip.sensor, shot, uv, strip.terrain, errors, atmosphere=strip.air).trust
        return (found == Method.facet) | (found == Method.footprint)

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
    """The overlap to plan so that a share `free` of strips has no gap: by samples with a `key`, without one linearly.

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
        """Above zero where the overlap is enough; continuous, which a share of flights would not be."""
        there = strip.with_overlap(overlap)
        if key is None:
            return float(linear_gaps(there, noise, compensation=compensation).free) - free
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


@eqx.filter_jit
def _flown(strip: Strip, noise: FlightNoise, key: Any, numbers: Any, compensation: Compensation) -> Any:
    size, spec = normals_of(strip), jnp.asarray(specs_of(strip))

    def one(number: Any) -> Any:
        normals = Random().standard_normal(key, number, size)
        overlap = flown(strip, noise, normals, compensation)
        squares = jnp.zeros(len(SPECS)).at[spec].add(normals * normals)
        return overlap.near, overlap.far, overlap.least, overlap.status, squares

    return jax.vmap(one)(numbers)


@eqx.filter_jit
def _linear(strip: Strip, noise: FlightNoise, compensation: Compensation) -> Any:
    def ends(normals: Float[Array, " normals"]) -> Any:
        overlap = flown(strip, noise, normals, compensation)
        margins = jnp.concatenate([overlap.near, overlap.far, overlap.sideways[:, 0], overlap.sideways[:, 1]])
        return margins, (margins, overlap.status)

    J, (margins, status) = jax.jacfwd(ends, has_aux=True)(jnp.zeros(normals_of(strip)))
    spec = np.asarray(specs_of(strip))
    parts = [J[:, spec == k] for k in range(len(SPECS))]
    cov = jnp.stack([part @ part.T for part in parts])

    def free(scales: Float[Array, " specs"]) -> Scalar:
        return orthant(margins, jnp.tensordot(scales**2, cov, 1))

    probability, slopes = jax.value_and_grad(free)(jnp.ones(len(SPECS)))
    near = margins[: strip.images - 1]
    spread = jnp.sqrt(jnp.diagonal(cov.sum(axis=0))[: strip.images - 1])
    of_pair = ndtr(-near / jnp.where(spread > 0.0, spread, 1e-12))
    return margins, cov, probability, of_pair, slopes, status


def orthant(mean: Float[Array, " n"], cov: Float[Array, "n n"], points: int = LATTICE) -> Scalar:
    """Probability that normal variables are all positive: Genz (1992), conditional on those before, over a lattice.

    Differentiable. Variables that go together in lockstep are told apart by a variance of 1e-10 of the largest.
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


@eqx.filter_jit
def _shots_as_planned(strip: Strip, noise: FlightNoise) -> Any:
    return shots_of(strip, noise, jnp.zeros(normals_of(strip)), Compensation())

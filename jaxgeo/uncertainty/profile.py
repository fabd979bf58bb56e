"""Error propagation over the terrain profile along a line of sight."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._numerics import tree_where
from jaxgeo._typing import Numbers, Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.model_inputs import FARTHER, NominalFix, Sweep
from jaxgeo.uncertainty.sight_plane import FLAT, SightPlane
from jaxgeo.uncertainty.unknown_ground import LinesOfSight, lost_beside

NODES = 512  # sample points before the fix, and the same number behind it
NEAREST = 0.25  # of a cell: distance of the nearest ones
GROWTH = 1.009  # of the spacing; the farthest are 2700 cells away
LEVELS = 256  # lines of sight of equal probability
FEW = slice(4, None, 8)  # of the lines, for what is beside them
HALVINGS, HALVINGS_NEAR = 40, 18  # of the whole range, and between ends that are near
LEAST = 1e-9  # m: lower limit of a standard deviation
GAP = 1.0  # of a cell: longer hidden ground is a gap, over which lines of sight jump
FINEST = 0.5  # of the error along the line of sight: the same for terrain without cells
FARTHEST = 30.0  # of that error: smallest distance over which the ground is sampled
FLATTEST = 0.02  # smallest descent per m used for the error along the line of sight over level ground

Places = Float[Array, " places"]
Levels = Float[Array, " levels"]
Bracket = tuple[Scalar, Scalar]


class Bisected(NamedTuple):
    """Ends between which a function is zero after a number of steps, and its values there."""

    number: Int[Array, ""]
    low: Scalar
    high: Scalar
    at_low: Scalar
    at_high: Scalar


class Ground(NamedTuple):
    """Ground along a line of sight: distance `ahead` of the fix and height `above` the ray in m, and a known flag."""

    ahead: Places
    above: Places
    known: Bool[Array, " places"]


class Profile(NamedTuple):
    """Ground points of lines of sight of equal probability, in the vertical plane of the nominal one.

    `ahead` of the fix along the line of sight, `across` and `up` in m are the mean ground point of each of `LEVELS`
    lines (infinite if there is none), `across_sigma` and `up_sigma` the remaining standard deviations. `jumps` is the
    share that hits the ground beyond a gap of hidden ground, `fails` the share that hits no ground, or unknown ground
    beside the plane first; `clearance` is the smallest number of sigmas at which either happens. `unseen` is the length
    of hidden ground up to each of `places`, m, `gap` the longest hidden ground that is ignored, and `off` the distance
    between the ground probed at the fix and the fix, infinite if unknown.
    """

    ahead: Levels
    across: Levels
    up: Levels
    across_sigma: Scalar
    up_sigma: Scalar
    jumps: Scalar
    fails: Scalar
    clearance: Scalar
    places: Places
    unseen: Places
    gap: Scalar
    off: Scalar

    def jumped(self, ahead: np.ndarray) -> np.ndarray:
        """Whether points `ahead` m ahead of the fix lie beyond a gap of hidden ground; not traced."""
        places, unseen, gap = (np.asarray(x) for x in (self.places, self.unseen, self.gap))
        return np.abs(np.interp(ahead, places, unseen) - unseen[NODES]) > gap

    def beyond_gap(self, offsets_enu: np.ndarray, direction_enu: Vector3) -> np.ndarray:
        """Whether points (n, 3) at offsets in m from the fix, NaN without ground, lie beyond a gap of hidden ground.

        `direction_enu` is the nominal line of sight; not traced.
        """
        level = np.asarray(direction_enu)[:2]
        size = float(np.hypot(*level))
        along = level / size if size >= FLAT else np.array([1.0, 0.0])
        return self.jumped(np.nan_to_num(offsets_enu[:, :2] @ along))

    def circular_error(self, probability: float | Scalar, near: Bracket | None = None) -> Scalar:
        """Radius in m in the horizontal plane that contains the fix with a probability; infinite if too many fail.

        `near` are radii between which it is looked for, to a millionth; it is the nearer one if it lies beyond.
        """

        def within(radius: Scalar) -> Scalar:
            half = jnp.sqrt(jnp.maximum(radius**2 - self.ahead**2, 0.0))
            chance = _chance_between(-half, half, self.across, self.across_sigma)
            return jnp.mean(jnp.where(jnp.abs(self.ahead) <= radius, chance, 0.0))

        reach = jnp.abs(self.ahead) + jnp.abs(self.across) + 9.0 * self.across_sigma
        return self._radius(within, probability, reach, near)

    def linear_error(self, probability: float | Scalar, near: Bracket | None = None) -> Scalar:
        """Height in m above and below the nominal fix that contains the fix with a probability; `near` as above."""

        def within(radius: Scalar) -> Scalar:
            chance = _chance_between(-radius, radius, self.up, self.up_sigma)
            return jnp.mean(jnp.where(jnp.isfinite(self.up), chance, 0.0))

        return self._radius(within, probability, jnp.abs(self.up) + 9.0 * self.up_sigma, near)

    def over_plane(self, ahead_sigma: Scalar, up_sigma: Scalar) -> Profile:
        """The same lines of sight over a plane, whose ground points ahead and up have these standard deviations, m."""
        levels, common = _normal_levels(), jnp.sqrt(jnp.maximum(up_sigma**2 - self.up_sigma**2, 0.0))
        return self._replace(ahead=ahead_sigma * levels, up=common * levels)

    def _radius(
        self, within: Callable[[Scalar], Scalar], probability: float | Scalar, reach: Levels, near: Bracket | None
    ) -> Scalar:
        if near is None:
            farthest = jnp.max(jnp.where(jnp.isfinite(reach), reach, 0.0)) + LEAST
            low, high, halvings = jnp.zeros_like(farthest), farthest, HALVINGS
        else:
            (low, high), halvings = near, HALVINGS_NEAR
        radius = _root(lambda radius: within(radius) - probability, low, high, halvings)
        return jnp.where(1.0 - self.fails >= probability, radius, jnp.inf)


def profile_of(
    terrain: AbstractTerrain, nominal: NominalFix, sweep: Sweep, cov_error: Float[Array, "axes axes"], normal: Vector3
) -> Profile:
    """Terrain profile of an observation, from its derivatives by the errors (`sweep`); itself without derivatives.

    An error of the line of sight or of the terrain height moves one relative to the other by the same number of sigmas
    along the whole profile: a line of sight passes through a point of the ground if it is moved there by the distance
    of that point from the nominal line. So the profile goes on below the camera and behind it, where errors reach
    beyond the nadir. Across the line of sight the ground is a plane with a `normal` whose last component is 1.
    """
    terrain, nominal, sweep, cov_error, normal = jax.lax.stop_gradient((terrain, nominal, sweep, cov_error, normal))
    plane = SightPlane.of(nominal.direction_enu)
    along, level, fall = plane
    to_lift = lambda swept: swept[2] + fall * (along @ swept[:2])  # noqa: E731
    turn = (to_lift(sweep.farther) - to_lift(sweep.line)) / FARTHER
    to_side = jnp.stack([-along[1], along[0]])
    aside = to_side @ sweep.line[:2]
    rise_aside = -(normal[:2] @ to_side) * aside
    lift_at_fix = to_lift(sweep.line) - sweep.ground - rise_aside
    spacing = terrain.spacing_at(nominal.p_ecef)
    if spacing is None:
        facet, level_ground = (_sigma(x, cov_error) for x in (along @ sweep.facet[:2], lift_at_fix))
        least = jnp.minimum(facet, level_ground / jnp.maximum(fall, FLATTEST))
        places, gap = _by_errors(least, nominal.distance)
    else:
        places, gap = _by_spacing(spacing), GAP * spacing
    ground, off = _ground(terrain, nominal, plane, places)
    lift = _sigma_ahead(lift_at_fix, turn / level, cov_error)
    nearest = plane.abreast(places, ground.above)
    ground = ground._replace(known=ground.known & (nearest > -nominal.distance * level))
    sigma = lift(nearest)

    levels = _normal_levels()
    ahead, rise, fell, unseen = _first_met(ground, ground.above / sigma, levels)
    jumped = fell & (jnp.abs(jnp.interp(ahead, ground.ahead, unseen) - unseen[NODES]) > gap)
    at_fix = lift_at_fix / sigma[NODES]
    across, across_sigma = _given_lift(aside, at_fix, cov_error)
    up, up_sigma = _given_lift(sweep.ground + rise_aside, at_fix, cov_error)
    side = _sigma_ahead(aside, to_side @ (sweep.farther - sweep.line)[:2] / (FARTHER * level), cov_error)
    met = jnp.where(fell, ahead, -jnp.inf)[FEW]
    lost, first = lost_beside(terrain, nominal, LinesOfSight(plane, lift, side), levels[FEW], met)
    clearance = jnp.min(jnp.where(jumped | ~fell, jnp.abs(levels), jnp.inf))
    return Profile(
        ahead=jnp.where(fell, ahead, jnp.inf),
        across=across * levels,
        up=jnp.where(fell, rise - fall * ahead + up * levels, jnp.inf),
        across_sigma=across_sigma,
        up_sigma=up_sigma,
        jumps=jnp.mean(jumped),
        fails=jnp.mean(~fell) + lost,
        clearance=jnp.minimum(clearance, first),
        places=ground.ahead,
        unseen=unseen,
        gap=gap,
        off=off,
    )


def _normal_levels() -> Levels:
    """Quantiles of the normal distribution at the middle of `LEVELS` equal shares."""
    return ndtri((jnp.arange(LEVELS) + 0.5) / LEVELS)


def _ground(terrain: AbstractTerrain, nominal: NominalFix, plane: SightPlane, places: Places) -> tuple[Ground, Scalar]:
    """Ground along a line of sight at distances ahead of its fix, and its distance from the fix there, m."""
    forth = nominal.R_ecef_from_enu @ plane.path
    above, known = jax.vmap(lambda ahead: terrain.ground_above(nominal.p_ecef + ahead * forth))(places)
    off = jnp.where(known[NODES], jnp.abs(above[NODES]), jnp.inf)
    above = (above + (plane.fall - plane.slant) * places).at[NODES].set(0.0)
    return Ground(places, above, known), off


def _by_spacing(spacing: Scalar) -> Places:
    """Sample points before and behind a fix for ground of a given spacing, m: dense near the fix, then sparser."""
    return _both_ways(NEAREST * spacing * (GROWTH ** jnp.arange(1, NODES + 1) - 1.0) / (GROWTH - 1.0))


def _by_errors(sigma: Scalar, distance: Scalar) -> tuple[Places, Scalar]:
    """Sample points for a given error along the line of sight, out to the camera, and the length of a gap, m."""
    sigma = jnp.maximum(sigma, LEAST)
    reach = jnp.maximum(distance, FARTHEST * sigma)
    return _both_ways(sigma * jnp.sinh(jnp.arange(1, NODES + 1) / NODES * jnp.arcsinh(reach / sigma))), FINEST * sigma


def _both_ways(aside: Float[Array, " half"]) -> Places:
    return jnp.concatenate([-aside[::-1], jnp.zeros(1), aside])


def _sigma_ahead(
    at_fix: Float[Array, " axes"], per_metre: Float[Array, " axes"], cov_error: Float[Array, "axes axes"]
) -> Callable[[Array], Array]:
    """Standard deviation in m of a quantity of the line of sight at distances ahead of the fix, m."""
    both = jnp.stack([at_fix, per_metre])
    (here, mixed), (_, there) = both @ cov_error @ both.T

    def sigma(ahead: Array) -> Array:
        return jnp.maximum(jnp.sqrt(jnp.maximum(here + ahead * (2.0 * mixed + ahead * there), 0.0)), LEAST)

    return sigma


def _sigma(moved: Float[Array, " axes"], cov_error: Float[Array, "axes axes"]) -> Scalar:
    return jnp.sqrt(jnp.maximum(moved @ cov_error @ moved, 0.0))


def _first_met(ground: Ground, excess: Places, levels: Levels) -> tuple[Levels, Levels, Bool[Array, " levels"], Places]:
    """(distance ahead, ground above the ray there, whether it hits the ground) of rays lifted by `levels` sigmas, and
    the hidden ground up to each sample point, m.

    `excess` is the height of the ground above the ray in sigmas: a ray lifted by z hits the ground where `excess` first
    reaches z, so only its running maximum is visible.
    """
    excess = jnp.where(ground.known, excess, -jnp.inf)
    highest = jax.lax.cummax(excess)
    index = jnp.searchsorted(highest, levels, side="left")
    fell = (index > 0) & (index < excess.shape[0])
    index = jnp.clip(index, 1, excess.shape[0] - 1)
    before, after = excess[index - 1], excess[index]
    share = jnp.where(jnp.isfinite(before), (levels - before) / jnp.where(after > before, after - before, 1.0), 1.0)
    share = jnp.clip(share, 0.0, 1.0)
    between = lambda x: x[index - 1] + share * (x[index] - x[index - 1])  # noqa: E731
    step = jnp.diff(ground.ahead, prepend=ground.ahead[:1])
    unseen = jnp.cumsum(jnp.where(excess < highest, step, 0.0))
    return between(ground.ahead), between(ground.above), fell, unseen


def _given_lift(
    moved: Float[Array, " axes"], lift: Float[Array, " axes"], cov_error: Float[Array, "axes axes"]
) -> tuple[Scalar, Scalar]:
    """(change of a quantity per sigma of lift, its remaining standard deviation)."""
    together = moved @ cov_error @ lift
    return together, jnp.sqrt(jnp.maximum(moved @ cov_error @ moved - together**2, 0.0))


def _root(function: Callable[[Scalar], Scalar], low: Scalar, high: Scalar, halvings: int) -> Scalar:
    """Where a growing function is zero between two ends, as exactly as after some halvings; an end if it is beyond.

    Interpolation that takes one step more than bisection at worst (Oliveira and Takahashi 2020, An enhancement of the
    bisection method average performance preserving minmax optimality).
    """
    first = high - low
    exact = first * 2.0**-halvings

    def goes_on(state: Bisected) -> Bool[Array, ""]:
        return state.high - state.low > exact

    def step(state: Bisected) -> Bisected:
        middle, width = 0.5 * (state.low + state.high), state.high - state.low
        rise = state.at_high - state.at_low
        crosses = (state.at_low < 0.0) & (state.at_high > 0.0)
        line = state.low - state.at_low * width / jnp.where(crosses, rise, 1.0)
        line = jnp.where(crosses, line, middle)
        toward = jnp.sign(middle - line)
        at = line + toward * jnp.minimum(0.2 / first * width**2, jnp.abs(middle - line))
        slack = jnp.maximum(exact * 2.0 ** (halvings - state.number) - 0.5 * width, 0.0)
        at = jnp.where(jnp.abs(at - middle) <= slack, at, middle - toward * slack)
        value = function(at)
        ends = Bisected(state.number + 1, at, state.high, value, state.at_high)
        others = Bisected(state.number + 1, state.low, at, state.at_low, value)
        return tree_where(value < 0.0, ends, others)

    start = Bisected(jnp.asarray(0), low, high, *jax.lax.map(function, jnp.stack([low, high])))
    found = jax.lax.while_loop(goes_on, step, start)
    return 0.5 * (found.low + found.high)


def _chance_between(low: Numbers, high: Numbers, mean: Levels, sigma: Scalar) -> Levels:
    sigma = jnp.maximum(sigma, LEAST)
    return ndtr((high - mean) / sigma) - ndtr((low - mean) / sigma)

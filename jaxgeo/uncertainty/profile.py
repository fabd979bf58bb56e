"""The ground's profile under a line of sight, and where lines of sight that err by so many sigmas would come down."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._typing import Numbers, Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.model_inputs import FARTHER, NominalFix, Sweep

NODES = 512  # places before the fix, and as many behind it
NEAREST = 0.25  # of a cell: how far the nearest of them lie from it
GROWTH = 1.009  # of the distance between neighbours; the farthest lie 2700 cells away
LEVELS = 256  # lines of sight, each standing for an equal share of chance
HALVINGS = 60
FLAT = 1e-3  # level part of a direction: a steeper line of sight has no profile
LEAST = 1e-9  # m: a standard deviation of nothing
GAP = 1.0  # of a cell: unseen ground that is longer is a gap, beyond which lines of sight jump
FINEST = 0.5  # of the errors' reach along the look: the same where the ground has no cells
FARTHEST = 30.0  # of that reach: how far the ground is probed at least
FLATTEST = 0.02  # fall of a line of sight by which its reach over level ground is told

Places = Float[Array, " places"]
Levels = Float[Array, " levels"]


class Ground(NamedTuple):
    """Ground along a line of sight: places `ahead` of the fix and height `above` the ray in m, and if it is known."""

    ahead: Places
    above: Places
    known: Bool[Array, " places"]


class Profile(NamedTuple):
    """Where lines of sight of equal chance come down, in the vertical plane of the nominal one.

    `ahead` of the fix along the look, `across` and `up` in m are the mean of where each of `LEVELS` comes down
    (infinite where it does not), `across_sigma` and `up_sigma` what is left of chance to the side and in height.
    `jumps` is the share that comes down beyond a gap of unseen ground, `fails` that which comes down nowhere;
    `clearance` is how many sigmas off the nearest line of sight is that does either. `unseen` is how much ground is out
    of sight up to each of `places`, m, `gap` the longest unseen ground that counts for nothing, and `off` how far the
    ground probed at the fix lies from it, infinite where it is unknown.
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

    def jumped(self, ahead: Float[Array, "..."]) -> Bool[Array, "..."]:
        """Whether points so far ahead of the fix, m, lie beyond a gap of unseen ground."""
        between = jnp.interp(ahead, self.places, self.unseen) - self.unseen[NODES]
        return jnp.abs(between) > self.gap

    def circular_error(self, probability: float) -> Scalar:
        """Radius in m on the level plane within which the fix falls with a probability; infinite if too many fail."""

        def within(radius: Scalar) -> Scalar:
            half = jnp.sqrt(jnp.maximum(radius**2 - self.ahead**2, 0.0))
            chance = _chance_between(-half, half, self.across, self.across_sigma)
            return jnp.mean(jnp.where(jnp.abs(self.ahead) <= radius, chance, 0.0))

        return self._radius(within, probability, jnp.abs(self.ahead) + jnp.abs(self.across) + 9.0 * self.across_sigma)

    def linear_error(self, probability: float) -> Scalar:
        """Height in m above and below the fix within which it falls with a probability."""

        def within(radius: Scalar) -> Scalar:
            chance = _chance_between(-radius, radius, self.up, self.up_sigma)
            return jnp.mean(jnp.where(jnp.isfinite(self.up), chance, 0.0))

        return self._radius(within, probability, jnp.abs(self.up) + 9.0 * self.up_sigma)

    def _radius(self, within: Callable[[Scalar], Scalar], probability: float, reach: Levels) -> Scalar:
        def halve(_: Int[Array, ""], ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = ends
            middle = 0.5 * (low + high)
            enough = within(middle) >= probability
            return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

        farthest = jnp.max(jnp.where(jnp.isfinite(reach), reach, 0.0)) + LEAST
        _, radius = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.zeros_like(farthest), farthest))
        return jnp.where(1.0 - self.fails >= probability, radius, jnp.inf)


def profile_of(
    terrain: AbstractTerrain, aim: NominalFix, sweep: Sweep, cov_error: Float[Array, "axes axes"], normal: Vector3
) -> Profile:
    """The profile of a look over a terrain, whose derivatives by its errors are known; without derivatives itself.

    An error of the line of sight, or of the terrain's height, lifts the one over the other by as many sigmas all the
    way; across the look the ground rises as the plane of a `normal` (its last component 1) does.
    """
    terrain, aim, sweep, cov_error, normal = jax.lax.stop_gradient((terrain, aim, sweep, cov_error, normal))
    level = jnp.sqrt(aim.direction_enu[0] ** 2 + aim.direction_enu[1] ** 2)
    plumb = level < FLAT
    along = jnp.where(plumb, jnp.array([1.0, 0.0]), aim.direction_enu[:2] / jnp.where(plumb, 1.0, level))
    level = jnp.maximum(level, FLAT)
    fall = -aim.direction_enu[2] / level
    to_lift = lambda swept: swept[2] + fall * (along @ swept[:2])  # noqa: E731
    turn = (to_lift(sweep.farther) - to_lift(sweep.line)) / FARTHER
    to_side = jnp.stack([-along[1], along[0]])
    aside = to_side @ sweep.line[:2]
    rise_aside = -(normal[:2] @ to_side) * aside
    lift_at_fix = to_lift(sweep.line) - sweep.ground - rise_aside
    spacing = terrain.spacing()
    if spacing is None:
        facet, level_ground = (_sigma(x, cov_error) for x in (along @ sweep.facet[:2], lift_at_fix))
        nearest = jnp.minimum(facet, level_ground / jnp.maximum(fall, FLATTEST))
        places, gap = _by_errors(nearest, aim.distance)
    else:
        places, gap = _by_spacing(spacing), GAP * spacing
    ground, off = _ground(terrain, aim, level, places)
    lift = lift_at_fix[None, :] + (ground.ahead / level)[:, None] * turn[None, :]
    sigma = jnp.maximum(jnp.sqrt(jnp.maximum(jnp.sum((lift @ cov_error) * lift, axis=1), 0.0)), LEAST)

    levels = ndtri((jnp.arange(LEVELS) + 0.5) / LEVELS)
    ahead, rise, fell, unseen = _first_met(ground, ground.above / sigma, levels)
    jumped = fell & (jnp.abs(jnp.interp(ahead, ground.ahead, unseen) - unseen[NODES]) > gap)
    at_fix = lift[NODES] / sigma[NODES]
    across, across_sigma = _given_lift(aside, at_fix, cov_error)
    up, up_sigma = _given_lift(sweep.ground + rise_aside, at_fix, cov_error)
    return Profile(
        ahead=jnp.where(fell, ahead, jnp.inf),
        across=across * levels,
        up=jnp.where(fell, rise - fall * ahead + up * levels, jnp.inf),
        across_sigma=across_sigma,
        up_sigma=up_sigma,
        jumps=jnp.mean(jumped),
        fails=jnp.mean(~fell),
        clearance=jnp.min(jnp.where(jumped | ~fell, jnp.abs(levels), jnp.inf)),
        places=ground.ahead,
        unseen=unseen,
        gap=gap,
        off=off,
    )


def _ground(terrain: AbstractTerrain, aim: NominalFix, level: Scalar, places: Places) -> tuple[Ground, Scalar]:
    """The ground along a line of sight at places ahead of its fix; and how far it there lies off the fix, m."""
    direction = aim.R_ecef_from_enu @ aim.direction_enu
    at = lambda ahead: aim.p_ecef + direction * (ahead / level)  # noqa: E731
    above, known = jax.vmap(lambda ahead: terrain.ground_above(at(ahead)))(places)
    off = jnp.where(known[NODES], jnp.abs(above[NODES]), jnp.inf)
    return Ground(places, above.at[NODES].set(0.0), known & (places > -aim.distance * level)), off


def _by_spacing(spacing: Scalar) -> Places:
    """Places before and behind a fix for ground of a known spacing, m: close about it, looser away from it."""
    return _both_ways(NEAREST * spacing * (GROWTH ** jnp.arange(1, NODES + 1) - 1.0) / (GROWTH - 1.0))


def _by_errors(sigma: Scalar, distance: Scalar) -> tuple[Places, Scalar]:
    """The same by how far errors move a fix along the look, out to the camera; and the gap that counts, m."""
    sigma = jnp.maximum(sigma, LEAST)
    reach = jnp.maximum(distance, FARTHEST * sigma)
    return _both_ways(sigma * jnp.sinh(jnp.arange(1, NODES + 1) / NODES * jnp.arcsinh(reach / sigma))), FINEST * sigma


def _both_ways(aside: Float[Array, " half"]) -> Places:
    return jnp.concatenate([-aside[::-1], jnp.zeros(1), aside])


def _sigma(moved: Float[Array, " axes"], cov_error: Float[Array, "axes axes"]) -> Scalar:
    return jnp.sqrt(jnp.maximum(moved @ cov_error @ moved, 0.0))


def _first_met(ground: Ground, excess: Places, levels: Levels) -> tuple[Levels, Levels, Bool[Array, " levels"], Places]:
    """(place ahead, ground above the ray there, whether it comes down) of rays lifted by sigmas; unseen ground up to
    each place, m.

    `excess` is the ground's height above the ray in sigmas: a ray that is lifted by z meets the ground where that first
    reaches z, so that its running maximum is all that is seen.
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
    """(how far a quantity goes with one sigma of lift, what is left of its standard deviation)."""
    together = moved @ cov_error @ lift
    return together, jnp.sqrt(jnp.maximum(moved @ cov_error @ moved - together**2, 0.0))


def _chance_between(low: Numbers, high: Numbers, mean: Levels, sigma: Scalar) -> Levels:
    sigma = jnp.maximum(sigma, LEAST)
    return ndtr((high - mean) / sigma) - ndtr((low - mean) / sigma)

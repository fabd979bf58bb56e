"""Recursive least squares over looks: a square-root information filter with shared errors as states.

The state is s = (fading numbers, position and velocity at the first look, constant numbers), in the frame of the
track. A look measures the two components of the target's distance from the line of sight across it. With the line
perturbed by the numbers z of `SharedErrors`, 0 = b + H dx + G z; the fresh part of G z is its noise. The filter carries
R s = y with R triangular, updated by a QR decomposition (Bierman 1977, "Factorization methods for discrete sequential
estimation"). Without a linearisation of its own at each look, it solves the normal equations of all looks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._numerics import dot, safe_norm, safe_sqrt, tree_where
from jaxgeo._typing import Flag, Matrix3, Scalar, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.look_lines import Lines
from jaxgeo.uncertainty.target_motion import AbstractTarget

FLOOR = 1e-8  # of the total variance of a look: least variance of its fresh errors, for models without any
LEAST = 1e-6  # m: least standard deviation of a look
FAR, FAST = 1e8, 1e7  # m, m/s: standard deviations of position and velocity before the first look
AT_ONCE = 1e-7  # least standard deviation of the change of a fading number
LEAST_REACH = 0.01  # m: least distance over which the slope of the ground is taken
SURFACE_STEPS, STEPS_NEARBY = 3, 2  # to the ground at a place in the level axes, and near one that is on it
UNDETERMINED = 0.1  # of the range: standard deviation of a position that is not determined
EXACT = 1e-12  # share of the variance of an innovation that is the look's own, below which rounding decides


class World(NamedTuple):
    """What all looks share: terrain (None if the target is free in height), frame of the track, fading times in s."""

    terrain: AbstractTerrain | None
    origin: Vector3
    R_ecef_from_track: Matrix3
    durations: Float[Array, " fading"]


class Mode(NamedTuple):
    """How a pass treats the looks.

    `shared`: 1 for shared errors as states, 0 to take the errors of all looks for fresh. `fresh` scales the fresh
    errors. `rounds`: linearisations at each look, about its own estimate; 0 for one about a given state.
    """

    shared: Any
    fresh: Any
    rounds: Any


class Carry(NamedTuple):
    """State of the filter: R and y, the estimate s, its last time, and sums for the covariance of `actual`."""

    R: Any
    y: Any
    s: Any
    time: Any
    fresh_sum: Any
    constant_sum: Any
    fading_sum: Any
    fading_cross: Any


class About(NamedTuple):
    """What a look is linearised about: a `state` (unknowns,), and the standard deviation of its position in m."""

    state: Any
    reach: Any


class AfterLook(NamedTuple):
    """Estimates after each look: position and its covariance in m2, velocity in m/s and its covariance, east, north,
    up at the position.

    `about` is the estimate in the frame of the track. `actual` is the covariance of the position that the
    error model with shared errors gives to the estimate of this pass. `innovation` (2,) is standardised, `nis` its
    squared length, `degrees` the number of its components that are determined.
    """

    about: About
    position: Geodetic
    p_ecef: Any
    cov_enu: Any
    velocity_enu: Any
    velocity_cov_enu: Any
    actual: Any
    innovation: Any
    nis: Any
    degrees: Any
    distance: Any
    is_known: Any


class Measured(NamedTuple):
    """A look linearised at a state: `b` (2,), `H` (2, unknowns) and `G` (2, z) of 0 = b + H dx + G z; and derivatives
    of the target's place, `T` (3, unknowns) and `up` (3,) by a rise of the ground; range in m.
    """

    b: Any
    H: Any
    G: Any
    T: Any
    up: Any
    distance: Any


def start_of(target: AbstractTarget, counts: tuple[int, int, int]) -> Carry:
    """The filter before the first look."""
    _, constant, fading = counts
    unknowns = target.unknowns
    before = np.full(unknowns, 1.0 / FAR)
    before[target.axes :] = 1.0 / FAST
    size = fading + unknowns + constant
    R = np.diag(np.concatenate([np.ones(fading), before, np.ones(constant)]))
    return Carry(
        R,
        y=np.zeros(size),
        s=np.zeros(size),
        time=np.array(-np.inf),
        fresh_sum=np.zeros((unknowns, unknowns)),
        constant_sum=np.zeros((unknowns, constant)),
        fading_sum=np.zeros((unknowns, unknowns)),
        fading_cross=np.zeros((unknowns, fading)),
    )


@batch_filter_jit
def filtered(
    carry: Carry,
    lines: Lines,
    used: Any,
    about: About,
    world: World,
    mode: Mode,
    target: AbstractTarget,
    counts: tuple[int, int, int],
) -> tuple[Carry, AfterLook]:
    """The filter after a block of looks (leading axis), and its estimates after each.

    With `mode.rounds` 0 all looks are linearised `about` one state.
    """
    layout = _Layout(target, counts)
    step = lambda carry, look: _step(carry, *look, about, world, mode, layout)  # noqa: E731
    return jax.lax.scan(step, carry, (lines, used))


class _Layout(NamedTuple):
    """Slices of the state and of the numbers z."""

    target: AbstractTarget
    counts: tuple[int, int, int]

    @property
    def unknowns(self) -> slice:
        return slice(self.counts[2], self.counts[2] + self.target.unknowns)

    @property
    def fresh(self) -> slice:
        return slice(0, self.counts[0])

    @property
    def constant(self) -> slice:
        return slice(self.counts[0], self.counts[0] + self.counts[1])

    @property
    def fading(self) -> slice:
        return slice(self.counts[0] + self.counts[1], sum(self.counts))

    def split(self, of_z: Any) -> tuple[Any, Any, Any]:
        """Fresh, constant and fading columns (last axis)."""
        return of_z[..., self.fresh], of_z[..., self.constant], of_z[..., self.fading]


def _step(
    carry: Carry, line: Lines, used: Flag, given: About, world: World, mode: Mode, layout: _Layout
) -> tuple[Carry, AfterLook]:
    since = line.time - carry.time
    stays = jnp.exp(-since / world.durations)
    new = jnp.maximum(jnp.sqrt(-jnp.expm1(-2.0 * since / world.durations)), AT_ONCE)
    fading = layout.counts[2]
    predicted = carry.s.at[:fading].multiply(stays)
    use = jnp.where(used, 1.0, 0.0)

    def update(about: About) -> tuple[Any, ...]:
        x = about.state
        measured = _measured(line, about, world, layout.target)
        A, W, noise = _equations(measured, line, mode, layout)
        right = -measured.b + measured.H @ x
        R, y = _qr_step(carry, stays, new, use * (W @ A), use * (W @ right))
        s = jax.scipy.linalg.solve_triangular(R, y)
        return R, y, s, measured, A, W, noise, right

    def again(_: Any, before: tuple[About, Any]) -> tuple[About, Any]:
        R, y, s, *rest = update(before[0])
        return About(s[layout.unknowns], _reach(R, line.time, layout)), (R, y, s, *rest)

    own_start = About(predicted[layout.unknowns], jnp.zeros(()))
    about = tree_where(mode.rounds > 0, own_start, given)
    empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(update, about))
    about, updated = jax.lax.fori_loop(0, jnp.maximum(mode.rounds, 1), again, (about, empty))
    R, y, s, measured, A, W, (noise_z, noise_ground), right = updated

    # Innovation.
    within = jax.scipy.linalg.solve_triangular(R, (W @ A).T, trans="T")
    own = jnp.eye(2) - use * within.T @ within
    inverse = W.T @ own @ W
    determined, innovation = _innovation(right - A @ predicted, inverse, line.distance)
    determined &= jnp.trace(own) > EXACT
    innovation = jnp.where(used & determined.any(), innovation, 0.0)
    degrees = jnp.where(used, jnp.sum(determined), 0)

    # Position: also of the ground as it is known from the fresh errors of this look.
    reach = about.reach
    place, is_known = _place(line, s[layout.unknowns], world, layout.target)
    weight = use * (noise_ground @ noise_z.T) @ (W.T @ W)  # of what is left of the look in the fresh height error
    shared = jnp.zeros(s.shape[0]).at[:fading].set(mode.shared * layout.split(line.ground)[2])
    shared = shared.at[layout.unknowns.stop :].set(mode.shared * layout.split(line.ground)[1])
    M = jnp.zeros((3, s.shape[0])).at[:, layout.unknowns].set(measured.T)
    M = M + jnp.outer(measured.up, shared - weight @ A)
    spread = jax.scipy.linalg.solve_triangular(R, M.T, trans="T")
    left = jnp.maximum(noise_ground @ noise_ground - weight @ (noise_z @ noise_ground), 0.0)
    cov = spread.T @ spread + jnp.outer(measured.up, measured.up) * left
    rise = shared @ s + weight @ (right - A @ s)
    p_ecef = world.origin + world.R_ecef_from_track @ (place + measured.up * rise)

    sums, actual = _actual(carry, line, measured, weight, W, stays, use, layout, R)
    velocity, V = _velocity(measured, s, R, layout)
    position = WGS84.to_geodetic(p_ecef)
    to_enu = R_ecef_from_enu(position).T @ world.R_ecef_from_track
    turned = lambda cov: to_enu @ cov @ to_enu.T  # noqa: E731
    after = AfterLook(
        About(s[layout.unknowns], reach),
        position,
        p_ecef,
        turned(cov),
        to_enu @ velocity,
        turned(V),
        turned(actual),
        innovation,
        dot(innovation, innovation),
        degrees,
        measured.distance,
        is_known,
    )
    return Carry(R, y, s, line.time, *sums), after


def _reach(R: Any, time: Scalar, layout: _Layout) -> Scalar:
    """Standard deviation in m of the position along a level axis, their mean."""
    target, first = layout.target, layout.unknowns.start
    M = jnp.zeros((2, R.shape[0])).at[:, first : first + 2].set(jnp.eye(2))
    if target.is_moving:
        M = M.at[:, first + target.axes : first + target.axes + 2].set(time * jnp.eye(2))
    return safe_sqrt(0.5 * jnp.sum(jax.scipy.linalg.solve_triangular(R, M.T, trans="T") ** 2))


def _measured(line: Lines, about: About, world: World, target: AbstractTarget) -> Measured:
    """A look linearised at a state."""
    place, _ = _place(line, about.state, world, target)
    T, up = jnp.eye(3), jnp.zeros(3)
    if target.on_terrain:
        assert world.terrain is not None
        T, up = _surface_slope(place, about.reach, world.terrain, world), jnp.array([0.0, 0.0, 1.0])
    if target.is_moving:
        T = jnp.concatenate([T, line.time * T], axis=1)
    ahead = dot(line.heading, place - line.point)
    foot = line.point + line.heading * ahead + 0.5 * line.bend * ahead**2
    across = _across(line.heading + line.bend * ahead)
    G = across @ (jnp.outer(up, line.ground) - line.shift - line.slope * ahead)
    return Measured(across @ (place - foot), across @ T, G, T, up, line.distance + ahead)


def _place(line: Lines, x: Any, world: World, target: AbstractTarget) -> tuple[Vector3, Flag]:
    """(place of the target at a look in the frame, m; whether the ground is known there)."""
    axes = target.axes
    place = x[:axes] + line.time * x[axes:] if target.is_moving else x
    if not target.on_terrain:
        return place, jnp.asarray(True)
    assert world.terrain is not None
    return on_surface(place, line.point[2], world.terrain, world)


def on_surface(
    horizontal: Any, start: Scalar, terrain: AbstractTerrain, world: World, steps: int = SURFACE_STEPS
) -> tuple[Vector3, Flag]:
    """(point of the ground in the frame, over a place in its level axes; whether the ground is known there)."""

    def nearer(_: Any, before: tuple[Vector3, Flag]) -> tuple[Vector3, Flag]:
        place, _ = before
        above, is_known = terrain.ground_above(world.origin + world.R_ecef_from_track @ place)
        return place.at[2].add(above), is_known

    place = jnp.concatenate([horizontal, start[None]])
    return jax.lax.fori_loop(0, steps, nearer, (place, jnp.asarray(True)))


def _surface_slope(place: Vector3, reach: Scalar, terrain: AbstractTerrain, world: World) -> Float[Array, "3 2"]:
    """Derivative of a point of the ground by its level coordinates, over as much ground as the position may err.

    The difference over the standard deviation on either side: the slope that matters for the estimate (statistical
    linearisation), and a continuous one. The derivative of a bilinear surface jumps at each row of posts.
    """
    steps = jnp.maximum(reach, LEAST_REACH) * jnp.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    around = jax.vmap(lambda step: on_surface(place[:2] + step, place[2], terrain, world, STEPS_NEARBY)[0])(steps)
    return (around[::2] - around[1::2]).T / (2.0 * jnp.maximum(reach, LEAST_REACH))


def _across(heading: Vector3) -> Float[Array, "2 3"]:
    """Unit vectors across a line of sight: to the right, level, and upwards; for a plumb line two level ones."""
    d = heading / safe_norm(heading)
    level = jnp.stack([d[1], -d[0], jnp.zeros(())])
    plumb = dot(level, level) < 1e-12
    level = jnp.where(plumb, jnp.array([1.0, 0.0, 0.0]), level)
    right = level / safe_norm(level)
    return jnp.stack([right, jnp.cross(right, d)])


def _equations(measured: Measured, line: Lines, mode: Mode, layout: _Layout) -> tuple[Any, Any, tuple[Any, Any]]:
    """(A of -b = A ds + noise; W with W' W the inverse covariance of the noise; derivatives of the noise (2, z) and of
    the height of the ground (z,) by the numbers that are fresh)."""
    noise, ground = (_fresh(of_z, mode, layout) for of_z in (measured.G, line.ground))
    _, constant, fading = layout.split(measured.G)
    A = jnp.concatenate([mode.shared * fading, measured.H, mode.shared * constant], axis=1)
    floor = FLOOR * 0.5 * jnp.sum(measured.G**2) + LEAST**2
    cov = noise @ noise.T
    middle, half = 0.5 * (cov[0, 0] + cov[1, 1]), 0.5 * (cov[0, 0] - cov[1, 1])
    least = middle - safe_sqrt(half**2 + cov[0, 1] ** 2)
    lower = jnp.linalg.cholesky(cov + jnp.maximum(floor - least, 0.0) * jnp.eye(2))
    W = jax.scipy.linalg.solve_triangular(lower, jnp.eye(2), lower=True)
    return A, W, (noise, ground)


def _fresh(of_z: Any, mode: Mode, layout: _Layout) -> Any:
    """The columns of the numbers that are taken for fresh; zeros in place of the others."""
    fresh, constant, fading = layout.split(of_z)
    return jnp.concatenate([mode.fresh * fresh, (1.0 - mode.shared) * constant, (1.0 - mode.shared) * fading], axis=-1)


def _qr_step(carry: Carry, stays: Any, new: Any, A: Any, right: Any) -> tuple[Any, Any]:
    """R and y after the fading numbers have changed and a look was added."""
    fading, size = stays.shape[0], carry.y.shape[0]
    rows = jnp.zeros((fading + size + 2, fading + size + 1))
    rows = rows.at[:fading, :fading].set(jnp.diag(-stays / new)).at[:fading, fading : 2 * fading].set(jnp.diag(1 / new))
    rows = rows.at[fading : fading + 2, fading:-1].set(A).at[fading : fading + 2, -1].set(right)
    old = jnp.concatenate([carry.R, carry.y[:, None]], axis=1)
    rows = rows.at[fading + 2 :, :fading].set(old[:, :fading]).at[fading + 2 :, 2 * fading :].set(old[:, fading:])
    reduced = jnp.linalg.qr(rows, mode="r")[fading : fading + size, fading:]
    return reduced[:, :-1], reduced[:, -1]


def _innovation(residual: Any, inverse: Any, distance: Scalar) -> tuple[Any, Any]:
    """(which of two directions are determined, standardised innovation) from the inverse innovation covariance."""
    values, vectors = jnp.linalg.eigh(0.5 * (inverse + inverse.T))
    determined = values * distance**2 > 1.0
    roots = jnp.sqrt(jnp.where(determined, values, 0.0))
    return determined, vectors @ (roots * (vectors.T @ residual))


def _velocity(measured: Measured, s: Any, R: Any, layout: _Layout) -> tuple[Any, Any]:
    """(velocity in the frame, m/s; its covariance)."""
    if not layout.target.is_moving:
        return jnp.zeros(3), jnp.zeros((3, 3))
    axes = layout.target.axes
    T = measured.T[:, :axes]
    first = layout.unknowns.start + axes
    M = jnp.zeros((3, s.shape[0])).at[:, first : first + axes].set(T)
    spread = jax.scipy.linalg.solve_triangular(R, M.T, trans="T")
    return T @ s[first : first + axes], spread.T @ spread


def _actual(
    carry: Carry,
    line: Lines,
    measured: Measured,
    weight: Any,
    W: Any,
    stays: Any,
    use: Any,
    layout: _Layout,
    R: Any,
) -> tuple[tuple[Any, Any, Any, Any], Matrix3]:
    """(sums of the filter that takes all errors for fresh; actual covariance of its position).

    Its estimate errs by P times the sum of H' W' W G z over the looks, where P is the covariance that it claims.
    """
    V = use * measured.H.T @ (W.T @ W)
    fresh, constant, fading = (V @ part for part in layout.split(measured.G))
    before = carry.fading_cross * stays[None, :]
    fresh_sum = carry.fresh_sum + fresh @ fresh.T
    constant_sum = carry.constant_sum + constant
    fading_sum = carry.fading_sum + fading @ fading.T + fading @ before.T + before @ fading.T
    cross = before + fading

    unit = jnp.eye(R.shape[0])[:, layout.unknowns]
    spread = jax.scipy.linalg.solve_triangular(R, unit, trans="T")
    by_sum = (measured.T - jnp.outer(measured.up, weight @ measured.H)) @ (spread.T @ spread)
    now, always, faded = layout.split(weight @ measured.G - line.ground)
    up = measured.up
    common = by_sum @ constant_sum + jnp.outer(up, always)
    mixed = jnp.outer(by_sum @ (cross @ faded + fresh @ now), up)
    own = jnp.outer(up, up) * (faded @ faded + now @ now)
    cov = common @ common.T + by_sum @ (fresh_sum + fading_sum) @ by_sum.T + mixed + mixed.T + own
    return (fresh_sum, constant_sum, fading_sum, cross), cov

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

from jaxgeo._compile import batch_filter_jit
from jaxgeo._numerics import dot, safe_sqrt, tree_where
from jaxgeo._typing import Flag, Matrix3, Scalar, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.uncertainty.look_equations import About, Measured, World, measured_at, place_at
from jaxgeo.uncertainty.look_lines import Lines
from jaxgeo.uncertainty.target_motion import AbstractTarget

FLOOR = 1e-8  # of the total variance of a look: least variance of its fresh errors, for models without any
LEAST = 1e-6  # m: least standard deviation of a look
FAR, FAST = 1e8, 1e7  # m, m/s: standard deviations of position and velocity before the first look
AT_ONCE = 1e-7  # least standard deviation of the change of a fading number
UNDETERMINED = 0.1  # of the range: standard deviation of a position that is not determined
EXACT = 1e-12  # share of the variance of an innovation that is the look's own, below which rounding decides


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
    span: Any,
    about: About,
    world: World,
    mode: Mode,
    target: AbstractTarget,
    counts: tuple[int, int, int],
) -> tuple[Carry, AfterLook]:
    """The filter after the looks `span` = (first, last + 1) of a block (leading axis), and its estimates after each;
    zeros for the other looks.

    With `mode.rounds` 0 all looks are linearised `about` one state.
    """
    layout = _Layout(target, counts)

    def step(number: Any, before: tuple[Carry, AfterLook]) -> tuple[Carry, AfterLook]:
        line, is_used = jax.tree.map(lambda x: x[number], (lines, used))
        after, found = _step(before[0], line, is_used, about, world, mode, layout)
        return after, jax.tree.map(lambda whole, one: whole.at[number].set(one), before[1], found)

    carry = jax.tree.map(jnp.asarray, carry)
    look = jax.tree.map(lambda x: x[0], (lines, used))
    _, shape = jax.eval_shape(lambda look: _step(carry, look[0], look[1], about, world, mode, layout), look)
    empty = jax.tree.map(lambda x: jnp.zeros((used.shape[0], *x.shape), x.dtype), shape)
    return jax.lax.fori_loop(span[0], span[1], step, (carry, empty))


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


class _Updated(NamedTuple):
    """A look taken in: R, y and s after it, the look linearised, and its equation right = A s + noise. `W` whitens the
    noise, `noise` (2, z) and `rise` (z,) are its derivatives, and those of the ground's height, by the fresh numbers.
    """

    R: Any
    y: Any
    s: Any
    measured: Measured
    A: Any
    right: Any
    W: Any
    noise: Any
    rise: Any


def _step(
    carry: Carry, line: Lines, used: Flag, given: About, world: World, mode: Mode, layout: _Layout
) -> tuple[Carry, AfterLook]:
    since = line.time - carry.time
    stays = jnp.exp(-since / world.durations)
    new = jnp.maximum(jnp.sqrt(-jnp.expm1(-2.0 * since / world.durations)), AT_ONCE)
    predicted = carry.s.at[: layout.counts[2]].multiply(stays)
    use = jnp.where(used, 1.0, 0.0)

    def again(_: Any, before: tuple[About, Any]) -> tuple[About, _Updated]:
        found = _updated(carry, line, before[0], (stays, new, use), world, mode, layout)
        return About(found.s[layout.unknowns], _reach(found.R, line.time, layout)), found

    about = tree_where(mode.rounds > 0, About(predicted[layout.unknowns], jnp.zeros(())), given)
    _, shape = jax.eval_shape(again, 0, (about, None))
    empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shape)
    about, found = jax.lax.fori_loop(0, jnp.maximum(mode.rounds, 1), again, (about, empty))

    innovation, degrees = _innovation(found, predicted, used, line.distance)
    weight = use * (found.rise @ found.noise.T) @ (found.W.T @ found.W)  # of the look in the fresh error of the ground
    p_ecef, is_known, cov = _position(found, weight, line, world, mode, layout)
    sums, actual = _actual(carry, line, found, weight, stays, use, layout)
    velocity, velocity_cov = _velocity(found, layout)
    position = WGS84.to_geodetic(p_ecef)
    to_enu = R_ecef_from_enu(position).T @ world.R_ecef_from_track
    turned = lambda cov: to_enu @ cov @ to_enu.T  # noqa: E731
    after = AfterLook(
        about,
        position,
        p_ecef,
        turned(cov),
        to_enu @ velocity,
        turned(velocity_cov),
        turned(actual),
        innovation,
        dot(innovation, innovation),
        degrees,
        found.measured.distance,
        is_known,
    )
    return Carry(found.R, found.y, found.s, line.time, *sums), after


def _updated(
    carry: Carry, line: Lines, about: About, change: tuple[Any, Any, Any], world: World, mode: Mode, layout: _Layout
) -> _Updated:
    """The filter with a look, linearised at a state; `change` is how much of the fading numbers stays and is new, and
    whether the look is used."""
    stays, new, use = change
    measured = measured_at(line, about, world, layout.target)
    A, W, noise, rise = _equations(measured, line, mode, layout)
    right = measured.H @ about.state - measured.b
    R, y = _qr_step(carry, stays, new, use * (W @ A), use * (W @ right))
    return _Updated(R, y, jax.scipy.linalg.solve_triangular(R, y), measured, A, right, W, noise, rise)


def _position(
    found: _Updated, weight: Any, line: Lines, world: World, mode: Mode, layout: _Layout
) -> tuple[Vector3, Flag, Matrix3]:
    """(position in ECEF m; whether the ground is known there; covariance in the frame, m2).

    On the terrain it is that of the surface raised by its estimated error, of the shared numbers and of the fresh ones
    of this look.
    """
    s, up = found.s, found.measured.up
    _, constant, fading = layout.split(line.ground)
    rise = jnp.zeros(s.shape[0]).at[: layout.counts[2]].set(mode.shared * fading)
    rise = rise.at[layout.unknowns.stop :].set(mode.shared * constant)
    M = jnp.zeros((3, s.shape[0])).at[:, layout.unknowns].set(found.measured.T)
    M = M + jnp.outer(up, rise - weight @ found.A)
    spread = jax.scipy.linalg.solve_triangular(found.R, M.T, trans="T")
    left = jnp.maximum(found.rise @ found.rise - weight @ (found.noise @ found.rise), 0.0)
    place, is_known = place_at(line, s[layout.unknowns], world, layout.target)
    place = place + up * (rise @ s + weight @ (found.right - found.A @ s))
    cov = spread.T @ spread + jnp.outer(up, up) * left
    return world.origin + world.R_ecef_from_track @ place, is_known, cov


def _reach(R: Any, time: Scalar, layout: _Layout) -> Scalar:
    """Standard deviation in m of the position along a level axis, their mean."""
    target, first = layout.target, layout.unknowns.start
    M = jnp.zeros((2, R.shape[0])).at[:, first : first + 2].set(jnp.eye(2))
    if target.is_moving:
        M = M.at[:, first + target.axes : first + target.axes + 2].set(time * jnp.eye(2))
    return safe_sqrt(0.5 * jnp.sum(jax.scipy.linalg.solve_triangular(R, M.T, trans="T") ** 2))


def _equations(measured: Measured, line: Lines, mode: Mode, layout: _Layout) -> tuple[Any, Any, Any, Any]:
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
    return A, W, noise, ground


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


def _innovation(found: _Updated, predicted: Any, used: Flag, distance: Scalar) -> tuple[Any, Any]:
    """(standardised innovation, number of its components that are determined), zeros for a look that is not used."""
    within = jax.scipy.linalg.solve_triangular(found.R, (found.W @ found.A).T, trans="T")
    own = jnp.eye(2) - within.T @ within
    inverse = found.W.T @ own @ found.W
    values, vectors = jnp.linalg.eigh(0.5 * (inverse + inverse.T))
    determined = used & (values * distance**2 > 1.0) & (jnp.trace(own) > EXACT)
    roots = jnp.sqrt(jnp.where(determined, values, 0.0))
    innovation = vectors @ (roots * (vectors.T @ (found.right - found.A @ predicted)))
    return innovation, jnp.sum(determined)


def _velocity(found: _Updated, layout: _Layout) -> tuple[Vector3, Matrix3]:
    """(velocity in the frame, m/s; its covariance)."""
    if not layout.target.is_moving:
        return jnp.zeros(3), jnp.zeros((3, 3))
    axes = layout.target.axes
    T = found.measured.T[:, :axes]
    first = layout.unknowns.start + axes
    M = jnp.zeros((3, found.s.shape[0])).at[:, first : first + axes].set(T)
    spread = jax.scipy.linalg.solve_triangular(found.R, M.T, trans="T")
    return T @ found.s[first : first + axes], spread.T @ spread


def _actual(
    carry: Carry, line: Lines, found: _Updated, weight: Any, stays: Any, use: Any, layout: _Layout
) -> tuple[tuple[Any, Any, Any, Any], Matrix3]:
    """(sums of the filter that takes all errors for fresh; actual covariance of its position).

    Its estimate errs by P times the sum of H' W' W G z over the looks, where P is the covariance that it claims.
    """
    measured = found.measured
    V = use * measured.H.T @ (found.W.T @ found.W)
    fresh, constant, fading = (V @ part for part in layout.split(measured.G))
    before = carry.fading_cross * stays[None, :]
    fresh_sum = carry.fresh_sum + fresh @ fresh.T
    constant_sum = carry.constant_sum + constant
    fading_sum = carry.fading_sum + fading @ fading.T + fading @ before.T + before @ fading.T
    cross = before + fading

    unit = jnp.eye(found.R.shape[0])[:, layout.unknowns]
    spread = jax.scipy.linalg.solve_triangular(found.R, unit, trans="T")
    by_sum = (measured.T - jnp.outer(measured.up, weight @ measured.H)) @ (spread.T @ spread)
    now, always, faded = layout.split(weight @ measured.G - line.ground)
    up = measured.up
    common = by_sum @ constant_sum + jnp.outer(up, always)
    mixed = jnp.outer(by_sum @ (cross @ faded + fresh @ now), up)
    own = jnp.outer(up, up) * (faded @ faded + now @ now)
    cov = common @ common.T + by_sum @ (fresh_sum + fading_sum) @ by_sum.T + mixed + mixed.T + own
    return (fresh_sum, constant_sum, fading_sum, cross), cov

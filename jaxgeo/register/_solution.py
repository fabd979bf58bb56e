"""Iterative least squares of the orientation update, with the prior as observations.

A loop of its own, without a `solver` argument: each step composes rotations and is applied to the exposure, weights are
those of the step, and ties keep their terrain cell after `HELD` steps, none of which a general solver of one vector of
unknowns does. On the tests' 20 sets of ties on rough terrain all converge here, in 11 steps; of optimistix's solvers
`GaussNewton` converges in 10, `LevenbergMarquardt` in all 20 in twice the steps, with a first call of the same time
(15 s of processor time) and answers 0.002 standard deviations off (`benchmarks/solvers.py`).
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxgeo._compile import batch_filter_jit
from jaxgeo._numerics import all_finite
from jaxgeo._typing import Flag, Scalar, StatusCode
from jaxgeo.adjust.losses import Cauchy, Tukey
from jaxgeo.earth import Geodetic
from jaxgeo.observation import Exposure
from jaxgeo.register._equations import Equations, Problem, Square, Unknowns, cells_of, equations_about, with_heights
from jaxgeo.register.tie_errors import Blocks, Pixels, Weights, squared_length
from jaxgeo.status import Status, first_failure, status_where
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.terrain.field import AbstractField

MOST_STEPS = 60
HELD = 8  # steps; then ties keep their terrain cell, as slope discontinuities can prevent convergence
CLOSE_ENOUGH = 1e-5  # standard deviations of the unknowns: longest last step; rounding of ties to 1 mm gives about 1e-6
ROUNDING = 1e-9  # relative increase of the sum of squares that a step may cause
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-7


class State(NamedTuple):
    """Current estimate, its offset from the prior mean in standard deviations, and the next trial step."""

    exposure: Any
    place: Unknowns
    equations: Equations
    step: Unknowns
    damping: Scalar
    settled: Flag
    done: Flag
    count: Int[Array, ""]


class Solution(NamedTuple):
    """Result of an update with padded ties; `predicted` is the prior uncertainty of the ties in their standard
    deviations."""

    exposure: Exposure
    terrain: AbstractTerrain | None
    field: AbstractField | None
    unknowns: Unknowns
    covariance: Square
    residuals: Pixels
    normalised: Pixels
    cov_residuals: Blocks
    weights: Weights
    chi_square_ties: Scalar
    chi_square_prior: Scalar
    determined: Scalar
    predicted: Scalar
    steps: Int[Array, ""]
    has_ground: Bool[Array, " ties"]
    status: StatusCode


@batch_filter_jit
def solve(problem: Problem) -> Solution:
    """Orientation update from validated input."""
    problem, factor = with_heights(problem), problem.prior.factor()
    start = problem.model.moved(problem.inputs, jnp.asarray(problem.prior.mean)[:-2]).exposure
    dynamic, static = eqx.partition(start, eqx.is_array)

    def iterate(state: State) -> State:
        return _iterate(problem, factor, state, static)

    def goes_on(state: State) -> Flag:
        return ~state.done & (state.count < MOST_STEPS)

    zero = jnp.zeros(factor.shape[0])
    of_start = eqx.filter_eval_shape(lambda: equations_about(problem, factor, start, zero, jnp.asarray(False)))
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), of_start)
    settled = jnp.asarray(not isinstance(problem.loss, Tukey | Cauchy))
    first = State(dynamic, zero, blank, zero, jnp.asarray(0.0), settled, jnp.asarray(False), jnp.asarray(0))
    state = jax.lax.while_loop(goes_on, iterate, first)
    return _result(problem, factor, state, eqx.combine(state.exposure, static))


def _iterate(problem: Problem, factor: Square, state: State, static: Any) -> State:
    """One step: accepted if the sum of squares decreases, otherwise shortened for the next trial."""
    kept = eqx.combine(state.exposure, static)
    change = (factor @ state.step)[:-2]
    moved = problem.model.moved(dataclasses.replace(problem.inputs, exposure=kept), change).exposure
    place = state.place + state.step
    old = state.equations
    cells = jnp.where(state.count < HELD, cells_of(problem, place, factor), old.cells)
    equations = equations_about(problem, factor, moved, place, state.settled, cells)
    before = squared_length(old.whiten(old.residuals[:, :, None])) + jnp.sum(state.place**2)
    after = squared_length(old.whiten(equations.residuals[:, :, None])) + jnp.sum(place**2)
    is_first = state.count == 0
    taken = is_first | (after <= before * (1.0 + ROUNDING))
    dynamic, _ = eqx.partition(moved, eqx.is_array)
    choose = lambda new, was: jnp.where(taken, new, was)  # noqa: E731
    dynamic, place, equations = jax.tree.map(
        choose, (dynamic, place, equations), (state.exposure, state.place, state.equations)
    )
    less = jnp.where(state.damping > LEAST_DAMPING, 0.1 * state.damping, 0.0)
    damping = jnp.where(taken, less, jnp.maximum(10.0 * state.damping, FIRST_DAMPING))

    normal = equations.normal
    damped = normal + damping * jnp.diag(jnp.diagonal(normal))
    step = -jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(damped), True), equations.gradient)
    is_short = taken & (step @ normal @ step <= CLOSE_ENOUGH**2)
    step = jnp.where(is_short, 0.0, step)  # with a new loss, the first step starts from the last solution
    stuck = ~jnp.all(jnp.isfinite(step))
    done = is_short & state.settled | stuck
    return State(dynamic, place, equations, step, damping, state.settled | is_short, done, state.count + 1)


def _has_ground(problem: Problem) -> Bool[Array, " ties"]:
    terrain, ties = problem.inputs.terrain, problem.ties
    if not isinstance(terrain, Dem) or ties.rise is not None:
        return jnp.ones_like(ties.used)
    at = lambda lat, lon: terrain.height_at(Geodetic(lat=lat, lon=lon, height=jnp.zeros_like(lat)))  # noqa: E731
    return jnp.isfinite(jax.vmap(at)(ties.lat, ties.lon)) | ~ties.used


def _result(problem: Problem, factor: Square, state: State, exposure: Exposure) -> Solution:
    """Solution from the last state; all numbers are NaN unless the status is `hit`."""
    equations, ties = state.equations, problem.ties
    unknowns = jnp.asarray(problem.prior.mean) + factor @ state.place
    root = jnp.linalg.cholesky(equations.normal)
    inverse = jax.scipy.linalg.cho_solve((root, True), jnp.eye(root.shape[0]))
    half = jax.scipy.linalg.solve_triangular(root, factor.T, lower=True)
    whitened = equations.whiten(equations.residuals[:, :, None])
    sigma = jnp.sqrt(jnp.stack([equations.covariances[:, 0, 0], equations.covariances[:, 1, 1]], axis=1))
    most = jnp.max(jnp.where(ties.used, equations.weights, 0.0))
    information = jnp.maximum(jnp.trace(equations.normal) - root.shape[0], 0.0)
    predicted = jnp.sqrt(information / jnp.where(most > 0.0, most, 1.0))

    has_ground = _has_ground(problem)
    is_found = state.done & all_finite((unknowns, equations.normal, equations.residuals))
    is_sound = all_finite((ties, problem.prior)) & jnp.all(has_ground)
    status = first_failure(
        status_where(is_sound, Status.hit, Status.invalid_input.code),
        equations.status,
        status_where(is_found, Status.hit, Status.not_converged.code),
    )
    ok = status == Status.hit
    known = lambda tree: jax.tree.map(  # noqa: E731
        lambda x: jnp.where(ok, x, jnp.nan) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree
    )
    dynamic, static = eqx.partition(exposure, eqx.is_array)
    unknowns = known(unknowns)
    terrain: Any = problem.model.moved(problem.inputs, unknowns[:-2]).terrain
    is_dem = isinstance(terrain, Dem)
    return Solution(
        eqx.combine(known(dynamic), static),
        None if is_dem else terrain,
        terrain.field if is_dem else None,
        unknowns,
        known(half.T @ half),
        known(equations.residuals),
        known(equations.residuals / sigma),
        known(equations.covariances),
        known(equations.weights),
        known(squared_length(whitened)),
        known(jnp.sum(state.place**2)),
        known(root.shape[0] - jnp.trace(inverse)),
        predicted,
        state.count,
        has_ground,
        status,
    )

"""Bundle adjustment of a block, with free-network datum and checks for rank defects."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import portable
from jaxgeo._renamed import renamed_argument
from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.datum import Whole, motions, observed_whole, unheld
from jaxgeo.adjust.diagnosis import Diagnosis, diagnosed
from jaxgeo.adjust.equations import linearised
from jaxgeo.adjust.kept import Kept, block_of, masked, set_aside
from jaxgeo.adjust.losses import AbstractLoss, Cauchy, LeastSquares
from jaxgeo.adjust.observing import Observing
from jaxgeo.adjust.posterior import Datum, least_share
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.rank_defects import DeficientBlock, Direction, datum_words, weakest_directions
from jaxgeo.adjust.refined import refined
from jaxgeo.adjust.screening import SIGMAS, Screen, screened_of
from jaxgeo.adjust.solve import Iteration, Solution, Solver, solve
from jaxgeo.adjust.terrain_heights import HeightObservations
from jaxgeo.adjust.tie_start import placed, start_by_ties, taken_back
from jaxgeo.adjust.unknowns import Unknowns
from jaxgeo.adjust.weak_datum import share_left

SINGULAR = 1e-12  # eigenvalues of the normal equations scaled to a unit diagonal; smaller ones count as unconstrained
NEAREST = 50  # iterations that align a free network with its start


POOR_STARTS = (
    "The orientations that it starts from are poor, for their rays miss each other in general: better ones may be all "
    "that it needs, and what disagrees with these may be right."
)


@portable
class NotConverged(RuntimeError):
    """The iterations did not converge: `log` lists them, `diagnosis` the outliers at the last one, `screened` the
    measurements set aside before."""

    def __init__(self, solution: Solution, diagnosis: Diagnosis, screened: Screen) -> None:
        self.log, self.diagnosis, self.screened = solution.log, diagnosis, screened.aside
        last = solution.log[-1]
        before = f" Set aside before the first iteration: {screened.words()}." if screened.aside else ""
        if screened.poor:
            before = f" {POOR_STARTS}{before}"
        super().__init__(
            f"the adjustment has not converged in {last.number} iterations; the cost is {last.cost:.6g}, the last step "
            f"predicted a decrease of {last.predicted_decrease:.3g}.{before} {diagnosis}"
        )


@portable
class BehindCamera(ValueError):
    """Points behind a camera that measured them, or outside the field of its lens: `rows` of the observations."""

    def __init__(self, block: Block, rows: np.ndarray) -> None:
        self.rows = rows
        observations, first = block.observations, rows[0]
        super().__init__(
            f"point {observations.point[first]} has come to lie behind image {observations.image[first]}, or beyond "
            f"the field of its lens, though it was measured there in row {first} ({len(rows)} such "
            f"measurements): its rays do not meet in front of the cameras. Leave these rows out (error.rows), or "
            f"correct the orientations to start from."
        )


@dataclass(frozen=True)
class InnerConstraints:
    """Free network datum: unconstrained motions of the whole (position, orientation, scale) are fixed so that the
    points keep their start positions in the least-squares sense; the point covariances have minimum trace over all
    datums.
    """


@renamed_argument("told", "callback")
def adjust(
    block: Block,
    unknowns: Unknowns | None = None,
    *,
    loss: AbstractLoss | None = None,
    datum: InnerConstraints | None = None,
    terrain: HeightObservations | None = None,
    solver: Solver | None = None,
    callback: Callable[[Iteration], Any] | None = None,
    screen: float | None = SIGMAS,
) -> Adjustment:
    """Bundle adjustment: maximum-likelihood orientations, points and calibrations of a block.

    Least squares over image points, control, navigation and priors, each with its own covariance (Xue et al. 2019, Eqs
    1 and 3-5). A `loss` applies to image points and control. `terrain` adds observations of the points' heights on a
    terrain model (`HeightObservations`). `callback` is called with every iteration. The bending of rays is that at the
    solution, from which the iterations continue once.

    Before the first iteration, image points and control that disagree with all others by more than `screen` standard
    deviations are set aside, with a `RuntimeWarning`; the adjustment's `screened` lists them. Those that agree with the
    adjusted block are restored. None disables screening.

    Raises `DeficientBlock`, with a description, for unconstrained unknowns: a missing datum (without control and
    navigation, unless `datum` requests a free network) or any other combination. Raises `NotConverged`, with the log
    and a diagnosis; `BehindCamera` for adjusted points that their cameras cannot see; `ControlElsewhere` if all control
    is displaced; and `ValueError` as `Unknowns` and `Block`.
    """
    unknowns, loss = Unknowns() if unknowns is None else unknowns, LeastSquares() if loss is None else loss
    screened, start = screened_of(block, unknowns, screen), None
    if screen is not None and screened.poor and block.control is not None:
        ready = prepared(block, unknowns, terrain, set_aside(block, screened.kept))
        screened, start = start_by_ties(block, ready, screened, screen)
        screened = replace(screened, poor=True)
    full = prepared(block, unknowns, terrain, set_aside(block, screened.kept))
    _check_datum(full, datum)
    ready = masked(block, full, screened.kept)
    solution = solve(ready.problem, loss, solver, callback, start)
    if screen is not None and screened.aside and solution.converged:
        before, screened = screened, taken_back(block, full, solution.values, screened, screen)
        if len(screened.aside) < len(before.aside):
            full = prepared(block, unknowns, terrain, set_aside(block, screened.kept))
            ready = masked(block, full, screened.kept)
            start = placed(block, full, solution.values, before.kept, screened.kept)
            solution = solve(ready.problem, loss, solver, callback, start).after(solution)
    ready, solution = refined(ready, solution, loss, solver, callback)
    found = _unless_deficient(block_of(block, screened.kept), unknowns, ready, solution, loss, datum, screened)
    if found is None:  # the start was too poor to judge what the block needs
        assert screen is not None  # without it nothing is set aside
        whole = prepared(block, unknowns, terrain)
        start = placed(block, whole, solution.values, screened.kept, Kept.all(block))
        robust = solve(whole.problem, Cauchy(), solver, callback, start)
        screened = taken_back(block, whole, robust.values, screened, screen)
        ready = masked(block, prepared(block, unknowns, terrain, set_aside(block, screened.kept)), screened.kept)
        solution = solve(ready.problem, loss, solver, callback, robust.values)
        ready, solution = refined(ready, solution, loss, solver, callback)
        found = adjusted(block_of(block, screened.kept), unknowns, ready, solution, loss, datum, screened)
    if screened.aside:
        warnings.warn(
            f"set aside before the first iteration: {screened.words()}. Correct or leave them out; "
            f"adjust(..., screen=None) keeps them.",
            RuntimeWarning,
            stacklevel=2,
        )
    return found


def _check_datum(ready: Prepared, datum: InnerConstraints | None) -> None:
    """Refuse a free network of rays that depend on the velocity and on the vertical."""
    if datum is not None and ready.problem.effects is not None:
        raise ValueError(
            "datum=InnerConstraints() takes rays that do not depend on where the whole lies; those of a readout depend "
            "on the velocity of the navigation, refracted ones on the vertical. Give navigation or control."
        )


def _unless_deficient(block: Block, *given: Any) -> Adjustment | None:
    """As `adjusted`, but None for a deficient block of which something is set aside."""
    screened: Screen = given[-1]
    try:
        return adjusted(block, *given)
    except DeficientBlock:
        if not screened.aside:
            raise
        return None


def adjusted(
    block: Block,
    unknowns: Unknowns,
    ready: Prepared,
    solution: Solution,
    loss: AbstractLoss,
    datum: InnerConstraints | None,
    screened: Screen,
) -> Adjustment:
    """`Adjustment` from the solution of a block, if it is determined and its points are visible. Raises as `adjust`."""
    _check_datum(ready, datum)
    observed, whole = _observed_whole(ready, solution)
    if solution.converged:
        _check_parallax(block, ready, solution, observed)
    rows = unheld(whole)
    if len(rows) and datum is None:
        words = datum_words(rows)
        raise DeficientBlock(
            f"nothing holds the {'; '.join(words)}. Give control or navigation that does, or adjust a free network "
            f"with datum=InnerConstraints().{_in_parts(block)}",
            [Direction(word, 0.0, {}) for word in words],
        )
    if not solution.converged:  # before convergence, rank defects could be the cause
        raise NotConverged(solution, diagnosed(block, unknowns, ready, solution, screened), screened)
    held = None
    if len(rows):
        solution = _at_start(ready, solution, loss, rows)
        rows = unheld(_observed_whole(ready, solution)[1])
        held = _datum(ready.problem, solution.values, jnp.asarray(rows))
    adjustment = Adjustment(block, unknowns, ready, solution, loss, held, screened.aside)
    posterior = adjustment.posterior
    is_held = posterior.weak is None or float(share_left(posterior.weak)[0][0]) >= SINGULAR
    if not is_held or not float(least_share(ready.problem, posterior)) >= 10.0 * SINGULAR:  # or it is made of rounding
        weak = [
            found for found in weakest_directions(ready, solution, 6, held, posterior.weak) if found.strength < SINGULAR
        ]
        words = "; ".join(str(direction) for direction in weak) or "the normal equations"
        raise DeficientBlock(
            f"the block does not hold {words}. Fix some of it, or give priors.{_in_parts(block)}", weak
        )
    lost = np.flatnonzero(~adjustment.visible)
    if len(lost):
        raise BehindCamera(block, lost)
    return adjustment


def _check_parallax(block: Block, ready: Prepared, solution: Solution, observed: Observing) -> None:
    """Refuse points that are unconstrained along their rays, independently of the cameras."""
    least = _least_of_points(ready, solution, observed)
    lost = np.flatnonzero(~(least >= SINGULAR))
    if len(lost) == 0:
        return
    names = ready.names.point[lost]
    observations = block.observations
    first = ", ".join(np.unique(observations.image[observations.point == names[0]]).tolist()[:4])
    raise DeficientBlock(
        f"nothing holds the distance of point {names[0]}: its rays, of images {first}, are parallel ({len(lost)} such "
        f"points). Leave it out, or give images from further apart, control or terrain.",
        [Direction(f"distance of point {name}", float(least[i]), {}) for i, name in zip(lost, names, strict=True)],
    )


def _least_of_points(ready: Prepared, solution: Solution, observed: Observing) -> np.ndarray:
    """Smallest eigenvalue of each point's normal matrix (m,), all observations with unit weight."""
    own = ready.order.row_of_point
    free = np.asarray(ready.problem.free_point)[own]
    weighted, alike = (x[own] * free[:, None, :] for x in _observed_points(observed))
    normal = np.moveaxis(np.asarray(solution.equations.points), -1, 0)[own]
    of_images = (normal - np.einsum("mki,mkj->mij", weighted, weighted)) * free[:, :, None] * free[:, None, :]
    size = np.trace(of_images, axis1=1, axis2=2)[:, None, None]
    total = of_images / np.where(size > 0.0, size, 1.0) + np.einsum("mki,mkj->mij", alike, alike)
    return np.linalg.eigvalsh(total + np.eye(3) * (1.0 - free)[:, None, :])[:, 0]


def _in_parts(block: Block) -> str:
    """A sentence if the block is disconnected, else empty."""
    parts = block.parts()
    if len(parts) == 1:
        return ""
    named = "; ".join(f"{len(part)} images, image {part[0]} among them" for part in parts[:3])
    return f" No point joins the {len(parts)} parts of the block ({named}{'; ...' if len(parts) > 3 else ''})."


def _observed_whole(ready: Prepared, solution: Solution) -> tuple[Observing, Whole]:
    return observed_whole(ready.problem, solution.values, solution.equations.control_root)


def _observed_points(observed: Observing) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of control and terrain by each point (rows, 4, 3), with their weights and with unit weights."""
    weighted = np.concatenate([observed.control, observed.terrain[:, None]], axis=1)
    weights = np.concatenate([observed.weights[0], observed.weights[1][:, None]], axis=1)[:, :, None]
    return weighted, np.where(weights > 0.0, weighted / np.where(weights > 0.0, weights, 1.0), 0.0)


@sized_filter_jit
def _datum(problem: Any, values: Any, rows: Any) -> Datum:
    z, x = motions(problem, values)
    return Datum(jnp.einsum("dm,mnc->dnc", rows, z), jnp.einsum("dm,mir->dir", rows, x))


def _at_start(ready: Prepared, solution: Solution, loss: AbstractLoss, rows: np.ndarray) -> Solution:
    """A free network transformed so that its points fit their start positions in the least-squares sense.

    Only the unconstrained motions, `rows` (d, 7) of `MOTIONS`, are applied.
    """
    values, problem = solution.values, ready.problem
    own = ready.order.row_of_point
    scale, R, shift = nearest(np.asarray(values.points)[own], np.asarray(problem.start.points)[own], rows)
    points = np.asarray(values.points) @ R.T * scale + shift
    centre = np.asarray(values.centre) @ R.T * scale + shift
    turned = R @ np.asarray(values.R_frame_from_camera)
    changed = (jnp.asarray(centre), jnp.asarray(turned), jnp.asarray(points))
    values = eqx.tree_at(lambda v: (v.centre, v.R_frame_from_camera, v.points), values, changed)
    return Solution(values, linearised(problem, values, loss), solution.log, solution.converged)


def nearest(source: np.ndarray, target: np.ndarray, rows: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(scale, rotation, shift) of points (m, 3) that best fit `target`, restricted to combinations (d, 7) of
    `MOTIONS`."""
    import scipy  # submodules load lazily

    middle = np.median(source, axis=0)  # as in `motions`
    offsets, goal = source - middle, target - middle
    size = np.sqrt(np.median(np.sum(offsets**2, axis=1)))
    generators = np.zeros((len(rows), 4, 4))  # of the similarity group; the unconstrained motions form a subgroup
    for generator, row in zip(generators, rows / np.abs(rows).max(axis=1, keepdims=True), strict=True):
        x, y, z = row[3:6] / size
        generator[:3, :3] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) + np.eye(3) * row[6] / size
        generator[:3, 3] = row[:3]
    total = np.eye(4)
    for _ in range(NEAREST):
        moved = offsets @ total[:3, :3].T + total[:3, 3]
        along = np.stack([(moved @ g[:3, :3].T + g[:3, 3]).ravel() for g in generators], axis=1)
        step = np.linalg.lstsq(along, (goal - moved).ravel(), rcond=None)[0]
        total = scipy.linalg.expm(np.einsum("d,dij->ij", step, generators)) @ total
        if np.linalg.norm(along @ step) <= 1e-12 * size:
            break
    scale = float(np.cbrt(np.linalg.det(total[:3, :3])))
    R = total[:3, :3] / scale
    return scale, R, middle + total[:3, 3] - scale * R @ middle

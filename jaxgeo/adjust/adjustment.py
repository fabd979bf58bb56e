"""Bundle adjustment: from a block to orientations, points and calibrations, with their covariances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust.block import Block, Images
from jaxgeo.adjust.datum import motions, unheld
from jaxgeo.adjust.equations import free_columns, image_residuals, navigation_residuals
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.losses import AbstractLoss, LeastSquares
from jaxgeo.adjust.posterior import (
    Datum,
    Posterior,
    covariance_of_points,
    covariance_of_reduced,
    posterior_of,
)
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.reduction import back_substituted, eliminated, reduced
from jaxgeo.adjust.solve import Iteration, Solution, Solver, equations_at, solve
from jaxgeo.adjust.unknowns import Unknowns
from jaxgeo.adjust.values import POSE, with_interior
from jaxgeo.adjust.weakness import DeficientBlock, Direction, datum_words, described
from jaxgeo.sensor import FrameCamera, Mount

SINGULAR = 1e-12  # eigenvalues of the normal equations, scaled to ones on the diagonal: below it nothing holds them
DIRECTIONS = 1500  # unknowns up to which weak directions are looked for among all


@dataclass(frozen=True)
class InnerConstraints:
    """A free network: what nothing holds of the whole (position, orientation, scale) is taken such that the points
    stay, in the mean square, where they started; their covariances are the least that any datum gives."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a camera, a mount or a strip: its value and standard deviation (of unit weight), and the prior's
    (infinite for none)."""

    whose: str
    name: str
    value: float
    sigma: float
    prior: float


@dataclass(frozen=True)
class Adjustment:
    """What an adjustment found.

    `images`, `points` (with covariances), `cameras` and `mounts` are the adjusted ones, in the block's frame. All
    covariances are of unit weight: of observations that are as good as their standard deviations say; times
    `sigma0` squared they are as good as the residuals say.
    """

    block: Block
    unknowns: Unknowns
    prepared: Prepared
    solution: Solution
    loss: AbstractLoss
    datum: Datum | None = field(default=None, repr=False)

    @property
    def log(self) -> tuple[Iteration, ...]:
        """The iterations, from the start on."""
        return self.solution.log

    @property
    def converged(self) -> bool:
        """Whether the iterations came to an end."""
        return self.solution.converged

    @property
    def cost(self) -> float:
        """Half the (robust) sum of squares of all weighted residuals."""
        return self.solution.log[-1].cost

    @cached_property
    def redundancy(self) -> int:
        """Observations, priors among them, less unknowns, and the datum's constraints."""
        return self.observations - self.unknown_count + (0 if self.datum is None else self.datum.reduced.shape[0])

    @cached_property
    def observations(self) -> int:
        """Numbers that are observed, or known beforehand with a standard deviation."""
        problem, order = self.prepared.problem, self.prepared.order
        known = np.asarray(problem.known_point)[order.row_of_point]
        count = 2 * len(self.block.observations) + int(np.sum(np.any(known != 0.0, axis=2)))
        if problem.observed is not None:
            for weights in (problem.observed.information_position, problem.observed.information_attitude):
                count += int(np.sum(np.any(np.asarray(weights) != 0.0, axis=2)))
        if problem.terrain is not None:
            count += int(np.sum(np.asarray(problem.terrain.information) > 0.0))
        return count + sum(
            int(np.sum(np.asarray(x.information) > 0.0)) for x in (problem.lens, problem.mount, problem.strip)
        )

    @cached_property
    def unknown_count(self) -> int:
        """Unknowns."""
        problem = self.prepared.problem
        images, shared = free_columns(problem)
        return int(np.sum(images) + np.sum(shared) + np.sum(problem.free_point))

    @cached_property
    def sigma0(self) -> float:
        """Standard deviation of unit weight: 1 where residuals are as large as the observations' sigmas say.

        With a robust loss, of the weights that it leaves. NaN without redundancy.
        """
        weighted = self._weighted_squares
        return float(np.sqrt(weighted / self.redundancy)) if self.redundancy > 0 else float("nan")

    @cached_property
    def _weighted_squares(self) -> float:
        squared = np.sum(np.asarray(self._image_residuals) ** 2, axis=0)
        robust = float(np.sum(np.asarray(self.loss.rho(jnp.asarray(squared)))))
        weights = np.asarray(self.loss.weight(jnp.asarray(squared)))
        return 2.0 * self.cost - robust + float(np.sum(weights * squared))

    @cached_property
    def _image_residuals(self) -> jax.Array:
        return image_residuals(self.prepared.problem, self.solution.values)

    @cached_property
    def residuals(self) -> np.ndarray:
        """Residuals of the image points (k, 2) in px, adjusted less measured, in the order of the observations."""
        weighted = np.asarray(self._image_residuals).T[self.prepared.order.place]
        return weighted * self.block.observations.sigma

    @cached_property
    def navigation_residuals(self) -> np.ndarray | None:
        """Residuals of the navigation (n, 6) over their standard deviations: position, attitude."""
        if self.prepared.problem.observed is None:
            return None
        return np.asarray(navigation_residuals(self.prepared.problem, self.solution.values))

    @cached_property
    def images(self) -> Images:
        """The adjusted exterior orientations."""
        values = self.solution.values
        given = self.block.images
        return Images(given.name, given.camera, np.asarray(values.centre), np.asarray(values.R_frame_from_camera))

    @cached_property
    def cameras(self) -> dict[str, FrameCamera]:
        """The cameras with their adjusted interior orientations and lenses."""
        lenses = zip(self.prepared.names.camera, self.solution.values.lens, strict=True)
        return {name: with_interior(self.block.cameras[name], lens) for name, lens in lenses}

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """The mounts with their adjusted boresights and lever arms, as a `Sensor` takes them."""
        navigation, values = self.block.navigation, self.solution.values
        if navigation is None:
            return {}
        found = {}
        for i, name in enumerate(self.prepared.names.mount):
            mount, level = navigation.mounts[name]
            turn = np.asarray(values.boresight[i])
            turned = (lambda m: m.R_head_from_camera) if level else (lambda m: m.R_body_from_base)
            mount = eqx.tree_at(turned, mount, turn @ np.asarray(turned(mount), np.float64))
            found[name] = eqx.tree_at(lambda m: m.lever_body, mount, np.asarray(values.lever[i]))
        return found

    @cached_property
    def strips(self) -> dict[str, np.ndarray]:
        """Shift (m) and drift (m/s), east, north and up of the frame, of the navigation's positions in each strip."""
        return dict(zip(self.prepared.names.strip, np.asarray(self.solution.values.strip), strict=True))

    @cached_property
    def points(self) -> GroundPoints:
        """The adjusted points that were measured, with covariances of unit weight."""
        rows = self.prepared.order.row_of_point
        covariance = np.asarray(covariance_of_points(self.prepared.problem, self.posterior))[rows]
        free = np.asarray(self.prepared.problem.free_point)[rows] > 0.0
        covariance = covariance * free[:, :, None] * free[:, None, :]
        place = np.asarray(self.solution.values.points)[rows]
        found = GroundPoints(self.prepared.names.point, place, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
        object.__setattr__(found, "covariance", 0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
        return found

    @cached_property
    def places(self) -> dict[str, np.ndarray]:
        """The adjusted places of the points by name, m."""
        rows = self.prepared.order.row_of_point
        return dict(zip(self.prepared.names.point.tolist(), np.asarray(self.solution.values.points)[rows], strict=True))

    @cached_property
    def posterior(self) -> Posterior:
        """The inverse of the reduced normal equations, from which all covariances come."""
        return posterior_of(self.prepared.problem, self.solution.equations, self.datum)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (N, N) of all orientations, image by image, and then of what images share (`columns`)."""
        return np.asarray(covariance_of_reduced(self.prepared.problem, self.posterior))

    @cached_property
    def columns(self) -> list[tuple[str, str]]:
        """(whose, what) of each row and column of `covariance`."""
        problem, names = self.prepared.problem, self.prepared.names
        own = [f"centre {axis}" for axis in "xyz"] + [f"turn {axis}" for axis in "xyz"]
        own += list(names.lens) if problem.own_lens else []
        return [(f"image {image}", what) for image in names.image for what in own] + names.columns(problem)

    @cached_property
    def covariance_of_images(self) -> np.ndarray:
        """Covariance (n, 6, 6) of each orientation: centre in m (frame axes), turn in rad about the camera's axes."""
        n, c = self.prepared.problem.n, self.prepared.problem.of_image
        at = np.arange(n)[:, None] * c + np.arange(POSE)[None, :]
        return self.covariance[at[:, :, None], at[:, None, :]]

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Everything that is unknown of cameras, mounts and strips, with standard deviations of unit weight."""
        problem, names, values = self.prepared.problem, self.prepared.names, self.solution.values
        known = {
            "camera": (names.camera, values.lens, problem.lens),
            "mount": (names.mount, self._of_mounts, problem.mount),
        }
        known["strip"] = (names.strip, values.strip, problem.strip)
        found = []
        for at, whose, name, kind, row, column in self._parameter_columns:
            _, numbers, prior = known[kind]
            if not float(prior.free[row, column]):
                continue
            entry = problem.active[column] if kind == "camera" else column
            information = float(prior.information[row, column])
            sigma = float(np.sqrt(self.covariance[at, at]))
            value = float(np.asarray(numbers)[row, entry])
            found.append(Parameter(whose, name, value, sigma, 1.0 / information if information else float("inf")))
        return found

    @cached_property
    def _of_mounts(self) -> np.ndarray:
        """Turn of the boresight from where it started (rotation vector, rad) and lever arm, m."""
        from jaxgeo.rotations import rotation_vector_from_R

        values = self.solution.values
        return np.concatenate([np.asarray(jax.vmap(rotation_vector_from_R)(values.boresight)), values.lever], axis=1)

    @property
    def _parameter_columns(self) -> list[tuple[int, str, str, str, int, int]]:
        """(place in `covariance`, whose, what, kind, row, column) of each parameter."""
        problem, names = self.prepared.problem, self.prepared.names
        found = []
        if problem.own_lens:
            for image, camera in enumerate(np.asarray(problem.layout.camera)):
                for column, lens in enumerate(names.lens):
                    at = image * problem.of_image + POSE + column
                    found.append((at, f"camera {names.camera[camera]}", lens, "camera", int(camera), column))
        at = problem.n * problem.of_image
        sizes = {"camera": len(names.lens), "mount": 6, "strip": 6}
        counts: dict[str, int] = {}
        for offset, (whose, what) in enumerate(names.columns(problem)):
            kind = whose.split()[0]
            row, column = divmod(counts.get(kind, 0), sizes[kind])
            counts[kind] = counts.get(kind, 0) + 1
            found.append((at + offset, whose, what, kind, row, column))
        return found

    @cached_property
    def correlations(self) -> np.ndarray:
        """Correlations (k, k) between the `parameters`."""
        free = {(p.whose, p.name) for p in self.parameters}
        at = [entry[0] for entry in self._parameter_columns if entry[1:3] in free]
        covariance = self.covariance[np.ix_(at, at)]
        sigma = np.sqrt(np.diagonal(covariance))
        return covariance / np.outer(sigma, sigma)

    def differences(self, points: GroundPoints) -> np.ndarray:
        """Adjusted less given places (m, 3) of points to check with, m. Raises `ValueError` for one not measured."""
        places = self.places
        missing = [name for name in points.name.tolist() if name not in places]
        if missing:
            raise ValueError(f"point {missing[0]} was measured in no image, so there is nothing to check.")
        return np.array([places[name] for name in points.name.tolist()]) - points.place

    def weak_directions(self, most: int = 3) -> list[Direction]:
        """The combinations of unknowns that are held least, the weakest first, in words."""
        return _weakest(self.prepared, self.solution, most)


def adjust(
    block: Block,
    unknowns: Unknowns | None = None,
    *,
    loss: AbstractLoss | None = None,
    datum: InnerConstraints | None = None,
    terrain: Any = None,
    solver: Solver | None = None,
    told: Callable[[Iteration], Any] | None = None,
) -> Adjustment:
    """The orientations, points and calibrations under which a block's observations are most likely.

    Least squares over image points, control, navigation and priors, each with its own covariance (Xue et al. 2019,
    Eqs 1 and 3-5), image points with a `loss` if that is given. `terrain` ties points to a model of the ground
    (`TerrainHeights`). `told` hears of every iteration.

    Raises `DeficientBlock`, in words, where something is not held: without control and navigation, unless `datum` asks
    for a free network; and for any other combination of unknowns. Raises `ValueError` as `Unknowns` and `Block`.
    """
    unknowns, loss = Unknowns() if unknowns is None else unknowns, LeastSquares() if loss is None else loss
    ready = prepared(block, unknowns, terrain)
    solution = solve(ready.problem, loss, solver, told)
    rows = np.asarray(_unheld(ready.problem, solution.values, solution.equations))
    rows = rows[np.any(rows != 0.0, axis=1)]
    if len(rows) and datum is None:
        words = datum_words(rows)
        raise DeficientBlock(
            f"nothing holds the {'; '.join(words)}. Give control or navigation that does, or adjust a free network "
            f"with datum=InnerConstraints().",
            [Direction(word, 0.0, {}) for word in words],
        )
    held = None
    if len(rows):
        solution = _at_start(ready, solution, loss)
        held = _datum(ready.problem, solution.values, jnp.asarray(rows))
    adjustment = Adjustment(block, unknowns, ready, solution, loss, held)
    if not np.all(np.isfinite(np.diagonal(np.asarray(adjustment.posterior.covariance)))) or _singular(adjustment):
        weak = [d for d in _weakest(ready, solution, 6 + len(rows)) if d.strength < SINGULAR][len(rows) :]
        words = "; ".join(str(direction) for direction in weak) or "the normal equations"
        raise DeficientBlock(f"the block does not hold {words}. Fix some of it, or give priors.", weak)
    return adjustment


@eqx.filter_jit
def _unheld(problem: Any, values: Any, equations: Any) -> Any:
    return unheld(problem, values, equations)


@eqx.filter_jit
def _datum(problem: Any, values: Any, rows: Any) -> Datum:
    z, x = motions(problem, values)
    return Datum(rows @ z, jnp.einsum("dm,mir->dir", rows, x))


def _singular(adjustment: Adjustment) -> bool:
    """Whether the scaled inverse is so large that it is made of rounding."""
    Q = np.asarray(adjustment.posterior.covariance)
    problem, equations = adjustment.prepared.problem, adjustment.solution.equations
    system = np.asarray(_reduced(problem, equations).matrix)
    return bool(np.max(np.diagonal(Q) * np.diagonal(system)) > 0.1 / SINGULAR)


@eqx.filter_jit
def _reduced(problem: Any, equations: Any) -> Any:
    return reduced(problem, equations, eliminated(problem, equations, 0.0), 0.0)


@eqx.filter_jit
def _points_along(problem: Any, equations: Any, vector: Any) -> Any:
    """How points follow a change of the reduced unknowns, over their own standard deviations (3, rows)."""
    points = eliminated(problem, equations, 0.0)
    points = eqx.tree_at(lambda p: p.forward, points, jnp.zeros_like(points.forward))
    images = vector[: problem.n * problem.of_image].reshape(problem.n, problem.of_image)
    along = back_substituted(problem, points, images, vector[problem.n * problem.of_image :])
    return along * jnp.sqrt(jnp.diagonal(equations.points, axis1=0, axis2=1).T) * problem.free_point.T


def _weakest(ready: Prepared, solution: Solution, most: int) -> list[Direction]:
    problem, names = ready.problem, ready.names
    system = np.asarray(_reduced(problem, solution.equations).matrix)
    scale = 1.0 / np.sqrt(np.diagonal(system))
    scaled = system * scale[:, None] * scale[None, :]
    import scipy  # loads its parts when they are asked for

    few = min(most, len(scaled))
    strengths, vectors = scipy.linalg.eigh(scaled, subset_by_index=[0, few - 1])
    diagonals = [
        np.diagonal(np.asarray(x), axis1=-2, axis2=-1) for x in (solution.equations.images, solution.equations.shared)
    ]
    weights = np.sqrt(np.concatenate([x.ravel() for x in diagonals]))
    own = names.lens if problem.own_lens else ()
    found = []
    for strength, vector in zip(strengths, vectors.T, strict=True):
        change = scale * vector
        points = np.asarray(_points_along(problem, solution.equations, jnp.asarray(change))).T[ready.order.row_of_point]
        parts, N = change * weights, problem.n * problem.of_image
        images = parts[:N].reshape(problem.n, problem.of_image)
        found.append(described(float(strength), images, parts[N:], points, (own, names.columns(problem))))
    return found


def _at_start(ready: Prepared, solution: Solution, loss: AbstractLoss) -> Solution:
    """A free network moved as a whole so that its points lie, in the mean square, where they started."""
    values, problem = solution.values, ready.problem
    rows = ready.order.row_of_point
    scale, R, shift = similarity(np.asarray(values.points)[rows], np.asarray(problem.start.points)[rows])
    points = np.asarray(values.points) @ R.T * scale + shift
    centre = np.asarray(values.centre) @ R.T * scale + shift
    turned = R @ np.asarray(values.R_frame_from_camera)
    changed = (jnp.asarray(centre), jnp.asarray(turned), jnp.asarray(points))
    values = eqx.tree_at(lambda v: (v.centre, v.R_frame_from_camera, v.points), values, changed)
    return Solution(values, equations_at(problem, values, loss), solution.log, solution.converged)


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(scale, rotation, shift) that bring points (m, 3) nearest to others: target = scale R source + shift.

    Umeyama (1991).
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ sign @ Vt
    scale = float(np.trace(np.diag(S) @ sign) / np.sum(a * a))
    return scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0)

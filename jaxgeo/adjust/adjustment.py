"""Adjustment results: orientations, points and calibrations, with their covariances."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._record import portable
from jaxgeo.adjust.arrays import free_columns
from jaxgeo.adjust.block import Block, Images
from jaxgeo.adjust.equations import known_points, navigation_residuals
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.measurements import image_residuals, in_view
from jaxgeo.adjust.omega_phi_kappa import angle_derivatives, omega_phi_kappa
from jaxgeo.adjust.posterior import (
    Datum,
    Posterior,
    covariance_of_images,
    covariance_of_points,
    covariance_of_reduced,
    covariance_of_shared,
    posterior_of,
)
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.rank_defects import Direction, weakest_directions
from jaxgeo.adjust.ray_effects import READOUT, REFRACTION
from jaxgeo.adjust.screening import Screened
from jaxgeo.adjust.solve import Iteration, Solution
from jaxgeo.adjust.unknowns import Unknowns
from jaxgeo.adjust.values import POSE, STRIP, with_interior
from jaxgeo.rotations import rotation_vector_from_R
from jaxgeo.sensor import FrameCamera, Mount

UNITS = {
    "focal": "px",
    "principal": "px",
    "boresight": "rad",
    "lever arm": "m",
    "shift": "m",
    "drift": "m/s",
    "time offset": "s",
    "readout": "s",
}
MINUTES = 60.0  # of arc in a degree


@dataclass(frozen=True)
class Parameter:
    """A parameter of a camera, a mount or a strip: its value and standard deviation (of unit weight), that of the prior
    (infinite for none), and their common unit ("1" for none).

    The boresight is the rotation from its start value, as a rotation vector about the axes of the body (of the head,
    for a gimbal that reports in local level); `Adjustment.mounts` have the full rotation.
    """

    whose: str
    name: str
    value: float
    sigma: float
    prior: float
    unit: str


@portable
@dataclass(frozen=True)
class Adjustment:
    """Result of an adjustment.

    `images`, `points` (with covariances), `cameras` and `mounts` are the adjusted ones, in the block's frame. All
    covariances are of unit weight: they assume that the given standard deviations of the observations are correct.
    Multiply by `sigma0` squared to scale them by the residuals.
    """

    block: Block
    unknowns: Unknowns
    prepared: Prepared
    solution: Solution
    loss: AbstractLoss
    datum: Datum | None = field(default=None, repr=False)
    screened: tuple[Screened, ...] = ()
    """Measurements set aside before the first iteration; `block` does not contain them."""

    @property
    def log(self) -> tuple[Iteration, ...]:
        """The iterations, including the start."""
        return self.solution.log

    @property
    def converged(self) -> bool:
        """Whether the iterations converged; `adjust` raises `NotConverged` if they do not."""
        return self.solution.converged

    @property
    def cost(self) -> float:
        """Half the (robust) sum of squares of all weighted residuals."""
        return self.solution.log[-1].cost

    @cached_property
    def redundancy(self) -> int:
        """Number of observations, priors and datum constraints, less the number of unknowns."""
        return self.observations - self.unknown_count + (0 if self.datum is None else self.datum.images.shape[0])

    @cached_property
    def observations(self) -> int:
        """Number of observed values, including priors with a standard deviation."""
        problem, order = self.prepared.problem, self.prepared.order
        known = np.asarray(problem.known_point)[order.row_of_point]
        count = 2 * len(self.block.observations) + int(np.sum(np.any(known != 0.0, axis=2)))
        if problem.observed is not None:
            for weights in (problem.observed.information_position, problem.observed.information_attitude):
                count += int(np.sum(np.any(np.asarray(weights) != 0.0, axis=2)))
            if problem.observed.rows is not None:
                count += int(np.sum(np.any(np.asarray(problem.observed.rows.by_pose) != 0.0, axis=2)))
        if problem.terrain is not None:
            count += int(np.sum(np.asarray(problem.terrain.information) > 0.0))
        return count + sum(
            int(np.sum(np.asarray(x.information) > 0.0))
            for x in (problem.lens, problem.mount, problem.strip, problem.common)
        )

    @cached_property
    def unknown_count(self) -> int:
        """Number of unknowns."""
        problem = self.prepared.problem
        images, shared = free_columns(problem)
        return int(np.sum(images) + np.sum(shared) + np.sum(problem.free_point))

    @cached_property
    def sigma0(self) -> float:
        """Standard deviation of unit weight: 1 where residuals match the given sigmas.

        With a robust loss, from the reweighted residuals. NaN without redundancy.
        """
        weighted = self._weighted_squares
        return float(np.sqrt(weighted / self.redundancy)) if self.redundancy > 0 else float("nan")

    @cached_property
    def _weighted_squares(self) -> float:
        control = np.asarray(known_points(self.prepared.problem, self.solution.values))
        squared = np.concatenate([np.sum(np.asarray(self._image_residuals) ** 2, axis=0), np.sum(control**2, axis=1)])
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
    def visible(self) -> np.ndarray:
        """Flags (k,) of image points whose adjusted point lies in front of the camera and in the field of its lens."""
        return np.asarray(in_view(self.prepared.problem, self.solution.values))[self.prepared.order.place]

    @cached_property
    def navigation_residuals(self) -> np.ndarray | None:
        """Residuals of the navigation (n, 6) in standard deviations: position, attitude."""
        if self.prepared.problem.observed is None:
            return None
        return np.asarray(navigation_residuals(self.prepared.problem, self.solution.values))[:, :6]

    @cached_property
    def pose_residuals(self) -> np.ndarray | None:
        """Residuals of the further observations of the orientations (n, r), in standard deviations; None without."""
        observed = self.prepared.problem.observed
        if observed is None or observed.rows is None:
            return None
        return np.asarray(navigation_residuals(self.prepared.problem, self.solution.values))[:, 6:]

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
        """Shift (m) and drift (m/s), east, north and up of the frame, of the navigation positions per strip."""
        found = np.asarray(self.solution.values.strip)[:, :STRIP]
        return dict(zip(self.prepared.names.strip, found, strict=True))

    @cached_property
    def time_offsets(self) -> dict[str, float]:
        """Time offset of the navigation per strip, s; zero if none was unknown."""
        found = np.pad(np.asarray(self.solution.values.strip), ((0, 0), (0, 1)))[:, STRIP]
        return dict(zip(self.prepared.names.strip, found.tolist(), strict=True))

    @cached_property
    def readouts(self) -> dict[str, float]:
        """Readout time of each camera, s, as of `RollingShutterCamera.from_readout`; those of a frame camera are 0."""
        return self._of_effects(READOUT)

    @cached_property
    def refractions(self) -> dict[str, float]:
        """Factor on the bending of rays of each camera in the block's atmosphere; 0 without one."""
        return self._of_effects(REFRACTION)

    def _of_effects(self, name: str) -> dict[str, float]:
        effects, names = self.prepared.problem.effects, self.prepared.names.camera
        if effects is None or name not in effects.names:
            return dict.fromkeys(names, 0.0)
        return dict(zip(names, effects.entry(self.solution.values, name).tolist(), strict=True))

    @cached_property
    def common(self) -> dict[str, tuple[float, float]]:
        """Errors of the navigation that images share, by name: how far the adjusted poses are from the navigation in
        standard deviations of each, and what is left of one, 1 if the images do not show it."""
        names = self.prepared.names.common
        left = np.sqrt(np.maximum(np.diagonal(self.covariance_of_shared), 0.0))[-len(names) :] if names else ()
        values = np.asarray(self.solution.values.common)
        return {name: (float(value), float(sigma)) for name, value, sigma in zip(names, values, left, strict=True)}

    @cached_property
    def points(self) -> GroundPoints:
        """The adjusted points with image measurements, with covariances of unit weight."""
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
        """Adjusted positions of the points by name, m."""
        rows = self.prepared.order.row_of_point
        return dict(zip(self.prepared.names.point.tolist(), np.asarray(self.solution.values.points)[rows], strict=True))

    @cached_property
    def posterior(self) -> Posterior:
        """Factor and inverse of the reduced normal equations, the source of all covariances."""
        return posterior_of(self.prepared.problem, self.solution.equations, self.datum, self.solution.values)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (N, N) of all orientations, image by image, followed by the shared parameters (`columns`).

        N is at least 6 per image, so that for thousands of images this matrix is large. The covariances of single
        images, points and parameters do not need it.
        """
        return np.asarray(covariance_of_reduced(self.prepared.problem, self.posterior))

    @cached_property
    def _of_images(self) -> np.ndarray:
        """Covariance (n, c, c) of each image's own columns."""
        return np.asarray(covariance_of_images(self.prepared.problem, self.posterior))

    @cached_property
    def covariance_of_shared(self) -> np.ndarray:
        """Covariance (s, s) of the shared parameters: the last of the `columns`."""
        return np.asarray(covariance_of_shared(self.prepared.problem, self.posterior))

    @cached_property
    def _variances(self) -> np.ndarray:
        """The diagonal of `covariance`."""
        images = np.diagonal(self._of_images, axis1=1, axis2=2)
        return np.concatenate([images.ravel(), np.diagonal(self.covariance_of_shared)])

    @cached_property
    def columns(self) -> list[tuple[str, str]]:
        """(owner, parameter) of each row and column of `covariance`."""
        problem, names = self.prepared.problem, self.prepared.names
        own = [f"centre {axis}" for axis in "xyz"] + [f"turn {axis}" for axis in "xyz"]
        own += list(names.lens) if problem.own_lens else []
        return [(f"image {image}", what) for image in names.image for what in own] + names.columns(problem)

    @cached_property
    def covariance_of_images(self) -> np.ndarray:
        """Covariance (n, 6, 6) of each orientation: centre in m (frame axes), rotation in rad about the camera's
        axes."""
        return self._of_images[:, :POSE, :POSE]

    @cached_property
    def omega_phi_kappa(self) -> np.ndarray:
        """Angles (n, 3) of the adjusted orientations in the block's frame, rad."""
        return omega_phi_kappa(self.images.R_frame_from_camera)

    @cached_property
    def sigma_of_images(self) -> np.ndarray:
        """Standard deviations (n, 6), of unit weight: centre in m (frame axes); omega, phi, kappa in rad."""
        covariance, by_turn = self.covariance_of_images, angle_derivatives(self.images.R_frame_from_camera)
        angles = np.einsum("nij,njk,nik->ni", by_turn, covariance[:, 3:, 3:], by_turn)
        centres = np.diagonal(covariance, axis1=1, axis2=2)[:, :3]
        return np.sqrt(np.maximum(np.concatenate([centres, angles], axis=1), 0.0))

    def summary(self) -> str:
        """Text summary of the results."""
        return _summary(self)

    @cached_property
    def parameters(self) -> list[Parameter]:
        """All unknown parameters of cameras, mounts and strips, with standard deviations of unit weight."""
        problem, values = self.prepared.problem, self.solution.values
        known = {
            "camera": (values.lens, problem.lens),
            "mount": (self._of_mounts, problem.mount),
            "strip": (values.strip, problem.strip),
        }
        found = []
        for at, whose, name, kind, row, column in self._parameter_columns:
            numbers, prior = known[kind]
            if not float(prior.free[row, column]):
                continue
            entry = problem.active[column] if kind == "camera" else column
            information = float(prior.information[row, column])
            sigma = float(np.sqrt(self._variances[at]))
            value = float(np.asarray(numbers)[row, entry])
            before = 1.0 / information if information else float("inf")
            unit = UNITS.get(name) or UNITS.get(name.rsplit(" ", 1)[0], "1")
            found.append(Parameter(whose, name, value, sigma, before, unit))
        return found

    @cached_property
    def _of_mounts(self) -> np.ndarray:
        """Boresight rotation from its start value (rotation vector, rad) and lever arm, m."""
        values = self.solution.values
        return np.concatenate([np.asarray(jax.vmap(rotation_vector_from_R)(values.boresight)), values.lever], axis=1)

    @property
    def _parameter_columns(self) -> list[tuple[int, str, str, str, int, int]]:
        """(index in `covariance`, owner, parameter, kind, row, column) of each parameter."""
        problem, names = self.prepared.problem, self.prepared.names
        found = []
        if problem.own_lens:
            for image, camera in enumerate(np.asarray(problem.layout.camera)):
                for column, lens in enumerate(names.lens):
                    at = image * problem.of_image + POSE + column
                    found.append((at, f"camera {names.camera[camera]}", lens, "camera", int(camera), column))
        at = problem.n * problem.of_image
        sizes = {"camera": len(names.lens), "mount": 6, "strip": problem.strip.free.shape[1]}
        counts: dict[str, int] = {}
        for offset, (whose, what) in enumerate(names.columns(problem)):
            kind = whose.split()[0]
            if kind == "navigation":
                continue
            row, column = divmod(counts.get(kind, 0), sizes[kind])
            counts[kind] = counts.get(kind, 0) + 1
            found.append((at + offset, whose, what, kind, row, column))
        return found

    @cached_property
    def correlations(self) -> np.ndarray:
        """Correlations (k, k) between the `parameters`."""
        free = {(p.whose, p.name) for p in self.parameters}
        at = [entry[0] for entry in self._parameter_columns if entry[1:3] in free]
        problem = self.prepared.problem
        if problem.own_lens:
            covariance = self.covariance[np.ix_(at, at)]
        else:
            own = np.array(at, int) - problem.n * problem.of_image
            covariance = self.covariance_of_shared[np.ix_(own, own)]
        sigma = np.sqrt(np.diagonal(covariance))
        return covariance / np.outer(sigma, sigma)

    def differences(self, points: GroundPoints) -> np.ndarray:
        """Adjusted less given positions (m, 3) of check points, m. Raises `ValueError` for one without measurements."""
        places = self.places
        missing = [name for name in points.name.tolist() if name not in places]
        if missing:
            raise ValueError(f"point {missing[0]} was measured in no image, so there is nothing to check.")
        return np.array([places[name] for name in points.name.tolist()]) - points.place

    def weak_directions(self, most: int = 3) -> list[Direction]:
        """The least constrained combinations of unknowns, the weakest first, as text."""
        return weakest_directions(self.prepared, self.solution, most)


def _summary(adjustment: Adjustment) -> str:
    """Counts, sigma0, residuals, accuracy of orientations and points, and every parameter with its sigma.

    Standard deviations are of unit weight; angles of orientations in deg, of the boresight in minutes of arc.
    """
    block, log = adjustment.block, adjustment.log
    residuals = np.sqrt(np.mean(adjustment.residuals**2, axis=0))
    images, points = adjustment.sigma_of_images, adjustment.points.sigma
    lines = [
        f"{len(block.images)} images, {len(adjustment.points)} points, {len(block.observations)} image points",
        f"{adjustment.observations} observations, {adjustment.unknown_count} unknowns, redundancy "
        f"{adjustment.redundancy}; sigma0 {adjustment.sigma0:.4f}",
        f"{len(log) - 1} iterations, cost {log[0].cost:.6g} -> {adjustment.cost:.6g}",
        f"image residuals, rms: {residuals[0]:.3f} px along columns, {residuals[1]:.3f} px along rows",
        "standard deviations, median: "
        f"perspective centres {_lengths(images[:, :3])}, "
        f"omega, phi, kappa {_numbers(np.rad2deg(images[:, 3:]), '.5f')} deg, points {_lengths(points)}",
    ]
    lines += [f"set aside before the first iteration: {one}" for one in adjustment.screened]
    if adjustment.parameters:
        lines += ["", f"{'':<34}{'value':>16}{'sigma':>13}{'known to':>13}"]
        lines += [_row(parameter) for parameter in adjustment.parameters]
    return "\n".join(lines)


def _row(parameter: Parameter) -> str:
    times, unit = (np.rad2deg(1.0) * MINUTES, "'") if parameter.unit == "rad" else (1.0, parameter.unit)
    name = f"{parameter.whose}: {parameter.name}" + (f", {unit}" if unit != "1" else "")
    value, sigma = parameter.value * times, parameter.sigma * times
    prior = f"{parameter.prior * times:13.4g}" if np.isfinite(parameter.prior) else f"{'–':>13}"
    return f"{name:<34}{value:16.{_decimals(sigma)}f}{sigma:13.3g}{prior}"


def _decimals(sigma: float) -> int:
    """Decimals that resolve a hundredth of the standard deviation."""
    return int(np.clip(2 - np.floor(np.log10(sigma)), 0, 12)) if sigma > 0.0 else 6


def _lengths(sigma: np.ndarray) -> str:
    return f"{_numbers(sigma, '.4f')} m"


def _numbers(values: np.ndarray, spec: str) -> str:
    return ", ".join(format(x, spec) for x in np.median(values, axis=0))

"""Space resection of images from ground control points, as start values of an adjustment."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Array

from jaxgeo._compile import sized_filter_jit
from jaxgeo._numerics import matmul3, safe_norm
from jaxgeo.adjust._least_squares import check_least_squares, minimize
from jaxgeo.adjust.block import Images
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.initial_points import camera_rays
from jaxgeo.adjust.records import ImagePoints
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import FrameCamera

FLAT = 0.1  # thickness of the points over their width, below which a plane is assumed for start values
LEAST = 4
MOST_OFF = 0.02  # of the image area of the points: residuals above which no orientation fits
AGREED = 0.01  # of the same: residuals of points that agree with an orientation
SUBSETS = 40  # subsets of four points tried
SMALL = 8  # points, up to which all subsets are listed
CLOSE_ENOUGH = 1e-6  # rad, and of the distance: longest Gauss-Newton step from the result of a solver
ENOUGH = 0.75  # share of the points that suffices as agreement with a subset

Refinement: TypeAlias = Callable[..., tuple[float, np.ndarray, np.ndarray]]


def resect_block(
    cameras: Mapping[str, FrameCamera],
    camera_of: Mapping[str, str],
    observations: ImagePoints,
    control: GroundPoints,
    *,
    solver: Any = None,
) -> Images:
    """Orientations of images from the control points in them, each image independently, as start values.

    `camera_of` names the camera of each image. A direct linear solution, planar or spatial, then least squares. Points
    with an infinite sigma are ignored. If the points are inconsistent, the orientation with the most support is taken,
    and a `RuntimeWarning` names the others. Raises `ValueError` for an unknown camera, and for an image with fewer than
    four control points, with collinear ones, or whose camera has no ray for one. `solver` as for `resect_image`.
    """
    known = np.all(np.isfinite(control.sigma), axis=1)
    where = dict(zip(control.name[known].tolist(), control.place[known], strict=True))
    refine = _refinement(solver)
    missing = [camera for camera in camera_of.values() if camera not in cameras]
    if missing:
        raise ValueError(f"there is no camera {missing[0]!r}; known are {', '.join(cameras)}.")
    centres, rotations = [], []
    for image, camera in camera_of.items():
        rows = [i for i in np.flatnonzero(observations.image == image) if observations.point[i] in where]
        if len(rows) < LEAST:
            raise ValueError(
                f"image {image} sees {len(rows)} control points; a resection takes at least {LEAST}. Give it an "
                f"orientation to start from."
            )
        places = np.array([where[name] for name in observations.point[rows].tolist()])
        try:
            centre, R, agree = _agreed(cameras[camera], observations.uv[rows], places, refine)
        except ValueError as error:
            raise ValueError(f"image {image}: {error}") from None
        if not np.all(agree):
            names = ", ".join(observations.point[np.array(rows)[~agree]].tolist())
            warnings.warn(
                f"image {image}: points {names} do not fit the orientation on which the other {int(np.sum(agree))} "
                f"agree, and are left out of its resection. Are their coordinates, and their names, right?",
                RuntimeWarning,
                stacklevel=2,
            )
        centres.append(centre)
        rotations.append(R)
    return Images(np.array(list(camera_of)), np.array(list(camera_of.values())), np.array(centres), np.array(rotations))


def resect_image(
    camera: FrameCamera, uv: np.ndarray, places: np.ndarray, *, solver: Any = None
) -> tuple[np.ndarray, np.ndarray]:
    """(perspective centre, R_frame_from_camera) from pixels (k, 2) of positions (k, 3), k at least 4.

    `solver` is an optimistix least-squares solver. The default, MINPACK's Levenberg-Marquardt in SciPy, compiles
    nothing: with the import of SciPy the first image takes 0.3 s of processor time, by optimistix 2 to 5 s for every
    new number of points; later images take 3.4 ms from one start, by optimistix 1.0 to 1.4 ms, with the same
    orientations to 2e-5 m from as many poor starts (single runs; `benchmarks/solvers.py`). For many images of equally
    many points, pass one.

    Raises `ValueError` for collinear positions, and if no start converges.
    """
    centre, R, _ = _agreed(camera, uv, places, _refinement(solver))
    return centre, R


def _agreed(
    camera: FrameCamera, uv: np.ndarray, places: np.ndarray, refine: Refinement
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(centre, R, flags of the agreeing points) from all points; if they are inconsistent, from those that agree
    with the orientation of a four-point subset."""
    rays = camera_rays(camera, np.asarray(uv, np.float64))
    ideal = rays[:, :2] / rays[:, 2:]
    lost = ~np.all(np.isfinite(ideal), axis=1)
    if np.any(lost):
        raise ValueError(
            f"the camera sees nothing at {np.asarray(uv)[np.argmax(lost)].tolist()} px, where its lens folds."
        )
    if _in_one_line(places):  # or all but one distant point
        if (found := _consensus(ideal, places, refine)) is not None:
            return found
        raise ValueError("the ground points lie in one line, from which no orientation follows.")
    size = float(np.abs(ideal - ideal.mean(axis=0)).max())
    cost, centre, R = _best(ideal, places, refine)
    off = float(np.sqrt(cost / ideal.size))
    everything = np.ones(len(places), bool)
    if off <= AGREED * size:
        return centre, R, everything
    found = _consensus(ideal, places, refine)
    if found is not None:
        return found
    if not np.isfinite(cost):
        raise ValueError(
            "no start converged to an orientation with all ground points in front of the camera; are image and points "
            "a pair?"
        )
    if off > MOST_OFF * size:
        off_px = off * float(np.mean(np.asarray(camera.focal_px)))
        raise ValueError(
            f"no orientation was found that fits: the best leaves {off_px:.0f} px on average. Are image and points a "
            f"pair, and the camera the right one?"
        )
    return centre, R, everything


def _in_one_line(places: np.ndarray) -> bool:
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 1e-3 * spread[0])


def _best(ideal: np.ndarray, places: np.ndarray, refine: Refinement) -> tuple[float, np.ndarray, np.ndarray]:
    """(sum of squares, centre, R) of the best of all starts; infinite if none converges."""
    middle = places.mean(axis=0)
    offsets = places - middle
    _, spread, axes = np.linalg.svd(offsets)
    starts = [_vertical(ideal, offsets, side) for side in (axes, np.diag([1.0, -1.0, -1.0]) @ axes)]
    if len(places) < 6 or spread[2] < FLAT * spread[1]:
        starts += _of_plane(ideal, offsets @ axes.T, axes)
    else:
        starts += [_of_space(ideal, offsets)]
    cost, centre, R = min((refine(ideal, offsets, *start) for start in starts), key=lambda found: found[0])
    return cost, centre + middle, R


def _consensus(
    ideal: np.ndarray, places: np.ndarray, refine: Refinement
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """(centre, R, flags) from the points that agree with the best four-point orientation; None if fewer than five,
    or less than two thirds, agree."""
    least = max(LEAST + 1, -(-2 * len(places) // 3))
    if len(places) <= least:
        return None
    rng = np.random.default_rng(0)
    few = len(places) <= SMALL
    subsets = list(combinations(range(len(places)), LEAST)) if few else []
    subsets = subsets or [tuple(rng.choice(len(places), LEAST, replace=False)) for _ in range(SUBSETS)]
    subsets = [subsets[i] for i in rng.permutation(len(subsets))[:SUBSETS]]
    most = np.zeros(len(places), bool)
    for subset in subsets:
        rows = np.array(subset, int)
        if _in_one_line(places[rows]):
            continue
        cost, centre, R = _best(ideal[rows], places[rows], refine)
        agree = _agreeing(ideal, places, centre, R) if np.isfinite(cost) else most
        most = agree if np.sum(agree) > np.sum(most) else most
        if np.sum(most) >= max(least, ENOUGH * len(places)):
            break
    if np.sum(most) < least:
        return None
    _, centre, R = _best(ideal[most], places[most], refine)
    return centre, R, _agreeing(ideal, places, centre, R)


def _agreeing(ideal: np.ndarray, places: np.ndarray, centre: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Flags of points whose residuals are within `AGREED` of the image area that most points cover."""
    p_camera = (places - centre) @ R
    depth = p_camera[:, 2:]
    off = np.linalg.norm(p_camera[:, :2] / np.where(depth > 0.0, depth, np.inf) - ideal, axis=1)
    size = 2.0 * np.median(np.abs(ideal - np.median(ideal, axis=0)).max(axis=1))
    return (off < AGREED * size) & (depth[:, 0] > 0.0)


def _vertical(ideal: np.ndarray, offsets: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(centre, R) with a view perpendicular to the points' plane, from the side of its third axis (row)."""
    axes = np.diag([1.0, 1.0, np.linalg.det(axes)]) @ axes
    p, q = offsets @ axes[:2].T, ideal - ideal.mean(axis=0)
    along, across = np.sum(q[:, 0] * p[:, 0] - q[:, 1] * p[:, 1]), np.sum(q[:, 0] * p[:, 1] + q[:, 1] * p[:, 0])
    length = np.hypot(along, across)
    cos, sin, height = along / length, across / length, np.sum(p * p) / length
    R = np.array([[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]]).T
    centre = height * (np.array([0.0, 0.0, 1.0]) - R[:, :2] @ ideal.mean(axis=0))
    return axes.T @ centre, axes.T @ R


def _of_plane(ideal: np.ndarray, places: np.ndarray, axes: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """(centre, R) from the homography of the points' plane, and with the opposite tilt: both look alike from far
    away."""
    size = np.abs(places[:, :2]).max()
    x, y = places[:, 0] / size, places[:, 1] / size
    one, zero = np.ones_like(x), np.zeros_like(x)
    u, v = ideal.T
    rows = [[x, y, one, zero, zero, zero, -u * x, -u * y, -u], [zero, zero, zero, x, y, one, -v * x, -v * y, -v]]
    A = np.concatenate([np.stack(row, axis=1) for row in rows])
    H = np.linalg.svd(A)[2][-1].reshape(3, 3)
    H = H * np.sign(H[2, 2]) @ np.diag([1.0 / size, 1.0 / size, 1.0])
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    R = _nearest_rotation(np.stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])], axis=1))
    centre = -R.T @ H[:, 2]
    to_frame = axes.T @ np.diag([1.0, 1.0, np.linalg.det(axes)])  # from the plane's axes, right-handed
    sight = -centre / np.linalg.norm(centre)
    mirrored = np.diag([-1.0, -1.0, 1.0]) @ centre
    turn = _between(sight, -mirrored / np.linalg.norm(mirrored))
    return [(to_frame @ c, to_frame @ Rc) for c, Rc in ((centre, R.T), (mirrored, turn @ R.T))]


def _of_space(ideal: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(centre, R) from the direct linear transformation of at least six points."""
    size = np.abs(places).max()
    X = np.concatenate([places / size, np.ones((len(places), 1))], axis=1)
    zero = np.zeros_like(X)
    rows = [np.concatenate([X, zero, -ideal[:, :1] * X], 1), np.concatenate([zero, X, -ideal[:, 1:] * X], 1)]
    P = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 4)
    P = P * np.sign(np.linalg.det(P[:, :3]))
    R = _nearest_rotation(P[:, :3])
    centre = -np.linalg.solve(P[:, :3], P[:, 3]) * size
    return centre, R.T


def _refinement(solver: Any) -> Refinement:
    check_least_squares(solver)
    return _refine if solver is None else functools.partial(_refine_by, solver)


def _refine(
    ideal: np.ndarray, places: np.ndarray, centre: np.ndarray, R: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """(sum of squares, centre, R) of least squares from a start; infinite if points lie behind the camera."""
    Rotation = scipy.spatial.transform.Rotation
    size = np.linalg.norm(centre)

    def off(step: np.ndarray) -> np.ndarray:
        p_camera = (places - centre - step[:3] * size) @ (R @ Rotation.from_rotvec(step[3:]).as_matrix())
        return (p_camera[:, :2] / p_camera[:, 2:] - ideal).ravel()

    found = scipy.optimize.least_squares(off, np.zeros(6), method="lm", x_scale="jac")
    centre = centre + found.x[:3] * size
    R = R @ Rotation.from_rotvec(found.x[3:]).as_matrix()
    ahead = np.all(((places - centre) @ R)[:, 2] > 0.0)
    return (2.0 * found.cost if ahead else np.inf), centre, R


def _refine_by(
    solver: Any, ideal: np.ndarray, places: np.ndarray, centre: np.ndarray, R: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """As `_refine`, by a solver of optimistix; infinite also if that does not converge."""
    cost, centre_, R_ = _pose_by(solver, *(jnp.asarray(part) for part in (ideal, places, centre, R)))
    return float(cost), np.asarray(centre_), np.asarray(R_)


@sized_filter_jit
def _pose_by(solver: Any, ideal: Array, places: Array, centre: Array, R: Array) -> tuple[Array, Array, Array]:
    size = jnp.linalg.norm(centre)

    def pose(step: Array) -> tuple[Array, Array]:
        return centre + step[:3] * size, matmul3(R, R_from_rotation_vector(step[3:]))

    def residual(step: Array, _: Any) -> Array:
        to, turned = pose(step)
        p_camera = (places - to[None]) @ turned
        return (p_camera[:, :2] / p_camera[:, 2:] - ideal).ravel()

    step, converged = minimize(residual, solver, jnp.zeros(6), None)
    gauss_newton = jnp.linalg.lstsq(jax.jacfwd(residual)(step, None), residual(step, None))[0]
    converged = converged & (safe_norm(gauss_newton) <= CLOSE_ENOUGH)  # else no minimum, whatever the solver reports
    to, turned = pose(step)
    ahead = jnp.all(((places - to[None]) @ turned)[:, 2] > 0.0)
    return jnp.where(converged & ahead, jnp.sum(residual(step, None) ** 2), jnp.inf), to, turned


def _nearest_rotation(M: np.ndarray) -> np.ndarray:
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that maps one unit vector to another."""
    axis = np.cross(a, b)
    length = np.linalg.norm(axis)
    if length < 1e-15:
        return np.eye(3)
    angle = np.arctan2(length, a @ b)
    return scipy.spatial.transform.Rotation.from_rotvec(axis / length * angle).as_matrix()

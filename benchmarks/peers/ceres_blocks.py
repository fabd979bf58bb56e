"""Bundle adjustment by compiled Ceres: pycolmap builds the problem with its own costs and manifolds, Ceres solves it.

`solve` uses pyceres, whose Ceres accepts any solver and tolerance, and adds observations of the images if the problem
has them; `solve_two_fixed` is pycolmap's own adjustment, which fixes the datum by two images instead. Ceres gets
residuals in px: observations of images are weighted accordingly, and costs and covariances are converted to units of
sigma afterwards. Times are those reported by Ceres; they exclude building the problem in Python.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from peers.block_problems import BlockProblem

try:
    import pyceres  # pyright: ignore[reportMissingImports]
    import pycolmap  # pyright: ignore[reportMissingImports]
    from pycolmap import cost_functions  # pyright: ignore[reportMissingImports]
except ImportError as error:
    raise ImportError(
        f"{error}: the compiled bundle adjustments need pycolmap and pyceres; try: pip install pycolmap pyceres."
    ) from error

DENSE, SPARSE = pyceres.LinearSolverType.DENSE_SCHUR, pyceres.LinearSolverType.SPARSE_SCHUR
CERES_TOLERANCE = 1e-6  # Ceres's default: relative change of the cost
MODEL = "RADIAL"  # f, cx, cy, k1, k2


class Built(NamedTuple):
    """A block inside pycolmap; the Ceres problem works in the memory of the reconstruction."""

    reconstruction: Any
    adjuster: Any

    @property
    def ceres(self) -> Any:
        return self.adjuster.problem

    def pose(self, image: int) -> np.ndarray:
        """The seven pose parameters of an image in Ceres: (x, y, z, w) and translation of camera from world."""
        return self.reconstruction.image(image + 1).frame.rig_from_world.params

    def point(self, point: int) -> np.ndarray:
        """The three parameters of a point in Ceres."""
        return self.reconstruction.point3D(point + 1).xyz


def solve(
    problem: BlockProblem, threads: int = 2, tolerance: float = CERES_TOLERANCE, linear_solver: Any = DENSE
) -> dict[str, Any]:
    """The adjusted block and Ceres's statistics, by pyceres; `tolerance` is relative, of the cost.

    Keys: `cost_start` and `cost` (half the weighted sum of squares), `iterations` (computed steps: the last one, if it
    meets the tolerance, is not applied), `jacobians` (number of evaluations), `seconds` of the whole solver and of its
    parts `preprocessor`, `minimizer`, `linear_solver`, `jacobian`, `residual`, `processor` (processor time of all
    threads in s), `threads` used, `structure` of the Schur complement, `message` and `block`.
    """
    built = build(problem, threads)
    options = pyceres.SolverOptions()
    _set(options, threads, tolerance, linear_solver)
    summary = pyceres.SolverSummary()
    begin = time.process_time()
    pyceres.solve(options, built.ceres, summary)
    return _report(problem, built, summary, time.process_time() - begin)


def solve_two_fixed(
    problem: BlockProblem, threads: int = 2, tolerance: float = CERES_TOLERANCE, linear_solver: Any = DENSE
) -> dict[str, Any]:
    """The same by pycolmap's own adjustment: no image observations; one image is fixed, and the distance of another."""
    problem = replace(problem, pos=None)
    built = build(problem, threads, tolerance, linear_solver, holds_two=True)
    begin = time.process_time()
    summary = built.adjuster.solve()
    return _report(problem, built, summary.ceres_summary, time.process_time() - begin)


def covariance(problem: BlockProblem, threads: int = 2) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Covariances at the block's current values, of images (n, 6, 6) and points (m, 3, 3), by `ceres::Covariance`.

    Images: rotation about the camera's right, down and forward in rad, then the centre in m. All other unknowns are
    free. Returns wall and processor time in s as well. A block without observations of its images has two of them
    fixed, which are NaN. Takes minutes for thousands of points: it computes a column of the inverse for each
    coordinate. Raises `ArithmeticError` if Ceres fails because the normal matrix is singular.
    """
    built = build(problem, threads, holds_two=problem.pos is None)
    options = pyceres.CovarianceOptions()
    options.num_threads = threads
    blocks = [built.pose(k) for k in range(len(problem.centres))]
    variable = [not built.ceres.is_parameter_block_constant(block) for block in blocks]
    points = [built.point(k) for k in range(len(problem.points))]
    wanted = [block for block, is_free in zip(blocks, variable, strict=True) if is_free] + points

    def run() -> tuple[list[Any], list[Any]]:
        found = pyceres.Covariance(options)
        if not found.compute([(block, block) for block in wanted], built.ceres):
            raise ArithmeticError("ceres::Covariance found the normal matrix singular; observe or hold more images.")
        of_images = [
            found.get_covariance_block_tangent_space(block, block, built.ceres) if is_free else None
            for block, is_free in zip(blocks, variable, strict=True)
        ]
        return of_images, [found.get_covariance_block(block, block) for block in points]

    (of_images, of_points), seconds = _clocked(run)
    return _poses(problem, of_images), problem.sigma**2 * np.stack(of_points), seconds


def covariance_points_alone(problem: BlockProblem, threads: int = 2) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """The same by pycolmap's Schur complement, whose point covariances treat images and cameras as error-free."""
    built = build(problem, threads, holds_two=problem.pos is None)
    options = pycolmap.BACovarianceOptions(params=pycolmap.BACovarianceOptionsParams.POSES_AND_POINTS)

    def run() -> tuple[list[Any], list[Any]]:
        found = pycolmap.estimate_ba_covariance_from_problem(options, built.reconstruction, built.ceres)
        if found is None:
            raise ArithmeticError("pycolmap found the normal matrix singular; observe or hold more images.")
        of_images = [found.get_cam_cov_from_world(k + 1) for k in range(len(problem.centres))]
        return of_images, [found.get_point_cov(k + 1) for k in range(len(problem.points))]

    (of_images, of_points), seconds = _clocked(run)
    return _poses(problem, of_images), problem.sigma**2 * np.stack(of_points), seconds


def covariance_by_blocks(problem: BlockProblem, threads: int = 2) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """The same as `covariance`, from Ceres's Jacobian by block elimination in NumPy and SciPy, as a careful user would.

    With U, V and W the blocks of the normal matrix of images and cameras, of points, and between them, the points'
    covariances are inv(V) + Y cov Y^T with Y = inv(V) W^T and cov = inv(U - W Y).
    """
    built = build(problem, threads, holds_two=problem.pos is None)
    images = [built.pose(k) for k in range(len(problem.centres))]
    sizes = [
        0 if built.ceres.is_parameter_block_constant(block) else built.ceres.parameter_block_tangent_size(block)
        for block in images
    ]
    others = [block for block, size in zip(images, sizes, strict=True) if size]
    others += [built.reconstruction.camera(k + 1).params for k in range(len(problem.cameras))]
    options = pyceres.EvaluateOptions()
    options.num_threads = threads
    options.set_parameter_blocks(others + [built.point(k) for k in range(len(problem.points))])

    def run() -> tuple[np.ndarray, np.ndarray]:
        by_all = built.ceres.evaluate_jacobian(options)
        shape = (by_all.num_rows, by_all.num_cols)
        jacobian = sparse.csr_matrix((by_all.values, by_all.cols, by_all.rows), shape).tocsc()
        split = shape[1] - 3 * len(problem.points)
        return _eliminated(jacobian[:, :split], jacobian[:, split:])

    (of_others, of_points), seconds = _clocked(run)
    ends = np.cumsum(sizes)
    rows = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    of_images = [of_others[row, row] for row in rows]
    return _poses(problem, of_images), problem.sigma**2 * of_points, seconds


def _eliminated(by_others: Any, by_points: Any) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (c, c) of images and cameras and (m, 3, 3) of points, from the two parts of the Jacobian."""
    V = (by_points.T @ by_points).tobsr((3, 3)).data
    W = (by_others.T @ by_points).toarray()
    Y = np.linalg.solve(V, W.T.reshape(len(V), 3, -1))
    normal = (by_others.T @ by_others).toarray() - W @ Y.reshape(W.shape[1], -1)
    scale = 1.0 / np.sqrt(np.diag(normal))
    cov = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
    through = (Y.reshape(W.shape[1], -1) @ cov).reshape(Y.shape)
    return cov, np.linalg.inv(V) + through @ np.swapaxes(Y, 1, 2)


# Building.


def build(
    problem: BlockProblem,
    threads: int = 2,
    tolerance: float = CERES_TOLERANCE,
    linear_solver: Any = DENSE,
    *,
    holds_two: bool = False,
) -> Built:
    """The problem as built by pycolmap, with the observations of the images added; not timed."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = problem.principal_point_free
    options.print_summary = False
    options.ceres.auto_select_solver_type = False
    options.ceres.min_num_residuals_for_cpu_multi_threading = 0
    _set(options.ceres.solver_options, threads, tolerance, linear_solver)
    reconstruction = _reconstruction(problem)
    built = Built(reconstruction, _adjuster(reconstruction, options, holds_two))
    if problem.pos is not None:
        _observe(problem, built)
    return built


def _set(options: Any, threads: int, tolerance: float, linear_solver: Any) -> None:
    options.linear_solver_type = getattr(type(options.linear_solver_type), linear_solver.name)
    options.num_threads = threads
    options.function_tolerance = tolerance
    options.gradient_tolerance, options.parameter_tolerance = 1e-10, 1e-8  # Ceres's defaults; pycolmap has others
    options.max_num_iterations = 200
    options.minimizer_progress_to_stdout = False
    options.logging_type = type(options.logging_type).SILENT


def _adjuster(reconstruction: Any, options: Any, holds_two: bool) -> Any:
    config = pycolmap.BundleAdjustmentConfig()
    for number in reconstruction.images:
        config.add_image(number)
    if holds_two:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)


def _reconstruction(problem: BlockProblem) -> Any:
    """The block as a pycolmap reconstruction, whose ids start at one."""
    block = pycolmap.Reconstruction()
    for number, values in enumerate(problem.cameras):
        size = np.ceil(2.0 * np.max(np.abs(problem.uv), axis=0)).astype(int)  # only for its record
        camera = pycolmap.Camera(camera_id=number + 1, model=MODEL, width=size[0], height=size[1], params=values)
        block.add_camera_with_trivial_rig(camera)
    rank = np.empty(len(problem.image), int)
    for number, centre in enumerate(problem.centres):
        rows = np.flatnonzero(problem.image == number)
        rank[rows] = np.arange(len(rows))
        R_camera_from_world = problem.R_world_from_camera[number].T
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R_camera_from_world), -R_camera_from_world @ centre)
        camera = int(problem.camera[number]) + 1
        image = pycolmap.Image(str(number), problem.uv[rows], camera_id=camera, image_id=number + 1)
        block.add_image_with_trivial_frame(image, pose)
    ends = np.searchsorted(problem.point, np.arange(len(problem.points) + 1))
    images, ranks = (problem.image + 1).tolist(), rank.tolist()
    for number, xyz in enumerate(problem.points):
        rows = range(ends[number], ends[number + 1])
        block.add_point3D(xyz, pycolmap.Track([pycolmap.TrackElement(images[k], ranks[k]) for k in rows]))
    return block


def _observe(problem: BlockProblem, built: Built) -> None:
    """Observed attitudes and centres: their residuals are about and along the camera's axes."""
    pos = problem.pos
    assert pos is not None
    sigmas = np.repeat([pos.sigma_attitude, pos.sigma_centre], 3)
    cov = np.diag((sigmas / problem.sigma) ** 2)
    for number, (centre, R_world_from_camera) in enumerate(zip(pos.centres, pos.R_world_from_camera, strict=True)):
        R_camera_from_world = R_world_from_camera.T
        prior = pycolmap.Rigid3d(pycolmap.Rotation3d(R_camera_from_world), -R_camera_from_world @ centre)
        cost = cost_functions.AbsolutePosePriorCost(cov, prior)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(cost))  # pycolmap's problem frees it: Python must not free it too
        built.ceres.add_residual_block(cost, None, [built.pose(number)])


# Results.


def _report(problem: BlockProblem, built: Built, summary: Any, processor: float) -> dict[str, Any]:
    per_px2 = problem.sigma**-2
    return {
        "cost_start": per_px2 * summary.initial_cost,
        "cost": per_px2 * summary.final_cost,
        "iterations": summary.num_linear_solves,
        "jacobians": summary.num_jacobian_evaluations,
        "seconds": summary.total_time_in_seconds,
        "preprocessor": summary.preprocessor_time_in_seconds,
        "minimizer": summary.minimizer_time_in_seconds,
        "linear_solver": summary.linear_solver_time_in_seconds,
        "jacobian": summary.jacobian_evaluation_time_in_seconds,
        "residual": summary.residual_evaluation_time_in_seconds,
        "processor": processor,
        "threads": summary.num_threads_used,
        "structure": summary.schur_structure_used,
        "message": summary.message,
        "block": _adjusted(problem, built),
    }


def _adjusted(problem: BlockProblem, built: Built) -> BlockProblem:
    block = built.reconstruction
    poses = [block.image(k + 1).cam_from_world() for k in range(len(problem.centres))]
    return replace(
        problem,
        centres=np.stack([pose.tgt_origin_in_src() for pose in poses]),
        R_world_from_camera=np.stack([pose.rotation.matrix().T for pose in poses]),
        points=np.stack([built.point(k) for k in range(len(problem.points))]),
        cameras=np.stack([block.camera(k + 1).params for k in range(len(problem.cameras))]),
    )


def _poses(problem: BlockProblem, found: list[Any]) -> np.ndarray:
    """Covariances of rotation about camera axes and centre, from Ceres's tangents of camera from world.

    Ceres's quaternion step is half the rotation vector, and rotates the world in the camera's frame: the camera rotates
    the other way. The centre is -R^T t.
    """
    cov = np.full((len(found), 6, 6), np.nan)
    for k, tangent in enumerate(found):
        if tangent is None or np.shape(tangent) != (6, 6):
            continue
        R_world_from_camera = problem.R_world_from_camera[k]
        x, y, z = -R_world_from_camera.T @ problem.centres[k]
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = -2.0 * np.eye(3)
        by_tangent = np.block([[turned, np.zeros((3, 3))], [-2.0 * R_world_from_camera @ cross, -R_world_from_camera]])
        cov[k] = problem.sigma**2 * by_tangent @ tangent @ by_tangent.T
    return cov


def _clocked(run: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    wall, processor = time.perf_counter(), time.process_time()
    answer = run()
    return answer, {"seconds": time.perf_counter() - wall, "processor": time.process_time() - processor}

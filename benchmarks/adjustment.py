"""Speed of block adjustment: against compiled Ceres by pycolmap and pyceres, and scaling with the number of images.

Run: python -m benchmarks.adjustment [--repeats 5] [--skip-growth] [--json out.json]
Solves are warm and interleaved; medians. Ours uses Ceres's stopping rule: a relative cost change below 1e-6. Building
the problem, in Python for both, is timed separately from solving it; so is compiling. BAL is read from the folder
JAXGEO_TEST_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import jax
import measuring
import numpy as np
from measuring import Column, Table
from peers import block_problems
from peers.block_problems import BlockProblem

import jaxgeo
from jaxgeo.adjust import (
    Block,
    Cartesian,
    Free,
    GroundPoints,
    ImagePoints,
    Images,
    InnerConstraints,
    LeastSquares,
    Navigation,
    Solver,
    Unknowns,
    adjust,
)
from jaxgeo.adjust.posterior import covariance_of_images, covariance_of_points, covariance_of_shared, posterior_of
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.solve import Solution, solve
from jaxgeo.sensor import BrownConrady, FrameCamera, Mount

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
BAL = DATA / "bal" / "problem-16-22106-pre.txt.bz2"
TOLERANCE, CORES = 1e-6, 2
STRIP = 25  # images per strip, in the scaling blocks
SIZES = (50, 150, 400, 1300)
DENSITY = 25.0  # points per squared base: about 200 per image


# Conversion to the package's types.


def block_of(problem: BlockProblem) -> tuple[Block, Unknowns]:
    """A block of plain arrays, in a Cartesian frame."""
    image, camera, point = (
        np.char.add(f"{letter}", np.arange(len(values)).astype(str))
        for letter, values in (("i", problem.centres), ("c", problem.cameras), ("p", problem.points))
    )
    cameras = {
        name: FrameCamera.from_pixels(
            focal_px=f,
            width=block_problems.WIDTH,
            height=block_problems.HEIGHT,
            principal_px=(cx, cy),
            distortion=BrownConrady(k1=k1, k2=k2),
        )
        for name, (f, cx, cy, k1, k2) in zip(camera.tolist(), problem.cameras, strict=True)
    }
    seen = ImagePoints(image[problem.image], point[problem.point], problem.uv, problem.sigma)
    images = Images(image, camera[problem.camera], problem.centres, problem.R_world_from_camera)
    starts, navigation = GroundPoints(point, problem.points), navigation_of(problem)
    block = Block(Cartesian(), cameras, images, seen, navigation=navigation, points=starts)
    principal = {"principal": Free()} if problem.principal_point_free else {}
    return block, Unknowns(focal=Free(), distortion={"k1": Free(), "k2": Free()}, **principal)


def navigation_of(problem: BlockProblem) -> Navigation | None:
    """Observed centres, and attitudes about the camera's axes: the body frame equals the camera frame."""
    if problem.pos is None:
        return None
    pos, count = problem.pos, len(problem.centres)
    each = np.broadcast_to(np.eye(3), (count, 3, 3))
    return Navigation(
        position=pos.centres,
        R_frame_from_body=pos.R_world_from_camera,
        R_frame_from_reference=pos.R_world_from_camera,
        R_base_from_head=each,
        information_position=each / pos.sigma_centre,
        information_attitude=each / pos.sigma_attitude,
        mount=np.full(count, "mount"),
        strip=np.full(count, "strip"),
        time=np.zeros(count),
        mounts={"mount": (Mount(np.eye(3), R_head_from_camera=np.eye(3)), False)},
    )


def solved(ready: Prepared) -> Solution:
    """The package's solve alone, to convergence."""
    return jax.block_until_ready(solve(ready.problem, LeastSquares(), Solver(relative=TOLERANCE)))


def covariances(ready: Prepared, found: Solution) -> Any:
    """Covariances of each orientation, of all lenses together, and of each point."""
    posterior = posterior_of(ready.problem, found.equations, None)
    told = (covariance_of_images, covariance_of_shared, covariance_of_points)
    return jax.block_until_ready([of(ready.problem, posterior) for of in told])


# Comparison with Ceres.


def side_by_side(name: str, problem: BlockProblem, repeats: int) -> Table:
    """Seconds, iterations, processor time and costs of both on one problem."""
    from peers import ceres_blocks

    (ready, preparing), kept = measuring.timed(lambda: prepared(*block_of(problem))), {}

    def ours() -> float:
        kept["jaxgeo"] = solved(ready)
        return float("nan")

    def theirs(kind: str) -> Callable[[], float]:
        def run() -> float:
            kept[kind] = ceres_blocks.solve(problem, CORES, TOLERANCE, getattr(ceres_blocks, kind))
            return kept[kind]["seconds"]  # without building

        return run

    runs = {"jaxgeo": ours, "DENSE": theirs("DENSE"), "SPARSE": theirs("SPARSE")}
    first = {kind: measuring.timed(run)[1] for kind, run in runs.items()}
    watch = measuring.Watch()
    wall, processor = _interleaved(runs, kept, repeats)
    table = Table(f"{name}: {_size(problem)}", COLUMNS)
    titles = {"jaxgeo": "jaxgeo", "DENSE": "Ceres, dense Schur", "SPARSE": "Ceres, sparse Schur"}
    best = float(np.median(wall["jaxgeo"]))
    for kind, title in titles.items():
        cost, iterations, start = _came_of(kept[kind])
        t = float(np.median(wall[kind]))
        spread = 100.0 * (max(wall[kind]) - min(wall[kind])) / t
        row = [title, t, spread, min(processor[kind]), iterations, t / iterations, start, f"{cost:.6f}"]
        table.rows.append([*row, best / t, first[kind]])
    costs = [_came_of(kept[kind])[0] for kind in titles]
    table.notes.append(f"costs differ by {(max(costs) - min(costs)) / min(costs):.1e} of themselves")
    table.notes.append(f"ours is put in order in {preparing:.2f} s, names and compiling of starts included")
    table.notes.append(f"medians of {repeats}; other processes used {watch.others():.2f} cores")
    return table


COLUMNS = [
    Column("contender"),
    Column("solve", "s", "lower"),
    Column("spread", "%", "lower"),
    Column("processor time, least", "s", "lower"),
    Column("iterations"),
    Column("each", "s", "lower"),
    Column("cost at the start"),
    Column("cost at the end", "", "lower"),
    Column("jaxgeo's time over this one's", "times", "lower"),
    Column("first call, with building or compiling", "s", "lower"),
]


def _size(problem: BlockProblem) -> str:
    return f"{len(problem.centres)} images, {len(problem.points)} points, {len(problem.uv)} measurements"


def _interleaved(runs: dict[str, Any], kept: dict[str, Any], repeats: int) -> tuple[dict, dict]:
    """Seconds of the solve and of processors, in alternating order; Ceres reports its own, without building."""
    wall, processor = ({name: [] for name in runs} for _ in range(2))
    for repeat in range(repeats):
        for name in list(runs) if repeat % 2 == 0 else list(runs)[::-1]:
            begin, spent = time.perf_counter(), time.process_time()
            seconds = runs[name]()
            ended, all_spent = time.perf_counter() - begin, time.process_time() - spent
            wall[name].append(ended if np.isnan(seconds) else seconds)
            processor[name].append(all_spent if np.isnan(seconds) else kept[name]["processor"])
    return wall, processor


def _came_of(found: Any) -> tuple[float, int, float]:
    """(cost, iterations, cost at the start)."""
    if isinstance(found, Solution):
        return found.log[-1].cost, len(found.log) - 1, found.log[0].cost
    return found["cost"], found["iterations"], found["cost_start"]


def spreads(name: str, problem: BlockProblem, repeats: int) -> Table:
    """Covariances of all orientations and points, at the solutions of both."""
    from peers import ceres_blocks

    ready = prepared(*block_of(problem))
    found = solved(ready)
    there = ceres_blocks.solve(problem, CORES, TOLERANCE)["block"]
    kept: dict[str, Any] = {}

    def ours() -> float:
        kept["jaxgeo"] = covariances(ready, found)
        return float("nan")

    def theirs() -> float:
        kept["peer"] = ceres_blocks.covariance_by_blocks(there, CORES)
        kept["processor"] = kept["peer"][2]["processor"]
        return kept["peer"][2]["seconds"]

    first = {kind: measuring.timed(run)[1] for kind, run in (("jaxgeo", ours), ("peer", theirs))}
    wall, processor = _interleaved({"jaxgeo": ours, "peer": theirs}, {"peer": kept}, repeats)
    columns = [COLUMNS[0], Column("covariances", "s", "lower"), *COLUMNS[2:4], *COLUMNS[8:]]
    table = Table(
        f"{name}: covariances of {len(problem.centres)} orientations and {len(problem.points)} points", columns
    )
    own = float(np.median(wall["jaxgeo"]))
    for kind, title in (("jaxgeo", "jaxgeo"), ("peer", "Ceres's Jacobian, eliminated by NumPy and SciPy")):
        t = float(np.median(wall[kind]))
        spread = 100.0 * (max(wall[kind]) - min(wall[kind])) / t
        table.rows.append([title, t, spread, min(processor[kind]), own / t, first[kind]])
    mine = np.asarray(kept["jaxgeo"][2])[ready.order.row_of_point]
    names = [int(point[1:]) for point in ready.names.point.tolist()]
    apart = np.sqrt(np.diagonal(mine, axis1=1, axis2=2) / np.diagonal(kept["peer"][1][names], axis1=1, axis2=2))
    table.notes.append(f"standard deviations of the points agree to {np.abs(apart - 1.0).max():.1e}")
    table.notes.append("pycolmap's own takes points as if images were known, and ceres::Covariance takes minutes")
    return table


# Scaling.


def strips(images: int, seed: int = 0) -> BlockProblem:
    """Alternating strips of 25 images, 60 % along and 30 % across, observed as in `simulated`."""
    rng = np.random.default_rng(seed)
    height, focal = block_problems.ABOVE, 10_000.0
    wide, high = (height * n / focal for n in (block_problems.WIDTH, block_problems.HEIGHT))
    base, apart = 0.4 * high, 0.7 * wide
    row, along = np.divmod(np.arange(images), STRIP)
    centres = np.stack([row * apart, along * base, np.full(images, height)], axis=1)
    R = np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (images, 3, 3)).copy()
    R[row % 2 == 1] = np.diag([-1.0, 1.0, -1.0])
    half = 0.5 * np.array([wide, high])
    ends = centres.max(axis=0)[:2] + half
    area = np.prod(ends + half)
    count = int(DENSITY * area / base**2)
    places = rng.uniform(-half, ends, (count, 2))
    points = np.concatenate([places, rng.uniform(-20.0, 20.0, (count, 1))], axis=1)
    image, point = _pairs(centres, points, wide, high)
    often = np.bincount(point, minlength=count)[point] >= 2
    kept, point = np.unique(point[often], return_inverse=True)
    camera = np.array([[focal, 0.5 * block_problems.WIDTH, 0.5 * block_problems.HEIGHT, 0.0, 0.0]])
    order = np.argsort(point, kind="stable")
    truth = BlockProblem(
        centres, R, points[kept], camera, np.zeros(images, int), image[often][order], point[order],
        np.zeros((len(point), 2)), block_problems.NOISE, True,
    )  # fmt: skip
    uv = truth.projected()
    return _observed(truth, uv, rng)


def _pairs(centres: np.ndarray, points: np.ndarray, wide: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """(image, point) of the points in each image's field, by rows of images to limit memory."""
    image, point = [], []
    for i, centre in enumerate(centres):
        scale = (centre[2] - points[:, 2]) / centre[2]
        off = np.abs(points[:, :2] - centre[:2]) / scale[:, None]
        seen = np.flatnonzero((off[:, 0] < 0.5 * wide) & (off[:, 1] < 0.5 * high))
        image.append(np.full(len(seen), i))
        point.append(seen)
    return np.concatenate(image), np.concatenate(point)


def _observed(truth: BlockProblem, uv: np.ndarray, rng: np.random.Generator) -> BlockProblem:
    metres, angle = 0.1, float(np.deg2rad(0.02))

    def moved() -> tuple[np.ndarray, np.ndarray]:
        turn = block_problems.rotation_matrices(rng.normal(0.0, angle, truth.centres.shape))
        return truth.centres + rng.normal(0.0, metres, truth.centres.shape), truth.R_world_from_camera @ turn

    pos = block_problems.Pos(*moved(), sigma_centre=metres, sigma_attitude=angle)
    centres, R = moved()
    return replace(
        truth,
        centres=centres,
        R_world_from_camera=R,
        points=truth.points + rng.normal(0.0, 1.0, truth.points.shape),
        uv=uv + rng.normal(0.0, truth.sigma, uv.shape),
        pos=pos,
        truth=replace(truth, uv=uv),
    )


def grown(images: int) -> dict[str, Any]:
    """One block of strips, in this process: seconds with and without compiling, and memory above the baseline."""
    problem = strips(images)
    before = measuring.resident()
    measuring.reset_peak()
    ready, preparing = measuring.timed(lambda: prepared(*block_of(problem)))
    _, first = measuring.timed(lambda: solved(ready))
    spent = time.process_time()
    found, again = measuring.timed(lambda: solved(ready))
    spent = time.process_time() - spent
    at_solve = measuring.peak() - before
    _, first_covariances = measuring.timed(lambda: covariances(ready, found))
    _, spreading = measuring.timed(lambda: covariances(ready, found))
    return {
        "images": images,
        "points": len(problem.points),
        "measurements": len(problem.uv),
        "preparing": preparing,
        "compiling": first - again,
        "solve": again,
        "iterations": len(found.log) - 1,
        "processor": spent,
        "covariances": spreading,
        "compiling_covariances": first_covariances - spreading,
        "peak_solve": at_solve,
        "peak": measuring.peak() - before,
        "sigma0": float(np.sqrt(2.0 * found.log[-1].cost / _redundancy(problem))),
    }


def _redundancy(problem: BlockProblem) -> int:
    return 2 * len(problem.uv) - 3 * len(problem.points) - 5


def growth(sizes: Sequence[int]) -> Table:
    """Blocks of strips, each in its own process."""
    columns = [Column("images"), Column("points"), Column("measurements"), Column("iterations")]
    columns += [Column("solve", "s", "lower"), Column("each iteration", "s", "lower")]
    columns += [Column("each, a measurement", "us", "lower"), Column("processor time of the solve", "s", "lower")]
    columns += [Column("covariances", "s", "lower"), Column("peak of the solve", "MB", "lower")]
    columns += [Column("peak with covariances", "MB", "lower"), Column("putting in order", "s", "lower")]
    columns += [Column("compiling the solve", "s", "lower"), Column("sigma0", "1")]
    table = Table("Growth with the images: strips of 25, 60 % along, 30 % across", columns)
    for size in sizes:
        found = _apart(size)
        if "reason" in found:
            table.notes.append(f"{size} images: {found['reason']}")
            continue
        each = found["solve"] / found["iterations"]
        row = [found[name] for name in ("images", "points", "measurements", "iterations", "solve")]
        row += [each, 1e6 * each / found["measurements"], found["processor"], found["covariances"]]
        row += [1e-6 * found["peak_solve"], 1e-6 * found["peak"], found["preparing"], found["compiling"]]
        table.rows.append([*row, found["sigma0"]])
    table.notes.append("each in a fresh process; memory over that before the block is put in order, compiling included")
    return table


def _apart(images: int) -> dict[str, Any]:
    """`grown` from a fresh process; {'reason': ...} if it fails."""
    command = [sys.executable, str(pathlib.Path(__file__).resolve()), "--grown", str(images)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=1800.0, check=False)
    except subprocess.TimeoutExpired:
        return {"reason": "no answer within half an hour"}
    if done.returncode != 0:
        return {"reason": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:200]}
    return json.loads(done.stdout.strip().splitlines()[-1])


# A complete adjustment through the public function.


def whole(name: str, problem: BlockProblem) -> Table:
    """`adjust` from names and arrays to all covariances, first call and second call."""
    columns = [Column("call"), Column("block", "s", "lower"), Column("adjust", "s", "lower")]
    columns += [Column("all covariances", "s", "lower"), Column("their size", "MB")]
    columns += [Column("sigma0", "1")]
    table = Table(f"{name}, as it is called", columns)
    datum = None if problem.pos is not None else InnerConstraints()
    for call in ("first, with compiling", "again"):
        begin = time.perf_counter()
        block, unknowns = block_of(problem)
        made = time.perf_counter()
        found = adjust(block, unknowns, datum=datum, solver=Solver(relative=TOLERANCE))
        adjusted = time.perf_counter()
        size = found.covariance.nbytes + found.points.sigma.nbytes  # computed lazily
        table.rows.append([call, made - begin, adjusted - made, time.perf_counter() - adjusted, 1e-6 * size])
        table.rows[-1].append(found.sigma0)
    return table


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--skip-growth", action="store_true")
    parser.add_argument("--grown", type=int, help="one block of so many images in this process, as JSON")
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    options = parser.parse_args()
    with measuring.pinned(CORES):
        if options.grown is not None:
            print(json.dumps(grown(options.grown)))
            return
        _, idle = measuring.idle_check()
        print(idle, file=sys.stderr)
        tables = []
        for table in _tables(options):
            tables.append(table)
            print(table.markdown(), flush=True)
    if options.json is not None:
        record = {"machine": measuring.machine(), "idle": idle, "tables": [table.record() for table in tables]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


def _tables(options: argparse.Namespace) -> Any:
    simulated = block_problems.simulated()
    problems = {"Simulated": simulated}
    if BAL.is_file():
        problems["BAL"] = block_problems.bal(BAL)
    else:
        print(f"no BAL problem: {BAL} does not exist; name another folder in JAXGEO_TEST_DATA", file=sys.stderr)
    for name, problem in problems.items():
        try:
            yield side_by_side(name, problem, options.repeats)
            if problem.pos is not None:
                yield spreads(name, problem, options.repeats)
        except ImportError as error:
            print(error, file=sys.stderr)
        yield whole(name, problem)
    if not options.skip_growth:
        yield growth(SIZES)


if __name__ == "__main__":
    main()

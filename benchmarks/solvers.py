"""Solvers side by side: the package's own least squares and those of optimistix, on intersection, resection, the
orientation update and the two-step boresight. Pointing has a benchmark of its own, `pointing.py`.

Run: python benchmarks/solvers.py [--only intersection resection registration boresight] [--repeats 7]
All start from the same values. Times are medians of repeats in alternating order; processor time is that of all
threads.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pathlib
import sys
from collections.abc import Callable
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests" / "register"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import measuring
import numpy as np
import optimistix as optx
from measuring import Column, Table
from scipy.spatial.transform import Rotation

import jaxgeo
from jaxgeo.adjust import forward_intersection, resection
from jaxgeo.uncertainty import ErrorModel, sources

jaxgeo.enable_x64()
TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-8}
SOLVERS = {
    "GaussNewton": optx.GaussNewton(**TIGHT, linear_solver=lx.Normal(lx.Cholesky())),
    "LevenbergMarquardt": optx.LevenbergMarquardt(**TIGHT),
    "Dogleg": optx.Dogleg(**TIGHT),
}
CONTENDERS: dict[str, Any] = {"ours": None} | SOLVERS
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
POINT = jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.002, height=610.0)
ERRORS = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=0.03, pitch=0.02, roll=0.02),
        sources.Position.from_ned(north=1.0, east=1.0, down=1.5),
        sources.PixelMeasurement.from_pixels(column=0.5, row=0.5),
    )
)
KINDS: dict[str, dict[str, Any]] = {
    "sigma": {"sigma": 0.5},
    "sigma, through the air": {"sigma": 0.5, "atmosphere": jaxgeo.Atmosphere()},
    "error model": {"errors": ERRORS},
}
RAYS = 6
FIRST_INTERSECTION = """
import time
from solvers import CONTENDERS, KINDS, SENSOR, rays_of
from jaxgeo.adjust import forward_intersection
shots, uvs = rays_of({kind!r}, 1)
given = KINDS[{kind!r}] | {{"solver": CONTENDERS[{solver!r}]}}
wall, processor = time.perf_counter(), time.process_time()
found = forward_intersection(SENSOR, shots, uvs[0], **given)
assert found.ok
print(time.perf_counter() - wall, time.process_time() - processor)
"""


@jax.jit
def _shots() -> jaxgeo.Shot:
    k = jnp.arange(RAYS)
    pose = jax.vmap(
        lambda k: jaxgeo.Pose(
            jaxgeo.Geodetic(
                lat=jnp.deg2rad(47.0 + 0.001 * (k % 2)), lon=jnp.deg2rad(11.0 + 0.0008 * k), height=1600.0 + 30.0 * k
            ),
            0.1 * k,
            0.0 * k,
            0.0 * k,
        )
    )(k)
    return jaxgeo.Shot(pose, jnp.zeros((RAYS, 0)), 0.0 * k)


def rays_of(kind: str, count: int, sigma: float = 0.5) -> tuple[jaxgeo.Shot, jax.Array]:
    """Shots, and pixels (count, rays, 2) of one point with noise."""
    shots, air = _shots(), KINDS[kind].get("atmosphere")
    exact = jax.jit(jax.vmap(lambda shot: jaxgeo.project(SENSOR, shot, POINT, atmosphere=air).uv))(shots)
    return shots, exact + jnp.asarray(np.random.default_rng(0).normal(0.0, sigma, (count, RAYS, 2)))


def intersection(repeats: int) -> list[Table]:
    """First call in a fresh process, warm calls, batches of 2000, and convergence with gross errors."""
    first = Table(
        "First call of a forward intersection of six rays, fresh process without a compilation cache",
        [Column("weights"), Column("solver"), Column("time", "s", "lower"), Column("processor time", "s", "lower")],
    )
    for kind in KINDS:
        best: dict[str, list[list[float]]] = {name: [] for name in CONTENDERS}
        for repeat in range(3):
            for name in list(CONTENDERS)[:: 1 - 2 * (repeat % 2)]:
                best[name].append(measuring.fresh_process(FIRST_INTERSECTION.format(kind=kind, solver=name)))
        first.rows += [[kind, name, *np.min(best[name], axis=0).tolist()] for name in CONTENDERS]
    warm = Table(
        "Forward intersection, compiled",
        [
            Column("weights"),
            Column("solver"),
            Column("single call", "ms", "lower"),
            Column("2000 in one vmap", "ms", "lower"),
            Column("over ours", "times", "lower"),
            Column("off ours", "m", "lower"),
            Column("converged, a ray 300 px off", "%", "higher"),
        ],
    )
    for kind, given in KINDS.items():
        shots, uvs = rays_of(kind, 2000)
        gross = uvs.at[:, 1, 0].add(300.0)
        runs, single = {}, {}
        for name, solver in CONTENDERS.items():
            one = lambda uv, given=given, shots=shots, solver=solver: forward_intersection(  # noqa: E731
                SENSOR, shots, uv, **given, solver=solver
            )
            many = jax.jit(jax.vmap(lambda uv, one=one: (one(uv).p_ecef, one(uv).status)))
            runs[name] = lambda many=many, uvs=uvs: jax.block_until_ready(many(uvs))
            single[name] = lambda one=one, uvs=uvs: jax.block_until_ready(one(uvs[0]).p_ecef)
            runs[name + " gross"] = lambda many=many, gross=gross: jax.block_until_ready(many(gross))
        found = {name: run() for name, run in runs.items()}
        for run in single.values():
            run()
        batch = measuring.interleaved({name: runs[name] for name in CONTENDERS}, repeats)
        alone = measuring.interleaved(single, 5 * repeats)
        for name in CONTENDERS:
            off = float(np.nanmax(np.abs(found[name][0] - found["ours"][0])))
            share = 100.0 * float(np.mean(np.asarray(found[name + " gross"][1]) == jaxgeo.Status.hit))
            ratio = batch[name].median / batch["ours"].median
            warm.rows.append([kind, name, 1e3 * alone[name].median, 1e3 * batch[name].median, ratio, off, share])
    return [first, warm]


def resections(repeats: int, count: int = 100, points: int = 6) -> list[Table]:
    """Least squares of single images from poor starts: a tenth of the distance and 0.3 rad off."""
    rng = np.random.default_rng(2)
    cases = []
    for case in range(count):
        R = Rotation.from_rotvec(rng.normal(0.0, 1.5, 3)).as_matrix()
        depth = rng.uniform(500.0, 800.0, (points, 1)) if case % 2 else 700.0
        p_camera = np.concatenate([rng.uniform(-0.4, 0.4, (points, 2)), np.ones((points, 1))], axis=1) * depth
        centre = rng.normal(0.0, 1e3, 3)
        ideal = p_camera[:, :2] / p_camera[:, 2:] + rng.normal(0.0, 0.5 / 3700.0, (points, 2))
        start = centre + rng.normal(0.0, 70.0, 3), R @ Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)).as_matrix()
        cases.append((ideal, centre + p_camera @ R.T, *start, centre))
    table = Table(
        f"Resection of {count} images, {points} points each, half of them on a plane",
        [
            Column("solver"),
            Column("first call, processor time", "s", "lower"),
            Column("each later image", "ms", "lower"),
            Column("converged", "%", "higher"),
            Column("off ours", "m", "lower"),
        ],
    )
    refine = {name: resection._refinement(solver) for name, solver in CONTENDERS.items()}
    runs: dict[str, Callable[[], Any]] = {
        name: lambda step=step: [step(*case[:4]) for case in cases] for name, step in refine.items()
    }
    spent: dict[str, list[float]] = {name: [] for name in runs}
    for name, step in refine.items():
        measuring.counting(lambda step=step: step(*cases[0][:4]), spent[name])()
    found = {name: run() for name, run in runs.items()}
    timings = measuring.interleaved(runs, repeats)
    good = {n: np.array([np.linalg.norm(x[1] - c[4]) < 70.0 for x, c in zip(f, cases, strict=True)]) for n, f in found.items()}  # fmt: skip  # noqa: E501
    for name in runs:
        both = good[name] & good["ours"]
        off = max(np.linalg.norm(a[1] - b[1]) for a, b, k in zip(found[name], found["ours"], both, strict=True) if k)
        row = [name, spent[name][0], 1e3 * timings[name].median / count, 100.0 * float(good[name].mean()), float(off)]
        table.rows.append(row)
    table.notes.append("ours is MINPACK's Levenberg-Marquardt in SciPy with numerical derivatives, without compiling")
    return [table]


def _update_by(solver: Any) -> Callable[[Any], Any]:
    """The orientation update's least squares by optimistix: the normal equations of each step as a square system of
    equations, with the weights of the step, in one vector of unknowns from the start."""
    from jaxgeo.register._equations import equations_about
    from jaxgeo.register.tie_errors import squared_length

    def solve(problem: Any) -> Any:
        factor = problem.prior.factor()
        start = problem.model.moved(problem.inputs, jnp.asarray(problem.prior.mean)[:-2])

        def residual(unknowns: jax.Array, _: Any) -> jax.Array:
            at = jax.lax.stop_gradient(unknowns)
            moved = problem.model.moved(dataclasses.replace(start, terrain=problem.inputs.terrain), (factor @ at)[:-2])
            equations = equations_about(problem, factor, moved.exposure, at, jnp.asarray(True))
            lower = jnp.linalg.cholesky(equations.normal)
            right = jax.scipy.linalg.solve_triangular(lower, equations.gradient, lower=True)
            cost = squared_length(equations.whiten(equations.residuals[:, :, None])) + at @ at
            rest = jnp.sqrt(jnp.maximum(cost - right @ right, 0.0))
            return jnp.append(lower.T @ (unknowns - at) + right, rest)

        none = jnp.zeros(factor.shape[0])
        found = optx.least_squares(residual, solver, none, max_steps=60, throw=False)
        return factor @ found.value, found.result == optx.RESULTS.successful, found.stats["num_steps"]

    return eqx.filter_jit(solve)


def registration(repeats: int, rounds: int = 20) -> list[Table]:
    """Updates on rough terrain, where ties cross the edges of cells, with a quarter of gross errors."""
    import test_update as scene  # pyright: ignore[reportMissingImports]

    from jaxgeo.adjust.losses import Huber
    from jaxgeo.observation import Exposure
    from jaxgeo.register._equations import Problem
    from jaxgeo.register._solution import solve
    from jaxgeo.register.prior import Prior
    from jaxgeo.register.ties import padded
    from jaxgeo.uncertainty.model_inputs import ModelInputs, of_arrays

    dem, tie_errors = scene.small_dem(scene.rough(seed=5)), scene.TieErrors(registration=1.0, terrain=1.0, shift=5.0)
    ties, model = scene.dem_ties(dem), scene.platform(3.0)
    exposure = Exposure(scene.looks.sensor(), scene.looks.shot(), jnp.asarray(0.0))
    inputs = ModelInputs(exposure, terrain=of_arrays(dem))
    problems = []
    for seed in range(rounds):
        rng = np.random.default_rng(seed)
        enu = rng.normal(0.0, 1.0, (12, 2)) + (rng.uniform(size=(12, 1)) < 0.25) * rng.normal(0.0, 60.0, (12, 2))
        there = scene.moved_on_map(ties.ground, jnp.asarray(enu))
        moved = scene.TiePoints(ties.uv + rng.normal(0.0, 15.0, 2)[None, :], there, ties.covariance)
        prior = Prior.of(model, tie_errors)
        problems.append(Problem(inputs, model, padded(moved), tie_errors, prior, Huber(), scene.FullJacobian()))

    def ours(problem: Any) -> Any:
        found = solve(problem)
        return found.unknowns, found.status == jaxgeo.Status.hit, found.steps

    runs = {"ours": ours} | {name: _update_by(solver) for name, solver in SOLVERS.items()}
    table = Table(
        f"Orientation updates from {rounds} sets of 12 ties on rough terrain",
        [
            Column("solver"),
            Column("first call, processor time", "s", "lower"),
            Column("each later call", "ms", "lower"),
            Column("converged", "%", "higher"),
            Column("steps, median"),
            Column("off ours where both converge", "sigma", "lower"),
        ],
    )
    spent: dict[str, list[float]] = {name: [] for name in runs}
    for name, run in runs.items():
        measuring.counting(lambda run=run: jax.block_until_ready(run(problems[0])), spent[name])()
    found = {name: [jax.tree.map(np.asarray, run(one)) for one in problems] for name, run in runs.items()}
    timings = measuring.interleaved(
        {name: lambda run=run: jax.block_until_ready([run(one) for one in problems]) for name, run in runs.items()},
        repeats,
    )
    sigma = [np.sqrt(np.diagonal(solve(one).covariance)) for one in problems]
    for name in runs:
        ok = [bool(one[1]) for one in found[name]]
        pairs = zip(found[name], found["ours"], sigma, ok, strict=True)
        off = [float(np.max(np.abs(a[0] - b[0]) / s)) for a, b, s, k in pairs if k and b[1]]
        steps = float(np.median([one[2] for one in found[name]]))
        each = 1e3 * timings[name].median / rounds
        table.rows.append([name, spent[name][0], each, 100.0 * float(np.mean(ok)), steps, max(off, default=np.nan)])
    return [table]


def boresight(repeats: int) -> list[Table]:
    """The second step of a two-step boresight: orientations eliminated in the banded matrix, against a general solver
    that sees all orientations as unknowns."""
    from jaxgeo.adjust import adjust, two_step_boresight
    from jaxgeo.adjust.collinearity import navigation_residual
    from jaxgeo.adjust.problem import observed_of
    from jaxgeo.adjust.reduction import undamped
    from jaxgeo.rotations import R_from_rotation_vector
    from tests.support.simulated_block import simulated

    truth = simulated()
    block = truth.block(control=truth.control(0.02, tuple(truth.points.name[::3])))
    assert block.navigation is not None
    loose = dataclasses.replace(block, navigation=block.navigation.loosened(1000.0))
    adjusted = adjust(loose)
    ready, values = adjusted.prepared, adjusted.solution.values
    matrix = undamped(ready.problem, adjusted.solution.equations)[1]
    n = len(block.images)
    assert matrix.diagonal.shape[0] == 1
    assert ready.problem.of_image == 6
    root = jnp.linalg.cholesky(matrix.diagonal[0]).T
    observed = observed_of(block, ready.names, np.zeros((len(ready.names.strip), 0)))
    images = (observed, values.centre, values.R_frame_from_camera, values.strip[ready.problem.strip_of])
    lever = values.lever[0]

    def residual(unknowns: jax.Array, _: Any) -> jax.Array:
        turn, steps = unknowns[:3], unknowns[3:].reshape(n, 6)

        def one(step: jax.Array, image: Any) -> jax.Array:
            of, centre, R, strip = image
            R = R @ R_from_rotation_vector(step[3:])
            return navigation_residual(
                of, centre + step[:3], R, R_from_rotation_vector(turn), lever, strip, values.common
            )

        return jnp.concatenate([jax.vmap(one)(steps, images).ravel(), root @ unknowns[3:]])

    start = jnp.zeros(3 + 6 * n)
    whole = two_step_boresight(adjusted, navigation=block.navigation)
    runs: dict[str, Callable[[], Any]] = {
        "ours": lambda: two_step_boresight(adjusted, navigation=block.navigation).turn
    }
    for name, solver in SOLVERS.items():
        by = eqx.filter_jit(lambda solver=solver: optx.least_squares(residual, solver, start, throw=False).value[:3])
        runs[name] = lambda by=by: jax.block_until_ready(by())
    table = Table(
        f"Second step of a two-step boresight, {n} images",
        [Column("solver"), Column("unknowns"), Column("time", "ms", "lower"), Column("off ours", "rad", "lower")],
    )
    found = {name: np.asarray(run()) for name, run in runs.items()}
    timings = measuring.interleaved(runs, repeats)
    for name in runs:
        off = float(np.max(np.abs(found[name] - whole.turn)))
        table.rows.append([name, 3 if name == "ours" else 3 + 6 * n, 1e3 * timings[name].median, off])
    return [table]


PARTS = {
    "intersection": intersection,
    "resection": resections,
    "registration": registration,
    "boresight": boresight,
}


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    options = parser.parse_args()
    _, idle = measuring.idle_check()
    print(idle, file=sys.stderr)
    tables = [table for part in options.only for table in PARTS[part](options.repeats)]
    for table in tables:
        print(table.markdown(), flush=True)
    if options.json is not None:
        record = {"machine": measuring.machine(), "idle": idle, "tables": [table.record() for table in tables]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

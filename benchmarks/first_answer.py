"""Time to a first answer: each call in a fresh process on one core, without and with programs kept on disk.

Run: python benchmarks/first_answer.py [--repeats 5] [--only locate,sample] [--against TREE] [--json out.json]
`--against` names another checkout, measured in the same run in alternating order. Processor time is that of all
threads of the process; the later lines of a process are calls after its first: with another count, another number of
pixels, one more error source.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

HERE = pathlib.Path(__file__).resolve()
KINDS = ("import", "locate", "accuracy", "sample", "compare", "point", "derivatives", "batch", "project")
PIXELS, POINTS, SAMPLES = (1200.0, 2400.0), 5000, 10_000


def main() -> None:
    parser = argparse.ArgumentParser(description="Time to a first answer.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default=",".join(KINDS))
    parser.add_argument("--against", type=pathlib.Path, help="another checkout")
    parser.add_argument("--json", type=pathlib.Path, help="write the table there as JSON")
    parser.add_argument("--process", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.process:
        print(json.dumps(list(_measured(options.process))))
        return
    sys.path.insert(0, str(HERE.parent))
    import measuring

    trees = {"this": HERE.parents[1]}
    if options.against is not None:
        trees["before"] = options.against.resolve()
    columns = [measuring.Column("call"), measuring.Column("kept programs"), measuring.Column("tree")]
    columns += [measuring.Column(f"{kind} time", "s", "lower") for kind in ("processor", "wall")]
    table = measuring.Table(f"First answers, medians of {options.repeats}, one core", columns)
    for kind in options.only.split(","):
        for is_kept in (False, True):
            for name, found in _medians(kind, trees, is_kept, options.repeats).items():
                for call, processor, wall in found:
                    table.rows.append([call, "yes" if is_kept else "no", name, processor, wall])
    print(table.markdown())
    if options.json is not None:
        record = {"machine": measuring.machine(), "tables": [table.record()]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


def _medians(
    kind: str, trees: dict[str, pathlib.Path], is_kept: bool, repeats: int
) -> dict[str, list[tuple[str, float, float]]]:
    """(call, processor s, wall s) of each tree, medians over fresh processes in alternating order."""
    found: dict[str, list[Any]] = {name: [] for name in trees}
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(repeats + is_kept):
            for name in trees if repeat % 2 == 0 else reversed(trees):
                each = _in_a_process(kind, trees[name], pathlib.Path(folder) / name if is_kept else None)
                if repeat or not is_kept:  # the first one fills the folder
                    found[name].append(each)
    median: Callable[[Any], float] = statistics.median
    return {
        name: [
            (rows[0][0], median([row[1] for row in rows]), median([row[2] for row in rows]))
            for rows in zip(*runs, strict=True)
        ]
        for name, runs in found.items()
    }


def _in_a_process(kind: str, tree: pathlib.Path, folder: pathlib.Path | None) -> Any:
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    environment |= {} if folder is None else {"JAX_COMPILATION_CACHE_DIR": str(folder)}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    command = [sys.executable, str(HERE), "--process", kind]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=tree)
    if done.returncode != 0:
        raise RuntimeError(f"{kind} in {tree}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def _measured(kind: str) -> Iterator[tuple[str, float, float]]:
    """(call, processor s, wall s) of the first call of a kind, and of those after it."""
    os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[0]})
    if kind == "import":
        yield "import", *_timed(lambda: __import__("jaxgeo"))
        return
    for name, call in _calls(kind):
        yield name, *_timed(call)


def _timed(call: Callable[[], Any]) -> tuple[float, float]:
    wall, processor = time.perf_counter(), time.process_time()
    found = call()
    if found is not None and "jax" in sys.modules and not hasattr(found, "__path__"):
        import jax

        jax.block_until_ready(jax.tree.leaves(found))
    return time.process_time() - processor, time.perf_counter() - wall


def _calls(kind: str) -> list[tuple[str, Callable[[], Any]]]:
    """The first call of a kind and further ones, on the packaged terrain."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import jaxgeo
    from jaxgeo.uncertainty import ErrorModel, presets, sample, sources

    jaxgeo.enable_x64()
    camera = jaxgeo.FrameCamera.from_metric(focal_length=0.075, pixel_pitch=5.5e-6, width=2400, height=4800)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
    pose = jaxgeo.Pose.from_degrees(lat=36.318, lon=-84.105, height=5469.0, heading=160.0)
    shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(outer=72.0, inner=0.0))
    dem, errors, uv = jaxgeo.io.example_dem(), presets.li_2023(terrain_height=5.0), np.array(PIXELS)
    more = ErrorModel((*errors.sources, sources.Boresight.from_degrees(heading=0.01, pitch=0.01, roll=0.01)))
    pixels = np.random.default_rng(0).uniform([0.0, 0.0], [2400.0, 4800.0], (2 * POINTS, 2))
    key = jax.block_until_ready(jax.random.key(0))
    of_many = jax.vmap(jaxgeo.locate, in_axes=(None, None, 0, None))
    target = jaxgeo.Geodetic.from_degrees(lat=36.28, lon=-84.10, height=400.0)
    new: dict[str, Any] = {"key": key, "count": SAMPLES}
    new = {"sampling": jaxgeo.Sampling(count=SAMPLES)} if hasattr(jaxgeo, "Sampling") else new
    point = getattr(jaxgeo.coverage, "point_gimbal", None) or jaxgeo.coverage.point

    def sampled(count: int, model: ErrorModel) -> Any:
        return tuple(sample(sensor, shot, uv, dem, model, key=key, count=count).circular_error(0.9))

    def accuracy(model: ErrorModel) -> Any:
        return jaxgeo.accuracy(sensor, shot, uv, dem, model).circular

    return {
        "locate": [("locate", lambda: jaxgeo.locate(sensor, shot, uv, dem))],
        "project": [("project", lambda: jaxgeo.project(sensor, shot, target))],
        "accuracy": [
            ("accuracy", lambda: accuracy(errors)),
            ("accuracy, one more source", lambda: accuracy(more)),
        ],
        "sample": [
            (f"sample, {SAMPLES}", lambda: sampled(SAMPLES, errors)),
            (f"sample, then {4 * SAMPLES}", lambda: sampled(4 * SAMPLES, errors)),
            ("sample, one more source", lambda: sampled(SAMPLES, more)),
        ],
        "compare": [("compare", lambda: jaxgeo.compare(sensor, shot, uv, dem, errors, **new).rows[0].values)],
        "point": [("point", lambda: point(sensor, shot, target=target).readings)],
        "derivatives": [
            ("jacfwd", lambda: jax.jacfwd(lambda uv: jaxgeo.locate(sensor, shot, uv, dem).ecef)(jnp.asarray(uv)))
        ],
        "batch": [
            (f"vmap, {POINTS}", lambda: of_many(sensor, shot, pixels[:POINTS], dem)),
            (f"vmap, then {2 * POINTS}", lambda: of_many(sensor, shot, pixels, dem)),
        ],
    }[kind]


if __name__ == "__main__":
    main()

"""Speed of pointing gimbals: batches in one `vmap` and first calls of single pointings, by optimistix and by
`FixedNewton`, against SciPy's solver on single pointings.

Run: python benchmarks/pointing.py [--count 100000] [--alone 300] [--repeats 7] [--json out.json]
Figures are medians of repeats in alternating order; processor time, that of all threads, is the minimum.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
from collections.abc import Callable
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import equinox as eqx
import jax
import jax.numpy as jnp
import measuring
import numpy as np
import optimistix as optx
from measuring import Column, Table
from peers import scipy_pointing

import jaxgeo
from jaxgeo.coverage import FixedNewton, point_gimbal
from jaxgeo.sensor import boresight_from_degrees
from jaxgeo.sensor.root_finder import default_root_finder

jaxgeo.enable_x64()
SOLVED = 1e-9  # rad, tolerance of the line of sight
HELD = {
    "R_body_from_base": boresight_from_degrees(heading=1.0, pitch=-2.0, roll=0.5),
    "lever_body": np.array([3.0, -1.0, 0.5]),
    "lever_head": np.array([0.2, 0.1, -0.3]),
}
CAMERA = jaxgeo.FrameCamera.from_metric(focal_length=0.075, pixel_pitch=5.5e-6, width=2400, height=4800)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir(**HELD))
DRIVES = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward(**HELD))
AIR = jaxgeo.Atmosphere()
SENSORS = {
    "two axes": (SENSOR, None),
    "two axes, through the air": (SENSOR, AIR),
    "a drone's three axes": (DRIVES, None),
}
SOLVERS = {
    "FixedNewton": FixedNewton(),
    "optimistix.Newton": default_root_finder(),
    "optimistix.LevenbergMarquardt": optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
}
FIRST_CALL = """
import time
import numpy as np
import jaxgeo
jaxgeo.enable_x64()
from jaxgeo.coverage import FixedNewton, point_gimbal
from pointing import AIR, DRIVES, SENSOR
kind, solver = {asked!r}
sensor, air = {{"two axes": (SENSOR, None), "a drone's three axes, through the air": (DRIVES, AIR)}}[kind]
shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=3000.0))
target = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.02, height=600.0)
wall, processor = time.perf_counter(), time.process_time()
given = dict(target=target, atmosphere=air, solver=FixedNewton() if solver else None)
found = point_gimbal(sensor, shot, **given)
assert found.ok
print(time.perf_counter() - wall, time.process_time() - processor)
wall = time.perf_counter()
for _ in range(50):
    point_gimbal(sensor, shot, **given).readings.block_until_ready()
print((time.perf_counter() - wall) / 50)
"""


def scene(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 6) 3 to 12 km high, in rad and m, and targets (n, 3), up to 75 deg off nadir on either side."""
    rng = np.random.default_rng(seed)
    lat, lon, height = rng.uniform(-1.2, 1.2, count), rng.uniform(-3.1, 3.1, count), rng.uniform(3e3, 1.2e4, count)
    attitude = np.stack([rng.uniform(-np.pi, np.pi, count), *rng.normal(0.0, 0.05, (2, count))])
    ground = rng.uniform(0.0, 2e3, count)
    reach, azimuth = (height - ground) * np.tan(rng.uniform(0.0, 1.3, count)), rng.uniform(-np.pi, np.pi, count)
    by_lat, by_lon = reach * np.cos(azimuth) / 6.37e6, reach * np.sin(azimuth) / 6.37e6 / np.cos(lat)
    return np.stack([lat, lon, height, *attitude], axis=1), np.stack([lat + by_lat, lon + by_lon, ground], axis=1)


@eqx.filter_jit
def pointed(sensor: jaxgeo.Sensor, poses: Any, targets: Any, air: Any = None, solver: Any = None) -> Any:
    """Readings and pointing errors of every pose and target."""

    def one(pose: Any, target: Any) -> Any:
        shot = jaxgeo.Shot(jaxgeo.Pose(jaxgeo.Geodetic(lat=pose[0], lon=pose[1], height=pose[2]), *pose[3:]))
        place = jaxgeo.Geodetic(lat=target[0], lon=target[1], height=target[2])
        return point_gimbal(sensor, shot, target=place, atmosphere=air, solver=solver)

    return jax.vmap(one)(poses, targets)


@jax.jit
@jax.vmap
def missed(pose: Any, target: Any, readings: Any) -> Any:
    """Angle in rad between the optical axis with these readings and the target."""
    place = jaxgeo.Geodetic(lat=pose[0], lon=pose[1], height=pose[2])
    target_ecef = jaxgeo.WGS84.to_ecef(jaxgeo.Geodetic(lat=target[0], lon=target[1], height=target[2]))
    x, y, z = SENSOR.to_camera(jaxgeo.Shot(jaxgeo.Pose(place, *pose[3:]), readings), target_ecef)
    return jnp.arctan2(jnp.hypot(x, y), z)


def peer(poses: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """SciPy's readings, one pointing after another."""
    sight = np.array([0.0, 0.0, 1.0])
    held = scipy_pointing.Held(np.asarray(HELD["R_body_from_base"]), HELD["lever_body"], HELD["lever_head"], sight)
    return np.stack([scipy_pointing.readings(held, p, t) for p, t in zip(poses, targets, strict=True)])


def rates(count: int, alone: int, repeats: int) -> Table:
    """Pointings per second, compared."""
    poses, targets = scene(count)
    given = jnp.asarray(poses), jnp.asarray(targets)
    ready = jax.block_until_ready
    runs: dict[str, tuple[int, Callable[[], Any]]] = {
        "SciPy, root(hybr), one at a time": (alone, lambda: peer(poses[:alone], targets[:alone])),
        "jaxgeo, two axes, one vmap": (count, lambda: ready(pointed(SENSOR, *given))),
        "jaxgeo, two axes, through the air": (count, lambda: ready(pointed(SENSOR, *given, AIR))),
        "jaxgeo, a drone's three axes": (count, lambda: ready(pointed(DRIVES, *given))),
    }
    first = {name: measuring.timed(run)[1] for name, (_, run) in runs.items()}
    spent: dict[str, list[float]] = {name: [] for name in runs}
    watch = measuring.Watch()
    timings = measuring.interleaved(
        {name: measuring.counting(run, spent[name]) for name, (_, run) in runs.items()}, repeats
    )
    columns = [Column("contender"), Column("pointings"), Column("time", "ms", "lower"), Column("spread", "%", "lower")]
    columns += [Column("rate", "pointings/s", "higher"), Column("rate over SciPy's", "times", "higher")]
    columns += [Column("processor time, least", "us/pointing", "lower")]
    columns += [Column("the same over jaxgeo's", "times"), Column("first call, with compiling", "s", "lower")]
    table = Table("Pointing a gimbal with lever arms and a boresight", columns)
    each = {name: 1e6 * min(spent[name]) / n for name, (n, _) in runs.items()}
    base = timings["SciPy, root(hybr), one at a time"].median / alone
    own = each["jaxgeo, two axes, one vmap"]
    for name, (n, _) in runs.items():
        t = timings[name]
        row = [name, n, 1e3 * t.median, 100.0 * t.spread, n / t.median, base * n / t.median]
        table.rows.append([*row, each[name], each[name] / own, first[name]])
    table.notes.append(f"medians of {repeats}; other processes used {watch.others():.2f} cores")
    return table


def agreement(alone: int) -> Table:
    """Agreement of both, and the number that each solves: within 1e-9 rad of the target, within the limits."""
    poses, targets = scene(alone, seed=1)
    given = jnp.asarray(poses), jnp.asarray(targets)
    theirs, found = peer(poses, targets), pointed(SENSOR, *given)
    ours, limits = np.asarray(found.readings), np.asarray(SENSOR.gimbal.limits)
    wrapped = (theirs + np.pi) % (2.0 * np.pi) - np.pi
    off = {
        "SciPy": np.asarray(missed(*given, jnp.asarray(wrapped))),
        "jaxgeo": np.asarray(missed(*given, found.readings)),
    }
    inside = {
        name: np.all((r >= limits[:, 0]) & (r <= limits[:, 1]), axis=1)
        for name, r in (("SciPy", wrapped), ("jaxgeo", ours))
    }
    solved = {name: (off[name] <= SOLVED) & inside[name] for name in off}
    both = solved["SciPy"] & solved["jaxgeo"]
    table = Table("Agreement with SciPy", [Column("what"), Column("SciPy"), Column("jaxgeo")])
    table.rows = [
        ["solved, %", *(100.0 * float(np.mean(solved[name])) for name in off)],
        ["farthest off the target where solved, rad", *(float(np.max(off[name][solved[name]])) for name in off)],
        ["looks away from the target, or no root, %", *(100.0 * float(np.mean(~(off[n] <= SOLVED))) for n in off)],
        ["beyond the limits, %", *(100.0 * float(np.mean((off[n] <= SOLVED) & ~inside[n])) for n in off)],
    ]
    apart = float(np.max(np.abs(wrapped - ours)[both]))
    table.notes.append(f"readings of both, where both solve: at most {apart:.2g} rad apart, of {int(np.sum(both))}")
    table.notes.append(f"of {alone} targets up to 75 deg off nadir; SciPy starts from readings of zero")
    return table


def solvers(count: int, repeats: int) -> Table:
    """Every solver on the same batch: time in one `vmap`, the share solved, and agreement of the readings."""
    poses, targets = scene(count, seed=2)
    given = jnp.asarray(poses), jnp.asarray(targets)
    columns = [
        Column("gimbal"),
        Column("solver"),
        Column("time in one vmap", "ms", "lower"),
        Column("over FixedNewton's", "times", "lower"),
    ]
    columns += [Column("first call, with compiling", "s", "lower"), Column("processor time of it", "s", "lower")]
    columns += [
        Column("solved, of those in range", "%", "higher"),
        Column("readings off FixedNewton's", "rad", "lower"),
    ]
    table = Table(f"Solvers on {count} pointings in one vmap", columns)
    for gimbal, (sensor, air) in SENSORS.items():
        runs = {
            name: lambda solver=solver, sensor=sensor, air=air: jax.block_until_ready(
                pointed(sensor, *given, air, solver)
            )
            for name, solver in SOLVERS.items()
        }
        spent: dict[str, list[float]] = {name: [] for name in runs}
        first = {name: measuring.timed(measuring.counting(run, spent[name])) for name, run in runs.items()}
        timings = measuring.interleaved(runs, repeats)
        own = first["FixedNewton"][0]
        in_range = np.asarray(own.status) != jaxgeo.Status.outside_gimbal_range
        for name, (found, seconds) in first.items():
            ok = np.asarray(found.status) == jaxgeo.Status.hit
            apart = np.max(np.abs(np.asarray(found.readings - own.readings)[ok & np.asarray(own.ok)]))
            ratio = timings[name].median / timings["FixedNewton"].median
            row = [gimbal, name, 1e3 * timings[name].median, ratio, seconds, spent[name][0]]
            table.rows.append([*row, 100.0 * float(np.mean(ok[in_range])), float(apart)])
    table.notes.append(f"medians of {repeats}, in turning order; all start from the same closed form")
    return table


def first_calls(repeats: int) -> Table:
    """A single pointing in a fresh process without a compilation cache: the default, and `FixedNewton`."""
    columns = [
        Column("gimbal"),
        Column("solver"),
        Column("first call", "s", "lower"),
        Column("processor time", "s", "lower"),
    ]
    columns += [Column("over FixedNewton's", "", "lower"), Column("each later call", "ms", "lower")]
    table = Table("The first call of a single pointing", columns)
    for gimbal in ("two axes", "a drone's three axes, through the air"):
        best: dict[bool, list[float]] = {}
        for _ in range(repeats):
            for own in (False, True):
                figures = measuring.fresh_process(FIRST_CALL.format(asked=(gimbal, own)))
                best[own] = [min(pair) for pair in zip(figures, best.get(own, figures), strict=True)]
        for own, name in ((True, "FixedNewton"), (False, "optimistix.Newton, the default")):
            wall, processor, later = best[own]
            table.rows.append([gimbal, name, wall, processor, processor / best[True][1], 1e3 * later])
    table.notes.append(f"the least of {repeats} processes each, in turn; importing optimistix and lineax is included")
    return table


def memory(count: int) -> Table:
    """Peak memory of one call above that of the process before it."""
    poses, targets = scene(count)
    given = jnp.asarray(poses), jnp.asarray(targets)
    jax.block_until_ready(pointed(SENSOR, *given))
    before = measuring.resident()
    measuring.reset_peak()
    jax.block_until_ready(pointed(SENSOR, *given))
    grown = measuring.peak() - before
    columns = [Column("pointings"), Column("peak over a warm process", "MB", "lower"), Column("each", "bytes", "lower")]
    return Table("Memory of one call", columns, [[count, 1e-6 * grown, grown / count]])


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--alone", type=int, default=300, help="pointings of SciPy a repeat")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    options = parser.parse_args()
    _, idle = measuring.idle_check()
    print(idle, file=sys.stderr)
    tables = [
        first_calls(3),
        solvers(options.count // 10, options.repeats),
        rates(options.count, options.alone, options.repeats),
        agreement(10 * options.alone),
        memory(options.count),
    ]
    for table in tables:
        print(table.markdown(), flush=True)
    if options.json is not None:
        record = {"machine": measuring.machine(), "idle": idle, "tables": [table.record() for table in tables]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Speed of Monte Carlo sampling: perturb, locate and summarise one pixel on real terrain, compared with NumPy.

Run: python benchmarks/sampling.py [--full] [--repeats 5] [--only rates,agreement,surety,doors,memory] [--json out.json]
`--full` goes up to 1e7 samples, which takes NumPy minutes. Figures are medians of repeats in alternating order.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import jax
import measuring
import numpy as np
from measuring import Column, Table
from peers import numpy_sampling

import jaxgeo
from jaxgeo.uncertainty import ErrorModel, Footprint, Random, Sobol, presets, sources
from jaxgeo.uncertainty.sampling import CHUNK

DEVICES = 2
jax.config.update("jax_num_cpu_devices", DEVICES)  # before JAX initialises its devices
jaxgeo.enable_x64()
COUNTS = (10_000, 1_000_000, 10_000_000)
GOAL = 10.0  # times NumPy
TIE = 1e-3  # m: hits of the same errors that differ by more are ties or mistakes
SCRAMBLED = 16 * 1024
GRAZING = {"outer": 80.0, "inner": 8.0}  # degrees: past a ridge, behind which some rays hit far away
CAMERA = jaxgeo.FrameCamera.from_metric(focal_length=0.075, pixel_pitch=5.5e-6, width=2400, height=4800)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
POSE = jaxgeo.Pose.from_degrees(lat=36.318, lon=-84.105, height=5469.0, heading=160.0)
SHOT = jaxgeo.Shot(POSE, SENSOR.gimbal.readings_from_degrees(outer=72.0, inner=0.0))
PIXEL = np.array([1200.0, 2400.0])
ERRORS = presets.li_2023(terrain_height=5.0)
FIELD = sources.TerrainField.of_variograms(gaussian=[(3.0, 500.0)], spherical=[(2.0, 2000.0)])
WITH_FIELD = ErrorModel((*ERRORS.sources[:-1], FIELD))
KEY = jax.random.key(0)


def sampled(dem: jaxgeo.Dem, count: int, errors: ErrorModel = ERRORS, shot: Any = SHOT, **options: Any) -> Any:
    """Samples of the pixel, and its CE90, so that the statistics are included in the time."""
    options = {"key": KEY, **options}
    drawn = jaxgeo.uncertainty.sample(SENSOR, shot, PIXEL, dem, errors, count=count, **options)
    return drawn, drawn.circular_error(0.9)


def scene_of(dem: jaxgeo.Dem) -> numpy_sampling.Scene:
    """The same scene as plain numbers for NumPy."""
    rows, cols = (int(size) for size in np.asarray(dem.extent))
    grid: Any = dem.grid
    step, middle, centre = (np.asarray(x) for x in (grid.step, grid.rowcol0, grid.lonlat0))
    by_row, by_col = float(step[1, 0]), float(step[0, 1])
    at, readings = POSE.position, np.asarray(SHOT.gimbal_readings)
    return numpy_sampling.Scene(
        posts=np.asarray(dem.posts, float)[:rows, :cols],
        first=(float(centre[1] - middle[0] * by_row), float(centre[0] - middle[1] * by_col)),
        step=(by_row, by_col),
        position=(float(at.lat), float(at.lon), float(at.height)),
        attitude=(float(POSE.heading), float(POSE.pitch), float(POSE.roll)),
        readings=(float(readings[0]), float(readings[1])),
        line=np.asarray(CAMERA.ray(PIXEL)[0]),
        sigma=np.concatenate([np.asarray(source.sigma) for source in ERRORS.sources]),
    )


def rates(dem: jaxgeo.Dem, counts: tuple[int, ...], repeats: int) -> list[Table]:
    """Samples per second, compared."""
    scene, two, one = scene_of(dem), jax.devices(), jax.devices()[:1]
    columns = [Column("contender"), Column("samples"), Column("time", "ms", "lower"), Column("spread", "%", "lower")]
    columns += [Column("rate", "samples/s", "higher"), Column("rate over NumPy's", "times", "higher")]
    columns += [Column("processor time, least", "us/sample", "lower")]
    table = Table("Sampling one pixel: draws, lines of sight, first hits, figures", columns)
    watch = measuring.Watch()
    for count in counts:
        runs: dict[str, Callable[[], Any]] = {
            "NumPy": lambda count=count: numpy_sampling.sampled(scene, count, np.random.default_rng(0)),
            f"jaxgeo, {len(two)} devices": lambda count=count: sampled(dem, count, devices=two),
            "jaxgeo, 1 device": lambda count=count: sampled(dem, count, devices=one),
        }
        for name, run in runs.items():
            if name != "NumPy":
                run()
        spent: dict[str, list[float]] = {name: [] for name in runs}
        timings = measuring.interleaved(
            {name: measuring.counting(run, spent[name]) for name, run in runs.items()}, repeats
        )
        base = timings["NumPy"].median
        for name, timing in timings.items():
            t, processor = timing.median, 1e6 * min(spent[name]) / count
            table.rows.append([name, count, 1e3 * t, 100.0 * timing.spread, count / t, base / t, processor])
    table.notes.append(f"li_2023 and the terrain's height, 344 x 403 posts of 90 m; goal: {GOAL:g} times NumPy")
    table.notes.append(f"medians of {repeats}; other processes used {watch.others():.2f} cores")
    return [table]


def agreement(dem: jaxgeo.Dem, count: int = 10_000) -> list[Table]:
    """Agreement of both: hits for the same errors, and circular errors for independent draws."""
    scene = scene_of(dem)
    drawn, circular = sampled(dem, count, keep=True, draws=Random())
    normals = jax.vmap(lambda number: Random().standard_normal(KEY, number, ERRORS.size))(np.arange(count))
    apart = np.linalg.norm(numpy_sampling.misses(scene, np.asarray(normals)) - drawn.errors_enu, axis=1)
    theirs = numpy_sampling.sampled(scene, count, np.random.default_rng(1))
    columns = [Column("what"), Column("value"), Column("should be")]
    table = Table("Agreement with NumPy", columns)
    ties = np.flatnonzero(~(apart <= TIE))
    table.rows = [
        ["hits of the same errors: farthest apart, m", float(np.nanmax(apart)), f"at most {TIE:g}"],
        ["hits farther apart, or only one of both found", int(ties.size), f"few of {count}"],
        ["CE90 of NumPy, m", theirs.circular, f"{circular.low:.3f} to {circular.high:.3f}, or a little beside"],
    ]
    if ties.size:
        table.notes.append(f"samples with other hits: {', '.join(map(str, ties[:20]))}")
    return [table]


def surety(dem: jaxgeo.Dem, keys: int = 200, truth: int = 2**22) -> list[Table]:
    """Error of CE90 from few samples against very many, and the coverage of its confidence interval."""
    grazing = jaxgeo.Shot(POSE, SENSOR.gimbal.readings_from_degrees(**GRAZING))
    columns = [Column("ground"), Column("draws"), Column("samples, mean"), Column("spread of CE90", "%", "lower")]
    columns += [Column("mean less truth", "%"), Column("intervals that hold it", "%", "higher")]
    table = Table(f"How sure CE90 is, over {keys} keys", columns)
    ways: dict[str, dict[str, Any]] = {
        "random": {"count": SCRAMBLED, "draws": Random()},
        "Sobol": {"count": SCRAMBLED, "draws": Sobol()},
        "random, to 0.2 % on either side": {"count": 1_000_000, "half_width": 0.002, "draws": Random()},
        "Sobol, to 0.2 % on either side": {
            "count": 1_024_000,
            "half_width": 0.002,
            "draws": Sobol(),
        },
    }
    for ground, shot in {"a slope": SHOT, "ridges": grazing}.items():
        _, true = sampled(dem, truth, shot=shot, key=jax.random.key(1_000_000), draws=Sobol())
        for name, way in ways.items():
            runs = [sampled(dem, shot=shot, key=jax.random.key(1 + number), **way) for number in range(keys)]
            relative = np.array([ce.value for _, ce in runs]) / true.value - 1.0
            holds = np.array([ce.low <= true.value <= ce.high for _, ce in runs])
            counts = np.mean([drawn.count for drawn, _ in runs])
            row = [ground, name, int(counts), 100.0 * relative.std(), 100.0 * relative.mean(), 100.0 * holds.mean()]
            table.rows.append(row)
    table.notes.append(f"the truth is that of {truth} Sobol points; intervals are asked to hold 95 %")
    return [table]


def doors(dem: jaxgeo.Dem, repeats: int) -> list[Table]:
    """Warm latency of the public functions for one pixel."""
    from jaxgeo.uncertainty import accuracy, budget, propagate

    look = (SENSOR, SHOT, PIXEL, dem)
    linear = propagate(*look, ERRORS)
    ready = jax.block_until_ready
    runs: dict[str, tuple[int | None, Callable[[], Any]]] = {
        "sample, 1e4": (10_000, lambda: sampled(dem, 10_000)),
        "sample, 1e4, 1 device": (10_000, lambda: sampled(dem, 10_000, devices=jax.devices()[:1])),
        "sample, 16 x 1024 Sobol points": (SCRAMBLED, lambda: sampled(dem, SCRAMBLED, draws=Sobol())),
        "sample, 16 x 1024 random": (SCRAMBLED, lambda: sampled(dem, SCRAMBLED, draws=Random())),
        "the same with a field of terrain errors": (SCRAMBLED, lambda: sampled(dem, SCRAMBLED, WITH_FIELD)),
        "propagate": (None, lambda: ready(propagate(*look, ERRORS).cov_enu)),
        "propagate over the footprint": (None, lambda: ready(propagate(*look, ERRORS, slope=Footprint()).cov_enu)),
        "budget of a propagation": (None, lambda: budget(linear)),
        "accuracy": (None, lambda: accuracy(*look, ERRORS)),
    }
    first = {name: measuring.timed(run)[1] for name, (_, run) in runs.items()}
    timings = measuring.interleaved({name: run for name, (_, run) in runs.items()}, repeats)
    columns = [Column("call"), Column("time", "ms", "lower"), Column("spread", "%", "lower")]
    columns += [Column("rate", "samples/s", "higher"), Column("first call, with compiling", "s", "lower")]
    table = Table("Warm calls about one pixel", columns)
    for name, timing in timings.items():
        count = runs[name][0]
        rate = None if count is None else count / timing.median
        table.rows.append([name, 1e3 * timing.median, 100.0 * timing.spread, rate, first[name]])
    method = accuracy(*look, ERRORS).words
    table.notes.append(f"goal: 1e4 samples within 25 ms; accuracy selects {method} here; {DEVICES} devices")
    return [table]


def memory(counts: tuple[int, ...]) -> list[Table]:
    """Peak memory and processor time of sampling with and without `summary`, each count in its own process."""
    columns = [Column("samples"), Column("kept"), Column("peak over a warm process", "MB", "lower")]
    columns += [Column("while CE90 is asked for", "MB", "lower"), Column("processor time", "s", "lower")]
    columns += [Column("CE90", "m")]
    table = Table("Memory of sampling CE, LE and SE", columns)
    for count in counts:
        for kept in ("radii", "summary"):
            command = [sys.executable, __file__, "--memory-of", str(count), "--kept", kept]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            peak, asked, spent, circular = json.loads(done.stdout.strip().splitlines()[-1])
            table.rows.append([count, kept, 1e-6 * peak, 1e-6 * asked, spent, circular])
    table.notes.append("a warm process has drawn two chunks; growth of its peak while it draws, and while it then asks")
    return [table]


def memory_of(count: int, summary: bool) -> list[float]:
    """Peak bytes above those held before, while drawing samples and while computing a quantile; s; CE90 in m."""
    dem = jaxgeo.io.example_dem()
    sampled(dem, 2 * CHUNK, figures=("CE",), summary=summary)
    before = measuring.resident()
    measuring.reset_peak()
    begin = time.process_time()
    drawn = jaxgeo.uncertainty.sample(SENSOR, SHOT, PIXEL, dem, ERRORS, key=KEY, count=count, summary=summary)
    spent = time.process_time() - begin
    drawing = measuring.peak()
    measuring.reset_peak()
    circular = drawn.circular_error(0.9)
    return [drawing - before, measuring.peak() - before, spent, circular.value]


def main() -> None:
    """Run the selected measurements, print and save them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="rates,agreement,surety,doors,memory")
    parser.add_argument("--full", action="store_true", help="up to 1e7 samples")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    parser.add_argument("--memory-of", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--kept", default="radii", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory_of:
        print(json.dumps(memory_of(options.memory_of, options.kept == "summary")))
        return
    _, idle = measuring.idle_check()
    print(idle, file=sys.stderr)
    dem = jaxgeo.io.example_dem()
    counts = COUNTS if options.full else COUNTS[:2]
    parts: dict[str, Callable[[], list[Table]]] = {
        "rates": lambda: rates(dem, counts, options.repeats),
        "agreement": lambda: agreement(dem),
        "surety": lambda: surety(dem),
        "doors": lambda: doors(dem, options.repeats),
        "memory": lambda: memory(COUNTS[1:]),
    }
    tables: list[Table] = []
    for name in options.only.split(","):
        for table in parts[name]():
            print(table.markdown(), flush=True)
            tables.append(table)
    if options.json is not None:
        record = {"machine": measuring.machine(), "idle": idle, "tables": [table.record() for table in tables]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

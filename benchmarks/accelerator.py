"""Speed and correctness of jaxgeo on one JAX device; each result is compared with a CPU's in the same process.

Run: python benchmarks/accelerator.py [--device cpu|gpu] [--full] [--only a,b] [--repeats 3] [--json out.json]
`--full` goes up to 1e8 rays and 1e9 samples. Rates are medians; the first call, which compiles, is apart. Terrain:
2001 x 2001 posts 30 m apart, 0 to 3000 m. Rays: nine tenths random, 60-79 degrees off nadir; one tenth graze a patch.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import pathlib
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import jax
import jax.numpy as jnp
import jobs
import measuring
import numpy as np
from measuring import Column, Table
from peers.ours import dem_of, rays_of

import jaxgeo
from jaxgeo._compile import long_run_options
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import ErrorModel, accuracy_map, presets, sources

jaxgeo.enable_x64()
SAME = 1e-6  # m
AT_ONCE = 10_000_000  # rays, pixels or points of one call, at most
SECTOR = 32  # bytes that a GPU reads from memory at least
PIXELS = 100_000  # distinct ones; larger batches repeat them
FIGURES, TIMES = 1024, 16  # pixels whose accuracy a CPU computes, and how often the device does
KEPT = 200_000  # samples that are compared one by one
BAND_SIZE = (4000, 6000)  # (rows, cols) of the rectified image
CELLS, FEW_CELLS = 8192, 1024  # on a side of the rectified image


@dataclass
class Bench:
    """The device, what is common to all parts, and the tables so far."""

    place: Any
    repeats: int
    largest: int
    samples: int
    cells: int
    blocks: tuple[int, ...]
    cache: pathlib.Path
    end: float
    bandwidth: float = float("nan")
    tables: list[Table] = field(default_factory=list)

    @functools.cached_property
    def cpu(self) -> Any:
        return jax.devices("cpu")[0]

    @functools.cached_property
    def job(self) -> jobs.Job:
        return jobs.mountain_job(jobs.MOST, self.cache, with_reference=False)

    def has_time(self) -> bool:
        """Whether the time given to the whole is not spent yet."""
        return time.monotonic() < self.end

    def measured(self, run: Callable[[], Any]) -> tuple[Any, float, float]:
        """(answer, s of the first call less that of a later one, median s of the later ones)."""
        answer, first = measuring.timed(lambda: jax.block_until_ready(run()))
        times: list[float] = []
        while len(times) < self.repeats and (not times or self.has_time()):
            times.append(measuring.timed(lambda: jax.block_until_ready(run()))[1])
        median = statistics.median(times)
        return answer, max(first - median, 0.0), median


def sizes(largest: int, least: int = 100_000) -> list[int]:
    """Powers of ten up to a number."""
    return [10**k for k in range(3, 10) if least <= 10**k <= largest] or [largest]


# The comparison with a CPU.


class Answer(NamedTuple):
    """Places of many items, their statuses, the sine of the angle at which they are fixed, and the rest of the answer.

    Where a ray grazes the ground, rounding moves its hit by the error of its height over that sine.
    """

    place: Any
    status: Any
    sine: Any
    rest: Any


@jax.jit
def _apart(found: Answer, expected: Answer) -> tuple[Any, ...]:
    """(other statuses; places farther apart than `SAME`, the largest distance, the largest one times the sine)."""
    count = expected.status.shape[0]
    place = found.place.reshape(-1, *expected.place.shape)
    same = found.status.reshape(-1, count) == expected.status[None]
    away = jnp.sqrt(jnp.sum((place - expected.place[None]) ** 2, axis=-1))
    is_unknown = jnp.all(jnp.isnan(expected.place), axis=1)[None] & jnp.all(jnp.isnan(place), axis=-1)
    away = jnp.nan_to_num(jnp.where(is_unknown | ~same, 0.0, away), nan=jnp.inf)
    across = jnp.where(away == 0.0, 0.0, away * jnp.nan_to_num(expected.sine, nan=1.0)[None])
    return jnp.sum(~same), jnp.sum(away > SAME), jnp.max(away), jnp.max(across)


def wrong(found: Answer, expected: Answer, place: Any) -> list[Any]:
    """Cells of a table, under `CHECKS`."""
    light = [x._replace(rest=None) for x in (found, jax.tree.map(np.asarray, expected))]
    return [np.asarray(x).item() for x in _apart(*jax.device_put(light, place))]


CHECKS = [
    Column("other statuses than a CPU's", "", "lower"),
    Column(f"more than {SAME:g} apart", "", "lower"),
    Column("farthest apart", "m or px", "lower"),
    Column("times the sine of the grazing angle", "m or px", "lower"),
]


# The parts.


def bandwidth(bench: Bench) -> Table:
    """Bytes read and written per second by a copy of 2 GiB."""
    size = 2**28 if bench.place.platform != "cpu" else 2**25
    block = jax.device_put(np.arange(size, dtype=np.float64), bench.place)
    copy = jax.jit(lambda x: x + 1.0)
    jax.block_until_ready(copy(block))
    times = [measuring.timed(lambda: jax.block_until_ready(copy(block)))[1] for _ in range(7)]
    bench.bandwidth = 16.0 * size / statistics.median(times)
    table = Table("Memory", [Column("device"), Column("a large copy, read and written", "GB/s", "higher")])
    table.rows.append([bench.place.device_kind, 1e-9 * bench.bandwidth])
    return table


def _batched(
    bench: Bench, title: str, unit: str, base: Any, function: Callable[..., Answer], common: tuple[Any, ...]
) -> tuple[Table, Answer]:
    """Rates of a function of items (leading axis of `base`), repeated to larger batches; and the CPU's answers.

    Two programs of each size: that of a plain `jax.jit`, and one with the options of the package's own batches.
    """
    columns = [Column(unit), Column("rate by `jax.jit`", f"M {unit}/s", "higher")]
    columns += [Column("by the package's options", f"M {unit}/s", "higher"), Column("compiling", "s", "lower")]
    table = Table(title, [*columns, *CHECKS])
    with jax.default_device(bench.cpu):
        here = jax.device_put((base, common), bench.cpu)
        expected, compiling, seconds = bench.measured(lambda run=jax.jit(function): run(here[0], *here[1]))
    count = jax.tree.leaves(base)[0].shape[0]
    note = f"the CPU of the comparison: {1e-6 * count / seconds:.3g} M {unit}/s, {compiling:.0f} s to compile"
    table.notes.append(note)
    with jax.default_device(bench.place), ThreadPoolExecutor(max((os.cpu_count() or 1) // 2, 1)) as pool:
        base, common = jax.device_put((base, common), bench.place)
        programs = {}
        for number in sizes(min(bench.largest, AT_ONCE)):
            like = jax.tree.map(lambda x, n=number: jax.ShapeDtypeStruct((n, *x.shape[1:]), x.dtype), base)
            lowered = jax.jit(function).lower(like, *common)
            programs[number] = [pool.submit(_compiled, lowered, how) for how in (None, long_run_options())]
        for number in sizes(bench.largest):
            if not bench.has_time():
                table.notes.append(f"{number:.0e} and more: the time was spent")
                break
            calls = -(-number // AT_ONCE)
            many = jax.tree.map(lambda x, n=number // calls // count: jnp.tile(x, (n, *[1] * (x.ndim - 1))), base)
            made = [program.result() for program in programs[number // calls]]
            called = [functools.partial(_calls, run, calls, many, common) for run, _ in made]
            timings = [bench.measured(run) for run in called]
            rates = [1e-6 * number / seconds for _, _, seconds in timings]
            checks = [wrong(found, expected, bench.place) for found, _, _ in timings]
            table.rows.append([number, *rates, made[0][1], *(max(pair) for pair in zip(*checks, strict=True))])
            del many, timings, called
    table.notes.append("compiling: of the first program, with those of the other sizes at the same time")
    return table, expected


def _calls(run: Any, calls: int, many: Any, common: tuple[Any, ...]) -> Answer:
    """The last answer of some calls."""
    for _ in range(calls - 1):
        jax.block_until_ready(run(many, *common))
    return run(many, *common)


def _compiled(lowered: Any, options: dict[str, Any] | None) -> tuple[Any, float]:
    """(program, s to compile)."""
    return measuring.timed(lambda: lowered.compile(compiler_options=options or None))


def _intersect(rays: Any, dem: Any) -> Answer:
    return _answer(jax.vmap(jaxgeo.intersect, in_axes=(0, None))(rays, dem))


def _answer(fix: Any) -> Answer:
    rest = (fix.position, fix.slant_range, fix.incidence_ellipsoid, fix.slope)
    return Answer(fix.ecef, fix.status, jnp.abs(jnp.cos(fix.incidence_surface)), rest)


def rays(bench: Bench) -> list[Table]:
    """Complete fixes of ECEF rays by first-hit search, and the share of the bandwidth that they use."""
    base, dem = rays_of(bench.job.sight), dem_of(bench.job.terrain)
    table, _ = _batched(bench, "First hits of rays", "rays", base, _intersect, (dem,))
    look_ups = _look_ups(base, dem)
    moved = 48.0 + 81.0 + SECTOR * look_ups  # a ray in, a fix out
    table.columns.append(Column("of the bandwidth", "%", "higher"))
    for row in table.rows:
        row.append(100.0 * 1e6 * max(row[1:3]) * moved / bench.bandwidth)
    table.notes.append(
        f"share of the bandwidth: {moved:.0f} bytes of a ray, 129 in and out and {SECTOR} for each of {look_ups:.1f} "
        "look-ups of a bound or a cell, without caches; the state between the kernels of the search is not counted"
    )
    return [table]


def _look_ups(rays: Any, dem: Any) -> float:
    """Mean look-ups of a ray, of bounds and cells; see `jaxgeo.studies.look_ups`."""
    import growing

    with jax.default_device(jax.devices("cpu")[0]):
        return growing.look_ups(rays, dem)


def _view(bench: Bench, size: tuple[int, int] = (6000, 4000)) -> tuple[Any, Any, Any]:
    """A camera (columns, rows) 5 km above the middle of the mountains that looks 50 degrees off nadir; the terrain."""
    terrain = bench.job.terrain
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=0.8 * size[0], width=size[0], height=size[1])
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
    at = jaxgeo.Geodetic(lat=terrain.lat, lon=terrain.lon, height=8000.0)
    shot = jaxgeo.Shot(jaxgeo.Pose(at, 0.3, 0.01, -0.02), sensor.gimbal.readings_from_degrees(outer=50.0, inner=0.0))
    return sensor, shot, dem_of(terrain)


def _pixels(sensor: Any) -> np.ndarray:
    return np.random.default_rng(4).uniform(
        [0.0, 0.0], [sensor.camera.width - 1.0, sensor.camera.height - 1.0], (PIXELS, 2)
    )


def _locate(uv: Any, sensor: Any, shot: Any, dem: Any) -> Answer:
    return _answer(jax.vmap(jaxgeo.locate, in_axes=(None, None, 0, None))(sensor, shot, uv, dem))


def _project(place: Any, sensor: Any, shot: Any) -> Answer:
    found = jax.vmap(jaxgeo.project, in_axes=(None, None, 0))(sensor, shot, place)
    return Answer(found.uv, found.status, jnp.ones(found.status.shape), ())


def locate(bench: Bench) -> list[Table]:
    """Pixels to the ground and back."""
    sensor, shot, dem = _view(bench)
    uv = jnp.asarray(_pixels(sensor))
    there, fixes = _batched(bench, "`locate` of pixels of one image", "pixels", uv, _locate, (sensor, shot, dem))
    ground = jax.tree.map(jnp.nan_to_num, fixes.rest[0])
    back, _ = _batched(bench, "`project` of points into an image", "points", ground, _project, (sensor, shot))
    return [there, back]


def bent(bench: Bench) -> list[Table]:
    """Pixels to the ground along lines of sight bent by the standard atmosphere."""
    look = (*_view(bench), jaxgeo.Atmosphere())
    return [_batched(bench, "`locate` with refraction", "pixels", jnp.asarray(_pixels(look[0])), _bent, look)[0]]


def _bent(uv: Any, sensor: Any, shot: Any, dem: Any, air: Any) -> Answer:
    one = lambda uv: jaxgeo.locate(sensor, shot, uv, dem, atmosphere=air)  # noqa: E731
    return _answer(jax.vmap(one)(uv))


def batches(bench: Bench) -> list[Table]:
    """`in_batches` of `locate`: from pixels on the host to fixes on the host."""
    look, uv = _view(bench), _pixels(_view(bench)[0])
    columns = [Column("pixels"), Column("rate", "M pixels/s", "higher"), Column("compiling", "s", "lower")]
    table = Table("`in_batches` of `locate`", [*columns, *CHECKS])

    def made(place: Any, uv: Any) -> Answer:
        with jax.default_device(place):
            return jaxgeo.in_batches(_locate_one, uv, *jax.device_put(look, place))

    expected = made(bench.cpu, uv)
    for number in sizes(min(bench.largest, AT_ONCE), 1_000_000):
        many = np.tile(uv, (max(number // PIXELS, 1), 1))
        found, compiling, seconds = bench.measured(lambda many=many: made(bench.place, many))
        table.rows.append([len(many), 1e-6 * len(many) / seconds, compiling, *wrong(found, expected, bench.place)])
    return [table]


def _locate_one(uv: Any, sensor: Any, shot: Any, dem: Any) -> Answer:
    return _answer(jaxgeo.locate(sensor, shot, uv, dem))


def accuracies(bench: Bench) -> list[Table]:
    """Accuracy of many pixels of one image by linear propagation, and of the cells of a map."""
    sensor, shot, dem = _view(bench)
    errors, uv = presets.li_2023(terrain_height=5.0), _pixels(sensor)[:FIGURES]
    many = np.tile(uv, (TIMES, 1))

    def made(place: Any, uv: Any) -> Any:
        with jax.default_device(place):
            look = jax.device_put((sensor, shot, dem, errors), place)
            return jaxgeo.accuracy(look[0], look[1], uv, look[2], look[3], sampling=None)

    columns = [Column("pixels"), Column("rate", "thousand/s", "higher"), Column("compiling", "s", "lower")]
    columns += [Column("by the CPU", "thousand/s"), Column("other methods than a CPU's", "", "lower")]
    columns += [Column("CE90 apart, of itself", "", "lower")]
    table = Table("`accuracy` of pixels, without samples", columns)
    expected, _, of_cpu = bench.measured(lambda: made(bench.cpu, uv))
    found, compiling, seconds = bench.measured(lambda: made(bench.place, many))
    repeated = lambda x: np.tile(np.asarray(x), TIMES)  # noqa: E731
    other = int(np.sum(np.asarray(found.method) != repeated(expected.method)))
    apart = float(np.nanmax(np.abs(np.asarray(found.circular) / repeated(expected.circular) - 1.0)))
    table.rows.append([len(many), 1e-3 * len(many) / seconds, compiling, 1e-3 * len(uv) / of_cpu, other, apart])
    return [table]


def maps(bench: Bench) -> list[Table]:
    """Accuracy of cells of the DEM as one image shows them, by linear propagation, and with samples where it fails."""
    look = (*_view(bench), presets.li_2023(terrain_height=5.0))

    def made(place: Any, step: int, **options: Any) -> Any:
        with jax.default_device(place):
            return accuracy_map(*jax.device_put(look, place), step=step, **options)

    columns = [
        Column("figures"),
        Column("cells"),
        Column("rate", "thousand/s", "higher"),
        Column("compiling", "s", "lower"),
    ]
    columns += [Column("by the CPU", "thousand/s"), Column("other methods than a CPU's", "", "lower")]
    table = Table("`accuracy_map` of one image", [*columns, Column("CE90 apart, of itself", "", "lower")])
    for name, options, step, few in (("linear", {"sampling": None}, 8, 64), ("with samples", {}, 32, 64)):
        if not bench.has_time():
            table.notes.append("the time was spent")
            break
        expected, _, of_cpu = bench.measured(lambda few=few, options=options: made(bench.cpu, few, **options))
        found, compiling, seconds = bench.measured(
            lambda step=step, options=options: made(bench.place, step, **options)
        )
        count, fewer = (np.asarray(x.accuracy.method).size for x in (found, expected))
        every = few // step
        same = lambda x, every=every: np.asarray(x)[::every, ::every]  # noqa: E731
        other = int(np.sum(same(found.accuracy.method) != np.asarray(expected.accuracy.method)))
        apart = np.abs(same(found.accuracy.circular) / np.asarray(expected.accuracy.circular) - 1.0)
        rates = 1e-3 * count / seconds, compiling, 1e-3 * fewer / of_cpu
        table.rows.append([name, count, *rates, other, float(np.nanmax(apart))])
    return [table]


def scenes(bench: Bench) -> list[Table]:
    """Images of an orthoimage over terrain, three bands."""
    terrain, side = bench.job.terrain, 4001
    centre = jaxgeo.Geodetic(lat=terrain.lat, lon=terrain.lon, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(15.0, 15.0), shape=(side, side))
    reference = Orthoimage.of(np.random.default_rng(0).integers(1, 255, (3, side, side), np.uint8), grid)

    def made(place: Any, look: Any) -> Any:
        with jax.default_device(place):
            sensor, shot, dem = jax.device_put(look, place)
            return render(sensor, shot, jax.device_put(reference, place), dem)

    columns = [Column("pixels"), Column("rate", "M pixels/s", "higher"), Column("compiling", "s", "lower")]
    columns += [Column("by the CPU", "M pixels/s"), Column("other statuses than a CPU's", "", "lower")]
    table = Table("`render` of an image of three bands", [*columns, Column("values off by more than 1", "", "lower")])
    for size, is_compared in (((1500, 1000), True), ((6000, 4000), False)):
        if not bench.has_time() or size[0] * size[1] > bench.largest:
            table.notes.append(
                f"{size[0]} x {size[1]} pixels: left out, for want of time or as larger than the largest batch"
            )
            continue
        look = _view(bench, size)
        found, compiling, seconds = bench.measured(lambda look=look: made(bench.place, look))
        row: list[Any] = [size[0] * size[1], 1e-6 * size[0] * size[1] / seconds, compiling, None, None, None]
        if is_compared:
            expected, _, of_cpu = bench.measured(lambda look=look: made(bench.cpu, look))
            off = np.abs(np.asarray(found.values) - np.asarray(expected.values)).max(axis=0) > 1.0
            row[3:] = [
                1e-6 * size[0] * size[1] / of_cpu,
                int(np.sum(found.status != expected.status)),
                int(np.sum(off)),
            ]
        table.rows.append(row)
    return [table]


def fields(bench: Bench) -> list[Table]:
    """Samples of one pixel over terrain whose height errors are correlated in space."""
    *few, _ = presets.li_2023(terrain_height=5.0).sources
    field_ = sources.TerrainField.of_variograms(gaussian=[(5.0, 300.0)])
    return [
        _sampled(bench, "`sample` over a field of height errors", ErrorModel((*few, field_)), min(bench.samples, 10**7))
    ]


def calls(bench: Bench) -> list[Table]:
    """Time of single calls of one pixel, compiled before."""
    *look, dem = _view(bench)
    sensor, shot, errors = jax.tree.map(np.asarray, (*look, presets.li_2023(terrain_height=5.0)))  # as users have them
    uv, key = np.array([3000.0, 2000.0]), jax.random.key(1)
    ground = jaxgeo.locate(sensor, shot, uv, dem).position
    runs: dict[str, Callable[..., Any]] = {
        "locate": lambda sensor, shot, dem, errors: jaxgeo.locate(sensor, shot, uv, dem),
        "project": lambda sensor, shot, dem, errors: jaxgeo.project(sensor, shot, ground),
        "accuracy, without samples": lambda sensor, shot, dem, errors: jaxgeo.accuracy(
            sensor, shot, uv, dem, errors, sampling=None
        ),
    }
    for count in (10_000, 1_000_000):

        def drawn(sensor: Any, shot: Any, dem: Any, errors: Any, count: int = count) -> Any:
            options: Any = {"key": key, "count": count, "summary": True, "devices": list(dem.posts.devices())}
            return jaxgeo.sample(sensor, shot, uv, dem, errors, **options)

        runs[f"sample, {count:,} with summary"] = drawn
    columns = [Column("call"), Column("time", "ms", "lower"), Column("compiling", "s", "lower")]
    table = Table("Single calls", [*columns, Column("by the CPU", "ms"), Column("compiling for it", "s")])
    for name, run in runs.items():
        row: list[Any] = [name]
        for place in (bench.place, bench.cpu):
            with jax.default_device(place):
                look = sensor, shot, jax.device_put(dem, place), errors
                _, compiling, _ = bench.measured(lambda run=run, look=look: run(*look))
                times = [
                    measuring.timed(lambda run=run, look=look: jax.block_until_ready(run(*look)))[1] for _ in range(9)
                ]
                row += [1e3 * statistics.median(times), compiling]
        table.rows.append(row)
    return [table]


def samples(bench: Bench) -> list[Table]:
    """Monte Carlo samples of one pixel, radii counted in bins."""
    errors = presets.li_2023(terrain_height=5.0)
    return [_sampled(bench, "`sample` of one pixel with `summary`", errors, bench.samples)]


def _sampled(bench: Bench, title: str, errors: ErrorModel, most: int) -> Table:
    (sensor, shot, dem), uv = _view(bench), np.array([3000.0, 2000.0])

    def drawn(count: int, place: Any, **options: Any) -> Any:
        with jax.default_device(place):
            look = jax.device_put((sensor, shot, dem, errors), place)
            key = jax.device_put(jax.random.key(1), place)
            return jaxgeo.sample(
                look[0], look[1], uv, look[2], look[3], key=key, count=count, devices=[place], **options
            )

    columns = [Column("samples"), Column("rate", "M samples/s", "higher"), Column("compiling", "s", "lower")]
    columns += [Column("CE90", "m"), Column("CE90 of a CPU", "m")]
    table = Table(title, columns)
    ways = {place: drawn(KEPT, place, keep=True) for place in dict.fromkeys((bench.cpu, bench.place))}
    expected, found = ways[bench.cpu], ways[bench.place]
    other, away = expected.codes != found.codes, np.linalg.norm(expected.errors_enu - found.errors_enu, axis=1)
    away = np.where(other | np.isnan(expected.errors_enu).all(axis=1), 0.0, away)
    many, farthest = int(np.sum(~(away <= SAME))), float(np.nanmax(away))
    table.notes.append(
        f"{KEPT} samples one by one: {int(other.sum())} have another status than a CPU's, {many} are {SAME:g} m "
        f"or more apart, the farthest {farthest:.1e} m"
    )
    for count in sizes(most, 10_000):
        if not bench.has_time():
            table.notes.append(f"{count:.0e} and more: the time was spent")
            break
        result, compiling, seconds = bench.measured(lambda count=count: drawn(count, bench.place, summary=True))
        circular = result.circular_error(0.9).value
        same = drawn(count, bench.cpu, summary=True).circular_error(0.9).value if count == 1_000_000 else None
        table.rows.append([count, 1e-6 * count / seconds, compiling, circular, same])
    return table


def ortho(bench: Bench) -> list[Table]:
    """Rectification of an image of three bands of uint8, from an array to an array."""
    from jaxgeo.ortho import rectify

    rows, cols = BAND_SIZE
    sensor, shot, dem = _view(bench, (cols, rows))
    shot = jaxgeo.Shot(shot.pose, sensor.gimbal.readings_from_degrees(outer=0.0, inner=0.0))
    image = np.random.default_rng(0).integers(1, 255, (3, rows, cols), np.uint8)
    terrain, side = bench.job.terrain, bench.cells
    centre = jaxgeo.Geodetic(lat=terrain.lat, lon=terrain.lon, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(9000.0 / side, 9000.0 / side), shape=(side, side))

    def made(place: Any, side: int = side, **options: Any) -> Any:
        with jax.default_device(place):
            look = jax.device_put((sensor, shot, dem, grid), place)
            return rectify(look[0], look[1], image, look[2], look[3], (side, side), **options)

    columns = [Column("cells"), Column("ground that the image does not show"), Column("rate", "M cells/s", "higher")]
    columns += [Column("compiling", "s", "lower"), Column("other statuses than a CPU's", "", "lower")]
    columns += [Column("values off by more than 1", "", "lower")]
    table = Table(f"`rectify` of {cols} x {rows} pixels of three bands", columns)
    for name, options in {"left out": {}, "left in": {"mask_hidden": False}}.items():
        if not bench.has_time():
            table.notes.append("the time was spent")
            break
        found, compiling, seconds = bench.measured(lambda options=options: made(bench.place, **options))
        expected, of_cpu = measuring.timed(lambda options=options: made(bench.cpu, **options))
        statuses = int(np.sum(found.status != expected.status))
        off = np.abs(found.orthoimage.values.astype(int) - expected.orthoimage.values.astype(int)).max(axis=0) > 1
        table.rows.append([side**2, name, 1e-6 * side**2 / seconds, compiling, statuses])
        table.rows[-1].append(int(np.sum(off & (found.status == expected.status))))
        table.notes.append(f"{name}: the CPU of the comparison took {of_cpu:.1f} s, compiling included")
    return [table]


def adjustment(bench: Bench) -> list[Table]:
    """Bundle adjustment of simulated blocks: from the prepared problem to the converged solution."""
    import adjustment as blocks

    columns = [Column("images"), Column("measurements"), Column("iterations"), Column("solve", "s", "lower")]
    columns += [Column("compiling", "s", "lower"), Column("solve by a CPU", "s")]
    columns += [Column("centres off a CPU's", "m", "lower"), Column("points off a CPU's", "m", "lower")]
    columns += [Column("covariances of centres off", "of themselves", "lower")]
    table = Table("Bundle adjustment of strips of 25 images", columns)
    for images in bench.blocks:
        if not bench.has_time():
            table.notes.append("the time was spent")
            break
        problem, found = blocks.strips(images), {}
        for place in dict.fromkeys((bench.cpu, bench.place)):
            with jax.default_device(place):
                ready = blocks.prepared(*blocks.block_of(problem))
                solution, compiling, seconds = bench.measured(lambda ready=ready: blocks.solved(ready))
                covariance = np.asarray(blocks.covariances(ready, solution)[0])
                found[place] = (solution, compiling, seconds, covariance)
        (theirs, _, of_cpu, expected), (ours, compiling, seconds, covariance) = found[bench.cpu], found[bench.place]
        apart = [float(np.abs(np.asarray(a) - np.asarray(b)).max()) for a, b in _centres_and_points(ours, theirs)]
        row = [images, len(problem.uv), len(ours.log) - 1, seconds, compiling, of_cpu, *apart]
        variances = (np.diagonal(x, axis1=-2, axis2=-1) for x in (covariance, expected))
        table.rows.append([*row, float(np.abs(np.divide(*variances) - 1.0).max())])
    return [table]


def _centres_and_points(ours: Any, theirs: Any) -> list[tuple[Any, Any]]:
    return [(ours.values.centre, theirs.values.centre), (ours.values.points, theirs.values.points)]


PARTS: dict[str, Callable[[Bench], list[Table]]] = {
    "rays": rays,
    "locate": locate,
    "bent": bent,
    "batches": batches,
    "accuracies": accuracies,
    "maps": maps,
    "scenes": scenes,
    "calls": calls,
    "samples": samples,
    "fields": fields,
    "ortho": ortho,
    "adjustment": adjustment,
}


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=["cpu", "gpu", "tpu"], default=None, help="by default that of JAX")
    parser.add_argument("--full", action="store_true", help="up to 1e8 rays, 1e9 samples")
    parser.add_argument("--largest", type=int, help="largest batch of rays, pixels and points")
    parser.add_argument("--samples", type=int, help="largest number of samples")
    parser.add_argument("--cells", type=int, help="cells on a side of the rectified image")
    parser.add_argument("--blocks", help="images of the adjusted blocks, as 50,400")
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=1e9, help="start no further measurement after so long")
    parser.add_argument("--cache", type=pathlib.Path, default=jobs.CACHE, help="where rays are kept")
    parser.add_argument("--json", type=pathlib.Path)
    o = parser.parse_args()
    place = jax.devices(o.device)[0]
    blocks = o.blocks or ("50,400,1300" if o.full else "50")
    bench = Bench(
        place=place,
        repeats=o.repeats,
        largest=o.largest or (100_000_000 if o.full else 100_000),
        samples=o.samples or (1_000_000_000 if o.full else 1_000_000),
        cells=o.cells or (CELLS if o.full else FEW_CELLS),
        blocks=tuple(int(images) for images in blocks.split(",")),
        cache=o.cache,
        end=time.monotonic() + o.seconds,
    )
    record = {"machine": measuring.machine(), "device": place.device_kind, "tables": []}
    print(f"{place.device_kind}; jax {jax.__version__}; {record['machine']['processor']}\n", flush=True)
    for make in (lambda bench: [bandwidth(bench)], *(PARTS[name] for name in o.only.split(","))):
        for table in make(bench):
            print(table.markdown(), flush=True)
            record["tables"].append(table.record())
            if o.json is not None:
                o.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

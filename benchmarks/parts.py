"""Cost breakdown of jaxgeo: stragglers, bundles, the papers' searches, stages, cores, devices."""

from __future__ import annotations

import importlib
import os
import pathlib
from collections.abc import Callable
from typing import Any

import jobs
import measuring
import numpy as np
from measuring import Column, Table


def batches(rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """One straggler in a batch, and a Monte Carlo bundle beside unrelated rays."""
    job = jobs.mountain_job(rays, cache, with_reference=False)
    return [_straggler(job, repeats), _bundle(job.terrain, min(10_000, rays), repeats)]


def _straggler(job: jobs.Job, repeats: int) -> Table:
    import jax
    from peers.ours import answers, dem_of, rays_of

    import jaxgeo

    terrain, skimming = jobs.with_runway(job.terrain)
    dem = jax.block_until_ready(dem_of(terrain))
    plain, one = rays_of(job.sight), rays_of(skimming)
    middle = job.sight.start.size // 2
    batches = {
        "without": plain,
        "with": jax.tree.map(lambda all_, slow: all_.at[middle].set(slow[0]), plain, one),
        "alone": one,
    }
    timings, fixes, others = _raced({name: lambda x=x: answers(x, dem) for name, x in batches.items()}, repeats)
    columns = [
        Column("without it", "ms", "lower"),
        Column("with it", "ms", "lower"),
        Column("it costs", "% of the batch", "lower"),
        Column("it alone", "ms", "lower"),
        Column("cells that it skims", "cells"),
    ]
    table = Table(f"One straggler in {job.sight.start.size} rays", columns)
    ms = {name: 1e3 * timing.median for name, timing in timings.items()}
    far = float(np.asarray(fixes["alone"].slant_range)[0])
    cells = None if np.isnan(far) else int(far / terrain.spacing)
    table.rows.append([ms["without"], ms["with"], 100.0 * (ms["with"] / ms["without"] - 1.0), ms["alone"], cells])
    status = jaxgeo.Status(int(np.asarray(fixes["alone"].status)[0]))
    table.notes += [
        "the ray skims 2 to 5 cm over a strip of ground shaped after it; both batches see that strip",
        f"alone it is answered `{status.name}`",
        others,
    ]
    return table


def _bundle(terrain: jobs.TangentTerrain, count: int, repeats: int) -> Table:
    import jax
    from peers.ours import answers, dem_of, rays_of

    dem = jax.block_until_ready(dem_of(terrain))
    batches = {
        "bundle": rays_of(jobs.bundle(terrain, count)),
        "unrelated": rays_of(jobs.random_job(terrain, count)),
    }
    timings, _, others = _raced({name: lambda x=x: answers(x, dem) for name, x in batches.items()}, repeats)
    columns = [Column("rays"), Column("rate", "M rays/s", "higher"), Column("spread", "% of the median", "lower")]
    table = Table(f"A bundle of {count} rays and {count} unrelated ones", columns)
    table.rows += [[name, 1e-6 * count / t.median, 100.0 * t.spread] for name, t in timings.items()]
    table.notes += ["bundle: one ray, its direction moved by 1e-4 rad and its origin by 1 m (1 sigma an axis)", others]
    return table


def air(rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """The same rays straight and refracted by the standard atmosphere."""
    import jax
    from peers.ours import dem_of, rays_of

    import jaxgeo

    job = jobs.mountain_job(rays, cache, with_reference=False)
    batch, dem = rays_of(job.sight), jax.block_until_ready(dem_of(job.terrain))

    def through(air: Any) -> Callable[[], Any]:
        run = jax.jit(jax.vmap(lambda ray, dem, air: jaxgeo.intersect(ray, dem, atmosphere=air), (0, None, None)))
        return lambda: run(batch, dem, air)

    runs = {"straight": through(None), "bent": through(jaxgeo.Atmosphere())}
    return [_beside_the_first(f"{job.sight.start.size} rays through the air", runs, job.sight.start.size, repeats)]


def motion(pixels: int, repeats: int) -> list[Table]:
    """Locate and project pixels of a sweep: all rows from one shot, and each from its own trajectory position."""
    import jax
    from peers.ours import dem_of

    import jaxgeo

    terrain = jobs.mountains()
    sensor, flight = jobs.sweep_over(terrain)
    dem = jax.block_until_ready(dem_of(terrain))
    camera: Any = sensor.camera
    uv = np.random.default_rng(4).uniform([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], (pixels, 2))
    locate = jax.jit(jax.vmap(jaxgeo.locate, in_axes=(None, None, 0, None)))
    through = jax.jit(
        jax.vmap(lambda *given: jaxgeo.locate(*given[:-1], atmosphere=given[-1]), (None, None, 0, None, None))
    )
    project = jax.jit(jax.vmap(jaxgeo.project, in_axes=(None, None, 0)))
    shot, air = flight.at(1.0), jaxgeo.Atmosphere()
    there = {
        "one shot": lambda: locate(sensor, shot, uv, dem),
        "trajectory": lambda: locate(sensor, flight, uv, dem),
        "trajectory and air": lambda: through(sensor, flight, uv, dem, air),
    }
    ground = locate(sensor, flight, uv, dem).position
    back = {"one shot": lambda: project(sensor, shot, ground), "trajectory": lambda: project(sensor, flight, ground)}
    return [
        _beside_the_first(f"{pixels} pixels of a sweep to the ground", there, pixels, repeats),
        _beside_the_first(f"{pixels} points on the ground to pixels of a sweep", back, pixels, repeats),
    ]


def _beside_the_first(title: str, runs: dict[str, Callable[[], Any]], count: int, repeats: int) -> Table:
    """Rates of several variants, as shares of the first one's."""
    timings, answers, others = _raced(runs, repeats)
    first = next(iter(runs))
    columns = [
        Column("way"),
        Column("rate", "M/s", "higher"),
        Column(f"of the rate of {first}", "%", "higher"),
        Column("spread", "% of the median", "lower"),
        Column("hits", "%"),
    ]
    table = Table(title, columns)
    for name, timing in timings.items():
        share = 100.0 * timings[first].median / timing.median
        hits = 100.0 * float(np.mean(np.asarray(answers[name].ok)))
        table.rows.append([name, 1e-6 * count / timing.median, share, 100.0 * timing.spread, hits])
    table.notes.append(others)
    return table


def _raced(runs: dict[str, Callable[[], Any]], repeats: int) -> tuple[dict[str, measuring.Timing], dict[str, Any], str]:
    """Interleaved timings of warm runs, the first result of each, and a note on other load on the machine."""
    import jax

    whole = {name: lambda run=run: jax.block_until_ready(run()) for name, run in runs.items()}
    answers = {name: run() for name, run in whole.items()}
    watch = measuring.Watch()
    timings = measuring.interleaved(whole, repeats)
    return timings, answers, f"while timing, other processes used {watch.others():.2f} cores on average"


def searches(rays: int, repeats: int) -> list[Table]:
    """The papers' searches on four kinds of ground, if that study is available, with the times printed for them."""
    columns = [
        Column("ground"),
        Column("search"),
        Column("heights asked of the DEM", "mean per ray", "lower"),
        Column("at most", "per ray", "lower"),
        Column("time", "us/ray", "lower"),
    ]
    table = Table(f"The papers' searches, {rays} rays a ground", columns)
    try:
        importlib.import_module("jaxgeo").enable_x64()
        study: Any = importlib.import_module("jaxgeo.studies.terrain_searches")
        rows = [row for scene in study.standard_scenes(rays) for row in study.study(scene, repeats=repeats)]
        outcomes = list(study.Outcome)
    except (ImportError, AttributeError) as error:
        table.notes.append(f"skipped ({type(error).__name__}: {error})")
        return [table]
    table.columns += [Column(outcome.name.replace("_", " "), "% of rays") for outcome in outcomes]
    table.columns.append(Column("farthest behind the first hit", "m", "lower"))
    for row in rows:
        shares = [100.0 * share for share in row.shares]
        cost = [row.evaluations, row.most_evaluations, row.us_per_ray]
        table.rows.append([row.scene, row.search, *cost, *shares, row.farthest])
    return [table, _printed(study, rows)]


def _printed(study: Any, rows: list[Any]) -> Table:
    columns = [
        Column("ground"),
        Column("search"),
        Column("printed", "ms of 100 runs", "lower"),
        Column("printed over the fast one's", "times", "lower"),
        Column("ours", "us/ray", "lower"),
        Column("ours over the fast one's", "times", "lower"),
        Column("our evaluations over the fast one's", "times", "lower"),
    ]
    table = Table("The twelve times of Table 4 of Li et al. (2023) beside ours", columns)
    ours = {(row.scene, study.PRINTED_AS[row.search]): row for row in rows if row.search in study.PRINTED_AS}
    for scene, printed in study.PRINTED_MS.items():
        fast = ours[scene, "fast"]
        for name, ms in printed.items():
            row = ours[scene, name]
            ratios = [row.us_per_ray / fast.us_per_ray, row.evaluations / fast.evaluations]
            table.rows.append([scene, name, ms, ms / printed["fast"], row.us_per_ray, *ratios])
    table.notes.append("other terrain, machine and language: only the ratios within one ground can be compared")
    return table


def stages(rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """Time per ray by stage, as far as the public functions separate them."""
    import jax
    from peers.ours import answers, dem_of, rays_of

    import jaxgeo
    from jaxgeo.terrain.polish import polish

    job = jobs.mountain_job(rays, cache, with_reference=False)
    batch, dem = rays_of(job.sight), jax.block_until_ready(dem_of(job.terrain))
    search = jax.jit(jax.vmap(lambda ray, dem: dem.bracket(ray, jaxgeo.FirstHit()), (0, None)))
    finish = jax.jit(jax.vmap(polish, (0, None, 0)))
    convert = jax.jit(jax.vmap(lambda ray, dem: dem.over(ray.origin), (0, None)))
    found = search(batch, dem)
    runs = {
        "whole answer": lambda: answers(batch, dem),
        "search for the bracket": lambda: search(batch, dem),
        "polish": lambda: finish(batch, dem, found),
        "one exact conversion to (row, col, height)": lambda: convert(batch, dem),
    }
    timings, _, others = _raced(runs, repeats)
    cost = {name: 1e9 * timing.median / job.sight.start.size for name, timing in timings.items()}
    cost["the rest of the answer (a difference)"] = 2.0 * cost["whole answer"] - sum(list(cost.values())[:3])
    columns = [Column("stage"), Column("cost", "ns/ray", "lower"), Column("share", "% of the whole")]
    table = Table(f"Where a ray's time goes, {rays} rays", columns)
    table.rows += [[name, ns, 100.0 * ns / cost["whole answer"]] for name, ns in cost.items()]
    table.notes.append("each stage compiled by itself: what they share, or what fuses, is counted in each")
    table.notes.append(others)
    return [table]


def cores(rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """Rates with one host device and with one per core."""
    columns = [
        Column("how"),
        Column("host devices"),
        Column("rate", "M rays/s", "higher"),
        Column("first call", "s", "lower"),
    ]
    table = Table(f"More than one core, {rays} rays", columns)
    for devices in sorted({1, os.cpu_count() or 1}):
        arguments = {"devices": devices, "rays": rays, "repeats": repeats, "cache": str(cache)}
        found = measuring.in_subprocess("cores", arguments, 1800.0)
        if "reason" in found:
            table.notes.append(f"{devices} host devices: {found['reason']}")
            continue
        table.rows += [[name, devices, x["rate"], x["first_s"]] for name, x in found.items()]
    table.notes.append("threads: one chunk of the rays to each of so many Python threads, on the first device")
    return [table]


def device(kind: str | None, most: int, repeats: int, budget_s: float, cache: pathlib.Path) -> list[Table]:
    """Rates of rays on an accelerator, by `accelerator.py`; a note if it was not run."""
    table = Table("On an accelerator", [Column("device")])
    if kind is None:
        table.notes.append("not run: ask for it with --device gpu on a machine that has one")
        return [table]
    arguments = {"kind": kind, "rays": most, "repeats": repeats, "budget_s": budget_s, "cache": str(cache)}
    found = measuring.in_subprocess("device", arguments, 3.0 * budget_s + 600.0)
    if "reason" in found:
        table.notes.append(f"not run ({found['reason']})")
        return [table]
    return [Table.of(record) for record in found["tables"]]

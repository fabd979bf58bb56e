"""Scaling of jaxgeo's cost with the DEM size and with the batch size."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable
from typing import Any

import jobs
import measuring
import numpy as np
from measuring import Column, Table

GROUNDS: dict[str, Callable[[int], float]] = {
    "finer posts": lambda side: 60_000.0 / (side - 1),
    "more ground": lambda side: 30.0,
}

COUNTED = 2000  # rays with counted look-ups

SIDES = [
    Column("ground"),
    Column("side", "posts"),
    Column("spacing", "m"),
    Column("cost", "ns/ray", "lower"),
    Column("over that of the first side", "times", "lower"),
    Column("look-ups", "bounds and cells per ray", "lower"),
    Column("over those of the first side", "times", "lower"),
    Column("log2(side) over that of the first side", "times"),
    Column("peak of building, the caller's posts included", "times the posts' bytes", "lower"),
    Column("kept by the Dem", "times the posts' bytes", "lower"),
    Column("answered", "% of rays"),
]


def growth(sides: list[int], rays: int, most: int, repeats: int, budget_s: float, cache: pathlib.Path) -> list[Table]:
    """Cost per ray and memory by DEM side, and cost per ray for batches from 1000 up to `most` rays."""
    return [_sides(sides, rays, repeats, cache), _batches(most, repeats, budget_s, cache)]


def _sides(sides: list[int], rays: int, repeats: int, cache: pathlib.Path) -> Table:
    import jax
    from peers.ours import answers, dem_of, rays_of

    kinds = [(ground, side) for ground in GROUNDS for side in sides]
    memory: dict[tuple[str, int], dict[str, Any]] = {}
    runs: dict[str, Callable[[], Any]] = {}
    asked: dict[str, float] = {}
    for ground, side in kinds:
        terrain = jobs.rough_terrain(side, GROUNDS[ground](side))
        memory[ground, side] = _built(terrain, cache)
        dem, batch = dem_of(terrain, np.float32), rays_of(jobs.random_job(terrain, rays))
        runs[f"{ground} {side}"] = lambda dem=dem, batch=batch: jax.block_until_ready(answers(batch, dem))
        asked[f"{ground} {side}"] = look_ups(batch, dem)
    answered = {name: 100.0 * float(np.mean(np.isfinite(np.asarray(run().slant_range)))) for name, run in runs.items()}
    watch = measuring.Watch()
    timings = measuring.interleaved(runs, repeats)
    table = Table(f"Cost against the DEM's side, {rays} random rays 60-79 degrees off nadir, float32 posts", SIDES)
    table.notes.append(f"interleaved in one process; others used {watch.others():.2f} cores; memory in fresh processes")
    for ground, spacing_of in GROUNDS.items():
        ns = np.array([1e9 * timings[f"{ground} {side}"].median / rays for side in sides])
        work = np.array([asked[f"{ground} {side}"] for side in sides])
        for side, cost, read in zip(sides, ns, work, strict=True):
            kept = memory[ground, side]
            row = [ground, side, spacing_of(side), cost, cost / ns[0], read, read / work[0]]
            row.append(np.log2(side) / np.log2(sides[0]))
            table.rows.append([*row, kept.get("peak"), kept.get("kept"), answered[f"{ground} {side}"]])
            if "reason" in kept:
                table.notes.append(f"{ground}, side {side}: {kept['reason']}")
        table.notes += _fitted(ground, np.array(sides), ns)
    return table


def look_ups(rays: Any, dem: Any) -> float:
    """Mean number of bounds and cells that a first-hit search reads per ray; see `jaxgeo.studies.look_ups`."""
    import jax
    from peers.ours import answers

    from jaxgeo.studies.look_ups import first_hit_look_ups

    some = jax.tree.map(lambda x: x[:COUNTED], rays)
    found = answers(some, dem).slant_range
    bounds, cells = jax.jit(jax.vmap(first_hit_look_ups, (0, None, 0)))(some, dem, found)
    return float(np.mean(np.asarray(bounds) + np.asarray(cells)))


def _built(terrain: jobs.TangentTerrain, cache: pathlib.Path) -> dict[str, Any]:
    """Memory to build a Dem of the terrain, in its own process."""
    path = _kept(terrain, cache)
    try:
        return measuring.in_subprocess("building", {"posts": str(path), "spacing": terrain.spacing}, 600.0)
    finally:
        path.unlink(missing_ok=True)


def _kept(terrain: jobs.TangentTerrain, cache: pathlib.Path) -> pathlib.Path:
    cache.mkdir(parents=True, exist_ok=True)
    path = cache / f"posts-{os.getpid()}.npy"
    np.save(path, terrain.posts)
    return path


def _fitted(ground: str, sides: np.ndarray, ns: np.ndarray) -> list[str]:
    if sides.size < 3:
        return []
    slope, base = np.polyfit(np.log2(sides), ns, 1)
    power = np.polyfit(np.log2(sides), np.log2(ns), 1)[0]
    return [f"{ground}: cost = {base:.0f} {slope:+.0f} log2(side) ns/ray; as a power of the side: {power:.3f}"]


def _batches(most: int, repeats: int, budget_s: float, cache: pathlib.Path) -> Table:
    columns = [
        Column("rays"),
        Column("cost", "ns/ray", "lower"),
        Column("repeats"),
        Column("compiling", "s", "lower"),
        Column("peak of a warm batch", "bytes/ray", "lower"),
    ]
    table = Table("Cost against the batch, 2001 x 2001 posts 30 m apart", columns)
    counts = [count for count in (10**k for k in range(3, 9)) if count <= most]
    path = _kept(jobs.rough_terrain(2001, 30.0), cache)
    arguments = {"posts": str(path), "spacing": 30.0, "rays": counts, "repeats": repeats, "budget_s": budget_s}
    try:
        found = measuring.in_subprocess("batches", arguments, 3.0 * budget_s + 300.0)
    finally:
        path.unlink(missing_ok=True)
    if "reason" in found:
        table.notes.append(found["reason"])
        return table
    for batch in found["batches"]:
        table.rows.append([batch[key] for key in ("rays", "ns", "repeats", "compile_s", "bytes_per_ray")])
    if len(table.rows) < len(counts):
        table.notes.append(f"stopped when {budget_s:.0f} s were spent; --budget and --largest go further")
    return table

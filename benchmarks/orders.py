"""First hits alone and complete fixes, of rays in random order and sorted: jaxgeo in JAX and native, and peers.

A complete fix is a point of the bilinear surface with latitude, longitude, height and a status.
"""

from __future__ import annotations

import importlib
import pathlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import comparison
import jobs
import measuring
import numpy as np
from measuring import Column, Table

BLOCK = 40  # cells on a side: rays that end in one block follow each other when sorted
COLUMNS = [
    Column("who"),
    Column("order"),
    Column("on one core", "ns/ray", "lower"),
    Column("on all cores", "ns/ray", "lower"),
    Column("rate of the native search on one core", "times", "higher"),
    Column("on all cores", "times", "higher"),
    Column("wrong by over 1 mm", "rays", "lower"),
]
FIRST = "jaxgeo, native"


@dataclass(frozen=True)
class Contender:
    """A run, and how the ranges in m (NaN for a miss) are read from its answer; None where they are not exact."""

    run: Callable[[], Any]
    ranges: Callable[[Any], np.ndarray] | None


def compare(rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """One table of first hits alone, one of complete fixes."""
    job = jobs.mountain_job(rays, cache)
    orders = {"random": np.arange(job.sight.start.size), "sorted": _sorted_by_place(job)}
    hits, fixes = Table(f"First hits alone, {rays} rays", COLUMNS), Table(f"Complete fixes, {rays} rays", COLUMNS)
    _fill(
        hits, job, orders, {**_ours(job, is_whole=False), "embreex": lambda: _peer("embree", "Embreex", None)}, repeats
    )
    peers = {
        "embreex, then Newton": lambda: _peer("embree", "EmbreexFixes", lambda answer: answer[:, 3]),
        "numba": lambda: _peer("numba_walk", "NumbaFixes", lambda answer: answer[:, 3]),
    }
    _fill(fixes, job, orders, {**_ours(job, is_whole=True), **peers}, repeats)
    hits.notes.append(
        "jaxgeo: a bracket from an ECEF ray; embreex: the range to a triangle, rays in float32 made before"
    )
    fixes.notes.append("jaxgeo: position, range, status; peers: position and range")
    return [hits, fixes]


def _sorted_by_place(job: jobs.Job) -> np.ndarray:
    assert job.reference is not None
    at = np.where(np.isfinite(job.reference[:, 0]), job.reference[:, 0], job.sight.target)
    rowcol, _ = job.terrain.over(job.sight.origin + at[:, None] * job.sight.direction)
    block = np.floor(rowcol / BLOCK)
    return np.lexsort((rowcol[:, 1], block[:, 1], block[:, 0]))


Made = Callable[[], Callable[[jobs.Job, jobs.Sight], Contender]]


def _ours(job: jobs.Job, *, is_whole: bool) -> dict[str, Made]:
    def make(is_native: bool) -> Callable[[jobs.Job, jobs.Sight], Contender]:
        import jax
        from peers.ours import dem_of, rays_of

        import jaxgeo
        from jaxgeo import _native

        if is_native and not _native.is_native():
            raise ImportError("the package jaxgeo_native is not installed: pip install ./native")
        search = jaxgeo.FirstHit(native=is_native)

        def fix(ray: Any, dem: Any) -> Any:
            found = jaxgeo.intersect(ray, dem, search=search)
            return found.position, found.slant_range, found.status

        one = fix if is_whole else lambda ray, dem: dem.bracket(ray, search)
        run = jax.jit(jax.vmap(one, in_axes=(0, None)))
        dem = jax.block_until_ready(dem_of(job.terrain))

        def of(_: jobs.Job, sight: jobs.Sight) -> Contender:
            batch = jax.block_until_ready(rays_of(sight))
            ranges = (lambda answer: np.asarray(answer[1])) if is_whole else None
            return Contender(lambda: jax.block_until_ready(run(batch, dem)), ranges)

        return of

    return {FIRST: lambda: make(True), "jaxgeo, in JAX": lambda: make(False)}


def _peer(module: str, kind: str, ranges: Any) -> Callable[[jobs.Job, jobs.Sight], Contender]:
    def of(job: jobs.Job, sight: jobs.Sight) -> Contender:
        peer = getattr(importlib.import_module(f"peers.{module}"), kind)()
        peer.prepare(job.terrain)
        peer.load(sight)
        return Contender(peer.run, ranges)

    importlib.import_module(f"peers.{module}")
    return of


def _fill(table: Table, job: jobs.Job, orders: dict[str, np.ndarray], makers: dict[str, Made], repeats: int) -> None:
    assert job.reference is not None
    contenders: dict[tuple[str, str], Contender] = {}
    for who, maker in makers.items():
        try:
            make = maker()
            for order, index in orders.items():
                contenders[who, order] = make(job, jobs.subset(job.sight, index))
        except (ImportError, OSError, RuntimeError) as error:
            table.notes.append(f"{who}: skipped ({type(error).__name__}: {error})")
    answers = {key: one.run() for key, one in contenders.items()}
    runs = {f"{who}|{order}": one.run for (who, order), one in contenders.items()}
    watch = measuring.Watch()
    with measuring.pinned(1) as is_pinned:
        alone = measuring.interleaved(runs, repeats)
    every = measuring.interleaved(runs, repeats)
    count = job.sight.start.size
    for (who, order), contender in contenders.items():
        times = [1e9 * timing[f"{who}|{order}"].median / count for timing in (alone, every)]
        ours = [
            1e9 * timing[f"{FIRST}|{order}"].median / count if (FIRST, order) in contenders else None
            for timing in (alone, every)
        ]
        ratios = [None if mine is None else theirs / mine for theirs, mine in zip(times, ours, strict=True)]
        wrong = None
        if contender.ranges is not None:
            distance, closest, _ = job.reference[orders[order]].T
            wrong = comparison.judged(contender.ranges(answers[who, order]), distance, closest)[0]
        table.rows.append([who, order, *(times if is_pinned else (None, times[1])), *ratios, wrong])
    table.notes.append(f"while timing, other processes used {watch.others():.2f} cores on average")

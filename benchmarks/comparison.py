"""jaxgeo and its peers on the same rays: speed, memory, and error rates."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass
from typing import Any

import jobs
import measuring
import numpy as np
import peers
from measuring import Column, Table

FAR = 1.0  # m: a different piece of ground
NEAR = 1e-3  # m: not the same point
TIE = 1e-6  # m of height: a ray that passes this close hits or misses depending on rounding
GUARD = 600.0  # s, total time limit of a peer's trial run

SPEEDS = [
    Column("who"),
    Column("version"),
    Column("on one core", "M rays/s", "higher"),
    Column("on all cores", "M rays/s", "higher"),
    Column("spread on all cores", "% of the median", "lower"),
    Column("jaxgeo is faster on one core", "times", "higher"),
    Column("jaxgeo is faster on all cores", "times", "higher"),
    Column("preparing the terrain", "s", "lower"),
    Column("compiling", "s", "lower"),
    Column("memory to prepare", "MB", "lower"),
    Column("memory of the batch", "MB", "lower"),
    Column("threads of a call"),
    Column("timed from"),
    Column("frame"),
    Column("precision"),
]

WRONGS = [
    Column("who"),
    Column("its surface"),
    Column("wrong by over 1 mm against the bilinear reference", "rays", "lower"),
    Column("by over 1 m", "rays", "lower"),
    Column("no answer", "rays", "lower"),
    Column("ties", "rays"),
    Column("median distance", "m", "lower"),
    Column("farthest", "m", "lower"),
    Column("wrong by over 1 mm against its own surface", "rays", "lower"),
    Column("by over 1 m there", "rays", "lower"),
    Column("median distance there", "m", "lower"),
    Column("farthest there", "m", "lower"),
]


@dataclass
class Entry:
    """A prepared peer, its preparation cost, and its answers."""

    peer: peers.Peer
    prepare_s: float
    first_s: float
    ranges: np.ndarray
    memory: dict[str, Any]


def compare(names: list[str], rays: int, repeats: int, cache: pathlib.Path) -> list[Table]:
    """The table of speeds and costs, and the table of wrong answers."""
    job = jobs.mountain_job(rays, cache)
    ready: dict[str, Entry] = {}
    skipped: dict[str, str] = {}
    for name in names:
        # A trial in its own process measures the memory, and shows whether the peer returns at all.
        trial = measuring.in_subprocess("memory", {"peer": name, "rays": rays, "cache": str(cache)}, GUARD)
        if "reason" in trial:
            skipped[name] = trial["reason"]
            continue
        try:
            ready[name] = _made_ready(name, job, trial)
        except (ImportError, OSError, RuntimeError) as error:
            skipped[name] = f"{type(error).__name__}: {error}"
    watch = measuring.Watch()
    with measuring.pinned(1) as is_pinned:
        one = measuring.interleaved({name: entry.peer.run for name, entry in ready.items()}, repeats)
    every = measuring.interleaved({name: entry.peer.run for name, entry in ready.items()}, repeats)
    busy = f"while timing, other processes used {watch.others():.2f} cores on average"
    speeds = _speeds(ready, skipped, one if is_pinned else None, every, job)
    speeds.notes.insert(0, busy)
    return [speeds, _wrongs(ready, job)]


def _made_ready(name: str, job: jobs.Job, memory: dict[str, Any]) -> Entry:
    peer = peers.make(name)
    _, prepare_s = measuring.timed(lambda: peer.prepare(job.terrain))
    peer.load(job.sight)
    answer, first_s = measuring.timed(peer.run)
    return Entry(peer, prepare_s, first_s, peer.ranges(answer), memory)


def _speeds(
    ready: dict[str, Entry],
    skipped: dict[str, str],
    one: dict[str, measuring.Timing] | None,
    every: dict[str, measuring.Timing],
    job: jobs.Job,
) -> Table:
    count = job.sight.start.size
    size = "x".join(str(n) for n in job.terrain.posts.shape)
    table = Table(f"First hits of {count} rays, {size} posts", list(SPEEDS))
    for name, entry in ready.items():
        facts, memory = entry.peer.facts, entry.memory
        timings = (one[name] if one else None, every[name])
        rates = [None if t is None else 1e-6 * count / t.median for t in timings]
        ratios: list[float | None] = [None, None]
        if "jaxgeo" in ready and name != "jaxgeo":
            ratios = [
                one[name].median / one["jaxgeo"].median if one else None,
                every[name].median / every["jaxgeo"].median,
            ]
        compile_s = max(0.0, entry.first_s - every[name].median)
        row = [name, entry.peer.version(), *rates, 100.0 * every[name].spread, *ratios, entry.prepare_s, compile_s]
        row += [memory["prepare_MB"], memory["batch_MB"], facts.threads, facts.input, facts.frame, facts.precision]
        table.rows.append(row)
    table.notes += [f"{name}: {entry.peer.facts.notes}" for name, entry in ready.items() if entry.peer.facts.notes]
    table.notes += [f"{name}: skipped ({reason})" for name, reason in skipped.items()]
    table.notes += [
        "warm, interleaved in turning order, medians; one core: all threads of the process pinned to one processor",
        "what turns ECEF rays into a peer's own input is not timed, which favours the peer; numba-ecef shows it",
        "memory: peak over what was resident before, in a process of its own, without compiling (1 MB = 1e6 bytes)",
    ]
    if one is None:
        table.notes.append("one core: this system cannot pin threads")
    return table


def _wrongs(ready: dict[str, Entry], job: jobs.Job) -> Table:
    assert job.reference is not None
    distance, closest, _ = job.reference.T
    table = Table(f"Wrong answers among {distance.size} rays", list(WRONGS))
    for name, entry in ready.items():
        surface = entry.peer.facts.surface
        row: list[Any] = [name, surface, *judged(entry.ranges, distance, closest)]
        own = None
        try:
            own = entry.peer.own_surface()
        except ImportError as error:
            table.notes.append(f"{name}: its own surface needs numba ({error})")
        if own is None:
            row += [None] * 4
        else:
            near, far, _, _, middle, farthest = judged(entry.ranges, own, np.full(own.shape, np.inf))
            row += [near, far, middle, farthest]
        table.rows.append(row)
    table.notes += [
        "bilinear reference: a walk over every cell with the exact map of the curved Earth, in float64",
        "triangles and chords are other surfaces: their distance from the bilinear reference is no error of the peer",
        "own surface: an exact float64 walk over the same float32 vertices, or over the same chords",
        f"ties: rays over 1 mm away that pass the ground closer than {TIE:g} m before; they are not counted as wrong",
        "distances are along the ray, as any difference of range is",
    ]
    return table


def judged(found: np.ndarray, expected: np.ndarray, closest: np.ndarray) -> tuple[int, int, int, int, float, float]:
    """(wrong by > 1 mm, by > 1 m, unanswered, ties, median distance, farthest); a miss in both counts as right."""
    both_miss = np.isnan(found) & np.isnan(expected)
    away = np.where(both_miss, 0.0, np.abs(found - expected))
    ties = ~(away <= NEAR) & (closest <= TIE)
    near, far = ~(away <= NEAR) & ~ties, ~(away <= FAR) & ~ties
    unanswered = np.isnan(found) & ~np.isnan(expected)
    if np.isnan(away).all():
        return int(near.sum()), int(far.sum()), int(unanswered.sum()), int(ties.sum()), float("nan"), float("nan")
    return (
        int(near.sum()),
        int(far.sum()),
        int(unanswered.sum()),
        int(ties.sum()),
        float(np.nanmedian(away)),
        float(np.nanmax(away)),
    )

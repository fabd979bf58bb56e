"""Measurements that need a separate process. Run: python workers.py TASK '{...}'; prints a line of JSON."""

from __future__ import annotations

import json
import pathlib
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jobs
import measuring
import numpy as np
import peers


def memory(peer: str, rays: int, cache: str) -> dict[str, Any]:
    """Peak memory of one peer above the baseline: to prepare the terrain, and for a warm batch."""
    job = jobs.mountain_job(rays, pathlib.Path(cache), with_reference=False)
    contender = peers.make(peer)
    before = measuring.resident()
    measuring.reset_peak()
    contender.prepare(job.terrain)
    prepared = measuring.peak()
    contender.load(job.sight)
    contender.run()
    begin = measuring.resident()
    measuring.reset_peak()
    contender.run()
    return {"prepare_MB": 1e-6 * (prepared - before), "batch_MB": 1e-6 * (measuring.peak() - begin)}


def building(posts: str, spacing: float) -> dict[str, float]:
    """Memory as multiples of the posts' bytes: the peak while building a Dem from posts in memory, and kept by it."""
    import jax
    from peers.ours import dem_of

    terrain = jobs.TangentTerrain(np.load(posts), np.deg2rad(40.0), np.deg2rad(10.0), spacing)
    small = jobs.TangentTerrain(terrain.posts[:64, :64], terrain.lat, terrain.lon, spacing)
    jax.block_until_ready(dem_of(small, terrain.posts.dtype))
    before = measuring.resident()
    measuring.reset_peak()
    dem = jax.block_until_ready(dem_of(terrain, terrain.posts.dtype))
    size = terrain.posts.nbytes
    kept = sum(leaf.nbytes for leaf in jax.tree.leaves(dem) if hasattr(leaf, "nbytes"))
    return {"peak": (measuring.peak() - before + size) / size, "kept": kept / size}


def batches(posts: str, spacing: float, rays: list[int], repeats: int, budget_s: float) -> dict[str, Any]:
    """ns per ray and memory of jaxgeo over posts kept in a file, for growing batches until the time budget is spent."""
    import jax
    from peers.ours import answers, dem_of, rays_of

    end = time.monotonic() + budget_s
    terrain = jobs.TangentTerrain(np.load(posts), np.deg2rad(40.0), np.deg2rad(10.0), spacing)
    dem = jax.block_until_ready(dem_of(terrain, terrain.posts.dtype))
    found = []
    for count in rays:
        if time.monotonic() > end:
            break
        batch = jax.block_until_ready(rays_of(jobs.random_job(terrain, count)))
        run = lambda batch=batch: jax.block_until_ready(answers(batch, dem))  # noqa: E731
        first_s = measuring.timed(run)[1]
        begin = measuring.resident()
        measuring.reset_peak()
        times = [measuring.timed(run)[1]]
        bytes_per_ray = (measuring.peak() - begin) / count
        while len(times) < repeats and time.monotonic() < end:
            times.append(measuring.timed(run)[1])
        median = statistics.median(times)
        row = {"rays": count, "ns": 1e9 * median / count, "repeats": len(times)}
        found.append(row | {"compile_s": max(0.0, first_s - median), "bytes_per_ray": bytes_per_ray})
    return {"batches": found}


def cores(devices: int, rays: int, repeats: int, cache: str) -> dict[str, Any]:
    """M rays/s by plain vmap, by threads over chunks, and by shard_map over `devices` host devices."""
    import jax

    if devices > 1:
        jax.config.update("jax_num_cpu_devices", devices)
    from jax.sharding import NamedSharding
    from jax.sharding import PartitionSpec as P
    from peers.ours import answers, dem_of, rays_of

    import jaxgeo

    job = jobs.mountain_job(rays // devices * devices, pathlib.Path(cache), with_reference=False)
    dem, batch = dem_of(job.terrain), rays_of(job.sight)
    runs = {"vmap": lambda: jax.block_until_ready(answers(batch, dem))}
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("rays",))
        over = jax.vmap(jaxgeo.intersect, in_axes=(0, None))
        shared = jax.jit(
            jax.shard_map(over, mesh=mesh, in_specs=(P("rays"), P()), out_specs=P("rays"), check_vma=False)
        )
        split = jax.device_put(batch, NamedSharding(mesh, P("rays")))
        everywhere = jax.device_put(dem, NamedSharding(mesh, P()))
        runs["shard_map"] = lambda: jax.block_until_ready(shared(split, everywhere))
        chunks = np.array_split(np.arange(job.sight.start.size), devices)
        parts = [rays_of(jobs.subset(job.sight, chunk)) for chunk in chunks]
        pool = ThreadPoolExecutor(devices)
        work = lambda part: jax.block_until_ready(answers(part, dem))  # noqa: E731
        runs["threads"] = lambda: list(pool.map(work, parts))
    compile_s = {name: measuring.timed(run)[1] for name, run in runs.items()}
    timings = measuring.interleaved(runs, repeats)
    count = job.sight.start.size
    return {name: {"rate": 1e-6 * count / t.median, "first_s": compile_s[name]} for name, t in timings.items()}


def device(kind: str, rays: int, repeats: int, budget_s: float, cache: str) -> dict[str, Any]:
    """The tables of `accelerator.py` on memory and rays."""
    import accelerator
    import jax

    place, end = jax.devices(kind)[0], time.monotonic() + budget_s
    bench = accelerator.Bench(place, repeats, rays, 0, 0, (), pathlib.Path(cache), end)
    return {"tables": [table.record() for table in (accelerator.bandwidth(bench), *accelerator.rays(bench))]}


TASKS = {"memory": memory, "building": building, "batches": batches, "cores": cores, "device": device}

if __name__ == "__main__":
    print(json.dumps(TASKS[sys.argv[1]](**json.loads(sys.argv[2]))))

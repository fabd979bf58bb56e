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


def device(kind: str, precision: str, rays: list[int], repeats: int, budget_s: float, cache: str) -> dict[str, Any]:
    """M rays/s on a device for growing batches, and the bandwidth of a 1 GiB copy on it."""
    import jax
    import jax.numpy as jnp
    from peers.ours import dem_of, rays_of

    import jaxgeo

    end = time.monotonic() + budget_s
    place = jax.devices(kind)[0]
    with jax.default_device(place):
        search = _search(precision)
        answers = jax.jit(jax.vmap(lambda ray, dem: jaxgeo.intersect(ray, dem, search=search), (0, None)))
        job = jobs.mountain_job(jobs.MOST, pathlib.Path(cache), with_reference=False)
        dem, base = dem_of(job.terrain), rays_of(job.sight)
        block = jnp.zeros(2**27)
        copy = jax.jit(lambda x: x + 1.0)
        jax.block_until_ready(copy(block))
        copies = [measuring.timed(lambda: jax.block_until_ready(copy(block)))[1] for _ in range(5)]
        del block
        batches = []
        for count in rays:
            if time.monotonic() > end:
                break
            tiles = -(-count // jobs.MOST)
            batch = jax.tree.map(lambda x, n=tiles, k=count: jnp.tile(x, (n, 1))[:k], base)
            run = lambda batch=batch: jax.block_until_ready(answers(batch, dem))  # noqa: E731
            fix, first_s = measuring.timed(run)
            moved = sum(leaf.nbytes for leaf in jax.tree.leaves((batch, fix)) if hasattr(leaf, "nbytes")) / count
            del fix
            times = [measuring.timed(run)[1] for _ in range(repeats)]
            rate = count / statistics.median(times)
            batches.append({"rays": count, "rate": 1e-6 * rate, "first_s": first_s, "bytes": moved})
    return {"name": place.device_kind, "copy_GB_s": 2e-9 * 2**30 / statistics.median(copies), "batches": batches}


def _search(precision: str) -> Any:
    """The first-hit search in that precision. Raises `SystemExit` with a message if it has no such option."""
    import jaxgeo

    if precision == "float64":
        return jaxgeo.FirstHit()
    raise SystemExit(f"FirstHit has no choice of precision: {precision} searching does not exist yet")


TASKS = {"memory": memory, "building": building, "batches": batches, "cores": cores, "device": device}

if __name__ == "__main__":
    print(json.dumps(TASKS[sys.argv[1]](**json.loads(sys.argv[2]))))

"""First hits of 100 000 rays over rough mountains against a walk over every cell, and the error rate of bisection.

Run: python benchmarks/first_hit.py [--rays 100000] [--chunk 10000]. The exhaustive walk takes about 5 ms a ray.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import pathlib
import sys
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))

from support.fractal import (
    Sight,
    TangentTerrain,
    fractal_posts,
    grazing_sights,
    median_slope_deg,
    random_sights,
    walk_every_cell,
)

WRONG_DISTANCE = 1e-3  # m
TIE = 1e-6  # m of height
SPACING = 30.0  # m


def mountains() -> TangentTerrain:
    """2001 x 2001 posts, 30 m apart, 0 to 3000 m, median slope 20 degrees."""
    posts = fractal_posts(2001, spacing=SPACING, relief=3000.0, exponent=3.39, seed=1)
    return TangentTerrain(posts, np.deg2rad(40.0), np.deg2rad(10.0), SPACING)


def all_sights(terrain: TangentTerrain, count: int) -> Sight:
    """Nine tenths random rays, one tenth that graze a patch and cross it twice."""
    parts = [random_sights(terrain, count - count // 10, seed=4), grazing_sights(terrain, count // 10, seed=5)]
    return Sight(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sight.__dataclass_fields__))


def _walk(terrain: TangentTerrain, sight: Sight) -> np.ndarray:
    walked = [
        walk_every_cell(terrain, o, d, start, target + 3000.0)
        for o, d, start, target in zip(sight.origin, sight.direction, sight.start, sight.target, strict=True)
    ]
    return np.array([(w.distance, w.closest, w.crossings) for w in walked])


def exhaustive(terrain: TangentTerrain, sight: Sight) -> np.ndarray:
    """(distance, closest clearance before it, crossings in its cell) of every ray, on all cores."""
    count = os.cpu_count() or 1
    parts = np.array_split(np.arange(sight.start.size), 8 * count)
    pieces = [Sight(*(getattr(sight, name)[part] for name in Sight.__dataclass_fields__)) for part in parts]
    with multiprocessing.get_context("fork").Pool(count) as pool:
        return np.concatenate(pool.starmap(_walk, [(terrain, piece) for piece in pieces]))


def searched(terrain: TangentTerrain, sight: Sight, chunk: int) -> dict[str, tuple[np.ndarray, float]]:
    """Slant ranges by each search, and compiled seconds per ray."""
    import jax
    import jax.numpy as jnp

    import jaxgeo
    from jaxgeo.terrain import TangentGrid

    jaxgeo.enable_x64()
    shape = terrain.posts.shape
    centre = jaxgeo.Geodetic(lat=terrain.lat, lon=terrain.lon, height=0.0)
    dem = jaxgeo.Dem.from_array(
        terrain.posts, TangentGrid.centred(centre, spacing=(terrain.spacing, terrain.spacing), shape=shape)
    )
    rays = jaxgeo.Ray(jnp.asarray(sight.origin), jnp.asarray(sight.direction))
    chunks = [jax.tree.map(lambda x, k=k: x[k : k + chunk], rays) for k in range(0, sight.start.size, chunk)]
    results = {}
    for name, search in (("first hit", jaxgeo.FirstHit()), ("bisection", jaxgeo.Bisection())):
        ranges = jax.jit(
            jax.vmap(lambda ray, dem, search=search: jaxgeo.intersect(ray, dem, search=search).slant_range, (0, None))
        )
        jax.block_until_ready(ranges(chunks[0], dem))
        begin = time.perf_counter()
        found = [np.asarray(ranges(part, dem)) for part in chunks]
        results[name] = (np.concatenate(found), (time.perf_counter() - begin) / sight.start.size)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=100_000)
    parser.add_argument("--chunk", type=int, default=10_000)
    options = parser.parse_args()
    terrain = mountains()
    sight = all_sights(terrain, options.rays)
    print(f"{sight.start.size} rays, median slope {median_slope_deg(terrain.posts, SPACING):.1f} deg")
    expected, closest, crossings = exhaustive(terrain, sight).T
    print(f"crossed twice within one cell: {int(np.sum(crossings == 2))}")
    for name, (distance, seconds) in searched(terrain, sight, options.chunk).items():
        away = np.abs(distance - expected)
        differs = ~(away <= WRONG_DISTANCE)
        ties = differs & (closest <= TIE)
        wrong = differs & ~ties
        print(
            f"{name:10s} wrong {int(wrong.sum())} ({wrong.mean():.2%}), ties {np.flatnonzero(ties).tolist()}, "
            f"largest distance else {np.nanmax(away[~differs]):.1e} m, farthest {np.nanmax(away):.0f} m; "
            f"{1e-6 / seconds:.3f} M rays/s"
        )


if __name__ == "__main__":
    main()

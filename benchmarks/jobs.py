"""Terrains, rays and reference answers of the benchmarks, cached in a directory between runs."""

from __future__ import annotations

import hashlib
import importlib.util
import pathlib
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))
sys.path.insert(0, str(HERE.parent))
if getattr(importlib.util.find_spec("coverage"), "origin", None) is None:
    sys.modules["coverage"] = None  # type: ignore[assignment]  # else numba takes the folder tests/coverage for it

from first_hit import SPACING, all_sights, exhaustive, mountains  # noqa: E402
from support.fractal import Sight, TangentTerrain, fractal_posts, random_sights, sights  # noqa: E402

CACHE = pathlib.Path(tempfile.gettempdir()) / "jaxgeo-benchmarks"
MOST = 100_000  # rays with a reference
SOURCES = (HERE.parent / "tests" / "support" / "fractal.py", HERE / "first_hit.py")


@dataclass(frozen=True)
class Job:
    """A terrain, rays over it, and for each (distance, closest clearance before it, crossings) by the reference."""

    terrain: TangentTerrain
    sight: Sight
    reference: np.ndarray | None = None


def subset(sight: Sight, index: np.ndarray | slice) -> Sight:
    """A subset of the rays."""
    return Sight(*(getattr(sight, f.name)[index] for f in fields(Sight)))


def mountain_job(count: int, cache: pathlib.Path, *, with_reference: bool = True) -> Job:
    """The fractal job: `count` of its 100 000 rays, evenly spread, and the reference answers of a walk over every cell.

    The walk takes 3 to 5 ms a ray once; afterwards its answers are read from the cache.
    """
    terrain = mountains()
    whole = _kept_sights(cache / f"sights-{_key(*SOURCES)}.npz", lambda: all_sights(terrain, MOST))
    index = np.linspace(0, MOST - 1, min(count, MOST)).astype(int)
    sight = subset(whole, index)
    if not with_reference:
        return Job(terrain, sight)
    everything = cache / f"reference-{_content(terrain, whole)}.npy"
    if everything.is_file():
        return Job(terrain, sight, np.load(everything)[index])
    kept = cache / f"reference-{_content(terrain, sight)}.npy"
    if not kept.is_file():
        print(f"walking every cell under {index.size} rays for the reference, once ...", flush=True)
        np.save(kept, exhaustive(terrain, sight))
    return Job(terrain, sight, np.load(kept))


def random_job(terrain: TangentTerrain, count: int, seed: int = 4) -> Sight:
    """Any number of random rays, generated in chunks of 100 000."""
    parts = [
        random_sights(terrain, min(MOST, count - first), seed=seed + 1000 * k)
        for k, first in enumerate(range(0, count, MOST))
    ]
    return Sight(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Sight)))


def rough_terrain(side: int, spacing: float, dtype: type = np.float32) -> TangentTerrain:
    """Rough ground of side x side posts, 0 to 3000 m."""
    posts = fractal_posts(side, spacing=spacing, relief=3000.0, exponent=3.39, seed=1)
    return TangentTerrain(posts.astype(dtype), np.deg2rad(40.0), np.deg2rad(10.0), spacing)


def with_runway(terrain: TangentTerrain, width: int = 24) -> tuple[TangentTerrain, Sight]:
    """The terrain with a strip of ground along its middle row that follows one straight ray, and that ray.

    The ray passes 2 to 5 cm above a strip `width` posts wide, from one side of the terrain to the other: no bound on
    more than a few cells clears it, so a first-hit search has to settle thousands of cells.
    """
    rows, cols = terrain.posts.shape
    row = 0.5 * (rows - 1.0)
    height = float(np.median(terrain.posts))  # a canyon where the ground is higher, a dam where it is lower
    ends = terrain.position(np.array([[row, 1.5], [row, cols - 2.5]]), np.array([height, height]))
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    at = np.linspace(-0.1, 1.1, 4 * cols) * length
    rowcol, along = terrain.over(ends[0] + at[:, None] * direction)
    heights = np.interp(np.arange(cols), rowcol[:, 1], along)
    ripple = 0.02 + 0.03 * np.random.default_rng(7).random((width, cols))
    posts = terrain.posts.copy()
    first = int(row) - width // 2
    posts[first : first + width] = heights[None, :] - ripple
    posts[first : first + width, -40:] += 5.0  # a wall at the end, for the ray to hit
    skimming = Sight(ends[:1], direction[None, :], np.zeros(1), np.array([length]))
    return TangentTerrain(posts, terrain.lat, terrain.lon, terrain.spacing), skimming


def bundle(terrain: TangentTerrain, count: int, *, angle: float = 1e-4, position: float = 1.0, seed: int = 8) -> Sight:
    """Monte Carlo perturbations of one ray: its direction by `angle` rad and its origin by `position` m (1 sigma)."""
    one = random_sights(terrain, 1, seed=seed)
    rng = np.random.default_rng(seed)
    origin = one.origin + position * rng.standard_normal((count, 3))
    direction = one.direction + angle * rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return Sight(origin, direction, np.repeat(one.start, count), np.repeat(one.target, count))


def _kept_sights(path: pathlib.Path, make: Callable[[], Sight]) -> Sight:
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        made = make()
        np.savez(path, **{f.name: getattr(made, f.name) for f in fields(Sight)})
    with np.load(path) as kept:
        return Sight(*(kept[f.name] for f in fields(Sight)))


def _key(*paths: pathlib.Path) -> str:
    return hashlib.blake2b(b"".join(path.read_bytes() for path in paths), digest_size=8).hexdigest()


def _content(terrain: TangentTerrain, sight: Sight) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for array in (terrain.posts, sight.origin, sight.direction, sight.start, sight.target):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


__all__ = ["CACHE", "MOST", "SPACING", "Job", "Sight", "TangentTerrain", "bundle", "mountain_job", "mountains"]
__all__ += ["random_job", "rough_terrain", "sights", "subset", "with_runway"]


def sweep_over(terrain: TangentTerrain) -> tuple[Any, Any]:
    """A sensor that sweeps the terrain from 15 km in 2 s, and its trajectory at 220 m/s with oscillating attitude."""
    from jaxgeo import Geodetic, Pose, Trajectory, enable_x64
    from jaxgeo.sensor.conventions import li_2023_sweep_sensor

    enable_x64()
    scan = {"scan_start": np.deg2rad(-25.0), "scan_end": np.deg2rad(-65.0), "duration": 2.0}
    sensor = li_2023_sweep_sensor(focal_length=1.9, pixel_pitch=8e-6, width=7584, height=48836, **scan)
    times, height = np.linspace(-0.1, 2.1, 221), 15_000.0
    lat = terrain.lat + height / np.tan(np.deg2rad(40.0)) / 6.37e6  # it looks to the right, southwards
    lon = terrain.lon + (times - 1.0) * 220.0 / (6.37e6 * np.cos(terrain.lat))
    position = Geodetic(lat=np.full(times.size, lat), lon=lon, height=np.full(times.size, height))
    swing = [np.deg2rad(size) * np.sin(rate * times) for size, rate in ((0.2, 2.0), (0.3, 3.0), (0.5, 4.0))]
    pose = Pose(position, 0.5 * np.pi + swing[0], swing[1], swing[2])
    return sensor, Trajectory.from_knots(times, pose, np.tile([0.5 * np.pi, 0.0], (times.size, 1)))

"""Ground that lines of sight need: each is followed from above all terrain until it is below the ground.

A ray that is below the lowest post around it has hit the ground before. So the parts of tiles under it up to there are
all that its first intersection depends on; what lies within a margin beside it is for the ground around the fix, and
for the lines of sight that its errors give.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Protocol, runtime_checkable

import numpy as np
from pyproj.transformer import Transformer

from jaxgeo.earth.ray import Ray

CEILING = 9100.0  # m; above all terrain
STEP = 400.0  # m along a line of sight
BESIDE = 300.0  # m around each line of sight
SHARE = 0.03  # of the distance: the same
REACH = 100_000.0  # m: how far below `CEILING` a line of sight that falls is followed
RISING = 20_000.0  # m: the same for one that rises
METRES_PER_DEGREE = 111_000.0
AROUND = tuple((x, y) for x in (0.0, -1.0, 1.0) for y in (0.0, -1.0, 1.0))  # in units of the margin
MOST_RAYS = 20_000


@runtime_checkable
class Ground(Protocol):
    """Ground that is fetched where it is asked for."""

    def fetch(self, lon: np.ndarray, lat: np.ndarray) -> None:
        """Fetch the ground at positions (n,) in deg."""
        ...

    def lowest(self, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        """A height (n,) in m above the ellipsoid that the fetched ground around positions does not fall below; -inf
        where none is known."""
        ...


@dataclasses.dataclass
class Extent:
    """Edges in deg of the positions added so far; longitudes are counted from the first position."""

    start: float | None = None
    west: float = np.inf
    east: float = -np.inf
    south: float = np.inf
    north: float = -np.inf

    def add(self, lon: np.ndarray, lat: np.ndarray) -> None:
        """Enlarge it to hold positions."""
        if not len(lon):
            return
        if self.start is None:
            self.start = float(lon[0])
        off = self.start + np.remainder(lon - self.start + 180.0, 360.0) - 180.0
        self.west, self.east = min(self.west, float(off.min())), max(self.east, float(off.max()))
        self.south, self.north = min(self.south, float(lat.min())), max(self.north, float(lat.max()))

    @property
    def bounds(self) -> tuple[float, float, float, float] | None:
        """(west, south, east, north), longitudes within 180 deg, west > east across the date line; None if empty."""
        if self.start is None:
            return None
        west, east = (float(np.remainder(edge + 180.0, 360.0) - 180.0) for edge in (self.west, self.east))
        return west, max(self.south, -90.0), east, min(self.north, 90.0)


def follow(rays: Ray, ground: Ground, extent: Extent, *, spread: float = 0.0, beside: float = BESIDE) -> int:
    """Fetch the ground of rays (n, 3), ECEF, and add it to `extent`; the number of rays that were not followed to it.

    `spread` is the angle in rad by which lines of sight may differ from the given ones, `beside` in m the same for
    positions. Rays that rise, or that are still above the ground at a distance of `REACH`, are cut there.
    """
    origin, direction = (np.asarray(part, np.float64).reshape(-1, 3) for part in (rays.origin, rays.direction))
    known = np.isfinite(origin).all(axis=1) & np.isfinite(direction).all(axis=1)
    known &= np.linalg.norm(origin, axis=1) < 2e7  # no line of sight, or far away in space
    origin, direction = origin[known], direction[known]
    if len(origin) > MOST_RAYS:
        index = np.linspace(0, len(origin) - 1, MOST_RAYS).astype(int)
        origin, direction = origin[index], direction[index]
    if spread > 0.0:
        up = origin / np.linalg.norm(origin, axis=1, keepdims=True)
        raised = direction + np.tan(spread) * (up - (up * direction).sum(axis=1, keepdims=True) * direction)
        raised /= np.linalg.norm(raised, axis=1, keepdims=True)
        origin, direction = np.concatenate([origin, origin]), np.concatenate([direction, raised])
    share = max(SHARE, np.tan(min(spread, 0.5)))
    count = len(origin)
    at, start = np.zeros(count), np.full(count, np.nan)
    last = np.full(count, np.inf)
    active, cut = np.ones(count, bool), np.zeros(count, bool)
    while active.any():
        index = np.flatnonzero(active)
        lon, lat, height = _geodetic(origin[index] + at[index, None] * direction[index])
        above = height > CEILING  # a ray cannot come down there on a shorter way than the rest of its height
        onward = np.where(above, np.maximum(STEP, height - CEILING), STEP)
        rises = height > last[index]
        active[index[above & rises]] = False
        last[index] = height
        under = index[~above]
        start[under] = np.where(np.isnan(start[under]), at[under], start[under])
        if under.size:
            lon, lat, height, rises = lon[~above], lat[~above], height[~above], rises[~above]
            wide = beside + share * at[under]
            around = _around(lon, lat, wide)
            ground.fetch(*around)
            extent.add(*around)
            with np.errstate(invalid="ignore"):
                met = height < ground.lowest(lon, lat)
            far = at[under] - start[under] > np.where(rises, RISING, REACH)
            active[under[met | far]] = False
            cut[under[far & ~met]] = True
        at[index] += onward
    return int(cut[: count // 2 if spread > 0.0 else count].sum())


def _around(lon: np.ndarray, lat: np.ndarray, wide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions, and the corners and sides of squares with half a side of `wide` m around them."""
    down = wide / METRES_PER_DEGREE
    across = np.minimum(down / np.maximum(np.cos(np.radians(lat)), 1e-3), 90.0)
    lons = np.concatenate([lon + across * x for x, _ in AROUND])
    lats = np.concatenate([np.clip(lat + down * y, -90.0, 90.0) for _, y in AROUND])
    return np.remainder(lons + 180.0, 360.0) - 180.0, lats


def _geodetic(p_ecef: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lon, lat, height = (np.asarray(one) for one in _to_geodetic().transform(*p_ecef.T))
    return lon, lat, height


@functools.cache
def _to_geodetic() -> Transformer:
    return Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)

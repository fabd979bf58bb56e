"""Rough synthetic mountains, and an independent exhaustive ray walk over them in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)


def fractal_posts(size: int, *, spacing: float, relief: float, exponent: float, seed: int) -> np.ndarray:
    """Posts (size, size) in m from 0 to `relief`, a Gaussian field with power spectrum f**-exponent."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    frequency[0, 0] = np.inf
    field = np.fft.irfft2(spectrum * frequency ** (-0.5 * exponent), s=(size, size))
    return relief * (field - field.min()) / np.ptp(field)


def median_slope_deg(posts: np.ndarray, spacing: float) -> float:
    """Median slope of the posts, degrees."""
    rows, cols = np.gradient(posts, spacing)
    return float(np.rad2deg(np.median(np.arctan(np.hypot(rows, cols)))))


def ecef(lat, lon, height):
    """ECEF of geodetic coordinates in rad and m."""
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (N + height) * np.cos(lat) * np.cos(lon),
            (N + height) * np.cos(lat) * np.sin(lon),
            (N * (1.0 - E2) + height) * np.sin(lat),
        ],
        axis=-1,
    )


def normal_and_height(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ellipsoid normal (..., 3) and height (...) of ECEF points, by fixed-point iteration on the latitude."""
    horizontal = np.hypot(p[..., 0], p[..., 1])
    lat = np.arctan2(p[..., 2], horizontal * (1.0 - E2))
    for _ in range(8):
        N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
        lat = np.arctan2(p[..., 2] + E2 * N * np.sin(lat), horizontal)
    height = horizontal * np.cos(lat) + p[..., 2] * np.sin(lat) - A * np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    lon = np.arctan2(p[..., 1], p[..., 0])
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1), height


@dataclass(frozen=True)
class TangentTerrain:
    """Posts regular in the plane that touches the ellipsoid at (lat, lon): the grid `TangentGrid` describes, in NumPy.

    Rows run south, columns east, `spacing` m apart; the post ((rows - 1) / 2, (cols - 1) / 2) is the point of contact.
    """

    posts: np.ndarray
    lat: float
    lon: float
    spacing: float

    @property
    def middle(self) -> np.ndarray:
        return (np.array(self.posts.shape) - 1) / 2.0

    @property
    def radii(self) -> np.ndarray:
        """Radii of curvature at the point of contact along a row step (meridian) and a column step, m."""
        W2 = 1.0 - E2 * np.sin(self.lat) ** 2
        return np.array([A * (1.0 - E2) / W2**1.5, A / np.sqrt(W2)])

    @property
    def axes(self) -> np.ndarray:
        """Rows: east, north, up of the point of contact in ECEF."""
        s, c, sl, cl = np.sin(self.lat), np.cos(self.lat), np.sin(self.lon), np.cos(self.lon)
        return np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])

    def over(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row, col) (..., 2) and height (...) of ECEF points."""
        normal, height = normal_and_height(p)
        east, north, up = np.moveaxis(normal @ self.axes.T, -1, 0)
        rowcol = np.stack([-north / up, east / up], axis=-1) * (self.radii / self.spacing) + self.middle
        return rowcol, height

    def surface(self, rowcol: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Bilinear height at (row, col) with the patch of `cell`."""
        i, j = cell[..., 0], cell[..., 1]
        u, v = rowcol[..., 0] - i, rowcol[..., 1] - j
        z = self.posts
        return (
            z[i, j] * (1 - u) * (1 - v)
            + z[i, j + 1] * (1 - u) * v
            + z[i + 1, j] * u * (1 - v)
            + z[i + 1, j + 1] * u * v
        )

    def clearance(self, p: np.ndarray, cell: np.ndarray) -> np.ndarray:
        rowcol, height = self.over(p)
        return height - self.surface(rowcol, cell)

    def position(self, rowcol: np.ndarray, height: np.ndarray) -> np.ndarray:
        """ECEF of points at (row, col) and height."""
        offset = (rowcol - self.middle) * (self.spacing / self.radii)
        local = np.stack([offset[..., 1], -offset[..., 0], np.ones_like(offset[..., 0])], axis=-1)
        normal = local @ self.axes
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        lat = np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1]))
        return ecef(lat, np.arctan2(normal[..., 1], normal[..., 0]), height)


@dataclass(frozen=True)
class Walked:
    """Outcome of the exhaustive walk of one ray.

    Range of the first crossing (NaN if none), the smallest clearance before it (m), and the number of surface crossings
    within the first crossed cell.
    """

    distance: float
    closest: float
    crossings: int


def walk_every_cell(
    terrain: TangentTerrain, origin: np.ndarray, direction: np.ndarray, start: float, end: float
) -> Walked:
    """First crossing between two ranges, by visiting every cell below the ray with the exact map."""
    rowcol_ends, _ = terrain.over(origin + np.array([start, end])[:, None] * direction)
    count = int(4 * np.abs(np.diff(rowcol_ends, axis=0)).max()) + 8
    s = np.linspace(start, end, count)
    rowcol, _ = terrain.over(origin + s[:, None] * direction)
    cuts = [s]
    for axis in (0, 1):
        whole = np.floor(rowcol[:, axis])
        crossed = np.flatnonzero(whole[1:] != whole[:-1])
        line = np.maximum(whole[1:], whole[:-1])[crossed]
        low, high, low_value = s[crossed], s[crossed + 1], rowcol[crossed, axis] - line
        high_value = rowcol[crossed + 1, axis] - line
        for _ in range(3):  # the map is nearly linear here
            at = low - low_value * (high - low) / (high_value - low_value)
            value = terrain.over(origin + at[:, None] * direction)[0][:, axis] - line
            slope = (high_value - low_value) / (high - low)
            at = at - value / slope
        cuts.append(at)
    cuts = np.unique(np.concatenate(cuts))
    return _first_crossing(terrain, origin, direction, cuts)


def _first_crossing(terrain: TangentTerrain, origin: np.ndarray, direction: np.ndarray, cuts: np.ndarray) -> Walked:
    begin, end = cuts[:-1], cuts[1:]
    middle = 0.5 * (begin + end)
    rowcol, _ = terrain.over(origin + middle[:, None] * direction)
    cell = np.floor(rowcol).astype(int)
    inside = np.all((cell >= 0) & (cell <= np.array(terrain.posts.shape) - 2), axis=-1)
    begin, end, middle, cell = begin[inside], end[inside], middle[inside], cell[inside]

    def clearance(at: np.ndarray) -> np.ndarray:
        return terrain.clearance(origin + at[:, None] * direction, cell)

    first, half, last = clearance(begin), clearance(middle), clearance(end)
    bend = 2.0 * (first + last - 2.0 * half)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(bend > 0.0, np.clip(-(last - first - bend) / (2.0 * bend), 0.0, 1.0), 1.0)
    lowest_at = begin + at * (end - begin)
    lowest = clearance(lowest_at)
    crossed = (first <= 0.0) | (last <= 0.0) | (lowest <= 0.0)
    if not crossed.any():
        return Walked(np.nan, float(np.min(lowest, initial=np.inf)), 0)
    k = int(np.argmax(crossed))
    before = min(float(np.min(np.minimum(lowest, last)[:k], initial=np.inf)), np.inf)
    low, high = begin[k], lowest_at[k] if lowest[k] <= 0.0 else end[k]
    if first[k] <= 0.0:
        high = low
    for _ in range(60):
        mid = 0.5 * (low + high)
        if terrain.clearance(origin + mid * direction, cell[k]) > 0.0:
            low = mid
        else:
            high = mid
    same = np.all(cell == cell[k], axis=-1)
    is_double = first[same][0] > 0.0 and last[same][-1] > 0.0
    return Walked(float(0.5 * (low + high)), min(before, abs(float(lowest[k]))), 2 if is_double else 1)


@dataclass(frozen=True)
class Sight:
    """Rays (n, 3) from a common altitude, with the ranges of the ceiling crossing and of the target."""

    origin: np.ndarray
    direction: np.ndarray
    start: np.ndarray
    target: np.ndarray


def sights(
    terrain: TangentTerrain,
    rowcol: np.ndarray,
    height: np.ndarray,
    zenith: np.ndarray,
    azimuth: np.ndarray,
    altitude: float,
) -> Sight:
    """Rays from `altitude` through points at (row, col) and height, `zenith` rad off nadir there."""
    p = terrain.position(rowcol, height)
    up, _ = normal_and_height(p)
    east = np.stack([-up[:, 1], up[:, 0], np.zeros_like(zenith)], axis=-1)
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    north = np.cross(up, east)
    along = np.sin(azimuth)[:, None] * east + np.cos(azimuth)[:, None] * north
    direction = np.sin(zenith)[:, None] * along - np.cos(zenith)[:, None] * up
    target = _range_up_to(p, -direction, altitude)
    origin = p - target[:, None] * direction
    return Sight(origin, direction, target - _range_up_to(p, -direction, float(terrain.posts.max()) + 1.0), target)


def random_sights(terrain: TangentTerrain, count: int, *, seed: int, altitude: float = 15_000.0) -> Sight:
    """Rays 60-79 degrees off nadir to points drawn over the terrain; about a third hits other ground first."""
    rng = np.random.default_rng(seed)
    size = terrain.posts.shape[0]
    rowcol = rng.uniform(0.1 * size, 0.9 * size, (count, 2))
    height = terrain.surface(rowcol, np.floor(rowcol).astype(int))
    zenith = np.deg2rad(rng.uniform(60.0, 79.0, count))
    return sights(terrain, rowcol, height, zenith, rng.uniform(0.0, 2.0 * np.pi, count), altitude)


def grazing_sights(terrain: TangentTerrain, count: int, *, seed: int, altitude: float = 15_000.0) -> Sight:
    """Rays 60-79 degrees off nadir that enter one bilinear patch and leave it again: two crossings in a cell."""
    rng = np.random.default_rng(seed)
    size, z = terrain.posts.shape[0], terrain.posts
    tries = 4000 * count
    rowcol = rng.uniform(0.1 * size, 0.9 * size, (tries, 2))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, tries)
    (i, j), (u, v) = np.floor(rowcol).astype(int).T, (rowcol % 1.0).T
    per_row, per_col = -np.cos(azimuth) / terrain.spacing, np.sin(azimuth) / terrain.spacing
    twist = z[i + 1, j + 1] - z[i + 1, j] - z[i, j + 1] + z[i, j]
    slope = (z[i + 1, j] - z[i, j] + twist * v) * per_row + (z[i, j + 1] - z[i, j] + twist * u) * per_col
    bend = 2.0 * twist * per_row * per_col
    depression = np.arctan(-slope)
    room = np.minimum(np.minimum(u, 1.0 - u) / np.abs(per_row), np.minimum(v, 1.0 - v) / np.abs(per_col))
    sagitta = -0.5 * bend * room**2
    good = (np.rad2deg(depression) > 11.5) & (np.rad2deg(depression) < 29.5) & (sagitta > 1e-4)
    keep = np.flatnonzero(good)[:count]
    dip = sagitta[keep] * rng.uniform(0.02, 0.9, keep.size)
    height = terrain.surface(rowcol[keep], np.floor(rowcol[keep]).astype(int)) - dip
    return sights(terrain, rowcol[keep], height, 0.5 * np.pi - depression[keep], azimuth[keep], altitude)


def _range_up_to(p: np.ndarray, direction: np.ndarray, height: float) -> np.ndarray:
    """Range along rising rays to a height, by Newton."""
    distance = np.zeros(p.shape[0])
    for _ in range(8):
        normal, h = normal_and_height(p + distance[:, None] * direction)
        distance = distance + (height - h) / np.sum(normal * direction, axis=-1)
    return distance

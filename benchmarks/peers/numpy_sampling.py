"""Monte Carlo accuracy of one pixel's ground point as a careful NumPy user would write it, without jaxgeo.

A camera on a two-axis gimbal under an aircraft, errors of attitude, gimbal, boresight and mounting, and of the height
of an elevation model on a grid of latitude and longitude. Vectorised over chunks of samples: lines of sight by a chain
of rotations; steps of half a cell down from the highest post, with rays removed once they are below ground; and
bisection of the step in which they crossed it.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

Number: TypeAlias = float | np.ndarray
A, E2 = 6_378_137.0, 0.0066943799901413165  # WGS 84
B = A * np.sqrt(1.0 - E2)
CHUNK = 16_384  # the fastest of 4096 to 131,072
HALVINGS = 16  # of a step of about 40 m: to 0.6 mm, before a last step along the chord


class Scene(NamedTuple):
    """Scene geometry and standard deviations; angles in rad, lengths in m.

    `posts` of the terrain [row, col], `first` latitude and longitude, `step` of latitude by row and of longitude by
    column; `position` latitude, longitude, height; `attitude` heading, pitch, roll; `readings` outer and inner; `line`
    the pixel's direction in the camera. `sigma` are standard deviations of heading, pitch, roll, outer, inner,
    boresight heading, pitch, roll, mounting outer, inner, and the terrain's height.
    """

    posts: np.ndarray
    first: tuple[float, float]
    step: tuple[float, float]
    position: tuple[float, float, float]
    attitude: tuple[float, float, float]
    readings: tuple[float, float]
    line: np.ndarray
    sigma: np.ndarray


class Answer(NamedTuple):
    """Circular, linear and spherical error at 90 % in m; mean and covariance of the errors in east, north, up."""

    circular: float
    linear: float
    spherical: float
    mean: np.ndarray
    covariance: np.ndarray


def sampled(scene: Scene, count: int, rng: np.random.Generator) -> Answer:
    """Accuracy of the fix from `count` samples; samples without a fix count as infinitely far."""
    radii = np.empty((3, count))
    found, total, squares = 0, np.zeros(3), np.zeros((3, 3))
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        miss = misses(scene, rng.standard_normal((size, scene.sigma.size)))
        across, up = miss[:, 0] ** 2 + miss[:, 1] ** 2, miss[:, 2] ** 2
        three = np.sqrt(np.stack([across, up, across + up]))
        radii[:, first : first + size] = np.where(np.isnan(three), np.inf, three)
        known = miss[~np.isnan(across)]
        found += len(known)
        total += known.sum(axis=0)
        squares += known.T @ known
    mean, rank = total / found, int(np.ceil(0.9 * count)) - 1
    circular, linear, spherical = (float(np.partition(row, rank)[rank]) for row in radii)
    return Answer(circular, linear, spherical, mean, (squares - found * np.outer(mean, mean)) / (found - 1))


def misses(scene: Scene, normals: np.ndarray) -> np.ndarray:
    """Errors (n, 3) in east, north, up at the fix, m, for standard normal vectors (n, 11); NaN without a fix."""
    centre = first_hits(scene, *lines_of_sight(scene, np.zeros((1, scene.sigma.size))))[0]
    points = first_hits(scene, *lines_of_sight(scene, normals * scene.sigma))
    lat, lon, _ = geodetic(*centre)
    north, east, down = axes_ned(lat, lon).T
    return (points - centre) @ np.stack([east, north, -down], axis=1)


def lines_of_sight(scene: Scene, error: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(perspective centre in ECEF, directions (n, 3) in ECEF, errors of the terrain's height (n,))."""
    heading, pitch, roll, outer, inner, turn, nod, lean, mount_outer, mount_inner, height = error.T
    right, down, forward = scene.line  # a nadir camera, image top forward
    v = np.broadcast_to(np.array([-down, right, forward])[:, None], (3, len(error)))
    v = about_y(scene.readings[1] + inner + mount_inner, v)
    v = about_x(-(scene.readings[0] + outer) + mount_outer, v)
    v = about_z(turn, about_y(nod, about_x(lean, v)))
    v = about_x(scene.attitude[2] + roll, v)
    v = about_y(scene.attitude[1] + pitch, v)
    v = about_z(scene.attitude[0] + heading, v)
    lat, lon, above = scene.position
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    out = -axes_ned(lat, lon)[:, 2]
    return out * (np.array([N, N, N * (1.0 - E2)]) + above), (axes_ned(lat, lon) @ v).T, height


def about_x(angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]])


def about_y(angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[0] + s * v[2], v[1], c * v[2] - s * v[0]])


def about_z(angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])


def axes_ned(lat: Number, lon: Number) -> np.ndarray:
    """North, east and down in ECEF, as columns."""
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    down = [-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)]
    return np.array([north, [-np.sin(lon), np.cos(lon), 0.0], down]).T


def geodetic(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude and longitude in rad and height in m of ECEF points (Bowring 1976), exact to 1e-9 m at such heights."""
    across = np.sqrt(x * x + y * y)
    t = z * A / (across * B)
    c = 1.0 / np.sqrt(1.0 + t * t)
    up, out = z + E2 / (1.0 - E2) * B * (t * c) ** 3, across - E2 * A * c**3
    length = np.sqrt(up * up + out * out)
    sine, cosine = up / length, out / length
    return np.arctan2(up, out), np.arctan2(y, x), across * cosine + z * sine - A * np.sqrt(1.0 - E2 * sine * sine)


def clearance(scene: Scene, p: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Height in m of ECEF points (n, 3) above the bilinear surface through the posts; NaN outside it."""
    lat, lon, height = geodetic(p[:, 0], p[:, 1], p[:, 2])
    row, col = (lat - scene.first[0]) / scene.step[0], (lon - scene.first[1]) / scene.step[1]
    rows, cols = scene.posts.shape
    inside = (row >= 0.0) & (row <= rows - 1) & (col >= 0.0) & (col <= cols - 1)
    i, j = (np.clip(x.astype(np.int32), 0, n - 2) for x, n in ((row, rows), (col, cols)))
    r, c = row - i, col - j
    posts, place = scene.posts.ravel(), i * cols + j
    upper = posts[place] * (1.0 - c) + posts[place + 1] * c
    lower = posts[place + cols] * (1.0 - c) + posts[place + cols + 1] * c
    return np.where(inside, height - bias - (upper * (1.0 - r) + lower * r), np.nan)


def first_hits(scene: Scene, origin: np.ndarray, direction: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Points (n, 3) in ECEF where rays first go below ground; NaN if they leave the grid before."""
    reach = ranges_to_height(origin, direction, scene.posts.max() + bias)
    lat, _, _ = geodetic(*origin)
    cell = A * np.abs(scene.step) * [1.0, np.cos(lat)]
    step = 0.5 * cell.min()
    low, alive = np.full(len(direction), np.nan), np.arange(len(direction))
    way, raised = direction, bias
    while alive.size:
        reach = reach + step
        above = clearance(scene, origin + reach[:, None] * way, raised)
        low[alive[above < 0.0]] = reach[above < 0.0] - step
        onward = above >= 0.0
        if not onward.all():
            alive, reach, way, raised = alive[onward], reach[onward], way[onward], raised[onward]
    return origin + crossings(scene, origin, direction, bias, low, step)[:, None] * direction


def crossings(
    scene: Scene, origin: np.ndarray, direction: np.ndarray, bias: np.ndarray, low: np.ndarray, step: float
) -> np.ndarray:
    """Ground crossing ranges of rays that are above ground at `low` and below it one step later; NaN stays NaN."""
    found = ~np.isnan(low)
    way, raised, low = direction[found], bias[found], low[found]
    above = lambda reach: clearance(scene, origin + reach[:, None] * way, raised)  # noqa: E731
    high = low + step
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        under = above(middle) < 0.0
        low, high = np.where(under, low, middle), np.where(under, middle, high)
    first, last = above(low), above(high)
    reach = np.full(len(direction), np.nan)
    reach[found] = low + (high - low) * first / (first - last)
    return reach


def ranges_to_height(origin: np.ndarray, direction: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Ranges at which rays reach a height above the ellipsoid, by the secant method."""
    reach, step = np.zeros(len(direction)), 10.0
    for _ in range(5):
        p = origin + reach[:, None] * direction
        q = p + step * direction
        here, there = geodetic(*p.T)[2], geodetic(*q.T)[2]
        reach = reach + step * (height - here) / (there - here)
    return reach

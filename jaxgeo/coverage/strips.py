"""Strips of a flight side by side: their side overlap on the terrain, and the spacing for a wanted one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._arguments import check_terrain, checked_air
from jaxgeo._checks import check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import portable
from jaxgeo._typing import StatusCode
from jaxgeo.coverage._checks import SeesNoGround, checked_overlap
from jaxgeo.coverage._overlap import STATIONS, check_stations
from jaxgeo.coverage.exposure import (
    Image,
    checked_image,
    image_size,
    local_projection,
    on_map,
    platform_ecef,
    seen_at,
)
from jaxgeo.earth import Atmosphere, TransverseMercator
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.status import Status, counts_as_fix
from jaxgeo.terrain import AbstractTerrain

STRAIGHT = math.cos(math.radians(30.0))  # of the turn from which images are of another strip, and strips not parallel
SCANS = 1025  # lines across two strips at which they are compared
STANDING = 1e-3  # m between two platforms, below which there is no course
CLOSE = 1e-4  # tolerance of the side overlap of a spacing
ROUNDS = 40  # trial spacings at most

Points = Float[Any, "points 2"]


@portable
@dataclasses.dataclass(frozen=True)
class StripOutline:
    """Ground outlines of the images of a strip on one map: `rings`, each (4 n, 2) easting and northing in m, n points a
    side of the image, not closed; and the positions of the `platforms` (images, 2) there, in order of flight."""

    rings: tuple[np.ndarray, ...]
    platforms: np.ndarray
    projection: TransverseMercator

    @property
    def course(self) -> np.ndarray:
        """Unit vector (easting, northing) from the first platform to the last. Raises `ValueError` if they are one."""
        way = self.platforms[-1] - self.platforms[0]
        if not np.linalg.norm(way) > STANDING:
            raise ValueError("a strip needs two or more images from different positions, in order of flight.")
        return way / np.linalg.norm(way)


@portable
class SideOverlap(NamedTuple):
    """Side overlap of two strips at lines across them, at even distances over the length that they have in common.

    `share` (scans,) is their common width as a share of the wider of them there: negative is a gap between them, NaN
    where a strip has no image. `places` (scans, 2) are latitude and longitude in rad of the middle of the overlap, or
    gap; `images` (scans, 2) the index in each strip of the image whose platform is nearest along the flight.
    `spacing` is the distance in m between the middles of the strips across the flight.
    """

    share: np.ndarray
    places: np.ndarray
    images: np.ndarray
    spacing: float

    @property
    def least(self) -> float:
        """The smallest share."""
        return float(np.nanmin(self.share))

    @property
    def mean(self) -> float:
        """The mean share along the flight."""
        return float(np.nanmean(self.share))

    @property
    def where_least(self) -> int:
        """The line of the smallest share."""
        return int(np.nanargmin(self.share))

    @property
    def without_image(self) -> float:
        """Share of the common length at which a strip has no image, because of a gap along the flight."""
        return float(np.mean(np.isnan(self.share)))


@portable
class StripSpacing(NamedTuple):
    """The `spacing` in m of a strip and the next, and their side overlap on the terrain then."""

    spacing: float
    overlap: SideOverlap


def split_strips(images: Sequence[Image]) -> list[np.ndarray]:
    """Indices of the images of each strip of a flight: runs of two or more with one course, in the order given.

    A new one begins where the course turns by more than 30 deg from that of the strip. The longest runs are taken
    first: the way from the end of a strip to the next is none. Images in a turn are in none.
    """
    if len(images) < 2:
        return []
    projection = local_projection(images[0])
    places = np.array([np.asarray(place_on_map(image, projection)) for image in images])
    steps = np.diff(places, axis=0)
    runs: list[list[int]] = []  # numbers of steps
    for k, step in enumerate(steps):
        if runs and _is_straight(places[k] - places[runs[-1][0]], step):
            runs[-1].append(k)
        else:
            runs.append([k])
    taken = np.zeros(len(images), bool)
    strips = []
    for run in sorted(runs, key=len, reverse=True):
        own = np.array([k for k in range(run[0], run[-1] + 2) if not taken[k]], int)
        if len(own) >= 2 and np.linalg.norm(places[own[-1]] - places[own[0]]) > STANDING:
            taken[own] = True
            strips.append(own)
    return sorted(strips, key=lambda own: int(own[0]))


def _is_straight(way: np.ndarray, step: np.ndarray) -> bool:
    """Whether a step goes on in the direction of a way; so does one without a length."""
    lengths = np.linalg.norm(way) * np.linalg.norm(step)
    return bool(np.linalg.norm(step) <= STANDING or way @ step > STRAIGHT * lengths)


def strip_outline(
    sensors: Sensor | Sequence[Sensor],
    images: Sequence[Image],
    terrain: AbstractTerrain,
    *,
    stations: int = STATIONS,
    atmosphere: Atmosphere | None = None,
    projection: TransverseMercator | None = None,
) -> StripOutline:
    """Outlines of the images of a strip on the terrain, in order of flight, by `stations` points a side.

    `sensors` is one for all, or one for each. Between stations, also over ground hidden by a ridge, sides are straight.
    The map is `local_projection` of the first image unless given: give neighbouring strips the same one. Not
    traceable. Raises `SeesNoGround`, naming the image by its index, if a part of an outline sees none; `ValueError` for
    no images, or another number of sensors.
    """
    check_stations(stations)
    check_terrain(terrain, FIRST_HIT)
    air = checked_air(atmosphere)
    if not images:
        raise ValueError("a strip needs images; got none.")
    each = [sensors] * len(images) if isinstance(sensors, Sensor) else list(sensors)
    if len(each) != len(images):
        raise ValueError(f"sensors must be one, or one for each of {len(images)} images; got {len(each)}.")
    projection = local_projection(images[0]) if projection is None else projection
    rings, platforms = [], []
    for index, (own, image) in enumerate(zip(each, images, strict=True)):
        own, image = checked_image(own, image)
        places, platform, status = _ring(own, image, terrain, air, projection, stations)
        code = Status(int(status))
        if code != Status.hit:
            raise SeesNoGround(f"image {index} of the strip: {code.message}")
        rings.append(np.asarray(places))
        platforms.append(np.asarray(platform))
    return StripOutline(tuple(rings), np.array(platforms), projection)


@quick_filter_jit
def place_on_map(image: Image, projection: TransverseMercator) -> Float[Array, "2"]:
    """Easting and northing in m of the platform of an image on a map."""
    return on_map(projection, platform_ecef(image))


@quick_filter_jit
def _ring(
    sensor: Sensor,
    image: Image,
    terrain: AbstractTerrain,
    air: Atmosphere | None,
    projection: TransverseMercator,
    stations: int,
) -> tuple[Float[Array, "places 2"], Float[Array, "2"], StatusCode]:
    """(outline of an image on the map, its platform there, the first status of it without ground)."""
    width, height = image_size(sensor)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], float) - 0.5
    ways = np.roll(corners, -1, axis=0) - corners
    shares = np.linspace(0.0, 1.0, stations)[:-1]
    uv = (corners[:, None] + shares[None, :, None] * ways[:, None]).reshape(-1, 2)
    fix = seen_at(sensor, image, jnp.asarray(uv), terrain, air)
    outcome = jnp.where(counts_as_fix(fix.status), Status.hit.code, fix.status)
    places = jax.vmap(lambda p: on_map(projection, p))(fix.ecef)
    return places, on_map(projection, platform_ecef(image)), outcome[jnp.argmax(outcome != Status.hit)]


def are_parallel(one: StripOutline, other: StripOutline) -> bool:
    """Whether the courses of two strips are parallel to 30 deg, in one direction or against each other."""
    return bool(abs(one.course @ other.course) > STRAIGHT)


def side_overlap(one: StripOutline, other: StripOutline, *, scans: int = SCANS) -> SideOverlap:
    """Side overlap of two parallel strips on the terrain, at `scans` lines across the course of the first.

    At each line the width of a strip is that from the leftmost to the rightmost ground of any of its images there.
    Raises `ValueError` for fewer than two lines, strips on different maps, and strips that are not parallel or have no
    length in common.

    >>> from jaxgeo import coverage
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1000, height=1000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    >>> def strip(lon):
    ...     poses = [jaxgeo.Pose.from_degrees(lat=47.0 + 0.004 * k, lon=lon, height=1600.0) for k in range(3)]
    ...     return [jaxgeo.Shot(pose) for pose in poses]
    >>> at = {"projection": coverage.local_projection(strip(11.0)[0])}
    >>> ground = jaxgeo.ConstantHeight(600.0)
    >>> outlines = [coverage.strip_outline(sensor, strip(lon), ground, **at) for lon in (11.0, 11.008)]
    >>> found = coverage.side_overlap(*outlines)
    >>> print(f"{found.spacing:.0f} m apart: {found.least:.3f}")
    608 m apart: 0.391
    """
    if scans < 2:
        raise ValueError(f"scans must be at least 2; got {scans}.")
    if not eqx.tree_equal(one.projection, other.projection):
        raise ValueError("the strips are on different maps: give strip_outline the same projection for both.")
    if not are_parallel(one, other):
        turned = math.degrees(math.acos(min(abs(float(one.course @ other.course)), 1.0)))
        raise ValueError(f"the courses of the strips differ by {turned:.0f} deg; they must be parallel to 30 deg.")
    axes = np.stack([one.course, [one.course[1], -one.course[0]]], axis=1)  # along the course, and right of it
    origin = one.platforms[0]
    both = [[(ring - origin) @ axes for ring in strip.rings] for strip in (one, other)]
    (start, end), (other_start, other_end) = map(_length_of, both)
    start, end = max(start, other_start), min(end, other_end)
    if not end > start:
        raise ValueError(f"the strips have no length in common: {start - end:.0f} m of the flight are between them.")
    lines = np.linspace(start, end, scans)
    (left, right), (other_left, other_right) = (_extents(rings, lines) for rings in both)
    inner, outer = np.maximum(left, other_left), np.minimum(right, other_right)
    widest = np.maximum(right - left, other_right - other_left)
    known = np.isfinite(left) & np.isfinite(other_left)
    with np.errstate(invalid="ignore"):
        share = np.where(known, (outer - inner) / widest, np.nan)
        middle = np.stack([lines, np.where(known, 0.5 * (inner + outer), 0.0)], axis=-1)
    places = origin + middle @ axes.T
    lat, lon = _on_earth(one.projection, jnp.asarray(places))
    along = [(strip.platforms - origin) @ axes[:, 0] for strip in (one, other)]
    images = np.stack([np.argmin(np.abs(own[None] - lines[:, None]), axis=1) for own in along], axis=-1)
    across = [float(np.mean((strip.platforms - origin) @ axes[:, 1])) for strip in (one, other)]
    return SideOverlap(share, np.stack([lat, lon], axis=-1), images, abs(across[1] - across[0]))


@quick_filter_jit
def _on_earth(projection: TransverseMercator, places: Float[Array, "places 2"]) -> Any:
    return jax.vmap(lambda place: projection.inverse(place[0], place[1]))(places)


def _length_of(rings: Sequence[np.ndarray]) -> tuple[float, float]:
    """Range along the flight that rings (4 n, 2), along and across, cover in their whole width: from the last point of
    the trailing side of an image to the first of the leading one."""
    starts, ends = [], []
    for ring in rings:
        sides = ring[:, 0].reshape(4, -1)
        sides = np.concatenate([sides, np.roll(sides, -1, axis=0)[:, :1]], axis=1)
        order = np.argsort(sides.mean(axis=1))
        starts.append(sides[order[0]].max())
        ends.append(sides[order[-1]].min())
    return float(min(starts)), float(max(ends))


def _extents(rings: Sequence[np.ndarray], lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(leftmost, rightmost) distance across of rings (n, 2), along and across, at lines of a distance along; inf, -inf
    where there is none."""
    left, right = np.full(len(lines), np.inf), np.full(len(lines), -np.inf)
    for ring in rings:
        first, last = np.searchsorted(lines, [ring[:, 0].min(), ring[:, 0].max()], side="left")
        own = lines[first : last + 1][None]
        (along, across), (next_along, next_across) = ring.T[:, :, None], np.roll(ring, -1, axis=0).T[:, :, None]
        length = next_along - along
        with np.errstate(divide="ignore", invalid="ignore"):
            part = (own - along) / length
        meets = (length != 0.0) & (part >= 0.0) & (part <= 1.0)
        at = across + np.where(meets, part, 0.0) * (next_across - across)
        left[first : last + 1] = np.minimum(left[first : last + 1], np.where(meets, at, np.inf).min(axis=0))
        right[first : last + 1] = np.maximum(right[first : last + 1], np.where(meets, at, -np.inf).max(axis=0))
    return left, right


def neighbouring_strips(strips: Sequence[StripOutline]) -> list[tuple[int, int]]:
    """Pairs of neighbouring strips by their indices, the lower one first: parallel ones with a length in common,
    between which no other lies there.

    All must be on one map. Strips across the others, as control strips are, pair with those parallel to them.
    """
    found: list[tuple[int, int]] = []
    left_over = sorted(range(len(strips)), key=lambda k: -float(np.linalg.norm(np.ptp(strips[k].platforms, axis=0))))
    while left_over:
        group = [k for k in left_over if are_parallel(strips[left_over[0]], strips[k])]
        found += _side_by_side([(k, strips[k]) for k in group], strips[left_over[0]].course)
        left_over = [k for k in left_over if k not in group]
    return sorted(found)


def _side_by_side(group: Sequence[tuple[int, StripOutline]], course: np.ndarray) -> list[tuple[int, int]]:
    right = np.array([course[1], -course[0]])
    across = {k: float(np.mean(strip.platforms @ right)) for k, strip in group}
    axes = np.stack([course, right], axis=1)
    ranges = {k: _length_of([ring @ axes for ring in strip.rings]) for k, strip in group}
    pairs = []
    for k, _ in sorted(group, key=lambda one: across[one[0]]):
        start, end = ranges[k]
        lines = np.linspace(start, end, SCANS)
        free = np.ones(SCANS, bool)
        for other in sorted((o for o in across if across[o] > across[k]), key=across.__getitem__):
            own = free & (lines >= ranges[other][0]) & (lines <= ranges[other][1])
            if own.any() and ranges[other][0] < end and ranges[other][1] > start:
                pairs.append((min(k, other), max(k, other)))
                free &= ~own
    return pairs


def strip_spacing(
    sensor: Sensor,
    shots: Sequence[Shot],
    terrain: AbstractTerrain,
    overlap: float,
    *,
    side: Literal["left", "right"] = "right",
    stations: int = STATIONS,
    scans: int = SCANS,
    atmosphere: Atmosphere | None = None,
    progress: Callable[[int], object] | None = None,
) -> StripSpacing:
    """Distance to the next strip at which the least side overlap on the terrain is the wanted `overlap`, a share.

    The next strip has the same shots, displaced across the course to a `side` of it at their heights and attitudes. The
    spacing is found to 1e-4 of the overlap by false position from 0 m; over terrain, where the overlap may grow again
    farther off, it is the first such one of the trials. `progress` is called with the number of trials. Raises
    `ValueError` for an overlap outside [0, 1) and shots of one position; `SeesNoGround` as `strip_outline`.
    """
    wanted = float(checked_overlap(overlap))
    if side not in ("left", "right"):
        raise ValueError(f'side must be "left" or "right" of the course; got {side!r}.')
    for one in shots:
        check_is(one, Shot, "shots", "Those of a trajectory: [trajectory.at(time) for time in times].")
    how: dict[str, Any] = {"stations": stations, "atmosphere": atmosphere}
    first = strip_outline(sensor, shots, terrain, **how)
    how["projection"] = first.projection
    turned = np.array([first.course[1], -first.course[0]]) * (1.0 if side == "right" else -1.0)
    trials: list[tuple[float, SideOverlap]] = []

    def at(spacing: float) -> float:
        """How far the overlap at a spacing is above the wanted one."""
        displaced = [_displaced(one, first.projection, jnp.asarray(spacing * turned)) for one in shots]
        found = side_overlap(first, strip_outline(sensor, displaced, terrain, **how), scans=scans)
        trials.append((spacing, found))
        if progress is not None:
            progress(len(trials))
        return found.least - wanted

    return StripSpacing(*_first_short(at, trials, _width(first), wanted))


def _width(strip: StripOutline) -> float:
    """Mean width of the images of a strip across its course, m."""
    right = np.array([strip.course[1], -strip.course[0]])
    return float(np.mean([np.ptp(ring @ right) for ring in strip.rings]))


def _first_short(
    at: Callable[[float], float], trials: list[tuple[float, SideOverlap]], width: float, wanted: float
) -> tuple[float, SideOverlap]:
    """The trial with the largest spacing of which the overlap is at least the wanted one, to `CLOSE`: by false position
    (Illinois), from a bracket that is enlarged until the overlap is too small."""
    low, above = 0.0, 1.0 - wanted
    high = (1.0 - wanted) * width
    while (below := at(high)) >= 0.0 and len(trials) < ROUNDS:
        low, above, high = high, below, 1.3 * high
    best = trials[-2] if len(trials) > 1 else None
    side = 0
    while len(trials) < ROUNDS and not (best is not None and 0.0 <= best[1].least - wanted <= CLOSE):
        middle = low + (high - low) * above / (above - below) if above > below else 0.5 * (low + high)
        middle = min(max(middle, low + 1e-3 * (high - low)), high - 1e-3 * (high - low))
        found = at(middle)
        if found >= 0.0:
            low, above, best = middle, found, trials[-1]
            below = 0.5 * below if side == 1 else below
            side = 1
        else:
            high, below = middle, found
            above = 0.5 * above if side == -1 else above
            side = -1
    if best is None:
        raise ValueError(f"no spacing above 0 m has a side overlap of {wanted:g} on this terrain; ask for less.")
    return best


@quick_filter_jit
def _displaced(shot: Shot, projection: TransverseMercator, way: Float[Array, "2"]) -> Shot:
    """A shot displaced on the map, at its height."""
    position = shot.pose.position
    easting, northing = projection.forward(position.lat, position.lon)
    lat, lon = projection.inverse(easting + way[0], northing + way[1])
    place: Any = lambda one: (one.pose.position.lat, one.pose.position.lon)  # noqa: E731
    return eqx.tree_at(place, shot, (lat, lon))

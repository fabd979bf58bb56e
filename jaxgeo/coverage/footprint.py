"""The ground outline of an image, and how fine the image is there."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._arguments import check_terrain, checked_air, checked_observation
from jaxgeo._checks import as_array, check_finite
from jaxgeo._numerics import dot, safe_angle, safe_norm
from jaxgeo._record import Record
from jaxgeo._typing import FlagField, PixelField, Scalar, ScalarField, StatusField, Vector3
from jaxgeo.coverage.exposure import Image, checked_image, image_size, local_projection, motion_of, on_map, seen_at
from jaxgeo.earth import WGS84, Atmosphere, TransverseMercator
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT, located_anywhere
from jaxgeo.sensor import Sensor
from jaxgeo.sensor.camera import Numbers
from jaxgeo.status import Status, counts_as_fix
from jaxgeo.terrain import AbstractTerrain

PLACES = 64  # to begin with, on each side of an image
FINEST = 2.0**-14  # px between neighbours, at which a jump of the outline is a jump
UNEVEN = 0.1  # of a stretch of the outline: what is in its middle in the image may lie so near to an end, no nearer
PLUMB = 1e-9  # rad off the vertical, within which rounding would say where a line of sight leans
SMOOTH = 10.0  # times what a step of the image is on the far ground: a gap beyond is a jump
MOST = 500_000  # places of one outline
BATCH = 256  # places that are located at a time, so that every outline runs what is compiled for one


class Footprint(Record):
    """The ground outline of an image.

    `uv` (n, 2) are places on the image's outer edge in px, from its upper left corner clockwise in the image, the ring
    not closed; `fix` what each sees, n of each number; `hidden` (n,) whether between a place and the next the outline
    jumps over ground that nearer ground hides. `outline` (n, 2) are the places on a map, `projection`, (easting,
    northing) in m, NaN where nothing is seen. `status` of the whole is `hit` if all places see ground; otherwise
    `crosses_horizon`, or why the first place does not.
    """

    uv: PixelField
    fix: Fix
    hidden: FlagField
    outline: PixelField
    status: StatusField
    projection: TransverseMercator

    @property
    def ok(self) -> bool:
        """Whether the whole edge of the image sees ground."""
        return int(self.status) == Status.hit

    @property
    def found(self) -> np.ndarray:
        """Which places see ground, (n,)."""
        return _seen(self.fix)

    @property
    def area(self) -> float:
        """Area in m2 within the outline, on the map; hidden ground counts. NaN if the outline is not whole."""
        x, y = (np.asarray(self.outline) - np.asarray(self.outline)[0]).T  # of millions of m, products lose digits
        twice = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        return 0.5 * abs(float(twice)) if self.ok else math.nan

    @property
    def hidden_length(self) -> float:
        """Length in m on the map of the parts of the outline that jump over hidden ground."""
        here = np.asarray(self.outline)
        steps = np.linalg.norm(np.roll(here, -1, axis=0) - here, axis=1)
        return float(np.sum(steps[np.asarray(self.hidden)]))


class GroundSampleDistance(Record):
    """How large a pixel is on the ground, m: along the image's `columns` axis (from a column to the next), along its
    `rows` axis, `along` the line of sight and `across` it, all on the surface; and its `area` there, m2.

    `along` and `across` are the length by which the ground in that direction moves the image by one pixel. NaN where
    the fix (`fix`) has no derivative.
    """

    columns: ScalarField
    rows: ScalarField
    along: ScalarField
    across: ScalarField
    area: ScalarField
    fix: Fix


def footprint(
    sensor: Sensor,
    image: Image,
    terrain: AbstractTerrain,
    *,
    tolerance: float = 1.0,
    places: int = PLACES,
    atmosphere: Atmosphere | None = None,
    projection: TransverseMercator | None = None,
) -> Footprint:
    """The outline of what an image sees: its outer edge, put on the ground as densely as `tolerance` m asks.

    `image` is a `Shot`, or an `Exposure` of a trajectory. Each side starts with `places`; between two of them others
    are put in until the one in the middle lies within `tolerance` of the straight line through its neighbours (in
    space, heights included) and not at one end of it, and until ground that begins or ends to be seen, or that a ridge
    hides, is known to a ten thousandth of a pixel. What is finer than the first places may be overlooked.
    Not for tracing: how many places there are is found by looking. Raises `ValueError` for a tolerance or a number of
    places that is not positive; what sees no ground has its status.

    >>> from jaxgeo import coverage
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1000, height=500)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    >>> shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1600.0))
    >>> seen = coverage.footprint(sensor, shot, jaxgeo.ConstantHeight(600.0))
    >>> print(f"{np.ptp(seen.outline[:, 0]):.0f} m by {np.ptp(seen.outline[:, 1]):.0f} m")
    1000 m by 500 m
    """
    sensor, image = checked_image(sensor, image)
    check_terrain(terrain, FIRST_HIT)
    air = checked_air(atmosphere)
    check_finite(tolerance, "tolerance", "m")
    if not tolerance > 0.0 or places < 1:
        raise ValueError(f"tolerance (m) and places must be positive; got {tolerance} and {places}.")
    width, height = image_size(sensor)
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    steps = np.linspace(0.0, 1.0, places, endpoint=False)[:, None]
    sides = [a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    uv = np.concatenate(sides)
    projection = local_projection(image) if projection is None else projection
    looked = Looked(sensor, image, terrain, air, projection)
    ring = _Ring(uv, *_located(looked, uv), np.zeros(len(uv), bool))
    while not ring.settled.all():
        if len(ring.uv) > MOST:
            raise ValueError(f"a tolerance of {tolerance:g} m asks for more than {MOST:,} places: take a larger one.")
        ring = _denser(looked, ring, tolerance)
    return Footprint(
        uv=ring.uv,
        fix=ring.fix,
        hidden=_jumps(sensor, ring, tolerance),
        outline=ring.outline,
        status=np.asarray(_whole(ring.fix), np.int8),
        projection=projection,
    )


def ground_sample_distance(
    sensor: Sensor,
    image: Image,
    uv: Numbers,
    terrain: AbstractTerrain,
    *,
    atmosphere: Atmosphere | None = None,
) -> GroundSampleDistance:
    """How large the pixel at `uv` = (column, row) is on the ground; for many pixels use `jax.vmap`.

    From the derivative of the fix by the pixel, so on the slope that is there. Raises as `locate`.
    """
    sensor, image = checked_image(sensor, image)
    motion, time = motion_of(image)
    air = checked_air(atmosphere)
    check_terrain(terrain, FIRST_HIT)
    seen_from = checked_observation(sensor, motion, time, as_array(uv, "uv"))
    return _ground_sampling(*seen_from, terrain, air)


@eqx.filter_jit
def _ground_sampling(
    sensor: Sensor, motion: Any, time: Scalar, uv: PixelField, terrain: AbstractTerrain, air: Atmosphere | None
) -> GroundSampleDistance:
    def seen(uv: PixelField) -> tuple[Vector3, tuple[Fix, Vector3]]:
        fix, _ = located_anywhere(sensor, motion, time, uv, terrain, FIRST_HIT, air)
        return fix.ecef, (fix, fix.ecef)

    J, (fix, p_ecef) = jax.jacfwd(seen, has_aux=True)(uv)
    by_column, by_row = J.T
    normal = jnp.cross(by_column, by_row)
    area = safe_norm(normal)
    up, _ = WGS84.normal_and_height(p_ecef)
    shot = motion if not hasattr(motion, "at") else motion.at(time)
    away = p_ecef - sensor.perspective_centre(shot)
    # What moves along the look on the surface: the level direction of the look, taken up or down onto the slope.
    surface = normal / jnp.where(area > 0.0, area, 1.0)
    level = away - dot(away, up) * up
    is_plumb = dot(level, level) <= PLUMB**2 * dot(away, away)
    level = jnp.where(is_plumb, -by_row, level)  # straight down, ahead is where the image has its upper side
    along = level - up * dot(level, surface) / jnp.where(dot(up, surface) == 0.0, 1.0, dot(up, surface))
    along = along / jnp.maximum(safe_norm(along), 1e-300)
    across = jnp.cross(surface, along)
    known = counts_as_fix(fix.status)
    lengths = [safe_norm(by_column), safe_norm(by_row), *(_length_of_a_pixel(J, d) for d in (along, across)), area]
    columns, rows, *others = (jnp.where(known, length, jnp.nan) for length in lengths)
    return GroundSampleDistance(columns, rows, *others, fix=fix)


def _length_of_a_pixel(J: Float[Array, "3 2"], direction: Vector3) -> Scalar:
    """m on the ground in a direction of its surface that move the image by one pixel."""
    (a, b), (_, d) = J.T @ J
    v = J.T @ direction
    det = a * d - b * b
    det = jnp.where(det > 0.0, det, 1.0)
    moved = jnp.stack([d * v[0] - b * v[1], a * v[1] - b * v[0]]) / det
    return 1.0 / jnp.maximum(safe_norm(moved), 1e-300)


class Looked(NamedTuple):
    """Who looks at what, through what, and on which map it is put."""

    sensor: Sensor
    image: Image
    terrain: AbstractTerrain
    air: Atmosphere | None
    projection: TransverseMercator


class _Ring(NamedTuple):
    """An outline that is being made: `settled` says whether the way from a place to the next is known."""

    uv: np.ndarray
    fix: Fix
    outline: np.ndarray
    settled: np.ndarray


def _denser(looked: Looked, ring: _Ring, tolerance: float) -> _Ring:
    """With the middle put in between places and the next where the line between them is not known to be straight."""
    asked = np.flatnonzero(~ring.settled)
    after = (asked + 1) % len(ring.uv)
    middles = 0.5 * (ring.uv[asked] + ring.uv[after])
    between, on_map = _located(looked, middles)
    here, there = (_taken(ring.fix, index) for index in (asked, after))
    seen = [_seen(fix) for fix in (here, there, between)]
    off, share = _off_line(here.ecef, there.ecef, between.ecef)
    # A jump is straight too, along a line of sight; but then the middle lies at one of its ends.
    even = (np.abs(share - 0.5) <= 0.5 - UNEVEN) | (np.linalg.norm(there.ecef - here.ecef, axis=1) <= tolerance)
    straight = (seen[0] == seen[1]) & (seen[0] == seen[2]) & (~seen[0] | ((off <= tolerance) & even))
    finest = np.max(np.abs(ring.uv[after] - ring.uv[asked]), axis=1) <= 2.0 * FINEST
    settled = ring.settled.copy()
    settled[asked] = straight | finest
    # Both halves of what is not straight are asked again; the middles stay, as they are known now.
    put = lambda old, new: np.insert(old, asked + 1, new, axis=0)  # noqa: E731
    return _Ring(
        put(ring.uv, middles),
        jax.tree.map(put, ring.fix, between),
        put(ring.outline, on_map),
        put(settled, straight | finest),
    )


def _located(looked: Looked, uv: np.ndarray) -> tuple[Fix, np.ndarray]:
    """What places (n, 2) see, and that on the map (n, 2), as NumPy arrays; in batches of one size."""
    parts = []
    for first in range(0, len(uv), BATCH):
        here = uv[np.minimum(np.arange(first, first + BATCH), len(uv) - 1)]
        found = _seen_and_mapped(looked, jnp.asarray(here))
        parts.append(jax.tree.map(lambda x, count=min(BATCH, len(uv) - first): np.asarray(x)[:count], found))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


@eqx.filter_jit
def _seen_and_mapped(looked: Looked, uv: Float[Array, "places 2"]) -> tuple[Fix, Float[Array, "places 2"]]:
    fix = seen_at(looked.sensor, looked.image, uv, looked.terrain, looked.air)
    return fix, jax.vmap(lambda p: on_map(looked.projection, p))(fix.ecef)


def _seen(fix: Fix) -> np.ndarray:
    """Whether each of a batch of fixes is ground."""
    status = np.asarray(fix.status)
    return (status == Status.hit) | (status == Status.near_tangent)


def _apart(fix: Fix) -> np.ndarray:
    """m between what a place sees and what the next does; NaN where one sees nothing."""
    return np.linalg.norm(np.roll(fix.ecef, -1, axis=0) - fix.ecef, axis=1)


def _taken(fix: Fix, index: np.ndarray) -> Any:
    return jax.tree.map(lambda x: x[index], fix)


def _off_line(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """m from points to the stretches from a to b, and at which share of those from 0 to 1 they are nearest."""
    along, to = b - a, p - a
    squared = np.sum(along**2, axis=1)
    share = np.clip(np.sum(along * to, axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return np.linalg.norm(to - share[:, None] * along, axis=1), share


def _jumps(sensor: Sensor, ring: _Ring, tolerance: float) -> np.ndarray:
    """Whether places as close as may be still see ground far apart: farther than the far ground's own slope explains,
    as close to the horizon it does."""
    uv, fix, seen = ring.uv, ring.fix, _seen(ring.fix)
    after = np.roll(uv, -1, axis=0)
    close = np.max(np.abs(after - uv), axis=1) <= FINEST
    apart, following = _apart(fix), _taken(fix, np.arange(1, len(uv) + 1) % len(uv))
    turn = np.zeros(len(uv))
    for first in range(0, np.count_nonzero(close), BATCH):
        index = np.flatnonzero(close)[first : first + BATCH]
        lanes = index[np.minimum(np.arange(BATCH), len(index) - 1)]
        turn[index] = np.asarray(_turns(sensor, jnp.asarray(uv[lanes]), jnp.asarray(after[lanes])))[: len(index)]
    far = following.slant_range > fix.slant_range
    reach, incidence = (
        np.where(far, getattr(following, name), getattr(fix, name)) for name in ("slant_range", "incidence_surface")
    )
    with np.errstate(invalid="ignore"):
        smooth = SMOOTH * reach * turn / np.maximum(np.cos(incidence), 1e-6)
        return close & seen & np.roll(seen, -1) & (apart > np.maximum(tolerance, smooth))


@eqx.filter_jit
def _turns(sensor: Sensor, uv: Float[Array, "places 2"], after: Float[Array, "places 2"]) -> Float[Array, " places"]:
    """Angles in rad between what places and the next look at."""
    ray = lambda place: sensor.camera.ray(place)[0]  # noqa: E731
    return jax.vmap(lambda a, b: safe_angle(ray(a), ray(b)))(uv, after)


def _whole(fix: Fix) -> int:
    """Status of an outline."""
    statuses = np.asarray(fix.status)
    wrong = statuses[~_seen(fix)]
    if not wrong.size:
        return int(Status.hit)
    return int(Status.crosses_horizon if np.any(wrong == Status.rises_away) else wrong[0])

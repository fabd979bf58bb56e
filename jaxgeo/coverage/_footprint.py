"""Ground outline of an image, and its ground sample distance."""

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
from jaxgeo._compile import batch_filter_jit, quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._locate import located_anywhere
from jaxgeo._numerics import dot, larger, safe_angle, safe_norm
from jaxgeo._record import Record
from jaxgeo._typing import FlagField, PixelField, Scalar, ScalarField, StatusField, Vector3
from jaxgeo.coverage.exposure import Image, checked_image, image_size, local_projection, motion_of, on_map, seen_at
from jaxgeo.earth import WGS84, Atmosphere, TransverseMercator
from jaxgeo.fix import Fix
from jaxgeo.sensor import Sensor
from jaxgeo.sensor.camera import Numbers
from jaxgeo.status import Status, counts_as_fix
from jaxgeo.terrain import AbstractTerrain

PLACES = 64  # initial points per image side
FINEST = 2.0**-14  # px between neighbours at which a jump of the outline is accepted
UNEVEN = 0.1  # of an outline segment: closest distance of its image midpoint to an end
PLUMB = 1e-9  # rad off the vertical, within which the azimuth of a line of sight is rounding
SMOOTH = 10.0  # factor on the image step projected to the far ground: a larger gap is a jump
MOST = 500_000  # points of one outline
BATCH = 256  # points located at a time, so that every outline uses the same compiled program


class Footprint(Record):
    """The ground outline of an image.

    `uv` (n, 2) are points on the image's outer edge in px, from its upper left corner clockwise in the image, the ring
    not closed; `fix` holds their n fixes; `hidden` (n,) states whether the outline jumps from a point to the next over
    ground hidden by nearer ground. `outline` (n, 2) are the points on a map, `projection`, (easting, northing) in m,
    NaN where no ground is seen. The overall `status` is `hit` if all points see ground; otherwise `crosses_horizon`,
    or the status of the first point without ground.
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
        """Which points see ground, (n,)."""
        return sees_ground(self.fix)

    @property
    def area(self) -> float:
        """Area in m2 within the outline, on the map, hidden ground included. NaN if the outline is not complete."""
        x, y = (np.asarray(self.outline) - np.asarray(self.outline)[0]).T  # products of millions of m lose digits
        twice = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        return 0.5 * abs(float(twice)) if self.ok else math.nan

    @property
    def hidden_length(self) -> float:
        """Length in m on the map of the outline's jumps over hidden ground."""
        here = np.asarray(self.outline)
        steps = np.linalg.norm(np.roll(here, -1, axis=0) - here, axis=1)
        return float(np.sum(steps[np.asarray(self.hidden)]))


class GroundSampleDistance(Record):
    """Size of a pixel on the ground, m: along the image's `columns` axis (from a column to the next), along its `rows`
    axis, `along` the line of sight and `across` it, all on the surface; and its `area` there, m2.

    `along` and `across` are ground lengths in these directions that move the image by one pixel. NaN where the fix
    (`fix`) has no derivative.
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
    """Ground outline of an image: its outer edge located on the terrain, to a `tolerance` in m.

    `image` is a `Shot`, or an `Exposure` of a trajectory. Each side starts with `places` points. Midpoints are inserted
    until each is within `tolerance` of the line through its neighbours (in space, heights included) and not at one end
    of it, and until every start or end of visible ground, and every ridge that hides ground, is located to a ten
    thousandth of a pixel. Details finer than the first points may be missed.
    Not traceable: the number of points depends on the values. Raises `ValueError` for a tolerance or a number of
    points that is not positive; points without ground have their status.

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
    ring = _Ring(uv, *located_points(looked, uv), np.zeros(len(uv), bool))
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
    """Size on the ground of the pixel at `uv` = (column, row); for many pixels use `jax.vmap`.

    From the derivative of the fix by the pixel, so it includes the slope of the ground. Raises as `locate`.
    """
    sensor, image = checked_image(sensor, image)
    motion, time = motion_of(image)
    air = checked_air(atmosphere)
    check_terrain(terrain, FIRST_HIT)
    seen_from = checked_observation(sensor, motion, time, as_array(uv, "uv"))
    return _ground_sampling(*seen_from, terrain, air)


@quick_filter_jit
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
    # Direction on the surface along the line of sight: its horizontal direction, projected vertically onto the slope.
    surface = normal / jnp.where(area > 0.0, area, 1.0)
    level = away - dot(away, up) * up
    is_plumb = dot(level, level) <= PLUMB**2 * dot(away, away)
    level = jnp.where(is_plumb, -by_row, level)  # straight down, forward is the top of the image
    along = level - up * dot(level, surface) / jnp.where(dot(up, surface) == 0.0, 1.0, dot(up, surface))
    along = along / larger(safe_norm(along), 1e-300)
    across = jnp.cross(surface, along)
    known = counts_as_fix(fix.status)
    lengths = [safe_norm(by_column), safe_norm(by_row), *(_length_of_a_pixel(J, d) for d in (along, across)), area]
    columns, rows, *others = (jnp.where(known, length, jnp.nan) for length in lengths)
    return GroundSampleDistance(columns, rows, *others, fix=fix)


def _length_of_a_pixel(J: Float[Array, "3 2"], direction: Vector3) -> Scalar:
    """Length in m on the ground, in a direction along its surface, that moves the image by one pixel."""
    (a, b), (_, d) = J.T @ J
    v = J.T @ direction
    det = a * d - b * b
    det = jnp.where(det > 0.0, det, 1.0)
    moved = jnp.stack([d * v[0] - b * v[1], a * v[1] - b * v[0]]) / det
    return 1.0 / larger(safe_norm(moved), 1e-300)


class Looked(NamedTuple):
    """Inputs of an outline: sensor, image, terrain, atmosphere and map."""

    sensor: Sensor
    image: Image
    terrain: AbstractTerrain
    air: Atmosphere | None
    projection: TransverseMercator


class _Ring(NamedTuple):
    """An outline under refinement; `settled` states whether the segment from a point to the next is finished."""

    uv: np.ndarray
    fix: Fix
    outline: np.ndarray
    settled: np.ndarray


def _denser(looked: Looked, ring: _Ring, tolerance: float) -> _Ring:
    """The outline with midpoints inserted into segments not known to be straight."""
    asked = np.flatnonzero(~ring.settled)
    after = (asked + 1) % len(ring.uv)
    middles = 0.5 * (ring.uv[asked] + ring.uv[after])
    between, on_map = located_points(looked, middles)
    here, there = (_taken(ring.fix, index) for index in (asked, after))
    seen = [sees_ground(fix) for fix in (here, there, between)]
    off, share = _off_line(here.ecef, there.ecef, between.ecef)
    # A jump is straight too, along a line of sight; but then the midpoint is at one of its ends.
    even = (np.abs(share - 0.5) <= 0.5 - UNEVEN) | (np.linalg.norm(there.ecef - here.ecef, axis=1) <= tolerance)
    straight = (seen[0] == seen[1]) & (seen[0] == seen[2]) & (~seen[0] | ((off <= tolerance) & even))
    finest = np.max(np.abs(ring.uv[after] - ring.uv[asked]), axis=1) <= 2.0 * FINEST
    settled = ring.settled.copy()
    settled[asked] = straight | finest
    # Both halves of a segment that is not straight are tested again; their midpoints are known now and stay.
    put = lambda old, new: np.insert(old, asked + 1, new, axis=0)  # noqa: E731
    return _Ring(
        put(ring.uv, middles),
        jax.tree.map(put, ring.fix, between),
        put(ring.outline, on_map),
        put(settled, straight | finest),
    )


def located_points(looked: Looked, uv: np.ndarray) -> tuple[Fix, np.ndarray]:
    """Fixes of points (n, 2), and their map coordinates (n, 2), as NumPy arrays; in batches of one size."""
    parts = []
    for first in range(0, len(uv), BATCH):
        here = uv[np.minimum(np.arange(first, first + BATCH), len(uv) - 1)]
        fix = seen_at(looked.sensor, looked.image, jnp.asarray(here), looked.terrain, looked.air)
        found = fix, _mapped(looked.projection, fix.ecef)
        parts.append(jax.tree.map(lambda x, count=min(BATCH, len(uv) - first): np.asarray(x)[:count], found))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


@batch_filter_jit
def _mapped(projection: TransverseMercator, p_ecef: Float[Array, "places 3"]) -> Float[Array, "places 2"]:
    return jax.vmap(lambda p: on_map(projection, p))(p_ecef)


def sees_ground(fix: Fix) -> np.ndarray:
    """Whether each fix of a batch is on the ground."""
    status = np.asarray(fix.status)
    return (status == Status.hit) | (status == Status.near_tangent)


def _apart(fix: Fix) -> np.ndarray:
    """Distance in m between the fixes of a point and the next; NaN if one sees no ground."""
    return np.linalg.norm(np.roll(fix.ecef, -1, axis=0) - fix.ecef, axis=1)


def _taken(fix: Fix, index: np.ndarray) -> Any:
    return jax.tree.map(lambda x: x[index], fix)


def _off_line(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance in m from points to the segments from a to b, and the share (0 to 1) of the nearest segment point."""
    along, to = b - a, p - a
    squared = np.sum(along**2, axis=1)
    share = np.clip(np.sum(along * to, axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return np.linalg.norm(to - share[:, None] * along, axis=1), share


def _jumps(sensor: Sensor, ring: _Ring, tolerance: float) -> np.ndarray:
    """Whether points at the finest spacing still see ground far apart: farther than the slope of the far ground
    explains, as it does close to the horizon."""
    uv, fix, seen = ring.uv, ring.fix, sees_ground(ring.fix)
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
    """Angles in rad between the rays of points and the next ones."""
    ray = lambda place: sensor.camera.ray(place)[0]  # noqa: E731
    return jax.vmap(lambda a, b: safe_angle(ray(a), ray(b)))(uv, after)


def _whole(fix: Fix) -> int:
    """Status of an outline."""
    statuses = np.asarray(fix.status)
    wrong = statuses[~sees_ground(fix)]
    if not wrong.size:
        return int(Status.hit)
    return int(Status.crosses_horizon if np.any(wrong == Status.rises_away) else wrong[0])

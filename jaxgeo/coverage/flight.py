"""Simulated flight of an image strip: planned line, flight noise and its compensation."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._arguments import check_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_float64, check_is, check_range
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._numerics import cross, matvec, safe_norm
from jaxgeo._record import Record, has_numbers, range_text
from jaxgeo._typing import FlagField, Scalar, ScalarField, Vector3
from jaxgeo.coverage._checks import SeesNoGround, checked_finite, checked_overlap, checked_positive
from jaxgeo.coverage._overlap import (
    GroundEdges,
    Overlap,
    axis_along,
    check_along,
    check_stations,
    edges_on_map,
    ground_edges,
    shared,
)
from jaxgeo.coverage.exposure import Along, near_edge, near_length
from jaxgeo.earth import WGS84, Atmosphere, Geodetic, R_ecef_from_ned, TransverseMercator
from jaxgeo.sensor import Pose, Sensor, Shot
from jaxgeo.sensor.aiming import aim
from jaxgeo.sensor.line_of_sight import LineOfSight
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, ConstantHeight

SPECS = ("heading", "pitch", "roll", "height", "across", "speed", "gimbal", "timing")
STATIONS = 9
Normals = Float[Array, " normals"]


class FlightNoise(Record):
    """Flight and camera noise: standard deviations and correlation times.

    `heading`, `pitch`, `roll` in rad, `height` and `across` (the track's offset to the right) in m, `speed` over the
    ground in m/s: each a first-order Gauss-Markov process about the plan, whose correlation falls to 1/e within
    `lasting` s (one number, or one for each of the six in this order). `gimbal`: control error of each axis in rad of
    its reading; `timing`: error of the exposure time, s; both are independent for every image.
    """

    heading: ScalarField
    pitch: ScalarField
    roll: ScalarField
    height: ScalarField
    across: ScalarField
    speed: ScalarField
    gimbal: ScalarField
    timing: ScalarField
    lasting: Float[Array, "6"]

    @classmethod
    def from_degrees(
        cls,
        *,
        heading: ArrayLike = 0.0,
        pitch: ArrayLike = 0.0,
        roll: ArrayLike = 0.0,
        height: ArrayLike = 0.0,
        across: ArrayLike = 0.0,
        speed: ArrayLike = 0.0,
        gimbal: ArrayLike = 0.0,
        timing: ArrayLike = 0.0,
        lasting: Any = 10.0,
    ) -> FlightNoise:
        """Noise from angles in deg, lengths in m, speed in m/s and times in s.

        Raises `ValueError` for a standard deviation that is negative or not finite, or a time that is not positive.
        """
        given = dict(zip(SPECS, (heading, pitch, roll, height, across, speed, gimbal, timing), strict=True))
        for name, value in given.items():
            check_range(value, name, "(a standard deviation)", 0.0, 1e9)
            if np.shape(value) != ():
                raise ValueError(f"{name} must be one number, a standard deviation; got shape {np.shape(value)}.")
        checked_positive(lasting, "lasting", "s")
        values: Any = as_float64(given, "FlightNoise.from_degrees")
        angles = {name: jnp.deg2rad(values[name]) for name in ("heading", "pitch", "roll", "gimbal")}
        if np.shape(lasting) not in ((), (6,)):
            raise ValueError(f"lasting must be one time in s, or six; got shape {np.shape(lasting)}.")
        times = jnp.broadcast_to(jnp.asarray(as_float64(jnp.asarray(lasting, float), "lasting")), (6,))
        return cls(**{**values, **angles}, lasting=times)

    @property
    def sigmas(self) -> Float[Array, " specs"]:
        """The standard deviations in the order of `SPECS`."""
        return jnp.stack([jnp.asarray(getattr(self, name), float) for name in SPECS])


class Compensation(Record):
    """Compensation of the noise; off by default.

    `attitude`: the gimbal keeps the line of sight in the planned direction. `timing`: the next image is taken when the
    integral of speed over height reaches its mark (Li et al. 2020, Eq 36), over level ground; `ground`: the same over
    the ground seen at the near end.
    """

    attitude: FlagField = eqx.field(converter=np.asarray, default=False)
    timing: FlagField = eqx.field(converter=np.asarray, default=False)
    ground: bool = eqx.field(static=True, default=False)

    @property
    def words(self) -> str:
        """The active compensations, in words."""
        timing = "timing by the ground seen" if self.ground else "timing" if np.all(self.timing) else ""
        return " and ".join(part for part in ("attitude" if np.all(self.attitude) else "", timing) if part) or "none"


class Strip(Record):
    """Plan of a strip: `images` of a `sensor`, the first at `shot`, at `speed` m/s along `course` (rad, true).

    Images are `step` m apart along the aircraft's path. That gives the target `overlap` at the near end if every image
    is as long along the flight as the first, `near_length` m on the terrain; or, with a height `ground` (m above the
    ellipsoid), over level ground of that height.
    """

    sensor: Sensor
    shot: Shot
    terrain: AbstractTerrain
    speed: ScalarField
    course: ScalarField
    overlap: ScalarField
    near_length: ScalarField
    ground: ScalarField
    air: Atmosphere | None
    images: int = eqx.field(static=True)
    along: Along = eqx.field(static=True)
    stations: int = eqx.field(static=True, default=STATIONS)

    def __repr__(self) -> str:
        """Images, speed, course, overlap and step; fields if they are traced."""
        of_path = (self.speed, self.course, self.overlap, self.near_length)
        if not has_numbers(*of_path, *jax.tree.leaves(self.shot)) or np.ndim(self.shot.pose.heading):
            return super().__repr__()
        with jax.ensure_compile_time_eval():
            step = range_text(self.step, 1)
        speed, course = range_text(self.speed, 1), range_text(np.rad2deg(np.asarray(self.course)), 3)
        share = range_text(100.0 * np.asarray(self.overlap), 1)
        return (
            f"Strip({self.images} images {step} m apart, at {speed} m/s, course {course} deg, overlap {share} % at the "
            f"near end, flight along {self.along})"
        )

    @classmethod
    def planned(
        cls,
        sensor: Sensor,
        shot: Shot,
        terrain: AbstractTerrain,
        *,
        overlap: ArrayLike,
        speed: ArrayLike,
        images: int,
        course: Any = None,
        ground: ArrayLike | None = None,
        along: Along | None = None,
        stations: int = STATIONS,
        atmosphere: Atmosphere | None = None,
    ) -> Strip:
        """A strip from its first shot; `course` in rad, by default the shot's heading.

        Raises `ValueError` for fewer than two images, an overlap outside [0, 1), a speed that is not positive, and a
        first image whose near end sees no ground.
        """
        if isinstance(images, bool) or not isinstance(images, int) or images < 2:
            raise ValueError(f"a strip needs at least two images to overlap, a whole number; got images={images!r}.")
        check_stations(stations)
        check_along(along)
        check_terrain(terrain, FIRST_HIT)
        check_is(shot, Shot, "shot")
        given: Any = checked_exposure(sensor, shot, None)
        sensor, shot, _ = given
        air = checked_air(atmosphere)
        course = shot.pose.heading if course is None else checked_finite(course, "course", "rad")
        if along is None:
            projection = TransverseMercator.gauss_krueger(shot.pose.position.lon)
            course_on_map = _on_map_direction(shot.pose.position, course, projection)
            along = axis_along(sensor, shot, course_on_map, terrain, projection)
        over = terrain if ground is None else ConstantHeight(checked_finite(ground, "ground", "m"))
        _, (_, ahead, _) = _axes(sensor, shot, course)
        length, height = _near_length(sensor, shot, over, along, ahead, air)
        if not np.isfinite(length):
            status = Status(int(near_edge(sensor, shot, over, along, air).status))
            raise SeesNoGround(
                f"the near end of the first image sees no ground: {status.message if status else 'at its corners.'} "
                "Turn the camera down, or load a larger terrain."
            )
        return cls(
            sensor,
            shot,
            terrain,
            checked_positive(speed, "speed", "m/s"),
            jnp.asarray(course),
            checked_overlap(overlap),
            length,
            height,
            air,
            images,
            along,
            stations,
        )

    @property
    def step(self) -> Scalar:
        """Planned distance of the aircraft from image to image in m, at its height."""
        return (1.0 - self.overlap) * self.near_length * self._faster

    @property
    def period(self) -> Scalar:
        """Planned time from image to image, s."""
        return self.step / self.speed

    def with_overlap(self, overlap: ArrayLike) -> Strip:
        """The same strip with another target overlap."""
        return eqx.tree_at(lambda strip: strip.overlap, self, checked_overlap(overlap))

    @property
    def _faster(self) -> Scalar:
        """Ratio of the speeds of the aircraft and the near end's ground point, by their radii."""
        position = self.shot.pose.position
        radius = WGS84.radius_in_azimuth(position.lat, self.course)
        return (radius + position.height) / (radius + self.ground)


def normals_of(strip: Strip) -> int:
    """Number of standard normal variables of one flight of the strip."""
    return strip.images * (7 + len(strip.sensor.gimbal.axes))


def specs_of(strip: Strip) -> list[int]:
    """For each of these variables, the index in `SPECS` of its standard deviation."""
    axes = len(strip.sensor.gimbal.axes)
    return [spec for spec in range(len(SPECS)) for _ in range(strip.images * (axes if SPECS[spec] == "gimbal" else 1))]


def flown(strip: Strip, noise: FlightNoise, normals: Normals, compensation: Compensation) -> Overlap:
    """Overlaps of consecutive images of a flight (images - 1), from standard normal numbers; all zeros is the planned
    flight. One flight; use `jax.vmap` for many."""
    _, edges = _images(strip, noise, normals, compensation)
    return _overlaps(strip, edges)


def shots_of(strip: Strip, noise: FlightNoise, normals: Normals, compensation: Compensation) -> Shot:
    """The shots of that flight, with a leading axis of images."""
    return _images(strip, noise, normals, compensation)[0]


def _images(strip: Strip, noise: FlightNoise, normals: Normals, compensation: Compensation) -> tuple[Shot, GroundEdges]:
    """The shots of a flight, and the ground edges of its images."""
    processes, gimbal, timing = _drawn(strip, noise, normals)
    planned, track = _axes(strip.sensor, strip.shot, strip.course)
    late = jnp.roll(timing, -1) - timing
    speeds = strip.speed + processes[5]

    def image(way: Scalar, k: Any) -> tuple[Shot, GroundEdges]:
        shot = _shot(strip, way, processes[:, k], gimbal[k], compensation, planned, track)
        return shot, ground_edges(strip.sensor, shot, strip.terrain, strip.along, strip.stations, strip.air)

    if compensation.ground:  # each wait depends on what the image before sees

        def following(way: Scalar, k: Any) -> tuple[Scalar, tuple[Shot, GroundEdges]]:
            shot, edges = image(way, k)
            step = strip.step / strip.near_length * _length_at_near_end(strip, shot, edges, track[1])
            return way + step + speeds[k] * late[k], (shot, edges)

        return jax.lax.scan(following, jnp.zeros(()), jnp.arange(strip.images))[1]
    height = strip.shot.pose.position.height
    by_height = (height + processes[3] - strip.ground) / (height - strip.ground) * strip.speed / speeds
    waits = strip.period * jnp.where(compensation.timing, by_height, 1.0)
    steps = speeds * (waits + late)
    ways = jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)[:-1]])
    return jax.vmap(image)(ways, jnp.arange(strip.images))


def _drawn(
    strip: Strip, noise: FlightNoise, normals: Normals
) -> tuple[Float[Array, "6 images"], Float[Array, "images axes"], Float[Array, " images"]]:
    """The six processes at the images, control errors of the axes, and the delay of each image."""
    axes, n = len(strip.sensor.gimbal.axes), strip.images
    walks, rest = normals[: 6 * n].reshape(6, n), normals[6 * n :]
    sigmas = noise.sigmas
    kept = jnp.exp(-strip.period / noise.lasting)
    fresh = jnp.sqrt(1.0 - kept * kept)

    def later(state: Float[Array, "6"], normal: Float[Array, "6"]) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
        state = kept * state + fresh * normal
        return state, state

    _, following = jax.lax.scan(later, walks[:, 0], walks[:, 1:].T)
    processes = sigmas[:6, None] * jnp.concatenate([walks[:, :1], following.T], axis=1)
    return processes, sigmas[6] * rest[: n * axes].reshape(n, axes), sigmas[7] * rest[n * axes :]


def _axes(sensor: Sensor, shot: Shot, course: Scalar) -> tuple[Vector3, tuple[Vector3, Vector3, Vector3]]:
    """The planned line of sight in axes (along the course, right of it, down), and the track: normal, along, right."""
    R = R_ecef_from_ned(shot.pose.position)
    c, s = jnp.cos(course), jnp.sin(course)
    up, along = -R[:, 2], c * R[:, 0] + s * R[:, 1]
    right = jnp.stack(cross(-up, along))
    sight = matvec(sensor.R_ned_from_camera(shot), sensor.camera.axis())
    planned = jnp.stack([c * sight[0] + s * sight[1], c * sight[1] - s * sight[0], sight[2]])
    return planned, (up, along, right)


def _shot(
    strip: Strip,
    way: Scalar,
    process: Float[Array, "6"],
    gimbal: Float[Array, " axes"],
    compensation: Compensation,
    planned: Vector3,
    track: tuple[Vector3, Vector3, Vector3],
) -> Shot:
    """The shot of an image, `way` m along the track from the first."""
    first, (up, along, right) = strip.shot, track
    height = first.pose.position.height
    radius = WGS84.radius_in_azimuth(first.pose.position.lat, strip.course) + height
    turn, aside = way / radius, process[4] / radius
    normal = jnp.cos(turn) * up + jnp.sin(turn) * along
    normal = jnp.cos(aside) * normal + jnp.sin(aside) * right
    heading_of_track = jnp.cos(turn) * along - jnp.sin(turn) * up
    lat = jnp.arctan2(normal[2], jnp.sqrt(normal[0] ** 2 + normal[1] ** 2))
    position = Geodetic(lat=lat, lon=jnp.arctan2(normal[1], normal[0]), height=height + process[3])
    north, east, _ = matvec(R_ecef_from_ned(position).T, heading_of_track)
    course = jnp.arctan2(east, north)
    pose = Pose(
        position,
        first.pose.heading + (course - strip.course) + process[0],
        first.pose.pitch + process[1],
        first.pose.roll + process[2],
        first.pose.deflection,
    )
    readings = jnp.asarray(first.gimbal_readings)
    c, s = jnp.cos(course), jnp.sin(course)
    ned = jnp.stack([c * planned[0] - s * planned[1], s * planned[0] + c * planned[1], planned[2]])
    held = aim(strip.sensor, pose, LineOfSight(ned), None, readings, None).readings
    readings = jnp.where(compensation.attitude, held, readings)
    return Shot(pose, readings + gimbal)


def _length_at_near_end(strip: Strip, shot: Shot, edges: GroundEdges, ahead: Vector3) -> Scalar:
    """Length in m along the flight of the near end of an image, between its corners."""
    corners = edges.points[:, jnp.array([0, -1])]
    centre = strip.sensor.perspective_centre(shot)
    reach = jnp.sum(jax.vmap(jax.vmap(lambda corner: safe_norm(corner - centre)))(corners), axis=0)
    lengths = jnp.abs((corners[1] - corners[0]) @ ahead)
    return jnp.where(reach[0] <= reach[1], lengths[0], lengths[1])


_near_length = quick_filter_jit(near_length)


def _overlaps(strip: Strip, edges: GroundEdges) -> Overlap:
    """Overlaps of consecutive images along the planned course."""
    projection = TransverseMercator.gauss_krueger(strip.shot.pose.position.lon)
    direction = _on_map_direction(strip.shot.pose.position, strip.course, projection)
    on_the_map = jax.vmap(lambda one: edges_on_map(one, direction, projection))(edges)
    before, after = (jax.tree.map(lambda x, p=part: x[p], on_the_map) for part in (slice(None, -1), slice(1, None)))
    return jax.vmap(lambda one, other: shared(one, other, direction, strip.stations))(before, after)


def _on_map_direction(position: Geodetic, course: Any, projection: TransverseMercator) -> Float[Array, "2"]:
    convergence, _ = projection.convergence_and_scale(position.lat, position.lon)
    bearing = course - convergence
    return jnp.stack([jnp.sin(bearing), jnp.cos(bearing)])

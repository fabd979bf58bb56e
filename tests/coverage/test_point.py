"""Where to turn a gimbal: what is pointed at is what is then seen, or it is said why it cannot be, and how near."""

from __future__ import annotations

import dataclasses
import functools
import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from jax.flatten_util import ravel_pytree
from jaxtyping import TypeCheckError
from support.fractal import fractal_posts

from jaxgeo import (
    Atmosphere,
    BrownConrady,
    ConstantHeight,
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    Ray,
    Sensor,
    Shot,
    Status,
    Trajectory,
    intersect,
)
from jaxgeo.coverage import LineOfSight, compensate, line_of_sight, point_gimbal
from jaxgeo.coverage.compensation_formulas import angles_towards, exact_compensation
from jaxgeo.earth import WGS84, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import boresight_from_degrees
from jaxgeo.terrain import TangentGrid

COUNT = 64
LENS = FrameCamera.from_pixels(
    focal_px=9000.0, width=8000, height=6000, principal_px=(4010.0, 2980.0), distortion=BrownConrady(k1=-0.12, p1=1e-4)
)
AXIS_PX, ASIDE_PX = LENS.principal_px, np.array([7000.0, 900.0])
AIR = Atmosphere()
CENTRE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
POSTS, SPACING = 64, 90.0  # m
DEM = Dem.from_array(
    fractal_posts(POSTS, spacing=SPACING, relief=1200.0, exponent=3.0, seed=4),
    TangentGrid.centred(CENTRE, spacing=(SPACING, SPACING), shape=(POSTS, POSTS)),
)
HELD = {
    "R_body_from_base": boresight_from_degrees(heading=1.0, pitch=-2.0, roll=0.5),
    "lever_body": np.array([3.0, -1.0, 0.5]),
    "lever_head": np.array([0.2, 0.1, -0.3]),
}
PAN_TILT = {"axes": {"pan": "z", "tilt": "y"}, "gain": (0.5, 1.0), "offset": (30.0, 0.0), "limits": (-720.0, 720.0)}
# Named as the other two axes are: what is compiled for those then does for it.
MIRROR = dataclasses.replace(Gimbal.mirror_two_axis(), names=Gimbal.two_axis().names)
SENSORS = {
    "two axes": Sensor(LENS, Gimbal.two_axis(), Mount.nadir(**HELD)),
    "mirror, 2:1": Sensor(LENS, MIRROR, Mount.nadir(**HELD)),
    "three axes, body": Sensor(LENS, Gimbal.three_axis(reference="body"), Mount.forward(**HELD)),
    "three axes, level": Sensor(LENS, Gimbal.three_axis(), Mount.forward(**HELD)),
    "pan and tilt, geared": Sensor(LENS, Gimbal.from_degrees(**PAN_TILT), Mount.forward(**HELD)),
}
ONE_AXIS = {
    "pan alone": Sensor(LENS, Gimbal.from_degrees(axes={"pan": "z"}, gain=0.5), Mount.forward(**HELD)),
    "roll alone": Sensor(LENS, Gimbal.from_degrees(axes={"roll": "x"}, sign=-1.0), Mount.nadir(**HELD)),
}
EVERY = SENSORS | ONE_AXIS
LATER = set(EVERY) - {"two axes", "mirror, 2:1"}  # much like others of the table, and a program of their own each


def rows(names):
    return pytest.mark.parametrize(
        "name", [pytest.param(n, marks=pytest.mark.slow) if n in LATER else n for n in names]
    )


class Looks(eqx.Module):
    """Many questions: from where, at what, with which pixel, and how far the axes may turn."""

    pose: Pose
    target: Geodetic
    uv: jax.Array
    limits: jax.Array


def in_numpy(function):
    """Compiled, and its answers as NumPy arrays."""
    compiled = eqx.filter_jit(function)
    return functools.wraps(function)(lambda *arguments: jax.tree.map(np.asarray, compiled(*arguments)))


@in_numpy
def asked(sensor, looks, air=None, terrain=None):
    """Answers, and the perspective centre and direction of the pixel with those readings, in ECEF."""

    def one(look):
        held = eqx.tree_at(lambda s: s.gimbal.limits, sensor, look.limits)
        found = point_gimbal(held, Shot(look.pose), target=look.target, uv=look.uv, atmosphere=air, terrain=terrain)
        origin, direction, _ = held.ray_ecef(Shot(look.pose, found.readings), look.uv)
        return found, origin, direction, held.gimbal.inside_limits(found.readings)

    return jax.vmap(one)(looks)


@functools.cache
def met(with_air: bool):
    air = AIR if with_air else None
    return in_numpy(lambda rays, dem: jax.vmap(lambda ray: intersect(ray, dem, atmosphere=air))(rays))


def random_looks(sensor: Sensor, seed: int, limits: np.ndarray | None = None) -> Looks:
    """From poses 1.5 to 6 km over rough ground at places on it; half by the middle pixel, half by one far aside."""
    rng = np.random.default_rng(seed)
    R, origin = np.asarray(R_ecef_from_enu(CENTRE)), np.asarray(WGS84.to_ecef(CENTRE))
    half = 0.4 * POSTS * SPACING

    def ecef_of(height):
        level = rng.uniform(-half, half, (COUNT, 2))
        return origin + np.concatenate([level, height[:, None]], axis=1) @ R.T

    above = ecef_of(np.full(COUNT, 5000.0))
    down = Ray(jnp.asarray(above), jnp.asarray(np.tile(-R[:, 2], (COUNT, 1))))
    ground = met(False)(down, DEM)
    assert np.all(ground.status == Status.hit)
    position = jax.vmap(WGS84.to_geodetic)(jnp.asarray(ecef_of(rng.uniform(1500.0, 6000.0, COUNT))))
    heading, pitch, roll = rng.uniform(-math.pi, math.pi, COUNT), *rng.normal(0.0, 0.08, (2, COUNT))
    uv = np.where(np.arange(COUNT)[:, None] % 2 == 0, np.asarray(AXIS_PX), ASIDE_PX)
    limits = np.tile(np.asarray(sensor.gimbal.limits), (COUNT, 1, 1)) if limits is None else limits
    return jax.tree.map(jnp.asarray, Looks(Pose(position, heading, pitch, roll), ground.position, uv, limits))


def ecef(position: Geodetic) -> np.ndarray:
    return np.asarray(jax.vmap(WGS84.to_ecef)(jax.tree.map(jnp.asarray, position)))


def lengths(v: np.ndarray) -> np.ndarray:
    return np.linalg.norm(v, axis=-1)


def units(v: np.ndarray) -> np.ndarray:
    return v / lengths(v)[..., None]


# What is pointed at is seen.


@pytest.mark.costly
@rows(SENSORS)
def test_the_pixel_sees_what_it_is_pointed_at(name):
    """Straight through space: within 1e-9 rad, and on the ground within 1 mm, or nearer ground is in the way."""
    looks = random_looks(SENSORS[name], seed=3)
    found, origin, direction, inside = asked(SENSORS[name], looks)
    reached = found.status == Status.hit
    assert np.all(reached | (found.status == Status.outside_gimbal_range))
    if name in ("two axes", "mirror, 2:1"):
        assert np.sum(reached) > COUNT // 4
    else:
        assert np.all(reached[::2])  # by the optical axis; far aside, a pixel cannot look straight down
        assert np.sum(reached) > 0.8 * COUNT
    assert np.all(inside)
    to_target = ecef(looks.target) - origin
    off = lengths(np.cross(direction, units(to_target)))
    assert np.max(off[reached]) < 1e-9
    np.testing.assert_allclose(found.miss[reached], off[reached], rtol=0, atol=1e-12)
    fix = met(False)(Ray(jnp.asarray(origin), jnp.asarray(direction)), DEM)
    away = lengths(np.asarray(fix.ecef) - ecef(looks.target))
    before = lengths(to_target) - np.asarray(fix.slant_range)
    assert np.all((away < 1e-3) | (before > 0.01) | ~reached)
    assert np.sum((away < 1e-3) & reached) > 0.7 * np.sum(reached)


@pytest.mark.slow
def test_the_optical_axis_is_the_default_and_lines_of_sight_are_what_it_takes():
    sensor, shot = SENSORS["two axes"], Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=4000.0, heading=40.0))
    target = Geodetic.from_degrees(lat=46.98, lon=11.02, height=500.0)
    found = point_gimbal(sensor, shot, target=target)
    assert found.ok
    looked = Shot(shot.pose, found.readings)
    sight = sensor.to_camera(looked, WGS84.to_ecef(target))
    np.testing.assert_allclose(sight[:2] / sight[2], 0.0, rtol=0, atol=1e-12)
    again = point_gimbal(sensor, shot, target=line_of_sight(sensor, looked))
    np.testing.assert_allclose(again.readings, found.readings, rtol=0, atol=1e-12)


def seen_on_ground(name: str, air: Atmosphere | None) -> np.ndarray:
    """The readings with which many pixels are found to see their ground, or to be hidden from it."""
    looks = random_looks(SENSORS[name], seed=5)
    found, origin, direction, _ = asked(SENSORS[name], looks, air, DEM)
    fix = met(air is not None)(Ray(jnp.asarray(origin), jnp.asarray(direction)), DEM)
    away, distance = lengths(np.asarray(fix.ecef) - ecef(looks.target)), lengths(ecef(looks.target) - origin)
    seen, hidden = found.status == Status.hit, found.status == Status.hidden_by_terrain
    before = distance - np.asarray(fix.slant_range)
    assert np.all(away[seen] < 1e-3)
    assert np.all(before[hidden] > 0.0099)
    assert np.sum(hidden) >= 2
    assert np.sum(seen) >= COUNT // 5
    assert np.all(np.isfinite(found.readings))
    assert np.all(found.miss[seen | hidden] < 1e-9)
    assert np.all(seen | hidden | (found.status == Status.outside_gimbal_range))
    return found.readings


@pytest.mark.slow
def test_what_terrain_hides_has_readings_and_its_status():
    seen_on_ground("two axes", None)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pan and tilt, geared"])  # the rest is as without air
def test_through_the_air_the_pixel_sees_what_it_is_pointed_at(name):
    bent = seen_on_ground(name, AIR)
    straight = asked(SENSORS[name], random_looks(SENSORS[name], seed=5))[0].readings
    assert np.max(np.abs(straight - bent)) > 1e-6


# What is out of reach: no reading within the limits comes nearer.


def about(axis: str, angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned about a named axis, in NumPy alone."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    angle, out = np.broadcast_to(angle, v.shape[:-1]), np.array(v, copy=True)
    out[..., i] = np.cos(angle) * v[..., i] - np.sin(angle) * v[..., j]
    out[..., j] = np.sin(angle) * v[..., i] + np.cos(angle) * v[..., j]
    return out


def least_miss(gimbal: Gimbal, limits: np.ndarray, sight: np.ndarray, wanted: np.ndarray, nodes: int) -> float:
    """Least angle in rad between the line of sight and a direction in the base, by grids over the first two axes.

    A dense one over the box of the limits, then finer ones about its best places.
    """
    axes, factor = gimbal.axes[:2], np.asarray(gimbal.sign * gimbal.gain)
    offset = np.asarray(gimbal.offset)
    held = np.clip(offset, np.asarray(limits)[:, 0], np.asarray(limits)[:, 1])
    for k in range(len(gimbal.axes) - 1, len(axes) - 1, -1):
        sight = about(gimbal.axes[k], factor[k] * (held[k] - offset[k]), sight)

    def misses(readings: np.ndarray) -> np.ndarray:
        v = np.broadcast_to(sight, (*readings.shape[:-1], 3))
        for k in range(len(axes) - 1, -1, -1):
            v = about(axes[k], factor[k] * (readings[..., k] - offset[k]), v)
        return 2.0 * np.arcsin(np.clip(0.5 * lengths(v - wanted), 0.0, 1.0))

    low, high = limits[: len(axes), 0], limits[: len(axes), 1]
    turn = 2.0 * np.pi / np.abs(factor[: len(axes)])
    high = np.minimum(high, low + turn)

    def grid(low: np.ndarray, high: np.ndarray, nodes: int) -> np.ndarray:
        sides = [np.linspace(a, b, nodes) for a, b in zip(low, high, strict=True)]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(axes))

    readings = grid(low, high, nodes)
    values = misses(readings)
    best = readings[np.argpartition(values, 5)[:5]]
    least, width = np.min(values), (high - low) / (nodes - 1)
    for place in best:
        reach, here = width, place
        for _ in range(9):
            finer = grid(np.maximum(here - reach, low), np.minimum(here + reach, high), 21)
            values = misses(finer)
            here, reach, least = finer[np.argmin(values)], reach / 5.0, min(least, float(np.min(values)))
    return float(least)


@in_numpy
def wanted_directions(looks):
    """Unit vectors: of the pixels in the camera, to the targets in north-east-down and in the body."""

    def one(look):
        way = WGS84.to_ecef(look.target) - WGS84.to_ecef(look.pose.position)
        ned = R_ecef_from_ned(look.pose.position).T @ (way / jnp.linalg.norm(way))
        return LENS.ray(look.uv)[0], ned, look.pose.R_ned_from_body.T @ ned

    return jax.vmap(one)(looks)


def narrow_limits(gimbal: Gimbal, rng: np.random.Generator) -> np.ndarray:
    """Boxes of limits (COUNT, axes, 2), from slits to a third of a circle of the axis, about angles of up to 60 deg."""
    axes = len(gimbal.axes)
    middle = np.asarray(gimbal.offset) + rng.uniform(-1.05, 1.05, (COUNT, axes)) / np.asarray(gimbal.gain)
    half = rng.uniform(0.0, 1.05, (COUNT, axes)) ** 2 / np.asarray(gimbal.gain)
    return np.stack([middle - half, middle + half], axis=-1)


@pytest.mark.costly
@rows(EVERY)
def test_out_of_range_nothing_within_the_limits_comes_nearer(name):
    check_nearest(name, seed=7, lanes=16, nodes=101)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("seed", [21, 22])
def test_out_of_range_nothing_comes_nearer_on_a_dense_grid(name, seed):
    check_nearest(name, seed, lanes=COUNT, nodes=301)


def check_nearest(name: str, seed: int, lanes: int, nodes: int) -> None:
    """Without lever arms, so that the direction to the target is the same for all readings."""
    sensor, rng = EVERY[name], np.random.default_rng(10 + seed)
    bare = eqx.tree_at(lambda s: (s.mount.lever_body, s.mount.lever_head), sensor, (np.zeros(3), np.zeros(3)))
    limits = narrow_limits(sensor.gimbal, rng)
    if len(sensor.gimbal.axes) == 3:
        limits[:, 2] = [-0.1, 0.1]  # the roll is held at zero
    looks = random_looks(bare, seed=seed, limits=limits)
    found, origin, direction, inside = asked(bare, looks)
    assert np.all(inside)
    off = 2.0 * np.arcsin(0.5 * lengths(direction - units(ecef(looks.target) - origin)))
    np.testing.assert_allclose(found.miss, off, rtol=0, atol=1e-12)
    outside = found.status == Status.outside_gimbal_range
    assert np.sum(outside) > COUNT // 2
    assert np.all(outside | (found.status == Status.hit))
    sights, to_ned, to_body = wanted_directions(looks)
    in_base = to_ned if sensor.gimbal.reference == "level" else to_body @ np.asarray(sensor.mount.R_body_from_base)
    for k in range(lanes):
        sight, wanted = np.asarray(sensor.mount.R_head_from_camera) @ sights[k], in_base[k]
        least = least_miss(sensor.gimbal, limits[k], sight, wanted, nodes if len(limits[k]) > 1 else 5001)
        assert found.miss[k] <= least + 1e-9, (k, Status(int(found.status[k])), found.miss[k], least)


@pytest.mark.costly
def test_with_lever_arms_nothing_comes_nearer_but_for_what_a_lever_is_of_the_way():
    """Levers of a third of a metre over 1.5 km and more; also against readings all around the answer."""
    sensor = SENSORS["two axes"]
    looks = random_looks(sensor, seed=8, limits=narrow_limits(sensor.gimbal, np.random.default_rng(18)))
    found, _, _, _ = asked(sensor, looks)
    offsets = np.random.default_rng(1).normal(0.0, 1.0, (50, 2)) * np.geomspace(1e-6, 0.1, 50)[:, None]

    @jax.jit
    @jax.vmap
    def misses(look, readings):
        def miss(offset):
            near = jnp.clip(readings + offset, look.limits[:, 0], look.limits[:, 1])
            origin, direction, _ = sensor.ray_ecef(Shot(look.pose, near), look.uv)
            to = WGS84.to_ecef(look.target) - origin
            return 2.0 * jnp.arcsin(0.5 * jnp.linalg.norm(direction - to / jnp.linalg.norm(to)))

        return jax.vmap(miss)(jnp.asarray(offsets))

    better = found.miss[:, None] - np.asarray(misses(looks, jnp.asarray(found.readings)))
    assert np.max(better) < 1e-7


# What goes wrong has a status, lane by lane.


@pytest.mark.costly
def test_what_cannot_be_asked_has_a_status_and_leaves_the_others():
    sensor = SENSORS["two axes"]
    looks = random_looks(sensor, seed=3)
    good, *_ = asked(sensor, looks)
    nan = jnp.nan
    spoilt = eqx.tree_at(
        lambda x: (x.pose.heading, x.target.height, x.uv, x.limits),
        looks,
        (
            looks.pose.heading.at[1].set(nan),
            looks.target.height.at[2].set(jnp.inf),
            looks.uv.at[3].set(jnp.array([1e7, 0.0])).at[4, 0].set(nan),
            looks.limits,
        ),
    )
    found, *_ = asked(sensor, spoilt)
    expected = {1: Status.invalid_input, 2: Status.invalid_input, 3: Status.outside_image}
    for lane, status in expected.items():
        assert found.status[lane] == status
        assert np.all(np.isnan(found.readings[lane]))
        assert np.isnan(found.miss[lane])
    assert found.status[4] != Status.hit
    assert np.all(np.isnan(found.readings[4]))
    others = np.setdiff1d(np.arange(COUNT), [1, 2, 3, 4])
    np.testing.assert_array_equal(found.readings[others], good.readings[others])
    np.testing.assert_array_equal(found.status[others], good.status[others])


# Derivatives are those of the implicit function, and finite everywhere.

UNITS = {"position": (1e-6, 1e-6, 10.0), "attitude": 1e-3, "target": (1e-6, 1e-6, 10.0), "uv": 10.0, "mount": 1e-3}


def changed(sensor: Sensor, look: Looks, change: jax.Array) -> jax.Array:
    """Readings after a change of 14 numbers: position, attitude, target, pixel and boresight, in units of `UNITS`."""
    flat, restore = ravel_pytree((look.pose.position, look.target))
    units = jnp.array([*UNITS["position"], *UNITS["target"]])
    position, target = restore(flat + units * change[:6])
    attitude = [getattr(look.pose, n) + UNITS["attitude"] * change[6 + k] for k, n in enumerate(ATTITUDE)]
    turn = R_from_rotation_vector(UNITS["mount"] * change[11:14])
    moved = eqx.tree_at(
        lambda s: (s.mount.R_body_from_base, s.gimbal.limits),
        sensor,
        (jnp.asarray(sensor.mount.R_body_from_base) @ turn, look.limits),
    )
    uv = look.uv + UNITS["uv"] * change[9:11]
    return point_gimbal(moved, Shot(Pose(position, *attitude)), target=target, uv=uv).readings


ATTITUDE = ("heading", "pitch", "roll")


@in_numpy
def derivatives(sensor, looks, directions):
    """Values a step on and back, the change along a direction, and gradients of every reading."""

    def one(look, direction):
        f = functools.partial(changed, sensor, look)
        at = jnp.zeros(14)
        places = 0.1 * jnp.stack([direction, -direction, at])
        values, changes = jax.vmap(lambda x: jax.jvp(f, (x,), (direction,)))(places)
        value, pull = jax.vjp(f, at)
        (back,) = jax.vmap(pull)(jnp.eye(value.shape[0]))
        return values[:2], changes[2], back

    return jax.vmap(one)(looks, directions)


def check_derivatives(name: str) -> None:
    sensor = SENSORS[name]
    looks = random_looks(sensor, seed=3)
    closed = looks.limits.at[::8].set(jnp.asarray(sensor.gimbal.neutral_readings())[:, None])  # a box of one point
    looks = dataclasses.replace(looks, limits=closed)
    status = asked(sensor, looks)[0].status
    reached = status == Status.hit
    assert np.any(~reached)
    directions = np.random.default_rng(2).normal(size=(COUNT, 14))
    values, forward, back = derivatives(sensor, looks, jnp.asarray(directions))
    assert all(np.all(np.isfinite(part)) for part in (values, forward, back))
    np.testing.assert_allclose(np.einsum("kri,ki->kr", back, directions), forward, rtol=1e-9, atol=1e-12)
    assert np.all(forward[~reached] == 0.0)
    numeric = (values[:, 0] - values[:, 1]) / 0.2
    size = np.max(np.abs(back), axis=(1, 2))[:, None]
    np.testing.assert_array_less(
        np.abs(forward - numeric)[reached], 2e-5 * np.broadcast_to(size, forward.shape)[reached]
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two axes", "mirror, 2:1"])
def test_derivatives_forward_and_reverse_equal_differences(name):
    check_derivatives(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SENSORS if name not in ("two axes", "mirror, 2:1")])
def test_derivatives_of_every_gimbal_equal_differences(name):
    check_derivatives(name)


@in_numpy
def towards(sensor, pose, ned, start):
    """Towards a direction from given readings, and the derivatives by the direction."""

    def find(v):
        found = point_gimbal(sensor, Shot(pose), target=LineOfSight(v), readings=start)
        return found.readings, found

    return jax.jacrev(find, has_aux=True)(ned)[::-1]


LEVEL = Pose.from_degrees(lat=47.0, lon=11.0, height=4000.0)
SINGULAR = {
    "ahead, along the outer axis": (
        Sensor(LENS, Gimbal.two_axis(), Mount.nadir()), [1.0, 0.0, 0.0], [0.3, 0.2], [0.3, 0.5 * math.pi]
    ),
    "straight down under pan and tilt": (
        Sensor(LENS, Gimbal.from_degrees(**PAN_TILT | {"offset": 0.0}), Mount.forward()),
        [0.0, 0.0, 1.0], [0.7, -1.0], [0.7, -0.5 * math.pi],
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGULAR)
def test_along_an_axis_that_axis_stays_where_it_is(name):
    sensor, ned, start, expected = SINGULAR[name]
    found, slope = towards(sensor, LEVEL, jnp.array(ned), jnp.array(start))
    assert found.ok
    np.testing.assert_allclose(found.readings, expected, rtol=0, atol=1e-8)
    assert np.all(np.isfinite(slope))
    for turn in (1e-12, 1e-9, 1e-6, 1e-3):  # and close by
        aside = np.asarray(R_from_rotation_vector(turn * jnp.array([0.6, 0.64, 0.48]))) @ np.array(ned)
        found, slope = towards(sensor, LEVEL, jnp.asarray(aside), jnp.array(start))
        assert found.status in (Status.hit, Status.outside_gimbal_range)  # an inner axis beyond its right angle
        assert found.miss < turn + 1e-9
        assert np.all(np.isfinite(slope))


# Directions: compensation of the attitude.

HOLDING = SENSORS["two axes"]
BARE = Sensor(LENS, HOLDING.gimbal, Mount.nadir())


def random_attitudes(seed: int) -> tuple[Shot, Pose]:
    """Shots before, looking to the right, and poses after, changed by some degrees."""
    rng = np.random.default_rng(seed)
    attitude = np.stack([rng.uniform(-3.1, 3.1, COUNT), *rng.normal(0.0, 0.03, (2, COUNT))])
    readings = np.stack([rng.uniform(-1.2, 1.2, COUNT), rng.uniform(-0.4, 0.4, COUNT)], axis=1)
    position = jax.tree.map(lambda x: jnp.full(COUNT, x), LEVEL.position)
    poses = [Pose(position, *map(jnp.asarray, a)) for a in (attitude, attitude + rng.normal(0.0, 0.05, (3, COUNT)))]
    return Shot(poses[0], jnp.asarray(readings), jnp.zeros(COUNT)), poses[1]


@in_numpy
def compensated(sensor, before, after):
    """Found, the lines of sight before and after, and the readings by Newton's method of another library."""

    def one(before, pose):
        found = compensate(sensor, before, Shot(pose))
        wanted = line_of_sight(sensor, before).ned
        across = jnp.cross(wanted, jnp.array([0.6, 0.0, 0.8]))
        across = jnp.stack([across, jnp.cross(wanted, across)])

        def residual(readings, _):
            return across @ line_of_sight(sensor, Shot(pose, readings)).ned

        root = optx.root_find(residual, optx.Newton(rtol=1e-13, atol=1e-13), before.gimbal_readings, max_steps=30)
        return found, wanted, line_of_sight(sensor, Shot(pose, found.readings)).ned, root.value

    return jax.vmap(one)(before, after)


@pytest.mark.costly
@pytest.mark.parametrize("sensor", [BARE, HOLDING], ids=["bare", "held"])
def test_compensation_keeps_the_line_of_sight_and_is_what_newton_finds(sensor):
    before, after = random_attitudes(seed=6)
    found, wanted, seen, root = compensated(sensor, before, after)
    assert np.all(found.ok)
    assert np.max(lengths(np.cross(wanted, seen))) < 1e-9
    np.testing.assert_allclose(found.readings, root, rtol=0, atol=1e-9)


@pytest.mark.costly
def test_compensation_is_the_exact_closed_form():
    before, after = random_attitudes(seed=6)
    found, wanted, _, _ = compensated(BARE, before, after)
    theta, phi = -before.gimbal_readings[:, 0], before.gimbal_readings[:, 1]
    R = jax.vmap(lambda pose: pose.R_ned_from_body)(after)
    change = jax.vmap(exact_compensation)(R, theta, phi, jnp.asarray(wanted))
    np.testing.assert_allclose(-(found.readings[:, 0] + theta), change.theta, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.readings[:, 1] - phi, change.phi, rtol=0, atol=1e-12)
    angles = jax.vmap(angles_towards)(R, jnp.asarray(wanted))
    np.testing.assert_allclose(found.readings, np.stack([-angles.theta, angles.phi], axis=1), rtol=0, atol=1e-12)


def test_lines_of_sight_in_degrees_come_back():
    sight = LineOfSight.from_degrees(azimuth=np.array([10.0, 350.0]), depression=np.array([30.0, -5.0]))
    np.testing.assert_allclose(sight.to_degrees(), [[10.0, 350.0], [30.0, -5.0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        LineOfSight.from_degrees(azimuth=90.0, depression=0.0).ned, [0, 1, 0], rtol=0, atol=1e-15
    )


# A whole flight.

KNOTS = 13
DRONE = SENSORS["three axes, level"]
RING = Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)


def round_the_target() -> Trajectory:
    """Over three quarters of a circle of 2 km about a point, which is first seen in azimuth 60 and last in 330 deg."""
    azimuth = np.deg2rad(np.linspace(60.0, 330.0, KNOTS))
    R, origin = np.asarray(R_ecef_from_enu(RING)), np.asarray(WGS84.to_ecef(RING))
    enu = np.stack([-2000.0 * np.sin(azimuth), -2000.0 * np.cos(azimuth), np.full(KNOTS, 1500.0)], axis=1)
    position = jax.vmap(WGS84.to_geodetic)(jnp.asarray(origin + enu @ R.T))
    wobble = 0.05 * np.sin(np.arange(KNOTS))
    return Trajectory.from_knots(np.arange(KNOTS) * 5.0, Pose(position, azimuth - 1.4, wobble, -0.5 * wobble))


FLIGHT = round_the_target()


def each_knot(poses: Pose):
    """Every knot by itself, by the program that is compiled for `COUNT` looks."""
    lanes = np.minimum(np.arange(COUNT), KNOTS - 1)
    poses, targets = jax.tree.map(lambda x: x[lanes], (poses, TARGETS))
    limits = jnp.tile(jnp.asarray(DRONE.gimbal.limits), (COUNT, 1, 1))
    found, *_ = asked(DRONE, Looks(poses, targets, jnp.tile(jnp.asarray(AXIS_PX), (COUNT, 1)), limits))
    return jax.tree.map(lambda x: x[:KNOTS], found)


seen_by_the_drone = in_numpy(jax.vmap(lambda pose, r: DRONE.to_camera(Shot(pose, r), WGS84.to_ecef(RING))))
TARGETS = jax.tree.map(lambda x: jnp.full(KNOTS, x), RING)


@pytest.mark.slow
def test_a_flight_is_pointed_knot_by_knot_without_jumps():
    found, alone = point_gimbal(DRONE, FLIGHT, target=RING), each_knot(FLIGHT.poses)
    assert np.all(found.ok)
    assert found.readings.shape == (KNOTS, 3)
    turns = (found.readings - alone.readings) / (2.0 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), rtol=0, atol=1e-9)
    assert np.any(np.round(turns) != 0.0)  # alone, the yaw jumps at 180 deg
    yaw = np.rad2deg(found.readings[:, 0])
    np.testing.assert_allclose(np.diff(yaw), 270.0 / (KNOTS - 1), rtol=0, atol=0.5)
    assert np.all(found.readings[:, 2] == 0.0)
    steered = FLIGHT.with_readings(found.readings)
    sensed = seen_by_the_drone(steered.poses, steered.gimbal_readings)
    np.testing.assert_allclose(sensed[:, :2] / sensed[:, 2:], 0.0, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_without_a_singularity_a_flight_is_what_its_knots_are():
    first = jax.tree.map(lambda x: x[:5], FLIGHT)
    poses = jax.tree.map(lambda x: jnp.concatenate([x[:5]] * 2 + [x[:3]]), FLIGHT.poses)
    assert first.times.shape == (5,)
    back_and_forth = Trajectory.from_knots(np.arange(KNOTS) * 5.0, dataclasses.replace(poses, heading=poses.pitch))
    found = point_gimbal(DRONE, back_and_forth, target=RING)
    alone = each_knot(back_and_forth.poses)
    np.testing.assert_allclose(found.readings, alone.readings, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.status, alone.status)


@pytest.mark.slow
def test_one_knot_s_failure_is_its_own():
    lat = TARGETS.lat.at[4].set(jnp.nan)
    height = TARGETS.height.at[7].set(3e5)  # far overhead, beyond a pitch of 90 deg seen the right way round
    tight = eqx.tree_at(lambda s: s.gimbal.limits, DRONE, jnp.asarray(DRONE.gimbal.limits).at[1, 1].set(0.3))
    whole = point_gimbal(tight, FLIGHT, target=RING)
    found = point_gimbal(tight, FLIGHT, target=Geodetic(lat=lat, lon=TARGETS.lon, height=height))
    assert found.status[4] == Status.invalid_input
    assert np.all(np.isnan(found.readings[4]))
    assert found.status[7] == Status.outside_gimbal_range
    assert found.miss[7] > 0.1
    assert tight.gimbal.inside_limits(found.readings[7])
    others = np.setdiff1d(np.arange(KNOTS), [4, 7])
    assert np.all(found.ok[others])
    np.testing.assert_allclose(found.readings[others], whole.readings[others], rtol=0, atol=1e-12)


# Mistakes, in words.

SENSOR, SHOT = SENSORS["two axes"], Shot(LEVEL)
DOWN = LineOfSight.from_degrees(azimuth=0.0, depression=90.0)
GROUND = ConstantHeight(0.0)
MISTAKES = {
    "a fixed gimbal": (
        lambda: point_gimbal(Sensor(LENS), SHOT, target=RING), ValueError,
        "gimbal has no axes.* turn the",
    ),
    "a fix": (
        lambda: point_gimbal(SENSOR, SHOT, target="here"), TypeError,
        "target must be a Geodetic point or a LineOf",
    ),
    "a direction and a terrain": (
        lambda: point_gimbal(SENSOR, SHOT, target=DOWN, terrain=GROUND), TypeError, "target.*leave the terrain out"
    ),
    "no terrain": (lambda: point_gimbal(SENSOR, SHOT, target=RING, terrain=3.0), TypeError, "terrain must be a"),
    "degrees": (
        lambda: point_gimbal(SENSOR, SHOT, target=jax.tree.map(jnp.rad2deg, RING)),
        ValueError, r"target\.lat must lie within pi/2.*from_degrees takes degrees",
    ),
    "readings of another gimbal": (
        lambda: point_gimbal(SENSOR, SHOT, target=RING, readings=np.zeros(3)), ValueError,
        r"2 axes \(outer, inner\).*\(3,\)",
    ),
    "air that is none": (
        lambda: point_gimbal(SENSOR, SHOT, target=RING, atmosphere=1.0), TypeError,
        "atmosphere must be a jaxgeo.Atmosphere",
    ),
    "a pose": (lambda: point_gimbal(SENSOR, LEVEL, target=RING), TypeError, "shot must be a jaxgeo Shot"),
    "a flight's line of sight": (lambda: line_of_sight(SENSOR, FLIGHT), TypeError, r"shot must be.*trajectory\.at"),
    "too few targets": (
        lambda: point_gimbal(DRONE, FLIGHT, target=jax.tree.map(lambda x: x[:3], TARGETS)), ValueError,
        r"13 knots.*\(3,\)",
    ),
    "too few directions": (
        lambda: point_gimbal(DRONE, FLIGHT, target=LineOfSight(jnp.ones((4, 3)))), ValueError, r"13 knots.*\(4, 3\)"
    ),
    "depression in rad out of range": (
        lambda: LineOfSight.from_degrees(azimuth=0.0, depression=100.0), ValueError, "depression.*deg"
    ),
    "single precision": (
        lambda: point_gimbal(SENSOR, SHOT, target=LineOfSight(np.array([1.0, 0.0, 0.0], np.float32))), TypeError,
        "float32",
    ),
    "targets in a batch": (lambda: point_gimbal(SENSOR, SHOT, target=TARGETS), ValueError, "vmap"),
    "many pixels": (lambda: point_gimbal(SENSOR, SHOT, target=RING, uv=np.zeros((2, 2))), ValueError, "vmap"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(name):
    ask, kind, words = MISTAKES[name]
    with pytest.raises((kind, TypeCheckError)) as refused:  # the checker of types is on in tests, not for users
        ask()
    assert isinstance(refused.value, TypeCheckError) or re.search(words, str(refused.value), flags=re.DOTALL)

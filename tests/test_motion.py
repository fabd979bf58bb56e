"""Images taken in motion: pixel to ground and back row by row, derivatives, and points that no row sees."""

from __future__ import annotations

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import fractal_posts

from jaxgeo import (
    Atmosphere,
    ConstantHeight,
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    PushbroomCamera,
    RollingShutterCamera,
    Sensor,
    Shot,
    Status,
    Trajectory,
    at_range,
    locate,
    project,
)
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.sensor.conventions import R_HEAD_FROM_CAMERA_LI_2023, li_2023_sweep_sensor
from jaxgeo.terrain import TangentGrid

pytestmark = pytest.mark.costly

CENTRE = Geodetic.from_degrees(lat=29.2, lon=88.9, height=0.0)
SIZE = 129
START = 418_000.0  # s of a GPS week: a time of many digits


def ground(spacing: float, relief: float, base: float = 0.0) -> Dem:
    posts = base + fractal_posts(SIZE, spacing=spacing, relief=relief, exponent=3.0, seed=4)
    return Dem.from_array(posts, TangentGrid.centred(CENTRE, spacing=(spacing, spacing), shape=posts.shape))


def flown(
    *, east: float, north: float, height: float, speed: float, heading_deg: float, rates_deg, readings, span: float
):
    """A flight of `span` s about START whose attitude swings by so many deg/s at most, in three frequencies."""
    times = START + np.linspace(-0.1, 1.1, 61) * span
    since = times - START
    heading = np.deg2rad(heading_deg)
    axes, origin = np.asarray(R_ecef_from_enu(CENTRE)), np.asarray(WGS84.to_ecef(CENTRE))
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    enu = np.array([east, north, height]) + since[:, None] * speed * along
    position = jax.vmap(WGS84.to_geodetic)(jnp.asarray(origin + enu @ axes.T))
    swing = [
        np.deg2rad(r) / w * np.sin(w * since + k)
        for k, (r, w) in enumerate(zip(rates_deg, (2.1, 3.7, 5.3), strict=True))
    ]
    pose = Pose(position, heading + swing[0], np.deg2rad(1.0) + swing[1], swing[2])
    return Trajectory.from_knots(times, pose, np.tile(readings, (len(times), 1)))


SWEEP = li_2023_sweep_sensor(
    focal_length=1.9,
    pixel_pitch=8e-6,
    width=7584,
    height=48836,
    scan_start=np.deg2rad(-6.44),
    scan_end=np.deg2rad(-18.21),
    duration=2.0,
)
DRONE = {"east": 300.0, "north": -250.0, "height": 400.0, "heading_deg": 70.0, "rates_deg": (5.0, 5.0, 5.0)}
LINES = PushbroomCamera.from_metric(
    focal_length=0.012, pixel_pitch=8e-6, width=1200, height=800, line_time=2.5e-3, principal_point=(2e-5, -3e-4)
)
ROLLING = RollingShutterCamera.from_readout(
    FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000), readout_time=0.03
)
ACROSS = Mount(np.eye(3), R_HEAD_FROM_CAMERA_LI_2023)
LEVER = Mount.nadir(lever_body=np.array([1.2, -0.3, 0.8]), lever_head=np.array([0.1, 0.05, 0.2]))
SCENES = {
    "sweep": (
        SWEEP,
        flown(
            east=10e3,
            north=-60e3,
            height=15409.0,
            speed=220.0,
            heading_deg=-102.44,
            rates_deg=(0.3, 0.5, 1.0),
            readings=[np.pi / 2, np.deg2rad(-0.7)],
            span=2.0,
        ),
        ground(1000.0, 3000.0, base=3000.0),
    ),
    "pushbroom": (
        Sensor(LINES, Gimbal.two_axis(), LEVER),
        flown(**DRONE, speed=60.0, readings=[0.35, 0.1], span=2.0),
        ground(20.0, 80.0),
    ),
    "rolling shutter": (
        Sensor(ROLLING, Gimbal.two_axis(), LEVER),
        flown(**DRONE, speed=15.0, readings=[0.6, -0.1], span=0.03),
        ground(20.0, 80.0),
    ),
}


def one_by_one(function, items):
    """Results of `function` for each item, stacked; single calls compile in half the time of a batch."""
    count = len(jax.tree.leaves(items)[0])
    found = [function(jax.tree.map(lambda x, k=k: np.asarray(x)[k], items)) for k in range(count)]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


def located(sensor, flight, uv, terrain):
    return one_by_one(lambda pixel: locate(sensor, flight, pixel, terrain, time=START), uv)


def projected(sensor, flight, points):
    return one_by_one(lambda point: project(sensor, flight, point, time=START), points)


projected_over = jax.jit(jax.vmap(lambda s, m, p, t: project(s, m, p, time=START, terrain=t), (None, None, 0, None)))


def some_pixels(camera, count: int = 64) -> np.ndarray:
    rng = np.random.default_rng(8)
    return rng.uniform([-0.49, -0.49], [camera.width - 0.51, camera.height - 0.51], (count, 2))


@pytest.mark.parametrize(
    "name", [name if name == "sweep" else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_from_pixel_to_level_ground_and_back(name):
    sensor, flight, _ = SCENES[name]
    uv = some_pixels(sensor.camera)
    fixes = located(sensor, flight, uv, ConstantHeight(40.0))
    back = projected(sensor, flight, fixes.position)
    assert np.all(fixes.ok)
    assert np.all(back.ok)
    np.testing.assert_allclose(back.uv, uv, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_from_pixel_to_rough_ground_and_back(name):
    sensor, flight, terrain = SCENES[name]
    uv = some_pixels(sensor.camera)
    fixes = located(sensor, flight, uv, terrain)
    assert np.mean(np.asarray(fixes.ok)) > 0.9
    assert np.std(np.asarray(fixes.position.height)[np.asarray(fixes.ok)]) > 5.0  # rough it is
    back = projected(sensor, flight, fixes.position)
    ok = np.asarray(fixes.ok)
    assert np.all(np.asarray(back.status)[ok] == Status.hit)
    np.testing.assert_allclose(np.asarray(back.uv)[ok], uv[ok], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_no_ground_that_a_sweep_sees_is_hidden():
    sensor, flight, terrain = SCENES["sweep"]
    fixes = located(sensor, flight, some_pixels(sensor.camera), terrain)
    back = projected_over(sensor, flight, fixes.position, terrain)
    assert np.all(np.asarray(back.status)[np.asarray(fixes.ok)] == Status.hit)


@pytest.mark.slow
def test_what_comes_back_is_inverse_to_first_order():
    """d pixel / d ground times d ground / d pixel is one."""
    sensor, flight, _ = SCENES["sweep"]
    level = ConstantHeight(3500.0)

    def there(uv):
        fix = locate(sensor, flight, uv, level, time=START)
        return fix.position, fix.ok

    def both(uv):
        (position, ok), J = there(uv), jax.jacfwd(lambda uv: there(uv)[0])(uv)
        back = jax.jacrev(lambda p: project(sensor, flight, p, time=START).uv)(position)
        return ok, jnp.outer(back.lat, J.lat) + jnp.outer(back.lon, J.lon) + jnp.outer(back.height, J.height)

    ok, product = jax.jit(jax.vmap(both))(jnp.asarray(some_pixels(sensor.camera, 4)))
    assert np.all(ok)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), (4, 2, 2)), rtol=0, atol=1e-7)


PARAMETERS = {"time": 1e-3, "line_time": 1e-9, "velocity": 1e-1, "body rates": 1e-4, "gimbal rates": 1e-4}


@pytest.mark.slow
def test_derivatives_by_time_tag_velocity_and_rates_equal_differences():
    """Of the ground under a pixel of the sweep, and of the pixel of a point, by all that says how it moves."""
    shot = SCENES["sweep"][1].at(START)
    level, uv = ConstantHeight(3500.0), jnp.array([300.0, 30_000.0])
    given = {
        "time": jnp.asarray(0.0),
        "line_time": SWEEP.camera.line_time,
        "velocity": jnp.array([-47.0, -214.0, 2.0]),
        "body rates": jnp.deg2rad(jnp.array([5.0, -5.0, 5.0])),
        "gimbal rates": jnp.array([0.02, -0.01]),
    }

    def flight(given):
        moving = {"velocity_ned": given["velocity"], "body_rates": given["body rates"]}
        still = Shot(shot.pose, shot.gimbal_readings, jnp.asarray(0.0))
        motion = Trajectory.steady(still, **moving, gimbal_rates=given["gimbal rates"], before=0.5, after=3.0)
        return eqx.tree_at(lambda s: s.camera.line_time, SWEEP, given["line_time"]), motion

    def ground(given):
        return locate(*flight(given), uv, level, time=given["time"]).ecef

    point = locate(*flight(given), uv, level, time=given["time"]).position

    def pixel(given):
        return project(*flight(given), point, time=given["time"]).uv

    for answer in (ground, pixel):  # m, px
        J, value = jax.jit(jax.jacfwd(answer))(given), jax.jit(answer)
        for name, step in PARAMETERS.items():
            for k in range(given[name].size):
                unit = step * jnp.reshape(jnp.arange(given[name].size) == k, given[name].shape)
                a, b, c, d = (value({**given, name: given[name] + n * unit}) for n in (-2, -1, 1, 2))
                difference = (8.0 * (c - b) - (d - a)) / 12.0
                predicted = np.tensordot(J[name], unit, axes=unit.ndim)
                assert np.max(np.abs(predicted)) > 1e-4, name
                np.testing.assert_allclose(predicted, difference, rtol=0, atol=1e-6, err_msg=name)


@pytest.mark.slow
def test_derivatives_by_every_knot_equal_differences():
    """Of the pixel of a point that the sweep sees: all that is in its trajectory, two knots on each side."""
    sensor, flight, _ = SCENES["sweep"]
    uv = jnp.array([5000.0, 20_000.0])
    point = locate(sensor, flight, uv, ConstantHeight(3500.0), time=START).position

    def pixel(moved):
        return project(sensor, moved, point, time=START).uv

    J, value = jax.jit(jax.jacrev(pixel))(flight), jax.jit(pixel)
    exposed = float(START + sensor.camera.time_of(uv))
    near = int(np.searchsorted(np.asarray(flight.times), exposed)) + np.arange(-2, 2)
    steps = {"times": 1e-4, "lat": 1e-8, "lon": 1e-8, "height": 0.01, "heading": 1e-6, "pitch": 1e-6, "roll": 1e-6}
    leaves = jax.tree_util.tree_leaves_with_path(flight)
    for number, ((path, leaf), slope) in enumerate(zip(leaves, jax.tree.leaves(J), strict=True)):
        slope, step = np.asarray(slope), steps.get(path[-1].name, 1e-6)
        others = np.delete(slope, near, axis=1)
        assert not np.any(others), path
        for knot in near:
            unit = np.zeros(leaf.shape)
            unit[knot] = step

            def moved(n, number=number, unit=unit):
                changed = [x + n * unit if k == number else x for k, (_, x) in enumerate(leaves)]
                return value(jax.tree.unflatten(jax.tree.structure(flight), changed))

            difference = (8.0 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / 12.0
            predicted = np.tensordot(slope, unit, axes=unit.ndim)
            np.testing.assert_allclose(predicted, difference, rtol=0, atol=1e-6, err_msg=str(path))  # px


@pytest.mark.slow
def test_a_camera_at_rest_and_a_frame_on_a_trajectory_are_their_shots():
    """What a sweep from a still platform sees, its shot has at the same pixel; a frame sees at the image's time."""
    _, flight, _ = SCENES["sweep"]
    shot = flight.at(START, 0.4)
    at_rest = Trajectory.steady(shot, velocity_ned=[0.0, 0.0, 0.0], before=1.0, after=4.0)
    level, uv = ConstantHeight(3500.0), jnp.asarray(some_pixels(SWEEP.camera, 8))
    found = jax.jit(jax.vmap(lambda uv: locate(SWEEP, at_rest, uv, level, time=at_rest.start + 1.0)))(uv)
    assert np.all(found.ok)
    back = jax.jit(jax.vmap(lambda p: project(SWEEP, shot, p)))(found.position)
    np.testing.assert_allclose(back.uv, uv, rtol=0, atol=1e-6)
    frame = Sensor(ROLLING.frame, SWEEP.gimbal, SWEEP.mount)
    eye, readings = at_rest.at(shot.time), [1.3, 0.0]
    seen_at = jax.jit(lambda motion: locate(frame, motion, (10.0, 20.0), level, time=shot.time))
    seen_from = jax.jit(lambda still: locate(frame, still, (10.0, 20.0), level))
    a, b = seen_at(flight.with_readings(readings)), seen_from(Shot(flight.at(shot.time).pose, readings))
    np.testing.assert_allclose(a.ecef, b.ecef, rtol=0, atol=1e-7)
    assert eye.time == shot.time


@pytest.mark.slow
def test_a_sweep_is_a_line_whose_frame_turns():
    """Li et al. scan with the outer frame: with an inner angle of zero that is a line on a gimbal that turns."""
    _, flight, _ = SCENES["sweep"]
    camera = SWEEP.camera
    line = PushbroomCamera(optics=camera.optics, rows=camera.rows, line_time=camera.line_time)
    row = (flight.times - START) / camera.line_time
    outer = jnp.pi / 2.0 - jax.vmap(camera.scan_angle)(row)
    turning = flight.with_readings(jnp.stack([outer, 0.0 * outer], axis=1))
    uv, level = jnp.array([[100.0, 5.0], [7000.0, 40_000.0]]), ConstantHeight(3500.0)
    sweep = jax.vmap(lambda p: locate(SWEEP, flight.with_readings([np.pi / 2, 0.0]), p, level, time=START))(uv)
    lines = jax.vmap(lambda p: locate(Sensor(line, SWEEP.gimbal, ACROSS), turning, p, level, time=START))(uv)
    np.testing.assert_allclose(sweep.ecef, lines.ecef, rtol=0, atol=1e-6)
    back = jax.vmap(lambda p: project(Sensor(line, SWEEP.gimbal, ACROSS), turning, p, time=START))(lines.position)
    np.testing.assert_allclose(back.uv, uv, rtol=0, atol=1e-6)


def test_lines_of_a_steady_pushbroom_lie_as_far_apart_as_the_platform_flies():
    shot = Shot(Pose.from_degrees(lat=50.0, lon=8.0, height=1000.0))
    flight = Trajectory.steady(shot, velocity_ned=[60.0, 0.0, 0.0], after=3.0)
    sensor = Sensor(PushbroomCamera.from_metric(**NADIR), Gimbal.fixed())
    hit = jax.jit(lambda row: locate(sensor, flight, jnp.stack([999.5, row]), ConstantHeight(0.0)).ecef)
    fixes = [hit(row) for row in (0.0, 500.0, 1000.0)]
    apart = [float(jnp.linalg.norm(b - a)) for a, b in itertools.pairwise(fixes)]
    np.testing.assert_allclose(apart, 60.0, rtol=0, atol=1e-6)  # straight on, without a turn: all lines are parallel


NADIR = {"focal_length": 0.05, "pixel_pitch": 5e-6, "width": 2000, "height": 1200, "line_time": 2e-3}


@pytest.mark.slow
def test_points_no_row_sees_are_told_from_those_beside_the_image_and_outside_the_records():
    shot = Shot(Pose.from_degrees(lat=50.0, lon=8.0, height=1000.0))
    flight = Trajectory.steady(shot, velocity_ned=[60.0, 0.0, 0.0], before=1.0, after=4.0)
    sensor = Sensor(PushbroomCamera.from_metric(**NADIR), Gimbal.fixed())

    def where(north: float, east: float, height: float = 0.0):
        return Geodetic(lat=np.deg2rad(50.0) + north / 6.3746e6, lon=np.deg2rad(8.0) + east / 4.1065e6, height=height)

    seen = jax.jit(lambda point, time: project(sensor, flight, point, time=time))
    cases = {
        "in the image": (where(70.0, 20.0), 0.0, Status.hit),
        "to its side": (where(70.0, 120.0), 0.0, Status.outside_image),
        "just beyond its last row": (where(150.0, 0.0), 0.0, Status.outside_image),
        "ahead": (where(400.0, 0.0), 0.0, Status.never_seen),
        "behind": (where(-400.0, 0.0), 0.0, Status.never_seen),
        "overhead": (where(400.0, 0.0, 3000.0), 0.0, Status.behind_camera),
        "after the last record": (where(330.0, 0.0), 3.0, Status.outside_trajectory),
        "far from the records": (where(0.0, 0.0), 1e4, Status.outside_trajectory),
        "before them": (where(0.0, 0.0), -1e4, Status.outside_trajectory),
        "nowhere": (where(np.nan, 0.0), 0.0, Status.invalid_input),
        "at no time": (where(0.0, 0.0), np.nan, Status.invalid_input),
    }
    for name, (point, time, expected) in cases.items():
        answer = seen(jax.tree.map(jnp.asarray, point), jnp.asarray(time))
        assert Status(int(answer.status)) == expected, name
        assert bool(jnp.all(jnp.isfinite(answer.uv))) == (expected in (Status.hit, Status.outside_image)), name

    located = jax.jit(lambda uv, time: locate(sensor, flight, uv, ConstantHeight(0.0), time=time).status)
    for uv, time, expected in (
        ([5.0, 5.0], 0.0, Status.hit),
        ([5.0, 1199.4], 1.7, Status.outside_trajectory),
        ([5.0, 5.0], 9.0, Status.outside_trajectory),
        ([5.0, np.nan], 0.0, Status.invalid_input),
        ([5.0, 5.0], np.nan, Status.invalid_input),
        ([5.0, 1300.0], 0.0, Status.outside_image),
    ):
        assert Status(int(located(jnp.array(uv), jnp.asarray(time)))) == expected

    def total(flight, sensor):  # whatever fails, gradients are finite
        points = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v, float) for v in x]), *(c[0] for c in cases.values()))
        times = jnp.array([c[1] for c in cases.values()])
        answers = jax.vmap(lambda p, t: project(sensor, flight, p, time=t))(points, times)
        return jnp.sum(jnp.where(answers.ok[:, None], answers.uv, 0.0))

    slope = jax.jit(jax.grad(total, argnums=(0, 1)))
    gradient, by_sensor = slope(flight, sensor)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves((gradient, by_sensor)))
    assert float(jnp.linalg.norm(gradient.poses.heading)) > 0.0
    lost = eqx.tree_at(lambda f: f.times, flight, jnp.full_like(flight.times, jnp.nan))
    assert all(bool(jnp.all(leaf == 0.0)) for leaf in jax.tree.leaves(slope(lost, sensor)))


@pytest.mark.slow
def test_where_the_motion_turns_back_over_the_ground_the_first_row_answers():
    """A pitch that swings faster than the platform flies: ground is seen three times, and each time is a true one."""
    since = np.linspace(-0.5, 3.0, 141)
    north = np.deg2rad(50.0) + 60.0 * since / 6.3756e6
    pitch = np.deg2rad(3.0) * np.sin(2.0 * np.pi * since / 1.2)
    pose = Pose(
        Geodetic(lat=north, lon=np.full(141, 0.14), height=np.full(141, 1000.0)), 0.0 * since, pitch, 0.0 * since
    )
    flight = Trajectory.from_knots(since, pose)
    sensor, level = Sensor(PushbroomCamera.from_metric(**NADIR), Gimbal.fixed()), ConstantHeight(0.0)
    rows = jnp.linspace(0.0, 1199.0, 241)
    uv = jnp.stack([jnp.full(241, 700.0), rows], axis=1)
    fixes = jax.jit(jax.vmap(lambda p: locate(sensor, flight, p, level)))(uv)
    back = jax.jit(jax.vmap(lambda p: project(sensor, flight, p)))(fixes.position)
    assert np.all(back.ok)
    again = jax.jit(jax.vmap(lambda p: locate(sensor, flight, p, level)))(back.uv)
    np.testing.assert_allclose(again.position.lat, fixes.position.lat, rtol=0, atol=1e-6 / 6.4e6)
    earlier = np.asarray(rows - back.uv[:, 1])
    later = earlier < -1e-6  # but for a point over which the line only just turns
    assert np.mean(later) < 0.01
    turning = np.abs(np.gradient(np.asarray(fixes.position.lat), 5.0)) * 6.4e6  # m a row
    assert np.all(turning[later] < 0.02 * np.max(turning))
    assert np.mean(earlier > 1.0) > 0.2  # it does turn back
    ground = np.asarray(fixes.position.lat)
    for k in np.flatnonzero(~later)[::8]:  # no row before the answer sees the point: north of it always, or south
        before = np.asarray(rows) < float(back.uv[k, 1]) - 5.0
        assert np.ptp(np.sign(ground[before] - ground[k])) == 0 if np.any(before) else True


@pytest.mark.slow
def test_a_lively_flight_is_seen_by_every_row_that_sees():
    """Many swings within one exposure, ground that is seen several times, also off the side of the image."""
    since = np.arange(-0.5, 10.5, 0.05)
    swing = [np.deg2rad(a) * np.sin(2.0 * np.pi * since / p) for a, p in ((5.0, 2.0), (4.0, 1.1), (8.0, 1.7))]
    north = 0.87 + 8.0 * since / 6.375e6
    position = Geodetic(lat=north, lon=np.full(since.size, 0.14), height=np.full(since.size, 100.0))
    heading, pitch, roll = swing
    flight = Trajectory.from_knots(since, Pose(position, heading, pitch, roll))
    camera = PushbroomCamera.from_metric(
        focal_length=0.012, pixel_pitch=1e-5, width=1000, height=4000, line_time=2.5e-3, principal_point=(0.0, -1e-3)
    )
    sensor, level, air = Sensor(camera, Gimbal.fixed()), ConstantHeight(0.0), Atmosphere()

    def there_and_back(uv):
        fix = locate(sensor, flight, uv, level, atmosphere=air)
        back = project(sensor, flight, fix.position, atmosphere=air)
        again = locate(sensor, flight, back.uv, level, atmosphere=air)
        return fix.ok, back, jnp.linalg.norm(again.ecef - fix.ecef)

    uv = jnp.asarray(some_pixels(camera, 300))
    ok, back, apart = jax.jit(jax.vmap(there_and_back))(uv)
    assert np.all(ok)
    assert np.mean(back.ok) > 0.98  # of more than three crossings those on the image may come last
    assert np.all(np.asarray(apart)[np.asarray(back.ok)] < 1e-6)
    assert np.mean(np.asarray(back.uv[:, 1] < uv[:, 1] - 1.0)) > 0.1


@pytest.mark.slow
def test_through_the_air_in_motion():
    sensor, flight, _ = SCENES["sweep"]
    air, level = Atmosphere.measured(pressure=60_000.0, temperature=275.0, height=4000.0), ConstantHeight(3500.0)

    def there_and_back(uv):
        fix = locate(sensor, flight, uv, level, time=START, atmosphere=air)
        straight = locate(sensor, flight, uv, level, time=START)
        back = project(sensor, flight, fix.position, time=START, atmosphere=air)
        same = at_range(sensor, flight, uv, fix.slant_range, time=START, atmosphere=air)
        return back, jnp.linalg.norm(fix.ecef - straight.ecef), jnp.linalg.norm(same.ecef - fix.ecef)

    uv = jnp.asarray(some_pixels(sensor.camera, 8))
    back, shift, apart = jax.jit(jax.vmap(there_and_back))(uv)
    assert np.all(back.ok)
    np.testing.assert_allclose(back.uv, uv, rtol=0, atol=1e-6)
    assert np.all((np.asarray(shift) > 5.0) & (np.asarray(shift) < 3000.0))
    assert np.all(np.asarray(apart) < 1e-6)


@pytest.mark.slow
def test_the_sweep_as_one_frame_is_far_off():
    """What ignoring the motion costs: metres per row that the platform flies and turns after the shot."""
    sensor, flight, _ = SCENES["sweep"]
    level = ConstantHeight(3500.0)
    uv = jnp.stack([jnp.full(5, 3791.5), jnp.linspace(0.0, 48835.0, 5)], axis=1)
    moving = jax.vmap(lambda p: locate(sensor, flight, p, level, time=START))(uv)
    frame = jax.vmap(lambda p: locate(sensor, flight.at(START), p, level))(uv)
    off = np.linalg.norm(moving.ecef - frame.ecef, axis=1)
    assert off[0] < 1e-5
    assert np.all(off[1:] > 50.0)
    assert np.max(off) > 500.0


def test_what_cannot_be_asked_is_refused():
    sensor, flight, _ = SCENES["rolling shutter"]
    level = ConstantHeight(0.0)
    with pytest.raises(ValueError, match="time goes with a Trajectory"):
        locate(sensor, flight.at(START), (0.0, 0.0), level, time=START)
    with pytest.raises(ValueError, match="one number in s"):
        locate(sensor, flight, (0.0, 0.0), level, time=jnp.array([START, START]))
    with pytest.raises(ValueError, match="outside_trajectory"):
        locate(sensor, flight, (0.0, 0.0), level, throw=True)

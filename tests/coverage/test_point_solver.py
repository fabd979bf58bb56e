"""Pointing by optimistix: the readings, statuses and derivatives of the package's own solver, one call or a batch."""

from __future__ import annotations

import dataclasses
import functools
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from test_point import (
    AIR,
    COUNT,
    DEM,
    EVERY,
    FLIGHT,
    LENS,
    LEVEL,
    RING,
    SENSORS,
    SINGULAR,
    Looks,
    asked,
    compensated,
    in_numpy,
    narrow_limits,
    random_attitudes,
    random_looks,
)

from jaxgeo import Geodetic, Gimbal, Mount, Pose, Sensor, Shot, Status
from jaxgeo.coverage import FixedNewton, LineOfSight, compensate, point_gimbal
from jaxgeo.earth import WGS84
from jaxgeo.sensor.root_finder import default_root_finder

TIGHT = {"rtol": jnp.asarray(1e-10), "atol": jnp.asarray(1e-10)}  # as arrays: other tolerances compile nothing anew
SOLVERS = {
    "Newton, SVD": optx.Newton(**TIGHT, linear_solver=lx.SVD(rcond=1e-7)),
    "Newton": optx.Newton(**TIGHT),
    "Chord": optx.Chord(**TIGHT),
    "Levenberg-Marquardt": optx.LevenbergMarquardt(**TIGHT),
    "dogleg": optx.Dogleg(**TIGHT),
}
SAME = 1e-9  # rad


@in_numpy
def batch(sensor, looks, solver, air=None, terrain=None):
    def one(look):
        held = eqx.tree_at(lambda s: s.gimbal.limits, sensor, look.limits)
        return point_gimbal(
            held, Shot(look.pose), target=look.target, uv=look.uv, atmosphere=air, terrain=terrain, solver=solver
        )

    return jax.vmap(one)(looks)


def alone(sensor, looks, lane, **more):
    look = jax.tree.map(lambda x: x[lane], looks)
    held = eqx.tree_at(lambda s: s.gimbal.limits, sensor, look.limits)
    return point_gimbal(held, Shot(look.pose), target=look.target, uv=look.uv, **more)


def assert_same(found, expected):
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.readings, expected.readings, rtol=0, atol=SAME)
    np.testing.assert_allclose(found.miss, expected.miss, rtol=0, atol=SAME)


def half_narrow(sensor):
    """Looks of which half have narrow limits, most of them out of reach."""
    looks = random_looks(sensor, seed=3)
    narrow = narrow_limits(sensor.gimbal, np.random.default_rng(13))
    return eqx.tree_at(lambda x: x.limits, looks, looks.limits.at[1::2].set(jnp.asarray(narrow[1::2])))


TABLE = [
    pytest.param(name, solver, marks=pytest.mark.slow)
    for name in EVERY
    for solver in SOLVERS
    if len(EVERY[name].gimbal.axes) > 1 or solver != "Newton"
]  # of one axis and two equations, Newton's default linear solver needs a square system


@pytest.mark.parametrize("name, solver", TABLE)
def test_a_batch_by_any_solver_is_what_ours_finds(name, solver):
    looks = half_narrow(EVERY[name])
    ours = asked(EVERY[name], looks)[0]
    assert {Status.outside_gimbal_range} <= set(ours.status.tolist())
    assert_same(batch(EVERY[name], looks, SOLVERS[solver]), ours)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_a_call_alone_is_its_lane_of_a_batch(name):
    looks = half_narrow(EVERY[name])
    looks = eqx.tree_at(lambda x: x.pose.heading, looks, looks.pose.heading.at[4].set(jnp.nan))
    looks = eqx.tree_at(lambda x: x.uv, looks, looks.uv.at[6].set(jnp.array([1e7, 0.0])))
    ours = asked(EVERY[name], looks)[0]
    assert ours.status[4] == Status.invalid_input
    assert ours.status[6] == Status.outside_image
    for lane in range(12):
        assert_same(alone(EVERY[name], looks, lane), jax.tree.map(lambda x, k=lane: x[k], ours))


@pytest.mark.slow
def test_a_call_alone_by_a_solver_is_its_lane_of_a_batch():
    looks = half_narrow(SENSORS["two axes"])
    ours = asked(SENSORS["two axes"], looks)[0]
    for lane in range(12):
        found = alone(SENSORS["two axes"], looks, lane, solver=SOLVERS["Levenberg-Marquardt"])
        assert_same(found, jax.tree.map(lambda x, k=lane: x[k], ours))


@pytest.mark.slow
def test_through_the_air_and_behind_terrain_a_call_alone_is_its_lane():
    sensor = SENSORS["pan and tilt, geared"]
    looks = random_looks(sensor, seed=5)
    ours = asked(sensor, looks, AIR, DEM)[0]
    hidden = np.flatnonzero(ours.status == Status.hidden_by_terrain)[:2]
    for lane in (0, 1, 2, *hidden.tolist()):
        found = alone(sensor, looks, lane, atmosphere=AIR, terrain=DEM)
        assert_same(found, jax.tree.map(lambda x, k=lane: x[k], ours))


ALONG_AN_AXIS = {name: pytest.mark.slow if "pan and tilt" in name else () for name in SINGULAR}


@pytest.mark.oldest
@pytest.mark.costly
@pytest.mark.parametrize("name", [pytest.param(name, marks=marks) for name, marks in ALONG_AN_AXIS.items()])
def test_alone_too_an_axis_along_the_line_of_sight_stays_where_it_is(name):
    sensor, ned, start, expected = SINGULAR[name]
    for turn in (0.0, 1e-12, 1e-9, 1e-6, 1e-3):
        aside = np.array(ned) + turn * np.array([0.0, 0.64, 0.48])
        asked = functools.partial(
            point_gimbal, sensor, Shot(LEVEL), target=LineOfSight(aside), readings=np.array(start)
        )
        found, ours = asked(), asked(solver=FixedNewton())
        assert found.status == ours.status
        assert abs(found.miss - ours.miss) < SAME
        if turn == 0.0:
            np.testing.assert_allclose(found.readings, expected, rtol=0, atol=1e-8)


@pytest.mark.costly
def test_compensation_alone_is_that_of_a_batch():
    sensor, (before, after) = SENSORS["two axes"], random_attitudes(seed=6)
    many = compensated(sensor, before, after)[0]
    for lane in range(5):
        shot, pose, expected = jax.tree.map(lambda x, k=lane: x[k], (before, after, many))
        assert_same(compensate(sensor, shot, Shot(pose)), expected)


@pytest.mark.slow
def test_compensation_by_a_solver_is_that_of_a_batch():
    sensor, (before, after) = SENSORS["two axes"], random_attitudes(seed=6)
    many = compensated(sensor, before, after)[0]
    for lane in range(5):
        shot, pose, expected = jax.tree.map(lambda x, k=lane: x[k], (before, after, many))
        assert_same(compensate(sensor, shot, Shot(pose), solver=SOLVERS["Levenberg-Marquardt"]), expected)


@pytest.mark.slow
def test_a_flight_by_a_solver_is_that_by_ours():
    drone = SENSORS["three axes, level"]
    assert_same(
        point_gimbal(drone, FLIGHT, target=RING, solver=SOLVERS["Newton, SVD"]),
        point_gimbal(drone, FLIGHT, target=RING),
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver, order",
    [
        (SOLVERS["Newton, SVD"], 1),
        pytest.param(FixedNewton(), 1, marks=pytest.mark.slow),
        pytest.param(SOLVERS["Newton, SVD"], 2, marks=pytest.mark.slow),
        pytest.param(FixedNewton(), 2, marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_those_of_the_implicit_function(solver, order):
    """Of a root of `Sensor.to_camera`: by a linear system, or, of second order, by optimistix's own adjoint."""
    sensor = SENSORS["two axes"]
    looks = random_looks(sensor, seed=3)
    look = jax.tree.map(lambda x: x[2], looks)
    start = alone(sensor, looks, 2)
    assert start.ok

    def changed(change):
        pose = dataclasses.replace(look.pose, heading=look.pose.heading + change[0], roll=look.pose.roll + change[1])
        return pose, dataclasses.replace(look.target, height=look.target.height + 100.0 * change[2])

    def readings(change):
        pose, target = changed(change)
        return point_gimbal(sensor, Shot(pose), target=target, uv=look.uv, solver=solver).readings

    def residual(angles, change):
        x, y, z = LENS.ray(look.uv)[0]
        pose, target = changed(change)
        sight = sensor.to_camera(Shot(pose, angles), WGS84.to_ecef(target))
        return sight[:2] / sight[2] - jnp.stack([x, y]) / z

    def by_their_adjoint(change):
        return optx.root_find(residual, SOLVERS["Newton"], start.readings, change).value

    if order == 1:
        ours = np.asarray(jax.jit(jax.jacfwd(readings))(jnp.zeros(3)))
        by_angles, by_change = jax.jit(jax.jacfwd(residual, (0, 1)))(start.readings, jnp.zeros(3))
        expected = -np.linalg.solve(by_angles, by_change)
    else:
        ours, expected = (
            np.asarray(jax.jit(jax.jacfwd(jax.jacrev(way)))(jnp.zeros(3))) for way in (readings, by_their_adjoint)
        )
    assert np.max(np.abs(ours)) > 0.01
    np.testing.assert_allclose(ours, expected, rtol=1e-8, atol=1e-9)


# A target so near that the closed form, which knows no lever arms, is off by degrees.
LONG_ARM = Sensor(
    LENS, Gimbal.two_axis(), Mount.nadir(lever_body=np.array([3.0, -1.0, 0.5]), lever_head=np.array([2.0, 1.0, 0.0]))
)
LOW = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=30.0))
CLOSE_BY = Geodetic.from_degrees(lat=47.0, lon=11.0001, height=26.0)


LOOSE = {"rtol": jnp.asarray(1e3), "atol": jnp.asarray(1e3)}  # content after one step


@pytest.mark.costly
@pytest.mark.parametrize(
    "call, solver",
    [
        (lambda *given, solver: alone(*given, 0, solver=solver), optx.Newton(**LOOSE)),
        pytest.param(batch, optx.Newton(**LOOSE, linear_solver=lx.SVD(rcond=1e-7)), marks=pytest.mark.slow),
    ],
    ids=["alone", "batch"],
)
def test_a_solver_that_ends_off_a_target_in_reach_has_not_converged(call, solver):
    """Alone and in a batch, by programs that are compiled for other tests."""
    look = Looks(LOW.pose, CLOSE_BY, LENS.principal_px, LONG_ARM.gimbal.limits)
    looks = jax.tree.map(lambda x: jnp.broadcast_to(x, (COUNT, *jnp.shape(x))), look)
    assert alone(LONG_ARM, looks, 0).ok
    found = call(LONG_ARM, looks, solver=solver)
    assert np.all(found.status == Status.not_converged)
    assert np.all(np.isnan(found.readings))
    assert np.all(np.isnan(found.miss))


@pytest.mark.parametrize("solver", ["newton", optx.Newton, optx.BFGS(rtol=1e-9, atol=1e-9), 1e-9])
def test_what_is_no_solver_is_refused(solver):
    with pytest.raises(TypeError, match=r"solver must be an optimistix root finder.*FixedNewton"):
        point_gimbal(LONG_ARM, LOW, target=CLOSE_BY, solver=solver)


@pytest.mark.costly
def test_batches_load_no_solver_that_nothing_asked_for():
    code = """
import sys, jax, numpy as np, jaxgeo
jaxgeo.enable_x64()
sensor = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000),
    jaxgeo.Gimbal.two_axis(),
    jaxgeo.Mount.nadir(),
)
pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=3000.0)
target = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
point = lambda p: jaxgeo.coverage.point_gimbal(sensor, jaxgeo.Shot(p), target=target)
jax.eval_shape(point, pose)
print("optimistix" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"]
    assert type(default_root_finder()).__module__.startswith("optimistix")

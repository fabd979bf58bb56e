"""Exposure times of many points of one image: by few samples where that is proven to be enough, else by all."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo.sensor import exposure
from jaxgeo.sensor.delay import Scene
from jaxgeo.sensor.steady_exposure import BLOCK, search_missed, steady_moment
from jaxgeo.status import Status

KNOTS = np.linspace(-1.0, 9.0, 21)  # s
LENS = jaxgeo.BrownConrady(k1=-0.05, k2=0.01)
CAMERAS = {
    "pushbroom": jaxgeo.PushbroomCamera.from_metric(
        focal_length=0.1, pixel_pitch=1e-5, width=6000, height=4000, line_time=2e-3, distortion=LENS
    ),
    "whiskbroom": jaxgeo.WhiskbroomCamera.from_metric(
        focal_length=0.1, pixel_pitch=1e-5, width=2000, height=4000, scan_start=-0.4, scan_end=0.5, duration=8.0
    ),
    "rolling shutter": jaxgeo.RollingShutterCamera.from_readout(
        jaxgeo.FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000), readout_time=0.03
    ),
}


def flight(unrest: float, seed: int = 0) -> jaxgeo.Trajectory:
    """Straight on at 60 m/s and 2000 m, with independent attitudes of some rad at records half a second apart."""
    lat = 47.0 + KNOTS * 60.0 / 111e3
    position = jaxgeo.Geodetic.from_degrees(lat=lat, lon=np.full(21, 11.0), height=np.full(21, 2000.0))
    turns = unrest * np.random.default_rng(seed).normal(size=(3, 21))
    return jaxgeo.Trajectory.from_knots(KNOTS, jaxgeo.Pose(position, *turns), np.zeros((21, 0)))


def points(count: int = 3 * BLOCK - 5) -> jax.Array:
    """Under, beside, ahead of and behind the flight, a few above it and one nowhere, in ECEF m."""
    random = np.random.default_rng(1)
    north, east = random.uniform(-1500.0, 2000.0, count), random.uniform(-1500.0, 1500.0, count)
    height = np.where(np.arange(count) % 40 == 0, 2500.0, random.uniform(0.0, 400.0, count))
    place = jaxgeo.Geodetic.from_degrees(lat=47.0 + north / 111e3, lon=11.0 + east / 76e3, height=height)
    return jax.vmap(jaxgeo.WGS84.to_ecef)(place).at[7].set(jnp.nan)


@functools.cache
def programs(name: str, with_air: bool) -> Any:
    """(exposure times and statuses of a batch; the same by all samples, and whether few are proven to be enough)."""
    camera, air = CAMERAS[name], jaxgeo.Atmosphere() if with_air else None
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())

    def each(one: Any) -> Any:
        def of_batch(motion: jaxgeo.Trajectory, places: jax.Array) -> Any:
            scene = Scene(sensor, motion.legs(), jnp.zeros(()), jnp.zeros(3), air)
            return jax.vmap(lambda p: one(scene._replace(p_ecef=p), camera.exposure()))(places)

        return jax.jit(of_batch, compiler_options=jaxgeo.compiler_options("short"))

    def sampled(scene: Scene, times: Any) -> Any:
        whole = exposure.Search.of(scene, times, exposure.MOST_SHARED)
        proven = steady_moment(scene, whole.nodes, whole.sights, whole.rates)[2]
        return *exposure._sampled_moment(scene, exposure.Search.of(scene, times)), proven

    return each(exposure._moment), each(sampled)


CASES = [
    ("pushbroom", False, 0.0, 0.7),
    ("pushbroom", False, 1e-3, 0.7),
    ("pushbroom", False, 1e-2, 0.0),
    ("pushbroom", False, 5e-2, 0.0),
    ("pushbroom", True, 0.0, 0.7),
    ("pushbroom", True, 1e-2, 0.0),
    ("whiskbroom", False, 0.0, 0.7),
    ("whiskbroom", False, 1e-2, 0.0),
    ("whiskbroom", False, 0.2, 0.0),
    ("rolling shutter", False, 0.0, 0.9),
    ("rolling shutter", False, 0.2, 0.0),
]


@pytest.mark.costly
@pytest.mark.parametrize("name, with_air, unrest, at_least", CASES)
def test_few_samples_give_what_all_give(name: str, with_air: bool, unrest: float, at_least: float) -> None:
    """`at_least` such a share of the points needs few."""
    of_batch, sampled = programs(name, with_air)
    motion, places = flight(unrest), points()
    (found, status), (expected, other, is_proven) = of_batch(motion, places), sampled(motion, places)
    is_proven = np.asarray(is_proven)
    np.testing.assert_array_equal(status, other)
    seen = np.asarray(status) == Status.hit
    assert seen.any()
    np.testing.assert_allclose(np.asarray(found)[seen], np.asarray(expected)[seen], rtol=0.0, atol=1e-10)  # s
    np.testing.assert_allclose(np.asarray(found)[~is_proven], np.asarray(expected)[~is_proven], rtol=0.0, atol=1e-13)
    assert is_proven.mean() >= at_least
    assert not is_proven[7], "nothing is proven of a point that is nowhere"


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_what_is_missed_is_searched_and_nothing_else_changes(share: float) -> None:
    random = np.random.default_rng(3)
    count = 2 * BLOCK + 9
    places, missed = jnp.asarray(random.normal(size=(count, 3))), jnp.asarray(random.uniform(size=count) < share)
    found = jnp.full(count, -1.0), jnp.full(count, 5, jnp.int8)
    moment, status = search_missed(lambda place: (place[0], jnp.asarray(3, jnp.int8)), places, missed, found)
    np.testing.assert_array_equal(moment, np.where(missed, places[:, 0], -1.0))
    np.testing.assert_array_equal(status, np.where(missed, 3, 5))


@pytest.mark.costly
def test_pixels_of_a_batch_are_those_of_single_points() -> None:
    """And so are their derivatives; in a batch of batches too."""
    sensor = jaxgeo.Sensor(CAMERAS["pushbroom"], jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    motion, places = flight(2e-3), points(12)
    ground = jax.vmap(jaxgeo.WGS84.to_geodetic)(places)
    project = lambda place: jaxgeo.project(sensor, motion, place, time=0.0)  # noqa: E731
    jit = functools.partial(jax.jit, compiler_options=jaxgeo.compiler_options("short"))
    one = jit(project)
    single = jax.tree.map(lambda *x: np.stack(x), *[one(jax.tree.map(lambda x, k=k: x[k], ground)) for k in range(12)])
    shaped = jax.tree.map(lambda x: x.reshape(3, 4), ground)
    nested = jit(jax.vmap(jax.vmap(project)))(shaped)
    np.testing.assert_array_equal(np.asarray(nested.status).ravel(), single.status)
    np.testing.assert_allclose(np.asarray(nested.uv).reshape(12, 2), single.uv, rtol=0.0, atol=1e-6)
    slope = jax.jacfwd(lambda place: project(place).uv)
    many, few = jit(jax.vmap(slope))(ground), jit(slope)(jax.tree.map(lambda x: x[0], ground))
    np.testing.assert_allclose(np.asarray(many.height)[0], few.height, rtol=1e-6)


def test_of_no_points_there_are_no_pixels() -> None:
    nothing = jnp.zeros((0,)), jnp.zeros((0,), jnp.int8)
    assert (
        search_missed(lambda place: (place[0], jnp.int8(0)), jnp.zeros((0, 3)), jnp.zeros(0, bool), nothing) is nothing
    )


@pytest.mark.costly
def test_points_may_be_divided_among_devices() -> None:
    sensor = jaxgeo.Sensor(CAMERAS["rolling shutter"], jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    motion, ground = flight(1e-3), jax.vmap(jaxgeo.WGS84.to_geodetic)(points(8))
    project = jax.vmap(lambda place: jaxgeo.project(sensor, motion, place, time=0.0))
    mesh = jax.make_mesh((1,), ("points",), (jax.sharding.AxisType.Auto,), devices=jax.devices()[:1])
    divided = jax.shard_map(project, mesh=mesh, in_specs=jax.P("points"), out_specs=jax.P("points"))
    options = jaxgeo.compiler_options("short")
    found, expected = (jax.jit(one, compiler_options=options)(ground) for one in (divided, project))
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.uv, expected.uv, rtol=0.0, atol=1e-8)


@pytest.mark.costly
@pytest.mark.parametrize("size, at_least, at_most", [(0.0, 0.7, 1.0), (1e-3, 0.0, 0.0)])
def test_motions_of_more_records_than_a_point_is_searched_at(size: float, at_least: float, at_most: float) -> None:
    """A pitch that swings once between two samples is not seen by them, but by those that all points share."""
    times = np.linspace(-1.0, 9.0, 400)
    position = jaxgeo.Geodetic.from_degrees(
        lat=47.0 + times * 60.0 / 111e3, lon=np.full(400, 11.0), height=np.full(400, 2000.0)
    )
    still, swing = np.zeros(400), size * np.cos(2.0 * np.pi * times / 0.0375)
    motion = jaxgeo.Trajectory.from_knots(times, jaxgeo.Pose(position, still, swing, still), np.zeros((400, 0)))
    of_batch, sampled = programs("pushbroom", False)
    places = points(40)
    (found, status), (expected, other, by_few) = of_batch(motion, places), sampled(motion, places)
    np.testing.assert_array_equal(status, other)
    compared = np.asarray(status) == Status.hit if size == 0.0 else slice(None)
    found, expected = np.nan_to_num(found)[compared], np.nan_to_num(expected)[compared]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 if size == 0.0 else 1e-12)  # s
    assert at_least <= np.mean(by_few) <= at_most

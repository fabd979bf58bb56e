"""Maps of accuracy: every place as `accuracy` says of it alone, and what is not seen masked with its reason."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Geodetic, Pose, Shot, Status, Trajectory, _accelerator
from jaxgeo.earth import WGS84
from jaxgeo.sensor import point_shot
from jaxgeo.uncertainty import NO_FIX, ErrorModel, Method, Sampling, accuracy, accuracy_map, sources
from jaxgeo.uncertainty.host_arrays import block_size
from jaxgeo.uncertainty.map_cells import check_block
from tests.support import looks
from tests.support.scenes import rough, small_dem

MODEL = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=0.03, pitch=0.03, roll=0.03),
        sources.TerrainHeight.from_metres(2.0),
    )
)
# The look over level ground is that of other tests, so that its programs are compiled once for all.
LEVEL_SENSOR, LEVEL_SHOT, LEVEL, LEVEL_MODEL = (
    looks.level_sensor(),
    looks.level_shot(),
    looks.LEVEL,
    looks.level_errors(),
)
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=3000.0, width=601, height=601)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
DRAWN = Sampling(count=256, key=jax.random.key(4))
FIGURES = ("circular", "linear", "spherical")
# Seen from 1.5 km to the west of it: the middle of the image lies at some 11 deg east.
POSE = Pose.from_degrees(lat=47.0, lon=10.98024, height=900.0)
SHOT = Shot(POSE, SENSOR.gimbal.readings_from_degrees(outer=62.0, inner=0.0))
LAT, LON = np.meshgrid(np.linspace(46.96, 46.99, 5), np.linspace(10.91, 10.96, 6), indexing="ij")


def positions(lat=LAT, lon=LON) -> Geodetic:
    return Geodetic.from_degrees(lat=lat, lon=lon, height=np.zeros_like(lat))


def at(position: Geodetic, place) -> Geodetic:
    return jax.tree.map(lambda x: x[place], position)


@pytest.fixture(scope="module")
def level():
    """Level ground, the image over a part of it."""
    return accuracy_map(LEVEL_SENSOR, LEVEL_SHOT, LEVEL, LEVEL_MODEL, positions(), block=4)


@pytest.mark.costly
def test_a_map_keeps_its_figures_by_name(level) -> None:
    for name in (*FIGURES, "method", "failed", "count", "shape"):
        np.testing.assert_array_equal(getattr(level, name), getattr(level.accuracy, name))
    assert level.probability == 0.9
    np.testing.assert_array_equal(level.status, level.accuracy.fix.status)


@pytest.mark.costly
def test_a_place_has_the_figures_of_its_pixel_alone(level) -> None:
    seen = np.argwhere(np.asarray(level.has_fix))
    assert 8 < len(seen) < LAT.size
    for place in map(tuple, (seen[0], seen[-1])):
        alone = accuracy(LEVEL_SENSOR, LEVEL_SHOT, level.uv[place], LEVEL, LEVEL_MODEL)
        for name in FIGURES:
            assert float(getattr(level, name)[place]) == pytest.approx(float(getattr(alone, name)), rel=1e-9), name
        off = WGS84.to_ecef(at(level.position, place)) - alone.fix.ecef
        np.testing.assert_allclose(off, 0.0, atol=1e-6)  # m


@pytest.mark.costly
def test_what_lies_beside_the_image_has_no_figures(level) -> None:
    status, method = np.asarray(level.status), np.asarray(level.method)
    beside = np.any((np.asarray(level.uv) < -0.5) | (np.asarray(level.uv) > np.array([2399.5, 3199.5])), axis=-1)
    assert set(np.unique(status)) == {Status.hit, Status.outside_image}
    np.testing.assert_array_equal(status == Status.outside_image, beside)
    np.testing.assert_array_equal(method, np.where(beside, NO_FIX, Method.facet.value))
    for name in FIGURES:
        np.testing.assert_array_equal(np.isnan(getattr(level, name)), beside)
    assert level.shape == LAT.shape
    said = str(level)
    assert f"{np.sum(~beside)} of {LAT.size} places have a fix. CE90 up to" in said
    assert Status.outside_image.message in said


@pytest.mark.costly
def test_pixels_have_the_figures_of_their_ground(level) -> None:
    uv = np.where(np.asarray(level.has_fix)[..., None], level.uv, -100.0)
    pixels = accuracy(LEVEL_SENSOR, LEVEL_SHOT, uv, LEVEL, LEVEL_MODEL, block=4)
    for name in (*FIGURES, "method"):
        np.testing.assert_allclose(getattr(pixels, name), getattr(level, name), rtol=1e-9)
    np.testing.assert_array_equal(pixels.fix.status, level.status)
    np.testing.assert_array_equal(np.isnan(pixels.fix.position.lat), ~np.asarray(level.has_fix))


def test_blocks_of_an_accelerator_are_larger_and_of_few_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    assert (check_block(None), block_size(300, 512)) == (128, 512)
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: True)
    most, counts = check_block(None), np.arange(1, 3000)
    sizes = np.array([block_size(int(count), most) for count in counts])
    assert most == 1024
    assert set(sizes.tolist()) == {1, 8, 64, 512, 1024}
    assert np.all(sizes >= np.minimum(counts, most))


@pytest.mark.slow
def test_the_size_of_blocks_does_not_matter(level) -> None:
    other = accuracy_map(LEVEL_SENSOR, LEVEL_SHOT, LEVEL, LEVEL_MODEL, positions(), block=1)
    for one, another in zip(jax.tree.leaves(level), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(another, one, rtol=1e-9)


@pytest.mark.slow
def test_one_look_without_raising() -> None:
    one = accuracy(SENSOR, SHOT, (300.0, 300.0), LEVEL, MODEL, probability=0.5, sampling=None)
    alone = accuracy(SENSOR, SHOT, (300.0, 300.0), LEVEL, MODEL, probability=0.5)
    assert [float(getattr(one, name)) for name in FIGURES] == pytest.approx(
        [float(getattr(alone, name)) for name in FIGURES], rel=1e-9
    )
    assert int(one.method) == int(alone.method)
    up = Shot(Pose(POSE.position, 0.0, 0.0, 0.0), SENSOR.gimbal.readings_from_degrees(outer=100.0, inner=0.0))
    none = accuracy(SENSOR, up, (300.0, 300.0), LEVEL, MODEL, probability=0.5, sampling=None)
    assert int(none.method) == NO_FIX
    assert int(none.fix.status) == Status.rises_away
    assert np.isnan([float(getattr(none, name)) for name in FIGURES]).all()


@pytest.fixture(scope="module")
def pointed():
    """The gimbal pointed from the pose at places, one of which its outer axis cannot reach and one that is none."""
    limited = jaxgeo.Gimbal.two_axis(limits=np.deg2rad([[-10.0, 70.0], [-60.0, 60.0]]))
    sensor = jaxgeo.Sensor(CAMERA, limited, jaxgeo.Mount.nadir())
    lat, lon = np.deg2rad([[47.0, 47.003, 47.0, np.nan], [11.0, 10.995, 10.96, 11.0]])
    places = Geodetic(lat=lat, lon=lon, height=np.zeros(4))
    return sensor, accuracy_map(sensor, POSE, LEVEL, MODEL, places, block=8)


@pytest.mark.slow
def test_from_a_pose_the_gimbal_is_pointed_at_each_place(pointed) -> None:
    sensor, found = pointed
    for place in (0, 1):
        shot = point_shot(sensor, POSE, at(found.position, place))
        np.testing.assert_allclose(found.readings[place], shot.gimbal_readings, atol=1e-12)  # rad
        alone = accuracy(sensor, shot, CAMERA.principal_px, LEVEL, MODEL)
        assert [float(getattr(found, name)[place]) for name in FIGURES] == pytest.approx(
            [float(getattr(alone, name)) for name in FIGURES], rel=1e-9
        )


@pytest.mark.slow
def test_what_the_gimbal_cannot_reach_is_told(pointed) -> None:
    found = pointed[1]
    np.testing.assert_array_equal(found.is_out_of_reach, [False, False, True, False])
    np.testing.assert_array_equal(found.method, [0, 0, NO_FIX, NO_FIX])
    assert Status(int(found.status[2])) is Status(int(found.status[3])) is Status.invalid_input
    assert "2  invalid_input: The gimbal cannot look there" in str(found)


@pytest.fixture(scope="module")
def walled():
    """Rough ground with a wall across the look, that hides what lies behind it, and a void."""
    posts = rough(seed=5, relief=8.0)
    posts[:, 6] += 60.0
    posts[3, 12] = np.nan
    dem = small_dem(posts)
    high = Shot(
        Pose.from_degrees(lat=47.0, lon=10.98024, height=1359.0),
        SENSOR.gimbal.readings_from_degrees(outer=50.0, inner=0.0),
    )
    return (
        dem,
        high,
        accuracy_map(SENSOR, high, dem, MODEL, sampling=DRAWN, block=32),
    )


@pytest.mark.slow
def test_on_a_terrain_each_cell_has_the_figures_of_its_pixel_alone(walled) -> None:
    dem, high, found = walled
    method = np.asarray(found.method)
    for one in (Method.facet, Method.samples):
        cells = np.argwhere(method == one)
        assert len(cells), str(found)
        for cell in map(tuple, (cells[0], cells[-1])):
            alone = accuracy(SENSOR, high, found.uv[cell], dem, MODEL, sampling=DRAWN)
            assert Method(int(alone.method)) is one
            for name in FIGURES:
                assert float(getattr(found, name)[cell]) == pytest.approx(float(getattr(alone, name)), rel=1e-9), name
            if alone.sampled is not None:
                assert float(found.failed[cell]) == pytest.approx(float(alone.failed), abs=1e-12)


@pytest.mark.slow
def test_hidden_and_unknown_ground_is_masked(walled) -> None:
    dem, high, found = walled
    seen_by = jax.jit(jax.vmap(lambda point: jaxgeo.project(SENSOR, high, point, terrain=dem).status))
    flat = jax.tree.map(lambda x: jnp.nan_to_num(x.reshape(-1)), found.position)
    expected = np.asarray(seen_by(flat)).reshape(found.shape)
    status, has_fix = np.asarray(found.status), np.asarray(found.has_fix)
    is_void = np.zeros(found.shape, bool)
    is_void[2:4, 11:13] = True
    np.testing.assert_array_equal(np.isnan(found.position.height), is_void)
    assert np.all(status[is_void] == Status.hits_void)
    assert np.sum(expected[~is_void] == Status.hidden_by_terrain) > 8
    np.testing.assert_array_equal(
        status[~is_void] == Status.hidden_by_terrain, expected[~is_void] == Status.hidden_by_terrain
    )
    np.testing.assert_array_equal(has_fix[~is_void], expected[~is_void] == Status.hit)
    assert not np.isnan(np.asarray(found.circular)[has_fix]).any()
    assert np.isnan(np.asarray(found.circular)[~has_fix]).all()


@pytest.mark.slow
def test_without_samples_what_needs_them_has_no_figures(walled) -> None:
    dem, high, found = walled
    none = accuracy_map(SENSOR, high, dem, MODEL, sampling=None, block=32)
    np.testing.assert_array_equal(none.method, found.method)
    for name in FIGURES:
        np.testing.assert_array_equal(
            np.isnan(getattr(none, name)), ~np.isin(found.method, [Method.facet, Method.footprint])
        )


@pytest.mark.slow
def test_an_image_taken_in_motion(level) -> None:
    """On a trajectory, when the platform passes where the shot was."""
    flown = Trajectory.steady(LEVEL_SHOT, velocity_ned=(60.0, 5.0, 0.0), body_rates=(0.0, 0.0, 0.01))
    found = accuracy_map(LEVEL_SENSOR, flown, LEVEL, LEVEL_MODEL, positions(), time=0.0, block=8)
    np.testing.assert_array_equal(found.status, level.status)
    np.testing.assert_allclose(found.circular, level.circular, rtol=1e-6)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"ground": None}, "has no cells"),
        ({"block": 0}, "block must be a whole number, 1 or more; got 0"),
        ({"sampling": Sampling(count=-1)}, "count must be a whole number of samples, 0 or more; got -1"),
        ({"probability": 1.0}, "between 0 and 1"),
        ({"ground": jax.tree.map(np.rad2deg, positions())}, "takes radians"),
        ({"ground": positions(LAT[:0], LON[:0])}, "ground must hold positions"),
        ({"errors": ()}, "no source"),
        ({"shot": POSE, "sensor": jaxgeo.Sensor(CAMERA)}, "no axes"),
        ({"time": 1.0}, "time goes with a Trajectory"),
    ],
)
def test_requests_that_make_no_sense(change: dict, message: str) -> None:
    given = {"sensor": SENSOR, "shot": SHOT, "terrain": LEVEL, "errors": MODEL, "ground": positions(), **change}
    with pytest.raises(ValueError, match=message):
        accuracy_map(**given)


@pytest.mark.costly
def test_pixels_need_a_shot_and_two_numbers() -> None:
    with pytest.raises(TypeError, match="Pose"):
        accuracy(SENSOR, POSE, [(1.0, 2.0)], LEVEL, MODEL)
    with pytest.raises(ValueError, match=r"uv must be pixels"):
        accuracy(SENSOR, SHOT, np.zeros((4, 3)), LEVEL, MODEL)
    with pytest.raises(ValueError, match="step must be"):
        accuracy_map(SENSOR, SHOT, small_dem(rough()), MODEL, step=0)

"""Terrain of a user's own has the accuracy that its samples have: it is probed, and never taken for a plane unseen."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.studies.scenes import tangent_dem
from jaxgeo.terrain.plumb import height_by_plumb_line
from jaxgeo.uncertainty import (
    Footprint,
    Method,
    Sampling,
    accuracy,
    accuracy_map,
    compare,
    propagate,
    sample,
    sources,
)
from jaxgeo.uncertainty.method_selection import Diagnostics, explain_method, select_method
from tests.support.terrains import Bridge, Tin, Unknown, tin_along
from tests.uncertainty.test_verdict import CASES, CENTRE, KEY, MODEL, SENSOR, SIZE, SPACING, UV, ground, shot_at

NORTH = SPACING * (SIZE // 2 - np.arange(SIZE))[::-1]


def tin(kind: str, like: type[Tin] = Tin) -> Tin:
    """The ground of `test_verdict` in triangles: the same heights, level from west to east."""
    return like(tin_along(CENTRE, NORTH, ground(kind)[::-1, 0]).corners)


@jax.jit
def told(shot, terrain):
    return accuracy(SENSOR, shot, UV, terrain, MODEL, sampling=None)


@pytest.mark.slow
@pytest.mark.parametrize("kind, rows_ahead, expected", CASES)
def test_the_method_fits_the_triangles(kind: str, rows_ahead: float, expected: Method) -> None:
    one = told(shot_at(rows_ahead), tin(kind))
    assert Method(int(one.method)) is expected, one.diagnostics
    assert float(one.diagnostics.known) == 1.0
    assert float(one.diagnostics.off) < 1e-6  # m


@pytest.mark.slow
@pytest.mark.parametrize("kind, rows_ahead, expected", CASES)
def test_figures_over_triangles_are_those_of_samples(kind: str, rows_ahead: float, expected: Method) -> None:
    scene = (SENSOR, shot_at(rows_ahead), UV, tin(kind), MODEL)
    result = accuracy(*scene, sampling=Sampling(count=4096, key=KEY))
    assert Method(int(result.method)) is expected, str(result)
    drawn = sample(*scene, key=jax.random.key(9), count=4096)
    for door, figure in (("circular_error", result.circular), ("linear_error", result.linear)):
        truth = getattr(drawn, door)(0.9)
        assert 0.93 * truth.low <= figure <= 1.07 * truth.high, (str(result), truth)
    if expected is Method.footprint:
        linear = propagate(*scene, slope=Footprint())
        assert float(linear.circular_error(0.9)) == pytest.approx(result.circular, rel=1e-9)
        assert float(linear.circular_error(0.9)) > 1.5 * float(propagate(*scene).circular_error(0.9))


@pytest.mark.slow
def test_every_door_tells_the_crest_of_triangles() -> None:
    kind, rows_ahead, expected = CASES[-1]
    terrain, shot = tin(kind), shot_at(rows_ahead)
    alone = accuracy(SENSOR, shot, UV, terrain, MODEL, sampling=Sampling(count=2048, key=KEY))
    shots = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * 2), shot)
    options = {"sampling": Sampling(count=2048, key=KEY)}
    axes = (None, 0, 0, None, None)
    each = accuracy(SENSOR, shots, np.array([UV, UV]), terrain, MODEL, in_axes=axes, **options)
    pixels = accuracy(SENSOR, shot, np.array([UV]), terrain, MODEL, **options)
    place = jax.tree.map(lambda x: jnp.asarray(x)[None], alone.fix.position)
    on_map = accuracy_map(SENSOR, shot, terrain, MODEL, place, **options)
    for found in (each, pixels, on_map):
        assert set(np.asarray(found.method).tolist()) == {expected.value}
        np.testing.assert_allclose(found.circular, alone.circular, rtol=1e-6)
    np.testing.assert_allclose(on_map.position.height, alone.fix.position.height, rtol=0, atol=1e-6)
    assert compare(SENSOR, shot, UV, terrain, MODEL, sampling=Sampling(count=2048, key=KEY)).jumped > 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    "like, because",
    [(Bridge, r"probed from above lies 50 m from the fix"), (Unknown, r"probed from above lies nowhere at the fix")],
)
def test_ground_that_cannot_be_probed_is_sampled_and_the_reason_said(like: type[Tin], because: str) -> None:
    scene = (SENSOR, shot_at(0.0), UV, tin("plain", like), MODEL)
    result = accuracy(*scene, sampling=Sampling(count=1024, key=KEY))
    assert Method(int(result.method)) is Method.samples
    assert result.circular == pytest.approx(62.0, rel=0.1)
    assert because in result.because
    footprint = float(propagate(*scene, slope=Footprint()).circular_error(0.9))
    assert math.isnan(footprint) == (like is Unknown)


SURE = Diagnostics(10.0, 10.0, 10.0, 3.0, 3.0, 3.0, 0.0, 0.0, math.inf, 0.5, 1.0, 0.0)
REASONS = [
    (
        {},
        Method.facet,
        "nearly planar within the error region, as linear propagation needs: CE90 found in three ways is the same "
        "within 0.1 %.",
    ),
    ({"facet": 9.979, "footprint": 10.02}, Method.facet, "CE90 found in three ways is the same within 0.3 %."),
    (
        {"facet": 9.4},
        Method.facet,
        "nearly planar within the error region: CE90 is 6.0 % smaller by the slope at the fix and 0.0 % larger by the "
        "mean slope of the error region than over the ground along the line of sight, which the radii follow.",
    ),
    ({"facet": 5.0}, Method.footprint, "differs from the mean slope of the error region"),
    (
        {"facet": 9.0, "profile": 20.0},
        Method.samples,
        "not planar within the error region: CE90 is 55 % smaller by the slope at the fix and 50 % smaller by the mean "
        "slope of the error region than over the ground along the line of sight; LE90 is the same",
    ),
    (
        {"profile": 20.0},
        Method.samples,
        "errors are too large for linear propagation with a line of sight at 30 deg to the ground, though the ground "
        "is nearly planar",
    ),
    (
        {"footprint_up": 3.6, "profile_up": 3.6},
        Method.footprint,
        "heights of the error region differ from a plane through the fix: LE90 is 17 % smaller by the slope at the fix",
    ),
    ({"facet_up": 2.0, "footprint_up": 3.0, "profile_up": 6.0}, Method.samples, "not planar within the error region"),
    (
        {"facet_up": 0.0, "footprint_up": 1e-5, "profile_up": 3e-4},
        Method.facet,
        "nearly planar within the error region",
    ),
    ({"facet": 1e-16, "footprint": 0.0, "profile": 3e-3}, Method.facet, "move the fix up and down alone"),
    ({"profile_up": math.nan}, Method.samples, "unbounded or unknown: CE90 is the same"),
    ({"profile": math.inf}, Method.samples, "unbounded or unknown: CE90 is unknown over the ground along the line"),
    (
        {"jumps": 0.02, "clearance": 1.5},
        Method.samples,
        "2 % of the perturbed lines of sight hit a nearer or farther slope (first at 1.5 sigma)",
    ),
    ({"jumps": 0.004, "facet": 8.0, "profile": 20.0}, Method.samples, "not planar"),
    (
        {"fails": 0.3},
        Method.samples,
        "30 % of the perturbed lines of sight meet no known ground ahead of the camera",
    ),
    ({"known": 0.75}, Method.samples, "25 % of the ground in the footprint is unknown"),
    ({"known": math.nan}, Method.samples, "ground in the footprint is unknown"),
    ({"grazing": 0.005}, Method.samples, "grazes the surface, at 5 mrad"),
    ({"grazing": math.nan}, Method.samples, "grazes"),
    ({"off": 12.0}, Method.samples, "lies 12 m from the fix"),
    ({"off": math.inf}, Method.samples, "lies nowhere near the fix"),
    ({"off": math.nan}, Method.samples, "lies nowhere near the fix"),
]


@pytest.mark.parametrize("change, expected, words", REASONS)
def test_a_sign_that_is_not_good_or_not_known_asks_for_samples_and_says_so(
    change, expected: Method, words: str
) -> None:
    diagnostics = SURE._replace(**change)
    method = Method(int(select_method(jax.tree.map(jnp.asarray, diagnostics))))
    assert method is expected
    assert words in explain_method(diagnostics, method)


@pytest.mark.slow
def test_level_ground_is_not_blamed_for_large_errors() -> None:
    """A gimbal that errs by 2 deg, seen at 8 deg to level ground: linear propagation fails, and not by the ground."""
    sensor = Sensor(FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000), Gimbal.three_axis(),
                    Mount.forward())  # fmt: skip
    pose = Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    shot = Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-8.0, roll=0.0))
    errors = [sources.GimbalAngles.from_degrees(yaw=2.0, pitch=2.0, roll=2.0), sources.TerrainHeight.from_metres(1.0)]
    found = accuracy(sensor, shot, (1999.5, 1499.5), ConstantHeight(600.0), errors, sampling=None)
    assert Method(int(found.method)) is Method.samples
    assert found.because is not None
    assert found.because.startswith("The errors are too large for linear propagation with a line of sight at 8 deg")


@pytest.mark.costly
def test_a_plumb_line_finds_the_heights_of_any_terrain() -> None:
    north = np.array([-611.0, -40.0, 0.0, 7.0, 815.0])
    lat = np.rad2deg(CENTRE.lat) + north / (math.radians(1.0) * 6.367e6)
    beside = 47.5
    places = Geodetic.from_degrees(lat=np.append(lat, beside), lon=np.full(6, 8.0), height=np.zeros(6))
    narrow = tin_along(CENTRE, NORTH, ground("crest")[::-1, 0], half_width=300.0)  # m: its chords sag by 7 mm
    dem = tangent_dem(ground("crest"), SPACING, CENTRE)

    @jax.jit
    @jax.vmap
    def heights(place):
        return narrow.height_at(place), height_by_plumb_line(dem, place), dem.height_at(place)

    found, plumb, expected = (np.asarray(one) for one in heights(places))
    np.testing.assert_allclose(found[:-1], np.interp(north, NORTH, ground("crest")[::-1, 0]), rtol=0, atol=0.02)
    assert np.isnan(found[-1])
    np.testing.assert_allclose(plumb[:-1], expected[:-1], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_an_earth_that_curves_away_is_no_plane() -> None:
    """Lines of sight close above the horizon: those that err upwards meet no ground at all."""
    camera = Geodetic.from_degrees(lat=46.0, lon=8.0, height=3000.0)
    shot = Shot(Pose(camera, 0.0, math.radians(-2.1), 0.0))
    errors = (sources.Attitude.from_degrees(heading=0.02, pitch=0.3, roll=0.02),)
    scene = (SENSOR, shot, UV, ConstantHeight(0.0), errors)
    result = accuracy(*scene, sampling=Sampling(count=4096, key=KEY))
    drawn = sample(*scene, key=jax.random.key(9), count=4096)
    assert drawn.found < 0.9 * drawn.count
    assert float(result.diagnostics.grazing) > 0.015
    assert Method(int(result.method)) is Method.samples, str(result)
    assert math.isinf(result.circular)
    assert "meet no known ground" in result.because

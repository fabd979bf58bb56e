"""Scene files: what they mean, and what is said about every mistake in them.

The format is our own, TOML, described in `docs/howto/navigation.md`. Held against: PROJ
(convergence), EGM96 undulations, and values worked out by hand from the keys.
"""

from __future__ import annotations

import pathlib

import jax.numpy as jnp
import numpy as np
import pyproj
import pytest

from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.io import undulation, write_errors, write_updated_scene
from jaxgeo.io.scene import SceneError, load_scene, read_scene
from jaxgeo.sensor import BrownConrady, FrameCamera
from jaxgeo.uncertainty import ErrorModel
from jaxgeo.uncertainty.distributions import Empirical, Laplace, Mixture, StudentT, TruncatedNormal
from jaxgeo.uncertainty.sources import Attitude, Position, TerrainField

GOOD = """
title = "a test"

[camera]
width = 400
height = 300
focal_length_mm = 50.0
pixel_pitch_um = 5.0

[gimbal]
kind = "two_axis"
outer_deg = 60.0
inner_deg = -1.0

[mount]
base_heading_deg = 0.5
lever_body_m = [1.0, 0.0, 0.5]

[pose]
lat_deg = 44.2
lon_deg = 5.3
height_m = 4000.0
height_datum = "ellipsoid"
heading_deg = 90
pitch_deg = 2.0
roll_deg = -3.0
"""


@pytest.fixture
def scene_file(tmp_path: pathlib.Path):
    def write(text: str, *replacements: tuple[str, str]) -> pathlib.Path:
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return path

    return write


def test_records_are_in_radians_and_metres(scene_file) -> None:
    sensor, shot = load_scene(scene_file(GOOD))
    assert isinstance(sensor.camera, FrameCamera)
    np.testing.assert_allclose(sensor.camera.focal_px, [10_000.0, 10_000.0], rtol=1e-14)
    np.testing.assert_allclose(sensor.camera.principal_px, [199.5, 149.5], rtol=1e-14)
    np.testing.assert_allclose(shot.gimbal_readings, np.deg2rad([60.0, -1.0]), rtol=1e-15)
    np.testing.assert_allclose(sensor.mount.lever_body, [1.0, 0.0, 0.5])
    np.testing.assert_allclose(
        jnp.arctan2(sensor.mount.R_body_from_base[1, 0], sensor.mount.R_body_from_base[0, 0]), np.deg2rad(0.5)
    )
    pose = shot.pose
    np.testing.assert_allclose([pose.heading, pose.pitch, pose.roll], np.deg2rad([90.0, 2.0, -3.0]), rtol=1e-15)
    np.testing.assert_allclose([pose.position.lat, pose.position.lon], np.deg2rad([44.2, 5.3]), rtol=1e-15)
    assert float(pose.position.height) == 4000.0


def test_the_packaged_example_is_a_scene() -> None:
    from jaxgeo.demo import scene_file

    sensor, shot = load_scene(scene_file())
    assert sensor.gimbal.names == ("outer", "inner")
    shift = float(undulation(np.array(36.318), np.array(-84.105)))
    assert float(shot.pose.position.height) == pytest.approx(5500.0 + shift, abs=1e-6)


@pytest.mark.parametrize(
    "datum, expected",
    [('"ellipsoid"', 0.0), ("31.25", 31.25), ('"EPSG:5773"', None)],
    ids=["ellipsoid", "number", "egm96"],
)
def test_heights_become_ellipsoidal(scene_file, datum: str, expected: float | None) -> None:
    _, shot = load_scene(scene_file(GOOD, ('height_datum = "ellipsoid"', f"height_datum = {datum}")))
    shift = float(undulation(np.array(44.2), np.array(5.3))) if expected is None else expected
    assert float(shot.pose.position.height) == pytest.approx(4000.0 + shift, abs=1e-9)


@pytest.mark.parametrize(
    "kind, readings",
    [
        ("mirror", "depression_deg = 16.0\nazimuth_deg = 44.0"),
        ("level", "yaw_deg = 10.0\npitch_deg = -60.0\nroll_deg = 0.0"),
        ("fixed", ""),
    ],
)
def test_kinds_of_gimbal(scene_file, kind: str, readings: str) -> None:
    path = scene_file(GOOD, ('"two_axis"', f'"{kind}"'), ("outer_deg = 60.0\ninner_deg = -1.0", readings))
    sensor, shot = load_scene(path)
    assert shot.gimbal_readings.shape == (len(sensor.gimbal.names),)
    looks = np.asarray(sensor.R_ned_from_camera(shot))[:, 2]
    assert looks[2] > 0.0 or kind == "level"
    if kind == "level":
        np.testing.assert_allclose(looks[2], np.sin(np.deg2rad(60.0)), rtol=1e-14)


ON_MAP = (("lat_deg = 44.2\nlon_deg = 5.3\n", 'easting_m = {x:.6f}\nnorthing_m = {y:.6f}\nmap_crs = "EPSG:32631"\n'),)


def test_a_position_may_be_on_a_map(scene_file, tmp_path: pathlib.Path) -> None:
    x, y = TransverseMercator.utm(31).forward(np.deg2rad(44.2), np.deg2rad(5.3))  # not PROJ's
    ((old, new),) = ON_MAP
    _, plain = load_scene(scene_file(GOOD))
    path = scene_file(GOOD, (old, new.format(x=float(x), y=float(y))))
    _, shot = load_scene(path)
    np.testing.assert_allclose(np.rad2deg(float(shot.pose.position.lat)), 44.2, atol=1e-10)
    np.testing.assert_allclose(np.rad2deg(float(shot.pose.position.lon)), 5.3, atol=1e-10)
    assert float(shot.pose.heading) == float(plain.pose.heading)  # true, not of the grid
    write_updated_scene(tmp_path / "new.toml", path, shot)
    text = (tmp_path / "new.toml").read_text()
    assert "easting_m" in text
    assert "lat_deg" not in text
    _, again = load_scene(tmp_path / "new.toml")
    for one, other in zip(again.pose.position.to_degrees(), shot.pose.position.to_degrees(), strict=True):
        np.testing.assert_allclose(float(one), float(other), rtol=1e-13)


def test_a_map_in_feet_has_metres_too(scene_file, tmp_path: pathlib.Path) -> None:
    """Tennessee's map in the EPSG registry: 600 000 m at its central meridian, 86 W."""
    ((old, new),) = ON_MAP
    path = scene_file(GOOD, (old, new.format(x=600_000.0, y=200_000.0).replace("EPSG:32631", "EPSG:2274")))
    _, shot = load_scene(path)
    np.testing.assert_allclose(np.rad2deg(float(shot.pose.position.lon)), -86.0, atol=1e-9)
    write_updated_scene(tmp_path / "new.toml", path, shot)
    written = next(line for line in (tmp_path / "new.toml").read_text().splitlines() if line.startswith("easting_m"))
    assert float(written.partition("=")[2]) == pytest.approx(600_000.0, abs=1e-6)


def test_omega_phi_kappa_of_a_level_camera_is_the_grid_north(scene_file) -> None:
    attitude = "heading_deg = 90\npitch_deg = 2.0\nroll_deg = -3.0"
    grid = 'omega_deg = 0.0\nphi_deg = 0.0\nkappa_deg = 0.0\nmap_crs = "EPSG:32631"'
    _, shot = load_scene(scene_file(GOOD, (attitude, grid)))
    expected = pyproj.Proj("EPSG:32631").get_factors(5.3, 44.2).meridian_convergence
    assert expected > 1.0
    np.testing.assert_allclose([shot.pose.pitch, shot.pose.roll], [0.0, 0.0], rtol=0, atol=1e-12)
    assert np.rad2deg(shot.pose.heading) == pytest.approx(expected, abs=1e-9)


def test_pixel_terms_and_distortion(scene_file) -> None:
    metric = "focal_length_mm = 50.0\npixel_pitch_um = 5.0"
    pixels = "focal_px = 9000.0\nprincipal_px = [190.0, 140.0]\n[camera.distortion]\nk1 = -0.1\np2 = 0.001"
    sensor, _ = load_scene(scene_file(GOOD, (metric, pixels)))
    assert isinstance(sensor.camera, FrameCamera)
    assert isinstance(sensor.camera.distortion, BrownConrady)
    np.testing.assert_allclose(sensor.camera.focal_px, [9000.0, 9000.0])
    np.testing.assert_allclose(sensor.camera.principal_px, [190.0, 140.0])
    assert float(sensor.camera.distortion.k1) == -0.1
    assert float(sensor.camera.distortion.p2) == 0.001


# Each mistake: what is replaced, by what, and what the message must say: the key, the value, the key or unit expected.
MISTAKES = [
    (
        "heading_deg = 90",
        "heading_rad = 1.57",
        ["[pose] heading_rad = 1.57", "unknown key", "write heading_deg, in deg"],
    ),
    ("focal_length_mm = 50.0", "focal_length_m = 0.05", ["[camera] focal_length_m = 0.05", "focal_length_mm, in mm"]),
    (
        "focal_length_mm = 50.0",
        "focal_mm = 50.0",
        ["[camera] focal_mm = 50.0: unknown key; write focal_length_mm, in mm."],
    ),
    ("focal_length_mm = 50.0", "focal = 50.0", ["unknown key; write focal_length_mm, in mm; or focal_px, "]),
    ("height_m = 4000.0", "height_ft = 13123.0", ["[pose] height_ft = 13123.0", "write height_m, in m"]),
    ("roll_deg = -3.0", "rol_deg = -3.0", ["[pose] rol_deg", "write roll_deg"]),
    ("inner_deg = -1.0", "inner_deg = -1.0\ncolour = 3", ["[gimbal] colour = 3", "known here: kind, outer_deg"]),
    ("lat_deg = 44.2\n", "", ["[pose]", "lat_deg and lon_deg (deg), or easting_m and northing_m (m) with map_crs"]),
    ("lat_deg = 44.2", "easting_m = 5e5\nnorthing_m = 5e6", ["[pose]", "or easting_m and northing_m (m) with map_crs"]),
    (
        "lat_deg = 44.2\nlon_deg = 5.3",
        'easting_m = 5e5\nnorthing_m = 5e6\nmap_crs = "EPSG:4326"',
        ["[pose] map_crs = 'EPSG:4326'", "is no map"],
    ),
    (
        "lat_deg = 44.2\nlon_deg = 5.3",
        'easting_m = 9e7\nnorthing_m = 9e7\nmap_crs = "EPSG:32631"',
        ["[pose] easting_m = 90000000", "is no place on the map 'EPSG:32631'"],
    ),
    ("lat_deg = 44.2", 'lat_deg = 44.2\nmap_crs = "EPSG:32631"', ["[pose]", "map_crs goes with easting_m"]),
    ("lat_deg = 44.2", "lat_deg = 95.0", ["[pose] lat_deg = 95.0", "at most 90 deg"]),
    ("lat_deg = 44.2", "lat_deg = nan", ["[pose] lat_deg = nan", "finite number", "deg"]),
    ("lon_deg = 5.3", "", ["[pose]", "the position is lat_deg and lon_deg (deg)"]),
    ("lon_deg = 5.3", 'lon_deg = "5 E"', ["[pose] lon_deg = '5 E'", "valid number", "deg"]),
    ("pixel_pitch_um = 5.0", "pixel_pitch_um = -5.0", ["[camera] pixel_pitch_um = -5.0", "at least 0.5 um"]),
    ("pixel_pitch_um = 5.0", "pixel_pitch_um = 0.0039", ["[camera] pixel_pitch_um = 0.0039", "at least 0.5 um"]),
    ("width = 400", "width = 400.5", ["[camera] width = 400.5", "whole pixels"]),
    ("[1.0, 0.0, 0.5]", "[1.0, 0.5]", ["[mount] lever_body_m = [1.0, 0.5]", "list of 3 numbers in m"]),
    (
        '"two_axis"',
        '"two-axis"',
        ["[gimbal] kind = 'two-axis'", "'two_axis', 'mirror', 'level', 'three_axis' or 'fixed'"],
    ),
    ("inner_deg = -1.0", "yaw_deg = 1.0", ["[gimbal]", "outer_deg, inner_deg (deg)", "yaw_deg"]),
    ("outer_deg = 60.0\ninner_deg = -1.0", "", ["[gimbal]", "outer_deg, inner_deg (deg)"]),
    ('height_datum = "ellipsoid"', "", ["[pose] height_datum is missing", "EPSG:5773", "undulation in m"]),
    (
        'height_datum = "ellipsoid"',
        'height_datum = "sea"',
        ['[pose] height_datum = "sea" is unknown to PROJ', "EPSG:5773"],
    ),
    ('height_datum = "ellipsoid"', "height_datum = 5773", ["[pose] height_datum = 5773 would", '"EPSG:5773"']),
    ('height_datum = "ellipsoid"', 'height_datum = "no.gtx"', ['[pose] height_datum = "no.gtx": the geoid grid']),
    ('height_datum = "ellipsoid"', 'height_datum = "EPSG:4326"', ['[pose] height_datum = "EPSG:4326" (WGS 84) says']),
    ('height_datum = "ellipsoid"', "height_datum = true", ["[pose] height_datum = True", "a vertical datum"]),
    ("roll_deg = -3.0", "omega_deg = -3.0", ["[pose]", "heading_deg, pitch_deg and roll_deg", "map_crs"]),
    ("pixel_pitch_um = 5.0", "", ["[camera]", "pixel_pitch_um (um)", "focal_px (pixels)"]),
    ("pixel_pitch_um = 5.0", "pixel_pitch_um = 5.0\nfocal_px = 1.0", ["[camera]", "not both"]),
    ("[pose]", "[pse]", ["[pse]", "unknown table", "write pose"]),
    ("[camera]", "[camera", ["not a TOML file", "line 4"]),
]


@pytest.mark.parametrize(
    "old, new, words", MISTAKES, ids=[(new or f"no {old}").split("=")[0].strip() for old, new, _ in MISTAKES]
)
def test_mistakes_are_named(scene_file, old: str, new: str, words: list[str]) -> None:
    path = scene_file(GOOD, (old, new))
    with pytest.raises(ValueError, match=r"scene\.toml") as caught:
        read_scene(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_every_mistake_is_told_at_once(scene_file) -> None:
    path = scene_file(GOOD, ("heading_deg = 90", "heading_rad = 1.57"), ("width = 400", "width = 0"))
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert len(str(caught.value).splitlines()) == 2


def test_air_is_asked_for_and_stands_on_the_sea(scene_file) -> None:
    assert read_scene(scene_file(GOOD)).atmosphere is None
    sea_level = float(undulation(44.2, 5.3))
    standard = read_scene(scene_file(GOOD + "[air]\n")).atmosphere
    assert float(standard.pressure(jnp.asarray(sea_level))) == pytest.approx(101_325.0, rel=0, abs=1e-6)
    measurement = "[air]\npressure_hpa = 930.5\ntemperature_c = 12.5\nheight_msl_m = 600.0\n"
    measured = read_scene(scene_file(GOOD + measurement)).atmosphere
    at = jnp.asarray(600.0 + sea_level)
    assert float(measured.pressure(at)) == pytest.approx(93_050.0, rel=0, abs=1e-6)
    assert float(measured.temperature(at)) == pytest.approx(285.65, rel=0, abs=1e-9)


@pytest.mark.parametrize(
    "air, words",
    [
        ("pressure_hpa = 930.5", ["temperature_c", "all three"]),
        ("pressure_hpa = 101325.0\ntemperature_c = 15.0\nheight_msl_m = 0.0", ["pressure_hpa", "hPa", "1200"]),
        ("temperature_k = 288.15", ["temperature_k"]),
    ],
)
def test_mistakes_about_the_air_are_named(scene_file, air: str, words: list[str]) -> None:
    with pytest.raises(SceneError) as error:
        read_scene(scene_file(f"{GOOD}[air]\n{air}\n"))
    assert all(word in str(error.value) for word in [*words, "air"])


def test_air_without_a_pose_needs_its_sea_level(scene_file) -> None:
    without_pose = GOOD[: GOOD.index("[pose]")].replace("outer_deg = 60.0\ninner_deg = -1.0\n", "")
    with pytest.raises(SceneError, match="sea_level_m is missing"):
        read_scene(scene_file(without_pose + "[air]\n"))
    scene = read_scene(scene_file(without_pose + "[air]\nsea_level_m = 50.0\n"))
    assert float(scene.atmosphere.sea_level) == 50.0


def test_a_scene_without_pose_is_for_tables(scene_file) -> None:
    text = GOOD[: GOOD.index("[pose]")] + '[shots]\nheight_datum = "EPSG:5773"\n'
    path = scene_file(text)
    assert read_scene(path).height_datum == "EPSG:5773"
    with pytest.raises(SceneError, match=r"\[pose\] is missing"):
        load_scene(path)


def test_a_missing_file_is_named(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.toml"):
        read_scene(tmp_path / "nowhere.toml")


def test_the_datum_of_a_table_of_shots_is_checked_and_goes_before_that_of_the_pose(scene_file) -> None:
    with pytest.raises(SceneError, match=r'scene\.toml: \[shots\] height_datum = "sea" is unknown to PROJ'):
        read_scene(scene_file(GOOD + '[shots]\nheight_datum = "sea"\n'))
    assert read_scene(scene_file(GOOD + "[shots]\nheight_datum = 31.25\n")).height_datum == 31.25


def test_a_byte_order_mark_is_no_mistake(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(GOOD, encoding="utf-8-sig")
    assert read_scene(path).title == "a test"


def test_a_folder_is_no_scene(tmp_path: pathlib.Path) -> None:
    with pytest.raises(SceneError, match="this is a folder"):
        read_scene(tmp_path)


ERRORS = """
[errors]
position_m = [1.5, 2.0, 3.0]
attitude_deg = 0.05
gimbal_deg = [0.02, 0.03]
gimbal_mounting_deg = 0.01
boresight_deg = [0.03, 0.01, 0.02]
lever_body_m = 0.01
focal_px = 2.0
principal_px = [1.0, 1.5]
pixel_px = 0.5
terrain_m = 5.0
"""


def test_errors_are_an_error_model(scene_file) -> None:
    model = read_scene(scene_file(GOOD + ERRORS)).errors
    assert model is not None
    found = {name: float(value) for name, value in zip(model.axes, np.sqrt(np.diag(model.covariance())), strict=True)}
    deg = np.pi / 180.0
    expected = {
        "position: north": 1.5,
        "position: east": 2.0,
        "position: down": 3.0,
        "attitude: heading": 0.05 * deg,
        "attitude: pitch": 0.05 * deg,
        "attitude: roll": 0.05 * deg,
        "gimbal angles: outer": 0.02 * deg,
        "gimbal angles: inner": 0.03 * deg,
        "gimbal mounting: outer": 0.01 * deg,
        "gimbal mounting: inner": 0.01 * deg,
        "boresight: heading": 0.03 * deg,
        "boresight: pitch": 0.01 * deg,
        "boresight: roll": 0.02 * deg,
        "lever arm: forward": 0.01,
        "lever arm: right": 0.01,
        "lever arm: down": 0.01,
        "interior orientation: focal length": 2.0,
        "interior orientation: principal column": 1.0,
        "interior orientation: principal row": 1.5,
        "pixel measurement: column": 0.5,
        "pixel measurement: row": 0.5,
        "terrain height: height": 5.0,
    }
    assert found == pytest.approx(expected)
    assert read_scene(scene_file(GOOD)).errors is None


def test_heights_that_err_alike_over_a_distance_are_a_field(scene_file) -> None:
    text = "[errors]\nterrain_m = 5.0\nterrain_correlation_m = 800.0\n"
    model = read_scene(scene_file(GOOD + text)).errors
    assert model is not None
    (field,) = model.sources
    assert isinstance(field, TerrainField)
    np.testing.assert_allclose(field.variance_at(jnp.array([0.0])), [25.0])
    np.testing.assert_array_equal(field.gaussian_lengths, [800.0])


@pytest.mark.parametrize(
    "errors, words",
    [
        ("", ["[errors]", "empty", "position_m"]),
        ("position_m = -1.0", ["[errors] position_m", "-1", "at least 0"]),
        ("position_m = [1.0, 2.0]", ["[errors] position_m", "north, east, down"]),
        ("attitude_deg = 'small'", ["[errors] attitude_deg", "standard deviation in deg"]),
        ("attitude = 0.1", ["[errors] attitude = 0.1", "write attitude_deg"]),
        ("gimbal_deg = [0.1, 0.1, 0.1]", ["[errors] gimbal_deg", "2 numbers"]),
        ("terrain_correlation_m = 100.0", ["terrain_correlation_m", "terrain_m"]),
        ("terrain_m = nan", ["[errors] terrain_m", "finite"]),
    ],
)
def test_mistakes_about_errors_are_named(scene_file, errors: str, words: list[str]) -> None:
    with pytest.raises(SceneError) as error:
        read_scene(scene_file(f"{GOOD}\n[errors]\n{errors}\n"))
    for word in words:
        assert word in str(error.value)


def test_a_wrong_number_in_a_list_is_told_once(scene_file) -> None:
    with pytest.raises(SceneError) as error:
        read_scene(scene_file(f"{GOOD}\n[errors]\nposition_m = [1.5, -1.5, 3.0]\n"))
    (line,) = str(error.value).splitlines()
    assert "[errors] position_m[1] = -1.5: must be at least 0" in line


@pytest.mark.parametrize(
    "kind, errors, word",
    [
        ('kind = "fixed"', "gimbal_deg = 0.1", "is fixed"),
        ('kind = "level"\nyaw_deg = 0.0\npitch_deg = -60.0\nroll_deg = 0.0', "boresight_deg = 0.1", "mounting"),
    ],
)
def test_errors_that_do_not_fit_the_gimbal(scene_file, kind: str, errors: str, word: str) -> None:
    text = GOOD.replace('kind = "two_axis"\nouter_deg = 60.0\ninner_deg = -1.0', kind)
    with pytest.raises(SceneError, match=word):
        read_scene(scene_file(f"{text}\n[errors]\n{errors}\n"))


@pytest.mark.parametrize(
    "errors, sigma, shape",
    [
        ('gimbal_deg = {sigma = 0.02, distribution = "uniform"}', [0.02, 0.02], "uniform"),
        ('gimbal_deg = {plus_minus = [0.3, 0.6], distribution = "uniform"}', [0.1732050808, 0.3464101615], "uniform"),
        ("gimbal_deg = {plus_minus = 0.1, sigmas = 2, distribution = 'normal'}", [0.05, 0.05], None),
        ("gimbal_deg = {plus_minus = 0.1, coverage = 0.95, distribution = 'normal'}", [0.0510213457] * 2, None),
        ("gimbal_deg = {rms = 0.1, axes = 1}", [0.1, 0.1], None),
        ('gimbal_deg = {sigma = 0.1, distribution = "student-t", df = 5}', [0.1, 0.1], "Student-t with 5 degrees of"),
        ('gimbal_deg = {sigma = 0.1, distribution = "outliers", share = 0.1, times = 5}', [0.1, 0.1], "a mixture of 2"),
        ("gimbal_deg = {sigma = 0.1}", [0.1, 0.1], None),
        (
            'gimbal_deg = {sigma = 0.1, distribution = "truncated-normal", low = -2, high = 1}',
            [0.1, 0.1],
            "normal trun",
        ),
        (
            'gimbal_deg = {sigma = 0.1, distribution = "truncated-normal", high = 3}',
            [0.1, 0.1],
            "normal truncated to -i",
        ),
        (
            'gimbal_deg = {distribution = "empirical", residuals = [0.1, -0.1, 0.1, -0.1]}',
            [0.1 * (5 / 6) ** 0.5] * 2,
            "empirical",
        ),
        (
            'gimbal_deg = {sigma = 0.2, distribution = "empirical", residuals = [1, 2, 4]}',
            [0.2, 0.2],
            "empirical with 5",
        ),
        (
            'gimbal_deg = {distribution = "empirical", probabilities = [0, 1], values = [0, 6]}',
            [3**0.5] * 2,
            "empirical",
        ),
        (
            'gimbal_deg = {distribution = "mixture", parts = [{share = 0.5, sigma = 3, mean = -4}, '
            "{share = 0.5, sigma = 3, mean = 4}]}",
            [5.0, 5.0],
            "a mixture of 2",
        ),
    ],
)
def test_errors_as_data_sheets_state_them(scene_file, errors: str, sigma: list[float], shape: str | None) -> None:
    model = read_scene(scene_file(f"{GOOD}\n[errors]\n{errors}\n")).errors
    assert model is not None
    (source,) = model.sources
    np.testing.assert_allclose(np.rad2deg(np.asarray(source.sigma)), sigma, rtol=1e-9)
    for one in source.shapes:
        assert one is None if shape is None else one.words.startswith(shape)


@pytest.mark.parametrize(
    "shape",
    [
        TruncatedNormal(-2.0, 1.0),
        TruncatedNormal(-np.inf, 3.0),
        Empirical.of_residuals([-0.3, 0.1, 0.4, 2.0]),
        Mixture.of_outliers(share=0.1, times=5.0),
        Mixture(np.array([0.25, 0.75]), np.array([1.0, 2.0]), np.array([3.0, -1.0])),
        StudentT(5.0),
        Laplace(),
    ],
    ids=lambda shape: shape.words,
)
def test_distributions_are_written_and_read_back(scene_file, tmp_path: pathlib.Path, shape) -> None:
    given = Position.from_ned(north=1.0, east=2.0, down=3.0, distribution=shape)
    write_errors(tmp_path / "errors.toml", ErrorModel((given,)))
    model = read_scene(scene_file(GOOD + (tmp_path / "errors.toml").read_text())).errors
    assert model is not None
    (found,) = model.sources
    np.testing.assert_array_equal(found.sigma, given.sigma)
    normal = jnp.linspace(-3.0, 3.0, 7)
    for one in found.shapes:
        assert type(one) is type(shape)
        np.testing.assert_allclose(one.standardised(normal), shape.standardised(normal), rtol=1e-12, atol=1e-12)


def test_sigmas_are_written_in_full(scene_file, tmp_path: pathlib.Path) -> None:
    given = (
        Position.from_ned(north=1.0 / 3.0, east=0.1 + 0.2, down=1234.56789012345),
        Attitude.from_degrees(heading=0.05, pitch=1.0 / 7.0, roll=0.3),
    )
    write_errors(tmp_path / "errors.toml", ErrorModel(given))
    text = (tmp_path / "errors.toml").read_text()
    assert "0.05," in text  # no more digits than needed
    model = read_scene(scene_file(GOOD + text)).errors
    assert model is not None
    for one, other in zip(model.sources, given, strict=True):
        np.testing.assert_allclose(one.sigma, other.sigma, rtol=1e-15)


def test_distributions_without_a_form_are_refused(tmp_path: pathlib.Path) -> None:
    mixed = Position.from_ned(north=1.0, east=2.0, down=3.0, distribution=(Laplace(), None, TruncatedNormal(-1.0, 1.0)))
    with pytest.raises(SceneError, match="no form in a scene file"):
        write_errors(tmp_path / "errors.toml", ErrorModel((mixed,)))


def test_radii_of_positions_and_heights_are_sigmas(scene_file) -> None:
    text = "[errors]\nposition_m = {ce = 1.5, le = 3.0, probability = 0.9}\nterrain_m = {le = 5.0, probability = 0.9}\n"
    model = read_scene(scene_file(GOOD + text)).errors
    assert model is not None
    position, terrain = model.sources
    np.testing.assert_allclose(position.sigma, [0.6989859, 0.6989859, 1.8238705], rtol=1e-6)
    np.testing.assert_allclose(terrain.sigma, [3.0397842], rtol=1e-7)
    text = "[errors]\nterrain_m = {sigma = 5.0, distribution = 'laplace'}\nterrain_correlation_m = 800.0\n"
    model = read_scene(scene_file(GOOD + text)).errors
    assert model is not None
    assert model.sources[0].shapes[0].words == "Laplace"
    text = "[errors]\nposition_m = {se = 3.0, probability = 0.5}\n"
    model = read_scene(scene_file(GOOD + text)).errors
    assert model is not None
    np.testing.assert_allclose(model.sources[0].sigma, 3 * [1.9503667], rtol=1e-7)


@pytest.mark.parametrize(
    "errors, words",
    [
        ("gimbal_deg = {plus_minus = 0.1}", ["[errors] gimbal_deg", '"uniform": sigma 0.05774', "sigmas=2"]),
        ("gimbal_deg = {sigma = 0.1, distribution = 'gaussian'}", ["gimbal_deg", "one of normal, uni", "'gaussian'"]),
        ("gimbal_deg = {sigma = 0.1, plus_minus = 0.1}", ["gimbal_deg: give one of sigma, plus_minus, rms"]),
        ("gimbal_deg = {distribution = 'uniform'}", ["gimbal_deg: give one of", "none of them"]),
        ("gimbal_deg = {sigma = [0.1, 0.1, 0.1]}", ["gimbal_deg.sigma", "2 numbers"]),
        ("gimbal_deg = {sigma = -0.1}", ["gimbal_deg] sigma", "at least 0"]),
        ("gimbal_deg = {sigm = 0.1}", ["gimbal_deg] sigm = 0.1", "write sigma"]),
        ("gimbal_deg = {sigma = 'x'}", ["gimbal_deg] sigma = 'x'", "standard deviation"]),
        ("gimbal_deg = {rms = 0.1}", ["gimbal_deg", "axes=1: sigma 0.1"]),
        ("gimbal_deg = {sigma = 0.1, sigmas = 2}", ["gimbal_deg: sigmas goes with plus_minus"]),
        ("gimbal_deg = {sigma = 0.1, distribution = 'student-t'}", ['distribution = "student-t" needs df']),
        ("gimbal_deg = {sigma = 0.1, distribution = 'student-t', df = 2}", ["df must be above 2", "got 2."]),
        ("gimbal_deg = {sigma = 0.1, df = 3}", ['distribution = "student-t" alone has df']),
        ("gimbal_deg = {sigma = 0.1, distribution = 'outliers', share = 2, times = 3}", ["share must lie in"]),
        ("gimbal_deg = {plus_minus = 0.1, distribution = 'laplace'}", ["plus_minus goes with"]),
        ("gimbal_deg = {ce = 0.1, probability = 0.5}", ["gimbal_deg: give sigma, plus_minus or rms"]),
        ("position_m = {ce = 1.5}", ["position_m: give ce and le (horizontal", "got ce."]),
        ("position_m = {ce = 1.5, le = 2.0}", ["position_m", "0.5 (CEP): sigma 1.274"]),
        ("position_m = {ce = 1.5, le = 2.0, probability = 90}", ["position_m: probability must lie between 0 and 1"]),
        ("terrain_m = {le = 5.0, distribution = 'uniform', probability = 0.9}", ["distribution goes with sigma"]),
        ("terrain_m = {sigma = 1.0, distribution = 'truncated-normal'}", ["needs low or high; got none of them"]),
        ("terrain_m = {distribution = 'truncated-normal', low = -1}", ["give one of sigma, plus_minus", "got none"]),
        ("terrain_m = {plus_minus = 1.0, distribution = 'truncated-normal', low = -1}", ["plus_minus goes with"]),
        ("terrain_m = {sigma = 1.0, distribution = 'truncated-normal', low = 2, high = 1}", ["low below high, in"]),
        ("terrain_m = {sigma = 1.0, distribution = 'laplace', low = 2}", ['"truncated-normal" alone has low']),
        ("terrain_m = {sigma = 1.0, residuals = [1.0, 2.0]}", ['"empirical" alone has residuals']),
        ("terrain_m = {distribution = 'empirical', residuals = [1.0]}", ["terrain_m] residuals", "at least 2 items"]),
        ("terrain_m = {distribution = 'empirical', residuals = [1.0, 1.0]}", ["are all 1, which leaves no error"]),
        ("terrain_m = {distribution = 'empirical', values = [1.0, 2.0]}", ["residuals or probabilities and values"]),
        ("terrain_m = {distribution = 'empirical', probabilities = [0, 0.5], values = [0, 1]}", ["must begin with 0"]),
        ("terrain_m = {distribution = 'empirical', probabilities = [0, 1], values = [0, 1, 2]}", ["a value for each"]),
        ("terrain_m = {distribution = 'mixture'}", ['distribution = "mixture" needs parts']),
        ("terrain_m = {distribution = 'mixture', parts = [{share = 0.5, sigma = 1}]}", ["positive and sum to 1"]),
        ("terrain_m = {distribution = 'mixture', parts = [{share = 1.0}]}", ["sigma is missing"]),
        ("gimbal_deg = {raster = 'x.tif'}", ["gimbal_deg: a raster of standard deviations is one of terrain_m"]),
        ("terrain_m = {sigma = 1.0, raster = 'x.tif'}", ["leave out sigma"]),
        ("terrain_m = {sigma = 1.0, scale = 2.0}", ["scale goes with raster"]),
        ("terrain_m = {raster = 'nowhere.tif'}", ["terrain_m: raster = 'nowhere.tif': there is no such file"]),
    ],
)  # fmt: skip
def test_mistakes_about_stated_errors_are_named(scene_file, errors: str, words: list[str]) -> None:
    with pytest.raises(SceneError) as error:
        read_scene(scene_file(f"{GOOD}\n[errors]\n{errors}\n"))
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)

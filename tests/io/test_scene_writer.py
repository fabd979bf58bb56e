"""Updated scenes and tie points: what was written is read back, and all else stays as it was."""

from __future__ import annotations

import dataclasses
import json
import pathlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io import TieRow, write_tie_points, write_updated_scene
from jaxgeo.io.scene import SceneError, read_scene
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import BrownConrady, Deflection, Pose, Sensor, Shot

SCENE = """\
title = "a test"   # kept

[camera]  # of a survey
width = 400
height = 300
focal_length_mm = 50.0   # calibrated
pixel_pitch_um = 5.0

[gimbal]
kind = "two_axis"
outer_deg = 60.0
inner_deg = -1.0  # read

[mount]
base_heading_deg = 0.5
lever_body_m = [1.0, 0.0, 0.5]

# where it was
[pose]
lat_deg = 44.2
lon_deg = 5.3     # east
height_m = 4000
height_datum = "ellipsoid"  # of GNSS
heading_deg = 359.9
pitch_deg = 2.0
roll_deg = -3.0
"""
PHOTOGRAMMETRIC = SCENE.replace(
    "heading_deg = 359.9\npitch_deg = 2.0\nroll_deg = -3.0",
    'omega_deg = 1.0\nphi_deg = -2.0\nkappa_deg = 95.0\nmap_crs = "EPSG:32631"',
)
INLINE = SCENE.replace('[gimbal]\nkind = "two_axis"\nouter_deg = 60.0\ninner_deg = -1.0  # read\n', "").replace(
    "[camera]", 'gimbal = {kind = "mirror", depression_deg = 5.0, azimuth_deg = 45.0}\n\n[camera]'
)
SCENES = {
    "ellipsoid": SCENE,
    "mean sea level": SCENE.replace('"ellipsoid"', '"EPSG:5773"'),
    "undulation": SCENE.replace('"ellipsoid"', "48.5"),
    "omega, phi, kappa": PHOTOGRAMMETRIC,
    "inline": INLINE,
}


def scene_in(folder: pathlib.Path, text: str = SCENE) -> pathlib.Path:
    path = folder / "scene.toml"
    path.write_bytes(text.encode())
    return path


def moved(shot: Shot) -> Shot:
    """The shot with a position, attitude and readings a little off, by numbers without an end."""
    position = shot.pose.position
    there = Geodetic(lat=position.lat + 1e-5 / 3.0, lon=position.lon - 1e-5 / 7.0, height=position.height + 1.0 / 3.0)
    angles = (shot.pose.heading + 1e-3 / 3.0, shot.pose.pitch - 1e-3 / 7.0, shot.pose.roll + 1e-3 / 9.0)
    return Shot(Pose(there, *angles), np.asarray(shot.gimbal_readings) + 1e-4 / 3.0, 12.5)


def assert_same_shot(found: Shot, expected: Shot) -> None:
    off = WGS84.to_ecef(found.pose.position) - WGS84.to_ecef(expected.pose.position)
    assert np.abs(off).max() < 1e-6  # m
    np.testing.assert_allclose(found.pose.R_ned_from_body, expected.pose.R_ned_from_body, atol=1e-9)  # rad
    np.testing.assert_allclose(found.gimbal_readings, expected.gimbal_readings, atol=1e-9)
    assert float(found.time) == float(expected.time)


@pytest.mark.parametrize("name", SCENES)
def test_an_updated_shot_is_read_back(tmp_path, name: str) -> None:
    scene = scene_in(tmp_path, SCENES[name])
    shot = moved(read_scene(scene).shot)
    write_updated_scene(tmp_path / "new.toml", scene, shot)
    found = read_scene(tmp_path / "new.toml")
    assert_same_shot(found.shot, shot)
    assert found.height_datum == read_scene(scene).height_datum


def test_all_else_stays_as_it_was_written(tmp_path) -> None:
    scene = scene_in(tmp_path, SCENE.replace("\n", "\r\n"))
    write_updated_scene(tmp_path / "new.toml", scene, moved(read_scene(scene).shot))
    before, after = (path.read_bytes().decode() for path in (scene, tmp_path / "new.toml"))
    changed = ("_deg = ", "height_m", "time_s")
    kept = [line for line in before.split("\r\n") if not any(key in line for key in changed) or "base" in line]
    assert [line for line in kept if line not in after.split("\r\n")] == []
    assert all(comment in after for comment in ("# read", "# east", "# where it was"))
    write_updated_scene(scene, scene, read_scene(scene).shot)  # onto itself, unchanged
    assert_same_shot(read_scene(scene).shot, read_scene(scene_in(tmp_path)).shot)


def test_a_levelled_attitude_is_written_against_the_ellipsoid(tmp_path) -> None:
    scene = scene_in(tmp_path)
    shot = read_scene(scene).shot
    shot = eqx.tree_at(
        lambda s: s.pose.deflection, shot, Deflection.from_arcseconds(xi=20.0, eta=-15.0), is_leaf=lambda x: x is None
    )
    write_updated_scene(tmp_path / "new.toml", scene, shot)
    assert_same_shot(read_scene(tmp_path / "new.toml").shot, shot)


def updated(sensor: Sensor) -> Sensor:
    """A sensor with another lens, boresight and lever arm."""
    R = R_from_rotation_vector(jnp.array([1e-3, -2e-3, 3e-3])) @ sensor.mount.R_body_from_base
    return eqx.tree_at(
        lambda s: (
            s.camera.focal_px,
            s.camera.principal_px,
            s.camera.distortion,
            s.mount.R_body_from_base,
            s.mount.lever_head,
        ),
        sensor,
        (
            sensor.camera.focal_px * 1.0001,
            sensor.camera.principal_px + jnp.array([0.3, -0.7]),
            BrownConrady(k1=-0.01, p2=1e-4),
            R,
            np.array([0.0, 0.01, -0.02]),
        ),
    )


@pytest.mark.parametrize("camera", ["focal_length_mm = 50.0\npixel_pitch_um = 5.0", "focal_px = 10000.0"])
def test_an_updated_sensor_is_read_back(tmp_path, camera: str) -> None:
    text = SCENE.replace("focal_length_mm = 50.0   # calibrated\npixel_pitch_um = 5.0", camera)
    scene = scene_in(tmp_path, text)
    before = read_scene(scene)
    sensor = updated(before.sensor)
    write_updated_scene(tmp_path / "new.toml", scene, before.shot, sensor)
    found = read_scene(tmp_path / "new.toml").sensor
    expected, got = jax.tree.leaves(sensor), jax.tree.leaves(found)
    assert jax.tree.structure(sensor) == jax.tree.structure(found)
    for one, other in zip(expected, got, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize(
    "change, message",
    [
        (
            lambda s: eqx.tree_at(lambda s: s.gimbal.offset, s, np.array([1e-3, 0.0])),
            "no key for the gimbal.s axes, signs, gains",
        ),
        (lambda s: eqx.tree_at(lambda s: s.mount.R_head_from_camera, s, np.eye(3)), "no key for R_head_from_camera"),
        (lambda s: eqx.tree_at(lambda s: s.camera.focal_px, s, np.array([9999.0, 9998.0])), "focal_length_mm is one"),
    ],
)
def test_what_a_scene_has_no_key_for_is_refused(tmp_path, change, message: str) -> None:
    scene = scene_in(tmp_path)
    before = read_scene(scene)
    with pytest.raises(SceneError, match=message):
        write_updated_scene(tmp_path / "new.toml", scene, before.shot, change(before.sensor))
    assert not (tmp_path / "new.toml").exists()


def test_shots_that_are_none_of_the_scene_are_refused(tmp_path) -> None:
    scene = scene_in(tmp_path)
    shot = read_scene(scene).shot
    lost = eqx.tree_at(lambda s: s.pose.heading, shot, np.nan)
    many = eqx.tree_at(lambda s: s.pose.heading, shot, np.zeros(3))
    high = eqx.tree_at(lambda s: s.pose.position.height, shot, 3e6)
    for wrong, message in (
        (lost, "not finite"),
        (many, "has one shot"),
        (Shot(shot.pose, np.zeros(3)), "readings outer, inner"),
        (high, r"\[pose\] height_m = 3000000.0: must be at most"),
    ):
        with pytest.raises(ValueError, match=message):
            write_updated_scene(tmp_path / "new.toml", scene, wrong)
    scene = scene_in(tmp_path, SCENE.split("# where")[0] + '[shots]\nheight_datum = "ellipsoid"\n')
    with pytest.raises(SceneError, match=r"\[pose\] is missing"):
        write_updated_scene(tmp_path / "new.toml", scene, shot)


TIE = TieRow(lat_deg=44.2, lon_deg=185.25, column=10.5, row=20.25, height_m=312.5, score=0.9, sigma_m=1.5, weight=0.8)


def test_tie_points_are_points_with_reasons(tmp_path) -> None:
    lost = dataclasses.replace(TIE, chosen=False, reason="its peak is no better than the next", score=float("nan"))
    write_tie_points(tmp_path / "ties.geojson", [TIE, lost])
    found = json.loads((tmp_path / "ties.geojson").read_text())
    assert "crs" not in found
    first, second = found["features"]
    assert first["geometry"] == {"type": "Point", "coordinates": [-174.75, 44.2, 312.5]}
    expected = {"column": 10.5, "row": 20.25, "score": 0.9, "sigma_m": 1.5, "weight": 0.8, "chosen": True}
    assert expected.items() <= first["properties"].items()
    assert first["properties"]["residual_row_px"] is None
    assert second["properties"]["score"] is None
    assert (second["properties"]["chosen"], second["properties"]["reason"]) == (False, lost.reason)
    write_tie_points(tmp_path / "ties.geojson", [TIE, dataclasses.replace(TIE, height_m=None)])
    found = json.loads((tmp_path / "ties.geojson").read_text())
    assert found["features"][0]["geometry"]["coordinates"] == [-174.75, 44.2]


@pytest.mark.parametrize("height, epsg", [(412.5, 4979), (None, 4326)])
def test_geopandas_reads_tie_points_and_their_crs(tmp_path, height: float | None, epsg: int) -> None:
    geopandas = pytest.importorskip("geopandas")
    write_tie_points(tmp_path / "ties.geojson", [dataclasses.replace(TIE, height_m=height)])
    found = geopandas.read_file(tmp_path / "ties.geojson")
    assert found.crs.to_epsg() == epsg
    (place,) = found.geometry
    assert (place.x, place.y) == pytest.approx((TIE.lon_deg - 360.0, TIE.lat_deg), abs=1e-9)
    assert place.has_z == (height is not None)
    assert found.loc[0, "column"] == pytest.approx(TIE.column, abs=1e-3)


@pytest.mark.parametrize(
    "name, rows, message",
    [
        ("ties.csv", [TIE], "written as GeoJSON"),
        ("ties.json", [], "no tie points"),
        ("ties.json", [TIE, dataclasses.replace(TIE, lat_deg=float("nan"))], "tie point 1: latitude nan"),
        ("ties.json", [dataclasses.replace(TIE, chosen=False)], "without a reason"),
    ],
)
def test_tie_points_that_cannot_be_written_are_refused(tmp_path, name: str, rows: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        write_tie_points(tmp_path / name, rows)
    assert not list(tmp_path.iterdir())

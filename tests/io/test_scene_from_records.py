"""Scene files of sensors and shots: lines of sight, angles, limits and errors as in the records."""

from __future__ import annotations

import pathlib
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.earth import Atmosphere
from jaxgeo.io import write_scene
from jaxgeo.io.scene import SceneError, read_scene
from jaxgeo.sensor import BrownConrady, Deflection
from jaxgeo.sensor.distortion import Ebner
from jaxgeo.sensor.platform import boresight_from_degrees
from jaxgeo.uncertainty import sources

LENS = BrownConrady(k1=-0.1, k2=0.02, p1=1e-3)
CAMERA = FrameCamera.from_pixels(focal_px=[1000.0, 990.0], width=640, height=480, principal_px=[322.0, 236.5],
                                 distortion=LENS)  # fmt: skip
POSE = Pose.from_degrees(lat=46.0, lon=-8.0, height=1500.0, heading=200.0, pitch=3.0, roll=-4.0)
LEVERS = {"lever_body": np.array([0.5, -0.2, 0.3]), "lever_head": np.array([0.1, 0.0, -0.1])}
TURNED = boresight_from_degrees(heading=5.0, pitch=-2.0, roll=1.0)
ANGLES = {"yaw": 30.0, "pitch": -100.0, "roll": 2.0}
WIDE = np.deg2rad([[-360.0, 360.0], [-180.0, 180.0], [-180.0, 180.0]])
SENSORS = {
    "fixed": (Gimbal.fixed(), Mount.nadir(R_body_from_base=TURNED, **LEVERS), {}),
    "two_axis": (Gimbal.two_axis(), Mount.nadir(**LEVERS), {"outer": 50.0, "inner": -3.0}),
    "mirror": (Gimbal.mirror_two_axis(), Mount.nadir(), {"depression": 30.0, "azimuth": 50.0}),
    "level": (Gimbal.three_axis(limits=WIDE), Mount.forward(**LEVERS), ANGLES),
    "three_axis": (Gimbal.three_axis(limits=WIDE, reference="body"), Mount.forward(R_body_from_base=TURNED), ANGLES),
}
PIXELS = jnp.asarray([[0.0, 0.0], [319.5, 239.5], [600.0, 20.0]])


def of(kind: str, pose: Pose = POSE) -> tuple[Sensor, Shot]:
    gimbal, mount, readings = SENSORS[kind]
    return Sensor(CAMERA, gimbal, mount), Shot(pose, gimbal.readings_from_degrees(**readings), 12.5)


def sight_lines(sensor: Sensor, shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """(perspective centre, directions in ECEF) by the matrices of the sensor."""
    sight = sensor.sight(shot)
    rays, _ = jax.vmap(sensor.camera.ray)(PIXELS)
    return np.asarray(sight.centre), np.asarray(rays @ sight.R_ecef_from_camera.T)


def assert_same_lines(one: tuple[Sensor, Shot], other: tuple[Sensor, Shot]) -> None:
    (centre, rays), (again, others) = sight_lines(*one), sight_lines(*other)
    np.testing.assert_allclose(again, centre, rtol=0, atol=1e-6)
    np.testing.assert_allclose(others, rays, rtol=0, atol=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("kind", SENSORS)
def test_a_scene_is_read_as_it_was_written(kind: str, tmp_path: pathlib.Path) -> None:
    sensor, shot = of(kind)
    errors = [
        sources.Position.from_ned(north=2.0, east=2.0, down=3.0),
        sources.Attitude.from_degrees(heading=0.3, pitch=0.1, roll=0.2),
    ]
    said = write_scene(tmp_path / "a.toml", sensor, shot, sources=errors, title="Title", comment="one\ntwo")
    assert said == ()
    assert (tmp_path / "a.toml").read_text().startswith("# one\n# two\n")
    scene = read_scene(tmp_path / "a.toml")
    assert scene.title == "Title"
    assert_same_lines((sensor, shot), (scene.sensor, scene.shot))
    assert tomllib.loads((tmp_path / "a.toml").read_text())["gimbal"]["kind"] == kind
    np.testing.assert_allclose(scene.sensor.gimbal.limits, sensor.gimbal.limits, atol=1e-12)
    assert scene.sensor.gimbal.reference == sensor.gimbal.reference
    np.testing.assert_allclose(scene.shot.gimbal_readings, shot.gimbal_readings, atol=1e-12)
    assert float(scene.shot.time) == 12.5
    assert [type(one) for one in scene.errors.sources] == [type(one) for one in errors]
    for one, other in zip(scene.errors.sources, errors, strict=True):
        np.testing.assert_allclose(one.sigma, other.sigma, rtol=1e-5)


OTHERS = {
    "axes": (Gimbal.from_degrees(axes={"tilt": "y", "pan": "z"}), Mount.forward(), {"tilt": 20.0, "pan": 10.0}, POSE),
    "turned camera": (Gimbal.fixed(), Mount(R_head_from_camera=TURNED), {}, POSE),
    "plumb line": (*SENSORS["level"], jaxgeo.Pose(*(getattr(POSE, name) for name in ("position", "heading", "pitch",
                   "roll")), deflection=Deflection(1e-4, -5e-5))),
}  # fmt: skip


@pytest.mark.costly
@pytest.mark.parametrize("name", OTHERS)
def test_what_has_no_key_becomes_position_and_attitude_of_the_camera(name: str, tmp_path: pathlib.Path) -> None:
    gimbal, mount, readings, pose = OTHERS[name]
    sensor, shot = Sensor(CAMERA, gimbal, mount), Shot(pose, gimbal.readings_from_degrees(**readings), 0.0)
    errors = [
        sources.Position.from_ned(north=2.0, east=2.0, down=3.0),
        sources.Attitude.from_degrees(heading=0.3, pitch=0.1, roll=0.2),
    ]
    said = write_scene(tmp_path / "a.toml", sensor, shot, sources=errors)
    assert "camera that looks down" in said[0]
    assert said[1].startswith("errors of attitude are left out")
    assert len(said) == 2
    scene = read_scene(tmp_path / "a.toml")
    assert_same_lines((sensor, shot), (scene.sensor, scene.shot))
    assert [type(one) for one in scene.errors.sources] == [sources.Position]


@pytest.mark.costly
def test_air_is_the_standard_atmosphere_or_refused(tmp_path: pathlib.Path) -> None:
    write_scene(tmp_path / "a.toml", *of("fixed"), atmosphere=Atmosphere(sea_level=31.0))
    assert float(read_scene(tmp_path / "a.toml").atmosphere.sea_level) == 31.0
    with pytest.raises(SceneError, match="standard atmosphere"):
        write_scene(tmp_path / "b.toml", *of("fixed"), atmosphere=Atmosphere(temperature_offset=5.0))
    assert not (tmp_path / "b.toml").exists()


def test_what_a_scene_cannot_hold_is_refused(tmp_path: pathlib.Path) -> None:
    sensor, shot = of("fixed")
    bent = FrameCamera.from_pixels(focal_px=1000.0, width=640, height=480, distortion=Ebner.zero(scale=0.3))
    with pytest.raises(SceneError, match="Ebner"):
        write_scene(tmp_path / "a.toml", Sensor(bent, sensor.gimbal, sensor.mount), shot)
    nowhere = Pose.from_degrees(lat=46.0, lon=-8.0, height=1500.0)
    nowhere = Pose(nowhere.position, jnp.nan, nowhere.pitch, nowhere.roll)
    with pytest.raises(SceneError, match="finite"):
        write_scene(tmp_path / "a.toml", sensor, Shot(nowhere, shot.gimbal_readings, 0.0))
    with pytest.raises(TypeError, match="shot"):
        write_scene(tmp_path / "a.toml", sensor, POSE)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_is_refused_leaves_the_file_as_it_was(tmp_path: pathlib.Path) -> None:
    (tmp_path / "a.toml").write_text("precious")
    sensor, shot = of("fixed", Pose.from_degrees(lat=46.0, lon=-8.0, height=5e7))
    with pytest.raises(SceneError, match="not written"):
        write_scene(tmp_path / "a.toml", sensor, shot)
    assert (tmp_path / "a.toml").read_text() == "precious"


@pytest.mark.costly
def test_limits_are_one_pair_for_each_reading_and_in_order(tmp_path: pathlib.Path) -> None:
    write_scene(tmp_path / "a.toml", *of("level"))
    text = (tmp_path / "a.toml").read_text()
    shown = next(line for line in text.splitlines() if line.startswith("limits_deg"))
    for wrong, word in (("limits_deg = [[-360.0, 360.0]]", "one pair for each reading"),
                        ("limits_deg = [[1.0, -1.0], [0.0, 1.0], [0.0, 1.0]]", "the least first")):  # fmt: skip
        (tmp_path / "b.toml").write_text(text.replace(shown, wrong))
        with pytest.raises(SceneError, match=word):
            read_scene(tmp_path / "b.toml")

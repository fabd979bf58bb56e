"""Reconstructions and tables of orientations as exposures: poses of their readers, cameras by name, stated errors."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import jax
import numpy as np
import pytest

from jaxgeo import WGS84, BrownConrady, FrameCamera, Sensor, Shot
from jaxgeo.earth import Geodetic
from jaxgeo.io import TableError, read_opensfm, read_orientations
from jaxgeo.io.acquisitions.blocks import acquisition_of_opensfm, acquisition_of_orientations
from jaxgeo.io.acquisitions.record import Acquisition, UnstatedDatum

BROWN = {
    "projection_type": "brown", "width": 800, "height": 600, "focal_x": 0.666, "focal_y": 0.667, "c_x": -0.0015,
    "c_y": 0.00475, "k1": -0.064, "k2": 0.022, "p1": 0.0007, "p2": 0.0003, "k3": -0.006,
}  # fmt: skip
PERSPECTIVE = {"projection_type": "perspective", "width": 800, "height": 600, "focal": 0.9, "k1": -0.05, "k2": 0.01}
UPRIGHT = PERSPECTIVE | {"width": 600, "height": 800}
SHOTS = {
    "a.jpg": ([2.9, 0.4, -0.2], [0.0, 5.0, 100.0], "brown"),
    "b.jpg": ([1.9, -1.98, 0.55], [-71.0, 19.0, 110.0], "old"),
    "c.jpg": ([3.0, 0.3, -0.1], [10.0, 5.0, 100.0], "brown"),
}
POINTS = {"1": [3.0, -4.0, 1.5], "7": [-2.0, 1.0, -2.0]}
EARTH = """image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,camera
a,43.7,4.6,1800.0,350.0,30.0,-1.5,eagle
b,43.8,4.7,1810.0,-10.0,-5.0,2.0,falcon
c,43.9,4.7,1820.0,10.0,-5.0,2.0,eagle
"""
SIGMAS = ",sigma_north_m,sigma_east_m,sigma_down_m,sigma_heading_deg,sigma_pitch_deg,sigma_roll_deg,time_s"


def reconstruction(cameras: dict[str, Any] | None = None, **change: Any) -> list[dict[str, Any]]:
    shots = {
        name: {"rotation": r, "translation": t, "camera": camera, "capture_time": 1e9 + k, "gps_dop": 0.1 * k}
        for k, (name, (r, t, camera)) in enumerate(SHOTS.items())
    }
    one = {
        "cameras": {"brown": BROWN, "old": PERSPECTIVE} if cameras is None else cameras,
        "shots": shots,
        "points": {name: {"coordinates": xyz} for name, xyz in POINTS.items()},
        "reference_lla": {"latitude": 24.6801, "longitude": 120.9512, "altitude": 12.5},
    }
    return [{key: value for key, value in (one | change).items() if value is not None}]


@pytest.fixture
def file(tmp_path: pathlib.Path):
    def write(content: Any, name: str = "reconstruction.json") -> pathlib.Path:
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
        return path

    return write


@jax.jit
def _seen(sensor: Sensor, shot: Shot, p: Geodetic) -> Any:
    p_ecef = jax.vmap(WGS84.to_ecef)(p)
    return jax.vmap(lambda one: sensor.project_ecef(shot, one)[0])(p_ecef)


@jax.jit
def _imaged(camera: FrameCamera, p_camera: Any) -> Any:
    return jax.vmap(lambda p: camera.project(p)[0])(p_camera)


def camera_of(found: Acquisition, name: str) -> FrameCamera:
    sensor, _, _ = found.exposure(found.index_of(name))
    assert sensor is not None
    assert isinstance(sensor.camera, FrameCamera)
    return sensor.camera


def test_exposures_of_a_reconstruction_see_its_points(file) -> None:
    path = file(reconstruction())
    block = read_opensfm(path, height_datum="ellipsoid")
    found = acquisition_of_opensfm(path, height_datum="ellipsoid")
    assert found.names.tolist() == list(SHOTS)
    places = block.positions()
    for k, name in enumerate(SHOTS):
        sensor, shot, sources = found.exposure(k)
        assert sensor is not None
        p_camera = (block.points - block.centres[k]) @ block.R_enu_from_camera[k]
        expected = _imaged(block.cameras[block.camera[k]], p_camera)
        np.testing.assert_allclose(_seen(sensor, shot, places), expected, atol=1e-5)  # px; of rounding in ECEF
        assert float(shot.time) == 1e9 + k
        assert found.tags[found.index_of(name)] == {"capture_time": 1e9 + k, "gps_dop": 0.1 * k}
        assert sources == ()
    assert not found.time_is_utc
    assert any("unknown time zone" in sentence for sentence in found.assumed)


def test_a_reconstruction_says_what_it_does_not_say(file) -> None:
    with pytest.raises(UnstatedDatum, match=r"altitude 12.5, .* Pass height_datum="):
        acquisition_of_opensfm(file(reconstruction()))
    with pytest.raises(TableError, match="no place on the Earth"):
        acquisition_of_opensfm(file(reconstruction(reference_lla=None)))
    with pytest.raises(TableError, match="not a JSON file"):
        acquisition_of_opensfm(file("{"))
    content = reconstruction()
    del content[0]["shots"]["b.jpg"]["capture_time"]
    found = acquisition_of_opensfm(file(content), height_datum=3.0)
    assert not np.any(found.shots.time)
    assert any("their time is 0" in sentence for sentence in found.assumed)
    assert any("3 m above the ellipsoid, as given" in sentence for sentence in found.assumed)


def test_images_of_one_record_are_of_one_size(file) -> None:
    path = file(reconstruction({"brown": BROWN, "old": UPRIGHT}))
    with pytest.raises(TableError, match=r"sizes: 'brown' 800 x 600, 'old' 600 x 800; choose one with camera="):
        acquisition_of_opensfm(path, height_datum="ellipsoid")
    found = acquisition_of_opensfm(path, height_datum="ellipsoid", camera="brown")
    assert found.names.tolist() == ["a.jpg", "c.jpg"]
    assert [tag["gps_dop"] for tag in found.tags] == [0.0, 0.2]
    assert found.shots.time.tolist() == [1e9, 1e9 + 2]
    whole = acquisition_of_opensfm(file(reconstruction()), height_datum="ellipsoid")
    np.testing.assert_allclose(found.shots.pose.heading, whole.shots.pose.heading[[0, 2]], atol=0)
    with pytest.raises(TableError, match="no image is of camera='phone'; they are of brown, old"):
        acquisition_of_opensfm(path, height_datum="ellipsoid", camera="phone")


def test_one_of_several_reconstructions(file) -> None:
    path = file([*reconstruction(), *reconstruction(shots={"z": next(iter(reconstruction()[0]["shots"].values()))})])
    found = acquisition_of_opensfm(path, height_datum="ellipsoid", part=1)
    assert found.names.tolist() == ["z"]
    with pytest.raises(UnstatedDatum):
        acquisition_of_opensfm(path, part=1)


EAGLE = FrameCamera.from_pixels(focal_px=1000.0, width=800, height=600)
FALCON = FrameCamera.from_pixels(focal_px=2000.0, width=800, height=600, distortion=BrownConrady(k1=-0.1))


def test_a_table_with_cameras_by_name(file) -> None:
    path = file(EARTH, "block.csv")
    found = acquisition_of_orientations(path, cameras={"eagle": EAGLE, "falcon": FALCON}, height_datum="ellipsoid")
    for name, expected in (("a", EAGLE), ("b", FALCON), ("c", EAGLE)):
        points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.2, 1.0]])
        np.testing.assert_allclose(_imaged(camera_of(found, name), points), _imaged(expected, points), atol=1e-9)  # px
    table = read_orientations(path, height_datum="ellipsoid")
    for ours, theirs in zip(jax.tree.leaves(found.shots.pose), jax.tree.leaves(table.pose), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert found.sources == ()
    assert acquisition_of_orientations(path, height_datum="ellipsoid").sensor is None
    alone = acquisition_of_orientations(path, cameras=FALCON, camera="falcon", height_datum="ellipsoid")
    assert alone.names.tolist() == ["b"]
    assert float(camera_of(alone, "b").distortion.k1) == -0.1  # type: ignore[attr-defined]


def test_stated_errors_are_sources(file) -> None:
    header, *rows = EARTH.splitlines()
    text = "\n".join(
        [header + SIGMAS, *(f"{row},0.1,0.2,0.3,0.05,0.02,{0.01 * k + 0.01},{k}.5" for k, row in enumerate(rows))]
    )
    found = acquisition_of_orientations(file(text, "block.csv"), height_datum="ellipsoid")
    _, shot, (position, attitude) = found.exposure(2)
    assert float(shot.time) == 2.5
    np.testing.assert_allclose(position.sigma, [0.1, 0.2, 0.3], atol=1e-15)  # m
    np.testing.assert_allclose(np.rad2deg(attitude.sigma), [0.05, 0.02, 0.03], atol=1e-12)  # heading, pitch, roll
    assert any("none of their correlations" in sentence for sentence in found.assumed)


def test_tables_that_do_not_fit_their_cameras(file) -> None:
    path = file(EARTH, "block.csv")
    bare = file("\n".join(line.rsplit(",", 1)[0] for line in EARTH.splitlines()), "bare.csv")
    both = {"eagle": EAGLE, "falcon": FALCON}
    wide = FrameCamera.from_pixels(focal_px=1000.0, width=900, height=600)

    def refused(path: pathlib.Path, words: str, **options: Any) -> None:
        with pytest.raises(TableError, match=words):
            acquisition_of_orientations(path, height_datum="ellipsoid", **options)

    refused(path, "images are of eagle, falcon; give cameras by name, or choose camera=", cameras=EAGLE)
    refused(path, "images are of camera 'falcon', but known are eagle", cameras={"eagle": EAGLE})
    refused(path, "'eagle' 900 x 600, 'falcon' 800 x 600; choose one", cameras=both | {"eagle": wide})
    refused(path, "no image is of camera='kite'", camera="kite")
    refused(bare, "there is no column camera; give one camera", cameras=both)
    refused(bare, "camera='eagle' is asked for, but there is no column camera", camera="eagle")
    with pytest.raises(UnstatedDatum, match="does not state the vertical datum of its heights"):
        acquisition_of_orientations(path)
    with pytest.raises(TypeError, match="cameras"):
        acquisition_of_orientations(path, cameras=3, height_datum="ellipsoid")  # type: ignore[arg-type]


def test_a_real_block_of_opendronemap(jaxgeo_test_data: pathlib.Path) -> None:
    """Its reconstruction and its table of angles are the same exposures."""
    folder = jaxgeo_test_data / "odm_miaoli"
    shots = acquisition_of_opensfm(
        folder / "opensfm" / "reconstruction.json", height_datum="ellipsoid", crs="EPSG:32651"
    )
    table = acquisition_of_orientations(folder / "odm_xyz_opk.csv", height_datum="ellipsoid", crs="EPSG:32651")
    rows = [table.index_of(name) for name in shots.names]
    ours, theirs = shots.shots.pose, jax.tree.map(lambda x: x[rows], table.shots.pose)
    np.testing.assert_allclose(np.exp(1j * ours.heading), np.exp(1j * theirs.heading), atol=3e-5)
    np.testing.assert_allclose(ours.pitch, theirs.pitch, atol=2e-5)  # written to 0.001 deg
    np.testing.assert_allclose(ours.position.lat, theirs.position.lat, atol=1e-9)
    assert shots.tags[0]["gps_dop"] == 0.0452
    assert np.all((shots.shots.time > 1.5e9) & (shots.shots.time < 1.6e9))

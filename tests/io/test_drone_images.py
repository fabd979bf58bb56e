"""Drone images: rays along the angles written, cameras by other libraries' formula, heights never guessed, refusals.

Held against: images of a DJI drone as it wrote them (the block Miaoli of OpenDroneMap's data), positions of EXIF as
GDAL reads them, lenses by OpenCV, tags as DJI, Skydio, Parrot and Autel publish or write them, and EXIF as GDAL puts it
into a TIFF file.
"""

from __future__ import annotations

import pathlib
from datetime import UTC, datetime
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from scipy.spatial.transform import Rotation

from jaxgeo import WGS84, FrameCamera, Sensor, Shot, intersect
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.earth.ray import Ray
from jaxgeo.io import TableError, VerticalDatumError
from jaxgeo.io.acquisitions import UnstatedDatum
from jaxgeo.io.acquisitions._image_tags import read_tags
from jaxgeo.io.acquisitions.drone_images import read_drone_images
from jaxgeo.io.errors import ImageError
from tests.support.drone_image_files import (
    CAMERA,
    FULL,
    ORIENTATION,
    PLACE,
    PLACE_DEG,
    SIZE,
    SPACES,
    packet,
    write_image,
)
from tests.support.miaoli import FRAMES, UNDULATION, Village

CLOCK = {0x9003: "2024:05:10 14:09:12"}
LAT, LON = 46.592612704, 7.525073398
DJI: dict[str, Any] = {
    "drone-dji:AbsoluteAltitude": "+1538.962",
    "drone-dji:RelativeAltitude": "+26.600",
    "drone-dji:GpsLatitude": f"+{LAT}",
    "drone-dji:GpsLongtitude": f"+{LON}",
    "drone-dji:GimbalYawDegree": "-97.40",
    "drone-dji:GimbalPitchDegree": "-35.50",
    "drone-dji:GimbalRollDegree": "+2.50",
    "drone-dji:FlightYawDegree": "+92.80",
    "drone-dji:FlightPitchDegree": "-4.00",
    "drone-dji:FlightRollDegree": "+2.30",
    "drone-dji:RtkFlag": "50",
    "drone-dji:RtkStdLon": "0.0097",
    "drone-dji:RtkStdLat": "0.0093",
    "drone-dji:RtkStdHgt": "0.0238",
    "drone-dji:CalibratedFocalLength": "3666.67",
    "drone-dji:CalibratedOpticalCenterX": "2010.0",
    "drone-dji:CalibratedOpticalCenterY": "1490.0",
}
DEWARP = {
    "drone-dji:DewarpFlag": "0",
    "drone-dji:DewarpData": "2018-09-07;3657.02,3650.62,-4.03,23.1,-0.267098,0.111977,0.000924881,0.0000882,-0.0331614",
}
SKYDIO: dict[str, Any] = {
    "drone-skydio:Latitude": LAT,
    "drone-skydio:Longitude": LON,
    "drone-skydio:AbsoluteAltitude": "312.25",
    "drone-skydio:RelativeAltitude": "40.5",
    "drone-skydio:VertCS": "ellipsoidal",
    "drone-skydio:CameraOrientationNED": {"Roll": "2.5", "Pitch": "-35.5", "Yaw": "-97.4"},
    "drone-skydio:CalibratedFocalLength": {"X": "2376.5625", "Y": "2370.5"},
    "drone-skydio:CalibratedOpticalCenter": {"X": "1999.5", "Y": "1499.5"},
    "drone-skydio:DewarpData": "0.13, -0.24, 0.104",
}
PARROT: dict[str, Any] = {
    "drone-parrot:CameraYawDegree": "-97.4",
    "drone-parrot:CameraPitchDegree": "-35.5",
    "drone-parrot:CameraRollDegree": "2.5",
    "Camera:Yaw": "-97.4",
    "Camera:Pitch": "54.5",
    "Camera:Roll": "0",
    "Camera:GPSXYAccuracy": "845389/2097152",
    "Camera:GPSZAccuracy": "5117051/8388608",
}
PIX4D = {"Camera:Yaw": "-97.4", "Camera:Pitch": "54.5", "Camera:Roll": "0.0"}
AUTEL_LITE = {"camera:Yaw": "-97.4", "camera:Pitch": "-35.5", "camera:Roll": "2.5"}
AUTEL_NEW = {name.replace("drone-dji:", "drone:"): value for name, value in DJI.items()}


def read(path: pathlib.Path | list[pathlib.Path], **options: Any):
    given: dict[str, Any] = {"height_datum": "ellipsoid"} | options
    return read_drone_images(path, **given)


@pytest.fixture
def image(tmp_path: pathlib.Path):
    """Writes an image with tags of XMP and returns its path."""

    def write(tags: Any = DJI, name: str = "a.jpg", *, elements: bool = False, **options: Any) -> pathlib.Path:
        xmp = tags if isinstance(tags, str) else packet(tags, elements=elements)
        return write_image(tmp_path / name, xmp, **options)

    return write


@eqx.filter_jit
def R_ned_from_camera(sensor: Sensor, shot: Shot) -> Any:
    return sensor.R_ned_from_camera(shot)


@eqx.filter_jit
def projected(camera: Any, points: np.ndarray) -> Any:
    return jax.vmap(lambda p: camera.project(p)[0])(jnp.asarray(points))


def orientation(path: pathlib.Path, **options: Any) -> np.ndarray:
    sensor, shot, _ = read(path, **options).exposure(0)
    assert sensor is not None
    sensor = Sensor(PINHOLE, sensor.gimbal, sensor.mount)  # one program for all lenses
    return np.asarray(R_ned_from_camera(sensor, shot))


PINHOLE = FrameCamera.from_pixels(focal_px=50.0, width=SIZE[0], height=SIZE[1])
MADE: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {  # tags, options and roll
    "DJI": (DJI, {"elements": False}, 2.5),
    "DJI, as elements": (DJI, {"elements": True}, 2.5),
    "DJI, in a TIFF": (DJI, {"name": "a.tif"}, 2.5),
    "Autel, with DJI's tags": (AUTEL_NEW, {"make": "Autel Robotics"}, 2.5),
    "Autel, of old": (PIX4D, {"make": "Autel Robotics", "model": "XT701"}, 0.0),
    "Autel, from the horizon": (AUTEL_LITE, {"make": "Camera", "model": "XL715"}, 2.5),
    "Skydio": (SKYDIO, {}, 2.5),
    "Skydio, as elements": (SKYDIO, {"elements": True}, 2.5),
    "Parrot": (PARROT, {"make": "Parrot"}, 2.5),
    "Pix4D": (PIX4D, {}, 0.0),
}


@pytest.mark.parametrize("case", MADE)
def test_the_axis_points_along_yaw_and_pitch(image, case: str) -> None:
    """Of every maker, the same camera: right, down and forward as the angles have them."""
    tags, options, roll = MADE[case]
    R = orientation(image(tags, **options))
    yaw, pitch = np.deg2rad([-97.4, -35.5])
    axis = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)]
    np.testing.assert_allclose(R[:, 2], axis, atol=1e-9)
    np.testing.assert_allclose(R[2, 0], np.cos(pitch) * np.sin(np.deg2rad(roll)), atol=1e-9)  # right side down
    head = Rotation.from_euler("ZYX", [-97.4, -35.5, roll], degrees=True).as_matrix()
    np.testing.assert_allclose(R, head[:, [1, 2, 0]], atol=1e-9)


def turned(yaw: float, pitch: float, roll: float) -> dict[str, Any]:
    angles = {"Yaw": yaw, "Pitch": pitch, "Roll": roll}
    return DJI | {f"drone-dji:Gimbal{name}Degree": f"{value:+.2f}" for name, value in angles.items()}


def test_a_gimbal_past_the_nadir(image) -> None:
    """What is written as a roll of 180 deg is the image upside down, not a look at the sky."""
    nadir = orientation(image(turned(30.0, -90.0, 180.0)))
    np.testing.assert_allclose(nadir[:, 2], [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(nadir, orientation(image(turned(-150.0, -90.0, 0.0))), atol=1e-9)
    past = orientation(image(turned(30.0, -100.0, 0.0)))
    np.testing.assert_allclose(past, orientation(image(turned(-150.0, -80.0, 180.0))), atol=1e-9)
    sensor, shot, _ = read(image(turned(30.0, -100.0, 0.0))).exposure(0)
    assert sensor is not None
    assert bool(sensor.gimbal.inside_limits(shot.gimbal_readings))
    told = read(image(DJI | {"drone-dji:GimbalReverse": "1"})).assumed
    assert any("upside down (drone-dji:GimbalReverse 1)" in line for line in told)


def test_pix4d_counts_roll_about_the_flight(image) -> None:
    """A camera of a wing looks down; its yaw, pitch and roll are those of the body that carries it."""
    R = orientation(image(PIX4D | {"Camera:Yaw": "40", "Camera:Pitch": "5", "Camera:Roll": "-8"}, make="senseFly"))
    body = Rotation.from_euler("ZYX", [40.0, 5.0, -8.0], degrees=True).as_matrix()
    np.testing.assert_allclose(R, np.stack([body[:, 1], -body[:, 0], body[:, 2]], axis=-1), atol=1e-9)


def test_a_jpeg_with_a_preview_behind_it(image, tmp_path: pathlib.Path) -> None:
    """Newer cameras put another image behind the first, in the format MPO."""
    with Image.open(image(name="b.jpg", exif=CAMERA | CLOCK)) as alone:
        preview = Image.new("RGB", (8, 6))
        given: dict[str, Any] = {"exif": alone.getexif(), "xmp": alone.info["xmp"], "append_images": [preview]}
        alone.save(tmp_path / "a.jpg", "MPO", save_all=True, **given)
    alone, behind = read_tags(tmp_path / "b.jpg"), read_tags(tmp_path / "a.jpg")
    assert (behind.width, behind.height) == SIZE
    assert behind.values == alone.values


def test_make_and_model_by_xmp_alone(image) -> None:
    tags = DJI | {"tiff:Make": "DJI", "tiff:Model": "FC6310R"}
    assert read(image(tags, make="", model="")).facts["camera"] == "DJI FC6310R"


def test_what_is_not_modelled_is_said(image) -> None:
    told = read(image(DJI | {"drone-dji:ShutterType": "Electronic"})).assumed
    assert any("rows are exposed one after another is not allowed for" in line for line in told)
    assert not any("one after another" in line for line in read(image(DJI)).assumed)


def test_what_a_file_of_dji_tells(image) -> None:
    found = read(image(DJI | {"drone-dji:Unheard": "of"}), height_datum=48.25)
    pose = found.shots.pose
    position = np.array([pose.position.lat, pose.position.lon, pose.position.height])[:, 0]
    np.testing.assert_allclose(position, [np.deg2rad(LAT), np.deg2rad(LON), 1538.962 + 48.25], atol=1e-12)
    np.testing.assert_allclose(np.rad2deg([pose.heading, pose.pitch, pose.roll])[:, 0], [92.8, -4.0, 2.3], atol=1e-12)
    source, _ = found.sources
    np.testing.assert_allclose(source.sigma, [[0.0093, 0.0097, 0.0238]], atol=1e-15)  # m north, east, down
    assert (found.form, len(found), found.names.tolist()) == ("DJI drone image", 1, ["a.jpg"])
    assert found.tags[0]["drone-dji:Unheard"] == "of"
    assert found.tags[0]["EXIF:Model"] == "Model"
    assert found.facts["camera"] == "Maker Model"


# Tags, and focal lengths, principal point and distortion of the full size, pixel centres at integers.
LENSES: dict[str, tuple[dict[str, Any], dict[int, Any], tuple[float, ...], dict[str, float]]] = {
    "dewarp": (
        DJI | DEWARP,
        CAMERA,
        (3657.02, 3650.62, 1995.47, 1522.6),
        {"k1": -0.267098, "p2": 8.82e-5, "k3": -0.0331614},
    ),
    "dewarped": (DJI | DEWARP | {"drone-dji:DewarpFlag": "1"}, CAMERA, (3657.02, 3650.62, 1995.47, 1522.6), {}),
    "rational": (
        DJI
        | {
            "drone-dji:DewarpData": "0,0,0,0,0,0,0,0,0",
            "drone-dji:DewarpDataK6": "3657,3650,1,2,1e-1,2e-1,0,0,3e-1,4e-1,5e-1,6e-1",
        },
        CAMERA,
        (3657.0, 3650.0, 2000.5, 1501.5),
        {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "k5": 0.5, "k6": 0.6},
    ),
    "designed": (DJI, CAMERA, (3666.67, 3666.67, 2009.5, 1489.5), {}),
    "Skydio": (SKYDIO, CAMERA, (2376.5625, 2370.5, 1999.5, 1499.5), {"k1": 0.13, "k2": -0.24, "k3": 0.104}),
    "Pix4D": (
        PARROT
        | {
            "Camera:PerspectiveFocalLength": "527/100",
            "Camera:PerspectiveFocalLengthUnits": "mm",
            "Camera:PrincipalPoint": "3.3,2.5",
            "Camera:PerspectiveDistortion": ["0.1", "0.2", "0.3", "0.01", "0.02"],
        },
        CAMERA | {0xA20E: 6003.2, 0xA20F: 6003.2, 0xA210: 3},
        (5.27 * 600.32, 5.27 * 600.32, 3.3 * 600.32 - 0.5, 2.5 * 600.32 - 0.5),
        {"k1": 0.1, "k2": 0.2, "k3": 0.3, "p1": 0.01, "p2": 0.02},
    ),
    "EXIF, cm": (PIX4D, CAMERA | {0xA20E: 4000.0, 0xA20F: 4000.0, 0xA210: 3}, (3520.0, 3520.0, 1999.5, 1499.5), {}),
    "EXIF, inch": (PIX4D, CAMERA | {0xA20E: 10160.0, 0xA20F: 5080.0, 0xA210: 2}, (3520.0, 1760.0, 1999.5, 1499.5), {}),
    "film": (PIX4D, CAMERA, (*[24.0 * 5000.0 / 43.266615305567875] * 2, 1999.5, 1499.5), {}),
}


@pytest.mark.parametrize("case", LENSES)
def test_the_camera_is_that_of_the_full_size_made_smaller(image, case: str) -> None:
    tags, exif, (fx, fy, u, v), distortion = LENSES[case]
    found = read(image(tags, exif=exif))
    sensor, _, _ = found.exposure(0)
    assert sensor is not None
    camera: Any = sensor.camera
    scale = SIZE[0] / FULL[0]
    np.testing.assert_allclose(camera.focal_px, np.multiply([fx, fy], scale), rtol=1e-6)  # EXIF's fractions
    np.testing.assert_allclose(camera.principal_px, np.multiply([u + 0.5, v + 0.5], scale) - 0.5, atol=1e-6)
    names = camera.distortion.names
    assert {name: float(getattr(camera.distortion, name)) for name in names if getattr(camera.distortion, name)} == (
        distortion | ({"k2": 0.111977, "p1": 0.000924881} if case == "dewarp" else {})
    )
    assert any("scaled by 0.01" in line for line in found.assumed)
    assert any("free of distortion" in line for line in found.assumed) == (not distortion and case != "dewarped")


def test_dewarp_data_is_the_formula_of_opencv(image) -> None:
    cv2 = pytest.importorskip("cv2")
    sensor, _, _ = read(image(DJI | DEWARP)).exposure(0)
    assert sensor is not None
    points = np.array([[x, y, 1.0] for x in (-0.5, 0.1, 0.45) for y in (-0.35, 0.0, 0.3)])
    matrix = np.array([[3657.02, 0.0, 2000.0 - 4.03], [0.0, 3650.62, 1500.0 + 23.1], [0.0, 0.0, 1.0]])  # by edges
    bent = np.array([-0.267098, 0.111977, 0.000924881, 0.0000882, -0.0331614])
    theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, bent)[0][:, 0]
    ours = projected(sensor.camera, points)
    np.testing.assert_allclose((np.asarray(ours) + 0.5) * FULL[0] / SIZE[0], theirs, atol=1e-8)  # pixels


def test_a_camera_given(image) -> None:
    camera = FrameCamera.from_pixels(focal_px=33.0, width=SIZE[0], height=SIZE[1])
    found = read([image(name="a.jpg"), image(name="b.jpg", exif={})], camera=camera)
    sensor, _, _ = found.exposure(1)
    assert sensor is not None
    np.testing.assert_array_equal(sensor.camera.focal_px, [33.0, 33.0])  # type: ignore[attr-defined]
    assert found.facts["focal length"] == "33 pixels (as given)"
    assert [type(one).__name__ for one in found.sources] == ["Position"]  # a lens that is given does not err
    with pytest.raises(TableError, match=r"a.jpg: the image has 40 x 30 pixels, the camera given 41 x 30, which is an"):
        read(image(), camera=FrameCamera.from_pixels(focal_px=33.0, width=41, height=30))


def test_heights_are_not_guessed(image) -> None:
    path = image(DJI | {"drone-dji:AltitudeType": "RtkAlt"})
    evidence = r"AbsoluteAltitude \+1538.962, RelativeAltitude \+26.600, AltitudeType RtkAlt, RtkFlag 50"
    with pytest.raises(UnstatedDatum, match=evidence) as why:
        read_drone_images(path)
    for choice in ('"ellipsoid"', '"EPSG:5773"', "an undulation in m", "takeoff_height="):
        assert choice in str(why.value)
    assert "\n" not in str(why.value)
    found = read_drone_images(path, takeoff_height=1560.0)
    np.testing.assert_allclose(found.shots.pose.position.height, [1586.6], atol=1e-9)
    told = "Heights are drone-dji:RelativeAltitude above a take-off at 1560 m"
    assert any(told in line for line in found.assumed)
    assert [one.label for one in found.sources] == ["interior orientation"]  # RTK's are not those of a barometer
    for datum, shift in (("ellipsoid", 0.0), (40.25, 40.25)):  # of the take-off
        above = read(path, takeoff_height=1560.0, height_datum=datum)
        np.testing.assert_allclose(above.shots.pose.position.height, [1586.6 + shift], atol=1e-9)
    with pytest.raises(VerticalDatumError, match=r"a.jpg: height_datum='EPSG:0' is unknown"):
        read(path, height_datum="EPSG:0")
    with pytest.raises(TableError, match=r"its maker does not tell heights above the take-off"):
        read_drone_images(image(PARROT), takeoff_height=10.0)
    with pytest.raises(UnstatedDatum, match=r"\(GPSAltitude 123.456, GPSAltitudeRef 0\)"):
        read_drone_images(image(PARROT))


def test_skydio_says_that_heights_are_ellipsoidal(image) -> None:
    path = image(SKYDIO)
    for datum in (None, "ellipsoid"):
        found = read_drone_images(path, height_datum=datum)
        np.testing.assert_array_equal(found.shots.pose.position.height, [312.25])
    with pytest.raises(TableError, match=r"drone-skydio:VertCS: heights are above the ellipsoid; leave height_datum"):
        read_drone_images(path, height_datum="EPSG:5773")
    with pytest.raises(UnstatedDatum, match="VertCS EGM96"):
        read_drone_images(image(SKYDIO | {"drone-skydio:VertCS": "EGM96"}))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name, below", [("a.jpg", 0), ("a.tif", 1), ("a.jpg", 3)])
def test_positions_of_exif_are_those_that_gdal_reads(image, name: str, below: int) -> None:
    path = image(PARROT, name, gps=PLACE | {5: below})
    found = read(path)
    lat, lon, height = (np.asarray(x)[0] for x in found.shots.pose.position.to_degrees())
    np.testing.assert_allclose([lat, lon, height], [*PLACE_DEG[:2], PLACE_DEG[2] * (-1 if below else 1)], atol=1e-9)
    with rasterio.open(path) as data:
        theirs = data.tags() | data.tags(ns="EXIF")
    for ours, axis, sign in ((lat, "Latitude", -1.0), (lon, "Longitude", -1.0)):
        parts = [float(part.strip("( )")) for part in theirs[f"EXIF_GPS{axis}"].split(") (")]
        np.testing.assert_allclose(sign * np.dot(parts, [1.0, 1 / 60, 1 / 3600]), ours, atol=2e-8)  # of six digits
    source, _ = found.sources
    xy, z = 845389 / 2097152, 5117051 / 8388608
    np.testing.assert_allclose(source.sigma, [[xy, xy, z]], atol=1e-15)  # m


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_exif_that_gdal_has_put_into_a_tiff(image, tmp_path: pathlib.Path) -> None:
    pytest.importorskip("rasterio", minversion="1.4.4", reason="older ones lose XMP on the way")
    source = image(PARROT, exif=CAMERA | {0x9003: "2024:05:10 14:09:12"})
    target = tmp_path / "b.tif"
    with rasterio.open(source) as data:
        profile = {"driver": "GTiff", "width": SIZE[0], "height": SIZE[1], "count": 3, "dtype": "uint8"}
        with rasterio.open(target, "w", **profile) as copy:
            copy.write(data.read())
            copy.update_tags(**data.tags())
            copy.update_tags(ns="xml:XMP", **data.tags(ns="xml:XMP"))
    before, after = read(source), read(target)
    pairs = zip(*(jax.tree.leaves((found.sensor, found.shots)) for found in (before, after)), strict=True)
    for one, other in pairs:
        np.testing.assert_allclose(one, other, atol=1e-9, rtol=1e-6)
    assert after.facts["camera"] == before.facts["camera"] == "Maker Model"


NOON = datetime(2024, 5, 10, 14, 9, 12, tzinfo=UTC).timestamp()
TIMES: dict[str, tuple[dict[str, Any], dict[int, Any], dict[int, Any], float, bool]] = {
    "none": ({}, {}, {}, 0.0, False),
    "by the camera's clock": ({}, CLOCK | {0x9291: "25"}, {}, NOON + 0.25, False),
    "in a time zone": ({}, CLOCK | {0x9011: "+08:00", 0x9291: "025"}, {}, NOON - 8 * 3600 + 0.025, True),
    "west": ({}, CLOCK | {0x9011: "-03:30"}, {}, NOON + 3.5 * 3600, True),
    "by GPS": ({}, CLOCK, {29: "2024:05:10", 7: (6.0, 9.0, 11.5)}, NOON - 8 * 3600 - 0.5, True),
    "of the exposure": (
        {"drone-dji:UTCAtExposure": "2024-05-10T06:09:11.708152"},
        CLOCK,
        {},
        NOON - 28801 + 0.708152,
        True,
    ),
    "as exiftool has it": ({"drone-dji:UTCAtExposure": "2024:05:10 06:09:11.7"}, CLOCK, {}, NOON - 28801 + 0.7, True),
}


@pytest.mark.parametrize("case", TIMES)
def test_times(image, case: str) -> None:
    tags, exif, gps, seconds, is_utc = TIMES[case]
    found = read(image(DJI | tags, exif=CAMERA | exif, gps=gps))
    np.testing.assert_allclose(found.shots.time, [seconds], atol=1e-5)
    assert found.time_is_utc == is_utc
    assert any("time" in line.lower() for line in found.assumed) == (not is_utc)


def test_several_images_and_a_folder(image, tmp_path: pathlib.Path) -> None:
    far = DJI | {
        "drone-dji:GpsLatitude": "47.5",
        "drone-dji:RtkStdHgt": "0.04",
        "drone-dji:DewarpData": "1000,1010,0,0,-0.1,0,0,0,0",
    }
    paths = [image(far, "b.jpg"), image(DJI, "a.jpg")]
    (tmp_path / "flight.txt").write_text("no image")
    found = read(paths)
    assert found.names.tolist() == ["b.jpg", "a.jpg"]
    np.testing.assert_allclose(np.rad2deg(found.shots.pose.position.lat), [47.5, LAT], atol=1e-12)
    np.testing.assert_allclose(found.sources[0].sigma[:, 2], [0.04, 0.0238])
    assert found.sensor is not None
    camera: Any = found.sensor.camera
    np.testing.assert_allclose(camera.focal_px[:, 1], [10.1, 36.6667], atol=1e-9)
    np.testing.assert_allclose(camera.distortion.k1, [-0.1, 0.0])  # a lens of which nothing is said has none
    assert read(tmp_path).names.tolist() == ["a.jpg", "b.jpg"]
    (tmp_path / "c").mkdir()
    twice = read([paths[0], image(far, "c/b.jpg")])
    assert twice.names.tolist() == [str(tmp_path / "b.jpg"), str(tmp_path / "c/b.jpg")]
    partly = read([image({**DJI, "drone-dji:RtkStdLat": "0"}, "a.jpg"), paths[0]])
    np.testing.assert_allclose(partly.sources[0].sigma, [[3.0, 3.0, 5.0], [0.0093, 0.0097, 0.04]])
    assert any("1 of 2 images state no position accuracy" in line for line in partly.assumed)
    none = read(image({**DJI, "drone-dji:RtkFlag": "0"}, "a.jpg"))
    assert (len(none.sources), none.facts["position errors"]) == (1, "not said")


def test_what_a_rangefinder_hit_is_reported(image) -> None:
    laser = {"LRFTargetLat": "46.6", "LRFTargetLon": "7.53", "LRFTargetAbsAlt": "1502.5", "LRFTargetDistance": "61.2"}
    tags = DJI | {f"drone-dji:{name}": value for name, value in laser.items()}
    reported = read([image(tags, "a.jpg"), image(tags | {"drone-dji:LRFTargetDistance": "0"}, "b.jpg")]).reported
    assert reported is not None
    centre = reported.centre
    rows = np.stack([np.rad2deg(centre.lat), np.rad2deg(centre.lon), centre.height, reported.slant_range])
    np.testing.assert_allclose(rows, [[46.6, np.nan], [7.53, np.nan], [1502.5, np.nan], [61.2, np.nan]], atol=1e-12)
    assert read(image()).reported is None


def less(tags: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in tags.items() if name not in names}


BOMB = '<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>' + packet(DJI)
TWICE = packet(DJI).replace(
    "</rdf:RDF>", f'<rdf:Description xmlns:d="{SPACES["drone-dji"]}" d:GimbalYawDegree="5"/></rdf:RDF>'
)
GPS_OFF = less(DJI, "drone-dji:GpsLatitude", "drone-dji:GpsLongtitude")
REFUSED: dict[str, tuple[Any, dict[str, Any], str]] = {
    "no XMP": (
        "",
        {},
        "nothing says how the camera was turned; expected one of drone-dji.* found XMP of no kind. Take the file",
    ),
    "no gimbal": (
        less(DJI, *(name for name in DJI if "Gimbal" in name)),
        {},
        "how the camera was turned.* found XMP of drone-dji",
    ),
    "half a gimbal": (
        less(DJI, "drone-dji:GimbalRollDegree"),
        {},
        "there is drone-dji:GimbalYawDegree, but no drone-dji:GimbalRollDegree; all three",
    ),
    "cut XMP": (packet(DJI)[:700], {}, "XMP: not XML, or cut off"),
    "entities": (BOMB, {}, "XMP: it has a document type or entities"),
    "twice": (TWICE, {}, "drone-dji:GimbalYawDegree: it is there twice, as '-97.40' and '5'"),
    "no number": (
        DJI | {"drone-dji:GimbalYawDegree": "north"},
        {},
        "drone-dji:GimbalYawDegree: 'north' is not a number; expected deg",
    ),
    "nan": (DJI | {"drone-dji:GimbalPitchDegree": "nan"}, {}, "drone-dji:GimbalPitchDegree: 'nan' is not a number"),
    "range": (DJI | {"drone-dji:GpsLatitude": "+96.1"}, {}, r"drone-dji:GpsLatitude: 96.1 is outside \[-90, 90\] deg"),
    "no GPS": (GPS_OFF, {"gps": {}}, "there is no position, neither of the maker's tags nor EXIF:GPSLatitude"),
    "no fix": (
        DJI | {"drone-dji:GpsLatitude": "0.0", "drone-dji:GpsLongtitude": "0.0"},
        {},
        r"its position is unknown: drone-dji:GpsLatitude 0.0, drone-dji:GpsLongtitude 0.0 \(a receiver without a fix",
    ),
    "no hemisphere": (
        GPS_OFF,
        {"gps": {key: PLACE[key] for key in (2, 3, 4)}},
        "EXIF:GPSLatitudeRef: ''; expected N or S",
    ),
    "no altitude": (PARROT, {"gps": {key: PLACE[key] for key in (1, 2, 3, 4)}}, "there is no EXIF:GPSAltitude"),
    "sigma": (DJI | {"drone-dji:RtkStdHgt": "-1"}, {}, "drone-dji:RtkStdHgt: -1 is outside"),
    "turned": (DJI, {"first": {ORIENTATION: 6}}, r"flagged to be turned for display \(Orientation 6\)"),
    "zoom": (DJI, {"exif": CAMERA | {0xA404: 2.5}}, "EXIF:DigitalZoomRatio: the image is magnified 2.5 times"),
    "cut image": (
        DJI,
        {"size": (40, 20)},
        r"the image has 40 x 20 pixels, its tags speak of 4000 x 3000: it was cut or turned",
    ),
    "no focal length": (
        PIX4D,
        {"exif": {}},
        r"nothing says what the focal length is in pixels.*Maker Model of 40 x 30 pixels is not in the table.* camera=",
    ),
    "fisheye": (PARROT | {"Camera:ModelType": "fisheye"}, {}, "Camera:ModelType: fisheye lenses are not read"),
    "another size, dewarped": (
        DJI | DEWARP | {"drone-dji:CalibratedOpticalCenterY": "1125"},
        {},
        r"principal point \(drone-dji:CalibratedOpticalCenter\) .* is far from the middle of 4000 x 3000",
    ),
    "another size": (
        DJI | {"drone-dji:CalibratedOpticalCenterX": "2736"},
        {},
        "principal point .* is far from the middle of 4000 x 3000",
    ),
    "long lens": (
        DJI | {"drone-dji:CalibratedFocalLength": "36.6"},
        {},
        "a focal length of 36.6 pixels .* does not fit an image 4000 pixels wide",
    ),
    "dewarp": (DJI | {"drone-dji:DewarpData": "1;3657,3650,0"}, {}, "drone-dji:DewarpData: 3 numbers; expected 9"),
    "dewarp text": (
        DJI | {"drone-dji:DewarpData": "1;3657,x"},
        {},
        "drone-dji:DewarpData: '1;3657,x' is not a list of numbers",
    ),
    "Skydio's lens": (
        SKYDIO | {"drone-skydio:DewarpData": "0.1"},
        {},
        "drone-skydio:DewarpData: 1 numbers; expected 3",
    ),
    "Autel's two ways": (
        PIX4D | {"Camera:Pitch": "-35.5"},
        {"make": "Autel Robotics"},
        r"Camera:Pitch: -35.5 is outside \[0, 180\] deg. Autel means",
    ),
}


MAVIC = {"model": "FC220", "exif": {0x920A: 4.73, 0xA002: 4000, 0xA003: 3000}}
BARE = less(DJI, *(name for name in DJI if "Calibrated" in name))
ZEROS = dict.fromkeys(("drone-dji:CalibratedOpticalCenterX", "drone-dji:CalibratedOpticalCenterY"), "0.000000")
# Strange tags that no line of sight depends on, and what is told of them, if anything.
UNUSED: dict[str, tuple[Any, dict[str, Any], str]] = {
    "a time": (
        DJI,
        {"exif": CAMERA | {0x9003: "yesterday"}},
        "Not used: EXIF:DateTimeOriginal: 'yesterday' is no date and time.",
    ),
    "a time zone": (
        DJI,
        {"exif": CAMERA | CLOCK | {0x9011: "CEST"}},
        "Not used: EXIF:OffsetTimeOriginal: 'CEST' is no",
    ),
    "no time": (DJI, {"exif": CAMERA | {0x9003: "0000:00:00 00:00:00"}}, "Not used: EXIF:DateTimeOriginal 0000:00:00"),
    "an attitude": (DJI | {"drone-dji:FlightPitchDegree": "up"}, {}, "The attitude of the aircraft is not said"),
    "a rangefinder": (DJI | {"drone-dji:LRFTargetDistance": "far", "drone-dji:LRFTargetLat": "999"}, {}, ""),
    "another maker's angle": (DJI | {"Camera:Yaw": "north"}, {}, ""),
    "a pixel density": (DJI, {"exif": CAMERA | {0xA20E: -1.0, 0xA210: 3}}, ""),
    "a 35 mm equivalent of 0": (DJI, {"exif": CAMERA | {0xA405: 0}}, "Not used: EXIF:FocalLengthIn35mmFilm 0"),
    "a calibration of 0": (
        DJI | ZEROS | {"drone-dji:CalibratedFocalLength": "0.000000"},
        {},
        "Not used: drone-dji:CalibratedFocalLength 0.000000 (the camera was not calibrated).",
    ),
    "an altitude of 0 beside another": (
        DJI | {"drone-dji:AbsoluteAltitude": "+0.00"},
        {},
        "Not used: drone-dji:AbsoluteAltitude +0.00 (a receiver without a height writes zero).",
    ),
    "a repeated tag": (
        packet(DJI).replace(
            "</rdf:RDF>",
            f'<rdf:Description xmlns:d="{SPACES["drone-dji"]}" d:SelfData="a"/><rdf:Description '
            f'xmlns:d="{SPACES["drone-dji"]}" d:SelfData="b"/></rdf:RDF>',
        ),
        {},
        "",
    ),
    "a control character": (packet(DJI | {"drone-dji:SelfData": "\x07\x00\x1f"}), {}, ""),
}


@pytest.mark.parametrize("case", UNUSED)
def test_only_what_is_used_can_refuse(image, case: str) -> None:
    tags, options, told = UNUSED[case]
    found = read(image(tags, **options))
    assert any(line.startswith(told) for line in found.assumed)
    np.testing.assert_allclose(np.rad2deg(found.shots.gimbal_readings), [[-97.4, -35.5, 2.5]], atol=1e-12)
    height = 1538.962 if "altitude of 0" not in case else PLACE_DEG[2]
    np.testing.assert_allclose(found.shots.pose.position.height, [height], atol=1e-9)
    focal: Any = found.sensor.camera.focal_px  # type: ignore[union-attr]
    by_film = case == "a calibration of 0"
    np.testing.assert_allclose(focal[0, 0], 24.0 * 50.0 / 43.26661 if by_film else 36.6667, rtol=1e-6)


@pytest.mark.parametrize("kind", ["byte", "undefined", "in the directory of EXIF"])
def test_xmp_of_a_tiff_of_every_type(tmp_path: pathlib.Path, kind: str) -> None:
    """As the maker of the file chose it: BYTE by the specification, UNDEFINED by MicaSense and the Phantom 4."""
    xmp, picture, path = packet(DJI).encode(), Image.new("L", SIZE), tmp_path / "a.tif"
    if kind.startswith("in"):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[700] = xmp
        exif[0x8769] = exif.get_ifd(0x8769)
        picture.save(path, exif=exif)
    else:
        directory = ImageFileDirectory_v2()
        directory.tagtype[700] = {"byte": 1, "undefined": 7}[kind]
        directory[700] = xmp
        picture.save(path, tiffinfo=directory)
        with Image.open(path) as written:
            assert written.tag_v2.tagtype[700] == directory.tagtype[700]  # type: ignore[attr-defined]
    assert read_tags(path).values["drone-dji:GimbalPitchDegree"] == "-35.50"


def test_the_table_of_cameras_beats_the_film_and_is_beaten_by_a_calibration(image) -> None:
    def focal(tags: dict[str, Any], **options: Any) -> tuple[float, str]:
        found = read(image(tags, make="DJI", **options), camera=options.pop("camera", None))
        assert found.sensor is not None
        return float(found.sensor.camera.focal_px[0, 0]), found.facts["focal length"]  # type: ignore[attr-defined]

    by_film = MAVIC | {"exif": {**MAVIC["exif"], 0xA405: 26}}  # type: ignore[dict-item]
    assert focal(BARE, **by_film) == (pytest.approx(47.3 / 1.58), "29.9367 pixels (table of cameras: Mavic Pro)")
    assert focal(DJI, **by_film)[0] == pytest.approx(36.6667)
    assert focal(DJI | DEWARP, **by_film)[0] == pytest.approx(36.5702)
    other = by_film | {"exif": {**MAVIC["exif"], 0x920A: 9.0, 0xA405: 26}}  # type: ignore[dict-item]
    assert "EXIF:FocalLengthIn35mmFilm" in focal(BARE, **other)[1]  # another lens than the table's


ZOOMS = {  # model, size, EXIF's focal length, digital zoom, focal length in pixels without it
    "of a table camera": ("FC6310", (5472, 3648), 8.8, 2.5, 8.8 / 2.41e-3),
    "of a cropped mode": ("FC6310", (5472, 3078), 8.8, 1.5, 8.8 / 2.41e-3),
    "at the end of an optical zoom": ("ZH20", (5184, 3888), 119.94, 4.0, 119.94 / 1.45e-3),
}


@pytest.mark.costly
@pytest.mark.parametrize("case", ZOOMS)
@pytest.mark.parametrize("named", [False, True], ids=["by tags", "by name"])
@pytest.mark.parametrize("scale", [1, 6], ids=["whole", "smaller copy"])
def test_a_digital_zoom_makes_the_focal_length_longer(tmp_path, case: str, named: bool, scale: int) -> None:
    """And less sure: against a crop of the middle that Pillow would make so many times larger."""
    model, (width, height), focal_mm, zoom, focal_px = ZOOMS[case]
    tags = {name: value for name, value in DJI.items() if "Calibrated" not in name}
    exif = {0x920A: focal_mm, 0xA002: width, 0xA003: height}
    size = width // scale, height // scale
    files = [
        write_image(tmp_path / f"{k}.jpg", packet(tags), make="DJI", model=model, exif=exif | more, size=size)
        for k, more in enumerate(({}, {0xA404: zoom}))
    ]
    how = {"camera": model} if named else {}
    found_of: list[Any] = [read(path, height_datum="ellipsoid", **how) for path in files]
    plain, zoomed = found_of
    for found, times in ((plain, 1.0), (zoomed, zoom)):
        np.testing.assert_allclose(found.sensor.camera.focal_px, focal_px * times * size[0] / width, rtol=1e-9)
        np.testing.assert_allclose(found.sensor.camera.principal_px, [[(n - 1) / 2 for n in size]], atol=1e-9)
    shares = [np.asarray(one.sources[-1].sigma)[0] / one.sensor.camera.focal_px[0, 0] for one in (plain, zoomed)]
    assert shares[1][0] == pytest.approx(np.hypot(shares[0][0], 0.02 * (zoom - 1.0)))
    assert shares[1][1] == pytest.approx(shares[0][1])  # as an angle: so many more pixels, of which each is smaller
    (told,) = [one for one in zoomed.assumed if "DigitalZoomRatio" in one]
    assert f"the focal length is {zoom:g} times that of the table" in told
    assert not any("DigitalZoomRatio" in one for one in plain.assumed)


def test_a_digital_zoom_that_cannot_be_told_is_refused_with_a_way_out(tmp_path) -> None:
    tags = {name: value for name, value in DJI.items() if "Calibrated" not in name}
    for k, (model, size, focal_mm) in enumerate(
        (("FC6310", (2189, 1459), 8.8), ("FC9998", (5472, 3648), 8.8), ("ZH20", (5184, 3888), 20.0))
    ):
        exif = {0x920A: focal_mm, 0xA404: 2.5, 0xA002: size[0], 0xA003: size[1]}
        path = write_image(tmp_path / f"{k}.jpg", packet(tags), make="DJI", model=model, exif=exif, size=size)
        with pytest.raises(TableError, match=r"magnified 2\.5 times.* its focal length 2\.5 times as long: camera="):
            read(path, height_datum="ellipsoid")
        found = read(path, height_datum="ellipsoid", camera="focal=22mm,pitch=2.41um")
        assert any("is taken as that of the magnified image" in one for one in found.assumed)


def test_a_camera_by_text_name_and_file(image, tmp_path: pathlib.Path) -> None:
    path, small = image(BARE, make="", model="", exif=CAMERA), image(BARE, name="b.jpg", exif={})
    file = tmp_path / "camera.toml"
    file.write_text("[camera]\nwidth = 4000\nheight = 3000\nfocal_px = 3000.0\nprincipal_px = [2009.5, 1499.5]\n")
    for given, focal in [
        ("focal=4.73mm,pitch=1.58um", 47.3 / 1.58),
        ("focal=8.8mm,sensor=13.2mm", 40 * 8.8 / 13.2),
        ("focal=30px", 30.0),
        (str(file), 30.0),
        (file, 30.0),
    ]:
        found = read(path, camera=given)
        camera: Any = found.sensor.camera  # type: ignore[union-attr]
        np.testing.assert_allclose(camera.focal_px, [[focal, focal]], rtol=1e-12)
        assert [one.label for one in found.sources] == ["position"]
        assert any(line.startswith("The camera is taken as given") for line in found.assumed)
    np.testing.assert_allclose(camera.principal_px, [[19.6, 14.5]])  # by edges, (2009.5 + 0.5) / 100 - 0.5
    named = read(image(BARE, name="c.jpg", exif=less_exif(CAMERA, 0x920A)), camera="Mavic Pro")
    assert named.facts["focal length"].endswith("(table of cameras: Mavic Pro)")
    assert [one.label for one in named.sources] == ["position", "interior orientation"]
    alone: Any = read(small, camera="focal=4.73mm,pitch=1.58um").sensor
    np.testing.assert_allclose(alone.camera.focal_px[0, 0], 4730 / 1.58)


def less_exif(tags: dict[int, Any], *keys: int) -> dict[int, Any]:
    return {key: value for key, value in tags.items() if key not in keys}


def test_angles_given_by_the_caller(image) -> None:
    """In place of those of the file, against the horizon whatever its maker's sense; yaw perhaps that of each."""
    zeros = turned(0.0, 0.0, 0.0)
    there = [image(zeros, "a.jpg"), image(zeros | {"drone-dji:FlightYawDegree": "10.00"}, "b.jpg")]
    found = read(there, gimbal_deg=("aircraft", -90.0, 0.0))
    np.testing.assert_allclose(np.rad2deg(found.shots.gimbal_readings), [[92.8, -90.0, 0.0], [10.0, -90.0, 0.0]])
    assert (
        "The camera's angles are as given: yaw the heading of the aircraft, pitch -90 deg, roll 0 deg." in found.assumed
    )
    for tags, options in ((PIX4D, {}), (PARROT, {"make": "Parrot"}), ("", {})):
        given = read(image(tags, "c.jpg", **options), gimbal_deg=(30.0, -60.0, 0.0))
        np.testing.assert_allclose(np.rad2deg(given.shots.gimbal_readings), [[30.0, -60.0, 0.0]])
        R = orientation(image(tags, "c.jpg", **options), gimbal_deg=(30.0, -60.0, 0.0))
        np.testing.assert_allclose(R[2, 2], np.sin(np.deg2rad(60.0)), atol=1e-12)  # down
    assert given.form == "image with a position in EXIF"
    with pytest.raises(TableError, match=r"yaw is asked for as the heading.*gimbal_deg=\(0, -90, 0\)"):
        read(image("", "c.jpg"), gimbal_deg=("aircraft", -90.0, 0.0))
    for wrong, words in [
        ((1.0, 2.0), r"gimbal_deg=\(1, 2\): expected three angles"),
        ((0.0, -200.0, 0.0), r"pitch -200 is outside \[-180, 180\]"),
        ((0.0, "aircraft", 0.0), "pitch is 'aircraft'"),
        ((float("nan"), 0.0, 0.0), "yaw nan is outside"),
    ]:
        with pytest.raises(TableError, match=words):
            read(there, gimbal_deg=wrong)


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_name_file_tag_and_reason(image, case: str) -> None:
    tags, options, words = REFUSED[case]
    with pytest.raises((TableError, ImageError), match=rf"a\.jpg.*{words}") as why:
        read(image(tags, **options))
    assert "\n" not in str(why.value)


def test_files_that_are_no_images(image, tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere.jpg: there is no such image"):
        read(tmp_path / "nowhere.jpg")
    with pytest.raises(ImageError, match="there are no images in this folder"):
        read(tmp_path)
    with pytest.raises(TableError, match="no image is named"):
        read([])
    (tmp_path / "a.jpg").write_text("no image")
    with pytest.raises(ImageError, match=r"a.jpg: not an image, or the file is damaged"):
        read(tmp_path / "a.jpg")
    raw = image(name="b.tif", first={50706: b"\x01\x04\x00\x00"})
    with pytest.raises(ImageError, match=r"b.tif: DNG files are not read.* Take the JPEG"):
        read(raw)
    with pytest.raises(TableError, match=r"b.jpg: it is of another camera or size \(DJI.*, M4E, .*\) than .*a.jpg"):
        read([image(name="a.jpg"), image(name="b.jpg", model="M4E")])


@pytest.mark.parametrize("name", ["a.jpg", "a.tif"])
def test_a_file_that_is_cut_anywhere_is_refused(image, name: str) -> None:
    path = image(DJI, name)
    whole, data = read_tags(path).values, path.read_bytes()
    for length in [*range(0, len(data) - 2, 41), len(data) - 3]:
        path.write_bytes(data[:length])
        with pytest.raises((ImageError, TableError)):
            read_tags(path)
    path.write_bytes(data + b"what a maker puts behind")
    assert read_tags(path).values == whole


@pytest.mark.parametrize("name", ["a.jpg", "a.tif"])
def test_a_damaged_file_is_read_or_refused(image, name: str) -> None:
    """Never another exception than our own."""
    path = image(DJI, name)
    data, rng = path.read_bytes(), np.random.default_rng(5)
    refused = 0
    for where in rng.integers(0, len(data), 150):
        path.write_bytes(data[:where] + bytes([int(rng.integers(256))]) + data[where + 1 :])
        try:
            read_tags(path)
        except (ImageError, TableError):
            refused += 1
    assert 0 < refused < 150


@pytest.mark.slow
def test_real_images_look_where_their_reconstruction_has_them(jaxgeo_test_data: pathlib.Path) -> None:
    """A Phantom's four oblique frames against OpenSfM: positions by RTK, gimbal angles to a degree and a half."""
    village = Village.of(jaxgeo_test_data)
    found = read([village.folder / "images" / f"{frame}.tif" for frame in FRAMES], height_datum=UNDULATION)
    met = eqx.filter_jit(lambda ray, terrain: intersect(ray, terrain).position)
    for k, frame in enumerate(FRAMES):
        looks: list[Any] = [found.exposure(k)[:2], (village.sensor, village.shots[frame])]
        R = [np.asarray(R_ned_from_camera(*look)) for look in looks]
        assert np.rad2deg(Rotation.from_matrix(R[0].T @ R[1]).magnitude()) < 1.5
        centres = [WGS84.to_ecef(shot.pose.position) for _, shot in looks]
        assert float(np.linalg.norm(centres[0] - centres[1])) < 0.06  # m
        level = np.asarray(R_ecef_from_ned(village.shots[frame].pose.position))
        rays = [Ray(centre, jnp.asarray(level @ turn[:, 2])) for centre, turn in zip(centres, R, strict=True)]
        ground = [WGS84.to_ecef(met(ray, village.terrain)) for ray in rays]
        assert 0.1 < float(np.linalg.norm(ground[0] - ground[1])) < 3.0  # m, from 100 m away
    sensor = found.exposure(0)[0]
    assert sensor is not None
    points = np.array([[x, y, 1.0] for x in (-0.6, 0.0, 0.6) for y in (-0.4, 0.0, 0.4)])
    ours, theirs = (np.asarray(projected(camera, points)) for camera in (sensor.camera, village.sensor.camera))
    assert np.abs(ours - theirs).max() < 6.0  # of 1368 pixels: calibrated half a year before the flight

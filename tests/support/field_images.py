"""Correct results for the images of the folder `field`."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.io import TableError
from jaxgeo.io.acquisitions import UnstatedDatum, read_drone_images
from jaxgeo.io.errors import ImageError
from tests.support.field import FieldFile

FILM = 24.0 / np.hypot(36.0, 24.0)  # focal length over the image diagonal, for a 24 mm equivalent
HERE = (36.3, -84.2, 900.0)


def read(path: pathlib.Path, **options: Any) -> Any:
    given: dict[str, Any] = {"height_datum": "ellipsoid"} | options
    return read_drone_images(path, **given)


def turn(found: Any) -> np.ndarray:
    """R_ned_from_head of the first exposure, by SciPy."""
    return Rotation.from_euler("ZYX", np.asarray(found.shots.gimbal_readings)[0]).as_matrix()


def sigma_of(found: Any, label: str) -> np.ndarray:
    (source,) = [one for one in found.sources if one.label == label]
    return np.asarray(source.sigma)[0]


def is_read(
    *,
    place: tuple[float, float, float] = HERE,
    turned: tuple[float, float, float] = (30.0, -60.0, 0.0),
    focal: float = FILM * 500.0,
    by: str = "EXIF:FocalLengthIn35mmFilm",
    share: float = 0.0632,
    **options: Any,
) -> Callable[[pathlib.Path], None]:
    """Checks position in deg and m, orientation in deg, focal length in pixels and its relative error."""

    def check(path: pathlib.Path) -> None:
        found = read(path, **options)
        position = found.shots.pose.position
        degrees = np.rad2deg([position.lat[0], position.lon[0]])
        np.testing.assert_allclose([*degrees, position.height[0]], place, atol=1e-6)
        np.testing.assert_allclose(turn(found), Rotation.from_euler("ZYX", turned, degrees=True).as_matrix(), atol=1e-9)
        np.testing.assert_allclose(found.sensor.camera.focal_px[0, 0], focal, rtol=1e-4)
        assert by in found.facts["focal length"], found.facts
        if share:
            np.testing.assert_allclose(sigma_of(found, "interior orientation")[0], share * focal, rtol=0.02)

    return check


def is_refused(*words: str, kind: type[Exception] = TableError, **ways_out: Any) -> Callable[[pathlib.Path], None]:
    """Checks that a file is refused with these words, in a line that names it, and read with `ways_out`, if given."""

    def check(path: pathlib.Path) -> None:
        with pytest.raises(kind) as why:
            read(path)
        line = str(why.value)
        assert path.name in line
        assert "\n" not in line
        for one in words:
            assert re.search(one, line), (one, line)
        if ways_out:
            assert len(read(path, **ways_out)) == 1

    return check


def both(*checks: Callable[[pathlib.Path], None]) -> Callable[[pathlib.Path], None]:
    def check(path: pathlib.Path) -> None:
        for one in checks:
            one(path)

    return check


def repeats_are_refused_only_if_used(path: pathlib.Path) -> None:
    is_read()(path)
    assert read(path).tags[0]["xmpMM:History/instanceID"] == "xmp.iid:1"


def corners_hold_the_truth(path: pathlib.Path) -> None:
    """Focal length 2994 px by published calibrations; the 35 mm equivalent would give 2758."""
    found = read(path)
    focal = float(found.sensor.camera.focal_px[0, 0])
    sigma = sigma_of(found, "interior orientation")[0]
    for truth in (2994.0, 4.73 / 1.5625e-3):
        assert abs(focal - truth) < 1.645 * sigma
    assert sigma > 0.015 * focal


def is_dewarped(path: pathlib.Path) -> None:
    found = read(path)
    camera = found.sensor.camera
    np.testing.assert_allclose(camera.focal_px[0], [2813.6, 2824.1])
    np.testing.assert_allclose(camera.principal_px[0], [2015.5 - 12.5, 1511.5 + 7.25])
    names = camera.distortion.names
    bent = {name: float(getattr(camera.distortion, name)[0]) for name in names}
    flagged = found.tags[0]["drone-dji:DewarpFlag"] == "1"  # distortion already removed
    theirs = {} if flagged else {"k1": 0.11, "k2": -0.26, "p1": -0.0046, "p2": 0.0026, "k3": 0.23}
    assert {name: value for name, value in bent.items() if value} == theirs
    assert sigma_of(found, "interior orientation")[0] < 0.005 * 2813.6
    np.testing.assert_allclose(sigma_of(found, "position"), [0.0108, 0.0110, 0.0221])


def neighbours_keep_their_errors(path: pathlib.Path) -> None:
    """Each image keeps its own standard deviations, also when read together with the other in a folder."""
    alone, beside = read(path), read(path.with_name("rtk35.jpg"))
    np.testing.assert_allclose(sigma_of(alone, "position"), [0.011, 0.011, 0.022])
    np.testing.assert_allclose(sigma_of(beside, "position"), [0.0108, 0.0110, 0.0221])


def needs_a_datum(path: pathlib.Path) -> None:
    with pytest.raises(UnstatedDatum, match=r"GPSAltitude 30\.04, RelativeAltitude \+300\.00"):
        read(path, height_datum=None)


BACK, SAME = (-150.0, -80.0, 180.0), (-150.0, -80.0, 0.0)
LENS, GIMBAL = "focal=4.5mm,pitch=1.6um", (121.3, -90.0, 0.0)
ZEROS = r"GimbalYawDegree \+0.00.*a gimbal that reports no angles writes zeros"
DIAGONAL, THERMAL = 5040.0, float(np.hypot(640.0, 512.0))
NADIR = (30.0, -90.0, 0.0)
CHECKS: dict[str, tuple[str, Callable[[pathlib.Path], None]]] = {
    "p4m_ifd0.tif": ("XMP of type UNDEFINED", is_read(turned=NADIR, focal=40.0 / 24.0 * FILM * 80.0)),
    "p4m_sub.tif": ("XMP in the directory of EXIF", is_read(turned=NADIR, focal=40.0 / 24.0 * FILM * 80.0)),
    "lightroom.jpg": ("list items repeated in a history", repeats_are_refused_only_if_used),
    "badxml.jpg": ("a control character in a tag that is not used", is_read()),
    "elements.jpg": ("XMP as elements", is_read()),
    "zoom4.jpg": ("digital zoom", is_refused("magnified 4 times", 'camera="focal=', camera=LENS)),
    "zoom_dji.jpg": ("digital zoom", is_refused("magnified 2 times", 'camera="focal=', camera=LENS)),
    "x2d_thermal.jpg": (
        "thermal camera without a focal length: by the table",
        is_read(turned=(30.0, -50.0, 0.0), focal=9.1 / 12e-3, by="table of cameras: Skydio X2 infrared", share=0.0),
    ),
    "nof35_db.jpg": (
        "no 35 mm equivalent: by the table",
        is_read(focal=4.73 / 1.58e-3, by="table of cameras: Mavic Pro", share=0.025),
    ),
    "crop169.jpg": ("35 mm equivalent of a cropped mode: the table wins", corners_hold_the_truth),
    "rtk35.jpg": ("35 mm equivalent only", is_read(turned=NADIR, focal=FILM * DIAGONAL)),
    "rtk_mix1.jpg": ("RTK's standard deviations of each image", both(is_read(), neighbours_keep_their_errors)),
    "dewarp.jpg": ("DewarpData", is_dewarped),
    "dewarp1.jpg": ("DewarpData of an image freed of distortion", is_dewarped),
    "calib_mm.jpg": (
        "CalibratedFocalLength in mm",
        is_read(turned=NADIR, focal=6.72 / 6.7 * FILM * DIAGONAL, by="CalibratedFocalLength in mm"),
    ),
    "calib_only.jpg": (
        "CalibratedFocalLength in pixels",
        is_read(turned=NADIR, focal=2795.0, by="CalibratedFocalLength)", share=0.0224),
    ),
    "allzero.jpg": (
        "angles all zero",
        is_refused(ZEROS, r'gimbal_deg=\("aircraft", -90', gimbal_deg=(0.0, -90.0, 0.0)),
    ),
    "mini2z.jpg": (
        "angles all zero",
        both(
            is_refused(ZEROS, r'121.3 deg: gimbal_deg=\("aircraft", -90, 0\)', gimbal_deg=("aircraft", -90, 0)),
            is_read(turned=GIMBAL, focal=4.49 / 1.59e-3 / 10.0, by="Mini 2", share=0.0, gimbal_deg=GIMBAL),
        ),
    ),
    "mini2.jpg": ("no angles", is_refused("nothing says how the camera was turned", "gimbal_deg=", gimbal_deg=GIMBAL)),
    "void.jpg": ("GPSStatus V", is_refused("GPSStatus V", "the receiver had no fix", "it gives no fix")),
    "invalid_gps.jpg": ("GpsStatus Invalid", is_refused("GpsStatus Invalid", "it gives no fix")),
    "zerozero.jpg": ("position 0/0", is_refused("GPSLatitude 0/0 0/0 0/0", "it gives no fix")),
    "alt0.jpg": (
        "altitude 0",
        is_refused("GPSAltitude 0.0", r"\+101.30 m.*as takeoff_height=", takeoff_height=300.0, height_datum=None),
    ),
    "alt00.jpg": (
        "altitude 0/0",
        is_refused("GPSAltitude 0/0", r"\+300.00 m.*as takeoff_height=", takeoff_height=300.0, height_datum=None),
    ),
    "focal00.jpg": ("focal length 0/0: by the 35 mm equivalent", is_read(focal=20.0 / 24.0 * FILM * 500.0)),
    "roll0.jpg": ("straight down", is_read(turned=NADIR, focal=FILM * THERMAL)),
    "roll180.jpg": ("straight down, written as upside down", is_read(turned=NADIR, focal=FILM * THERMAL)),
    "m3e_back.jpg": ("past straight down", is_read(turned=BACK, focal=FILM * THERMAL)),
    "m3e_same.jpg": ("the same without roll", is_read(turned=SAME, focal=FILM * THERMAL)),
    "below.jpg": ("below sea level", is_read(place=(31.5, 35.47, -30.037239))),
    "below_noabs.jpg": ("below sea level by EXIF", both(is_read(place=(31.5, 35.47, -30.04)), needs_a_datum)),
    "south.jpg": ("southern latitude by EXIF", is_read(place=(-33.9, -70.6, 900.0))),
    "comma.jpg": ("a decimal comma", is_refused("'-60,00' is not a number .a decimal comma; tags have a point")),
    "noorient.jpg": (
        "flagged to be turned for display",
        is_refused("Orientation 6", "exiftool -n -Orientation=1", kind=ImageError),
    ),
}
ROWS = tuple(FieldFile(f"img/{name}", situation, check) for name, (situation, check) in CHECKS.items())

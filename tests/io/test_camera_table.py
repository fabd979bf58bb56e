"""The table of cameras: whole, consistent in itself and with the rule of 35 mm film, found by tags; lenses as typed."""

from __future__ import annotations

import math
import pathlib

import numpy as np
import pytest
from pydantic import ValidationError

from jaxgeo import FrameCamera
from jaxgeo.io import TableError
from jaxgeo.io.camera_table import CameraModel, camera_models, known_camera, named_camera
from jaxgeo.io.given_camera import FILM, FILM_CUT, WIDE, given_camera, resized, whole_camera
from jaxgeo.io.scene import SceneError

MODELS = camera_models()
FIXED = [one for one in MODELS if one.focal_mm is not None]
# Data sheets' angles of view: across, or along the diagonal where the last is True. Not those by which a pixel size of
# the table was found.
VIEWS = [
    ("MicaSense", "RedEdge-M", 1280, 960, 5.5, 47.2, False),
    ("MicaSense", "RedEdge-P", 1456, 1088, 5.5, 49.6, False),
    ("MicaSense", "RedEdge-P", 2464, 2056, 10.3, 44.5, False),
    ("MicaSense", "Altum", 2064, 1544, 8.0, 48.0, False),
    ("MicaSense", "Altum", 160, 120, 1.77, 57.0, False),
    ("MicaSense", "Altum-PT", 4112, 3008, 16.3, 46.0, False),
    ("Skydio", "X2 Narrow", 320, 256, 9.1, 24.0, False),
    ("Autel Robotics", "XT709", 640, 512, 13.0, 33.0, False),
    ("DJI", "ZH20T", 640, 512, 13.5, 40.6, True),
    ("DJI", "H30T", 1280, 1024, 24.0, 45.2, True),
    ("DJI", "M3T", 8000, 6000, 4.4, 84.0, True),
    ("DJI", "M3M", 2592, 1944, 4.34, 73.91, True),
    ("DJI", "FC3411", 5472, 3648, 8.38, 88.0, True),
]


def focal_px(one: CameraModel) -> float:
    assert one.focal_mm is not None
    return 1e3 * one.focal_mm / one.pitch_um


def film_error(one: CameraModel, width: int, height: int) -> float:
    """By how much of it the rule of 35 mm film gets the focal length of a model wrong."""
    assert one.film_mm is not None
    return one.film_mm * math.hypot(width, height) / math.hypot(36.0, 24.0) / focal_px(one) - 1.0


def test_it_has_the_models_in_use() -> None:
    tags = {(make.lower(), model.lower()) for one in MODELS for make in one.makes[:1] for model in one.models}
    assert len(tags) >= 60
    assert len({one.name for one in MODELS}) == len(MODELS)
    assert sum(one.thermal for one in MODELS) >= 10
    assert {make for make, _ in tags} >= {"dji", "autel robotics", "parrot", "skydio", "micasense", "sony", "sensefly"}


@pytest.mark.parametrize("one", MODELS, ids=lambda one: one.name)
def test_an_entry_is_consistent(one: CameraModel) -> None:
    width, height = one.sizes[0]
    sensor = one.pitch_um * 1e-3 * width, one.pitch_um * 1e-3 * height
    assert 1.5 < sensor[0] < 54.0  # mm, from the smallest thermal detector to the medium format
    assert 1.19 <= width / height <= 1.52
    assert all(w <= width and h <= height for w, h in one.sizes)  # cut from the first
    for w, h, pitch in one.binned_sizes:
        assert abs(pitch * w / (one.pitch_um * width) - 1.0) < 0.01  # of the whole detector
        assert abs(w * height / (h * width) - 1.0) < 0.01
    if one.thermal:
        assert one.pitch_um in (12.0, 17.0)
    shortest = one.focal_mm if one.focal_mm is not None else one.zoom_mm[0]  # type: ignore[index]
    longest = one.focal_mm if one.focal_mm is not None else one.zoom_mm[1]  # type: ignore[index]
    assert 0.1 < shortest / sensor[0] <= longest / sensor[0] < 25.0
    assert one.source.startswith(("Compared: ", "Not looked up: "))
    assert one.source.count("specifications") == 1  # says whose
    if one.film_mm is not None:
        assert one.focal_mm is not None
        assert -0.15 < film_error(one, width, height) < 0.03


def test_the_rule_of_film_errs_by_what_it_says() -> None:
    """Of whole images, and of those cut to the shape of videos."""
    whole = np.array([film_error(one, *one.sizes[0]) for one in FIXED if one.film_mm])
    cut = [(one, size) for one in FIXED if one.film_mm for size in one.sizes[1:]]
    wide = np.array([film_error(one, *size) for one, size in cut if size[0] > WIDE * size[1]])
    assert len(whole) >= 40
    assert len(wide) >= 12
    assert 0.02 < np.sqrt(np.mean(whole**2)) < FILM
    assert 0.07 < np.sqrt(np.mean(wide**2)) < FILM_CUT
    assert np.mean(np.abs(whole) < 1.645 * FILM) >= 0.9
    assert np.mean(np.abs(wide) < 1.645 * FILM_CUT) >= 0.9


@pytest.mark.parametrize("make, model, width, height, focal, view, diagonal", VIEWS)
def test_angles_of_view_are_those_of_data_sheets(
    make: str, model: str, width: int, height: int, focal: float, view: float, diagonal: bool
) -> None:
    known = known_camera(make, model, width, height, focal)
    assert known is not None
    side = math.hypot(width, height) if diagonal else width
    ours = 2.0 * math.degrees(math.atan(0.5 * side * known.pitch_mm / known.focal_mm))
    assert abs(math.tan(math.radians(ours) / 2) / math.tan(math.radians(view) / 2) - 1.0) < 0.035


def test_cameras_of_one_name_are_told_by_focal_length_and_size() -> None:
    found = {
        focal: known_camera("DJI", "ZH20T", width, height, focal)
        for width, height, focal in [(4056, 3040, 4.5), (5184, 3888, 25.0), (640, 512, 13.5)]
    }
    told = [(one.model.name, one.focal_mm) for one in found.values() if one is not None]
    assert told == [("Zenmuse H20 wide", 4.5), ("Zenmuse H20 zoom", 25.0), ("Zenmuse H20T infrared", 13.5)]
    assert known_camera("DJI", "M3T", 4000, 3000) is None  # wide or tele: without a focal length nobody knows
    assert known_camera("DJI", "M3T", 4000, 3000, 4.4) is not None
    assert known_camera("DJI", "FC6310", 5472, 3648, 12.0) is None  # another lens
    assert known_camera("Sony", "FC6310", 5472, 3648, 8.8) is None
    assert known_camera("dji", "fc6310", 1368, 912) is not None  # a copy made smaller
    assert known_camera("DJI", "FC6310", 1920, 1080) is None  # or a cut one, of unknown size
    assert known_camera("DJI", "FC9999", 4000, 3000) is None


def test_cameras_are_found_by_the_names_that_people_type() -> None:
    for name in ("FC6310", "dji fc6310", "Phantom 4 Pro", "DJI FC6310R"):
        found = named_camera(name, 5472, 3648)
        assert found is not None
        assert found.model.name == "Phantom 4 Pro"
    assert named_camera("Phantom 4 Pro", 640, 512) is None
    assert named_camera("Phantom", 5472, 3648) is None


@pytest.mark.parametrize(
    "change, words",
    [
        ({"focal_mm": None}, "either focal_mm or zoom_mm"),
        ({"zoom_mm": (4.0, 8.0)}, "either focal_mm or zoom_mm"),
        ({"pitch_um": 0.0}, "greater than 0"),
        ({"sizes": ()}, "at least 1"),
        ({"source": ""}, "at least 10"),
        ({"colour": True}, "Extra inputs"),
    ],
)
def test_an_entry_that_is_wrong_is_refused(change: dict, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        CameraModel.model_validate(MODELS[0].model_dump() | change)


def test_lenses_as_people_type_them() -> None:
    """Against the similar triangles of a pinhole."""
    for text, full, expected in [
        ("focal=8.8mm,pitch=2.41um", 5472, 8.8 / 2.41e-3 / 4),
        ("focal=8.8mm, pitch=2.41 µm", 5472, 8.8 / 2.41e-3 / 4),
        ("Focal=8.8mm,sensor=13.2mm", 5472, 8.8 / 13.2 * 1368),
        ("focal=3666px", 5472, 3666.0),
        ("focal=8.8mm,pitch=2.41um,size=1368x912", 1368, 8.8 / 2.41e-3),
    ]:
        lens = given_camera(text)
        assert not isinstance(lens, FrameCamera | str)
        assert lens.focal_at(1368, full) == pytest.approx(expected, rel=1e-12)
    assert given_camera("FC6310") == "FC6310"
    camera = whole_camera("focal=3666px,size=5472x3648")
    np.testing.assert_array_equal(camera.focal_px, [3666.0, 3666.0])
    np.testing.assert_array_equal(camera.principal_px, [2735.5, 1823.5])


@pytest.mark.parametrize(
    "text, words",
    [
        ("focal=8.8mm", "needs either the pixel size, pitch=, or the sensor width"),
        ("focal=8.8mm,pitch=2um,sensor=13mm", "needs either"),
        ("pitch=2.41um", "the focal length is missing"),
        ("focal=8.8", "focal=8.8 is not a number above zero in mm or px"),
        ("focal=0mm,pitch=2um", "focal=0mm is not a number above zero"),
        ("focal=-8mm,pitch=2um", "focal=-8mm is not"),
        ("focal=8.8mm,pitch=2.41mm", "pitch=2.41mm is not a number above zero in um"),
        ("focal=120mm,pitch=0.144mm", r"in um \(pitch=144um\?\)"),
        ("focal=120mm,pitch=2410nm", r"\(pitch=2\.41um\?\)"),
        ("focal=120mm,pitch=2.41", r"\(pitch=2\.41um\?\)"),
        ("focal=120mm,pitch=0.144", "is not a number above zero in um. Give"),
        ("focal=12cm,pitch=5um", r"in mm or px \(focal=120mm\?\)"),
        ("focal=0.12m,pitch=5um", r"\(focal=120mm\?\)"),
        ("focal=8.8mm,sensor=1.32cm", r"\(sensor=13\.2mm\?\)"),
        ("focal=8.8mm,sensor=13200um", r"\(sensor=13\.2mm\?\)"),
        ("film=0.024m", r"\(film=24mm\?\)"),
        ("focal=120mm,pitch=0.144um", "pitch=0.144um is no such length of a camera; expected from 0.5 to 1000 um"),
        ("focal=120mm,pitch=1001um", "pitch=1001um is no such length of a camera; expected from 0.5 to 1000 um"),
        ("focal=120000mm,pitch=5um", "focal=120000mm is no such length of a camera; expected at most 10000 mm"),
        ("focal=3666px,pitch=2um", "in px needs neither"),
        ("focal=8mm,focal=9mm", "each once"),
        ("focal=8.8mm,zoom=2", "'zoom=2' is none of"),
        ("focal=30px,size=40", "size=40 is not the pixels of an image"),
        ("focal=1e9999px", "is not a number"),
    ],
)
def test_lenses_that_are_none(text: str, words: str) -> None:
    with pytest.raises(TableError, match=words) as why:
        given_camera(text)
    assert 'camera="focal=8.8mm,pitch=2.41um"' in str(why.value)
    assert "\n" not in str(why.value)


@pytest.mark.parametrize("pitch", [0.4999, 0.5, 240.0, 1000.0, 1000.1])
def test_text_scene_files_and_python_have_one_range_of_pixel_sizes(tmp_path: pathlib.Path, pitch: float) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(f"[camera]\nwidth = 40\nheight = 30\nfocal_length_mm = 8.8\npixel_pitch_um = {pitch}\n")
    ways = (
        lambda: whole_camera(f"focal=8.8mm,pitch={pitch}um,size=40x30"),
        lambda: whole_camera(path),
        lambda: FrameCamera.from_metric(focal_length=8.8e-3, pixel_pitch=pitch * 1e-6, width=40, height=30),
    )
    for way in ways:
        if 0.5 <= pitch <= 1000.0:
            np.testing.assert_allclose(way().focal_px, 8.8e3 / pitch, rtol=1e-12)
        else:
            with pytest.raises((TableError, SceneError, ValueError), match="pitch"):
                way()


def test_a_size_is_needed_where_files_have_none() -> None:
    with pytest.raises(TableError, match=r'the size of the images is missing; say it.*size=5472x3648"'):
        whole_camera("focal=3666px")


def test_camera_files(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text("[camera]\nwidth = 40\nheight = 30\nfocal_length_mm = 8.8\npixel_pitch_um = 2.4\n")
    camera = given_camera(path)
    assert isinstance(camera, FrameCamera)
    np.testing.assert_allclose(camera.focal_px, [8.8 / 2.4e-3] * 2)
    path.write_text("[camera]\nwidth = 40\nheight = 30\nfocal_mm = 8.8\n")
    with pytest.raises(SceneError, match=r"camera.toml: \[camera\] focal"):
        given_camera(path)
    path.write_text("[lens]\n")
    with pytest.raises(SceneError, match=r"\[camera\] is missing"):
        given_camera(path)
    with pytest.raises(FileNotFoundError):
        given_camera(tmp_path / "nowhere.toml")


def test_a_camera_for_copies_of_another_size() -> None:
    camera = FrameCamera.from_pixels(focal_px=[100.0, 101.0], width=40, height=30, principal_px=[20.0, 14.0])
    half = resized(camera, 20, 15)
    assert half is not None
    np.testing.assert_allclose(half.focal_px, [50.0, 50.5])
    np.testing.assert_allclose(half.principal_px, [9.75, 6.75])  # edges stay: (20.5 / 2) - 0.5
    assert resized(camera, 20, 20) is None

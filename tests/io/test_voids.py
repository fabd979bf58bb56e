"""Voids without a tag: found among the values as they are stored, in any scale and unit; and what is no void."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import numpy as np
import pytest
from rasterio.transform import Affine
from support.rasters import DEGREE, hills, write

from jaxgeo.io import DemError, open_dem, read_dem, read_dem_and_report
from jaxgeo.io.height_units import UNITS, metres_in
from jaxgeo.io.tiles import read_header
from jaxgeo.io.voids import check_untagged

SHAPE = (24, 30)
GROUND = hills(SHAPE)
BLOCK = np.s_[10:13, 7:11]

# Stored value, type, scale and unit of the file.
MARKS = {
    "-32768 in feet": (-32768, "int16", 1.0, "ft"),
    "-32767 in feet": (-32767, "int16", 1.0, "ft"),
    "-32767 in US survey feet": (-32767, "float32", 1.0, "us-ft"),
    "-32768 in cm": (-32768, "int32", 1.0, "cm"),
    "-9999 with scale 0.1": (-9999, "int16", 0.1, None),
    "-9999 with scale 0.01": (-9999, "int32", 0.01, None),
    "-9999.9": (-9999.9, "float32", 1.0, None),
    "-9999.9 in double": (-9999.9, "float64", 1.0, None),
    "-10000": (-10000, "int16", 1.0, None),
    "-9998": (-9998, "float32", 1.0, None),
    "-999": (-999, "int16", 1.0, None),
    "65535 in dm": (65535, "uint16", 1.0, "dm"),
    "32767 in dm": (32767, "int16", 1.0, "dm"),
    "-999999 in cm": (-999999, "int32", 1.0, "cm"),
    "9999": (9999, "int16", 1.0, None),
    "the lowest float": (float(np.finfo(np.float32).min), "float32", 1.0, None),
    "1e20": (1e20, "float32", 1.0, None),
    "2147483647 in mm": (2147483647, "int32", 1.0, "mm"),
}


def stored(dtype: str, scale: float, unit: str | None) -> np.ndarray:
    steps = GROUND / (scale * UNITS[(unit or "m").replace("-", "")])
    return (steps if dtype.startswith("float") else np.round(steps)).astype(dtype)


@pytest.mark.costly
@pytest.mark.parametrize("where", ["a block", "one post", "the edge"])
@pytest.mark.parametrize("case", MARKS)
def test_a_usual_mark_is_refused_and_read_as_void_once_it_is_said(
    case: str, where: str, tmp_path: pathlib.Path
) -> None:
    mark, dtype, scale, unit = MARKS[case]
    values = stored(dtype, scale, unit)
    here = {"a block": BLOCK, "one post": np.s_[5:6, 6:7], "the edge": np.s_[0:2, :]}[where]
    values[here] = mark
    path = write(tmp_path / "dem.tif", values, scale=scale if scale != 1.0 else None, unit=unit)
    with pytest.raises(DemError, match=r"dem\.tif: .*nodata=") as refusal:
        read_dem(path, vertical_datum=0)
    said = str(refusal.value).split("nodata=")[1].split(";")[0].rstrip(".").split(". ")[0]
    dem = read_dem(path, vertical_datum=0, nodata=float(said))
    expected = np.zeros(SHAPE, bool)
    expected[here] = True
    np.testing.assert_array_equal(dem.void, expected)
    metres = stored(dtype, scale, unit) * scale * UNITS[(unit or "m").replace("-", "")]
    np.testing.assert_allclose(np.asarray(dem.posts)[~expected], metres[~expected], rtol=0, atol=1e-9)


def test_terrain_on_disk_finds_them_too(tmp_path: pathlib.Path) -> None:
    values = stored("int16", 1.0, "ft")
    values[BLOCK] = -32768
    path = write(tmp_path / "dem.tif", values, unit="ft")
    with pytest.raises(DemError, match=r"exactly -32768.*Pass nodata=-32768"):
        _ = open_dem(path, vertical_datum=0).highest
    assert open_dem(path, vertical_datum=0, nodata=-32768).lowest > 0.0
    with pytest.raises(DemError, match=r"nodata=-5 marks no post"):
        _ = open_dem(path, vertical_datum=0, nodata=[-32768, -5]).highest


def test_one_value_given_does_not_switch_the_search_for_others_off(tmp_path: pathlib.Path) -> None:
    values = GROUND.astype(np.float32)
    values[BLOCK], values[0, 0], values[20:22, 3:5] = -9999.0, -32768.0, 0.0
    path = write(tmp_path / "dem.tif", values, nodata=-32768.0)
    with pytest.raises(
        DemError, match=r"exactly -9999, .* no nodata tag for that \(-32768 is it\). Pass nodata=-9999\."
    ):
        read_dem(path, vertical_datum=0)
    with pytest.raises(DemError, match=r"exactly -9999"):
        read_dem(path, vertical_datum=0, nodata=0.0)
    assert int(np.sum(read_dem(path, vertical_datum=0, nodata=[0.0, -9999]).void)) == 12 + 1 + 4


def test_several_marks_are_told_at_once(tmp_path: pathlib.Path) -> None:
    values = np.round(GROUND).astype(np.int16)
    values[BLOCK], values[0, 0] = -9999, -32768
    path = write(tmp_path / "dem.tif", values)
    with pytest.raises(DemError, match=r"13 posts, .* exactly -32768 or -9999.* Pass nodata=\[-32768, -9999\]\."):
        read_dem(path, vertical_datum=0)
    assert int(np.sum(read_dem(path, vertical_datum=0, nodata=[-32768, -9999]).void)) == 13


@pytest.mark.parametrize("nodata", [-9998, 12.5, [-9999, -1], 1e30, 70000])
def test_a_value_that_marks_no_post_says_so(nodata: Any, tmp_path: pathlib.Path) -> None:
    values = np.round(GROUND).astype(np.int16)
    values[BLOCK] = -9999
    path = write(tmp_path / "dem.tif", values, nodata=-9999)
    with pytest.raises(DemError, match=r"marks no post of it .*before scale and unit"):
        read_dem(path, vertical_datum=0, nodata=nodata)
    read_dem(path, vertical_datum=0, nodata=-9999)  # the file's own tag, once more
    read_dem(path, vertical_datum=0, nodata=nodata, bounds=(5.0, 44.99, 5.01, 45.0))  # there may be some elsewhere


def test_what_is_no_value_is_refused(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", GROUND)
    with pytest.raises(
        DemError, match=r"dem\.tif: nodata=True is no stored value; give a number, or several in a list"
    ):
        read_dem(path, vertical_datum=0, nodata=True)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_single_pits_and_spikes_are_named(sign: float, tmp_path: pathlib.Path) -> None:
    values = GROUND + 2000.0
    for row, col in ((5, 6), (0, 29), (12, 0)):
        values[row, col] += sign * 900.0
    path = write(tmp_path / "dem.tif", np.round(values).astype(np.int16))
    with pytest.raises(DemError, match=r"3 posts, the first at row 0, column 29, .* 500 m below or above") as refusal:
        read_dem(path, vertical_datum=0)
    said = json.loads(str(refusal.value).split("nodata=")[1].split("]")[0] + "]")
    assert len(said) == 3
    dem = read_dem(path, vertical_datum=0, nodata=said)
    assert np.asarray(dem.void)[5, 6]


def test_a_patch_of_zeros_in_the_mountains_is_named(tmp_path: pathlib.Path) -> None:
    values = GROUND + 1500.0
    values[BLOCK] = 0.0
    path = write(tmp_path / "dem.tif", values)
    with pytest.raises(DemError, match=r"12 posts, the first at row 10, column 7, where the file stores 0,.*nodata=0,"):
        read_dem(path, vertical_datum=0)
    assert int(np.sum(read_dem(path, vertical_datum=0, nodata=0).void)) == 12


SLOPE = np.add.outer(np.linspace(-4000.0, -300.0, 60), np.linspace(0.0, 40.0, 50))
CLIFF = np.where(np.arange(30)[None, :] < 12, 100.0, 1000.0) + np.zeros((24, 1))
SOUND: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "a sea floor that passes -999": (np.round(SLOPE).astype(np.int16), {}),
    "a trench": (np.round(SLOPE - 6800.0).astype(np.int16), {}),
    "a cliff of 900 m": (CLIFF, {}),
    "a lake beside a cliff": (np.where(CLIFF > 500.0, CLIFF, 0.0), {}),
    "a tower of 300 m": (np.where(np.indices(SHAPE).sum(axis=0) == 20, GROUND, GROUND + 0.0) + np.eye(*SHAPE), {}),
    "heights that pass 3276.7 m in dm": (np.round(SLOPE * 10.0 + 45_000.0).astype(np.uint16), {"unit": "dm"}),
    "the Dead Sea": (np.full(SHAPE, -430.0), {}),
    "coarse relief": (np.where(np.eye(*SHAPE) > 0, -900.0, GROUND), {"affine": Affine(0.5, 0, 5.0, 0, -0.5, 45.0)}),
}


@pytest.mark.parametrize("case", SOUND)
def test_ground_is_no_void(case: str, tmp_path: pathlib.Path) -> None:
    values, options = SOUND[case]
    path = write(tmp_path / "dem.tif", values, **options)
    assert not np.any(read_dem(path, vertical_datum=0).void)


def test_no_window_of_ground_is_taken_for_a_void(tmp_path: pathlib.Path) -> None:
    """Whatever part is read, as small as may be."""
    values = np.round(SLOPE).astype(np.int16)
    tile = read_header(str(write(tmp_path / "dem.tif", values)), 1)
    for row in range(58):
        for shape in ((2, 2), (2, 50), (5, 9)):
            part = values[row : row + shape[0], : shape[1]]
            check_untagged(tile, part, np.zeros(part.shape, bool), (row, 0), 1.0)


@pytest.mark.parametrize("unit, factor", [("m", 100.0), ("ft", 150.0), ("us-ft", 150.0), ("km", 1.0), ("dm", 200.0)])
def test_impossible_heights_are_refused_in_any_unit(unit: str, factor: float, tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", GROUND * factor, unit=unit)
    with pytest.raises(
        DemError, match=r"it stores \d+.*, a height of .* m, which no place on the Earth has.*height_unit="
    ):
        read_dem(path, vertical_datum=0)


SPELLINGS = {
    1.0: "m, metre, meter, metres, Meters, METRE, [m]",
    0.3048: "ft, foot, feet, Foot, FEET, international_foot, foot (international), ft_int",
    1200 / 3937: "US survey foot, us-ft, ftUS, foot_us, US_survey_foot, US Survey Feet, ft-us, Foot_US, us_ft, usft",
    0.1: "dm, decimetre, decimeter, Decimeters",
    0.01: "cm, centimetre, centimeters",
    0.001: "mm, millimeter",
    1000.0: "km, kilometre",
}  # fmt: skip


@pytest.mark.parametrize("word, metres", [(word, m) for m, words in SPELLINGS.items() for word in words.split(", ")])
def test_units_however_they_are_spelt(word: str, metres: float) -> None:
    assert metres_in(word) == metres


@pytest.mark.parametrize("word", ["fathom", "yd", "", "degree", "inch"])
def test_what_is_no_unit_of_height_is_none(word: str) -> None:
    assert metres_in(word) is None


def test_the_report_counts_voids(tmp_path: pathlib.Path) -> None:
    values = GROUND.copy()
    values[BLOCK] = -5.0
    path = write(tmp_path / "dem.tif", values, affine=Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0))
    assert read_dem_and_report(path, vertical_datum=0, nodata=-5)[1].voids == 12

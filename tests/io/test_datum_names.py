"""Vertical datums by the names in use: each is its code wherever a datum is named, or refused with names that do."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pytest

from jaxgeo.cli._inputs import as_datum
from jaxgeo.io import write_fixes
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.io.archives import fetch_geoid
from jaxgeo.io.datum_names import ACCEPTED, UNCLEAR
from jaxgeo.io.errors import VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.vertical import height_shift
from tests.support.made_fixes import made

SAME = [("EGM96", "EPSG:5773"), ("egm96", "EPSG:5773"), ("Egm-96", "EPSG:5773"), ("HAE", "ellipsoid"),
        ("Ellipsoid", "ellipsoid"), ("WGS84 ellipsoid", "ellipsoid")]  # fmt: skip
UNDULATION = -31.628  # m at 38.6281550 deg N, 269.7791550 deg E: test point of NGA's program for EGM96 (F477)


@pytest.mark.parametrize("name, code", SAME)
def test_a_name_is_its_code(name: str, code: str) -> None:
    at = np.array([269.779155 - 360.0]), np.array([38.628155]), np.array([500.0])
    expected = height_shift(code).to_ellipsoid(*at)
    assert float(expected[0] - 500.0) == pytest.approx(0.0 if code == "ellipsoid" else UNDULATION, abs=0.1)
    np.testing.assert_array_equal(height_shift(name).to_ellipsoid(*at), expected)
    np.testing.assert_array_equal(ellipsoidal_heights(*at, as_datum(name)), expected)


@pytest.mark.parametrize("code", ACCEPTED)
def test_all_names_of_a_datum_are_one(code: str) -> None:
    for name in ACCEPTED[code]:
        for written in (name, name.upper(), name.replace(" ", "-")):
            assert as_datum(written) == code


@pytest.mark.parametrize("name", [name for names in UNCLEAR.values() for name in names])
def test_names_of_no_one_datum_are_refused_with_those_that_do(name: str, tmp_path: pathlib.Path) -> None:
    said = r'does not say .*"ellipsoid" \(or HAE\).*"EGM96" .*"EGM2008" .*"NAVD88" \(EPSG:5703\)'
    with pytest.raises(VerticalDatumError, match=f"{name.upper()}' {said}, or an undulation in m"):
        height_shift(as_datum(name.upper()))
    with pytest.raises(ValueError, match=f"{said}\\.$"):  # an undulation has no name in a file
        write_fixes(tmp_path / "a.geojson", made(), crs="EPSG:4326", heights=name)


def test_other_datums_are_left_as_they_are() -> None:
    path = pathlib.Path("egm96.tif")
    given: list[Any] = ["EPSG:5703", "EGM96 height", "us_nga_egm96_15.tif", "egm84"]
    assert [as_datum(one) for one in given] == given
    assert as_datum("-32.5") == -32.5
    with pytest.raises(VerticalDatumError, match=r"egm96\.tif"):
        height_shift(path)


def test_files_above_the_ellipsoid_take_its_other_names(tmp_path: pathlib.Path) -> None:
    """And no other datum."""
    marks = tmp_path / "flight_Timestamp.MRK"
    marks.write_text(
        "1\t1000.0\t[2200]\t1,N\t2,E\t3,V\t36.30000000,Lat\t-84.25000000,Lon\t500.000,Ellh\t0.01, 0.01, 0.02\t50,Q\n"
    )
    assert read_positions(marks, height_datum="HAE", crs=None).has_heights
    with pytest.raises(ValueError, match="above the ellipsoid"):
        read_positions(marks, height_datum="EGM96", crs=None)


def test_fixes_are_written_above_a_named_datum(tmp_path: pathlib.Path) -> None:
    rows = []
    for name in ("EPSG:5773", "EGM96", "ellipsoid", "hae"):
        path = tmp_path / f"{name.replace(':', '')}.csv"
        write_fixes(path, made(), crs="EPSG:4326", heights=name)
        rows.append(path.read_text())
    assert rows[0] == rows[1] != rows[2] == rows[3]


def test_the_grid_of_a_named_datum_is_found() -> None:
    assert fetch_geoid("EGM96") == []

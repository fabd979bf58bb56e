"""Tables on the terminal: every number in full, whatever the width."""

from __future__ import annotations

import io
import re
from typing import Any

import pytest

from jaxgeo.cli._console import Console
from jaxgeo.cli._locate_results import fixes_table
from jaxgeo.cli._screen import number_table

COLUMNS = {
    "name": ("name", ""),
    **{key: (key, ".7f") for key in ("lat", "lon", "height", "range", "heading", "pitch")},
    "status": ("status", ""),
}
ROWS = [
    {"name": f"image_{k}.jpg", "status": "camera_below_terrain", "lat": 36.1234567 + k, "lon": -104.7654321,
     "height": 1234.5, "range": None, "heading": 359.0, "pitch": -0.0}
    for k in range(3)
]  # fmt: skip


def printed(table: Any, width: int) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False).print(table)
    return stream.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 100, 160])
def test_every_number_is_shown_in_full_at_any_width(width: int) -> None:
    text = printed(number_table(ROWS, COLUMNS, "height: m"), width)
    assert all(len(line) <= width for line in text.splitlines())
    assert "…" not in text
    for row in ROWS:
        for name in ("lat", "lon", "height", "heading"):
            assert f"{row[name]:.7f}" in text
    names = [line for line in text.splitlines() if "image_1.jpg" in line]
    tables = sum("──" in line for line in text.splitlines())
    assert len(names) == tables  # each table names its rows
    assert text.count("height: m") == 1


def test_wide_terminals_get_one_table() -> None:
    assert printed(number_table(ROWS, COLUMNS), 160).count("image_0.jpg") == 1


def test_zero_has_no_sign() -> None:
    text = printed(number_table([{"a": -0.0, "b": -1e-9, "c": -1.0}], {k: (k, ".2f") for k in "abc"}), 80)
    assert re.findall(r"-?\d\.\d\d", text) == ["0.00", "0.00", "-1.00"]


def test_fixes_leave_columns_out_before_they_take_a_second_table() -> None:
    row = {"name": "2012-09-19T20:41:00Z", "u": 639.5, "v": 359.5, "fix_lat_deg": 41.1357459,
           "fix_lon_deg": -104.7860772, "fix_height_m": 1837.61, "fix_height_msl_m": 1853.54, "slant_range_m": 2107.6,
           "incidence_surface_deg": 59.4, "status": "hit"}  # fmt: skip
    text = printed(fixes_table([row], None, 80), 80)
    assert "41.1357459  -104.7860772  1837.61" in text
    assert text.count("2012-09-19T20:41:00Z") == 1
    assert "inc." not in text
    wide = " ".join(printed(fixes_table([row], None, 160), 160).split())
    assert all(word in wide for word in ("2107.6", "59.4", "range: slant range, m; inc.: incidence angle, deg"))

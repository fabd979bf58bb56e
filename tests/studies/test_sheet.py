"""Tables of studies on screens of any width."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from jaxgeo.studies.sheet import Sheet

REMARK = "what the printed figure is, and why it differs from the one obtained here, in a sentence"
SHEET = Sheet(
    "cases",
    "All cases",
    {"case": "", "points": "d"} | {f"printed {axis}": ".3f" for axis in "xyz"} | {"ours": ".4f", "remark": ""},
    [["direct georeferencing", 21, 0.444, None, 2.734, 1.23456, REMARK], ["free net", 12, 0.1, 0.2, 0.3, 0.4, ""]],
    "Root mean squares.",
)


@pytest.mark.parametrize("width", [40, 56, 70, 90, 150])
def test_numbers_and_remarks_are_never_cut(width: int) -> None:
    stream = io.StringIO()
    Console(file=stream, width=width).print(SHEET.to_rich(width))
    text = stream.getvalue()
    assert "…" not in text
    for number in ("direct", "points", "printed", "ours", "21", "0.444", "–", "2.734", "1.2346", "0.300"):
        assert number in text
    below = text[text.index("Root mean squares.") :]
    assert (REMARK[:20] in below) == (width < 90)


def test_a_file_has_room_for_remarks() -> None:
    assert REMARK in SHEET.to_markdown()

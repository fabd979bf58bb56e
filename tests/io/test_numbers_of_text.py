"""Numbers in text files are ASCII decimals; what else Python's `float` takes is refused by every reader of text."""

from __future__ import annotations

import json
import math
import pathlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgeo._text_numbers import number_in, whole_in, words_of
from tests.fuzz.readers import READERS

# Of each reader of text a number in one of its sound files; "47.1" becomes "4_7.1" and so on.
PLACES = {
    "XMP of a drone image": "35.50",
    "orientations": "43.7",
    "orientations in a map": "292710.2",
    "orientations of other programs": "751000.12",
    "orientations of aerial triangulation": "292710.20000",
    "cameras of Metashape": "277.5",
    "subtitles of DJI": "8.25",
    "flight log of AirData": "47.1",
    "positions of images": "610.5",
    "reconstruction of OpenSfM": "24.6801",
    "points of OpenSfM": "24.6801",
    "cameras of OpenSfM": "800",
    "cameras of Orthority": "92.16",
    "exposures of Orthority": "5200.0",
    "camera": "8.8",
    "shots": "36.318",
    "navigation": "5500",
    "ground control": "2731048.25",
    "image points": "10.25",
    "BAL": "10.5",
    "camera parameters of Pix4D": "4020020.5",
    "camera of Pix4D": "1.385",
    "cameras of COLMAP, text": "203.5",
    "images of COLMAP, text": "900.125",
    "fisheyes of OpenSfM": "24.6801",
    "log of ArduPilot, text": "36.3",
    "flight log of Litchi": "36.3002",
    "flight log at a time": "301.5",
    "flight log of Flight Reader": "984.252",
    "image of a band": "0.05",
}
NO_TEXT = {"DEM, VRT", "DEM, ASCII grid", "scene"}  # GDAL's own numbers; a scene has those of a camera file, TOML
ARABIC, FULLWIDTH = ({ord(str(k)): first + k for k in range(10)} for first in (0x0660, 0xFF10))
ODD = {
    "underscore": lambda number: number[0] + "_" + number[1:],
    "Arabic-Indic digits": lambda number: number.translate(ARABIC),
    "fullwidth digits": lambda number: number.translate(FULLWIDTH),
    "no-break space": lambda number: number[0] + "\u00a0" + number[1:],
    "narrow no-break space": lambda number: number[0] + "\u202f" + number[1:],
    "hexadecimal": lambda number: "0x10",
    "infinity": lambda number: "infinity",
    "inf": lambda number: "inf",
    "two points": lambda number: number.replace(".", ".1."),
}
# What a format has: underscores of TOML and YAML 1.1, and their hexadecimals, which then are in range or not.
OWN = {
    ("camera", "underscore"), ("camera", "hexadecimal"),
    ("cameras of Orthority", "underscore"), ("cameras of Orthority", "hexadecimal"),
    *((name, "two points") for name in ("navigation", "cameras of OpenSfM")),  # of a whole number
}  # fmt: skip
CASES = [(name, kind) for name in PLACES for kind in ODD if (name, kind) not in OWN]


def test_every_reader_of_text_has_its_row() -> None:
    assert {reader.name for reader in READERS if reader.text} == set(PLACES) | NO_TEXT


@pytest.mark.costly
@pytest.mark.parametrize("name, kind", CASES)
def test_a_number_that_only_python_reads_is_refused(tmp_path: pathlib.Path, name: str, kind: str) -> None:
    reader = next(reader for reader in READERS if reader.name == name)
    number = PLACES[name].encode()
    content = next(seed for seed in reader.seeds(tmp_path) if number in seed)
    path = tmp_path / f"sound{reader.ending}"
    path.write_bytes(content)
    reader.check(reader.read(path))
    changed = re.sub(rb"(?<![\d.])" + re.escape(number), ODD[kind](number.decode()).encode(), content)
    assert changed != content
    path.write_bytes(changed)
    with pytest.raises(reader.refusals, match=re.escape(path.name)):
        reader.read(path)


@pytest.mark.parametrize("text", ["1", "-1", "+1.5", ".5", "5.", "1e3", "-1.5E-3", " 7 ", "\t7\r\n", "0" * 300 + "1"])
def test_a_decimal_is_read_as_python_reads_it(text: str) -> None:
    assert number_in(text) == float(text)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_float_is_read_to_the_last_bit(value: float) -> None:
    for text in (repr(value), f"{value:.17g}", f"{value:.20f}"):
        assert number_in(text) == float(text)


@pytest.mark.costly
@given(st.text(max_size=12))
def test_what_is_taken_is_ascii_and_python_takes_it_too(text: str) -> None:
    value = number_in(text)
    if value is not None:
        assert text.isascii()
        assert value == float(text)
        assert math.isfinite(value)


@given(st.one_of(st.integers(-(2**70), 2**70).map(str), st.text("0123456789+-_ ", max_size=24)))
def test_whole_numbers_are_those_of_64_bits(text: str) -> None:
    value = whole_in(text)
    bare = text.strip(" ").lstrip("+-")
    is_whole = bare.isdigit() and text.strip(" ").count("+") + text.strip(" ").count("-") <= 1
    assert (value is not None) == (is_whole and abs(int(text)) < 2**63)
    assert value is None or value == int(text)


def test_long_numbers_cost_nothing() -> None:
    assert number_in("9" * 10_000) is None
    assert whole_in("9" * 10_000) is None
    assert number_in("0." + "3" * 390) == 1.0 / 3.0
    assert number_in("0." + "3" * 10_000_000) is None


def test_a_no_break_space_parts_no_words() -> None:
    assert words_of(" 500\u00a0000.5 2\t3 ") == ["500\u00a0000.5", "2", "3"]
    assert words_of(" \t") == []


def test_json_knows_its_own_numbers() -> None:
    """Readers of JSON rely on it: its parser takes ASCII decimals alone, and words that `number_of` refuses."""
    for text in ("1_0", "0x10", "\u0661", "+1", ".5", "inf"):
        with pytest.raises(json.JSONDecodeError):
            json.loads(text)

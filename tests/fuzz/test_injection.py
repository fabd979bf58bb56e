"""Names in files that would run, colour or turn round what they are printed into: nothing of it gets through."""

from __future__ import annotations

import csv
import io
import json
import pathlib
import re
import unicodedata

import pytest
from defusedxml.ElementTree import fromstring
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.demo import scene_file
from tests.fuzz.sound_files import RECONSTRUCTION, SHOT

NAMES = (
    "\x1b[31mred\x1b[0m",  # colours a terminal
    "\x1b]0;title\x07",  # its title
    "\x9b2J",  # clears it, as one byte of C1
    "a\u202egpj.exe",  # turns round what comes behind
    "a\u2066b\u2069",
    "\ufeffa\u200b",  # not seen
    "first\nsecond",
    "a\rb",
    "a\0b",
    '=HYPERLINK("http://127.0.0.1","x")',  # a spreadsheet runs it
    "+1+cmd|' /C calc'!A0",
    "@SUM(1)",
    "<script>alert(1)</script>",
    "]]></name><name>",
    "&amp;&lt;",
    '"},{"a":"',
    "{{7*7}}",
    "%s%n",
    "../../../etc/passwd",
    "\u2028separated",
)
FORBIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def hostile(folder: pathlib.Path, names: tuple[str, ...] = NAMES) -> pathlib.Path:
    shots = {name: {**SHOT, "translation": [k, 5.0, 100.0]} for k, name in enumerate(names)}
    content = [{**RECONSTRUCTION, "shots": shots}]
    (folder / "hostile.json").write_text(json.dumps(content))
    return folder / "hostile.json"


def harmful(text: str) -> set[str]:
    return {character for character in text if character != "\n" and unicodedata.category(character) in FORBIDDEN}


@pytest.mark.costly
@pytest.mark.parametrize("name", NAMES)
def test_no_name_reaches_the_terminal_as_more_than_text(tmp_path: pathlib.Path, name: str) -> None:
    result = CliRunner().invoke(app, ["inspect", str(hostile(tmp_path, (name,))), "--camera-datum", "ellipsoid"])
    assert result.exit_code in (0, 2), result.output
    assert not harmful(result.output), result.output


@pytest.mark.costly
@pytest.mark.parametrize("title", [name for name in NAMES if "\0" not in name])
def test_a_title_of_a_scene_is_text(tmp_path: pathlib.Path, title: str) -> None:
    text = re.sub(r'title = ".*"', lambda _: f"title = {json.dumps(title)}", scene_file().read_text())
    (tmp_path / "scene.toml").write_text(text)
    result = CliRunner().invoke(app, ["inspect", str(tmp_path / "scene.toml")])
    assert result.exit_code in (0, 2), result.output
    assert not harmful(result.output), result.output


def test_names_in_json_are_those_of_the_file(tmp_path: pathlib.Path) -> None:
    result = CliRunner().invoke(app, ["inspect", str(hostile(tmp_path)), "--camera-datum", "ellipsoid", "--json"])
    assert result.exit_code == 0, result.output
    assert not harmful(result.stdout), result.stdout
    written = json.dumps(json.loads(result.stdout))
    assert all(json.dumps(name)[1:-1] in written for name in NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".geojson", ".kml"])
def test_no_name_breaks_out_of_a_file_that_is_written(tmp_path: pathlib.Path, ending: str) -> None:
    target = tmp_path / f"fixes{ending}"
    line = ["locate", hostile(tmp_path), "--camera-datum", "ellipsoid", "--ground", "0", "--pixel", "10,10"]
    result = CliRunner().invoke(app, [*map(str, line), "--no-accuracy", "-o", str(target)])
    assert result.exit_code in (0, 1, 2), result.output
    assert not harmful(result.output), result.output
    if not target.exists():
        assert result.exit_code == 2
        return
    text = target.read_text(encoding="utf-8")
    if ending == ".kml":
        root = fromstring(text)
        assert not [one for one in root.iter() if one.tag.rpartition("}")[2] == "script"]
        assert len([one for one in root.iter() if one.tag.endswith("Placemark")]) >= len(NAMES)
    elif ending == ".geojson":
        assert len(json.loads(text)["features"]) == len(NAMES)
    else:
        assert not re.search(r"(^|,)\"?[=+@]", text, re.MULTILINE)
        assert len(list(csv.DictReader(io.StringIO(text, newline="")))) == len(NAMES)

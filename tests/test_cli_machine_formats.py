"""On a terminal, what a program is to read stays whole: counts, reasons and bars are not within it."""

from __future__ import annotations

import csv
import io
import json
import os
import pathlib
import threading
from collections.abc import Callable

import pytest
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image
from test_cli_folders import DJI, GROUND

from jaxgeo.cli import app
from jaxgeo.demo import scene_file

HEADER = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg,u,v"
DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))


def on_a_terminal(monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> str:
    """What a terminal shows of a command whose stdout and stderr are both that terminal."""
    outer, inner = os.openpty()
    shown: list[bytes] = []

    def read() -> None:
        while True:
            try:
                part = os.read(outer, 65536)
            except OSError:  # the other end is closed
                return
            shown.append(part)

    reader = threading.Thread(target=read)
    reader.start()
    with open(inner, "w", closefd=False) as stdout, open(inner, "w", closefd=False) as stderr:
        monkeypatch.setattr("sys.stdout", stdout)
        monkeypatch.setattr("sys.stderr", stderr)
        with pytest.raises(SystemExit) as left:
            app(arguments)
        monkeypatch.undo()
    os.close(inner)
    reader.join(timeout=20.0)
    os.close(outer)
    assert left.value.code == 0, b"".join(shown)
    return b"".join(shown).decode().replace("\r\n", "\n")


def is_whole_json(text: str, count: int) -> None:
    content, _ = json.JSONDecoder().raw_decode(text[text.index("{") :])
    assert len(content.get("features", content.get("fixes"))) == count


def is_whole_csv(text: str, count: int) -> None:
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if "fix_lat_deg" in line)
    rows = list(csv.DictReader(io.StringIO("\n".join(lines[start : start + count + 1]))))
    assert len(rows) == count
    assert all(float(row["fix_lat_deg"]) for row in rows)


FORMATS: dict[str, tuple[list[str], Callable[[str, int], None]]] = {
    "geojson": (["--format", "geojson"], is_whole_json),
    "csv": (["--format", "csv"], is_whole_csv),
    "json": (["--json"], is_whole_json),
}


@pytest.mark.costly
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("of", ["images", "shots"])
def test_rows_on_a_terminal_are_whole(tmp_path: pathlib.Path, monkeypatch, form: str, of: str) -> None:
    options, is_whole = FORMATS[form]
    if of == "images":
        for name in ("a.jpg", "b.jpg"):
            write_image(tmp_path / name, packet(DJI), make="DJI")
        arguments = [str(tmp_path), *GROUND, "--no-accuracy"]
    else:
        table = tmp_path / "shots.csv"
        row = "36.318,-84.105,5500,160,1,-0.5,72,0,1199.5,2399.5"
        table.write_text("\n".join([HEADER, row, row]) + "\n")
        arguments = ["--scene", str(scene_file()), "--ground", "300", "--shots", str(table)]
    text = on_a_terminal(monkeypatch, ["locate", *arguments, *options])
    assert "2 pixels:" in text
    is_whole(text, 2)


def test_a_dash_is_the_screen(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "a.jpg", packet(DJI), make="DJI")
    result = CliRunner().invoke(app, ["locate", "a.jpg", *GROUND, "--no-accuracy", "-o", "-", "--format", "csv"])
    assert result.exit_code == 0, result.stderr
    (row,) = csv.DictReader(io.StringIO(result.stdout))
    assert row["name"] == "a.jpg"
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]

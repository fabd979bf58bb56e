"""Hundreds of images in one folder: a row for each, and nothing partial of a command that is stopped."""

from __future__ import annotations

import csv
import io
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest
from support import interrupted
from support.drone_image_files import packet, write_image
from test_cli_folders import DJI, GROUND

pytestmark = pytest.mark.slow

COUNT = 200


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("many")
    for k in range(COUNT):
        tags = DJI | {"drone-dji:GpsLatitude": f"{36.30 + 1e-4 * k:+.4f}"}
        write_image(folder / f"DJI_{k:04d}.jpg", packet(tags), make="DJI")
    return folder


def started(flight: pathlib.Path, output: pathlib.Path) -> subprocess.Popen:
    line = [sys.executable, "-m", "jaxgeo", "locate", str(flight), *GROUND, "-o", str(output)]
    return interrupted.started(line, stdout=subprocess.PIPE)


def test_each_of_many_images_has_its_row(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    output = tmp_path / "fixes.csv"
    process = started(flight, output)
    _, told = process.communicate(timeout=300)
    assert process.returncode == 0, told
    rows = list(csv.DictReader(io.StringIO(output.read_text())))
    assert [row["name"] for row in rows] == [f"DJI_{k:04d}.jpg" for k in range(COUNT)]
    north = [float(row["fix_lat_deg"]) for row in rows]
    assert north[-1] - north[0] == pytest.approx(1e-4 * (COUNT - 1), abs=1e-7)
    assert all(float(row["ce90_m"]) > 0.0 for row in rows)
    assert told.count("assumed:") < 20, "told once, and not for each image"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGKILL"])
@pytest.mark.parametrize("after", ["assumed:", None], ids=["while it computes", "while it starts"])
def test_a_stopped_command_leaves_the_output_as_it_was(
    flight: pathlib.Path, tmp_path: pathlib.Path, name: str, after: str | None
) -> None:
    output = tmp_path / "fixes.csv"
    output.write_text("as it was")
    process = started(flight, output)
    assert process.stderr is not None
    if after is None:
        time.sleep(3.0)
    else:
        while after not in process.stderr.readline():
            assert process.poll() is None
    os.kill(process.pid, getattr(signal, name))
    _, told = process.communicate(timeout=60)
    assert process.returncode == {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -signal.SIGKILL}[name]
    assert output.read_text() == "as it was"
    assert list(tmp_path.iterdir()) == [output]
    assert "Traceback" not in told

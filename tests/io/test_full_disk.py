"""A disk without room: every writer tells it with the file's name, and leaves nothing that looks whole.

Held against: the system itself, whose limit on the size of a file fails in Python, GDAL, SQLite and Arrow as a full
disk does.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator

import numpy as np
import pyproj
import pytest
from rasterio.transform import Affine

from jaxgeo import Geodetic, Pose
from jaxgeo.adjust import ImagePoints
from jaxgeo.demo import scene_file
from jaxgeo.io import (
    MapRaster,
    Orientations,
    read_bal,
    write_bal,
    write_fixes,
    write_image_points,
    write_orientations,
    write_orthoimage,
    write_updated_scene,
)
from jaxgeo.io.registration_report import write_registration_report
from jaxgeo.io.scene import read_scene
from tests.fuzz.sound_files import BAL
from tests.support.made_fixes import ALPS, made

RASTER = MapRaster(pyproj.CRS("EPSG:32632"), Affine(5.0, 0.0, 650_000.0, 0.0, -5.0, 5_207_000.0), (200, 200))

pytestmark = [
    pytest.mark.costly,
    pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does"),
]


@contextlib.contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file of this process grows beyond some bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def some_fixes(path: pathlib.Path) -> None:
    write_fixes(path, made(np.repeat(ALPS[:1], 30, axis=0)), attributes=[{"name": f"a{k}"} for k in range(30)])


def some_points(path: pathlib.Path) -> None:
    names = np.array([f"a{k}" for k in range(300)])
    write_image_points(path, ImagePoints(names, names, np.ones((300, 2))))


def some_orientations(path: pathlib.Path) -> None:
    zero = np.zeros(300)
    pose = Pose(Geodetic(lat=zero, lon=zero, height=zero), zero, zero, zero)
    write_orientations(path, Orientations(np.arange(300).astype(str), pose))


def some_image(path: pathlib.Path) -> None:
    write_orthoimage(path, np.random.default_rng(0).integers(0, 255, (3, 200, 200)).astype(np.uint8), RASTER)


def some_cog(path: pathlib.Path) -> None:
    write_orthoimage(path, np.random.default_rng(0).random((1, 200, 200), np.float32), RASTER, cog=True)


def some_scene(path: pathlib.Path) -> None:
    shot = read_scene(scene_file()).shot
    assert shot is not None
    write_updated_scene(path, scene_file(), shot)


def some_problem(path: pathlib.Path) -> None:
    held = path.with_name("held.txt")
    if not held.exists():
        held.write_text(BAL)
    write_bal(path, read_bal(held))


WRITERS: dict[str, Callable[[pathlib.Path], None]] = {
    **{f"fixes{ending}": some_fixes for ending in (".csv", ".geojson", ".gpkg", ".parquet", ".kml", ".kmz", ".gpx")},
    "points.csv": some_points,
    "orientations.csv": some_orientations,
    "image.tif": some_image,
    "cloud.tif": some_cog,
    "scene.toml": some_scene,
    "problem.txt": some_problem,
    "problem.bz2": some_problem,
    "report.json": lambda path: write_registration_report(path, {"a": list(range(100))}),
}


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: pathlib.Path, name: str, share: float) -> None:
    whole, path = tmp_path / f"whole_{name}", tmp_path / name
    WRITERS[name](whole)
    before = sorted(tmp_path.iterdir())
    with room_for(int(share * whole.stat().st_size)), pytest.raises((OSError, ValueError)) as error:
        WRITERS[name](path)
    assert f"{path}" in str(error.value)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["study", "--help"], ["inspect", f"{scene_file()}"]])
def test_a_screen_that_takes_nothing_is_told_in_a_line(arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "jaxgeo", *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "jaxgeo: the output cannot be written: No space left on device; make room, or send it elsewhere."
    ]

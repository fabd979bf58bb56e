"""How commands read elevation models: the same options everywhere, URLs as typed, advice that works as printed."""

from __future__ import annotations

import pathlib
import re
import shlex
from typing import Any

import numpy as np
import pytest
import typer
from rasterio.transform import Affine
from support.command_files import prepare
from support.command_runner import CliRunner
from support.rasters import DEGREE, gdalbuildvrt, hills, write

from jaxgeo.cli import app
from jaxgeo.cli._option_names import dem_as_typed

URL = "s3://bucket/folder/dem.tif"
READING = (
    "--nodata -9999 --nodata 0 --height-unit ft --dem-band 2 --dem-bounds -85,36,-84,37 --assume-wgs84 --allow-remote "
    "--allow-outside"
)
SCENE = f"--scene scene.toml --dem {URL}"
LINES = {
    "locate": f"{SCENE} --pixel 1,2",
    "report": f"{SCENE} --pixel 1,2 -o out.html",
    "view": f"{SCENE} --no-browser",
    "footprint": SCENE,
    "point": f"{SCENE} --target 36.27,-84.268",
    "overlap": f"{SCENE} --shots shots.csv",
    "plan": f"{SCENE} --navigation flight.csv --overlap 0.5 -o out.csv",
    "accuracy-map": f"{SCENE} --resolution 100 -o out.tif",
    "rectify": f"image.tif {SCENE} -o out.tif",
    "adjust": f"images --camera-datum ellipsoid --dem {URL} -o out",
    "register": f"image.tif {SCENE} --reference ortho.tif --position-sigma 20 --attitude-sigma 0.3 -o out",
    "inspect": f"DJI_0042.JPG --takeoff-height dem --dem {URL}",
    "scene": f"DJI_0042.JPG --takeoff-height dem --dem {URL} -o out.toml",
    "validate": f"{SCENE} --points points.csv --points-datum ellipsoid",
    "study gu2017": f"{SCENE} --image image.tif --reference ortho.tif",
}


def run(words: list[str]) -> Any:
    return CliRunner().invoke(app, words, prog_name="jaxgeo")


def commands_with_dem() -> set[str]:
    return commands_with("--dem")


def commands_with(*options: str) -> set[str]:
    """Commands that take all of these options."""
    group: Any = typer.main.get_command(app)
    found = set()
    for name, command in group.commands.items():
        for inner, one in getattr(command, "commands", {"": command}).items():
            if set(options) <= {option for param in one.params for option in param.opts}:
                found.add(f"{name} {inner}".strip())
    return found


class Reached(ValueError):
    """The elevation model was asked for, or was read."""


LONG = pytest.mark.slow, "register"  # whose image is rendered first


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=LONG[:1]) if name in LONG else name for name in sorted(commands_with_dem())]
)
def test_every_command_reads_a_dem_as_asked_and_keeps_urls(
    name: str, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def read_dem(paths: list[str], **options: Any) -> None:
        asked.update(paths=paths, **options)
        raise Reached("reached")

    line = f"{name} {LINES[name]}"
    prepare(tmp_path, line.replace(URL, "dem.tif"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxgeo.io.read_dem", read_dem)
    monkeypatch.setattr("jaxgeo.io.paths.files_behind", lambda path, reach: [str(path)])  # which would open the URL
    result = run([*line.split(), *READING.split()])
    assert result.exit_code == 2, result.output
    assert "reached" in result.stderr
    assert asked == {
        "paths": [URL], "vertical_datum": None, "nodata": [-9999.0, 0.0], "height_unit": "ft", "band": 2,
        "bounds": (-85.0, 36.0, -84.0, 37.0), "assume_wgs84": True, "allow_remote": True,
        "allow_outside": True, "padded": not name.startswith("study"),
    }  # fmt: skip


@pytest.mark.parametrize(
    "option",
    ["--nodata -9999", "--height-unit ft", "--dem-band 2", "--assume-wgs84", "--allow-remote", "--allow-outside"],
)
def test_options_of_a_dem_need_one(option: str) -> None:
    for line in ("point --scene s.toml --line-of-sight 1,2", "locate --scene s.toml --ground 300"):
        result = run([*line.split(), *option.split()])
        assert result.exit_code == 2
        assert f"{option.split()[0]} needs --dem FILE." in result.stderr


HERE = Affine(DEGREE, 0, -84.27, 0, -DEGREE, 36.28)
LAMBERT = "+proj=lcc +lat_1=36 +lat_2=37 +lat_0=36.5 +lon_0=-84 +ellps=GRS80"
FEET = {"crs": "EPSG:2263", "affine": Affine(30, 0, 980000, 0, -30, 200000)}
HILLS = hills((40, 50))


def marked(*marks: float, dtype: Any = np.float32, factor: float = 1.0) -> np.ndarray:
    stored = (HILLS * factor).astype(dtype)
    for index, mark in enumerate(marks):
        stored[10 + 2 * index : 12 + 2 * index, 20:25] = mark
    return stored


def pits(value: float) -> np.ndarray:
    stored = HILLS + 1500.0
    stored[5, 6] = stored[20, 30] = value
    return stored


# Options of `write`, what is typed beside the DEM, and what must be advised.
ADVISED: dict[str, tuple[dict[str, Any], str, str]] = {
    "no datum": ({}, "", "--dem-datum"),
    "no datum, DTED": ({"driver": "DTED"}, "", "--dem-datum"),
    "void -9999": ({"heights": marked(-9999)}, "--dem-datum ellipsoid", "--nodata -9999"),
    "void -9999.9": ({"heights": marked(-9999.9)}, "--dem-datum ellipsoid", "--nodata -9999.9"),
    "two voids": (
        {"heights": marked(-9999, -32768, dtype=np.int16)}, "--dem-datum ellipsoid",
        "--nodata -32768 --nodata -9999",
    ),
    "void 3.4e38": (
        {"heights": marked(float(np.finfo(np.float32).max))}, "--dem-datum ellipsoid", "--nodata 3.4028235e+38",
    ),
    "pits": ({"heights": pits(12.5)}, "--dem-datum ellipsoid", "--nodata 12.5"),
    "unit that is unknown": ({"unit": "fathom"}, "--dem-datum ellipsoid", '--height-unit "us-ft"'),
    "3DEP": ({"unit": "foot", "crs": "EPSG:4326+5703"}, "--dem-datum -30", '--height-unit "ft"'),
    "a map in feet": (FEET, "--dem-datum ellipsoid", '--height-unit "us-ft"'),
    "heights in cm": (
        {"heights": marked(dtype=np.int32, factor=100.0)}, "--dem-datum ellipsoid", '--height-unit "cm"',
    ),
    "ballpark": (
        {"crs": LAMBERT, "affine": Affine(30, 0, 0, 0, -30, 0)}, "--dem-datum ellipsoid", "--assume-wgs84",
    ),
    "no such band": ({}, "--dem-datum ellipsoid --dem-band 3", "--dem-band 1"),
}  # fmt: skip


def advice(message: str) -> str:
    """A message with each of several values of one option behind the option itself."""

    def spread(found: re.Match[str]) -> str:
        return " ".join(f"{found[1]} {value}" for value in re.findall(r'"[^"]+"', found[2]))

    return re.sub(r'(--[a-z-]+) ("[^"]+"(?:(?:, | or )"[^"]+")+)', spread, message)


@pytest.mark.costly
@pytest.mark.parametrize("case", ADVISED)
def test_what_a_refusal_advises_works_as_printed(
    case: str, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options, typed, advised = ADVISED[case]
    dem = write_dem(tmp_path / "dem.tif", **options)
    prepare(tmp_path, "jaxgeo point --scene scene.toml")
    monkeypatch.chdir(tmp_path)

    def point(*_: Any, terrain: Any, **__: Any) -> None:
        raise Reached(f"read {terrain.posts.shape}")

    monkeypatch.setattr("jaxgeo.coverage.point_gimbal", point)
    line = f"point --scene scene.toml --target 36.27,-84.268,500 --dem {dem.name}"
    refused = run([*line.split(), *typed.split()])
    message = " ".join(refused.stderr.split())
    assert refused.exit_code == 2, refused.output
    assert "=" not in re.sub(r"height = |'[^']*'", "", message), message  # no word of Python's
    if advised == "--dem-datum":
        assert advised in message
        values = re.findall(r'"(EPSG:5773|ellipsoid)"', message)
        assert set(values) == {"EPSG:5773", "ellipsoid"}
        ways = [f'--dem-datum "{value}"' for value in values]
    else:
        assert advised in advice(message), message
        ways = [advised]
    if case == "no datum, DTED":
        assert "'MSL'" in message
    for way in ways:
        kept = [] if "--dem-band" in way else typed.split()
        kept += ["--dem-datum", "ellipsoid"] if "--dem-band" in way else []
        accepted = run([*line.split(), *kept, *shlex.split(way)])
        # Some of these terrains lie elsewhere, which is told once they are read.
        assert re.search(r"read \(|the elevation model reaches", accepted.stderr), accepted.stderr


def test_what_lies_elsewhere_is_read_by_the_option_that_the_refusal_names(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mosaic over a folder beside it, as `gdalbuildvrt ../tiles/*.tif` makes it; of the image too."""
    for folder in ("tiles", "work"):
        (tmp_path / folder).mkdir()
    write(tmp_path / "tiles" / "a.tif", HILLS, affine=HERE)
    prepare(tmp_path / "work", "jaxgeo point --scene scene.toml")
    monkeypatch.chdir(tmp_path / "work")
    vrt = gdalbuildvrt(tmp_path / "dem.vrt", [tmp_path / "tiles" / "a.tif"]).read_text()
    pathlib.Path("dem.vrt").write_text(vrt.replace("tiles/a.tif", "../tiles/a.tif"))
    monkeypatch.setattr("jaxgeo.coverage.point_gimbal", lambda *_, terrain, **__: _raise(f"read {terrain.posts.shape}"))
    monkeypatch.setattr("jaxgeo.io.rectify_file", lambda *_, **how: _raise(f"read {how['allow_outside']}"))
    ground = "--dem dem.vrt --dem-datum ellipsoid"
    for line in (f"point --scene scene.toml --target 36.27,-84.268,500 {ground}", f"rectify dem.vrt --scene scene.toml "
                 f"--dem {tmp_path}/tiles/a.tif --dem-datum ellipsoid -o out.tif"):  # fmt: skip
        refused = run(line.split())
        message = " ".join(refused.stderr.split())
        assert refused.exit_code == 2, refused.output
        assert "Pass --allow-outside if you trust it" in message, message
        assert "allow_outside" not in message, message
        accepted = run([*line.split(), "--allow-outside"])
        assert "read " in accepted.stderr, accepted.stderr


def test_a_url_asks_for_an_option(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(tmp_path, "jaxgeo point --scene scene.toml")
    monkeypatch.chdir(tmp_path)
    line = f"point --scene scene.toml --target 36.27,-84.268,500 --dem {URL} --dem-datum ellipsoid"
    refused = run(line.split())
    assert refused.exit_code == 2, refused.output
    assert f"{URL}: this is no file of this machine by its path. Pass --allow-remote" in " ".join(
        refused.stderr.split()
    )


def test_a_model_too_large_asks_for_a_part(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "dem.tif", np.zeros((4000, 4000), np.uint8), affine=HERE, compress="deflate", crs="EPSG:4326")
    prepare(tmp_path, "jaxgeo point --scene scene.toml")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxgeo.io._memory_at_hand.memory_at_hand", lambda: 1e8)
    line = "point --scene scene.toml --target 36.27,-84.268,500 --dem dem.tif --dem-datum ellipsoid"
    refused = run(line.split())
    assert refused.exit_code == 2, refused.output
    said = (
        "too large: 4,000 x 4,000 posts need about 0.35 GB of memory, and 0.1 GB are at hand. Read a part of it with "
    )
    assert f"{said}--dem-bounds WEST,SOUTH,EAST,NORTH in deg" in " ".join(refused.stderr.split())


def _raise(what: str) -> None:
    raise Reached(what)


def write_dem(path: pathlib.Path, **options: Any) -> pathlib.Path:
    if options.pop("driver", None) == "DTED":
        return dted(path.with_suffix(".dt1"))
    made: dict[str, Any] = {"affine": HERE} | options
    return write(path, made.pop("heights", HILLS), **made)


def dted(path: pathlib.Path) -> pathlib.Path:
    """A tile of DTED level 1 as GDAL writes it, its field of the vertical datum MSL."""
    import rasterio
    import rasterio.shutil

    posts = np.round(hills((1201, 1201))).astype(np.int16)
    affine = Affine(DEGREE, 0, -85.0 - DEGREE / 2, 0, -DEGREE, 37.0 + DEGREE / 2)
    plain = write(path.with_suffix(".tmp.tif"), posts, affine=affine)
    with rasterio.open(plain) as data:
        rasterio.shutil.copy(data, path, driver="DTED")
    return path


def test_words_of_python_become_those_of_the_shell() -> None:
    text = 'Pass nodata=[-9999, 1.5]; height_unit="m" or assume_wgs84=True, a part with bounds=, a band with band=2.'
    typed = (
        'Pass --nodata -9999 --nodata 1.5; --height-unit "m" or --assume-wgs84, a part with --dem-bounds, a band with '
        "--dem-band 2."
    )
    assert dem_as_typed(text) == typed
    assert dem_as_typed("with bounds=(170, -60, -170, 60).") == "with --dem-bounds 170,-60,-170,60."

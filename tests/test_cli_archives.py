"""`--dem ARCHIVE` in every command and `jaxgeo dem`, against a server on the loopback: fixes, messages, advice."""

from __future__ import annotations

import json
import pathlib
import re
import shlex
import shutil
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
from support.command_files import prepare
from support.command_runner import CliRunner
from support.tile_server import Served, serving, write_archive, write_geoid
from test_cli_dem import LINES, URL, commands_with_dem

import jaxgeo
from jaxgeo.cli import app

TILE = "Copernicus_DSM_COG_10_N36_00_W085_00_DEM"
IMAGE = "DJI_0042.JPG --camera-datum ellipsoid"
AREA = "--bounds -84.30,36.30,-84.28,36.32"


def run(line: str) -> Any:
    return CliRunner().invoke(app, shlex.split(line), prog_name="jaxgeo")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    root = tmp_path_factory.mktemp("archive")
    write_archive(root, "copernicus", [(36, -85)])
    write_geoid(root)
    return root


@pytest.fixture
def home(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """An empty home folder, and a folder to work in."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    for name in ("XDG_CACHE_HOME", "JAXGEO_DEM_CACHE", "JAXGEO_DEM_MIRROR", "JAXGEO_OFFLINE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("JAXGEO_HTTP_TIMEOUT", "1")
    monkeypatch.setattr("jaxgeo.io.archives.web.PAUSE", 0.01)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return folder


@pytest.fixture
def server(archive: pathlib.Path) -> Iterator[Served]:
    with serving(archive) as served:
        yield served


def mirror(served: Served) -> str:
    return f"--mirror 'copernicus={served.url} proj={served.url}'"


@pytest.mark.costly
def test_a_fix_from_an_empty_home_is_that_of_the_same_model_by_hand(home: pathlib.Path, archive: pathlib.Path) -> None:
    """`--dem copernicus`, again without the server, and the downloaded tile with the same geoid: one answer."""
    prepare(pathlib.Path(), f"jaxgeo locate {IMAGE}")
    with serving(archive) as served:
        results = [run(f"locate {IMAGE} --dem copernicus {mirror(served)} --json")]
        assert served.sent < 1.0e6
    assert (home / ".cache" / "jaxgeo" / "dem").is_dir()
    results.append(run(f"locate {IMAGE} --dem copernicus --json"))
    results.append(run(f"locate {IMAGE} --dem copernicus --offline --json"))
    by_hand = f"--dem {archive}/{TILE}/{TILE}.tif --dem-datum {archive}/us_nga_egm08_25.tif"
    results.append(run(f"locate {IMAGE} {by_hand} --json"))
    assert [one.exit_code for one in results] == [0] * 4, results[-1].output
    *told, expected = (json.loads(one.stdout) for one in results)
    (right,) = expected["fixes"]
    place = position_of(right)
    for one in told:
        (fix,) = one["fixes"]
        assert np.abs(position_of(fix) - place).max() < 1e-6  # m
        for name in ("ce90_m", "le90_m", "slant_range_m"):
            assert abs(fix[name] - right[name]) < 1e-6  # m
        assert one["elevation_model"]["datum"] == "EPSG:3855"
        assert one["elevation_model"]["tiles"] == [f"{TILE}.tif"]
    assert "elevation_model" not in expected
    assert told[0]["elevation_model"]["bytes_fetched"] > 0
    assert [one["elevation_model"]["bytes_fetched"] for one in told[1:]] == [0, 0]
    message = " ".join(results[0].stderr.split())
    assert "heights above EGM2008 (EPSG:3855). Licence: free for any use with attribution" in message
    assert "© DLR e.V. 2010-2014" in message


def position_of(fix: dict[str, Any]) -> np.ndarray:
    """The fix of a row of JSON, ECEF m."""
    lat, lon, height = (fix[f"fix_{name}"] for name in ("lat_deg", "lon_deg", "height_m"))
    return np.asarray(jaxgeo.WGS84.to_ecef(jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=height)))


class Reached(ValueError):
    """An archive was asked."""


LONG = ("register",)  # whose image is rendered first
OF_BOUNDS = ("study gu2017",)  # for which an extent must be given


def place_of(asked: dict[str, Any]) -> tuple[float, float]:
    """(lat, lon) in deg of the first line of sight for which an archive was asked, or of the middle of its bounds."""
    if asked["rays"] is None:
        west, south, east, north = asked["bounds"]
        return 0.5 * (south + north), 0.5 * (west + east)
    origin = np.concatenate([np.asarray(ray.origin) for ray in asked["rays"].rays])
    lat, lon, _ = jaxgeo.WGS84.to_geodetic(jnp.asarray(origin[0])).to_degrees()
    return float(lat), float(lon)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in sorted(commands_with_dem())],
)
def test_every_command_with_a_dem_takes_an_archive(
    name: str, home: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its lines of sight, which come down near the scene, or the place of take-off, and the archive's options."""
    asked: dict[str, Any] = {}

    def fetch_dem(archive: str, **how: Any) -> None:
        asked.update(archive=archive, **how)
        raise Reached("reached")

    monkeypatch.setattr("jaxgeo.io.archives.fetch_dem", fetch_dem)
    line = f"{name} {LINES[name].replace(URL, 'copernicus')}"
    prepare(pathlib.Path(), line)
    plain = run(f"{line} --mirror http://host --proxy http://proxy:1 --offline")
    assert plain.exit_code == 2, plain.output
    if name in OF_BOUNDS:
        assert "--dem copernicus: say for which ground, with --dem-bounds WEST,SOUTH,EAST,NORTH" in plain.stderr
    else:
        assert "reached" in plain.stderr
        assert asked["archive"] == "copernicus"
        assert (asked["mirror"], asked["proxy"], asked["offline"]) == ("http://host", "http://proxy:1", True)
        lat, lon = place_of(asked)
        assert abs(lat - 36.3) < 0.2
        assert abs(lon + 84.2) < 0.2
    asked.clear()
    bounded = run(f"{line} --dem-bounds -85,36,-84,37")
    assert "reached" in bounded.stderr
    assert asked["bounds"] == (-85.0, 36.0, -84.0, 37.0)
    assert asked["rays"] is None


@pytest.mark.parametrize(
    "line, reason",
    [
        ("--dem copernicus --dem dem.tif", "--dem copernicus is an archive, and dem.tif another elevation model"),
        ("--dem copernicus --dem-band 2", "--dem-band 2: the tiles of archives have one band; leave it out."),
        ("--dem dem.tif --mirror http://host", "--mirror is for the archives of --dem, such as --dem copernicus"),
        ("--dem dem.tif --offline", "--offline is for the archives of --dem"),
        ("--dem copernicos", "neither a file nor an archive; the archives are copernicus, .* Did you mean copernicus?"),
        ("--dem copernicus --mirror nowhere", r"--mirror 'nowhere': neither an address \(https://...\) nor a folder."),
        ("--dem copernicus --proxy localhost:1", "--proxy 'localhost:1': expected an address such as http://HOST:PORT"),
        ("--dem https://host/{S}{X}.tif", r"the field \{X\} is unknown"),
        ("--dem stac:https://host", "this names no STAC collection"),
    ],
)
def test_options_that_are_refused(home: pathlib.Path, line: str, reason: str) -> None:
    prepare(pathlib.Path(), "jaxgeo point --scene scene.toml --dem dem.tif")
    refused = run(f"point --scene scene.toml --target 36.27,-84.268,500 {line}")
    assert refused.exit_code == 2, refused.output
    assert re.search(reason, " ".join(refused.stderr.split())), refused.stderr
    assert len(refused.stderr.strip().splitlines()) <= 2


def test_a_file_of_the_name_of_an_archive_is_the_file(home: pathlib.Path) -> None:
    prepare(pathlib.Path(), "jaxgeo point --scene scene.toml --dem dem.tif")
    shutil.copy("dem.tif", "srtm")
    line = "point --scene scene.toml --target 10,10,500 --dem srtm"
    assert "the elevation model reaches from 36.1" in " ".join(run(line).stderr.split())


# `jaxgeo dem`


def test_archives_are_listed(home: pathlib.Path) -> None:
    listed = run("dem")
    assert listed.exit_code == 0
    for name in ("copernicus ", "copernicus-90 ", "srtm ", "skadi ", "3dep "):
        assert f"\n{name}" in f"\n{listed.stdout}"
    assert re.search(r"heights above EPSG:3855\n +licence: free for any use", listed.stdout)
    told = json.loads(run("dem --json").stdout)
    assert [one["name"] for one in told["archives"]][:2] == ["copernicus", "copernicus-90"]
    assert told["cache"]["folder"] == str(home / ".cache" / "jaxgeo" / "dem")


@pytest.mark.costly
def test_a_place_an_extent_and_images(server: Served, home: pathlib.Path) -> None:
    """The model of a place holds all of its circle; of an image, what its corners see."""
    prepare(pathlib.Path(), f"jaxgeo locate {IMAGE}")
    done = run(f"dem 36.31,-84.25 --radius 2000 -o ground.tif {mirror(server)}")
    assert done.exit_code == 0, done.output
    with rasterio.open("ground.tif") as data:
        west, south, east, north = data.bounds
        assert data.crs.to_epsg() == 4979
    for edge, near, metres in ((north, 36.31, 1.0), (36.31, south, 1.0), (east, -84.25, 0.806), (-84.25, west, 0.806)):
        assert 2000.0 < (edge - near) * 111_000.0 * metres < 2300.0
    for line in (f"dem {AREA}", f"dem --for {IMAGE}", "dem 36.31N,84.25W --radius 10"):
        told = json.loads(run(f"{line} {mirror(server)} --json").stdout)
        assert told["elevation_model"]["tiles"] == [f"{TILE}.tif"]
    south = run(f"dem -36.31,-84.25 --radius 10 {mirror(server)}")
    assert "Copernicus_DSM_COG_10_S37_00_W085_00_DEM.tif" in south.stderr
    assert "sea, at height zero" in " ".join(south.stderr.split())


@pytest.mark.parametrize(
    "line, reason",
    [
        ("dem 36.31", "expected LAT,LON in deg"),
        ("dem 136.31,-84.25", "is it LON,LAT?"),
        ("dem here,there", "expected LAT,LON in deg"),
        (f"dem 36.31,-84.25 {AREA}", "give one of LAT,LON, --for FILE and --bounds EDGES."),
        (f"dem {AREA} --radius 10", "--radius 10 applies to LAT,LON; leave it out."),
        ("dem 36.31,-84.25 --radius -5", "--radius -5: must be above 0 m"),
        ("dem -o ground.tif", "--output ground.tif: say for which ground"),
        ("dem 36.31,-84.25 -o ground.png", "--output ground.png: unsupported file type .png; use .tif."),
        ("dem 36.31,-84.25 --scene scene.toml", "--scene scene.toml applies to --for FILE"),
        ("dem 36.31,-84.25 --archive none", "none: no such archive; known are copernicus"),
        ("dem --geoid EPSG:3855 --offline", "--geoid needs the network; leave --offline out."),
        ("dem --bounds 0,0,20,20", "400 square degrees; ask for at most 16 at once"),
        ("dem --bounds 0,0,20", "--dem-bounds '0,0,20': expected WEST,SOUTH,EAST,NORTH"),
    ],
)
def test_wrong_uses_of_dem(home: pathlib.Path, line: str, reason: str) -> None:
    refused = run(line)
    assert refused.exit_code == 2, refused.output
    message = " ".join(refused.stderr.split())
    assert reason in message, message
    assert len(refused.stderr.strip().splitlines()) == 1
    assert not (home / ".cache").exists()


def test_the_cache_is_cleared(server: Served, home: pathlib.Path) -> None:
    assert run(f"dem {AREA} {mirror(server)}").exit_code == 0
    cleared = run("dem --clear-cache --json")
    assert json.loads(cleared.stdout)["removed_bytes"] > 100_000
    assert json.loads(cleared.stdout)["cache"]["bytes"] == 0
    assert run(f"dem {AREA} --offline").exit_code == 2


# What is advised, done as printed


def test_offline_the_missing_tile_goes_where_it_is_said(home: pathlib.Path, archive: pathlib.Path) -> None:
    refused = run(f"dem {AREA} --offline")
    message = " ".join(refused.stderr.split())
    assert refused.exit_code == 2
    place = pathlib.Path(re.search(r"put it at (\S+)\.$", message)[1])  # pyright: ignore[reportOptionalSubscript]
    place.parent.mkdir(parents=True)
    shutil.copy(archive / TILE / f"{TILE}.tif", place)
    refused = run(f"dem {AREA} --offline")
    message = " ".join(refused.stderr.split())
    assert "offline, and heights above EPSG:3855 need the geoid grid us_nga_egm08_25.tif" in message
    assert "or put the file into" in message
    assert 'take --dem-datum "EPSG:5773"' in message
    assert run(f"dem {AREA} --offline --dem-datum EPSG:5773").exit_code == 0


def test_offline_level_ground_is_named_where_a_command_takes_it(home: pathlib.Path) -> None:
    prepare(pathlib.Path(), "jaxgeo locate --scene scene.toml --dem dem.tif")
    refused = run("locate --scene scene.toml --dem copernicus --pixel 1200,2400 --offline")
    assert refused.exit_code == 2
    assert " ".join(refused.stderr.split()).endswith("Without an elevation model: --ground HEIGHT, level ground, in m.")


def test_the_geoid_command_that_is_advised(
    server: Served, home: pathlib.Path, tmp_path: pathlib.Path, archive: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`jaxgeo dem --geoid EPSG:3855` puts PROJ's grid where it is found offline."""
    assert run(f"dem {AREA} --dem-datum EPSG:5773 {mirror(server)}").exit_code == 0
    refused = run(f"dem {AREA} --offline")
    advised = re.search(r"`(jaxgeo dem --geoid \S+)`", " ".join(refused.stderr.split()))
    assert advised is not None, refused.stderr
    folder = tmp_path / "proj"
    folder.mkdir()
    monkeypatch.setattr("jaxgeo.io.archives.geoid_window.get_user_data_dir", lambda create=False: str(folder))
    monkeypatch.setattr("jaxgeo.io.archives.geoid_window.append_data_dir", lambda path: None)
    done = run(f"{advised[1].removeprefix('jaxgeo ')} {mirror(server)}")
    assert done.exit_code == 0, done.stderr
    assert (folder / "us_nga_egm08_25.tif").read_bytes() == (archive / "us_nga_egm08_25.tif").read_bytes()


def test_an_unreachable_archive_is_read_by_the_options_that_are_advised(
    server: Served, home: pathlib.Path, archive: pathlib.Path
) -> None:
    refused = run(f"dem {AREA} --mirror http://127.0.0.1:9")
    message = " ".join(refused.stderr.split())
    assert refused.exit_code == 2
    assert "it cannot be reached" in message
    assert "Try again, name a --proxy or a --mirror, or download it elsewhere and put it at" in message
    assert "=" not in re.sub(r"https?://\S+", "", message)
    assert run(f"dem {AREA} {mirror(server)}").exit_code == 0
    assert run(f"dem --bounds -84.7,36.3,-84.69,36.31 --mirror {archive} --dem-datum EPSG:5773").exit_code == 0


def test_environment_variables_instead_of_options(
    server: Served, home: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAXGEO_DEM_MIRROR", f"copernicus={server.url} proj={server.url}")
    monkeypatch.setenv("JAXGEO_DEM_CACHE", str(tmp_path / "elsewhere"))
    assert run(f"dem {AREA}").exit_code == 0
    assert (tmp_path / "elsewhere" / "objects").is_dir()
    monkeypatch.setenv("JAXGEO_OFFLINE", "1")
    count = len(server.asked)
    assert run(f"dem {AREA}").exit_code == 0
    assert "or JAXGEO_OFFLINE" in run("dem 36.9,-84.9 --radius 10").stderr
    assert len(server.asked) == count
    monkeypatch.setenv("JAXGEO_HTTP_TIMEOUT", "soon")
    assert "JAXGEO_HTTP_TIMEOUT=soon: expected a number of seconds above 0." in run(f"dem {AREA}").stderr


def test_without_a_name_of_an_archive_no_network_is_used(
    server: Served, home: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An environment that names a mirror asks for nothing: only --dem or `jaxgeo dem` does."""
    monkeypatch.setenv("JAXGEO_DEM_MIRROR", server.url)
    prepare(pathlib.Path(), "jaxgeo point --scene scene.toml --dem dem.tif")
    run("point --scene scene.toml --target 10,10,500 --dem dem.tif")
    run("dem")
    assert not server.asked

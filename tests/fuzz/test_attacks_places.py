"""Files that name other places: refused in a line, with no request to a server and no byte of a file elsewhere.

The server is real, since what GDAL does is out of sight of Python; that it counts is shown by GDAL without our checks.
"""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import re
import shlex
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rasterio
from support.attacks_places import (
    ATTACKS,
    CRS_ATTACKS,
    CRS_WITH_FILES,
    POSTS,
    Requests,
    band_of,
    counted_requests,
    named,
    vrt_of,
    wcs,
    wms,
)
from support.command_runner import CliRunner
from support.rasters import write

from jaxgeo import io
from jaxgeo.cli import app
from jaxgeo.demo import scene_file
from jaxgeo.io import DemError, ImageError, acquisitions, open_dem, read_dem, read_image, read_orthoimage
from jaxgeo.io._proj import DATA
from jaxgeo.io.acquisitions._rtklib import read_solutions
from jaxgeo.io.acquisitions.transport_stream import read_transport_stream
from jaxgeo.io.paths import files_behind
from jaxgeo.io.scene import read_camera, read_scene
from jaxgeo.io.tables import read_shots


def _dem(path: Any, **options: Any) -> Any:
    return read_dem(path, vertical_datum="ellipsoid", **options)


RASTERS: dict[str, Callable[..., Any]] = {
    "dem": _dem,
    "dem on disk": lambda path: open_dem(path, vertical_datum="ellipsoid").highest,
    "image": read_image,
    "orthoimage": read_orthoimage,
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Requests]:
    with counted_requests(tmp_path_factory.mktemp("served")) as found:
        yield found


@pytest.fixture(scope="module")
def secret(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return write(tmp_path_factory.mktemp("elsewhere") / "secret.tif", POSTS)


def test_the_server_counts_what_gdal_asks_it_for(tmp_path: pathlib.Path, server: Requests) -> None:
    (tmp_path / "dem.tif").write_text(wcs(server.address))
    with pytest.raises(rasterio.RasterioIOError):
        rasterio.open(tmp_path / "dem.tif")
    assert len(server.taken()) >= 1


@pytest.mark.parametrize("attack", ATTACKS)
def test_nothing_is_asked_of_a_server_or_taken_from_elsewhere(
    tmp_path: pathlib.Path, server: Requests, secret: pathlib.Path, attack: str
) -> None:
    path = tmp_path / ATTACKS[attack](tmp_path, server.address, secret)
    for read in RASTERS.values():
        with pytest.raises((DemError, ImageError)) as told:
            read(path)
        assert str(tmp_path) in str(told.value)
        assert "\n" not in str(told.value)
    assert files_behind(path) == [str(path)]
    assert server.taken() == []
    assert not pathlib.Path(f"{secret}.touched").exists()


def test_nor_from_a_folder_of_tiles(tmp_path: pathlib.Path, server: Requests) -> None:
    write(tmp_path / "a.tif", POSTS)
    (tmp_path / "b.tif").write_text(wms(server.address))
    for read in (_dem, RASTERS["dem on disk"]):
        with pytest.raises(DemError, match=r"b\.tif: this is of a kind of GDAL's \(WMS\)"):
            read(tmp_path)
    assert server.taken() == []


@pytest.mark.parametrize("attack", CRS_ATTACKS)
def test_no_file_is_opened_that_a_crs_names(tmp_path: pathlib.Path, secret: pathlib.Path, attack: str) -> None:
    path = tmp_path / CRS_ATTACKS[attack](tmp_path, "", secret)
    for name in ("dem", "dem on disk", "orthoimage"):
        with pytest.raises((DemError, ImageError), match=f"names the file {secret}"):
            RASTERS[name](path)


def test_nor_that_tables_and_documents_name_in_theirs(tmp_path: pathlib.Path, secret: pathlib.Path) -> None:
    text = CRS_WITH_FILES["pipeline"].replace("SECRET", str(secret))
    control = tmp_path / "gcp_list.txt"
    control.write_text(f"+proj=utm +zone=32 +ellps=intl +nadgrids={secret} +units=m\n1 2 3 4 5 a.jpg\n")
    exterior = tmp_path / "exterior.geojson"
    exterior.write_text(json.dumps({"type": "FeatureCollection", "world_crs": text, "features": []}))
    interior = tmp_path / "interior.yaml"
    interior.write_text("one: {type: pinhole, im_size: [40, 30], focal_len: 1.0, sensor_size: [1.0, 0.75]}\n")
    named = f"names the file {secret}"
    with pytest.raises(ValueError, match=named):
        io.read_gcp_list(control, height_datum="ellipsoid")
    with pytest.raises(ValueError, match=named):
        io.read_acquisition(exterior, interior=interior)


NAMES = (
    "{0}/a.tif", "/vsicurl/{0}/a.tif", "/vsizip/x.zip/a.tif", "/vsimem/a.tif", "/vsistdin/", "WMS:{0}/?LAYERS=a",
    "WCS:{0}/", "PG:host=127.0.0.1", "<GDAL_WMS/>", "vrt:///vsicurl/{0}/a.tif", "NETCDF:{0}/a.nc:z", "s3://bucket/a.tif",
    "zip://x.zip!a.tif", "PLMosaic:key", "GTIFF_DIR:1:/vsicurl/{0}/a.tif",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_names_that_only_gdal_resolves_need_an_option(server: Requests, name: str) -> None:
    name = name.format(server.address)
    for read in RASTERS.values():
        with pytest.raises((DemError, ImageError, FileNotFoundError)) as told:
            read(name)
        if not isinstance(told.value, FileNotFoundError):
            assert "allow_remote=True" in str(told.value)
    assert server.taken() == []


def test_a_file_named_as_gdal_names_places_is_a_file(
    tmp_path: pathlib.Path, server: Requests, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GDAL is never given the bare name of a file in the current folder."""
    monkeypatch.chdir(tmp_path)
    write(pathlib.Path("a.tif"), POSTS)
    os.rename("a.tif", "WMS:a.tif")
    np.testing.assert_allclose(np.asarray(_dem("WMS:a.tif").posts), POSTS)
    assert server.taken() == []


@pytest.mark.parametrize("kind", ["SimpleSource", "raw"])
def test_files_elsewhere_are_read_by_the_option_that_is_told(
    tmp_path: pathlib.Path, secret: pathlib.Path, kind: str
) -> None:
    path = tmp_path / "dem.vrt"
    if kind == "raw":
        (tmp_path / "raw").mkdir()
        (tmp_path / "raw" / "posts").write_bytes(POSTS.astype("<f8").tobytes())
        (tmp_path / "a").mkdir()
        path = tmp_path / "a" / "dem.vrt"
        path.write_text(
            vrt_of(
                f'<VRTRasterBand dataType="Float64" band="1" subClass="VRTRawRasterBand">{named("../raw/posts", 1)}'
                "<ByteOrder>LSB</ByteOrder></VRTRasterBand>"
            )
        )
    else:
        path.write_text(vrt_of(band_of(named(secret))))
    with pytest.raises(DemError, match="allow_outside=True"):
        _dem(path)
    np.testing.assert_allclose(np.asarray(_dem(path, allow_outside=True).posts), POSTS)


def test_a_url_is_read_by_the_option_that_is_told(server: Requests) -> None:
    write(server.folder / "dem.tif", POSTS)
    with pytest.raises(DemError, match="allow_remote=True"):
        _dem(f"{server.address}/dem.tif")
    assert server.taken() == []
    np.testing.assert_allclose(np.asarray(_dem(f"{server.address}/dem.tif", allow_remote=True).posts), POSTS)
    assert server.taken()


def test_a_vrt_from_a_server_takes_nothing_from_this_machine(server: Requests, secret: pathlib.Path) -> None:
    (server.folder / "dem.vrt").write_text(vrt_of(band_of(named(secret))))
    with pytest.raises(DemError, match="does not lie in the folder of the VRT"):
        _dem(f"{server.address}/dem.vrt", allow_remote=True)


def _raised(found: Any) -> None:
    """The error of the only file, that could not be read."""
    (one,) = found.unread
    raise one.error


def _beside(path: pathlib.Path, name: str, content: bytes) -> pathlib.Path:
    made = path.with_name(name)
    made.write_bytes(content)
    return made


SBET = np.array([[0.02 * k, 0.8, 0.1, 900.0, *[0.0] * 13] for k in range(8)], "<f8").tobytes()
READERS: dict[str, Callable[[pathlib.Path], Any]] = {
    **RASTERS,
    "geoid grid": lambda path: read_dem(DATA / "jacksboro.tif", vertical_datum=path, bounds=(-84.3, 36.3, -84.2, 36.4)),
    "bounds of a dem": lambda path: open_dem(DATA / "jacksboro.tif", cache=path),
    "exposures": io.read_acquisition,
    "several exposures": lambda path: _raised(io.read_acquisitions(path)),
    "positions": lambda path: io.read_acquisition(_beside(path, "a.jpg", b"\xff\xd8\xff\xe0"), positions=path),
    "drone image": acquisitions.read_drone_images,
    "interior parameters": acquisitions.read_orthority_cameras,
    "SBET": acquisitions.read_sbet,
    "smrmsg": lambda path: io.read_acquisition(_beside(path, "a.sbet", SBET), errors=path),
    "telemetry": acquisitions.read_telemetry,
    "transport stream": read_transport_stream,
    "subtitles": acquisitions.read_dji_subtitles,
    "flight log": acquisitions.read_airdata,
    "flight log of Litchi": lambda path: acquisitions.read_litchi(path, takeoff_height=0.0),
    "flight log of Flight Reader": acquisitions.read_flight_reader,
    "flight log of ArduPilot": lambda path: acquisitions.read_ardupilot(path, takeoff_height=0.0),
    "flight log of PX4": acquisitions.read_px4,
    "model of COLMAP": lambda path: acquisitions.read_colmap(path, crs="EPSG:4978", height_datum=0.0),
    "orientation of MicMac": lambda path: acquisitions.read_micmac(path, crs="EPSG:4978", height_datum=0.0),
    "camera parameters of Pix4D": lambda path: acquisitions.read_pix4d(path, crs="EPSG:4978", height_datum=0.0),
    "solutions of RTKLIB": read_solutions,
    "cameras of Metashape": acquisitions.read_metashape_cameras,
    "BAL": io.read_bal,
    "ground control": lambda path: io.read_gcp_list(path, height_datum="ellipsoid"),
    "image points": io.read_image_points,
    "navigation": lambda path: io.read_navigation(path, height_datum="ellipsoid"),
    "reconstruction": lambda path: io.read_opensfm(path, height_datum=20.0),
    "cameras of OpenSfM": io.read_opensfm_cameras,
    "orientations": lambda path: io.read_orientations(path, height_datum="ellipsoid"),
    "shots": lambda path: read_shots(path, ()),
    "scene": read_scene,
    "camera": read_camera,
}


@contextlib.contextmanager
def within(seconds: int) -> Iterator[None]:
    """Ends the test where it hangs."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"still at it after {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


posix = pytest.mark.skipif(sys.platform == "win32", reason="has no such files")


@posix
@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "link to a pipe"])
@pytest.mark.parametrize("reader", READERS)
def test_pipes_sockets_and_devices_are_refused_at_once(tmp_path: pathlib.Path, reader: str, kind: str) -> None:
    path = tmp_path / ("special.gtx" if reader == "geoid grid" else "special")
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(str(path))
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to(tmp_path / "pipe")
    said = f"{path}: this is a {kind.removeprefix('link to a ')}, not a file"
    with within(10), pytest.raises(ValueError, match=re.escape(said)):
        READERS[reader](path)


GROUND = "--dem {dem} --dem-bounds=-84.3,36.3,-84.2,36.4"
COMMANDS = (
    "inspect SPECIAL",
    "inspect {jpg} --positions SPECIAL",
    "inspect {sbet} --errors SPECIAL",
    "inspect {geojson} --interior SPECIAL",
    "inspect {table} --camera SPECIAL.toml",
    "locate SPECIAL --ground 300",
    "locate --scene SPECIAL --ground 300",
    "locate --scene {scene} --ground 300 --shots SPECIAL",
    "locate --scene {scene} --dem SPECIAL",
    "locate --scene {scene} --ground 300 --dem-datum SPECIAL.gtx",
    "report --scene SPECIAL --ground 300 -o {out}.html",
    "footprint --scene SPECIAL " + GROUND,
    "footprint --scene {scene} --dem SPECIAL",
    "footprint --scene {scene} --shots SPECIAL " + GROUND,
    "point --scene SPECIAL --target 36.3,-84.2 " + GROUND,
    "overlap --scene {scene} --navigation SPECIAL --times 0,1 " + GROUND,
    "overlap --scene {scene} --shots SPECIAL " + GROUND,
    "plan --scene {scene} --navigation SPECIAL --overlap 0.6 -o {out}.csv " + GROUND,
    "rectify SPECIAL --scene {scene} -o {out}.tif " + GROUND,
    "rectify {image} --like SPECIAL --scene {scene} -o {out}.tif " + GROUND,
    "register SPECIAL --reference {dem} --scene {scene} -o {out} --position-sigma 5 --attitude-sigma 1 " + GROUND,
    "register {dem} --reference SPECIAL --scene {scene} -o {out} --position-sigma 5 --attitude-sigma 1 " + GROUND,
    "study gu2017 --image SPECIAL --reference {dem} --scene {scene} " + GROUND,
)


@pytest.mark.costly
@posix
@pytest.mark.parametrize("command", COMMANDS)
def test_so_are_they_by_every_option_of_the_commands(tmp_path: pathlib.Path, command: str) -> None:
    for name in ("special", "special.toml", "special.gtx"):
        os.mkfifo(tmp_path / name)
    files = {"scene": scene_file(), "dem": DATA / "jacksboro.tif", "out": tmp_path / "out"}
    files |= {"jpg": _beside(tmp_path / "special", "a.jpg", b"\xff\xd8\xff\xe0")}
    files |= {"sbet": _beside(tmp_path / "special", "a.sbet", SBET)}
    files |= {"geojson": _beside(tmp_path / "special", "a.geojson", b'{"type": "FeatureCollection"}')}
    header = b"name,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\na.jpg,36.3,-84.2,900,0,0,0\n"
    files |= {"table": _beside(tmp_path / "special", "a.csv", header)}
    files |= {"image": write(tmp_path / "image.tif", np.ones((4800, 2400), np.uint8), compress="deflate")}
    line = command.format(**files).replace("SPECIAL", str(tmp_path / "special"))
    with within(60):
        done = CliRunner().invoke(app, shlex.split(line))
    told = " ".join(done.stderr.split())
    assert done.exit_code == 2, told
    assert re.search(r"special(\.\w+)?: this is a pipe, not a file", told), told

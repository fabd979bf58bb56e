"""Files that name other places: refused in a line, with no request to a server and no byte of a file elsewhere.

The server is real, since what GDAL does is out of sight of Python; that it counts is shown by GDAL without our checks.
"""

from __future__ import annotations

import os
import pathlib
import socket
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rasterio
from support.attacks_places import ATTACKS, POSTS, Requests, band_of, counted_requests, named, vrt_of, wcs, wms
from support.rasters import write

from jaxgeo.io import DemError, ImageError, open_dem, read_dem, read_image, read_orthoimage
from jaxgeo.io.paths import files_behind


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
        with pytest.raises(DemError, match=r"b\.tif: this is a document of GDAL's \(WMS\)"):
            read(tmp_path)
    assert server.taken() == []


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


def _pipe(path: pathlib.Path) -> None:
    os.mkfifo(path)


def _socket(path: pathlib.Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


SPECIAL: dict[str, Callable[[pathlib.Path], None]] = {
    "pipe": _pipe,
    "socket": _socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}

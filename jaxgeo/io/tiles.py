"""Raster tiles opened with rasterio: cached headers and windowed reads."""

from __future__ import annotations

import collections
import contextvars
import dataclasses
import functools
import math
import os

import numpy as np
import pyproj
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._deflate import Block, damaged_block
from jaxgeo.io._gdal import GDAL_ERRORS, refused_as
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io._rasters import open_raster
from jaxgeo.io.errors import DemError
from jaxgeo.io.reach import HERE, Reach, is_local
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.io.vrt import check_files_exist, check_on_grid, read_vrt
from jaxgeo.io.vrt_facts import inherit

_INSIDE: contextvars.ContextVar[tuple[str, ...]] = contextvars.ContextVar("VRTs that are being read", default=())
MISALIGNED = 1e-3  # cells; tiles farther than this from a common grid would need resampling
MOST_PER_TURN = 2**31  # columns in 360 degrees; no file with a spacing below 2 cm spans all longitudes
MOST_OPEN = 8  # datasets kept open at once while a mosaic is read in parts
_NOT_HEIGHTS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha, ColorInterp.palette)


@dataclasses.dataclass(frozen=True)
class Tile:
    """Header of one file. `affine` maps (col, row) of post centres, not of corners, to map coordinates."""

    path: str
    band: int
    driver: str
    shape: tuple[int, int]
    affine: Affine
    crs: pyproj.CRS
    dtype: np.dtype
    scale: float
    offset: float
    unit: str | None
    sources: tuple[str, ...] = ()
    """The source files of a VRT."""
    nodata: float | None = None
    has_mask: bool = False
    marks: tuple[float, ...] = ()
    """Stored void values besides `nodata`: those of a VRT's sources."""
    datum_field: str | None = None
    """Content of a DTED file's vertical datum field."""
    reach: Reach = HERE
    """Access permissions for opening the file."""

    @functools.cached_property
    def is_geographic(self) -> bool:
        """Whether the map coordinates are longitude and latitude."""
        return horizontal_part(self.crs).is_geographic

    @functools.cached_property
    def map_unit(self) -> float:
        """m, or rad, per unit of the map coordinates."""
        return horizontal_part(self.crs).axis_info[0].unit_conversion_factor

    @functools.cached_property
    def cols_per_turn(self) -> int | None:
        """Columns in 360 degrees of longitude, if a whole number."""
        if not self.is_geographic or self.affine.a == 0.0 or self.affine.b or self.affine.d:
            return None
        turn = 2.0 * np.pi / self.map_unit
        cols = abs(turn / self.affine.a)
        return round(cols) if cols < MOST_PER_TURN and abs(cols - round(cols)) < MISALIGNED else None


class OpenFiles:
    """Cache of the last few open datasets; close it, or use it as a context manager."""

    def __init__(self) -> None:
        self._open: collections.OrderedDict[str, DatasetReader] = collections.OrderedDict()
        self._sound: dict[str, set[Block]] = {}

    def __enter__(self) -> OpenFiles:
        return self

    def __exit__(self, *_: object) -> None:
        while self._open:
            self._open.popitem()[1].close()

    def __getitem__(self, tile: Tile) -> DatasetReader:
        if tile.path not in self._open:
            if len(self._open) >= MOST_OPEN:
                self._open.popitem(last=False)[1].close()
            self._open[tile.path] = _opened(tile.path, tile.reach)
        self._open.move_to_end(tile.path)
        return self._open[tile.path]

    def sound_blocks(self, tile: Tile) -> set[Block]:
        """The compressed blocks of a file whose checksums have been verified."""
        return self._sound.setdefault(tile.path, set())


def read_header(path: str, band: int, reach: Reach = HERE) -> Tile:
    """The header of a raster file, cached until the file's time or size changes. Raises as `read_dem` does."""
    return _header(path, band, reach, stamp_of(path))


def stamp_of(path: str) -> tuple[int, int] | None:
    """Modification time in ns and size of a plain file; None for anything else that GDAL opens."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size


def read_tile(tile: Tile, window: Window, files: OpenFiles) -> tuple[np.ndarray, np.ndarray]:
    """Values as stored, without scale and offset, and voids, of a window of one file. Raises `DemError` if damaged."""
    data = files[tile]
    with refused_as(DemError, tile.path, f"rows {window.row_off} to {window.row_off + window.height}"):
        damaged = damaged_block(data, (tile.band,), window, files.sound_blocks(tile))
        if damaged:
            raise DemError(f"{tile.path}: the file is damaged: {damaged}.")
        values = data.read(tile.band, window=window)
        unknown = data.read_masks(tile.band, window=window) == 0
        if ColorInterp.alpha in data.colorinterp:  # GDAL's mask uses it for 8- and 16-bit files only
            unknown |= data.read(data.colorinterp.index(ColorInterp.alpha) + 1, window=window) == 0
    for mark in tile.marks:
        unknown |= values == mark
    if values.dtype.kind == "f":
        unknown |= ~np.isfinite(values)
        values = np.where(unknown & ~np.isfinite(values), 0.0, values).astype(values.dtype)
    return values, unknown


def _opened(path: str, reach: Reach) -> DatasetReader:
    """Open a dataset; GDAL is configured to keep the vertical part of a GeoTIFF's CRS."""
    return open_raster(path, reach, DemError, "a raster")


@functools.lru_cache(maxsize=65_536)
def _header(path: str, band: int, reach: Reach, stamp: tuple[int, int] | None) -> Tile:
    del stamp  # only part of the cache key: a changed time or size means a changed file
    with _opened(path, reach) as data, refused_as(DemError, path, "its header"):
        if not 1 <= band <= data.count:
            lack = f"{path}: there is no band {band}; the file has {data.count}"
            if _INSIDE.get():  # the source of a VRT, whose author named the band
                raise DemError(f"{lack}. {_INSIDE.get()[-1]} asks for it; make that VRT anew.")
            raise DemError(f"{lack}. Pass {'band=1' if data.count == 1 else f'one from band=1 to band={data.count}'}.")
        _check_holds_heights(path, data, band)
        _check_georeferenced(path, data)
        if data.crs is None:
            raise DemError(
                f"{path}: the file names no coordinate reference system, so nobody knows where it lies. "
                f"Write one into it, e.g. gdal_edit -a_srs EPSG:4326 {path}."
            )
        tile = Tile(
            path=path,
            band=band,
            driver=data.driver,
            shape=data.shape,
            affine=_centred(data.transform),
            crs=_crs(path, data, reach),
            dtype=np.dtype(data.dtypes[band - 1]),
            scale=data.scales[band - 1],
            offset=data.offsets[band - 1],
            unit=data.units[band - 1] or None,
            nodata=data.nodatavals[band - 1],
            has_mask=_has_mask(data, band),
            datum_field=data.tags().get("DTED_VerticalDatum", "").strip() or None,
            reach=reach,
        )
        _check_scale(tile)
        xml = data.tags(ns="xml:VRT").get("xml:VRT", "") if data.driver == "VRT" else ""
    return _with_sources(tile, xml) if xml else tile


def _check_scale(tile: Tile) -> None:
    """Raises `DemError` if the file's scale and offset give every post the same height, or none."""
    if math.isfinite(tile.scale) and math.isfinite(tile.offset) and tile.scale != 0.0:
        return
    raise DemError(
        f"{tile.path}: scale {tile.scale:g} and offset {tile.offset:g} of its heights make all equal or undefined. "
        f"Set the right values, e.g. gdal_edit -scale 1 -offset 0 {tile.path}."
    )


def _with_sources(tile: Tile, xml: str) -> Tile:
    """The header of a VRT completed from its sources. Raises `DemError` if they are not on its grid or differ."""
    vrt = read_vrt(tile.path, xml, tile.band)
    if vrt is None:
        return tile
    check_files_exist(tile.path, vrt)
    inside = (*_INSIDE.get(), os.path.realpath(tile.path))
    for source in vrt.sources:
        if os.path.realpath(source.file) in inside:
            raise DemError(f"{tile.path}: this VRT has itself among its sources ({source.file}); make it anew.")
    token = _INSIDE.set(inside)
    try:
        headers = [read_header(source.file, source.band, tile.reach) for source in vrt.sources]
    finally:
        _INSIDE.reset(token)
    for source, header in zip(vrt.sources, headers, strict=True):
        check_on_grid(tile.path, vrt, source, header.shape)
    behind = [file for header in headers for file in (header.path, *header.sources) if is_local(file)]
    return inherit(dataclasses.replace(tile, sources=tuple(dict.fromkeys(behind))), vrt, headers)


def _has_mask(data: DatasetReader, band: int) -> bool:
    flags = data.mask_flag_enums[band - 1]
    return MaskFlags.per_dataset in flags or ColorInterp.alpha in data.colorinterp


def _centred(corner: Affine) -> Affine:
    """The transform of post centres from that of corners, which is what GDAL gives for area and for point files."""
    a, b, c, d, e, f = corner[:6]
    return Affine(a, b, c + (a + b) / 2.0, d, e, f + (d + e) / 2.0)


_known_crs = functools.lru_cache(maxsize=256)(known_crs)


def _crs(path: str, data: DatasetReader, reach: Reach) -> pyproj.CRS:
    try:
        crs = _known_crs(data.crs.to_wkt())
    except (*UNKNOWN_CRS, *GDAL_ERRORS) as error:
        raise DemError(f"{path}: PROJ does not understand the file's coordinate reference system: {error}") from error
    if not reach.outside:
        check_crs(path, crs, DemError)
    flat = horizontal_part(crs)
    if not (flat.is_geographic or flat.is_projected):
        raise DemError(f"{path}: {crs.name!r} ({crs.type_name}) does not say where on the Earth the file lies.")
    return crs


def _check_holds_heights(path: str, data: DatasetReader, band: int) -> None:
    dtype, colour = data.dtypes[band - 1], data.colorinterp[band - 1]
    if "complex" in dtype:
        raise DemError(f"{path}: band {band} holds complex numbers ({dtype}), not heights.")
    if colour in _NOT_HEIGHTS:
        raise DemError(f"{path}: band {band} is the {colour.name} channel of a picture, not heights.")
    if min(data.shape) < 2:
        raise DemError(f"{path}: {data.height} x {data.width} posts make no surface; at least 2 x 2 are needed.")


def _check_georeferenced(path: str, data: DatasetReader) -> None:
    t = data.transform
    if t.is_identity:
        how = "ground control points" if data.gcps[0] else "rational polynomials" if data.rpcs else None
        reason = f"it is placed by {how} only" if how else "it has no geotransform"
        raise DemError(f"{path}: the file's rows and columns are on no map: {reason}. Warp it first (gdalwarp).")
    if not np.isfinite(t.determinant) or t.is_degenerate:
        raise DemError(f"{path}: the geotransform {tuple(t)[:6]} squeezes the raster into a line.")

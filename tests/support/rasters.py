"""Small rasters for the tests of the readers."""

from __future__ import annotations

import pathlib
import struct
from typing import Any

import numpy as np
import pyproj
import rasterio
from rasterio.transform import Affine

DEGREE = 1.0 / 1200.0


def hills(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    """Smooth synthetic heights between about 100 and 900 m."""
    rng = np.random.default_rng(seed)
    row, col = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    heights = np.full(shape, 500.0)
    for _ in range(6):
        a, b, phase = rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(0, 6.28)
        heights += 60.0 * np.sin(a * row + b * col + phase)
    return heights


def write(
    path: pathlib.Path,
    heights: np.ndarray,
    *,
    crs: Any = "EPSG:4326",
    affine: Affine | None = Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0),
    point: bool = False,
    unit: str | None = None,
    scale: float | None = None,
    offset: float | None = None,
    mask: np.ndarray | None = None,
    **profile: Any,
) -> pathlib.Path:
    """A GeoTIFF of (rows, cols) or (bands, rows, cols) heights; `affine` maps corners, as in GDAL."""
    bands = heights if heights.ndim == 3 else heights[None]
    made = {
        "driver": "GTiff",
        "dtype": bands.dtype,
        "count": bands.shape[0],
        "height": bands.shape[1],
        "width": bands.shape[2],
        "crs": crs,
    }
    if affine is not None:
        made["transform"] = affine
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "w", **made | profile) as sink:
        if point:
            sink.update_tags(AREA_OR_POINT="Point")
        if unit is not None:
            sink.units = (unit,) * bands.shape[0]
        if scale is not None:  # before any value: GDAL loses it afterwards if the CRS has a vertical part
            sink.scales = (scale,) * bands.shape[0]
        if offset is not None:
            sink.offsets = (offset,) * bands.shape[0]
        sink.write(bands)
        if mask is not None:
            sink.write_mask(mask)
    return path


def gdalbuildvrt(path: pathlib.Path, tiles: list[pathlib.Path]) -> pathlib.Path:
    """A VRT over files as written by `gdalbuildvrt`: without units, scales and vertical CRS."""
    found, nodata, crs = [], None, None
    for tile in tiles:
        with rasterio.open(tile) as data:
            found.append((tile, data.shape, data.transform, data.dtypes[0]))
            nodata, crs = data.nodata, data.crs
    assert crs is not None
    step = found[0][2]
    west, north = min(t.c for _, _, t, _ in found), max(t.f for _, _, t, _ in found)
    sources, right, bottom = [], 0, 0
    for tile, (rows, cols), t, _ in found:
        x, y = round((t.c - west) / step.a), round((t.f - north) / step.e)
        right, bottom = max(right, x + cols), max(bottom, y + rows)
        size = f'xSize="{cols}" ySize="{rows}"'
        rects = f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="{x}" yOff="{y}" {size}/>'
        name = f'<SourceFilename relativeToVRT="1">{tile.relative_to(path.parent)}</SourceFilename>'
        tag = "" if nodata is None else f"<NODATA>{nodata:.9g}</NODATA>"
        kind = "SimpleSource" if nodata is None else "ComplexSource"
        sources.append(f"<{kind}>{name}<SourceBand>1</SourceBand>{rects}{tag}</{kind}>")
    kinds = {"int16": "Int16", "uint16": "UInt16", "int32": "Int32", "float32": "Float32", "float64": "Float64"}
    tag = "" if nodata is None else f"<NoDataValue>{nodata:.9g}</NoDataValue>"
    flat = pyproj.CRS.from_wkt(crs.to_wkt())
    flat = flat.sub_crs_list[0] if flat.is_compound else flat.to_2d()
    srs = flat.to_wkt("WKT1_GDAL").replace('"', "&quot;")
    path.write_text(
        f'<VRTDataset rasterXSize="{right}" rasterYSize="{bottom}"><SRS>{srs}</SRS>'
        f"<GeoTransform>{west!r}, {step.a!r}, 0, {north!r}, 0, {step.e!r}</GeoTransform>"
        f'<VRTRasterBand dataType="{kinds[found[0][3]]}" band="1">{tag}{"".join(sources)}</VRTRasterBand></VRTDataset>'
    )
    return path


def lose_tag(path: pathlib.Path, tag: int) -> None:
    """Let a tag of a (little-endian, classic) TIFF lie behind the end of the file."""
    content = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, first)
    entries = [first + 2 + 12 * k for k in range(count)]
    (found,) = [at for at in entries if struct.unpack_from("<H", content, at)[0] == tag]
    struct.pack_into("<I", content, found + 8, len(content) + 1000)
    path.write_bytes(content)

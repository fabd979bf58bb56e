"""Mosaic of aligned rasters as a VRT, GDAL's XML file of rasters that read from others."""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from jaxgeo._partial import partial_file
from jaxgeo.io.map_raster import MapRaster

BLOCK = "512"  # cells on a side of the blocks of a COG
TYPES = {"uint8": "Byte", "uint16": "UInt16", "uint32": "UInt32", "uint64": "UInt64"}  # others are capitalised
ALIGNED = 1e-3  # cells: largest offset of rasters that share their cells


@dataclasses.dataclass(frozen=True)
class MosaicFile:
    """A file of a mosaic: its path relative to the VRT, and its raster."""

    path: str
    raster: MapRaster


@dataclasses.dataclass(frozen=True)
class Bands:
    """Bands of all files of a mosaic.

    - `dtype`: that of the values; `nodata` the value of unknown cells, or None if the files have a mask instead.
    - `names`, and `units`: of each band, or empty.
    """

    count: int
    dtype: str
    nodata: float | None = None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @property
    def colours(self) -> tuple[str, ...]:
        """Interpretation of the bands, as `OrthoWriter` and `write_accuracy_map` write them."""
        return ("Red", "Green", "Blue") if self.count == 3 and self.dtype in ("uint8", "uint16") else ("Gray",)


def write_vrt(
    path: str | os.PathLike[str], files: Sequence[MosaicFile], bands: Bands, tags: Mapping[str, str] | None = None
) -> None:
    """Write a VRT of files with the same bands and aligned cells; where they overlap, the later known value counts.

    The file appears only when complete. Raises `ValueError` for no files, and for another CRS or cells that are not
    aligned.
    """
    target = pathlib.Path(path)
    if not files:
        raise ValueError(f"{target}: a mosaic needs one or more files.")
    whole, corners = _placed(target, files)
    root = Element("VRTDataset", rasterXSize=f"{whole.shape[1]}", rasterYSize=f"{whole.shape[0]}")
    _add(root, "SRS", whole.crs.to_wkt())
    a, b, c, d, e, f = whole.transform[:6]
    _add(root, "GeoTransform", ", ".join(repr(float(x)) for x in (c, a, b, f, d, e)))
    metadata = SubElement(root, "Metadata")
    for key, value in {"AREA_OR_POINT": "Area", **(tags or {})}.items():
        _add(metadata, "MDI", value, key=key)
    placed = list(zip(files, corners, strict=True))
    for number in range(1, bands.count + 1):
        _add_band(root, number, bands, placed)
    if bands.nodata is None:
        band = SubElement(
            SubElement(root, "MaskBand"), "VRTRasterBand", dataType="Byte", blockXSize=BLOCK, blockYSize=BLOCK
        )
        for file, corner in placed:
            _add_source(band, "mask,1", Bands(1, "uint8"), file, corner)
    ElementTree.indent(root, " ")
    with partial_file(target) as partial:
        ElementTree.ElementTree(root).write(partial, encoding="utf-8")
        os.replace(partial, target)


def _placed(target: pathlib.Path, files: Sequence[MosaicFile]) -> tuple[MapRaster, list[tuple[int, int]]]:
    """The raster that holds all files, and the (row, col) of the first cell of each."""
    first = files[0].raster
    off = np.array([first.rowcol(one.raster.transform.c, one.raster.transform.f) for one in files])
    starts = np.rint(off).astype(int)
    is_off = np.abs(off - starts).max(axis=1) > ALIGNED
    for one, is_beside in zip(files, is_off, strict=True):
        if is_beside or one.raster.crs != first.crs or _steps(one.raster) != _steps(first):
            raise ValueError(
                f"{target}: the cells of {one.path} are not aligned with those of {files[0].path}; make all files of "
                f"a mosaic with one crs and one resolution."
            )
    row, col = starts.min(axis=0).tolist()
    rows, cols = (starts + np.array([one.raster.shape for one in files])).max(axis=0).tolist()
    return first.part(row, col, (rows - row, cols - col)), [(r - row, c - col) for r, c in starts.tolist()]


def _steps(raster: MapRaster) -> tuple[float, ...]:
    a, b, _, d, e, _ = raster.transform[:6]
    return a, b, d, e


def _add_band(root: Element, number: int, bands: Bands, placed: Sequence[tuple[MosaicFile, tuple[int, int]]]) -> None:
    band = SubElement(
        root, "VRTRasterBand", dataType=_gdal(bands.dtype), band=f"{number}", blockXSize=BLOCK, blockYSize=BLOCK
    )
    if bands.names:
        _add(band, "Description", bands.names[number - 1])
    if bands.units and bands.units[number - 1]:
        _add(band, "UnitType", bands.units[number - 1])
    if bands.nodata is not None:
        _add(band, "NoDataValue", _number(bands.nodata))
    _add(band, "ColorInterp", bands.colours[min(number, len(bands.colours)) - 1] if number <= 3 else "Undefined")
    for file, corner in placed:
        _add_source(band, f"{number}", bands, file, corner)


def _add_source(band: Element, number: str, bands: Bands, file: MosaicFile, corner: tuple[int, int]) -> None:
    rows, cols = file.raster.shape
    source = SubElement(band, "ComplexSource")
    _add(source, "SourceFilename", file.path, relativeToVRT="1")
    _add(source, "SourceBand", number)
    SubElement(
        source,
        "SourceProperties",
        RasterXSize=f"{cols}",
        RasterYSize=f"{rows}",
        DataType=_gdal(bands.dtype),
        BlockXSize=BLOCK,
        BlockYSize=BLOCK,
    )
    SubElement(source, "SrcRect", xOff="0", yOff="0", xSize=f"{cols}", ySize=f"{rows}")
    SubElement(source, "DstRect", xOff=f"{corner[1]}", yOff=f"{corner[0]}", xSize=f"{cols}", ySize=f"{rows}")
    if bands.nodata is None:
        _add(source, "UseMaskBand", "true")
    else:
        _add(source, "NODATA", _number(bands.nodata))


def _add(parent: Element, tag: str, text: str, **attributes: Any) -> None:
    SubElement(parent, tag, attributes).text = text


def _gdal(dtype: str) -> str:
    """GDAL's name of a type."""
    return TYPES.get(dtype, dtype.capitalize())


def _number(value: float) -> str:
    return "nan" if math.isnan(value) else f"{value:.17g}"

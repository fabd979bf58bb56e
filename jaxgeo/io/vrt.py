"""VRT parser: source files, and whether they are placed on the VRT's grid without resampling."""

from __future__ import annotations

import dataclasses
import math
import os
from xml.etree import ElementTree

import numpy as np

from jaxgeo.io.errors import DemError
from jaxgeo.io.reach import is_local

OFF_GRID = 1e-3  # posts; a source with a larger offset would be resampled
MOST_CELLS = 100_000_000  # of a lattice for comparing rectangles
NAME_TILES = "Name the files that it is put together from (or their folder) in its place"
_MOSAIC = {None, "VRTRasterBand", "VRTSourcedRasterBand"}
_COPYING = ("SimpleSource", "ComplexSource", "NoDataFromMaskSource")
_ALTERING = ("LUT", "ColorTableComponent", "Exponent", "SrcMin", "DstMin")


@dataclasses.dataclass(frozen=True)
class VrtSource:
    """One source of a band: `taken` and `put` are (column, row, columns, rows) in the source and in the VRT.

    None stands for the whole. `scaling` is (ratio, offset) applied to its values, `nodata` the value that
    is skipped.
    """

    file: str
    band: int
    taken: tuple[float, ...] | None
    put: tuple[float, ...] | None
    scaling: tuple[float, float] | None
    nodata: float | None
    uses_mask: bool


@dataclasses.dataclass(frozen=True)
class VrtBand:
    """One band of a VRT as the VRT states it; `shape` is (rows, cols) of the VRT, `sources` at least one."""

    shape: tuple[int, int]
    sources: tuple[VrtSource, ...]
    states_scale: bool

    @property
    def local_files(self) -> tuple[str, ...]:
        """The source files in the file system, without repetition."""
        return tuple(dict.fromkeys(source.file for source in self.sources if is_local(source.file)))


def read_vrt(path: str, xml: str, band: int) -> VrtBand | None:
    """Parse one band of a VRT from GDAL's XML; None for raw values, which have no source.

    Raises `DemError` if heights are computed or resampled on reading.

    GDAL would fail only at the first read of a missing source, and would silently shift the posts of an off-grid
    source to the nearest: both are refused. Where sources overlap, GDAL uses the last in the VRT.
    """
    root = ElementTree.fromstring(xml)
    if root.get("subClass") is not None:
        raise DemError(
            f"{path}: this VRT ({root.get('subClass')}) resamples as it is read: GDAL moves its posts to the nearest, "
            f"or between them. {NAME_TILES}, or write it to a file first, with a method of your choice "
            f"(gdalwarp -r bilinear)."
        )
    shape = tuple(int(_number(path, key, root.get(key, "0"))) for key in ("rasterYSize", "rasterXSize"))
    element = next((found for found in root.findall("VRTRasterBand") if found.get("band", "1") == str(band)), None)
    if element is None or element.get("subClass") == "VRTRawRasterBand":
        return None
    _check_copies(path, band, element)
    folder = os.path.dirname(os.path.realpath(path) if os.path.islink(path) else path)  # as in GDAL
    found = tuple(_source(path, one, folder) for one in element if one.tag in _COPYING)
    if not found:
        raise DemError(f"{path}: band {band} of this VRT has no source, so that it holds no heights.")
    return VrtBand((shape[0], shape[1]), found, element.find("Scale") is not None or element.find("Offset") is not None)


def check_files_exist(path: str, sources: VrtBand) -> None:
    """Raises `DemError` if a source file of a VRT is missing."""
    missing = [file for file in sources.local_files if not os.path.exists(file)]
    if missing:
        count = len({source.file for source in sources.sources})
        raise DemError(
            f"{path}: {len(missing)} of the {count} files that it is put together from do not exist, the first "
            f"is {missing[0]}. Bring them back, or write the VRT anew without them (gdalbuildvrt)."
        )


def check_on_grid(path: str, vrt: VrtBand, source: VrtSource, shape: tuple[int, int]) -> None:
    """Raises `DemError` if GDAL would resample a source of `shape` (rows, cols)."""
    x0, y0, w0, h0 = source.taken or (0.0, 0.0, float(shape[1]), float(shape[0]))
    x1, y1, w1, h1 = source.put or (0.0, 0.0, float(vrt.shape[1]), float(vrt.shape[0]))
    stretch = max(abs(w1 - w0), abs(h1 - h0))
    shift = max(abs(off - round(off)) for off in (x1 - x0, y1 - y0))
    if not (stretch <= OFF_GRID and shift <= OFF_GRID):
        raise DemError(
            f"{path}: its source {source.file} is not on the grid of the VRT ({w0:.9g} x {h0:.9g} posts become "
            f"{w1:.9g} x {h1:.9g}, from row {y1:.9g}, column {x1:.9g}): GDAL would resample it as it is read. Warp the "
            f"source to the common grid first (gdalwarp -r bilinear)."
        )


def holes(vrt: VrtBand) -> bool:
    """Whether some posts of a VRT are outside all sources: without a nodata value GDAL gives zero there."""
    rects = [source.put for source in vrt.sources]
    if any(rect is None for rect in rects):
        return False
    x, y, w, h = np.array(rects, dtype=float).T
    xs = np.unique(np.clip(np.round(np.concatenate([x, x + w, [0, vrt.shape[1]]])), 0, vrt.shape[1]))
    ys = np.unique(np.clip(np.round(np.concatenate([y, y + h, [0, vrt.shape[0]]])), 0, vrt.shape[0]))
    if len(xs) * len(ys) > MOST_CELLS:
        return False
    covered = np.zeros((len(ys) - 1, len(xs) - 1), bool)
    for left, top, right, bottom in np.round(np.stack([x, y, x + w, y + h], axis=1)):
        (c0, c1), (r0, r1) = np.searchsorted(xs, [left, right]), np.searchsorted(ys, [top, bottom])
        covered[r0:r1, c0:c1] = True
    return not covered.all()


def _check_copies(path: str, band: int, element: ElementTree.Element) -> None:
    """Raises `DemError` if a band holds anything but values copied or scaled from its sources."""
    kind = element.get("subClass")
    computed = kind if kind not in _MOSAIC else None
    for source in element:
        if source.tag.endswith("Source") and source.tag not in _COPYING:
            computed = source.tag
        computed = next((tag for tag in _ALTERING if source.find(tag) is not None), computed)
        if source.find("OpenOptions/OOI[@key='OVERVIEW_LEVEL']") is not None:
            computed = "OVERVIEW_LEVEL"
    if computed is not None:
        raise DemError(
            f"{path}: band {band} of this VRT is computed as it is read ({computed}), so that nothing says any more "
            f"what its heights are. {NAME_TILES}, or write it to a file that states unit and voids "
            f"(gdal_translate)."
        )


def _source(path: str, element: ElementTree.Element, folder: str) -> VrtSource:
    name, band = element.find("SourceFilename"), element.findtext("SourceBand", "1")
    file = "" if name is None or not name.text else name.text
    if name is not None and name.get("relativeToVRT") == "1":
        file = os.path.join(folder, file)
    if not (band.isdecimal() and len(band) < 10):
        raise DemError(f"{path}: it takes {band!r} of its source {file} for heights. {NAME_TILES}.")
    ratio, offset, nodata = (element.findtext(tag) for tag in ("ScaleRatio", "ScaleOffset", "NODATA"))
    scaling = None
    if ratio is not None or offset is not None:
        scaling = _number(path, "ScaleRatio", ratio or "1"), _number(path, "ScaleOffset", offset or "0")
    taken, put = (_rect(path, element.find(tag)) for tag in ("SrcRect", "DstRect"))
    uses_mask = element.findtext("UseMaskBand", "").lower() == "true" or element.tag == "NoDataFromMaskSource"
    void = None if nodata is None else _number(path, "NODATA", nodata, finite=False)
    return VrtSource(file, int(band), taken, put, scaling, void, uses_mask)


def _rect(path: str, element: ElementTree.Element | None) -> tuple[float, ...] | None:
    if element is None:
        return None
    return tuple(_number(path, key, element.get(key, "")) for key in ("xOff", "yOff", "xSize", "ySize"))


def _number(path: str, name: str, text: str, *, finite: bool = True) -> float:
    """A number in the XML of a VRT. Raises `DemError` if it is invalid, or not finite where it must be."""
    try:
        number = float(text)
        if math.isfinite(number) or not finite:
            return number
    except ValueError:
        pass
    raise DemError(f"{path}: {name} of this VRT is {text!r}, which is no number. Write it anew (gdalbuildvrt).")

"""Virtual rasters: whether the files that a VRT is put together from are there, and on its own grid."""

from __future__ import annotations

import os
import pathlib
from xml.etree import ElementTree

from jaxgeo.io.errors import DemError

OFF_GRID = 1e-3  # posts; a source farther off is resampled


def checked_sources(path: str, band: int) -> tuple[str, ...]:
    """The files behind one band of a VRT.

    GDAL would fail at the first read of a missing one, and shift the posts of one that is off the VRT's grid by up to
    half a cell in silence: both are refused with `DemError`. Where sources overlap, GDAL takes the last in the VRT.
    """
    try:
        root = ElementTree.fromstring(path if path.lstrip().startswith("<") else pathlib.Path(path).read_bytes())
    except (OSError, ElementTree.ParseError):
        return ()  # GDAL has opened it: it lies where only GDAL can read
    folder = os.path.dirname(path)
    sources = [source for found in root.findall("VRTRasterBand") if _is_band(found, band) for source in found]
    sources = [source for source in sources if source.tag in ("SimpleSource", "ComplexSource")]
    files = {_file(source, folder): None for source in sources}
    plain = [file for file in files if not file.startswith("/vsi") and "://" not in file and ":" not in file[2:]]
    missing = [file for file in plain if not os.path.exists(file)]
    if missing:
        raise DemError(
            f"{path}: {len(missing)} of the {len(files)} files that it is put together from do not exist, the first "
            f"is {missing[0]}. Bring them back, or write the VRT anew without them (gdalbuildvrt)."
        )
    for source in sources:
        _check_on_grid(path, source, _file(source, folder))
    return tuple(plain)


def _is_band(found: ElementTree.Element, band: int) -> bool:
    return found.get("band", "1") == str(band)


def _file(source: ElementTree.Element, folder: str) -> str:
    name = source.find("SourceFilename")
    if name is None or not name.text:
        return ""
    return os.path.join(folder, name.text) if name.get("relativeToVRT") == "1" else name.text


def _check_on_grid(path: str, source: ElementTree.Element, file: str) -> None:
    taken, put = source.find("SrcRect"), source.find("DstRect")
    if taken is None or put is None or source.get("resampling", "nearest").lower() not in ("near", "nearest"):
        return  # the whole of it, or resampled by the caller's own choice
    (x0, y0, w0, h0), (x1, y1, w1, h1) = (
        [float(rect.get(key, "nan")) for key in ("xOff", "yOff", "xSize", "ySize")] for rect in (taken, put)
    )
    stretch = max(abs(w1 - w0), abs(h1 - h0))
    shift = max(abs(off - round(off)) for off in (x1 - x0, y1 - y0))
    if not (stretch <= OFF_GRID and shift <= OFF_GRID):
        raise DemError(
            f"{path}: its source {file} is not on the grid of the VRT ({w0:.9g} x {h0:.9g} posts become {w1:.9g} x "
            f"{h1:.9g}, from row {y1:.9g}, column {x1:.9g}): GDAL would shift its posts to the nearest. Warp the "
            f"source to the common grid first (gdalwarp), or choose how in the VRT (gdalbuildvrt -r bilinear)."
        )

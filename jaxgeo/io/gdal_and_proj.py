"""Versions and drivers of GDAL and PROJ."""

from __future__ import annotations

from types import ModuleType

import pyproj
import rasterio.env
from pyproj.datadir import get_data_dir


def _pyogrio() -> ModuleType | None:
    """The library of vector files, of the extra `gis`, if it is installed."""
    try:
        import pyogrio
    except ImportError:
        return None
    return pyogrio


def versions() -> dict[str, str]:
    """Versions by the name of the library; rasterio and pyogrio may have a GDAL each."""
    pyogrio = _pyogrio()
    gdal = f"{rasterio.__gdal_version__} (rasterio)"
    if pyogrio is not None:
        gdal += f", {pyogrio.__gdal_version_string__} (pyogrio)"
    return {"GDAL": gdal, "PROJ": f"{pyproj.proj_version_str}, data in {get_data_dir()}"}


def drivers() -> tuple[frozenset[str], frozenset[str]]:
    """Names of the drivers for (rasters, vector files); none of vector files without pyogrio."""
    pyogrio = _pyogrio()
    with rasterio.env.Env() as environment:
        return frozenset(environment.drivers()), frozenset(() if pyogrio is None else pyogrio.list_drivers())

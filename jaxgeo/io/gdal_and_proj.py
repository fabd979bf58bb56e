"""Versions and drivers of GDAL and PROJ."""

from __future__ import annotations

import pyogrio
import pyproj
import rasterio.env
from pyproj.datadir import get_data_dir


def versions() -> dict[str, str]:
    """Versions by the name of the library; rasterio and pyogrio may have a GDAL each."""
    of_both = f"{rasterio.__gdal_version__} (rasterio), {pyogrio.__gdal_version_string__} (pyogrio)"
    return {"GDAL": of_both, "PROJ": f"{pyproj.proj_version_str}, data in {get_data_dir()}"}


def drivers() -> tuple[frozenset[str], frozenset[str]]:
    """Names of the drivers for (rasters, vector files)."""
    with rasterio.env.Env() as environment:
        return frozenset(environment.drivers()), frozenset(pyogrio.list_drivers())

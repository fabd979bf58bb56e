"""Files to records and back: elevation models, vertical datums, scenes, tables. Only this room knows PROJ and GDAL."""

from __future__ import annotations

from jaxgeo.io.dem import DemReport, example_dem, read_dem, read_dem_and_report
from jaxgeo.io.errors import DemError, VerticalDatumError
from jaxgeo.io.geoid import height_msl, undulation

__all__ = [
    "DemError",
    "DemReport",
    "VerticalDatumError",
    "example_dem",
    "height_msl",
    "read_dem",
    "read_dem_and_report",
    "undulation",
]

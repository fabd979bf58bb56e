"""Files to records and back: elevation models, vertical datums, scenes, tables, maps. Only io knows PROJ and GDAL."""

from __future__ import annotations

from jaxgeo.io.accuracy_map import write_accuracy_map
from jaxgeo.io.crowds import intersect_files, locate_files
from jaxgeo.io.dem import DemReport, example_dem, read_dem, read_dem_and_report
from jaxgeo.io.errors import DemError, VerticalDatumError
from jaxgeo.io.files import DemFiles, open_dem
from jaxgeo.io.geoid import height_msl, undulation

__all__ = [
    "DemError",
    "DemFiles",
    "DemReport",
    "VerticalDatumError",
    "example_dem",
    "height_msl",
    "intersect_files",
    "locate_files",
    "open_dem",
    "read_dem",
    "read_dem_and_report",
    "undulation",
    "write_accuracy_map",
]

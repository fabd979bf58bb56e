"""Files to records and back: elevation models, vertical datums, scenes, tables, maps. Only io knows PROJ and GDAL."""

from __future__ import annotations

from jaxgeo.io.accuracy_map import write_accuracy_map
from jaxgeo.io.crowds import intersect_files, locate_files
from jaxgeo.io.dem import DemReport, example_dem, read_dem, read_dem_and_report
from jaxgeo.io.errors import DemError, TableError, VerticalDatumError
from jaxgeo.io.exposures import write_exposures
from jaxgeo.io.files import DemFiles, open_dem
from jaxgeo.io.footprints import write_footprints
from jaxgeo.io.geoid import height_msl, undulation
from jaxgeo.io.navigation import read_navigation

__all__ = [
    "DemError",
    "DemFiles",
    "DemReport",
    "TableError",
    "VerticalDatumError",
    "example_dem",
    "height_msl",
    "intersect_files",
    "locate_files",
    "open_dem",
    "read_dem",
    "read_dem_and_report",
    "read_navigation",
    "undulation",
    "write_accuracy_map",
    "write_exposures",
    "write_footprints",
]

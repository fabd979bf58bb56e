"""Readers and writers: terrain, heights, scenes, image blocks, tables, maps. Only `io` uses PROJ and GDAL."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from jaxgeo.io import _proj as _proj  # makes the packaged geoid known to PROJ

if TYPE_CHECKING:
    from jaxgeo.io.accuracy_map import write_accuracy_map
    from jaxgeo.io.acquisitions import (
        Acquisition,
        AcquisitionSet,
        UnstatedDatum,
        read_acquisition,
        read_acquisitions,
        with_positions,
        with_usual_errors,
    )
    from jaxgeo.io.archives import ArchiveError, DemCache, FetchedDem, fetch_dem, fetch_geoid
    from jaxgeo.io.bal import BalProblem, read_bal, write_bal
    from jaxgeo.io.check_points import SurveyedPixels, check_points_of, read_check_points
    from jaxgeo.io.corrected import exposures_of, orientations_of, write_image_ties
    from jaxgeo.io.datasets import accuracy_map_dataset, samples_dataset
    from jaxgeo.io.dem import DemReport, example_dem, read_dem, read_dem_and_report
    from jaxgeo.io.errors import DemError, ImageError, TableError, VerticalDatumError
    from jaxgeo.io.errors_writer import errors_table, write_errors
    from jaxgeo.io.exposures import write_exposures
    from jaxgeo.io.files import DemFiles, open_dem
    from jaxgeo.io.fix_files import write_fixes
    from jaxgeo.io.footprints import write_footprints
    from jaxgeo.io.gcp import GroundControl, read_gcp_list
    from jaxgeo.io.geoid import height_msl, undulation
    from jaxgeo.io.ground_control import control_of, write_control
    from jaxgeo.io.height_sigmas import read_height_sigmas
    from jaxgeo.io.image_points import read_image_points, write_image_points
    from jaxgeo.io.images import read_image
    from jaxgeo.io.locate_on_disk import intersect_files, locate_files
    from jaxgeo.io.located import accuracy_of_observations, locate_observations
    from jaxgeo.io.map_raster import MapRaster
    from jaxgeo.io.metashape_writer import write_metashape_cameras
    from jaxgeo.io.mosaic import MosaicFile, write_mosaic
    from jaxgeo.io.navigation import read_navigation
    from jaxgeo.io.observation_reader import observations_of, read_observations
    from jaxgeo.io.observations import ObservationBatch, Observations
    from jaxgeo.io.opensfm import Reconstruction, read_opensfm, read_opensfm_cameras
    from jaxgeo.io.orientation_writer import write_orientations
    from jaxgeo.io.orientations import Orientations, read_orientations
    from jaxgeo.io.ortho_writer import OrthoWriter, write_orthoimage
    from jaxgeo.io.orthoimages import OrthoimageReport, read_orthoimage, read_orthoimage_and_report
    from jaxgeo.io.reconstruction_writer import write_colmap, write_opensfm
    from jaxgeo.io.rectified import RectifiedFile, rectify_file
    from jaxgeo.io.regions import write_probability_map, write_region
    from jaxgeo.io.scene_from_records import write_scene
    from jaxgeo.io.scene_writer import write_updated_scene
    from jaxgeo.io.shot_groups import flights_by_time, shots_by_name, shots_by_time
    from jaxgeo.io.tie_points import TieRow, write_tie_points
    from jaxgeo.io.tracks import write_track

__all__ = [
    "Acquisition",
    "AcquisitionSet",
    "ArchiveError",
    "BalProblem",
    "DemCache",
    "DemError",
    "DemFiles",
    "DemReport",
    "FetchedDem",
    "GroundControl",
    "ImageError",
    "MapRaster",
    "MosaicFile",
    "ObservationBatch",
    "Observations",
    "Orientations",
    "OrthoWriter",
    "OrthoimageReport",
    "Reconstruction",
    "RectifiedFile",
    "SurveyedPixels",
    "TableError",
    "TieRow",
    "UnstatedDatum",
    "VerticalDatumError",
    "accuracy_map_dataset",
    "accuracy_of_observations",
    "check_points_of",
    "control_of",
    "errors_table",
    "example_dem",
    "exposures_of",
    "fetch_dem",
    "fetch_geoid",
    "flights_by_time",
    "height_msl",
    "intersect_files",
    "locate_files",
    "locate_observations",
    "observations_of",
    "open_dem",
    "orientations_of",
    "read_acquisition",
    "read_acquisitions",
    "read_bal",
    "read_check_points",
    "read_dem",
    "read_dem_and_report",
    "read_gcp_list",
    "read_height_sigmas",
    "read_image",
    "read_image_points",
    "read_navigation",
    "read_observations",
    "read_opensfm",
    "read_opensfm_cameras",
    "read_orientations",
    "read_orthoimage",
    "read_orthoimage_and_report",
    "rectify_file",
    "samples_dataset",
    "shots_by_name",
    "shots_by_time",
    "undulation",
    "with_positions",
    "with_usual_errors",
    "write_accuracy_map",
    "write_bal",
    "write_colmap",
    "write_control",
    "write_errors",
    "write_exposures",
    "write_fixes",
    "write_footprints",
    "write_image_points",
    "write_image_ties",
    "write_metashape_cameras",
    "write_mosaic",
    "write_opensfm",
    "write_orientations",
    "write_orthoimage",
    "write_probability_map",
    "write_region",
    "write_scene",
    "write_tie_points",
    "write_track",
    "write_updated_scene",
]

# The module of each name, loaded when first used: a reader of one format needs few of them.
_NAMES_OF = {
    "accuracy_map": "write_accuracy_map",
    "acquisitions": "Acquisition AcquisitionSet UnstatedDatum read_acquisition read_acquisitions with_positions "
    "with_usual_errors",
    "archives": "ArchiveError DemCache FetchedDem fetch_dem fetch_geoid",
    "bal": "BalProblem read_bal write_bal",
    "check_points": "SurveyedPixels check_points_of read_check_points",
    "corrected": "exposures_of orientations_of write_image_ties",
    "datasets": "accuracy_map_dataset samples_dataset",
    "dem": "DemReport example_dem read_dem read_dem_and_report",
    "errors": "DemError ImageError TableError VerticalDatumError",
    "errors_writer": "errors_table write_errors",
    "exposures": "write_exposures",
    "files": "DemFiles open_dem",
    "fix_files": "write_fixes",
    "footprints": "write_footprints",
    "gcp": "GroundControl read_gcp_list",
    "geoid": "height_msl undulation",
    "ground_control": "control_of write_control",
    "height_sigmas": "read_height_sigmas",
    "image_points": "read_image_points write_image_points",
    "images": "read_image",
    "locate_on_disk": "intersect_files locate_files",
    "located": "accuracy_of_observations locate_observations",
    "map_raster": "MapRaster",
    "metashape_writer": "write_metashape_cameras",
    "mosaic": "MosaicFile write_mosaic",
    "navigation": "read_navigation",
    "observation_reader": "observations_of read_observations",
    "observations": "ObservationBatch Observations",
    "opensfm": "Reconstruction read_opensfm read_opensfm_cameras",
    "orientation_writer": "write_orientations",
    "orientations": "Orientations read_orientations",
    "ortho_writer": "OrthoWriter write_orthoimage",
    "orthoimages": "OrthoimageReport read_orthoimage read_orthoimage_and_report",
    "reconstruction_writer": "write_colmap write_opensfm",
    "rectified": "RectifiedFile rectify_file",
    "regions": "write_probability_map write_region",
    "scene_from_records": "write_scene",
    "scene_writer": "write_updated_scene",
    "shot_groups": "flights_by_time shots_by_name shots_by_time",
    "tie_points": "TieRow write_tie_points",
    "tracks": "write_track",
}
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        found = getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        return globals().setdefault(name, found)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

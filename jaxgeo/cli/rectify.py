"""`jaxgeo rectify`: orthorectification of an image."""

from __future__ import annotations

import dataclasses
import math
import pathlib
import time
from enum import StrEnum
from typing import Annotated, Any

import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._cluster import PartsOptions
from jaxgeo.cli._common import Debug, UserError, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.cli._inputs import read_terrain, terrain_files, view_of_shots
from jaxgeo.cli._map_cells import MapCells
from jaxgeo.cli._option_names import translate_cell_errors, translate_reach_errors
from jaxgeo.cli._options import WRITING, DemFiles, DemOptions, DemOptionsBesideBand
from jaxgeo.cli._oriented_images import OrientedImages
from jaxgeo.cli._rectify_many import rectify_several
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import bars_on_stderr, print_counts, print_written

QUICK_PIXELS = 40_000_000  # below this, optimised compilation does not pay off
SHOWN = "The cell is visible in the image (it is unknown where the image is)."


class Interpolation(StrEnum):
    """Resampling methods."""

    nearest = "nearest"
    bilinear = "bilinear"
    cubic = "cubic"


@dataclasses.dataclass(frozen=True, kw_only=True)
class CellOptions(MapCells):
    """The cells of an orthoimage, and how they are filled."""

    like: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--like",
            metavar="FILE",
            help="Orthoimage whose grid to use, instead of --crs, --bounds and --resolution.",
        ),
    ] = None
    band: Annotated[list[int] | None, typer.Option("--band", help="Image band, from 1 (repeatable).")] = None
    interpolation: Annotated[Interpolation, typer.Option("--interpolation", help="Resampling method.")] = (
        Interpolation.bilinear
    )
    cog: Annotated[
        bool, typer.Option("--cog", help="Write a cloud-optimised GeoTIFF; those of several images always are.")
    ] = False
    status: Annotated[bool, typer.Option("--status", help="Also write *_status.tif: status code of each cell.")] = False
    no_hidden_mask: Annotated[
        bool, typer.Option("--no-hidden-mask", help="Do not mask cells hidden by terrain; faster.")
    ] = False

    @property
    def wishes(self) -> dict[str, Any]:
        """Arguments of `rectify_file`. Raises `UserError`."""
        if self.like is not None and any(one is not None for one in (self.crs, self.bounds, self.resolution)):
            raise UserError("--like sets the grid: leave out --crs, --bounds and --resolution.")
        return self.placed | {
            "like": self.like,
            "bands": self.band,
            "interpolation": _interpolations()[self.interpolation],
            "cog": self.cog,
            "status": self.status,
            "mask_hidden": not self.no_hidden_mask,
        }


def rectify_command(
    image: Annotated[
        list[pathlib.Path],
        typer.Argument(
            metavar="IMAGE",
            help="The image of a --scene; or drone images, folders of them, or a file with the poses of --images.",
        ),
    ],
    dem: DemFiles,
    output: Annotated[
        pathlib.Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="GeoTIFF to write (.tif); for several images a FOLDER.",
            rich_help_panel=WRITING,
        ),
    ],
    *,
    scene: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--scene", metavar="FILE", help="Scene file (TOML): camera, gimbal, mount and pose of the only IMAGE."
        ),
    ] = None,
    images: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--images",
            metavar="FOLDER",
            help="Images by name, if IMAGE is a file of poses (a reconstruction, a table).",
        ),
    ] = None,
    reading_dem: DemOptionsBesideBand = DemOptionsBesideBand(),
    cells: CellOptions = CellOptions(),
    reading: ReadingOptions = ReadingOptions(),
    many: PartsOptions = PartsOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Orthorectify images: GeoTIFFs on a map grid, cells hidden by terrain masked.

    Of several images, or with --cluster, the result is a folder: a GeoTIFF for each, a mosaic and a STAC catalogue.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        wishes = cells.wishes
        given = OrientedImages(image, scene, images, reading)
        given.check()
        in_parts = many.cluster is not None or given.are_several
        many.check_parts(in_parts)
        if in_parts:
            rectify_several(given, dem, reading_dem, output, wishes, many, inputs if as_json else None)
            return
        done, seconds = _rectify(given, dem, reading_dem, output, wishes)
        if as_json:
            print_json("rectify", {"inputs": inputs, **_content(done, seconds)})
        else:
            print_raster(done, seconds)
        print_written(output)
        count_cells(done)


def _rectify(
    given: OrientedImages, dem: list[str], reading: DemOptions, output: pathlib.Path, wishes: dict[str, Any]
) -> tuple[Any, float]:
    """(the result, seconds taken)."""
    from jaxgeo._checks import enable_x64
    from jaxgeo._destination import check_no_input
    from jaxgeo.io import rectify_file
    from jaxgeo.io.map_raster import checked_target
    from jaxgeo.io.paths import files_behind
    from jaxgeo.io.rectified import status_file

    checked_target(output, "an orthoimage")
    reach = reading.reach
    wishes |= {"allow_remote": reach.remote, "allow_outside": reach.outside}
    rasters = [*given.files, *([] if wishes["like"] is None else [wishes["like"]])]
    read = [
        *given.inputs,
        *terrain_files(dem, reading),
        *(file for one in rasters for file in files_behind(one, reach)),
    ]
    check_no_input("--output", [output, status_file(output)] if wishes["status"] else [output], read)
    if given.scene is not None:
        with translate_reach_errors():
            pixels = pixels_of(given.files[0], reach)
        if pixels < QUICK_PIXELS:
            compile_quickly()
    else:
        compile_quickly()
    enable_x64()
    file, exposure = given.on(dem, reading).one()
    note_far_crs(wishes["crs"], exposure.motion)
    terrain = read_terrain(dem, reading, lambda: view_of_shots(exposure.sensor, [exposure.motion]))
    began = time.perf_counter()
    with bars_on_stderr() as is_shown, translate_cell_errors(), translate_reach_errors():
        done = rectify_file(
            output,
            file,
            exposure.sensor,
            exposure.motion,
            terrain,
            progress=is_shown,
            atmosphere=exposure.atmosphere,
            **wishes,
        )
    return done, time.perf_counter() - began


def pixels_of(path: pathlib.Path, reach: Any) -> int:
    """Number of pixels of an image. Raises `ImageError` or `FileNotFoundError` early if it cannot be read."""
    from jaxgeo.io.images import opened

    with opened(str(path), reach) as data:
        return data.width * data.height


def print_raster(done: Any, seconds: float) -> None:
    """Print the result on stdout."""
    rows, cols = done.raster.shape
    unit = done.raster.crs.axis_info[0].unit_name
    name = _crs_name(done.raster)
    sides = [f"{size:.6g}" for size in _cell(done.raster)]
    size = sides[0] if sides[0] == sides[1] else " x ".join(sides)
    console = Console(soft_wrap=True)
    console.print(
        f"{done.path}: {rows} rows of {cols} cells of {size} {unit}, {name}; {done.known} known; {seconds:.1f} s, "
        f"{1e-6 * rows * cols / seconds:.2g} million cells/s",
        highlight=False,
        markup=False,
    )


def count_cells(done: Any) -> None:
    """Print the number of cells per status on stderr."""
    rows, cols = done.raster.shape
    print_counts({one.name: count for one, count in done.counts.items()}, rows * cols, "cell", SHOWN)


def _content(done: Any, seconds: float) -> dict[str, Any]:
    """JSON content; `transform` is (a, b, c, d, e, f) as in rasterio."""
    rows, cols = done.raster.shape
    cells = {"rows": rows, "columns": cols, "known": done.known}
    statuses = {one.name: count for one, count in done.counts.items()}
    place = {"crs": _crs_name(done.raster), "transform": list(done.raster.transform[:6]), "cell": _cell(done.raster)}
    return {"file": done.path, **place, **cells, "cells_by_status": statuses, "seconds": seconds}


def _cell(raster: Any) -> tuple[float, float]:
    """Cell size, across and down, also of a rotated raster."""
    a, b, _, d, e, _ = raster.transform[:6]
    return math.hypot(a, d), math.hypot(b, e)


def _crs_name(raster: Any) -> str:
    return ":".join(raster.crs.to_authority() or ()) or raster.crs.name


def _interpolations() -> dict[Interpolation, Any]:
    from jaxgeo.ortho import Bilinear, Cubic, Nearest

    return {
        Interpolation.nearest: Nearest(),
        Interpolation.bilinear: Bilinear(),
        Interpolation.cubic: Cubic(),
    }

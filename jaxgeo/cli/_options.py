"""Options shared by several commands."""

from __future__ import annotations

import pathlib
from enum import StrEnum
from typing import Annotated

import typer

SEEN, SURE = "Inputs", "Accuracy"  # help panels of commands with many options
READING, WRITING = "Reading the FILE", "Output"
OF_DEM = "Reading the elevation model"

SceneFile = Annotated[
    pathlib.Path,
    typer.Option("--scene", metavar="FILE", help="Scene file (TOML): camera, gimbal, mount and pose."),
]
DemFiles = Annotated[
    list[str],
    typer.Option(
        "--dem", metavar="FILE", help="Elevation model: a file, or a URL with --allow-remote; repeatable for tiles."
    ),
]
Nodata = Annotated[
    list[float] | None,
    typer.Option(
        "--nodata",
        metavar="VALUE",
        help="Stored value that marks voids of --dem, besides its nodata tag (repeatable).",
        rich_help_panel=OF_DEM,
    ),
]
HeightUnit = Annotated[
    str | None,
    typer.Option(
        "--height-unit",
        metavar="UNIT",
        help='Height unit of --dem, overrides the file: "m", "ft", "us-ft", "dm", "cm".',
        rich_help_panel=OF_DEM,
    ),
]
_BAND = "Height band of --dem, from 1 (default 1)."
DemBand = Annotated[int | None, typer.Option("--dem-band", "--band", help=_BAND, rich_help_panel=OF_DEM)]
DemBandBesideBand = Annotated[int | None, typer.Option("--dem-band", help=_BAND, rich_help_panel=OF_DEM)]
"""For commands in which --band selects an image band."""
DemBounds = Annotated[
    str | None,
    typer.Option(
        "--dem-bounds",
        metavar="EDGES",
        help="Extent of --dem to read: WEST,SOUTH,EAST,NORTH in deg.",
        rich_help_panel=OF_DEM,
    ),
]
AssumeWgs84 = Annotated[
    bool | None,
    typer.Option(
        "--assume-wgs84", help="Assume that the geographic coordinates of --dem are WGS 84.", rich_help_panel=OF_DEM
    ),
]
AllowRemote = Annotated[
    bool | None,
    typer.Option(
        "--allow-remote",
        help="Allow rasters at URLs and other GDAL data sources (/vsi..., a WMS).",
        rich_help_panel=OF_DEM,
    ),
]
AllowOutside = Annotated[
    bool | None,
    typer.Option(
        "--allow-outside",
        help="Allow rasters (a VRT) to read files outside their own folder.",
        rich_help_panel=OF_DEM,
    ),
]
VerticalDatum = Annotated[
    str | None,
    typer.Option(
        metavar="DATUM",
        help='Vertical datum of the DEM: "EPSG:5773", "ellipsoid", an undulation in m, a geoid grid.',
    ),
]
HeightDatum = Annotated[
    str | None,
    typer.Option(
        metavar="DATUM",
        help='Vertical datum of other heights: "EPSG:5773", "ellipsoid", an undulation in m (default: the scene\'s).',
    ),
]
ShotsFile = Annotated[pathlib.Path | None, typer.Option("--shots", metavar="FILE", help="CSV with a shot per row.")]
NavigationFile = Annotated[
    pathlib.Path | None,
    typer.Option("--navigation", metavar="FILE", help="CSV with a navigation record per row."),
]


class Axis(StrEnum):
    """An axis of the image."""

    columns = "columns"
    rows = "rows"


Along = Annotated[Axis | None, typer.Option("--along", help="Image axis along track (default: detected).")]

"""Options that several commands have."""

from __future__ import annotations

import pathlib
from enum import StrEnum
from typing import Annotated

import typer

SEEN, SURE = "What is seen", "How sure it is"  # panels of the help of commands with many options
READING, WRITING = "How the FILE is read", "What comes out"
OF_DEM = "How the elevation model is read"

SceneFile = Annotated[
    pathlib.Path,
    typer.Option("--scene", metavar="FILE", help="Scene file (TOML): camera, gimbal, mount and pose."),
]
DemFiles = Annotated[
    list[str],
    typer.Option(
        "--dem", metavar="FILE", help="Elevation model: a file, or a URL with --allow-remote; repeat it for tiles."
    ),
]
Nodata = Annotated[
    list[float] | None,
    typer.Option(
        "--nodata",
        metavar="VALUE",
        help="Value that marks voids of --dem beside its own tag, as stored; repeat it for more.",
        rich_help_panel=OF_DEM,
    ),
]
HeightUnit = Annotated[
    str | None,
    typer.Option(
        "--height-unit",
        metavar="UNIT",
        help='Unit of the heights of --dem, over what the file states: "m", "ft", "us-ft", "dm", "cm".',
        rich_help_panel=OF_DEM,
    ),
]
_BAND = "Band of --dem that holds the heights, from 1; 1 if left out."
DemBand = Annotated[int | None, typer.Option("--dem-band", "--band", help=_BAND, rich_help_panel=OF_DEM)]
DemBandBesideBand = Annotated[int | None, typer.Option("--dem-band", help=_BAND, rich_help_panel=OF_DEM)]
"""Of commands in which --band is that of an image."""
DemBounds = Annotated[
    str | None,
    typer.Option(
        "--dem-bounds",
        metavar="EDGES",
        help="WEST,SOUTH,EAST,NORTH in deg: the part of --dem to read.",
        rich_help_panel=OF_DEM,
    ),
]
AssumeWgs84 = Annotated[
    bool | None,
    typer.Option(
        "--assume-wgs84", help="Take latitudes and longitudes of --dem as those of WGS 84.", rich_help_panel=OF_DEM
    ),
]
AllowRemote = Annotated[
    bool | None,
    typer.Option(
        "--allow-remote",
        help="Let rasters be, or take values from, URLs and other places that only GDAL resolves (/vsi..., a WMS).",
        rich_help_panel=OF_DEM,
    ),
]
AllowOutside = Annotated[
    bool | None,
    typer.Option(
        "--allow-outside",
        help="Let rasters (a VRT) take values from files outside their own folder.",
        rich_help_panel=OF_DEM,
    ),
]
VerticalDatum = Annotated[
    str | None,
    typer.Option(
        metavar="DATUM", help='What the DEM heights are above: "EPSG:5773", "ellipsoid", metres, a geoid grid.'
    ),
]
HeightDatum = Annotated[
    str | None,
    typer.Option(
        metavar="DATUM",
        help='What other heights are above: "EPSG:5773", "ellipsoid", metres; that of the scene if left out.',
    ),
]
ShotsFile = Annotated[pathlib.Path | None, typer.Option("--shots", metavar="FILE", help="CSV with a shot in each row.")]
NavigationFile = Annotated[
    pathlib.Path | None,
    typer.Option("--navigation", metavar="FILE", help="CSV with a navigation record of the flight in each row."),
]


class Axis(StrEnum):
    """An axis of the image."""

    columns = "columns"
    rows = "rows"


Along = Annotated[
    Axis | None, typer.Option("--along", help="Axis of the image that lies along the flight; found if left out.")
]

"""Options that several commands have."""

from __future__ import annotations

import pathlib
from enum import StrEnum
from typing import Annotated

import typer

SEEN, SURE = "What is seen", "How sure it is"  # panels of the help of commands with many options
READING, WRITING = "How the FILE is read", "What comes out"

SceneFile = Annotated[
    pathlib.Path,
    typer.Option("--scene", metavar="FILE", help="Scene file (TOML): camera, gimbal, mount and pose."),
]
DemFiles = Annotated[
    list[pathlib.Path],
    typer.Option("--dem", metavar="FILE", help="Elevation model; repeat it for several tiles."),
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

"""Options of commands that read exposures from a file of a camera or an aircraft, whatever its kind."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import numbers_in, said_datum
from jaxgeo.cli._options import READING

SourceDatum = Annotated[
    str | None,
    typer.Option(
        "--height-datum",
        metavar="DATUM",
        help='What the file\'s heights are above: "ellipsoid", "EPSG:5773", metres.',
        rich_help_panel=READING,
    ),
]
TakeoffHeight = Annotated[
    float | None,
    typer.Option(
        metavar="HEIGHT",
        help="Drone images: the point of take-off, m above the ellipsoid; in place of a datum.",
        rich_help_panel=READING,
    ),
]
SourceCrs = Annotated[
    str | None,
    typer.Option(
        "--source-crs",
        metavar="CRS",
        help='Map of the file\'s positions: "EPSG:32651"; if it has them in one.',
        rich_help_panel=READING,
    ),
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="CAMERA",
        help="The camera: focal=8.8mm,pitch=2.41um or focal=3666px, a camera or scene file (.toml), or the NAME of one "
        "of the file's cameras, of drone images one of the table of cameras.",
        rich_help_panel=READING,
    ),
]
GimbalAngles = Annotated[
    str | None,
    typer.Option(
        "--gimbal",
        metavar="ANGLES",
        help="Drone images: YAW,PITCH,ROLL of the camera, deg from true north and the horizon, in place of tags; "
        "aircraft,PITCH,ROLL takes yaw from the heading of the aircraft.",
        rich_help_panel=READING,
    ),
]
VideoSize = Annotated[
    str | None,
    typer.Option(
        "--image-size",
        metavar="SIZE",
        help="Telemetry: WIDTH,HEIGHT of the video, in pixels.",
        rich_help_panel=READING,
    ),
]
Upright = Annotated[
    bool,
    typer.Option("--upright", help="Telemetry: images are held level with the horizon.", rich_help_panel=READING),
]
KeepDamaged = Annotated[
    bool,
    typer.Option("--keep-damaged", help="Telemetry: packets with a wrong checksum too.", rich_help_panel=READING),
]
Stream = Annotated[
    int | None,
    typer.Option(
        "--stream",
        metavar="NUMBER",
        help="Telemetry: which data stream of a transport stream.",
        rich_help_panel=READING,
    ),
]
SbetErrors = Annotated[
    pathlib.Path | None,
    typer.Option("--errors", metavar="FILE", help="SBET: its file of errors (smrmsg).", rich_help_panel=READING),
]
PositionsFile = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--positions",
        metavar="FILE",
        help="Drone images: a file of better positions (geo.txt, Timestamp.MRK, shots.geojson, a table).",
        rich_help_panel=READING,
    ),
]
NoVelocities = Annotated[
    bool,
    typer.Option("--no-velocities", help="SBET: leave its velocities out.", rich_help_panel=READING),
]
InteriorFile = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--interior",
        metavar="FILE",
        help="Orthority: the file of interior parameters (.yaml).",
        rich_help_panel=READING,
    ),
]


def how_to_read(
    height_datum: str | None,
    takeoff_height: float | None,
    crs: str | None,
    camera: str | None,
    image_size: str | None,
    telemetry: tuple[bool, bool, int | None],
    errors: pathlib.Path | None,
    interior: pathlib.Path | None,
    no_velocities: bool = False,
    gimbal: str | None = None,
    *,
    positions: pathlib.Path | None = None,
) -> dict[str, Any]:
    """Options of `read_acquisition` from those of the command line; `telemetry` are (upright, keep damaged, stream).

    Raises `UserError`.
    """
    how: dict[str, Any] = {"takeoff_height": takeoff_height, "crs": crs, "camera": camera}
    how |= {"errors": errors, "interior": interior, "positions": positions}
    how |= {"velocities": False if no_velocities else None}
    upright, keep_damaged, stream = telemetry
    how |= {"upright": upright or None, "keep_damaged": keep_damaged or None, "stream": stream}
    if height_datum is not None:
        how["height_datum"] = said_datum(height_datum)
    if gimbal is not None:
        form = "YAW,PITCH,ROLL, three angles in deg, or aircraft,PITCH,ROLL"
        by_aircraft = gimbal.strip().startswith("aircraft,")
        angles: list[Any] = numbers_in(
            "--gimbal", gimbal.replace("aircraft,", "0,", 1) if by_aircraft else gimbal, (3,), form
        )
        how["gimbal_deg"] = ["aircraft", *angles[1:]] if by_aircraft else angles
    if image_size is not None:
        size = numbers_in("--image-size", image_size, (2,), "WIDTH,HEIGHT, two whole numbers")
        if any(one != int(one) or one < 1 for one in size):
            raise UserError(f"--image-size {image_size!r}: expected WIDTH,HEIGHT, two whole numbers.")
        how["image_size"] = int(size[0]), int(size[1])
    return {name: value for name, value in how.items() if value is not None}

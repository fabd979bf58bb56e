"""Options of commands that read exposures from image, telemetry or navigation files."""

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
        help='Vertical datum of the file\'s heights: "ellipsoid", "EPSG:5773", or an undulation in m.',
        rich_help_panel=READING,
    ),
]
TakeoffHeight = Annotated[
    float | None,
    typer.Option(
        metavar="HEIGHT",
        help="Drone images: height of the take-off point, m above the ellipsoid; replaces --height-datum.",
        rich_help_panel=READING,
    ),
]
SourceCrs = Annotated[
    str | None,
    typer.Option(
        "--source-crs",
        metavar="CRS",
        help='CRS of the file\'s positions, if they are projected: "EPSG:32651".',
        rich_help_panel=READING,
    ),
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="CAMERA",
        help="Camera: focal=8.8mm,pitch=2.41um or focal=3666px, a camera or scene file (.toml), or the NAME of a "
        "camera in the file (drone images: in the camera table).",
        rich_help_panel=READING,
    ),
]
GimbalAngles = Annotated[
    str | None,
    typer.Option(
        "--gimbal",
        metavar="ANGLES",
        help="Drone images: YAW,PITCH,ROLL of the camera, deg from true north and the horizon; replaces the "
        "tags. aircraft,PITCH,ROLL takes the yaw from the aircraft heading.",
        rich_help_panel=READING,
    ),
]
VideoSize = Annotated[
    str | None,
    typer.Option(
        "--image-size",
        metavar="SIZE",
        help="Telemetry: WIDTH,HEIGHT of the video, pixels.",
        rich_help_panel=READING,
    ),
]
Upright = Annotated[
    bool,
    typer.Option(
        "--upright", help="Telemetry: the image is stabilised level with the horizon.", rich_help_panel=READING
    ),
]
KeepDamaged = Annotated[
    bool,
    typer.Option("--keep-damaged", help="Telemetry: also use packets with a wrong checksum.", rich_help_panel=READING),
]
Stream = Annotated[
    int | None,
    typer.Option(
        "--stream",
        metavar="NUMBER",
        help="Telemetry: number of the data stream in a transport stream.",
        rich_help_panel=READING,
    ),
]
SbetErrors = Annotated[
    pathlib.Path | None,
    typer.Option("--errors", metavar="FILE", help="SBET: accuracy file (smrmsg).", rich_help_panel=READING),
]
PositionsFile = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--positions",
        metavar="FILE",
        help="Drone images: file of refined positions (geo.txt, Timestamp.MRK, shots.geojson, a table).",
        rich_help_panel=READING,
    ),
]
NoVelocities = Annotated[
    bool,
    typer.Option("--no-velocities", help="SBET: ignore the velocities.", rich_help_panel=READING),
]
InteriorFile = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--interior",
        metavar="FILE",
        help="Orthority: interior parameter file (.yaml).",
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
    """Keyword arguments of `read_acquisition` from options; `telemetry` is (upright, keep damaged, stream).

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

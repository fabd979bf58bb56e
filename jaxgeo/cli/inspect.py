"""`jaxgeo inspect`: the exposures in a file, and the assumptions of its reader."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape

import jaxgeo
from jaxgeo._destination import check_place, destination
from jaxgeo._refusals import is_refusal
from jaxgeo.cli._acquisitions import ReadingOptions, print_unread, reading_files
from jaxgeo.cli._common import FAULT, Debug, UserError, counted, name_says, report_errors
from jaxgeo.cli._console import Console
from jaxgeo.cli._exposure_tables import centre_pixels, rows_of, tags_of
from jaxgeo.cli._inputs import check_no_overwrite
from jaxgeo.cli._known_heights import TakeoffOptions, relative_heights
from jaxgeo.cli._option_names import as_typed, reason_not_read
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import number_table, print_written

SHOWN = 5  # exposures printed
TRACKS = (".gpx", ".kml")
OFF = {
    "range_off_m": "range off, m",
    "axis_off_azimuth_mrad": "az. off, mrad",
    "axis_off_elevation_mrad": "el. off, mrad",
}  # columns that compare a line of sight with the reported frame centre


def inspect_command(
    files: Annotated[
        list[pathlib.Path],
        typer.Argument(metavar="FILE", help="Drone images or folders, KLV, SBET, table, reconstruction, scene."),
    ],
    reading: ReadingOptions = ReadingOptions(),
    of_takeoff: TakeoffOptions = TakeoffOptions(),
    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write all exposures to a table of shots (.csv), with the image centre as pixel, or as a track with "
            "times (.gpx, .kml).",
        ),
    ] = None,
    tags: Annotated[bool, typer.Option("--tags", help="With --json: all tags of each exposure.")] = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Exposures in a file: cameras, poses, error sources, and the assumptions of its reader."""
    inputs = given_options(locals())
    inputs |= {"file": inputs.pop("files")[0]} if len(files) == 1 else {}
    with report_errors(debug):
        from jaxgeo._checks import enable_x64

        if output is not None:
            if output.suffix.lower() not in (".csv", *TRACKS):
                raise UserError(f"--output {output}: {name_says(output)}; use .csv, {' or '.join(TRACKS)}.")
            check_place("--output", output)
            check_no_overwrite(
                "--output", output, [*_files_in(files), reading.errors, reading.interior, reading.positions]
            )
        if tags and not as_json:
            raise UserError("--tags needs --json.")
        enable_x64()
        found, unstated = _read(files, of_takeoff.known(reading, files).known_arguments)
        found = dataclasses.replace(found, assumed=(*found.assumed, *relative_heights(reading)))
        rows = rows_of(found)
        if reading.is_above_takeoff:
            rows = [_above_takeoff(row) for row in rows]
        if output is not None:
            if unstated is not None:
                raise UserError(as_typed(unstated))
            if output.suffix.lower() in TRACKS:
                from jaxgeo.io import write_track

                write_track(output, found, is_above_takeoff=reading.is_above_takeoff)
            else:
                _write(output, found, rows, has_datum=not reading.is_above_takeoff)
            print_written(output)
        print_unread(found.unread)
        if as_json:
            print_json("inspect", {"inputs": inputs, **_content(files, found, rows, unstated, tags)})
        else:
            _show(files, found, rows, unstated, has_datum=not reading.is_above_takeoff)
        if any(not is_refusal(one.error) for one in found.unread):
            raise typer.Exit(FAULT)


def _files_in(files: list[pathlib.Path]) -> list[pathlib.Path]:
    return [*files, *(inside for one in files if one.is_dir() for inside in one.iterdir())]


def _read(files: list[pathlib.Path], how: dict[str, Any]) -> tuple[jaxgeo.io.AcquisitionSet, str | None]:
    """(exposures, why their vertical datum is unknown or None); without a datum heights are as in the files."""
    from jaxgeo.io.acquisitions import UnstatedDatum
    from jaxgeo.io.observation_reader import read_files

    try:
        with reading_files(files) as progress:
            return read_files(files, progress=progress, **how), None
    except UserError as error:
        if not isinstance(error.__cause__, UnstatedDatum):
            raise
        found, _ = _read(files, {**how, "height_datum": "ellipsoid"})
        assumed = tuple(one for one in found.assumed if not one.startswith("Heights are above"))  # not stated
        return dataclasses.replace(found, assumed=assumed), str(error)


def _above_takeoff(row: dict[str, Any]) -> dict[str, Any]:
    """A row whose height is named as one above the take-off, so that no reader takes it as above a datum."""
    from jaxgeo.io._csv import ABOVE_TAKEOFF

    return {ABOVE_TAKEOFF if name == "height_m" else name: value for name, value in row.items()}


def _write(
    output: pathlib.Path, found: jaxgeo.io.AcquisitionSet, rows: list[dict[str, Any]], *, has_datum: bool
) -> None:
    """Write a table of shots, with columns for the vertical datum, if there is one, and the gimbal reference."""
    from jaxgeo.io.tables import write_csv

    more = {"height_datum": "ellipsoid"} if has_datum else {}
    rows = [row | more | middle for row, middle in zip(rows, centre_pixels(found), strict=True)]
    with destination("--output", output) as stream:
        write_csv(({name: _text(name, value) for name, value in row.items()} for row in rows), stream)


def _text(name: str, value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return f"{value:.{10 if name.endswith('_deg') else 6 if name == 'time_s' else 4}f}"


def _content(
    files: list[pathlib.Path],
    found: jaxgeo.io.AcquisitionSet,
    rows: list[dict[str, Any]],
    unstated: str | None,
    tags: bool,
) -> dict[str, Any]:
    """JSON content: all exposures, and each part of one structure (one camera)."""
    parts = [
        {"form": one.form, "facts": dict(one.facts), "sensor": _sensor(one), "errors": _errors(one), "count": len(one)}
        for one in found.parts
    ]
    first = {name: value for name, value in parts[0].items() if name != "count"}
    content = {"file": _named(files, found), **first, "parts": parts, "assumed": list(map(as_typed, found.assumed))}
    content |= {"height_datum_unstated": None if unstated is None else as_typed(unstated)}
    content |= {"time_is_utc": all(one.time_is_utc for one in found.parts)}
    content |= {"exposures": rows, "unread": [_unread(one) for one in found.unread]}
    return content | ({"tags": tags_of(found)} if tags else {})


def _named(files: list[pathlib.Path], found: jaxgeo.io.AcquisitionSet) -> str:
    if len(files) > 1:
        return f"{files[0]} and {len(files) - 1} more"
    return found.parts[0].path if not files[0].is_dir() else f"{files[0]}"


def _unread(one: Any) -> dict[str, str]:
    return {"name": one.name, "path": one.path, "reason": reason_not_read(one)}


def _sensor(found: jaxgeo.io.Acquisition) -> dict[str, Any] | None:
    """The sensor of the first exposure."""
    if found.sensor is None:
        return None
    from jaxgeo.io.observations import frame_camera_of

    sensor, _, _ = found.exposure(0)
    assert sensor is not None
    camera = frame_camera_of(sensor)
    focal = np.asarray(camera.focal_px)
    half = 0.5 * np.array([camera.width, camera.height])
    return {
        "width": camera.width,
        "height": camera.height,
        "focal_px": focal.tolist(),
        "principal_px": np.asarray(camera.principal_px).tolist(),
        "field_of_view_deg": np.rad2deg(2.0 * np.arctan(half / focal)).tolist(),
        "lens": type(camera.distortion).__name__,
        "gimbal": list(sensor.gimbal.names),
        "gimbal_reference": sensor.gimbal.reference,
    }


def _errors(found: jaxgeo.io.Acquisition) -> dict[str, float]:
    """Standard deviations of the first exposure by axis, angles in deg."""
    _, _, sources = found.exposure(0)
    sigmas = {}
    for source in sources:
        unit, scale = ("deg", 180.0 / math.pi) if source.unit == "rad" else (source.unit, 1.0)
        for axis, sigma in zip(source.sigma_axes, np.asarray(source.sigma), strict=True):
            sigmas[f"{source.label}: {axis}, {unit}"] = float(sigma) * scale
    return sigmas


def _show(
    files: list[pathlib.Path],
    found: jaxgeo.io.AcquisitionSet,
    rows: list[dict[str, Any]],
    unstated: str | None,
    *,
    has_datum: bool,
) -> None:
    console = Console(width=None if Console().is_terminal else 160, highlight=False)
    count, unread = len(rows), len(found.unread)
    for number, part in enumerate(found.parts):
        title = f"[bold]{escape(_named(files, found))}[/bold]: " if not number else ""
        console.print(f"{title}{part.form}, {counted(len(part), 'exposure')}")
        for name, value in part.facts.items():
            console.print(f"  {name}: {value}", markup=False)
        console.print(_sensor_line(part), markup=False)
        words = [f"{name} {value:.4g}" for name, value in _errors(part).items()]
        console.print("  errors: " + ("; ".join(words) if words else "none"), markup=False)
    above = "as in the file" if unstated is not None else "m above WGS 84" if has_datum else "m above the take-off"
    columns, caption = _columns(rows), f"height: {above}; angles: deg"
    caption += "; off: frame centre as reported, less that of the line of sight" if "range_off_m" in columns else ""
    console.print(number_table(rows[:SHOWN], columns, caption))
    if count > SHOWN:
        console.print(f"  ... and {count - SHOWN} more; --json and --output list all", markup=False)
    if unread:
        console.print(f"  {counted(unread, 'file')} could not be read; --json lists the reasons", markup=False)
    if "range_off_m" in rows[0]:
        console.print(_comparison(rows), markup=False)
    if unstated is not None:
        console.print("Vertical datum unknown: pass --camera-datum (below).", markup=False)
        console.print(f"  {as_typed(unstated)}", markup=False)
    if found.assumed:
        console.print("assumed:")
        for one in found.assumed:
            console.print(f"  - {as_typed(one)}", markup=False)


def _columns(rows: list[dict[str, Any]]) -> dict[str, tuple[str, str]]:
    """Headers and formats of the printed exposure table."""
    from jaxgeo.io._csv import ABOVE_TAKEOFF

    row, compared = rows[0], any(one.get("centre_lat_deg") is not None for one in rows)
    shown = {"name": ("name", ""), "lat_deg": ("lat, deg", ".7f"), "lon_deg": ("lon, deg", ".7f")}
    shown |= {name: ("height, m", ".2f") for name in ("height_m", ABOVE_TAKEOFF) if name in row}
    shown |= {f"{name}_deg": (name, ".2f") for name in ("heading", "pitch", "roll")}
    gimbal = [name for name in row if name.startswith("gimbal_")]
    shown |= {name: (name.removesuffix("_deg").replace("_", " "), ".2f") for name in gimbal}
    return shown | {name: (title, ".2f") for name, title in OFF.items() if name in row and compared}


def _sensor_line(found: jaxgeo.io.Acquisition) -> str:
    sensor = _sensor(found)
    if sensor is None:
        return "  sensor: none in this file"
    (fu, fv), (across, down) = sensor["focal_px"], sensor["field_of_view_deg"]
    gimbal = ", ".join(sensor["gimbal"])
    held = f"gimbal {gimbal} relative to the {sensor['gimbal_reference']}" if gimbal else "fixed, no gimbal"
    return (
        f"  sensor: {sensor['width']} x {sensor['height']} pixels, focal length {fu:.1f} x {fv:.1f} pixels, "
        f"field of view {across:.2f} x {down:.2f} deg, {held}"
    )


def _comparison(rows: list[dict[str, Any]]) -> str:
    """Percentiles of the differences to the reported range, frame centre and corners, over all exposures."""

    def middle(name: str, places: int) -> str:
        values = np.array([row[name] for row in rows if row[name] is not None])
        if not len(values):
            return "unknown"
        low, mid, high = np.percentile(values, [5.0, 50.0, 95.0])
        return f"{mid:+.{places}f} ({low:+.{places}f} to {high:+.{places}f})"

    if all(row["centre_lat_deg"] is None for row in rows):
        return "the file reports no frame centres to compare the lines of sight with"
    return (
        "comparison with the reported frame centre, medians (5 to 95 %): reported slant range minus computed: "
        f"{middle('range_off_m', 2)} m; line of sight off by {middle('axis_off_azimuth_mrad', 2)} mrad in azimuth, "
        f"{middle('axis_off_elevation_mrad', 2)} mrad in elevation: {middle('axis_off_east_m', 1)} m east, "
        f"{middle('axis_off_north_m', 1)} m north; reported corners rotated by {middle('image_off_turn_deg', 2)} deg"
    )

"""`jaxgeo scene`: a scene file of an exposure of another file."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer

from jaxgeo._destination import check_place
from jaxgeo.cli._acquisitions import ReadingOptions, reading_files
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._console import Console
from jaxgeo.cli._inputs import check_no_overwrite
from jaxgeo.cli._known_heights import TakeoffOptions, refuse_relative_heights
from jaxgeo.cli._option_names import as_typed
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import print_note, print_written
from jaxgeo.sensor import Shot


def scene_command(
    file: Annotated[
        pathlib.Path, typer.Argument(metavar="FILE", help="Drone image, KLV, SBET, table, reconstruction; or a scene.")
    ],
    output: Annotated[
        pathlib.Path, typer.Option("--output", "-o", metavar="FILE", help="Scene file to write (.toml).")
    ],
    exposure: Annotated[
        str | None, typer.Option("--exposure", metavar="NAME", help="Exposure name, if FILE has several.")
    ] = None,
    scene: Annotated[
        pathlib.Path | None,
        typer.Option("--scene", metavar="FILE", help="Scene file (TOML) with the camera of a FILE without one."),
    ] = None,
    reading: ReadingOptions = ReadingOptions(),
    of_takeoff: TakeoffOptions = TakeoffOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Write a scene file of an exposure: camera, gimbal, mount, pose and its errors, to be edited or used again."""
    inputs = given_options(locals())
    with report_errors(debug):
        if output.suffix.lower() != ".toml":
            raise UserError(f"--output {output}: {name_says(output)}; use .toml.")
        check_place("--output", output)
        read = [file, scene, reading.positions, reading.errors, reading.interior]
        check_no_overwrite("--output", output, read)
        name, said = write_scene_of(file, output, exposure, scene, of_takeoff.known(reading, [file], scene))
        print_written(output)
        if as_json:
            print_json("scene", {"inputs": inputs, "exposure": name, "assumed": said})
            return
        Console().print(f"{name} -> {output}", highlight=False, markup=False, soft_wrap=True)


def write_scene_of(
    file: pathlib.Path,
    output: pathlib.Path,
    exposure: str | None,
    scene: pathlib.Path | None,
    reading: ReadingOptions,
) -> tuple[str, list[str]]:
    """Write the scene of an exposure; returns (its name, assumptions), which are printed on stderr, too.

    Raises `UserError`, also for heights above a take-off of unknown height.
    """
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import read_observations, write_scene

    enable_x64()
    given: dict[str, Any] = {"exposures": () if exposure is None else (exposure,), **reading.known_arguments}
    with reading_files([file]):
        observed = read_observations(file, scene=scene, **given)
    names = [str(row.get("name", file.name)) for row in observed.columns]
    if len(names) != 1:
        some = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise UserError(f"{file} has {len(names)} exposures: {some}. Name one with --exposure {names[0]}.")
    observation, sources = observed.at(0)
    look = observation.exposure
    refuse_relative_heights(reading, "a scene")
    assumed = list(map(as_typed, observed.assumed)) + [sentence for _, sentence in observed.assumed_errors]
    named = file.name if names[0] == file.name else f"{names[0]} of {file.name}"
    comment = "\n".join([named, *(f"assumed: {one}" for one in assumed)])
    assert isinstance(look.motion, Shot)
    left_out = write_scene(
        output, look.sensor, look.motion, sources=sources, atmosphere=look.atmosphere, comment=comment
    )
    print_assumed(assumed)
    for one in left_out:
        print_note(one)
    return names[0], [*assumed, *left_out]

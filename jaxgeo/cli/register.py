"""`jaxgeo register`: the pose of an image from a map, and how sure every pixel then is."""

from __future__ import annotations

import pathlib
import time
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console

from jaxgeo.cli._common import Traceback, compile_quickly, mistakes_told
from jaxgeo.cli._inputs import read_terrain, shot_of, terrain_files
from jaxgeo.cli._options import DemFiles, SceneFile, VerticalDatum
from jaxgeo.cli._registering import (
    Errors,
    Sigmas,
    check_search,
    errors_of,
    fixes_of,
    new_results,
    picture_of,
    pixels_in,
    prepared_folder,
    seen_part,
)
from jaxgeo.cli._screen import number_table, stderr, tell

UNKNOWNS = {
    "name": ("error of", ""),
    "unit": ("unit", ""),
    "change": ("change", ".5g"),
    "sigma_before": ("sigma before", ".3g"),
    "sigma_after": ("after", ".3g"),
}
FIXES = {
    "column": ("column", ".1f"),
    "row": ("row", ".1f"),
    "by": ("by", ""),
    "lat_deg": ("lat, deg", ".7f"),
    "lon_deg": ("lon, deg", ".7f"),
    "height_m": ("height, m", ".2f"),
    "ce90_m": ("CE90, m", ".2f"),
    "status": ("status", ""),
}


class Work(NamedTuple):
    """What is registered with what."""

    image: pathlib.Path
    values: Any
    known: Any
    scene_path: pathlib.Path
    scene: Any
    shot: Any
    reference: Any
    raster: Any
    terrain: Any
    bands: list[int] | None


def register_command(
    image: Annotated[pathlib.Path, typer.Argument(help="Image file, of the size of the scene's camera.")],
    reference: Annotated[pathlib.Path, typer.Option(help="Orthoimage of the same ground, on any map.")],
    dem: DemFiles,
    scene: SceneFile,
    output: Annotated[pathlib.Path, typer.Option(help="Folder for the results; made if it is not there.")],
    position_sigma: Annotated[str, typer.Option(help="How the position errs: m, or NORTH,EAST,DOWN.")],
    attitude_sigma: Annotated[str, typer.Option(help="How the attitude errs: deg, or HEADING,PITCH,ROLL.")],
    gimbal_sigma: Annotated[
        str | None, typer.Option(help="How the gimbal's readings err: deg, or one for each; exact if left out.")
    ] = None,
    focal_sigma: Annotated[
        str | None, typer.Option(help="Also find focal length and principal point, which err by so much: 5px, 0.1mm.")
    ] = None,
    reference_sigma: Annotated[
        float | None,
        typer.Option(
            help="By how much the whole reference may be off, m; one cell if left out. Nothing in one image can tell "
            "it: the figure is your guarantee."
        ),
    ] = None,
    registration_sigma: Annotated[
        float, typer.Option(help="Least error of a match beside its own, m; residuals raise it.")
    ] = 0.0,
    dem_sigma: Annotated[
        float | None, typer.Option(help="How heights of the elevation model err, m; 5 if left out.")
    ] = None,
    dem_correlation: Annotated[
        float | None,
        typer.Option(help="Over which distance these errors are alike, m; 500 if left out, 0 if each errs for itself."),
    ] = None,
    vertical_datum: VerticalDatum = None,
    block: Annotated[int, typer.Option(help="Cells on a side of a block, at most; 32 or more.")] = 300,
    probability: Annotated[
        float, typer.Option(help="With which a shift lies in what is searched; between 0.5 and 1.")
    ] = 0.999,
    pixel: Annotated[
        list[str] | None, typer.Option(help="COLUMN,ROW of a pixel to fix; repeat it for more; else the middle.")
    ] = None,
    band: Annotated[list[int] | None, typer.Option(help="Band of the image, from 1; repeat it for more.")] = None,
    reference_band: Annotated[list[int] | None, typer.Option(help="The same of the reference.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    traceback: Traceback = False,
) -> None:
    """Find the pose of an image from a map, and say how sure each pixel's ground point then is.

    Writes scene.toml, ties.geojson, ortho.tif, report.json and registration.png into the folder. The exit code is 1
    where the image is not registered: then there is no scene and no orthoimage, and the report says why.
    """
    with mistakes_told(traceback):
        from jaxgeo.io.paths import files_behind
        from jaxgeo.io.registration_report import write_registration_report

        check_search(block, probability)
        began = time.perf_counter()
        sigmas = Sigmas(
            position_sigma,
            attitude_sigma,
            gimbal_sigma,
            focal_sigma,
            reference_sigma,
            registration_sigma,
            dem_sigma,
            dem_correlation,
        )
        work, errors, pixels = _read(
            image, reference, (dem, vertical_datum), scene, sigmas, pixel or [], (band, reference_band)
        )
        files = [*files_behind(image), *files_behind(reference), scene, *terrain_files(dem, vertical_datum)]
        prepared_folder(output, files)
        for one in errors.assumed:
            tell(f"assumed: {one}")
        with stderr().status("registering ..."):
            found = _registered(work, errors, block, probability)
        found_by = time.perf_counter() - began
        paths = {"image": image, "scene": scene, "reference": reference}
        inputs = {name: str(path) for name, path in paths.items()} | {"dem": [str(path) for path in dem]}
        inputs |= {"sigmas": sigmas._asdict(), "block": block, "probability": probability}
        with new_results(output):
            content = _written(work, errors, pixels, found, output) | {"inputs": inputs}
            content["seconds"] = {"registration": found_by, "all": time.perf_counter() - began}
            write_registration_report(output / "report.json", content)
        _reported(content, output, found, as_json)
    if not found.accepted:
        raise typer.Exit(1)


def _read(
    image: pathlib.Path,
    reference_path: pathlib.Path,
    ground: tuple[list[pathlib.Path], str | None],
    scene_path: pathlib.Path,
    sigmas: Sigmas,
    pixels: list[str],
    bands: tuple[list[int] | None, list[int] | None],
) -> tuple[Work, Errors, list[list[float]]]:
    """All input, what is small and likely to be mistaken first."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import read_image, read_orthoimage_and_report
    from jaxgeo.io.images import check_size
    from jaxgeo.io.orthoimages import raster_of_file
    from jaxgeo.io.scene import read_scene

    compile_quickly()
    enable_x64()
    scene = read_scene(scene_path)
    shot = shot_of(scene, scene_path, "a registration")
    errors_of(sigmas, scene, scene_path, 1.0)  # for mistakes
    uv = pixels_in(pixels, scene.sensor.camera)
    raster_of_file(reference_path)
    values, known = read_image(image, bands[0])
    check_size(str(image), values.shape, scene.sensor.camera)
    reference, report = read_orthoimage_and_report(reference_path, bands[1])
    terrain = read_terrain(*ground)
    errors = errors_of(sigmas, scene, scene_path, reference.ground_sampling)
    work = Work(image, values, known, scene_path, scene, shot, reference, report.raster, terrain, bands[0])
    return work, errors, uv


def _registered(work: Work, errors: Errors, block: int, probability: float) -> Any:
    from jaxgeo.register import register
    from jaxgeo.uncertainty import ErrorModel

    return register(
        work.scene.sensor,
        work.shot,
        work.values,
        work.reference,
        work.terrain,
        ErrorModel(errors.sources),
        errors.tie_errors,
        known=work.known,
        block=block,
        probability=probability,
        atmosphere=work.scene.atmosphere,
    )


def _written(work: Work, errors: Errors, pixels: list[list[float]], found: Any, folder: pathlib.Path) -> dict[str, Any]:
    """All files but the report, and what that is to hold."""
    from jaxgeo.io import write_tie_points, write_updated_scene
    from jaxgeo.io.registration_report import fix_report, report_of, tie_rows, versions
    from jaxgeo.register.places import places_of_blocks

    content = report_of(found) | {"assumed": errors.assumed, "versions": versions()}
    fixes = fixes_of(work.scene, work.shot, work.terrain, errors, found, pixels)
    content["pixels"] = [
        {"column": uv[0], "row": uv[1], "before": fix_report(direct), "after": fix_report(updated)}
        for uv, direct, updated in fixes
    ]
    written = []
    if found.accepted:
        write_updated_scene(folder / "scene.toml", work.scene_path, found.shot, found.sensor)
        written.append("scene.toml")
        content["ortho"] = _ortho(work, found, folder / "ortho.tif")
        written.append("ortho.tif")
    rows = tie_rows(found, places_of_blocks(found, atmosphere=work.scene.atmosphere)) if found.passes else []
    if rows:
        write_tie_points(folder / "ties.geojson", rows)
        written.append("ties.geojson")
    if _pictured(work, errors, found, fixes[0], folder / "registration.png"):
        written.append("registration.png")
    return content | {"files": written}


def _ortho(work: Work, found: Any, path: pathlib.Path) -> dict[str, Any]:
    """The image on the very cells of the reference, as far as it reaches there."""
    from jaxgeo.io import MapRaster, rectify_file

    air = work.scene.atmosphere
    part = seen_part(found.sensor, found.shot, found.terrain, air, work.reference)
    assert part is not None
    (row, col), shape = part
    whole = work.raster.transform
    raster = MapRaster(work.raster.crs, whole @ type(whole).translation(col, row), shape)
    done = rectify_file(
        path,
        work.image,
        found.sensor,
        found.shot,
        found.terrain,
        like=raster,
        bands=work.bands,
        progress=True,
        atmosphere=air,
    )
    return {
        "rows": shape[0],
        "columns": shape[1],
        "known": done.known,
        "cells": {status.name: count for status, count in done.counts.items()},
    }


def _pictured(work: Work, errors: Errors, found: Any, fix: Any, path: pathlib.Path) -> bool:
    """Draw the page of figures; whether there is one."""
    import numpy as np

    grey = np.asarray(work.values, np.float32).mean(axis=0, keepdims=True)
    look = (work.scene.sensor, work.shot, work.terrain, work.scene.atmosphere)
    try:
        figure = picture_of(found, work.reference, look, (grey, work.known), errors, fix)
    except ImportError as error:
        tell(f"there is no picture, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        return False
    if figure is None:
        return False
    figure.suptitle(f"{work.image.name}: {found.outcome.name.replace('_', ' ')}", fontsize=13)
    figure.savefig(path, dpi=150)
    return True


def _reported(content: dict[str, Any], folder: pathlib.Path, found: Any, as_json: bool) -> None:
    """The report on the screen."""
    from jaxgeo.io.registration_report import as_json as json_of

    if as_json:
        typer.echo(json_of(content), nl=False)
        return
    console = Console(width=None if Console().is_terminal else 160)
    console.print(f"{found}", highlight=False, markup=False, soft_wrap=True)
    if "unknowns" in content:
        rows = [{**one, "status": "hit"} for one in content["unknowns"]]
        ties = content["ties"]
        caption = (
            f"{ties['count']} ties, residuals {ties['residuals_rms_px']:.2f} px, sigma0 {ties['sigma0_ties']:.2f}; "
            f"a match errs by {ties['registration_sigma_m']:.3g} m on the map"
        )
        console.print(number_table(rows, UNKNOWNS, caption))
    console.print(number_table(_fix_rows(content["pixels"]), FIXES, "CE90: radius that holds the point with 90 %"))
    names = ", ".join([*content["files"], "report.json"])
    console.print(f"{folder}: {names}; {content['seconds']['all']:.1f} s", highlight=False, soft_wrap=True)


def _fix_rows(pixels: list[dict[str, Any]]) -> list[dict[str, Any]]:
    rows = []
    for one in pixels:
        for by, fix in (("navigation", one["before"]), ("registration", one["after"])):
            if fix["status"] is not None:
                numbers = {name: fix.get(name) for name in ("lat_deg", "lon_deg", "height_m", "ce90_m", "status")}
                rows.append({"column": one["column"], "row": one["row"], "by": by, **numbers})
    return rows

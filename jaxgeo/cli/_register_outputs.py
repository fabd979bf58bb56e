"""Output files and report of `jaxgeo register`."""

from __future__ import annotations

import pathlib
from typing import Any, NamedTuple

from jaxgeo.cli._console import Console
from jaxgeo.cli._register_inputs import Errors, fixes_of, picture_of, seen_part
from jaxgeo.cli._results import print_json
from jaxgeo.cli._screen import bars_on_stderr, number_table, print_message

UNKNOWNS = {
    "name": ("parameter", ""),
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
    """Image, scene, reference and terrain of one registration."""

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


def write_results(
    work: Work, errors: Errors, pixels: list[list[float]], found: Any, folder: pathlib.Path
) -> dict[str, Any]:
    """Write all files except the report; returns the report content."""
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
    if _write_figure(work, errors, found, fixes[0], folder / "registration.png"):
        written.append("registration.png")
    return content | {"files": written}


def _ortho(work: Work, found: Any, path: pathlib.Path) -> dict[str, Any]:
    """Orthoimage on the cell grid of the reference, over their overlap."""
    from jaxgeo.io import MapRaster, rectify_file

    air = work.scene.atmosphere
    part = seen_part(found.sensor, found.shot, found.terrain, air, work.reference)
    assert part is not None
    (row, col), shape = part
    whole = work.raster.transform
    raster = MapRaster(work.raster.crs, whole @ type(whole).translation(col, row), shape)
    with bars_on_stderr() as is_shown:
        done = rectify_file(
            path,
            work.image,
            found.sensor,
            found.shot,
            found.terrain,
            like=raster,
            bands=work.bands,
            progress=is_shown,
            atmosphere=air,
        )
    return {
        "rows": shape[0],
        "columns": shape[1],
        "known": done.known,
        "cells": {status.name: count for status, count in done.counts.items()},
    }


def _write_figure(work: Work, errors: Errors, found: Any, fix: Any, path: pathlib.Path) -> bool:
    """Write the registration figure; returns whether there is one."""
    import numpy as np

    grey = np.asarray(work.values, np.float32).mean(axis=0, keepdims=True)
    look = (work.scene.sensor, work.shot, work.terrain, work.scene.atmosphere)
    try:
        figure = picture_of(found, work.reference, look, (grey, work.known), errors, fix)
    except ImportError as error:
        print_message(f"no figure: matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        return False
    if figure is None:
        return False
    figure.suptitle(f"{work.image.name}: {found.outcome.name.replace('_', ' ')}", fontsize=13)
    figure.savefig(path, dpi=150)
    return True


def print_report(content: dict[str, Any], folder: pathlib.Path, found: Any, as_json: bool) -> None:
    """Print the report."""
    if as_json:
        print_json("register", content)
        return
    console = Console(width=None if Console().is_terminal else 160)
    console.print(f"{found}", highlight=False, markup=False, soft_wrap=True)
    if "unknowns" in content:
        rows = [{**one, "status": "hit"} for one in content["unknowns"]]
        ties = content["ties"]
        caption = (
            f"{ties['count']} ties, residuals {ties['residuals_rms_px']:.2f} px, sigma0 {ties['sigma0_ties']:.2f}; "
            f"match sigma {ties['registration_sigma_m']:.3g} m on the map"
        )
        console.print(number_table(rows, UNKNOWNS, caption))
    console.print(number_table(_fix_rows(content["pixels"]), FIXES, "CE90: radius of the 90 % horizontal circle"))
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

"""Output files and summary of `jaxgeo adjust`."""

from __future__ import annotations

import pathlib
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo.cli import _adjust_control as of_control
from jaxgeo.cli._adjust_rigs import rows_of_cameras
from jaxgeo.cli._common import UserError
from jaxgeo.cli._console import Console
from jaxgeo.cli._screen import number_table, print_note

if TYPE_CHECKING:
    from jaxgeo.ties import Correction, Ties, Views

IMAGES = {
    "image": ("image", ""),
    "east_m": ("east, m", ".3f"),
    "north_m": ("north, m", ".3f"),
    "up_m": ("up, m", ".3f"),
    "turned_deg": ("turned, deg", ".3f"),
    "sigmas": ("sigmas", ".1f"),
    "ties": ("ties", "d"),
}
CAPTION = (
    "east, north, up: movement of the perspective centre; turned: change of the attitude; sigmas: larger of both in "
    "standard deviations of the navigation"
)
TABLES = "orientations.csv", "ties.csv"
OPENSFM = "opensfm/reconstruction.json"
COLMAP = "colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt"
CONTROL = "control.csv"
PAGE = "report.html"
METASHAPE = "metashape/cameras.xml"
FILES = *TABLES, CONTROL, PAGE, OPENSFM, *COLMAP, METASHAPE
SHOWN = 30  # images in the table on the screen
SHOWN_BARE = 5  # pairs without ties there


def write_files(folder: pathlib.Path, found: Correction, crs: str | None) -> list[str]:
    """Write the tables and the models of OpenSfM, COLMAP and Metashape; a note for a lens that one lacks.

    Names of the files.
    """
    from jaxgeo.io import (
        orientations_of,
        write_colmap,
        write_control,
        write_image_ties,
        write_metashape_cameras,
        write_opensfm,
        write_orientations,
    )
    from jaxgeo.io.errors import UnwritableLens

    folder.mkdir(parents=True, exist_ok=True)
    adjustment, written = found.adjustment, [*TABLES]
    write_orientations(folder / TABLES[0], orientations_of(adjustment), crs=crs)
    write_image_ties(folder / TABLES[1], adjustment)
    if found.control_residuals is not None:
        write_control(folder / CONTROL, found.control_residuals)
        written.append(CONTROL)
    for model in (OPENSFM, METASHAPE):
        (folder / model).parent.mkdir(exist_ok=True)
    models = (
        ([OPENSFM], lambda: write_opensfm(folder / OPENSFM, adjustment)),
        ([*COLMAP], lambda: write_colmap((folder / COLMAP[0]).parent, adjustment)),
        ([METASHAPE], lambda: write_metashape_cameras(folder / METASHAPE, adjustment)),
    )
    for names, write in models:
        try:
            write()
        except UnwritableLens as error:
            print_note(f"not written: {names[0]}: {error}")
            continue
        written += names
    return written


def locate_command(folder: pathlib.Path, written: list[str], crs: str | None) -> str | None:
    """The command, without its elevation model, that locates pixels with the orientations, cameras and standard
    deviations of the output; None if no model has the cameras."""
    if OPENSFM not in written:
        return None
    words = ["jaxgeo", "locate", f"{folder / TABLES[0]}", "--camera", f"{folder / OPENSFM}"]
    return shlex.join([*words, *([] if crs is None else ["--source-crs", crs])])


def check_report() -> None:
    """Raises `UserError` where the packages of pages are missing."""
    try:
        import jaxgeo.report  # noqa: F401
    except ImportError as error:
        raise UserError(f"--report: {error}") from error


def write_page(
    folder: pathlib.Path, found: Correction, terrain: Any, inputs: dict[str, Any], assumed: list[str]
) -> str:
    """Write the report page. Its name."""
    from jaxgeo.report import ReportHeader, write_correction_report
    from jaxgeo.report.correction import TITLE

    given = {name: value for name, value in inputs.items() if value is not None and value != []}
    header = ReportHeader(TITLE, inputs=given, assumed=assumed)
    write_correction_report(folder / PAGE, found, terrain, header=header)
    return PAGE


def content_of(views: Views, ties: Ties, found: Correction | None, files: list[str], seconds: float) -> dict[str, Any]:
    """Content of --json."""
    count = 0 if ties.observations is None else len(np.unique(ties.observations.point))
    content: dict[str, Any] = {
        "images": len(views),
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "overlap": pair.overlap,
                "points": {outcome.name: number for outcome, number in pair.counts.items()},
            }
            for pair in ties.pairs
        ],
        "tie_points": count,
        "unconnected": ties.unconnected if found is None else found.unconnected,
        "seconds": seconds,
    }
    if found is None:
        return content
    adjustment = found.adjustment
    observed = adjustment.block.observations
    degrees = np.rad2deg(np.linalg.norm(found.turned, axis=1))
    rows = [
        {
            "image": name,
            "east_m": float(found.moved[k, 0]),
            "north_m": float(found.moved[k, 1]),
            "up_m": float(found.moved[k, 2]),
            "turned_deg": float(degrees[k]),
            "sigmas": float(found.sigmas[k]),
            "ties": int(np.count_nonzero(observed.image == name)),
        }
        for k, name in enumerate(found.names)
    ]
    if found.control_residuals is not None:
        content["control"] = {
            "added_sigma_px": found.excess_of_control,
            "points": of_control.rows_of_points(found.control_residuals),
            "left_out": [
                {"point": one.point, "image": one.image or None, "standardised": one.standardised, "words": f"{one}"}
                for one in found.blunders
            ],
        }
    return content | {
        "measurements": {"used": len(observed), "left_out": found.left_out},
        "residuals_rms_px": {"before": found.rms_before, "after": found.rms_after},
        "sigma_px": float(np.median(observed.sigma)),
        "adjusted": rows,
        "moved_rms_m": float(np.sqrt(np.mean(np.sum(found.moved**2, axis=1)))),
        "turned_rms_deg": float(np.sqrt(np.mean(degrees**2))),
        "sigma_of_mean_position_m": found.sigma_of_mean.tolist(),
        "doubtful": found.doubtful,
        "relative_orientations": rows_of_cameras(found),
        "registered": [] if found.map_control is None else found.map_control.names,
        "registrations_refused": found.refused,
        "parameters": [
            {
                "of": "navigation" if p.name == "time offset" else p.whose,
                "name": p.name,
                "value": p.value,
                "sigma": p.sigma,
                "unit": p.unit,
            }
            for p in adjustment.parameters
        ],
        "words": found.words().splitlines(),
        "files": files,
    }


def print_summary(content: dict[str, Any], found: Correction | None) -> None:
    """Print the summary on stdout."""
    console = Console(width=None if Console().is_terminal else 160)

    def say(words: str) -> None:
        console.print(words, highlight=False, markup=False, soft_wrap=True)

    tied = sum(pair["points"].get("tied", 0) > 0 for pair in content["pairs"])
    say(
        f"{content['images']} images, {len(content['pairs'])} pairs, {tied} of them with ties; "
        f"{content['tie_points']} tie points"
    )
    bare = [pair for pair in content["pairs"] if not pair["points"].get("tied", 0)]
    for pair in bare[:SHOWN_BARE]:
        why = ", ".join(f"{count} {outcome.replace('_', ' ')}" for outcome, count in pair["points"].items() if count)
        say(f"without ties: {pair['first']} and {pair['second']} ({why or 'no points'})")
    if len(bare) > SHOWN_BARE:
        say(f"and {len(bare) - SHOWN_BARE} more pairs without ties")
    if found is None:
        say("Nothing is adjusted: no two images share enough tie points. Check navigation, datums and --dem-sigma.")
        return
    rms = content["residuals_rms_px"]
    say(
        f"residuals: {rms['before']:.2f} px before, {rms['after']:.2f} px after (RMS per axis of the same measurements)"
    )
    used = content["measurements"]
    say(f"measurements: {used['used']} used, {used['left_out']} left out")
    say(f"moved by {content['moved_rms_m']:.3g} m, turned by {content['turned_rms_deg']:.3g} deg (RMS)")
    console.print(number_table(content["adjusted"][:SHOWN], IMAGES, CAPTION))
    if "control" in content:
        points = content["control"]["points"]
        console.print(number_table(points[:SHOWN], of_control.COLUMNS, of_control.CAPTION))
    for one in content["parameters"]:
        say(f"{one['of']} {one['name']}: {one['value']:.7g} +- {one['sigma']:.3g} {one['unit']}")
    say(found.words())
    if "mosaic" in content:
        one = content["mosaic"]
        share = 100.0 * one["known"] / (one["rows"] * one["columns"])
        say(
            f"{one['file']}: {one['rows']} rows of {one['columns']} cells of {one['transform'][0]:.6g}, {one['crs']}; "
            f"{share:.0f} % of them known"
        )
    if content.get("locate"):
        say(f"pixels by these orientations, cameras and standard deviations: {content['locate']} --dem DEM")
    say(f"{', '.join(content['files'])}; {content['seconds']:.1f} s")

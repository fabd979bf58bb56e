"""`jaxgeo report`: ground coordinates of pixels and their accuracy, as one self-contained HTML page."""

from __future__ import annotations

import dataclasses
import pathlib
from collections import Counter
from typing import Annotated, Any, ClassVar, TextIO

import typer

from jaxgeo._destination import check_place, destination, is_device
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._archive_dem import messages
from jaxgeo.cli._assumed import assumed_shares, told_shares
from jaxgeo.cli._cluster import ClusterOptions
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._locate_inputs import LocateInputs, read_inputs, states_errors
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions, Refraction
from jaxgeo.cli._locate_results import exit_without_fix, locate_inputs
from jaxgeo.cli._options import WRITING, OptionGroup, Probability
from jaxgeo.cli._results import AsJson, print_json
from jaxgeo.cli._screen import print_counts, print_note, print_written, working
from jaxgeo.fix import Fix

ENDINGS = (".html", ".htm")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PageOptions(OptionGroup):
    """The page and its content."""

    panel: ClassVar[str | None] = WRITING

    title: Annotated[
        str | None,
        typer.Option("--title", metavar="TEXT", help="Page title (default: from the scene or file)."),
    ] = None
    details: Annotated[
        int,
        typer.Option(
            "--details",
            metavar="COUNT",
            help="Number of fixes shown in detail (median, worst, best CE90 first).",
        ),
    ] = 3


def report_command(
    output: Annotated[
        pathlib.Path,
        typer.Option("--output", "-o", metavar="FILE", help="HTML page to write (.html).", rich_help_panel=WRITING),
    ],
    of_images: ObservationOptions,
    ground: GroundOptions,
    *,
    probability: Probability = 0.9,
    sigmas: Sigmas,
    refraction: Refraction = False,
    reading: ReadingOptions,
    page: PageOptions,
    many: ClusterOptions,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Write a self-contained HTML page: map, fixes and their accuracy, error budgets, and assumptions."""
    with report_errors(debug):
        _check_report(output, probability, page.details)
        many.check()
        options = LocateOptions(of_images, ground, reading, sigmas, refraction)
        _ = reading.arguments  # raises for wrong values
        with destination("--output", output) as stream:
            inputs, fixes = _report(options, probability, output, stream, page, many, as_json)
        print_written(output)
        exit_without_fix(inputs, fixes)


def _check_report(output: pathlib.Path, probability: float, details: int) -> None:
    if not is_device(output):
        check_place("--output", output)
        if output.suffix.lower() not in ENDINGS:
            raise UserError(f"--output {output}: {name_says(output)}; use .html.")
    if not 0.0 < probability < 1.0:
        raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
    if details < 0:
        raise UserError(f"--details {details}: must be a number of fixes, 0 or more.")


def _report(
    options: LocateOptions,
    probability: float,
    output: pathlib.Path,
    stream: TextIO,
    page: PageOptions,
    many: ClusterOptions,
    as_json: bool,
) -> tuple[LocateInputs, Fix]:
    from jaxgeo._checks import enable_x64

    with working("starting"):
        from jaxgeo.report import ReportData, ReportHeader, details_of, report_html
    compile_quickly(options.has_terrain_field)
    enable_x64()
    inputs = read_inputs(options, states_errors(options), output)
    observed, reasons = inputs.observed, inputs.reasons
    if many.cluster is None:
        fixes, accuracy = locate_inputs(inputs, probability)
    else:
        from jaxgeo.cluster import fixes_of_frames

        with many.connected() as client:
            how = {"accuracy": inputs.has_errors, "probability": probability, "progress": many.shows_progress}
            fixes, accuracy = fixes_of_frames(observed, inputs.grounds, client=client, **how)
    if not inputs.has_errors:
        observed = observed.with_sources([()] * len(observed.batches))
    subject = ReportData.of_observations(observed, inputs.grounds, fixes, accuracy, probability)
    with working("computing details"):
        details = details_of(subject, most=page.details)
    assumed = [*inputs.assumed, *messages(), *(f"Not read: {reason}" for reason in reasons or () if reason is not None)]
    shares = assumed_shares(inputs, accuracy)
    said = told_shares(shares, probability, count=len(observed))
    header = ReportHeader(page.title or _title(options), _inputs(options), assumed, notice=said or "")
    with working("drawing"):
        stream.write(report_html(subject, header=header, details=details, images=_images(options, observed)))
    rows = observed.table(fixes, accuracy, reasons=reasons)
    if said is not None:
        print_note(said)
    print_counts(Counter(row["status"] for row in rows), len(rows))
    if as_json:
        content = {
            "assumed_variance_shares": shares,
            "fixes": rows,
            "details": [detail.to_dict() for detail in details],
        }
        print_json("report", {"inputs": options.inputs, "assumed": inputs.assumed, **content})
    return inputs, fixes


def _images(options: LocateOptions, observed: Any) -> dict[int, pathlib.Path]:
    """The image files of drone images, by pixel of the page."""
    from jaxgeo.io.acquisitions.several import files_of
    from jaxgeo.io.observation_reader import IMAGE_ENDINGS

    if options.is_scene:
        return {}
    files = [pathlib.Path(one) for one in files_of(options.files)[0]]
    by_name = {one.name: one for one in files if one.suffix.lower() in IMAGE_ENDINGS}
    names = [str(observed.columns[row].get("name")) for row in observed.read_rows.tolist()]
    return {index: by_name[name] for index, name in enumerate(names) if name in by_name}


def _title(options: LocateOptions) -> str:
    """Title of the scene, or one with the file name."""
    from jaxgeo.io.scene import read_scene

    if not options.is_scene:
        more = f" and {len(options.files) - 1} more" if len(options.files) > 1 else ""
        return f"Ground coordinates and accuracy: {options.files[0].name}{more}"
    path = options.scene_file
    assert path is not None
    return read_scene(path).title or f"Ground coordinates and accuracy: {path.name}"


def _inputs(options: LocateOptions) -> dict[str, Any]:
    """The options as typed, with pixels and exposures."""
    named = {"pixel": " and ".join(options.pixels), "exposure": ", ".join(options.of_images.exposures or ())}
    return options.inputs | {name: text for name, text in named.items() if text}

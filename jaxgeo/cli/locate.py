"""`jaxgeo locate`: ground coordinates of pixels and their accuracy."""

from __future__ import annotations

import dataclasses
import functools
import math
import pathlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from typing import Annotated, Any, ClassVar, TextIO

import typer

import jaxgeo
from jaxgeo._destination import check_place, destination, is_device
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._assumed import assumed_shares, assumed_shares_of_files, told_shares
from jaxgeo.cli._cluster import PartsOptions, print_missing, report_failed_parts
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.cli._locate_inputs import LocateInputs, read_inputs
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions, Refraction
from jaxgeo.cli._locate_results import exit_without_fix, fixes_as_computed, fixes_table, locate_inputs, outlines_of
from jaxgeo.cli._option_names import reason_not_read
from jaxgeo.cli._options import SURE, WRITING, OptionGroup, Probability
from jaxgeo.cli._results import AsJson, print_json
from jaxgeo.cli._screen import print_counts, print_message, print_note, print_written
from jaxgeo.status import Status, counts_as_fix

STYLED = (".gpkg", ".geojson", ".json")
ENDINGS = (".csv", ".geojson", ".json", ".gpkg", ".parquet", ".kml", ".kmz", ".gpx")
Row = dict[str, Any]


class Format(StrEnum):
    """Output format for the terminal, a pipe, or a file of any name."""

    table = "table"
    csv = "csv"
    geojson = "geojson"


OF_FORMAT = {Format.table: (".csv",), Format.csv: (".csv",), Format.geojson: (".geojson", ".json")}


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutputOptions(OptionGroup):
    """File or terminal format, and coordinates of a file."""

    panel: ClassVar[str | None] = WRITING

    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help=f"File to write ({', '.join(ENDINGS)}), or FOLDER with --cluster; default: the terminal.",
        ),
    ] = None
    format: Annotated[
        Format | None,
        typer.Option("--format", help="Terminal format (default: table, or csv for --shots).", show_default=False),
    ] = None
    crs: Annotated[
        str,
        typer.Option("--crs", metavar="CRS", help='CRS of the --output: "EPSG:4326", "EPSG:32616", ...'),
    ] = "EPSG:4326"
    heights: Annotated[
        str | None,
        typer.Option(
            "--heights", metavar="DATUM", help='Vertical datum of the --output: "ellipsoid", "EPSG:5773", ...'
        ),
    ] = None
    mgrs: Annotated[bool, typer.Option("--mgrs", help="With --output: also MGRS coordinates.")] = False
    style: Annotated[
        bool,
        typer.Option(
            "--style", help="With --output .gpkg or .geojson: also a style for QGIS, in it or beside it (.qml)."
        ),
    ] = False

    @property
    def is_file(self) -> bool:
        """Whether the output is a file whose extension determines its format."""
        return self.output is not None and not is_device(self.output) and self.format is None

    @property
    def drawn(self) -> dict[str, Any]:
        """Arguments of `write_fixes`."""
        return {"crs": self.crs, "heights": self.heights, "mgrs": self.mgrs}

    def check(self) -> None:
        """Raises `UserError` for options that contradict each other, and as `check_place`."""
        output = self.output
        if output is not None and not is_device(output):
            check_place("--output", output)
            ending = output.suffix.lower()
            if self.format is None and ending not in ENDINGS:
                raise UserError(
                    f"--output {output}: {name_says(output)}; use {', '.join(ENDINGS)}, or give --format table, csv or "
                    f"geojson."
                )
            if self.format is not None and ending in ENDINGS and ending not in OF_FORMAT[self.format]:
                raise UserError(f"--format {self.format.value} conflicts with --output {output}; leave one out.")
        if self.style and (output is None or output.suffix.lower() not in STYLED or not self.is_file):
            raise UserError(f"--style needs --output FILE ({', '.join(STYLED)}).")
        if not self.is_file and (self.crs != "EPSG:4326" or self.heights is not None or self.mgrs):
            raise UserError(f"--crs, --heights and --mgrs need --output FILE ({', '.join(ENDINGS)}).")

    def format_of_rows(self, shots: pathlib.Path | None) -> Format:
        """Format of rows on the terminal or a pipe, whose name may have an extension."""
        by_name = {".csv": Format.csv, ".geojson": Format.geojson, ".json": Format.geojson}
        usual = Format.table if shots is None else Format.csv
        return self.format or (usual if self.output is None else by_name.get(self.output.suffix.lower(), usual))


def locate_command(
    of_images: ObservationOptions,
    ground: GroundOptions,
    *,
    accuracy: Annotated[
        bool | None,
        typer.Option(
            "--accuracy/--no-accuracy",
            help="Report CE/LE/SE; on by default if the input states errors, except for --shots.",
            show_default=False,
            rich_help_panel=SURE,
        ),
    ] = None,
    probability: Probability = 0.9,
    sigmas: Sigmas,
    refraction: Refraction = False,
    reading: ReadingOptions,
    writing: OutputOptions,
    many: PartsOptions,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Ground coordinates of pixels and their accuracy: one row per pixel, with a status."""
    with report_errors(debug):
        options = LocateOptions(of_images, ground, reading, sigmas, refraction)
        _ = reading.arguments  # raises for wrong values
        if not 0.0 < probability < 1.0:
            raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
        if accuracy is False and sigmas.given:
            raise UserError("--no-accuracy contradicts standard deviations (--...-sigma); leave one out.")
        if many.cluster is not None:
            if of_images.detections is not None:
                raise UserError(f"--detections {of_images.detections} and --cluster do not go together; leave one out.")
            many.check_parts(True, format=writing.format is not None, style=writing.style)
            _locate_on_cluster(options, accuracy, probability, writing, many, as_json)
            return
        many.check_parts(False)
        writing.check()
        if writing.is_file or as_json:
            _locate_all(options, accuracy, probability, writing, as_json)
        else:
            _locate_rows(options, accuracy, probability, writing)


def _locate_all(
    options: LocateOptions, accuracy: bool | None, probability: float, writing: OutputOptions, as_json: bool
) -> None:
    """Locate, then write the file and the JSON object."""
    _start(options)
    check = functools.partial(_check_file, writing, probability) if writing.is_file else None
    inputs = read_inputs(options, accuracy, writing.output, check)
    fixes, found = locate_inputs(inputs, probability)
    shares = _told_shares(inputs, found, probability)
    rows = inputs.observed.table(fixes, found, reasons=inputs.reasons)
    outlines = outlines_of(inputs)
    extra = [{} for _ in rows] if outlines is None else [{"outline_status": one} for one in outlines.statuses]
    if writing.is_file:
        from jaxgeo.io import write_fixes

        assert writing.output is not None
        write_fixes(
            writing.output,
            fixes,
            accuracy=found,
            probability=probability if found is not None else None,
            attributes=[row | more for row, more in zip(_typed(inputs.observed), extra, strict=True)],
            reasons=inputs.reasons,
            rings=None if outlines is None else outlines.rings,
            style=writing.style,
            is_above_takeoff=inputs.observed.is_above_takeoff,
            **writing.drawn,
        )
        print_written(writing.output)
    print_counts(Counter(row["status"] for row in rows), len(rows))
    if as_json:
        if outlines is not None:
            each = zip(rows, extra, outlines.rings, strict=True)
            rows = [row | more | {"outline": None if ring is None else ring.tolist()} for row, more, ring in each]
        more = {"assumed": inputs.assumed, "assumed_variance_shares": shares}
        print_json("locate", {"inputs": options.inputs, **more, "fixes": rows})
    exit_without_fix(inputs, fixes)


def _locate_on_cluster(
    options: LocateOptions,
    accuracy: bool | None,
    probability: float,
    writing: OutputOptions,
    many: PartsOptions,
    as_json: bool,
) -> None:
    """Locate on the workers of Dask, into a folder of GeoParquet files."""
    from jaxgeo.cluster import locate_frames, statuses_of

    folder = many.check_folder(writing.output)
    _start(options)
    inputs = read_inputs(options, accuracy, None, on_disk=True)
    note_far_crs(writing.crs, inputs.observed.position)
    observed = dataclasses.replace(inputs.observed, columns=_typed(inputs.observed))
    with many.connected() as client, report_failed_parts():
        run = locate_frames(
            folder,
            observed,
            inputs.grounds,
            client=client,
            accuracy=inputs.has_errors,
            probability=probability,
            progress=many.shows_progress,
            **writing.drawn,
        )
    counts = statuses_of(run)
    print_missing(run)
    print_written(folder)
    print_counts(counts, len(observed))
    shares = assumed_shares_of_files(inputs, [folder / name for name in run.parts], probability)
    said = told_shares(shares, probability, count=len(observed))
    if said is not None:
        print_note(said)
    if as_json:
        print_json(
            "locate",
            {
                "inputs": options.inputs | {"cluster": many.cluster, "output": folder},
                "assumed": inputs.assumed,
                "assumed_variance_shares": shares,
                "parts": list(run.parts),
                "computed": run.computed,
                "statuses": counts,
            },
        )
    if not any(counts_as_fix(Status[name].code) for name in counts):
        print_message("no pixel has a fix.")
        raise typer.Exit(NO_ANSWER)


def _locate_rows(options: LocateOptions, accuracy: bool | None, probability: float, writing: OutputOptions) -> None:
    """Locate, and write rows to the terminal or a pipe: as they are computed if there are no errors to estimate."""
    with destination("--output", writing.output) as stream:
        _start(options)
        inputs = read_inputs(options, accuracy, writing.output)
        chosen = writing.format_of_rows(options.of_images.shots)
        counts: Counter[str] = Counter()
        fixes = found = None
        if chosen is Format.table or inputs.has_errors or not inputs.observed.batches[0].is_one_camera:
            fixes, found = locate_inputs(inputs, probability)
            _told_shares(inputs, found, probability)
            rows = inputs.observed.table(fixes, found, reasons=inputs.reasons)
            counts.update(row["status"] for row in rows)
        else:
            rows = _rows(inputs, counts)
            if stream.isatty():  # a progress bar on the same terminal would break the rows
                rows = list(rows)
        if chosen is Format.table:
            print_counts(counts, len(inputs.observed))
        _write_rows(rows, inputs, None if found is None else probability, chosen, stream)
        stream.flush()
    print_written(writing.output)
    if chosen is not Format.table:  # after the rows, not between them
        print_counts(counts, len(inputs.observed))
    if fixes is not None:
        exit_without_fix(inputs, fixes)


def _told_shares(inputs: LocateInputs, found: jaxgeo.Accuracy | None, probability: float) -> dict[str, float]:
    """Shares of assumed standard deviations in the horizontal variance, by option; printed if they are most of it."""
    shares = assumed_shares(inputs, found)
    said = told_shares(shares, probability, count=len(inputs.observed))
    if said is not None:
        print_note(said)
    return shares


def _start(options: LocateOptions) -> None:
    """Set up JAX."""
    from jaxgeo._checks import enable_x64

    compile_quickly(options.has_terrain_field)
    enable_x64()


def _check_file(writing: OutputOptions, probability: float, observed: jaxgeo.io.Observations, has_errors: bool) -> None:
    """Raises if the output file cannot be written as requested, before the ground is read."""
    from jaxgeo.io.fix_files import check_fix_file

    assert writing.output is not None
    note_far_crs(writing.crs, observed.position)
    check_fix_file(
        writing.output,
        writing.crs,
        writing.heights,
        observed.position,
        attributes=_typed(observed),
        mgrs=writing.mgrs,
        reasons=observed.reasons_by(reason_not_read),
        probability=probability if has_errors else None,
        is_above_takeoff=observed.is_above_takeoff,
    )


def _typed(observed: jaxgeo.io.Observations) -> list[Row]:
    """Input columns; numeric columns of a table of shots as numbers, NaN as None."""
    from jaxgeo.io.tables import number_columns

    numbers = number_columns(observed.gimbal_names)
    return [
        {name: _number(value) if name in numbers else value for name, value in row.items()} for row in observed.columns
    ]


def _number(value: Any) -> float | None:
    number = math.nan if value is None else float(value)
    return number if math.isfinite(number) else None


def _rows(inputs: LocateInputs, counts: Counter[str]) -> Iterator[Row]:
    """Rows of fixes without accuracy, as they are computed; statuses are counted in `counts`."""
    from jaxgeo.io import height_msl
    from jaxgeo.io.tables import fix_rows

    columns, is_above_takeoff = iter(inputs.observed.columns), inputs.observed.is_above_takeoff
    for fixes in fixes_as_computed(inputs):
        msl = None if is_above_takeoff else height_msl(fixes)
        for row in fix_rows(fixes, msl, is_above_takeoff=is_above_takeoff):
            counts[row["status"]] += 1
            yield {**next(columns), **row}


def _write_rows(
    rows: Iterable[Row], inputs: LocateInputs, probability: float | None, output_format: Format, stream: TextIO
) -> None:
    from jaxgeo.io.tables import number_columns, write_csv, write_geojson

    if output_format is Format.csv:
        write_csv(rows, stream)
    elif output_format is Format.geojson:
        write_geojson(rows, stream, number_columns(inputs.observed.gimbal_names))
    else:
        assert isinstance(rows, Sequence)
        console = Console(file=stream, width=None if stream.isatty() else 160, highlight=False)
        console.print(fixes_table(rows, probability, console.width))
        if len(rows) == 1 and rows[0].get("accuracy_text"):
            console.print(rows[0]["accuracy_text"], markup=False, soft_wrap=True)

"""`jaxgeo overlap`: overlap of consecutive images on the terrain, and of strips side by side."""

from __future__ import annotations

import contextlib
import itertools
import math
import pathlib
from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import Annotated, Any

import typer

from jaxgeo._destination import destination, is_device
from jaxgeo._text_numbers import numbers_in
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._exposures import ExposureOrShotOptions, GivenExposure, GivenExposures, sensors_differ
from jaxgeo.cli._inputs import check_no_overwrite, trajectory_of
from jaxgeo.cli._known_heights import with_known_heights
from jaxgeo.cli._level_ground import check_ground, terrain_of, with_ground
from jaxgeo.cli._locate_options import GroundOptions
from jaxgeo.cli._options import Along, NavigationFile
from jaxgeo.cli._results import AsJson, given_options, print_json, status_words
from jaxgeo.cli._screen import number_table, print_counts, print_note, print_written, track
from jaxgeo.cli._strips import CAPTION as STRIPS_CAPTION
from jaxgeo.cli._strips import COLUMNS as OF_STRIPS
from jaxgeo.cli._strips import as_cells, strip_rows, strips_of
from jaxgeo.cli._unseen_ground import print_unseen, translate_unseen

DECIMALS = {"near": 6, "far": 6, "least": 6, "side": 6, "area": 6, "step_m": 3}
COLUMNS = {
    "before": ("image", ""),
    "after": ("next", ""),
    "near": ("near", ".4f"),
    "far": ("far", ".4f"),
    "least": ("least", ".4f"),
    "side": ("side", ".4f"),
    "area": ("area", ".4f"),
    "step_m": ("step, m", ".1f"),
    "status": ("status", ""),
}
CAPTION = (
    "near, far, least: along-track overlap at near edge, far edge, minimum, as a share of the first image's length; "
    "side: cross-track overlap, as a share of its width; area: share of its area"
)
HIT, TURNED, APART = "hit", "images_turned", "images_apart"
ASKEW = "invalid_input"  # of pairs of which one edge is not ahead of the other
MOST_NAMED = 5  # images named in the message on partial ground
ANSWERS = HIT, TURNED
BOTH = "Both footprints are complete and overlap."


class Format(StrEnum):
    """Output format."""

    table = "table"
    csv = "csv"


def overlap_command(
    given: ExposureOrShotOptions,
    ground: GroundOptions,
    navigation: NavigationFile = None,
    times: Annotated[
        str | None, typer.Option(metavar="TIMES", help="Exposure times T1,T2[,...], s, with --navigation.")
    ] = None,
    along: Along = None,
    strips: Annotated[
        bool,
        typer.Option(
            "--strips",
            help="One row per strip, its forward overlap, and per pair of neighbouring strips, their side overlap. "
            'Strips are those of the column "strip" of --shots, else told apart by their courses.',
        ),
    ] = False,
    how: ReadingOptions = ReadingOptions(),
    output_format: Annotated[
        Format | None, typer.Option("--format", help="Default: csv with --output, table on the terminal.")
    ] = None,
    output: Annotated[
        pathlib.Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="File to write (.csv); default: the terminal."),
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Overlap of consecutive images on the terrain, one row per pair; with --strips that of strips side by side too."""
    inputs = with_ground(given_options(locals()))
    with report_errors(debug):
        chosen = _chosen_format(output_format, output)
        moments = _moments(navigation, times, given)
        if navigation is None:
            given.check(how)
        check_ground(ground)
        check_no_overwrite("--output", output, [navigation, *given.inputs(how)], ground.dem, ground)
        with destination("--output", output) as stream:
            from jaxgeo._checks import enable_x64
            from jaxgeo.status import Status

            compile_quickly()
            enable_x64()
            if navigation is not None:
                images = _at_times(given.scene, navigation, moments, how.height_datum)
            else:
                known = with_known_heights(how, given.files or [], given.scene, ground.dem or [], ground)
                images = given.read(known, "overlap without --shots", ground)
                _check_several(images, given)
            terrain = terrain_of(ground, lambda: images.exposures[0].shot, images.view)
            of_strips = strips_of(images.exposures) if strips else {}
            axis = None if along is None else along.value
            more: dict[str, Any] = {}
            if of_strips:
                found, rows, unknown = strip_rows(
                    of_strips, terrain, lambda own, means: _overlaps(own, terrain, axis, means)
                )
                partial = {}
                for number, own in of_strips.items():
                    partial |= _partial([row for row in rows if row["strip"] == number], own, terrain)
                more = {"strips": found, "strips_without_side": unknown}
            else:
                found = rows = _overlaps(images.exposures, terrain, axis)
                partial = _partial(rows, images.exposures, terrain)
            _count(rows)
            _print_askew(rows)
            _print_partial(partial)
            if output is not None or not as_json:
                _write(found, chosen, stream, strips)
        print_written(output)
        if as_json:
            pairs = [{**row, **status_words(Status[row["status"]], BOTH)} for row in rows]
            content = {"pairs": pairs, **more, "partial": partial, "unread": images.unread}
            print_json("overlap", {"inputs": inputs, **content})
    if not any(row["status"] in ANSWERS for row in rows):
        print_unseen("no pair has an overlap", terrain, images.exposures[0].shot)
        raise typer.Exit(NO_ANSWER)


def _chosen_format(asked: Format | None, output: pathlib.Path | None) -> Format:
    if asked is not None:
        return asked
    if output is None or is_device(output):
        return Format.table
    if output.suffix.lower() == ".csv":
        return Format.csv
    raise UserError(f"--output {output}: {name_says(output)}; use .csv, or give --format table.")


def _moments(navigation: Any, times: str | None, given: ExposureOrShotOptions) -> list[float]:
    """The exposure times in s."""
    others = given.shots is not None or not given.is_scene
    if (navigation is None) != (times is None) or (navigation is None) != others:
        raise UserError(
            "give FILEs of exposures, or --scene with --navigation FILE and --times T1,T2[,...], or with --shots FILE."
        )
    if navigation is not None and given.scene is None:
        raise UserError(f"--navigation {navigation} needs --scene SCENE.toml for the camera.")
    if times is None:
        return []
    found = numbers_in(times.split(","))
    if found is None:
        raise UserError(f"--times {times!r}: expected T1,T2[,...], numbers in s.")
    if len(found) < 2:
        raise UserError(f"--times {times}: give at least two exposure times.")
    for before, after in itertools.pairwise(found):
        if not after > before:
            how = "repeated time" if after == before else "decreasing times"
            raise UserError(f"--times {times}: {how}, {before:.9g} s to {after:.9g} s; give increasing times.")
    return found


def _at_times(
    path: pathlib.Path | None, navigation: pathlib.Path, times: list[float], height_datum: str | None
) -> GivenExposures:
    """Exposures at times on a trajectory."""
    import jax.numpy as jnp

    from jaxgeo.coverage import MovingExposure
    from jaxgeo.io.scene import read_scene

    assert path is not None
    scene = read_scene(path)
    flight = trajectory_of(scene, path, navigation, height_datum)
    start, end = float(flight.start), float(flight.end)
    for time in times:
        if not start <= time <= end:
            raise UserError(f"--times: {time:.9g} s is outside {navigation}, which covers {start:.9g} to {end:.9g} s.")
    exposures = [(f"{time:.9g} s", scene.sensor, MovingExposure(flight, jnp.asarray(time))) for time in times]
    return GivenExposures([GivenExposure(*one, scene.atmosphere) for one in exposures], True)


def _check_several(images: GivenExposures, given: ExposureOrShotOptions) -> None:
    if len(images.exposures) < 2:
        what = given.shots or given.scene_file or (given.files or [""])[0]
        count = "rows" if given.shots is not None else "exposures"
        raise UserError(f"{what}: overlap needs at least two {count}.")


def _overlaps(
    images: Sequence[GivenExposure], terrain: Any, along: Any, means: list[float] | None = None
) -> list[dict[str, Any]]:
    """A row for each pair; the mean of each along the flight is added to `means`."""
    import numpy as np

    from jaxgeo.coverage import overlap
    from jaxgeo.status import Status

    rows = []
    for before, after in track(list(itertools.pairwise(images)), "computing overlaps"):
        own = after.sensor if sensors_differ(before.sensor, after.sensor) else None
        how = {"along": along, "atmosphere": before.atmosphere, "sensor_after": own}
        with _as_options(before, after), translate_unseen(terrain, before.shot, f"{before.name} and {after.name}: "):
            found: Any = overlap(before.sensor, before.shot, after.shot, terrain, **how)
        if means is not None:
            means.append(float(np.mean(np.asarray(found.along))))
        numbers = [getattr(found, key.removesuffix("_m")) for key in DECIMALS]
        row = {key: float(x) if math.isfinite(x) else None for key, x in zip(DECIMALS, numbers, strict=True)}
        rows.append({"before": before.name, "after": after.name, **row, "status": Status(int(found.status)).name})
    return rows


@contextlib.contextmanager
def _as_options(before: GivenExposure, after: GivenExposure) -> Iterator[None]:
    """Refusals of a pair with its names and command-line options. Raises `UserError`."""
    try:
        yield
    except ValueError as error:
        if "gives no direction of flight" in f"{error}":
            pair = f"{before.name} and {after.name}"
            message = f"{pair} are taken from one place, which gives no direction of flight: leave one of them out."
            raise UserError(message) from error
        raise


def _partial(rows: list[dict[str, Any]], images: Sequence[GivenExposure], terrain: Any) -> dict[str, dict[str, float]]:
    """By image of a pair without an overlap, the part of it that sees known ground, if that is not the whole."""
    from jaxgeo.coverage import covered_part

    pairs = zip(itertools.pairwise(images), rows, strict=True)
    each = [one for pair, row in pairs if row["status"] not in (*ANSWERS, APART) for one in pair]
    found: dict[str, dict[str, float]] = {}
    for one in track(list({one.name: one for one in each}.values()), "computing the parts that see known ground"):
        part = covered_part(one.sensor, one.shot, terrain, atmosphere=one.atmosphere)
        if 0.0 < part.share < 1.0:
            found[one.name] = {"covered_area_km2": 1e-6 * part.area, "covered_share": part.share}
    return found


def _print_partial(partial: dict[str, dict[str, float]]) -> None:
    if not partial:
        return
    texts = [
        f"{name} {100.0 * one['covered_share']:.3g} % ({one['covered_area_km2']:.3g} km2)"
        for name, one in list(partial.items())[:MOST_NAMED]
    ]
    more = f", and {len(partial) - MOST_NAMED} more" if len(partial) > MOST_NAMED else ""
    print_note(f"partial: share of the image that sees known ground, and its area: {', '.join(texts)}{more}.")


def _count(rows: list[dict[str, Any]]) -> None:
    names = [row["status"] for row in rows]
    print_counts({name: names.count(name) for name in names}, len(names), "pair", BOTH)


def _print_askew(rows: list[dict[str, Any]]) -> None:
    """Say which pairs have no overlap along the flight because the way from one to the other is askew to both."""
    pairs = [f"{row['before']} and {row['after']}" for row in rows if row["status"] == ASKEW]
    if pairs:
        more = f", and {len(pairs) - MOST_NAMED} more pairs" if len(pairs) > MOST_NAMED else ""
        print_note(
            f"{ASKEW}: {', '.join(pairs[:MOST_NAMED])}{more}: the way from one image to the next is along neither "
            f"side of them, as from strip to strip, or --along is the wrong axis; so no overlap along the flight is "
            f"known."
        )


def _write(rows: list[dict[str, Any]], output_format: Format, stream: Any, are_strips: bool) -> None:
    from jaxgeo.io.tables import write_csv

    if output_format is Format.table:
        columns, caption = (OF_STRIPS, STRIPS_CAPTION) if are_strips else (COLUMNS, CAPTION)
        Console(file=stream, width=None if stream.isatty() else 160).print(number_table(rows, columns, caption))
    else:
        write_csv((as_cells(row) if are_strips else {**row, **_texts(row)} for row in rows), stream)


def _texts(row: dict[str, Any]) -> dict[str, str | None]:
    return {key: None if row[key] is None else f"{row[key]:.{places}f}" for key, places in DECIMALS.items()}

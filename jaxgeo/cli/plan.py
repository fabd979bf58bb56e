"""`jaxgeo plan`: exposure times on a flight for a required overlap."""

from __future__ import annotations

import pathlib
from enum import StrEnum
from typing import Annotated, Any

import typer

from jaxgeo._destination import check_place
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._exposure_tables import as_rows, pose_columns
from jaxgeo.cli._flights import FlightOptions
from jaxgeo.cli._inputs import check_no_overwrite, single, view_of_shots
from jaxgeo.cli._known_heights import refuse_relative_heights, with_known_heights
from jaxgeo.cli._level_ground import check_ground, terrain_of, with_ground
from jaxgeo.cli._locate_options import GroundOptions
from jaxgeo.cli._options import Along
from jaxgeo.cli._results import AsJson, given_options, print_json, status_words
from jaxgeo.cli._screen import is_quiet, print_counts, print_written, progress_bar, stderr
from jaxgeo.cli._strips import spacings
from jaxgeo.cli._unseen_ground import print_unseen, translate_unseen
from jaxgeo.cli.overlap import BOTH

ALONG = 100  # times along a flight for whose images the ground is fetched
WAYS = "ground, velocity-height or fixed:PERIOD"


class Place(StrEnum):
    """Position in the image at which the overlap is required."""

    near = "near"
    least = "least"


def plan_command(
    given: FlightOptions,
    ground: GroundOptions,
    output: Annotated[
        pathlib.Path,
        typer.Option("--output", "-o", metavar="FILE", help="File to write (.csv), one row per exposure."),
    ],
    overlap: Annotated[
        float | None,
        typer.Option(help="Required along-track overlap: 0.15 for 15 %; not with a fixed period."),
    ] = None,
    timing: Annotated[
        str,
        typer.Option(
            help="ground: overlap on the terrain; velocity-height: integral of speed over slant range; fixed:PERIOD, s."
        ),
    ] = "ground",
    place: Annotated[
        Place | None, typer.Option(help="With ground: require the overlap at the near edge, or where it is least.")
    ] = None,
    side_overlap: Annotated[
        float | None,
        typer.Option(
            "--side-overlap",
            metavar="SHARE",
            help="Also the spacing of the next strip, left and right, at which the least side overlap on the terrain "
            "is this: 0.3 for 30 %.",
        ),
    ] = None,
    start: Annotated[float | None, typer.Option(help="Time of the first exposure, s (default: first record).")] = None,
    along: Along = None,
    how: ReadingOptions = ReadingOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Plan exposure times on a flight for a required overlap; also reports the overlap.

    The flight is that of a scene's sensor with navigation records, or of the exposures of a FILE. Output heights are
    above the ellipsoid.
    """
    inputs = with_ground(given_options(locals()))
    with report_errors(debug):
        if output.suffix.lower() != ".csv":
            raise UserError(f"--output {output}: {name_says(output)}; use .csv.")
        check_place("--output", output)
        given.check(how)
        check_ground(ground)
        check_no_overwrite("--output", output, given.inputs(how), ground.dem, ground)
        period = _check_timing(timing, overlap, place)
        if side_overlap is not None and not 0.0 <= side_overlap < 1.0:
            raise UserError(f"--side-overlap {side_overlap:g}: must be in [0, 1), a share: 0.3 for 30 %.")
        exposures, strips = _plan(
            (given, how),
            ground,
            (timing, period if overlap is None else overlap, place or Place.near),
            (start, None if along is None else along.value),
            output,
            side_overlap,
        )
        if as_json:
            more = {} if strips is None else {"strips": strips}
            print_json("plan", {"inputs": inputs, "exposures": exposures, **more})


def _check_timing(timing: str, overlap: float | None, place: Place | None) -> float | None:
    """Check the options; the period in s of a fixed timing, or None."""
    way, _, number = timing.partition(":")
    if way not in ("ground", "velocity-height", "fixed") or bool(number) != (way == "fixed"):
        raise UserError(f"--timing {timing!r}: expected {WAYS} (in s, such as fixed:2.3).")
    if place is not None and way != "ground":
        raise UserError(f"--place {place} needs --timing ground.")
    if way == "fixed":
        return _period(timing, number, overlap)
    if overlap is None:
        raise UserError(f"--timing {timing} needs --overlap, a share: 0.15 for 15 %.")
    if not 0.0 <= overlap < 1.0:
        raise UserError(f"--overlap {overlap:g}: must be in [0, 1), a share: 0.15 for 15 %.")
    return None


def _period(timing: str, number: str, overlap: float | None) -> float:
    if overlap is not None:
        raise UserError(f"--overlap conflicts with --timing {timing}, which determines it; leave one out.")
    period = number_in(number)
    if period is None or not period > 0.0:
        raise UserError(f"--timing {timing!r}: the period must be a number above 0 s, such as fixed:2.3.")
    return period


def _plan(
    of: tuple[FlightOptions, ReadingOptions],
    ground: GroundOptions,
    wishes: tuple[str, float | None, Place],
    course: tuple[float | None, Any],
    output: pathlib.Path,
    side_overlap: float | None,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]] | None]:
    """Compute and write the exposures; returns their rows, and those of strip spacings if a side overlap is wanted."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxgeo._checks import enable_x64
    from jaxgeo.coverage import MovingExposure, plan
    from jaxgeo.io import write_exposures

    compile_quickly()
    enable_x64()
    given, how = of
    start, along = course
    how = with_known_heights(how, given.files or [], given.scene, ground.dem or [], ground)
    of_flight = given.flight(how)
    refuse_relative_heights(how, "a plan")
    sensor, flight = of_flight.sensor, of_flight.trajectory
    _check_count(wishes, flight, start)
    terrain = terrain_of(ground, lambda: flight.at(flight.start), lambda: _view(sensor, flight))
    how_timed: dict[str, Any] = {"start": start, "along": along, "atmosphere": of_flight.atmosphere}
    with progress_bar() as bar:
        task = bar.add_task("compiling, planning", total=None)

        def advance(done: float, total: float) -> None:
            bar.update(task, completed=round(done), total=round(total), description="planning, s of the flight")

        begin = MovingExposure(flight, flight.start if start is None else jnp.asarray(start))
        with translate_unseen(terrain, begin):
            found = plan(sensor, flight, terrain, _timing(*wishes), progress=advance, **how_timed)
        bar.update(task, description="computing overlaps")
        shots = jax.vmap(flight.at)(found.times)
    write_exposures(output, shots, sensor.gimbal.names, overlaps=found.overlaps)
    print_written(output)
    _summarise(found)
    if not np.asarray(found.overlaps.ok).any():
        print_unseen("no pair has an overlap", terrain, begin)
    strips = None
    if side_overlap is not None:
        strips = spacings(sensor, list(single(shots)), terrain, side_overlap, of_flight.atmosphere)
    return _exposures(shots, sensor.gimbal.names, found.overlaps), strips


def _view(sensor: Any, flight: Any) -> Any:
    import numpy as np

    times = np.linspace(float(flight.start), float(flight.end), ALONG)
    return view_of_shots(sensor, [(flight, time) for time in times.tolist()])


def _check_count(wishes: tuple[str, float | None, Place], flight: Any, start: float | None) -> None:
    """Raises `UserError` for a fixed period that gives more exposures than a plan may have."""
    from jaxgeo.coverage.timing import MOST

    timing, period, _ = wishes
    if not timing.startswith("fixed:") or period is None:
        return
    length = float(flight.end) - (float(flight.start) if start is None else start)
    if length / period > MOST:
        raise UserError(
            f"--timing {timing}: more than {MOST} exposures in {length:g} s; give {length / MOST:.3g} s or more."
        )


def _exposures(shots: Any, names: tuple[str, ...], overlaps: Any) -> list[dict[str, Any]]:
    """One row per exposure, with its overlap with the one before."""
    import numpy as np

    rows = as_rows({"exposure": np.arange(np.size(shots.time)), **pose_columns(shots, names)})
    for index, row in enumerate(rows[1:]):
        shares = {f"overlap_{name}": float(getattr(overlaps, name)[index]) for name in ("near", "far", "least", "side")}
        row |= shares | status_words(overlaps.status[index], BOTH)
    return rows


def _timing(way: str, number: float | None, place: Place) -> Any:
    from jaxgeo.coverage import FixedPeriod, GroundShared, VelocityHeight

    if way == "ground":
        return GroundShared(number, place.value)
    return VelocityHeight(number) if way == "velocity-height" else FixedPeriod(number)


def _summarise(found: Any) -> None:
    """Print the number of exposures and their overlap on stderr."""
    import numpy as np

    from jaxgeo.status import Status

    if is_quiet():
        return
    times = np.asarray(found.times)
    intervals = np.diff(times)
    console = stderr()
    said = [
        f"{len(times)} exposures from {times[0]:.3f} to {times[-1]:.3f} s, "
        f"every {intervals.min():.3f} to {intervals.max():.3f} s"
    ]
    for place in ("near", "least"):
        values = np.asarray(getattr(found.overlaps, place))
        known = np.isfinite(values)
        if known.any():
            worst = int(np.nanargmin(values))
            said.append(
                f"overlap, {place}: mean {values[known].mean():.4f}, worst {values[worst]:.4f} at exposure {worst + 1}"
            )
    for line in said:
        console.print(line, highlight=False, soft_wrap=True)
    names = [Status(int(code)).name for code in np.asarray(found.overlaps.status)]
    print_counts({name: names.count(name) for name in names}, len(names), "pair", BOTH)

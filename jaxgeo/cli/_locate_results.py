"""Results of `jaxgeo locate` and `jaxgeo report`: fixes, their accuracy, their table, and the exit code."""

from __future__ import annotations

import contextlib
from collections.abc import Container, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import typer

from jaxgeo._arguments import heights_of_camera_and_ground
from jaxgeo.cli._common import FAULT, NO_ANSWER
from jaxgeo.cli._locate_inputs import LocateInputs
from jaxgeo.cli._screen import (
    NumberTable,
    bars_on_stderr,
    number_table,
    print_message,
    print_note,
    progress_bar,
    working,
)
from jaxgeo.fix import Fix
from jaxgeo.status import Status
from jaxgeo.terrain import ConstantHeight, Dem
from jaxgeo.uncertainty import Accuracy

if TYPE_CHECKING:
    from jaxgeo.io.detected import DetectedOutlines

WIDE = 120  # terminal width, characters, from which all columns are shown
SPARED = (
    "incidence_surface_deg",
    "slant_range_m",
    "fix_height_msl_m",
    "accuracy_method",
    "time",
)  # first, without room


def locate_inputs(inputs: LocateInputs, probability: float) -> tuple[Fix, Accuracy | None]:
    """The fixes, and their accuracy if there are error sources and any fix; progress bars on stderr."""
    from jaxgeo.io import accuracy_of_observations, locate_observations
    from jaxgeo.io.located import FEW, located_with_accuracy

    observed = inputs.observed
    if inputs.has_errors:
        with working("estimating accuracy"):
            found = located_with_accuracy(observed, inputs.grounds, probability)
        if found is not None:
            return found
    with progress_bar() as bar:
        task = bar.add_task("locating", total=None)
        fixes = locate_observations(
            observed, inputs.grounds, progress=lambda count, total: bar.update(task, completed=count, total=total)
        )
    if not inputs.has_errors:
        return fixes, None
    is_long = len(observed) > FEW
    with contextlib.nullcontext() if is_long else working("estimating accuracy"), bars_on_stderr() as is_shown:
        return fixes, accuracy_of_observations(
            observed, inputs.grounds, fixes, probability=probability, progress=is_long and is_shown
        )


def outlines_of(inputs: LocateInputs) -> DetectedOutlines | None:
    """The outlines of detections on the ground; None if there are none."""
    from jaxgeo.io import locate_observations
    from jaxgeo.io.detected import outline_observations, outlines_on_ground

    found = None if inputs.vertices is None else outline_observations(inputs.observed, inputs.vertices, inputs.grounds)
    if found is None:
        return None
    observed, grounds, rows = found
    with working("locating outlines"):
        return outlines_on_ground(locate_observations(observed, grounds), rows)


def fixes_as_computed(inputs: LocateInputs) -> Iterator[Fix]:
    """Fixes of consecutive parts of the only batch; progress bar on stderr."""
    from jaxgeo.io.located import fixes_in_parts

    (batch,) = inputs.observed.batches
    with progress_bar() as progress:
        task = progress.add_task("locating", total=len(batch))
        for fixes in fixes_in_parts(batch, inputs.grounds[0]):
            yield fixes
            progress.advance(task, len(fixes.status))


def fixes_table(rows: Sequence[dict[str, Any]], probability: float | None, width: int) -> NumberTable:
    """Table of fixes for the terminal, with the columns that fit."""
    from jaxgeo.io.tables import ABOVE_TAKEOFF

    first, is_wide = rows[0], width >= WIDE
    columns: dict[str, tuple[str, str]] = {}
    if "name" in first:
        columns["name"] = ("name", "")
    times, day = _times_of(rows)
    if times:
        columns["time"] = ("time, UTC" if day else "time, s", "" if day else ".3f")
    if "label" in first:
        columns["label"] = ("label", "")
    pixels = {(row["u"], row["v"]) for row in rows}
    if "name" not in first or is_wide or len(pixels) > 1:
        columns |= {"u": ("u", ".0f"), "v": ("v", ".0f")}
    columns |= {
        "fix_lat_deg": ("lat, deg", ".7f"),
        "fix_lon_deg": ("lon, deg", ".7f"),
    }
    has_datum = ABOVE_TAKEOFF not in first
    columns |= {"fix_height_m" if has_datum else ABOVE_TAKEOFF: ("height", ".2f")}
    if is_wide or probability is None:
        columns |= {"fix_height_msl_m": ("msl", ".2f")} if has_datum else {}
        columns |= {"slant_range_m": ("range", ".1f"), "incidence_surface_deg": ("inc.", ".1f")}
    if probability is not None:
        percent = f"{100.0 * probability:.10g}"
        column = percent.replace(".", "_")
        columns |= {f"ce{column}_m": (f"CE{percent}", ".2f"), f"le{column}_m": (f"LE{percent}", ".2f")}
        columns |= {"accuracy_method": ("by", "")} if is_wide else {}
    columns["status"] = ("status", "")
    rows = [row | {"time": time} for row, time in zip(rows, times or [None] * len(rows), strict=True)]
    shown = [{name: _plain(row.get(name), spec) for name, (_, spec) in columns.items()} for row in rows]
    for name in SPARED:
        if not number_table(shown, columns).fits(width):
            columns.pop(name, None)
    return number_table(shown, columns, _caption(columns, probability, day))


def _times_of(rows: Sequence[dict[str, Any]]) -> tuple[list[Any], str]:
    """(time of each row, their day, or days) for fixes at several times: in UTC as text, else in s without a day; ([],
    "") for others."""
    utc = [row.get("time_utc") for row in rows]
    if len(set(utc)) > 1 and all(isinstance(one, str) for one in utc):
        days = sorted({f"{one}"[:10] for one in utc})
        return [f"{one}"[11:].removesuffix("Z") if len(days) == 1 else f"{one}" for one in utc], " to ".join(
            dict.fromkeys((days[0], days[-1]))
        )
    seconds = [row.get("time_s") for row in rows]
    return (seconds, "") if len(set(seconds)) > 1 else ([], "")


def _caption(columns: Container[str], probability: float | None, day: str = "") -> str:
    """Units and datums of the columns of a table of fixes."""
    from jaxgeo.io.tables import ABOVE_TAKEOFF

    of_time = [f"time: on {day}"] if day and "time" in columns else []
    words = ["height: m above the take-off" if ABOVE_TAKEOFF in columns else "height: m above WGS 84"]
    if "fix_height_msl_m" in columns:
        words = ["height, msl: m above WGS 84 and EGM96 mean sea level"]
    words = [*of_time, *words]
    words += ["range: slant range, m"] if "slant_range_m" in columns else []
    words += ["inc.: incidence angle, deg"] if "incidence_surface_deg" in columns else []
    if probability is not None:
        percent = f"{100.0 * probability:.10g}"
        words += [f"CE{percent}: radius of the {percent} % horizontal circle"]
        words += [f"LE{percent}: {percent} % vertical half-interval (m)"]
    return "; ".join(words)


def _plain(value: Any, spec: str) -> Any:
    """A CSV cell as a number if its column is numeric; a missing text is empty."""
    if value is None:
        return "" if not spec else None
    return float(value) if spec and isinstance(value, str) else value


def exit_without_fix(inputs: LocateInputs, fixes: Fix) -> None:
    """Exit with code 1 if no pixel has a fix; call it after the output is written.

    Exits with code 70 if a file could not be read because of an internal error.
    """
    below = below_terrain(inputs, fixes)
    if below is not None:
        print_note(below)
    if inputs.has_faults:
        raise typer.Exit(FAULT)
    if np.isfinite(fixes.slant_range).any():
        return
    why = camera_outside_dem(inputs)
    print_message("no pixel has a fix" + (f": {why}." if why else "."))
    raise typer.Exit(NO_ANSWER)


def below_terrain(inputs: LocateInputs, fixes: Fix) -> str | None:
    """Heights of the first camera that is below the terrain, and of the ground there, with how the camera's is
    replaced; None if there is none."""
    for batch, terrain in zip(inputs.observed.batches, inputs.grounds, strict=True):
        (below,) = np.nonzero(np.asarray(fixes.status)[batch.rows] == Status.camera_below_terrain)
        if not below.size or not isinstance(terrain, Dem | ConstantHeight):
            continue
        first = int(below[0])
        at = lambda x, first=first: np.asarray(x)[first] if np.ndim(x) else x  # noqa: E731
        position = jax.tree.map(at, batch.shots.pose.position)
        ground = jax.tree.map(at, terrain) if isinstance(terrain, ConstantHeight) else terrain
        both = heights_of_camera_and_ground(position, ground)
        above = np.nan if batch.above_takeoff is None else float(batch.above_takeoff[first])
        way = inputs.other_height.always or (inputs.other_height.by_takeoff if above > 0.0 else "")
        if both is None or not way:
            return both
        known = f" ({above:.1f} m above the take-off by the file)" if above > 0.0 else ""
        return f"{both} If the height of the camera is the wrong one{known}, {way}."
    return None


def camera_outside_dem(inputs: LocateInputs) -> str | None:
    """Possible reason why no pixel has a fix: the DEM does not cover the first camera; None otherwise."""
    from jaxgeo.io.extent import camera_beside

    return camera_beside(inputs.grounds[0], inputs.observed.batches[0].shots.pose.position)

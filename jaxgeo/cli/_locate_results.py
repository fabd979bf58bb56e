"""What `jaxgeo locate` finds: fixes of a question, how sure they are, and how they are shown."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import typer
from rich.table import Table

from jaxgeo.cli._common import FAULT, NO_ANSWER
from jaxgeo.cli._locate_inputs import Batch, LocateInputs, on_image
from jaxgeo.cli._screen import bars_on_stderr, number_table, progress_bar, tell, working

CHUNKS = (1, 16, 1024)  # fixes that are computed at a time: few shapes, so few compilations
FEW = 20  # fixes up to which samples are as many as for one
SAMPLES_OF_MANY = 2000  # for each of more, whose figures then are good to some 3 %
WIDE = 120  # characters of a screen on which there is room for all columns


class LocateResults(NamedTuple):
    """Fixes (n) and how sure they are, an `AccuracyOfEach` or None; a row without a file has the status of that."""

    fixes: Any
    accuracy: Any

    def rows(self, name: str, question: LocateInputs) -> list[dict[str, Any]]:
        """Output rows: carried columns, and the columns of `write_fixes` without a number."""
        from jaxgeo.io._fix_columns import figures_of, rows_of

        figures = figures_of(name, self.fixes, self.accuracy, None, None, None)
        found = rows_of(self.fixes, figures, question.reasons)
        pairs = zip(found, question.carried, strict=True)
        return [more | {key: row[key] for key in row if key != "index"} for row, more in pairs]

    def part(self, rows: Any) -> LocateResults:
        """Some of the rows."""
        if self.accuracy is None:
            return LocateResults(_part(self.fixes, rows), None)
        one = self.accuracy
        fixes, arrays = _part((self.fixes, _arrays(one)), rows)
        return LocateResults(fixes, _with(one, fixes, arrays))


def located(question: LocateInputs, probability: float) -> LocateResults:
    """The fixes, and how sure they are if the question has errors; with bars on stderr."""
    import jax
    import numpy as np

    from jaxgeo.status import Status

    count = len(question.carried)
    each = [jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts) for parts in _fixes_of_each(question)]
    blank = jax.tree.map(lambda leaf: _blank(leaf, count, Status.file_not_read), each[0])
    rows = np.concatenate([batch.rows for batch in question.batches])
    fixes = _spread(each, rows, blank)
    if not question.has_errors:
        return LocateResults(fixes, None)
    pairs = zip(question.batches, each, strict=True)
    is_long = len(question.carried) > FEW
    sure = [_how_sure(batch, found, probability, question.atmosphere, is_long=is_long) for batch, found in pairs]
    known = [one for one in sure if one is not None]
    if not known:
        return LocateResults(fixes, None)
    arrays = [_arrays(one) for one in known]
    where = [batch.rows for batch, one in zip(question.batches, sure, strict=True) if one is not None]
    blank = jax.tree.map(lambda leaf: _blank(leaf, count, -1), arrays[0])
    own = _spread(arrays, np.concatenate(where), blank)
    return LocateResults(fixes, _with(known[0], fixes, own))


def _with(one: Any, fixes: Any, arrays: tuple[Any, ...]) -> Any:
    """An `AccuracyOfEach` with other fixes and arrays."""
    return type(one)(fixes, one.probability, *arrays, one.count)


def _arrays(one: Any) -> tuple[Any, ...]:
    """The arrays of an `AccuracyOfEach` but for its fixes, as NumPy's."""
    import jax
    import numpy as np

    found = (one.circular, one.linear, one.spherical, one.trust, one.cov_enu, one.bias_enu, one.signs)
    return jax.tree.map(np.asarray, found)


def _fixes_of_each(question: LocateInputs) -> Iterator[list[Any]]:
    """Fixes of each batch, in parts; a bar on stderr."""
    total = sum(len(batch.uv) for batch in question.batches)
    with progress_bar() as progress:
        task = progress.add_task("locating", total=total)
        for batch in question.batches:
            parts = []
            for _, fixes in _fixes_in_parts(batch, question.atmosphere):
                parts.append(fixes)
                progress.advance(task, len(fixes.status))
            yield parts


def _blank(leaf: Any, count: int, code: int) -> Any:
    """An array for `count` rows, in which nothing is known; of whole numbers the code."""
    import numpy as np

    return np.full((count, *np.shape(leaf)[1:]), np.nan if leaf.dtype.kind == "f" else code, leaf.dtype)


def _spread(each: list[Any], rows: Any, blank: Any) -> Any:
    """Arrays of batches at their rows among all."""
    import jax
    import numpy as np

    def placed(whole: Any, *parts: Any) -> Any:
        whole[rows] = np.concatenate(parts)
        return whole

    return jax.tree.map(placed, blank, *each)


def fixes_in_parts(question: LocateInputs) -> Iterator[tuple[int, Any]]:
    """(number of the first, fixes) of parts of all pixels of the only batch, one after the other; a bar on stderr."""
    (batch,) = question.batches
    with progress_bar() as progress:
        task = progress.add_task("locating", total=len(batch.uv))
        for start, fixes in _fixes_in_parts(batch, question.atmosphere):
            yield start, fixes
            progress.advance(task, len(fixes.status))


def _fixes_in_parts(batch: Batch, atmosphere: Any) -> Iterator[tuple[int, Any]]:
    """(number of the first, fixes) of parts of the pixels of a batch, one after the other."""
    import numpy as np

    total = len(batch.uv)
    if _are_outside(batch, atmosphere):  # which needs no program
        yield 0, _outside(total)
        return
    size = next((size for size in CHUNKS if size >= total), CHUNKS[-1])
    program = _program(batch.axes[0], batch.axes[3], size == 1)
    for start in range(0, total, size):
        here = np.minimum(np.arange(start, start + size), total - 1)
        sensor, shots, uv, terrain = _taken(batch, here)
        fixes = program(sensor, shots, uv, terrain, atmosphere)
        yield start, _part(fixes, np.arange(min(size, total - start)))


def _are_outside(batch: Batch, atmosphere: Any) -> bool:
    """Whether no pixel lies on its image, and nothing else is wrong with any."""
    import jax
    import numpy as np

    given = jax.tree.leaves((batch.sensor, batch.shots, batch.uv, atmosphere))
    is_sound = all(np.isfinite(np.asarray(leaf)).all() for leaf in given)
    return is_sound and not on_image(batch.sensor.camera, batch.uv).any()


def _outside(count: int) -> Any:
    """Fixes of so many pixels outside the image."""
    import numpy as np

    from jaxgeo.earth import Geodetic
    from jaxgeo.fix import Fix
    from jaxgeo.status import Status

    unknown = np.full(count, np.nan)
    position = Geodetic(lat=unknown, lon=unknown, height=unknown)
    ecef, status = np.full((count, 3), np.nan), np.full(count, Status.outside_image, np.int8)
    return Fix(position, ecef, unknown, unknown, unknown, unknown, status)


@functools.cache
def _program(sensor_axis: int | None, terrain_axis: int | None, is_alone: bool) -> Any:
    """`locate` of a batch; of a batch of one without `vmap`, which is traced in half the time."""
    import jax

    from jaxgeo.locate import locate

    def through_the_air(sensor: Any, shot: Any, uv: Any, terrain: Any, atmosphere: Any) -> Any:
        return locate(sensor, shot, uv, terrain, atmosphere=atmosphere)

    axes = (sensor_axis, 0, 0, terrain_axis, None)
    if not is_alone:
        return jax.jit(jax.vmap(through_the_air, in_axes=axes))

    def of_one(*given: Any) -> Any:
        own = [jax.tree.map(lambda x: x[0], one) if axis == 0 else one for one, axis in zip(given, axes, strict=True)]
        return jax.tree.map(lambda leaf: leaf[None], through_the_air(*own))

    return jax.jit(of_one)


def _taken(batch: Batch, index: Any) -> list[Any]:
    """(sensor, shots, uv, terrain) of some pixels."""
    given = (batch.sensor, batch.shots, batch.uv, batch.terrain)
    return [_part(one, index) if axis == 0 else one for one, axis in zip(given, batch.axes, strict=False)]


def _part(tree: Any, index: Any) -> Any:
    """Items of every leaf, as NumPy arrays."""
    import jax
    import numpy as np

    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


def _how_sure(batch: Batch, fixes: Any, probability: float, atmosphere: Any, *, is_long: bool) -> Any:
    """How sure the fixes are, an `AccuracyOfEach`, without figures for those that are none; None where all are."""
    import jax
    import numpy as np

    from jaxgeo.status import Status, counts_as_fix
    from jaxgeo.uncertainty import accuracy_of_each
    from jaxgeo.uncertainty.accuracy_of_each import SAMPLES

    counts = {int(one) for one in Status if counts_as_fix(one.code)}
    index = np.flatnonzero(np.isin(fixes.status, list(counts)))
    if not index.size:
        return None
    sensor, shots, uv, terrain = _taken(batch, index)
    errors = _part(batch.errors, index) if batch.axes[4] == 0 else batch.errors
    waiting = contextlib.nullcontext() if is_long else working("computing how sure that is")
    with waiting, bars_on_stderr() as is_shown:
        found = accuracy_of_each(
            sensor,
            shots,
            uv,
            terrain,
            errors,
            in_axes=batch.axes,
            probability=probability,
            count=SAMPLES_OF_MANY if is_long else SAMPLES,
            progress=is_long and is_shown,
            atmosphere=atmosphere,
        )
    arrays = _arrays(found)
    blank = jax.tree.map(lambda leaf: _blank(leaf, len(batch.uv), -1), arrays)
    return _with(found, fixes, _spread([arrays], index, blank))


def fixes_table(rows: list[dict[str, Any]], probability: float | None, width: int) -> Table:
    """Fixes for the screen, with the columns that there is room for."""
    first, is_wide = rows[0], width >= WIDE
    columns: dict[str, tuple[str, str]] = {}
    if "name" in first:
        columns["name"] = ("name", "")
    pixels = {(row["u"], row["v"]) for row in rows}
    if "name" not in first or is_wide or len(pixels) > 1:
        columns |= {"u": ("u", ".0f"), "v": ("v", ".0f")}
    columns |= {
        "fix_lat_deg": ("lat, deg", ".7f"),
        "fix_lon_deg": ("lon, deg", ".7f"),
        "fix_height_m": ("height", ".2f"),
    }
    if is_wide or probability is None:
        columns |= {"fix_height_msl_m": ("msl", ".2f"), "slant_range_m": ("range", ".1f")}
        columns |= {"incidence_surface_deg": ("inc.", ".1f")}
    caption = "height, msl: m above WGS 84 and above EGM96 mean sea level; range: slant range, m; inc.: incidence, deg"
    if probability is not None:
        percent = f"{100.0 * probability:.10g}"
        column = percent.replace(".", "_")
        columns |= {f"ce{column}_m": (f"CE{percent}", ".2f"), f"le{column}_m": (f"LE{percent}", ".2f")}
        columns |= {"accuracy_method": ("by", "")} if is_wide else {}
        caption = (caption if is_wide else "height: m above WGS 84") + (
            f"; CE{percent}, LE{percent}: radius, and half a height, that hold the truth with {percent} %, m"
        )
    columns["status"] = ("status", "")
    shown = [{name: _plain(row.get(name), spec) for name, (_, spec) in columns.items()} for row in rows]
    return number_table(shown, columns, caption)


def _plain(value: Any, spec: str) -> Any:
    """A cell of a CSV file as a number, if it is one; a text that is not there is empty."""
    if value is None:
        return "" if not spec else None
    return float(value) if spec and isinstance(value, str) else value


def leave_without_a_fix(question: LocateInputs, found: LocateResults) -> None:
    """Exit with 1 where no pixel at all has a fix; what was to be written says so, and is written before.

    With 70 where a file could not be read by a fault of the program's.
    """
    import numpy as np

    if question.has_faults:
        raise typer.Exit(FAULT)
    if np.isfinite(np.asarray(found.fixes.slant_range)).any():
        return
    why = where_from(question)
    tell("no pixel has a fix" + (f": {why}." if why else "."))
    raise typer.Exit(NO_ANSWER)


def where_from(question: LocateInputs) -> str | None:
    """Why there may be no fix at all, in words: the elevation model lies elsewhere than the first camera."""
    import numpy as np

    from jaxgeo.io.extent import place_beside
    from jaxgeo.terrain import Dem

    terrain, position = question.batches[0].terrain, question.position
    if not isinstance(terrain, Dem):
        return None
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return place_beside(terrain, lat, lon)

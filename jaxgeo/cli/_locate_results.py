"""Results of `jaxgeo locate`: fixes, their accuracy, and their tables."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import typer
from rich.table import Table

from jaxgeo.cli._common import FAULT, NO_ANSWER
from jaxgeo.cli._locate_inputs import Batch, LocateInputs, on_image
from jaxgeo.cli._screen import bars_on_stderr, number_table, progress_bar, tell, working

CHUNKS = (1, 16, 1024)  # fixes computed at a time: few shapes, few compilations
FEW = 20  # up to this many fixes, each gets the full number of samples
SAMPLES_OF_MANY = 2000  # per fix if there are more; radii are then good to about 3 %
ARRAYS = (
    *("probability", "circular", "linear", "spherical", "method", "cov_enu", "bias_enu", "failed"),
    "diagnostics",
)  # of an `Accuracy`, except its fixes
WIDE = 120  # terminal width, characters, from which all columns are shown


class LocateResults(NamedTuple):
    """Fixes (n) and their accuracy, an `Accuracy` or None; rows of unread files have status `file_not_read`."""

    fixes: Any
    accuracy: Any

    def rows(self, name: str, question: LocateInputs) -> list[dict[str, Any]]:
        """Output rows: carried columns, then the columns of `write_fixes` without `index`."""
        from jaxgeo.io._fix_columns import figures_of, rows_of

        figures = figures_of(name, self.fixes, self.accuracy, None, None, None)
        found = rows_of(self.fixes, figures, question.reasons)
        pairs = zip(found, question.carried, strict=True)
        return [more | {key: row[key] for key in row if key != "index"} for row, more in pairs]

    def part(self, rows: Any) -> LocateResults:
        """A subset of the rows."""
        if self.accuracy is None:
            return LocateResults(_part(self.fixes, rows), None)
        one = self.accuracy
        fixes, arrays = _part((self.fixes, _arrays(one)), rows)
        return LocateResults(fixes, _with(one, fixes, arrays))


def located(question: LocateInputs, probability: float) -> LocateResults:
    """The fixes, and their accuracy if there are error sources; progress bars on stderr."""
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
    """An `Accuracy` with replaced fixes and arrays."""
    return dataclasses.replace(one, fix=fixes, **dict(zip(ARRAYS, arrays, strict=True)))


def _arrays(one: Any) -> tuple[Any, ...]:
    """The arrays of an `Accuracy` except its fixes, as NumPy arrays."""
    import jax
    import numpy as np

    return jax.tree.map(np.asarray, tuple(getattr(one, name) for name in ARRAYS))


def _fixes_of_each(question: LocateInputs) -> Iterator[list[Any]]:
    """Fixes of each batch, in parts; progress bar on stderr."""
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
    """An array for `count` rows filled with NaN, or with `code` for integers."""
    import numpy as np

    return np.full((count, *np.shape(leaf)[1:]), np.nan if leaf.dtype.kind == "f" else code, leaf.dtype)


def _spread(each: list[Any], rows: Any, blank: Any) -> Any:
    """Scatter batch arrays into their rows of `blank`."""
    import jax
    import numpy as np

    def placed(whole: Any, *parts: Any) -> Any:
        whole[rows] = np.concatenate(parts)
        return whole

    return jax.tree.map(placed, blank, *each)


def fixes_in_parts(question: LocateInputs) -> Iterator[tuple[int, Any]]:
    """(index of the first, fixes) of consecutive parts of the only batch; progress bar on stderr."""
    (batch,) = question.batches
    with progress_bar() as progress:
        task = progress.add_task("locating", total=len(batch.uv))
        for start, fixes in _fixes_in_parts(batch, question.atmosphere):
            yield start, fixes
            progress.advance(task, len(fixes.status))


def _fixes_in_parts(batch: Batch, atmosphere: Any) -> Iterator[tuple[int, Any]]:
    """(index of the first, fixes) of consecutive parts of a batch."""
    import numpy as np

    total = len(batch.uv)
    if _are_outside(batch, atmosphere):  # needs no compilation
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
    """Whether all pixels lie outside the image and all inputs are finite."""
    import jax
    import numpy as np

    given = jax.tree.leaves((batch.sensor, batch.shots, batch.uv, atmosphere))
    is_sound = all(np.isfinite(np.asarray(leaf)).all() for leaf in given)
    return is_sound and not on_image(batch.sensor.camera, batch.uv).any()


def _outside(count: int) -> Any:
    """Fixes of `count` pixels outside the image."""
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
    """Jitted `locate` of a batch; without `vmap` for a batch of one, which halves tracing time."""
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
    """(sensor, shots, uv, terrain) of the indexed pixels."""
    given = (batch.sensor, batch.shots, batch.uv, batch.terrain)
    return [_part(one, index) if axis == 0 else one for one, axis in zip(given, batch.axes, strict=False)]


def _part(tree: Any, index: Any) -> Any:
    """Indexed items of every leaf, as NumPy arrays."""
    import jax
    import numpy as np

    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


def _how_sure(batch: Batch, fixes: Any, probability: float, atmosphere: Any, *, is_long: bool) -> Any:
    """Accuracy of the fixes, an `Accuracy`, NaN for pixels without a fix; None if no pixel has one."""
    import jax
    import numpy as np

    from jaxgeo.status import Status, counts_as_fix
    from jaxgeo.uncertainty import Sampling, accuracy
    from jaxgeo.uncertainty.accuracy import SAMPLES

    counts = {int(one) for one in Status if counts_as_fix(one.code)}
    index = np.flatnonzero(np.isin(fixes.status, list(counts)))
    if not index.size:
        return None
    sensor, shots, uv, terrain = _taken(batch, index)
    errors = _part(batch.errors, index) if batch.axes[4] == 0 else batch.errors
    waiting = contextlib.nullcontext() if is_long else working("estimating accuracy")
    with waiting, bars_on_stderr() as is_shown:
        found = accuracy(
            sensor,
            shots,
            uv,
            terrain,
            errors,
            in_axes=batch.axes,
            probability=probability,
            sampling=Sampling(count=SAMPLES_OF_MANY if is_long else SAMPLES, progress=is_long and is_shown),
            atmosphere=atmosphere,
        )
    arrays = _arrays(found)
    blank = jax.tree.map(lambda leaf: _blank(leaf, len(batch.uv), -1), arrays)
    return _with(found, fixes, _spread([arrays], index, blank))


def fixes_table(rows: list[dict[str, Any]], probability: float | None, width: int) -> Table:
    """Table of fixes for the terminal, with the columns that fit."""
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
    caption = "height, msl: m above WGS 84 and EGM96 mean sea level; range: slant range, m; inc.: incidence angle, deg"
    if probability is not None:
        percent = f"{100.0 * probability:.10g}"
        column = percent.replace(".", "_")
        columns |= {f"ce{column}_m": (f"CE{percent}", ".2f"), f"le{column}_m": (f"LE{percent}", ".2f")}
        columns |= {"accuracy_method": ("by", "")} if is_wide else {}
        caption = (caption if is_wide else "height: m above WGS 84") + (
            f"; CE{percent}: radius of the {percent} % horizontal circle; "
            f"LE{percent}: {percent} % vertical half-interval (m)"
        )
    columns["status"] = ("status", "")
    shown = [{name: _plain(row.get(name), spec) for name, (_, spec) in columns.items()} for row in rows]
    return number_table(shown, columns, caption)


def _plain(value: Any, spec: str) -> Any:
    """A CSV cell as a number if its column is numeric; a missing text is empty."""
    if value is None:
        return "" if not spec else None
    return float(value) if spec and isinstance(value, str) else value


def leave_without_a_fix(question: LocateInputs, found: LocateResults) -> None:
    """Exit with code 1 if no pixel has a fix; call it after the output is written.

    Exits with code 70 if a file could not be read because of an internal error.
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
    """Possible reason why no pixel has a fix: the DEM does not cover the first camera; None otherwise."""
    import numpy as np

    from jaxgeo.io.extent import place_beside
    from jaxgeo.terrain import Dem

    terrain, position = question.batches[0].terrain, question.position
    if not isinstance(terrain, Dem):
        return None
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return place_beside(terrain, lat, lon)

"""What `jaxgeo locate` finds: fixes of a question, how sure they are, and how they are shown."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import typer
from rich.table import Table

from jaxgeo.cli._common import NO_ANSWER
from jaxgeo.cli._question import Question, on_image
from jaxgeo.cli._screen import bars_on_stderr, number_table, progress_bar, tell, working

CHUNKS = (1, 16, 1024)  # fixes that are computed at a time: few shapes, so few compilations
FEW = 20  # fixes up to which samples are as many as for one
SAMPLES_OF_MANY = 2000  # for each of more, whose figures then are good to some 3 %
WIDE = 120  # characters of a screen on which there is room for all columns


class Located(NamedTuple):
    """Fixes (n) and how sure they are, an `AccuracyOfEach` or None."""

    fixes: Any
    accuracy: Any

    def rows(self, name: str, question: Question) -> list[dict[str, Any]]:
        """What is told of each: what is carried through, and the columns of `write_fixes` but for a number."""
        from jaxgeo.io._fix_columns import figures_of, rows_of

        figures = figures_of(name, self.fixes, self.accuracy, None, None, None)
        found = rows_of(self.fixes, figures)
        pairs = zip(found, question.carried, strict=True)
        return [more | {key: row[key] for key in row if key != "index"} for row, more in pairs]


def located(question: Question, probability: float) -> Located:
    """The fixes, and how sure they are if the question has errors; with bars on stderr."""
    import jax
    import numpy as np

    parts = [fixes for _, fixes in fixes_in_parts(question)]
    fixes = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    return Located(fixes, None if question.errors is None else _how_sure(question, fixes, probability))


def fixes_in_parts(question: Question) -> Iterator[tuple[int, Any]]:
    """(number of the first, fixes) of parts of all pixels, one after the other; a bar on stderr."""
    import numpy as np

    total = len(question.uv)
    if _are_outside(question):  # which needs no program
        yield 0, _outside(total)
        return
    size = next((size for size in CHUNKS if size >= total), CHUNKS[-1])
    program = _program(question.axes[0], question.axes[3], size == 1)
    with progress_bar() as progress:
        task = progress.add_task("locating", total=total)
        for start in range(0, total, size):
            here = np.minimum(np.arange(start, start + size), total - 1)
            sensor, shots, uv, terrain = _taken(question, here)
            fixes = program(sensor, shots, uv, terrain, question.atmosphere)
            yield start, _part(fixes, np.arange(min(size, total - start)))
            progress.update(task, completed=min(start + size, total))


def _are_outside(question: Question) -> bool:
    """Whether no pixel lies on its image, and nothing else is wrong with any."""
    import jax
    import numpy as np

    given = jax.tree.leaves((question.sensor, question.shots, question.uv, question.atmosphere))
    is_sound = all(np.isfinite(np.asarray(leaf)).all() for leaf in given)
    return is_sound and not on_image(question.sensor.camera, question.uv).any()


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


def _taken(question: Question, index: Any) -> list[Any]:
    """(sensor, shots, uv, terrain) of some pixels."""
    given = (question.sensor, question.shots, question.uv, question.terrain)
    return [_part(one, index) if axis == 0 else one for one, axis in zip(given, question.axes, strict=False)]


def _part(tree: Any, index: Any) -> Any:
    """Items of every leaf, as NumPy arrays."""
    import jax
    import numpy as np

    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


def _how_sure(question: Question, fixes: Any, probability: float) -> Any:
    """How sure the fixes are; those that are none have no figures."""
    import jax.numpy as jnp
    import numpy as np

    from jaxgeo.status import counts_as_fix
    from jaxgeo.uncertainty import accuracy_of_each
    from jaxgeo.uncertainty.accuracy_of_each import SAMPLES
    from jaxgeo.uncertainty.places import spread

    index = np.flatnonzero(np.asarray(counts_as_fix(jnp.asarray(fixes.status))))
    if not index.size:
        return None
    sensor, shots, uv, terrain = _taken(question, index)
    errors = _part(question.errors, index) if question.axes[4] == 0 else question.errors
    is_long = len(index) > FEW
    waiting = contextlib.nullcontext() if is_long else working("computing how sure that is")
    with waiting, bars_on_stderr() as is_shown:
        found = accuracy_of_each(
            sensor,
            shots,
            uv,
            terrain,
            errors,
            in_axes=question.axes,
            probability=probability,
            count=SAMPLES_OF_MANY if is_long else SAMPLES,
            progress=is_long and is_shown,
            atmosphere=question.atmosphere,
        )
    arrays = (found.circular, found.linear, found.spherical, found.trust, found.cov_enu, found.bias_enu, found.signs)
    whole = spread(arrays, jnp.asarray(index), len(question.uv))
    circular, linear, spherical, trust, cov, bias, signs = whole
    return type(found)(fixes, found.probability, circular, linear, spherical, trust, cov, bias, signs, found.count)


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


def leave_without_a_fix(question: Question, found: Located) -> None:
    """Exit with 1 where no pixel at all has a fix; what was to be written says so, and is written before."""
    import numpy as np

    if np.isfinite(np.asarray(found.fixes.slant_range)).any():
        return
    why = where_from(question)
    tell("no pixel has a fix" + (f": {why}." if why else "."))
    raise typer.Exit(NO_ANSWER)


def where_from(question: Question) -> str | None:
    """Why there may be no fix at all, in words: the elevation model lies elsewhere than the first camera."""
    import numpy as np

    from jaxgeo.io.extent import camera_beside
    from jaxgeo.terrain import Dem

    if not isinstance(question.terrain, Dem):
        return None
    position = question.shots.pose.position
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return camera_beside(question.terrain, lat, lon)

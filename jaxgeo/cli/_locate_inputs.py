"""Inputs of `jaxgeo locate` and `jaxgeo report`: exposures, pixels, ground and error sources."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxgeo._destination import check_no_input
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import errors_given, ground_errors
from jaxgeo.cli._exposures import ExposureSet, Seen, in_air, joined_positions, reasons_of, views_of_scene
from jaxgeo.cli._file_views import tell_unread, views_of_files
from jaxgeo.cli._inputs import read_terrain, said_datum, terrain_files
from jaxgeo.cli._locate_options import LocateOptions, check_asked
from jaxgeo._refusals import is_refusal
from jaxgeo.cli._screen import tell

REPORTED = "reported"


class Batch(NamedTuple):
    """n pixels, each with its exposure, of one structure (images of one camera).

    `shots` and `uv` (n, 2) have an entry per pixel. `axes`, for (sensor, shot, uv, terrain, errors), is 0 for an entry
    per pixel and None for a shared one. `errors` are sources, None without. `rows` (n,) are indices among all pixels.
    """

    sensor: Any
    shots: Any
    uv: Any
    terrain: Any
    errors: tuple[Any, ...] | None
    axes: tuple[int | None, ...]
    rows: Any


class LocateInputs(NamedTuple):
    """All pixels in batches, with their row data.

    `carried` are the columns of each row besides its fix; `unread` the rows, by number, whose file could not be read.
    `readings` are the names of the gimbal axes, `assumed` sentences; `reads` all input files.
    """

    batches: list[Batch]
    unread: dict[int, Any]
    has_errors: bool
    is_each: bool
    atmosphere: Any
    carried: list[dict[str, Any]]
    readings: tuple[str, ...]
    assumed: list[str]
    inputs: dict[str, Any]
    reads: list[Any]

    @property
    def reasons(self) -> list[str | None] | None:
        """Reason per row why its file could not be read, or None; None if all were read."""
        return reasons_of(self.unread, len(self.carried))

    @property
    def read(self) -> Any:
        """Row numbers whose file was read, in order."""
        import numpy as np

        return np.sort(np.concatenate([batch.rows for batch in self.batches]))

    def look(self, row: int) -> tuple[Any, ...]:
        """(sensor, shot, pixel, terrain, errors) of one row whose file was read."""
        import jax
        import numpy as np

        batch = next(one for one in self.batches if row in one.rows)
        index = int(np.flatnonzero(batch.rows == row)[0])
        given = (batch.sensor, batch.shots, batch.uv, batch.terrain, batch.errors)
        pairs = zip(given, batch.axes, strict=True)
        return tuple(jax.tree.map(lambda x: np.asarray(x)[index], one) if axis == 0 else one for one, axis in pairs)

    @property
    def has_faults(self) -> bool:
        """Whether a file could not be read because of an internal error."""
        return any(not is_refusal(one.error) for one in self.unread.values())

    @property
    def position(self) -> Any:
        """Positions of all exposures whose file was read, a `Geodetic`."""
        return joined_positions(self.batches)


def told_question(
    asked: LocateOptions,
    with_errors: bool | None,
    output: pathlib.Path | None,
    check: Callable[[ExposureSet, bool], object] | None = None,
) -> LocateInputs:
    """The inputs, with assumptions reported on stderr. Raises `ValueError` if `output` would overwrite an input."""
    check_asked(asked)
    if output is not None:
        check_no_input("--output", [output], _reads(asked))
    question = read_question(asked, with_errors=with_errors, check=check)
    for one in question.assumed:
        tell(f"assumed: {one}")
    _tell_of_pixels_outside(asked.pixels, question)
    tell_unread(question.unread.values())
    return question


def _tell_of_pixels_outside(texts: list[str], question: LocateInputs) -> None:
    """Report typed pixels outside the image on stderr, before computing; they keep their rows."""
    import numpy as np

    told: dict[str, None] = {}
    for batch in question.batches:
        camera, typed = batch.sensor.camera, np.asarray(batch.uv)[: len(texts)]
        if not np.isfinite(typed).all():
            continue
        for text, inside in zip(texts, on_image(camera, typed), strict=True):
            if not inside:
                told[
                    f"--pixel {text}: outside the image of {camera.width} x {camera.height} pixels; columns go from 0 "
                    f"to {camera.width - 1}, rows from 0 to {camera.height - 1}."
                ] = None
    for one in told:
        tell(one)


def on_image(camera: Any, uv: Any) -> Any:
    """Which of the pixels (n, 2) lie on the image, including the outer edges of its pixels."""
    import numpy as np

    uv = np.asarray(uv, np.float64)
    return np.all((uv >= -0.5) & (uv <= np.array([camera.width, camera.height]) - 0.5), axis=1)


def read_question(
    asked: LocateOptions, *, with_errors: bool | None, check: Callable[[ExposureSet, bool], object] | None = None
) -> LocateInputs:
    """Read all inputs, small and error-prone ones first.

    `check` is called with the exposures, and whether there are error sources, before the ground is read.

    Error sources are included if `with_errors`; if that is None, for a FILE, or if the scene ([errors] table) or an
    option states them. Raises `UserError`, and as the readers.
    """
    check_asked(asked)
    if with_errors is None and asked.shots is None:
        with_errors = not asked.is_scene or asked.sigmas.are_given or None
    views = views_of_scene(asked) if asked.is_scene else views_of_files(asked)
    if with_errors is None:
        with_errors = any(seen.sources for seen in views.seen) and asked.shots is None
    if asked.refraction:
        views = in_air(views)
    assumed = list(views.assumed)
    sources: list[Any] = [None] * len(views.seen)
    if with_errors:
        each = [_sources(seen, views, asked) for seen in views.seen]
        sources = [found for found, _ in each]
        assumed += [*views.assumed_of_errors, *dict.fromkeys(one for _, told in each for one in told)]
    if check is not None:
        check(views, bool(with_errors))
    batches = [
        Batch(seen.sensor, seen.shots, seen.uv, ground, own, _axes(views.is_each, has_ground_each), seen.rows)
        for seen, own, (ground, has_ground_each) in zip(views.seen, sources, _terrain(asked, views), strict=True)
    ]
    return LocateInputs(
        batches,
        views.unread,
        bool(with_errors),
        views.is_each,
        views.atmosphere,
        views.carried,
        views.readings,
        assumed,
        _inputs(asked),
        _reads(asked),
    )


def _axes(is_each: bool, has_ground_each: bool) -> tuple[int | None, ...]:
    own = 0 if is_each else None
    return own, 0, 0, 0 if has_ground_each else None, own


def _sources(seen: Seen, views: ExposureSet, asked: LocateOptions) -> tuple[tuple[Any, ...], list[str]]:
    """(error sources, one entry per pixel if exposures have their own; assumptions on the ground)."""
    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.uncertainty import sources

    of_ground = sources.TerrainHeight | sources.TerrainField
    count = len(seen.uv)
    own = tuple(one for one in seen.sources if not isinstance(one, of_ground))
    given = errors_given(own, asked.sigmas, seen.sensor.gimbal, views.where, views.pixel_pitch)
    if views.is_each:
        kept = {id(one) for one in own}
        given = tuple(one if id(one) in kept or np.ndim(one.sigma) > 1 else for_each(one, count) for one in given)
    ground, of_heights = ground_errors(seen.sources, asked.sigmas, level=asked.ground is not None)
    if views.is_each:
        stated = {id(one) for one in seen.sources}
        ground = tuple(one if id(one) in stated else for_each(one, count) for one in ground)
    found = (*given, *ground)
    if not found:
        raise UserError(
            f"{views.where}: no error sources; add an [errors] table to the scene, or give --position-sigma, "
            f"--attitude-sigma, --gimbal-sigma, --dem-sigma."
        )
    return found, of_heights


def _terrain(asked: LocateOptions, views: ExposureSet) -> list[tuple[Any, bool]]:
    """For each batch (the ground, whether there is one per pixel)."""
    import numpy as np

    from jaxgeo.terrain import ConstantHeight

    if asked.ground is None:
        return [(read_terrain(asked.dem, asked.vertical_datum, asked.reading), False)] * len(views.seen)
    if asked.ground == REPORTED:
        known = [seen.centre_heights for seen in views.seen if seen.centre_heights is not None]
        if not any(np.isfinite(heights).any() for heights in known):
            raise UserError(f"--ground {REPORTED}: {views.where} reports no frame centre height; give a height in m.")
        heights = [np.nan if seen.centre_heights is None else seen.centre_heights for seen in views.seen]
        pairs = zip(views.seen, heights, strict=True)
        return [(ConstantHeight(np.broadcast_to(height, len(seen.uv))), True) for seen, height in pairs]
    height = number_in(asked.ground)
    if height is None:
        raise UserError(f"--ground {asked.ground!r}: expected a height in m, or {REPORTED!r}.")
    if asked.vertical_datum is None:
        return [(ConstantHeight(np.asarray(height)), False)] * len(views.seen)
    return [(_level(seen, height, said_datum(asked.vertical_datum)), True) for seen in views.seen]


def _level(seen: Seen, height: float, datum: str | float) -> Any:
    """Level ground for each pixel, at a height in m above a datum."""
    import numpy as np

    from jaxgeo.io.scene import ellipsoidal_heights
    from jaxgeo.terrain import ConstantHeight

    position = seen.shots.pose.position
    lon, lat = (np.rad2deg(np.asarray(angle)) for angle in (position.lon, position.lat))
    return ConstantHeight(ellipsoidal_heights(lon, lat, np.full(len(lon), height), datum))


def _inputs(asked: LocateOptions) -> dict[str, Any]:
    """The options as typed, by name."""
    paths = {"file": asked.files[0] if len(asked.files) == 1 else None, "scene": asked.scene, "shots": asked.shots}
    found: dict[str, Any] = {name: str(path) for name, path in paths.items() if path is not None}
    if len(asked.files) > 1:
        found["files"] = [str(path) for path in asked.files]
    found |= {"dem": list(asked.dem)} if asked.dem else {"ground": asked.ground}
    found |= {f"dem_{name}": value for name, value in asked.reading._asdict().items() if value is not None}
    if asked.vertical_datum is not None:
        found["vertical_datum"] = asked.vertical_datum
    found |= {name: str(value) if isinstance(value, pathlib.Path) else value for name, value in asked.how.items()}
    sigmas = {name: value for name, value in asked.sigmas._asdict().items() if value is not None}
    return found | ({"sigmas": sigmas} if sigmas else {}) | ({"refraction": True} if asked.refraction else {})


def _reads(asked: LocateOptions) -> list[Any]:
    named = [*asked.files, asked.scene, asked.shots]
    named += [asked.how.get(name) for name in ("errors", "interior", "positions")]
    files: list[Any] = [one for one in named if one is not None]
    camera = asked.how.get("camera")
    files += [camera] if camera is not None and str(camera).lower().endswith(".toml") else []
    for folder in [one for one in files if pathlib.Path(one).is_dir()]:
        files += sorted(pathlib.Path(folder).iterdir())
    return [*files, *(terrain_files(asked.dem, asked.vertical_datum, asked.reading) if asked.dem else [])]

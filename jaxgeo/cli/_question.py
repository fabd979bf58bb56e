"""What `jaxgeo locate` and `jaxgeo report` ask: exposures, pixels, ground and errors, read from all that is given."""

from __future__ import annotations

import math
import pathlib
from typing import Any, NamedTuple

from jaxgeo._destination import check_no_input
from jaxgeo.cli._asked import Asked, check_asked
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import errors_given, ground_errors
from jaxgeo.cli._inputs import read_terrain, said_datum, terrain_files
from jaxgeo.cli._screen import tell
from jaxgeo.cli._views import Views, in_air, views_of_file, views_of_scene

REPORTED = "reported"


class Question(NamedTuple):
    """n pixels, each of its own exposure, and what is known of them.

    `shots` and `uv` (n, 2) have an entry for each pixel; `sensor`, `terrain` and `errors` (sources, without any: None)
    too where `axes`, for (sensor, shot, uv, terrain, errors), has 0, and are one for all where it has None. `carried`
    is told of each with its fix, `readings` are the names of the gimbal's axes, `assumed` sentences; `reads` all files.
    """

    sensor: Any
    shots: Any
    uv: Any
    terrain: Any
    errors: tuple[Any, ...] | None
    axes: tuple[int | None, ...]
    atmosphere: Any
    carried: list[dict[str, Any]]
    readings: tuple[str, ...]
    assumed: list[str]
    inputs: dict[str, Any]
    reads: list[Any]

    def lane(self, index: int) -> tuple[Any, Any, Any, Any, Any]:
        """(sensor, shot, pixel, terrain, errors) of one pixel."""
        import jax
        import numpy as np

        given = (self.sensor, self.shots, self.uv, self.terrain, self.errors)
        own = jax.tree.map(
            lambda leaf: np.asarray(leaf)[index], [one if a == 0 else None for one, a in self._of(given)]
        )
        one: Any = tuple(a if axis == 0 else b for a, b, axis in zip(own, given, self.axes, strict=True))
        return one

    def _of(self, given: tuple[Any, ...]) -> Any:
        return zip(given, self.axes, strict=True)


def told_question(asked: Asked, with_errors: bool | None, output: pathlib.Path | None) -> Question:
    """The question, what was assumed told on stderr. An `output` that would replace what is read is refused."""
    question = read_question(asked, with_errors=with_errors)
    if output is not None:
        check_no_input("--output", [output], question.reads)
    for one in question.assumed:
        tell(f"assumed: {one}")
    return question


def read_question(asked: Asked, *, with_errors: bool | None) -> Question:
    """All input, what is small and likely to be mistaken first.

    Errors are there `with_errors`; if that is None, where a FILE is given, or something says how it errs: a table
    [errors] of the scene, or an option. Raises `UserError`, and as the readers.
    """
    check_asked(asked)
    is_scene = asked.file is None or asked.file.suffix.lower() == ".toml"
    if with_errors is None and asked.shots is None:
        with_errors = not is_scene or asked.sigmas.are_given or None
    views = views_of_scene(asked) if is_scene else views_of_file(asked)
    if with_errors is None:
        with_errors = bool(views.sources) and asked.shots is None
    if asked.refraction:
        views = in_air(views)
    sources, assumed = (None, []) if not with_errors else _sources(views, asked)
    terrain, each_ground = _terrain(asked, views)
    axes = (0 if views.is_each else None, 0, 0, 0 if each_ground else None, 0 if views.is_each else None)
    return Question(
        views.sensor,
        views.shots,
        views.uv,
        terrain,
        sources,
        axes,
        views.atmosphere,
        views.carried,
        tuple(views.sensor.gimbal.names),
        [*views.assumed, *assumed],
        _inputs(asked),
        _reads(asked),
    )


def _sources(views: Views, asked: Asked) -> tuple[tuple[Any, ...], list[str]]:
    """(sources of error, one entry for each pixel where exposures have their own; what was assumed of the ground)."""
    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.uncertainty import sources

    of_ground = sources.TerrainHeight | sources.TerrainField
    count = len(views.uv)
    own = tuple(one for one in views.sources if not isinstance(one, of_ground))
    given = errors_given(own, asked.sigmas, views.sensor.gimbal, views.where, views.pixel_pitch)
    if views.is_each:
        given = tuple(one if np.ndim(one.sigma) > 1 else for_each(one, count) for one in given)
    ground, of_heights = ground_errors(views.sources, asked.sigmas, level=asked.ground is not None)
    if views.is_each:
        stated = {id(one) for one in views.sources}
        ground = tuple(one if id(one) in stated else for_each(one, count) for one in ground)
    found = (*given, *ground)
    if not found:
        raise UserError(
            f"nothing says how {views.where} errs: write a table [errors] in the scene, or give --position-sigma, "
            f"--attitude-sigma, --gimbal-sigma, --dem-sigma."
        )
    return found, [*views.assumed_of_errors, *of_heights]


def _terrain(asked: Asked, views: Views) -> tuple[Any, bool]:
    """(the ground, whether there is one for each pixel)."""
    import numpy as np

    from jaxgeo.io.scene import ellipsoidal_heights
    from jaxgeo.terrain import ConstantHeight

    if asked.ground is None:
        return read_terrain(asked.dem, asked.vertical_datum, asked.reading), False
    if asked.ground == REPORTED:
        heights = views.centre_heights
        if heights is None or not np.isfinite(heights).any():
            raise UserError(f"--ground {REPORTED}: {views.where} reports no height of what its images show; give it.")
        return ConstantHeight(np.asarray(heights)), True
    try:
        height = float(asked.ground)
    except ValueError:
        height = math.nan
    if not math.isfinite(height):
        raise UserError(f"--ground {asked.ground!r}: expected a height in m, or {REPORTED!r}.")
    if asked.vertical_datum is None:
        return ConstantHeight(np.asarray(height)), False
    position = views.shots.pose.position
    lon, lat = (np.rad2deg(np.asarray(angle)) for angle in (position.lon, position.lat))
    datum = said_datum(asked.vertical_datum)
    return ConstantHeight(ellipsoidal_heights(lon, lat, np.full(len(lon), height), datum)), True


def _inputs(asked: Asked) -> dict[str, Any]:
    """What was typed, in plain words."""
    paths = {"file": asked.file, "scene": asked.scene, "shots": asked.shots}
    found: dict[str, Any] = {name: str(path) for name, path in paths.items() if path is not None}
    found |= {"dem": list(asked.dem)} if asked.dem else {"ground": asked.ground}
    found |= {f"dem_{name}": value for name, value in asked.reading._asdict().items() if value is not None}
    if asked.vertical_datum is not None:
        found["vertical_datum"] = asked.vertical_datum
    found |= {name: str(value) if isinstance(value, pathlib.Path) else value for name, value in asked.how.items()}
    sigmas = {name: value for name, value in asked.sigmas._asdict().items() if value is not None}
    return found | ({"sigmas": sigmas} if sigmas else {}) | ({"refraction": True} if asked.refraction else {})


def _reads(asked: Asked) -> list[Any]:
    named = [asked.file, asked.scene, asked.shots, asked.how.get("errors"), asked.how.get("interior")]
    files: list[Any] = [one for one in named if one is not None]
    camera = asked.how.get("camera")
    files += [camera] if camera is not None and str(camera).lower().endswith(".toml") else []
    for folder in [one for one in files if pathlib.Path(one).is_dir()]:
        files += sorted(pathlib.Path(folder).iterdir())
    return [*files, *(terrain_files(asked.dem, asked.vertical_datum) if asked.dem else [])]

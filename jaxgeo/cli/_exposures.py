"""Exposures and pixels from a scene or from files, before the ground is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import pixel_pitch_of
from jaxgeo.cli._inputs import check_stated, height_datum_of, numbers_in, shot_of
from jaxgeo.cli._locate_options import LocateOptions
from jaxgeo.cli._option_names import reason_not_read


class Seen(NamedTuple):
    """n pixels whose exposures share one structure (one camera), as in `Batch`; `rows` (n,) are their row numbers.

    `centre_heights` (n,) are the ground heights at the image centres in m, as reported by their files.
    """

    sensor: Any
    shots: Any
    uv: Any
    sources: tuple[Any, ...]
    rows: Any
    centre_heights: Any = None


class ExposureSet(NamedTuple):
    """All pixels and their exposures, before the ground is read.

    `carried` holds the input columns of each row, in order; `unread` the reasons of rows whose file could not be read.
    `is_each`: whether each pixel has its own sensor and error sources. `where` names their file.
    """

    seen: list[Seen]
    is_each: bool
    carried: list[dict[str, Any]]
    atmosphere: Any
    assumed: list[str]
    where: Any
    pixel_pitch: float | None
    assumed_of_errors: list[str]
    unread: dict[int, Any]

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of the gimbal axes."""
        return tuple(self.seen[0].sensor.gimbal.names)

    @property
    def position(self) -> Any:
        """Positions of all rows, a `Geodetic`; NaN if the file could not be read."""
        import jax
        import numpy as np

        rows = np.concatenate([one.rows for one in self.seen])

        def placed(values: Any) -> Any:
            whole = np.full(len(self.carried), np.nan)
            whole[rows] = values
            return whole

        return jax.tree.map(placed, joined_positions(self.seen))

    @property
    def reasons(self) -> list[str | None] | None:
        """Reason per row why its file could not be read, or None; None if all were read."""
        return reasons_of(self.unread, len(self.carried))


def joined_positions(parts: Sequence[Any]) -> Any:
    """Concatenated positions of the shots of several parts, a `Geodetic`."""
    import jax
    import numpy as np

    each = [part.shots.pose.position for part in parts]
    return jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves]), *each)


def reasons_of(unread: Mapping[int, Any], count: int) -> list[str | None] | None:
    """Reason for each of `count` rows why its file could not be read, or None; None if all were read."""
    if not unread:
        return None
    found = {row: reason_not_read(one) for row, one in unread.items()}
    return [found.get(row) for row in range(count)]


def views_of_scene(asked: LocateOptions) -> ExposureSet:
    import jax
    import numpy as np

    from jaxgeo.io.errors import OutsideDatum, VerticalDatumError
    from jaxgeo.io.scene import SceneError, read_scene
    from jaxgeo.io.tables import read_shots

    path = asked.scene_file
    assert path is not None
    if asked.files and asked.scene is not None:
        raise UserError(f"{path} is itself a scene file; leave out --scene {asked.scene}.")
    if asked.how:
        raise UserError(f"--{next(iter(asked.how)).replace('_', '-')} does not apply to scene files; leave it out.")
    scene = read_scene(path)
    sources = () if scene.errors is None else scene.errors.sources
    if asked.shots is None:
        shot = shot_of(scene, path, "--pixel")
        uv = pixels_of(asked.pixels, scene.sensor.camera)
        shots = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(uv), *np.shape(leaf))), shot)
        carried: list[dict[str, Any]] = [{"u": float(u), "v": float(v)} for u, v in uv]
    else:
        height_datum = height_datum_of(scene, path, asked.shots)
        table = read_shots(asked.shots, scene.sensor.gimbal.names)
        check_stated(table, asked.shots, scene.sensor.gimbal, height_datum)
        try:
            shots, uv = table.as_records(scene.sensor.gimbal.names, height_datum)
        except (OutsideDatum, VerticalDatumError) as error:
            raise SceneError(f"{path}, with the heights of {asked.shots}: {error}") from error
        carried = table.rows
    seen = Seen(scene.sensor, shots, uv, sources, np.arange(len(uv)))
    return ExposureSet([seen], False, carried, scene.atmosphere, [], f"{path}", pixel_pitch_of(path), [], {})


def pixels_of(texts: list[str], camera: Any) -> Any:
    """Pixels (n, 2) from the command line; the image centre if none is given. Raises `UserError`."""
    import numpy as np

    found = [numbers_in("--pixel", text, (2,), "COLUMN,ROW, two numbers, e.g. --pixel 100,200") for text in texts]
    return np.array(found or [[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])


def in_air(views: ExposureSet) -> ExposureSet:
    """The exposures with a standard atmosphere, sea level taken at the first exposure. Raises `UserError`."""
    import numpy as np

    from jaxgeo.earth import Atmosphere
    from jaxgeo.io import undulation

    if views.atmosphere is not None:
        raise UserError(f"--refraction: {views.where} already has an [air] table; leave the option out.")
    position = views.seen[0].shots.pose.position
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return views._replace(atmosphere=Atmosphere(sea_level=float(undulation(lat, lon))))

"""Level ground of commands about whole images: a height in m above the ellipsoid or a datum."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgeo._text_numbers import number_in
from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import Look, as_datum, check_goes_with_dem, read_terrain
from jaxgeo.cli._locate_options import NO_GROUND, GroundOptions
from jaxgeo.terrain import ConstantHeight


def check_ground(ground: GroundOptions) -> None:
    """Raises `UserError` unless there is either an elevation model or a height."""
    if ground.dem and ground.level is not None:
        raise UserError("--dem and --ground exclude each other: give one of them.")
    if not ground.dem and ground.level is None:
        raise UserError(NO_GROUND)
    if ground.dem:
        return
    check_goes_with_dem(ground)
    if number_in(ground.level or "") is None:
        raise UserError(f"--ground {ground.level!r}: expected a height in m.")


def terrain_of(ground: GroundOptions, shot: Callable[[], Any], look: Look) -> Any:
    """The elevation model for the lines of sight of `look`, or level ground at the height above its datum that it has
    at one `shot`."""
    return level_at(shot(), ground) if ground.level is not None else read_terrain(ground.dem or [], ground, look)


def with_ground(inputs: dict[str, Any]) -> dict[str, Any]:
    """Given options by the names that they have on the command line."""
    return {("ground" if name == "level" else name): value for name, value in inputs.items()}


def level_at(shot: Any, ground: GroundOptions) -> ConstantHeight:
    """Level ground at the height of `--ground`, above the datum as it is at the shot."""
    height = number_in(ground.level or "")
    assert height is not None
    if ground.vertical_datum is None:
        return ConstantHeight(np.float64(height))
    from jaxgeo.io.scene import ellipsoidal_heights

    position = shot.pose.position
    lon, lat = (np.rad2deg(np.atleast_1d(np.asarray(angle))) for angle in (position.lon, position.lat))
    return ConstantHeight(ellipsoidal_heights(lon, lat, np.array([height]), as_datum(ground.vertical_datum))[0])

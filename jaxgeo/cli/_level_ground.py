"""Level ground of commands about whole images: a height in m above the ellipsoid or a datum."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo._text_numbers import number_in
from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import Look, as_datum, check_goes_with_dem, read_terrain
from jaxgeo.cli._locate_options import NO_GROUND, GroundOptions
from jaxgeo.terrain import ConstantHeight

if TYPE_CHECKING:
    from jaxgeo.io import Observations

FAR = 50.0  # m: five usual standard deviations of level ground


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


def ground_doubts(observed: Observations, ground: GroundOptions, instead: str | None) -> list[str]:
    """Sentences on level ground that is far from what files report: the frame centre, and the take-off.

    `instead` are the options by which heights above the take-off replace the altitudes of files (`takeoff_instead`).
    """
    from jaxgeo.io.acquisitions.sentences import DOUBT

    height = number_in(ground.level or "")
    if height is None:
        return []
    or_instead = "" if instead is None else f"; or, if the altitude of the files is the wrong one, {instead}"
    centres, takeoffs = [], []
    for batch in observed.batches:
        level = level_at(batch.at(0)[0].exposure.motion, ground).height
        own = np.asarray(batch.shots.pose.position.height)
        centres += [] if batch.centre_heights is None else (batch.centre_heights - level).tolist()
        takeoffs += [] if batch.above_takeoff is None else (own - batch.above_takeoff - level).tolist()
    doubts = []
    for what, values, advice in (
        ("The files report the frame centre", centres, "."),
        ("The take-off is", takeoffs, f" if the ground is as high as the take-off{or_instead}."),
    ):
        known = np.array(values)[np.isfinite(values)]
        off = float(np.median(known)) if known.size else 0.0
        if abs(off) > FAR:
            side = "above" if off > 0.0 else "below"
            where = f"{abs(off):.0f} m {side} --ground {ground.level}"
            doubts.append(f"{DOUBT}{what} {where}. Give --ground {height + off:.0f}{advice}")
    return doubts


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

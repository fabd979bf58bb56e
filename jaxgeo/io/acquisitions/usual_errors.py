"""Default errors for files that state none, each with a sentence."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from jaxgeo.io.acquisitions.record import Acquisition, for_each
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty.sources import AbstractSource, Attitude, GimbalAngles, Position

POSITION = (3.0, 3.0, 5.0)  # m north, east, down: a GNSS receiver without corrections
ATTITUDE = (0.3, 0.1, 0.1)  # deg heading, pitch, roll: a small inertial system
READINGS = 0.1  # deg: encoders of a gimbal on such a system
LEVEL = {"yaw": 1.0}  # deg, of a drone gimbal relative to level and north: its yaw depends on a compass
LEVEL_ELSE = 0.5  # deg: its other angles
OF_DRONES = (
    "subtitle file of DJI",
    "video of DJI",
    "flight log of AirData",
    "flight log of Litchi",
    "flight log of Flight Reader",
)  # whose pose has the angles of such a gimbal


def with_usual_errors(found: Acquisition) -> Acquisition:
    """The exposures, with default errors of position, attitude and gimbal where the file states none.

    Each has a sentence in `assumed`, with its numbers: replace what you know better. 3, 3 and 5 m (north, east, down)
    for the position, the last and `takeoff_sigma` as root of the sum of squares; for a gimbal relative to level, 1 deg
    for yaw and 0.5 deg for the rest; else 0.3, 0.1 and 0.1 deg for heading, pitch and roll (for drone logs, whose poses
    are the gimbal's, 1, 0.5 and 0.5 deg), and 0.1 deg for each gimbal reading. If a file states any angle errors, no
    default angle errors are added.
    """
    made = usual_errors_of(found)
    added = tuple(for_each(source, len(found)) for source, _ in made)
    notes = (*found.assumed, *(sentence for _, sentence in made))
    return dataclasses.replace(found, sources=(*found.sources, *added), assumed=notes)


def usual_errors_of(found: Acquisition) -> list[tuple[AbstractSource, str]]:
    """The sources that `with_usual_errors` adds, common to all exposures, each with its sentence."""
    gimbal = None if found.sensor is None else found.sensor.gimbal
    return usual_errors(found.sources, gimbal, of_drone=found.form in OF_DRONES, takeoff_sigma=found.takeoff_sigma)


def usual_errors(
    stated: Sequence[AbstractSource], gimbal: Gimbal | None, *, of_drone: bool = False, takeoff_sigma: float = 0.0
) -> list[tuple[AbstractSource, str]]:
    """Default sources of position, attitude and gimbal beside those stated, each with its sentence.

    `takeoff_sigma`, in m, is that of the height of the take-off, to which heights above it were added.
    """
    kinds = [type(source) for source in stated]
    made = [] if Position in kinds else [_position(takeoff_sigma)]
    return made if Attitude in kinds or GimbalAngles in kinds else [*made, *_angles(gimbal, of_drone)]


def _position(takeoff_sigma: float) -> tuple[AbstractSource, str]:
    north, east, alone = POSITION
    down = math.hypot(alone, takeoff_sigma)
    of_takeoff = f", with {takeoff_sigma:.3g} m of the take-off" if takeoff_sigma else ""
    note = f"Position sigma: {north:g}, {east:g}, {down:.3g} m (N, E, D; default{of_takeoff})."
    return Position.from_ned(north=north, east=east, down=down), note


def _angles(gimbal: Gimbal | None, of_drone: bool) -> list[tuple[AbstractSource, str]]:
    is_level = gimbal is not None and gimbal.reference == "level"
    made: list[tuple[AbstractSource, str]] = []
    if not is_level:
        heading, pitch, roll = (LEVEL["yaw"], LEVEL_ELSE, LEVEL_ELSE) if of_drone else ATTITUDE
        note = f"Attitude sigma: {heading:g}, {pitch:g}, {roll:g} deg (heading, pitch, roll; default)."
        made.append((Attitude.from_degrees(heading=heading, pitch=pitch, roll=roll), note))
    if gimbal is not None and gimbal.names:
        sigma: dict[str, Any] = {name: LEVEL.get(name, LEVEL_ELSE) if is_level else READINGS for name in gimbal.names}
        figures = ", ".join(f"{value:g}" for value in sigma.values())
        note = f"Gimbal angle sigma: {figures} deg ({', '.join(sigma)}; default)."
        made.append((GimbalAngles.from_degrees(**sigma), note))
    return made

"""Strips over a plain and over mountains, comparable to Figs. 11 and 12 of Li et al. (2020).

The paper's images are not available. Here an aircraft whose speed and height oscillate by 5 % takes strips with the
paper's camera, 65 deg off nadir, over level ground and over the mountains of the example terrain. The paper times its
strips by the current speed and height, Eq 36, over the planned ground height; three other timings are compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.coverage import FixedPeriod, GroundShared, Overlap, VelocityHeight, geometry, plan
from jaxgeo.io import example_dem
from jaxgeo.sensor import Pose, Trajectory
from jaxgeo.studies.li2020 import printed
from jaxgeo.terrain import ConstantHeight

OFF_NADIR = 65.0  # deg
PLANNED = 300.0  # m above the ellipsoid, ground height of the fixed period's plan: that of the valleys
HEIGHT, SPEED, HEADING = 5500.0, 170.0, 150.0  # m, m/s, deg
SWING, OF_SPEED, OF_HEIGHT = 0.05, 23.0, 31.0  # relative amplitude, and periods in s
LAT, LON = 36.40, -84.20  # deg, start of the flight
DURATION = 30.0  # s
METRES_NORTH, METRES_EAST = 110_940.0, 111_320.0  # per degree, the latter at the equator
PLAIN, MOUNTAINS = "plain", "mountains"
AS_IN_THE_PAPER = "planned height"  # the timing of Figs. 11 and 12


@dataclass(frozen=True)
class Strips:
    """Strips of a flight: the ground, the timing method, exposure times (s), and the overlap of each strip (except
    the first) with the previous one."""

    ground: str
    timing: str
    times: np.ndarray
    overlaps: Overlap

    @property
    def near(self) -> np.ndarray:
        """Overlap at the near end, of each strip except the first."""
        return np.asarray(self.overlaps.near)

    @property
    def rms(self) -> float:
        """Root mean square difference from the required overlap, at the near end."""
        return float(np.sqrt(np.mean((self.near - printed.OVERLAP) ** 2)))


def strips() -> list[Strips]:
    """Strips over the plain and over the mountains, with each timing method."""
    camera, flight = printed.sensor(mirror=False), _flight()
    grounds: dict[str, Any] = {PLAIN: ConstantHeight(PLANNED), MOUNTAINS: example_dem()}
    timings: dict[str, Any] = {
        "fixed period": FixedPeriod(_planned_period()),
        AS_IN_THE_PAPER: VelocityHeight(printed.OVERLAP, height=PLANNED),
        "velocity-height": VelocityHeight(printed.OVERLAP),
        "ground shared": GroundShared(printed.OVERLAP, stations=5),
    }
    found = []
    for ground, terrain in grounds.items():
        for name, timing in timings.items():
            flown = plan(camera, flight, terrain, timing, along="rows")
            found.append(Strips(ground, name, np.asarray(flown.times), flown.overlaps))
    return found


def _planned_period() -> float:
    """Period by Eq 29 at the mean speed and height, over the planned ground height, at the near end of the strip."""
    half = math.degrees(math.atan(0.5 * printed.ACROSS * printed.PIXEL_PITCH / printed.FOCAL_LENGTH))
    period = geometry.period_of_overlap(
        overlap=printed.OVERLAP,
        speed=SPEED,
        height_above_ground=HEIGHT - PLANNED,
        off_nadir=math.radians(OFF_NADIR - half),
        field_of_view=math.radians(printed.FIELD_OF_VIEW),
    )
    return float(period)


def _flight() -> Trajectory:
    """Straight flight with oscillating speed and height."""
    times = np.linspace(0.0, DURATION, 61)
    speed = SPEED * (1.0 + SWING * np.sin(2.0 * np.pi * times / OF_SPEED))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])
    heading = math.radians(HEADING)
    pose = Pose.from_degrees(
        lat=LAT + way * math.cos(heading) / METRES_NORTH,
        lon=LON + way * math.sin(heading) / (METRES_EAST * math.cos(math.radians(LAT))),
        height=HEIGHT * (1.0 + SWING * np.sin(2.0 * np.pi * times / OF_HEIGHT + 1.0)),
        heading=np.full(times.shape, HEADING),
    )
    return Trajectory.from_knots(times, pose, np.tile(np.radians([OFF_NADIR, 0.0]), (len(times), 1)))

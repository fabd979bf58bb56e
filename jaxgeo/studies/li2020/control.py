"""Overlap with gimbal control errors: the first subject that Li et al. (2020) leave to future work.

The paper's camera and flight (near end 74 deg off nadir, 8143 m above level ground, 172 m/s) take strips of a few
frames with random errors: attitude with and without compensation, and both drives, redrawn for each frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import numpy as np
from scipy.special import ndtri

from jaxgeo.coverage import Compensation, FlightNoise, Strip, fly
from jaxgeo.sensor import Pose, Shot
from jaxgeo.studies.li2020 import printed
from jaxgeo.terrain import ConstantHeight

IMAGES, STATIONS = 3, 5
ATTITUDE = 0.1  # deg, standard deviation of heading, pitch and roll; if larger, frames no longer overlap
LASTING = 0.1  # s, correlation time: independent for each frame
CONTROL = (0.0025, 0.005, 0.01, 0.02, 0.05)  # deg, standard deviation of a drive's reading
FREE = 0.99  # required share of pairs without a gap
HALF = math.degrees(math.atan(0.5 * printed.ACROSS * printed.PIXEL_PITCH / printed.FOCAL_LENGTH))  # half field, deg


@dataclass(frozen=True)
class Control:
    """Overlap at the near end of strips with random errors.

    `attitude` and `control` are standard deviations in deg, of the three angles and of a drive; `mean` and `spread`
    (standard deviation) are those of the overlap, with standard errors; `formula` is the spread by Eqs 18, 19 and the
    mirror's gain of two, `gaps` the share of pairs with a gap, and `needed` the nominal overlap at which 99 % of pairs
    have no gap, given the spread.
    """

    attitude: float
    is_compensated: bool
    control: float
    mean: float
    mean_error: float
    spread: float
    spread_error: float
    formula: float
    gaps: float
    needed: float


def controls(flights: int = 512, *, seed: int = 0) -> list[Control]:
    """Attitude errors alone, compensated, and compensated by drives with each of the errors `CONTROL`.

    All rows use the same standard normal draws.
    """
    strip = _strip()
    rows = [(ATTITUDE, False, 0.0), *((ATTITUDE, True, control) for control in (0.0, *CONTROL))]
    return [_flown(strip, row, flights, seed) for row in rows]


def spread_by_formula(attitude_deg: float, control_deg: float) -> float:
    """Standard deviation of the overlap of two frames, from errors of heading and pitch (Eqs 18 and 19) or of the
    azimuth drive, whose mirror turns the line of sight by twice the angle; both frames have errors. Small angles,
    level ground."""
    theta, opening = math.radians(printed.OFF_NADIR), 2.0 * math.tan(math.radians(0.5 * printed.FIELD_OF_VIEW))
    by_attitude = math.radians(attitude_deg) * math.hypot(math.sin(theta), math.cos(theta))
    by_drive = 2.0 * math.radians(control_deg)
    return math.sqrt(2.0) * math.hypot(by_attitude, by_drive) / opening


def _strip() -> Strip:
    sensor, row = printed.sensor(mirror=True), printed.TABLE_4[0]
    pose = Pose.from_degrees(lat=row.lat, lon=row.lon, height=row.height_above_ground, heading=180.0)
    readings = sensor.gimbal.readings_from_degrees(depression=90.0 - printed.OFF_NADIR - HALF, azimuth=45.0)
    return Strip.planned(
        sensor,
        Shot(pose, readings),
        ConstantHeight(0.0),
        overlap=printed.OVERLAP,
        speed=row.speed_kmh / 3.6,
        images=IMAGES,
        along="rows",
        stations=STATIONS,
    )


def _flown(strip: Strip, row: tuple[float, bool, float], flights: int, seed: int) -> Control:
    attitude, is_compensated, control = row
    noise = FlightNoise.from_degrees(heading=attitude, pitch=attitude, roll=attitude, gimbal=control, lasting=LASTING)
    compensation = Compensation(attitude=is_compensated)
    found = fly(strip, noise, key=jax.random.key(seed), flights=flights, compensation=compensation)
    near = np.asarray(found.near)
    means = near.mean(axis=1)  # pairs of one flight share a frame
    spread, spread_error = _spread(near)
    return Control(
        attitude,
        is_compensated,
        control,
        float(means.mean()),
        float(means.std(ddof=1) / math.sqrt(len(means))),
        spread,
        spread_error,
        spread_by_formula(0.0 if is_compensated else attitude, control),
        float(np.mean(np.asarray(found.gap))),
        float(ndtri(FREE)) * spread,
    )


def _spread(near: np.ndarray) -> tuple[float, float]:
    """Standard deviation over all pairs, and its standard error from those of the flights."""
    squares = np.mean((near - near.mean()) ** 2, axis=1)
    spread = math.sqrt(squares.mean())
    return spread, float(squares.std(ddof=1) / math.sqrt(len(squares)) / (2.0 * spread)) if spread > 0.0 else 0.0

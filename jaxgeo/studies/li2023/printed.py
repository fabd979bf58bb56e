"""Printed values of Li et al. (2023) in their units (deg and m), with the corresponding sensor and shots."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxgeo.earth import Geodetic
from jaxgeo.sensor import Pose, Sensor, Shot
from jaxgeo.sensor.conventions import li_2023_sensor
from jaxgeo.terrain import ConstantHeight

HEADING, PITCH, ROLL = -102.4800, 2.8679, -0.3876  # deg, Table 2: the same in all three rows
DEM_SIGMA = 20.0  # m, section 5.2: ASTER GDEM V2
UV = (3791.5, 24417.5)  # centre of their image of 7584 columns and 48836 rows: the line of sight

LOS_RMS = 0.0681  # deg, section 5.1
ANGLE_SIGMAS = (0.05, 0.02, 0.02, 0.02, 0.02, 0.03, 0.01, 0.01, 0.01, 0.01)  # deg, Table 1, in its order
DRAWS = 10_000  # in their simulation
LOS_NOMINAL = (0.9386, -0.2277, 0.2592)  # section 5.1, north, east, down
LOS_WITHIN = {0.10: 0.8624, 0.15: 0.984}  # share of the 10 000 pointing errors below an angle in deg
LOS_BAND = (0.004, 0.05)  # deg, said to contain "more than 50 %" of them

FIG_5_AIRCRAFT = (28.9702, 89.0043, 15409.0)  # lat, lon in deg, height in m
FIG_5_GROUND = 3824.0  # m
FIG_5_SIGMAS = (10.0, 190.0)  # m, from and to


class Terrain(NamedTuple):
    """A row of Tables 2 and 3: aircraft and frame, the located target, its errors, and that against a map."""

    lat: float
    lon: float
    outer: float
    inner: float
    target: tuple[float, float, float]
    lat_rms: float
    lon_rms: float
    height_rms: float
    rms: float
    cep: float
    actual: float


TERRAINS = {
    "plain": Terrain(
        *(28.9702, 89.0043, 74.6747, 0.2304),
        target=(29.3559124, 88.8988296, 3850.0036),
        lat_rms=0.001131,
        lon_rms=0.000546,
        height_rms=20.3096,
        rms=137.7469,
        cep=114.7890,
        actual=153.5,
    ),
    "hill": Terrain(
        *(28.9703, 89.0045, 75.3977, -0.7532),
        target=(29.3746921, 88.9026302, 3935.7022),
        lat_rms=0.000903,
        lon_rms=0.000496,
        height_rms=26.7596,
        rms=114.3994,
        cep=95.3328,
        actual=118.8,
    ),
    "mountain": Terrain(
        *(28.9705, 89.0056, 78.7673, -0.7064),
        target=(29.4453004, 88.8862045, 5289.8706),
        lat_rms=0.001923,
        lon_rms=0.000499,
        height_rms=36.2531,
        rms=221.8547,
        cep=184.8812,
        actual=516.9,
    ),
}
MOUNTAIN_INNER = -0.6064  # deg: puts the mountain's target at the printed position; Table 2 prints -0.7064
ALTITUDE = 15_409.0  # m, in all three rows


def sensor() -> Sensor:
    """The camera of section 5.2 in its two-axis frame; the line of sight uses only its central pixel."""
    return li_2023_sensor(focal_length=1.9, pixel_pitch=10e-6, width=7584, height=48836)


def shot_of(terrain: Terrain, inner: float | None = None) -> Shot:
    """The shot of a row of Table 2, optionally with another inner frame angle in deg."""
    lat, lon = terrain.lat, terrain.lon
    pose = Pose.from_degrees(lat=lat, lon=lon, height=ALTITUDE, heading=HEADING, pitch=PITCH, roll=ROLL)
    return _shot(pose, terrain.outer, terrain.inner if inner is None else inner)


def level_shot(outer: float) -> Shot:
    """The aircraft of Fig. 5 in level flight, the inner frame at zero and the outer at an angle in deg.

    The paper states no heading; that of Table 2 is used.
    """
    lat, lon, height = FIG_5_AIRCRAFT
    return _shot(Pose.from_degrees(lat=lat, lon=lon, height=height, heading=HEADING), outer, 0.0)


def level_ground(height: float) -> ConstantHeight:
    """Ground of one height in m, as an array, so that all heights share one compiled program."""
    return ConstantHeight(jnp.asarray(height, jnp.float64))


def target_of(terrain: Terrain) -> Geodetic:
    """The printed target."""
    lat, lon, height = terrain.target
    return Geodetic.from_degrees(lat=lat, lon=lon, height=height)


def _shot(pose: Pose, outer: float, inner: float) -> Shot:
    return Shot(pose, sensor().gimbal.readings_from_degrees(outer=outer, inner=inner))

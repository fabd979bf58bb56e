"""Printed values of Li et al. (2020) in their units (deg, m and km/h), with the corresponding sensor, map and shots."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp

from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.sensor import Pose, Sensor, Shot
from jaxgeo.sensor.conventions import li_2020_sensor
from jaxgeo.terrain import ConstantHeight

FIELD_OF_VIEW = 0.88  # deg along the flight
OFF_NADIR = 74.0  # deg, of Tables 1 to 3 and of the compensation
OVERLAP = 0.15  # required overlap throughout

CHANGES = (0.2, 0.4, 0.6, 0.8, 1.0)  # deg
TABLES = {  # Tables 1, 2 and 3: change of the overlap by a change of one angle
    "heading": (0.2185, 0.4369, 0.6553, 0.8738, 1.0920),
    "pitch": (-0.0640, -0.1280, -0.1920, -0.2560, -0.3200),
    "roll": (0.0104, 0.0207, 0.0311, 0.0415, 0.0519),
}

HEADING_BEFORE, ATTITUDE_AFTER = 180.0, (179.0, 1.0, 1.0)  # deg, the compensation: heading; heading, pitch, roll
AZIMUTH_DRIVE_CHANGE, DEPRESSION_CHANGE = 0.618, -1.016  # deg, Eqs 25 and 26

MOUNTAIN_HEIGHT = 8080.0  # m above the planned ground height (8460 - 380)
MOUNTAIN_CHANGE = -620.0  # m, the mountain is nearer by this amount
MOUNTAIN_OVERLAP_CHANGE, MOUNTAIN_OVERLAP, MOUNTAIN_FLOWN = -0.077, 0.073, 0.07
FLOWN = 0.16  # mean overlap over the plain, from the images


class Strip(NamedTuple):
    """A column of Table 4. It prints beta with roll and alpha with pitch, opposite to Eq 4; the words are used."""

    lat: float
    lon: float
    height_above_ground: float
    speed_kmh: float
    heading: float
    roll: float
    pitch: float
    azimuth_drive: float
    depression_drive: float
    overlap: float | None


TABLE_4 = (
    Strip(34.862798, 109.511151, 8143.0, 620.09, 159.086, 2.158, 3.630, 45.415, 13.885, None),
    Strip(34.859568, 109.513024, 8139.0, 620.11, 159.214, 2.081, 3.789, 45.398, 13.961, 0.16),
    Strip(34.856361, 109.514869, 8142.0, 620.09, 159.263, 1.820, 3.766, 45.361, 14.216, 0.16),
    Strip(34.853151, 109.516707, 8139.0, 620.21, 159.471, 1.826, 3.621, 45.235, 14.211, 0.15),
    Strip(34.850027, 109.518486, 8140.0, 620.31, 159.543, 1.820, 3.652, 45.219, 14.216, 0.17),
)
CENTRAL_MERIDIAN = 111.0  # deg, that of the six-degree zone of Table 4; the paper names none

ALONG, ACROSS, PIXEL_PITCH = 3072, 4096, 9e-6  # of a detector; only the field of view affects the study
FOCAL_LENGTH = 0.5 * ALONG * PIXEL_PITCH / math.tan(math.radians(0.5 * FIELD_OF_VIEW))  # m
MIDDLE = ((ACROSS - 1) / 2.0, (ALONG - 1) / 2.0)
EDGES = ((MIDDLE[0], ALONG - 0.5), MIDDLE, (MIDDLE[0], -0.5))  # rear edge, line of sight, front edge of a frame


def sensor(*, mirror: bool) -> Sensor:
    """The camera, with the paper's field of view along the flight; read by the drives of Table 4 or angles of Eq 3."""
    return li_2020_sensor(
        focal_length=FOCAL_LENGTH,
        pixel_pitch=PIXEL_PITCH,
        along_flight=ALONG,
        across_flight=ACROSS,
        mirror=mirror,
    )


def gauss_krueger() -> TransverseMercator:
    """The map about the zone's meridian; Eqs 10 to 12 are its series, micrometres off in this zone."""
    return TransverseMercator.gauss_krueger(math.radians(CENTRAL_MERIDIAN))


def ground() -> ConstantHeight:
    """Level ground, at height 0: heights above the ground are then ellipsoidal."""
    return ConstantHeight(jnp.zeros(()))


def pose_of(strip: Strip) -> Pose:
    """Position and attitude of the aircraft at a strip's near end."""
    return Pose.from_degrees(
        lat=strip.lat,
        lon=strip.lon,
        height=strip.height_above_ground,
        heading=strip.heading,
        pitch=strip.pitch,
        roll=strip.roll,
    )


def shot_of(strip: Strip) -> Shot:
    """The exposure at a strip's near end."""
    drives = {"depression": strip.depression_drive, "azimuth": strip.azimuth_drive}
    return Shot(pose_of(strip), sensor(mirror=True).gimbal.readings_from_degrees(**drives))

"""Footprints of a strip, of the next strip as planned, and of the next strip with another attitude, without and with
compensation: Figs. 7 and 8 of Li et al. (2020)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax.numpy as jnp

from jaxgeo.coverage import Footprint, Overlap, compensate, footprint, overlap
from jaxgeo.earth import Geodetic
from jaxgeo.sensor import Pose, Shot
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.influence import START, required_flight


@dataclass(frozen=True)
class Outlines:
    """Footprints by name, the overlap of each (except the first) with the first, and the centre of the first."""

    footprints: dict[str, Footprint]
    overlaps: dict[str, Overlap]
    middle: Geodetic


FIRST, EXPECTED = "strip at T0", "expected at T1"
ACTUAL, COMPENSATED = "actual at T1", "compensated at T1"


def outlines() -> Outlines:
    """Footprints from the position and height of Table 4's first strip; the step gives the required overlap."""
    camera, ground = printed.sensor(mirror=False), printed.ground()
    before, after = required_flight()
    level = (printed.HEADING_BEFORE, 0.0, 0.0)
    shots = {
        FIRST: _shot(before, level),
        EXPECTED: _shot(after, level),
        ACTUAL: _shot(after, printed.ATTITUDE_AFTER),
    }
    readings = compensate(camera, shots[FIRST], shots[ACTUAL]).readings
    shots[COMPENSATED] = Shot(shots[ACTUAL].pose, readings)
    seen = {name: footprint(camera, shot, ground) for name, shot in shots.items()}
    shared = {
        name: overlap(camera, shots[FIRST], shot, ground, along="rows") for name, shot in shots.items() if name != FIRST
    }
    where = seen[FIRST].fix.position
    middle = Geodetic(lat=jnp.mean(where.lat), lon=jnp.mean(where.lon), height=jnp.zeros(()))
    return Outlines(seen, shared, middle)


def _shot(lat: float, attitude: tuple[float, float, float]) -> Shot:
    """A shot looking right, level, from a latitude in rad; heading, pitch and roll in deg."""
    heading, pitch, roll = attitude
    pose = Pose.from_degrees(
        lat=math.degrees(lat),
        lon=START.lon,
        height=START.height_above_ground,
        heading=heading,
        pitch=pitch,
        roll=roll,
    )
    return Shot(pose, printed.sensor(mirror=False).gimbal.readings_from_degrees(outer=printed.OFF_NADIR, inner=0.0))

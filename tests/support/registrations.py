"""Real frames with disturbed poses, and the error of a registration against the given orientation."""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np

from jaxgeo._locate import locate
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.register.registration import Registration, register_image
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.sensor import Shot
from jaxgeo.studies.gu2017.scene import disturbed
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import ErrorModel, sources
from support.ngi import Flight

HEIGHT = 3.0  # m: error of the elevation model, as a whole and over a kilometre
PIXELS = np.array([(319.5, 575.5), (40.0, 40.0), (600.0, 40.0), (40.0, 1100.0), (600.0, 1100.0)])
REFERENCES = {"05_0182": 1, "05_0184": 2}


class Trial(NamedTuple):
    """A registration from a disturbed pose. Unless it was refused: for the pixels `PIXELS` the horizontal distance
    in m from the given orientation's ground point and the larger of its two components in standard deviations; and
    the differences of position (north, east, down) and attitude from the given ones, in standard deviations."""

    registration: Registration
    off: np.ndarray
    off_sigmas: np.ndarray
    pose_sigmas: np.ndarray


def errors(position: float, attitude_deg: float) -> ErrorModel:
    """Error model of a navigation with these sigmas, m and deg along each axis, over this terrain."""
    return ErrorModel(
        (
            sources.Position.from_ned(north=position, east=position, down=position),
            sources.Attitude.from_degrees(heading=attitude_deg, pitch=attitude_deg, roll=attitude_deg),
            sources.TerrainHeight.from_metres(HEIGHT),
        )
    )


def tie_errors() -> TieErrors:
    """Tie errors of the orthophotos, and of the terrain heights about its mean."""
    field = sources.TerrainField.of_variograms(gaussian=[(HEIGHT, 1000.0)])
    return TieErrors(registration=0.5, terrain=1.0, shift=1.0, terrain_field=field)


def trial(flight: Flight, frame: str, rng: np.random.Generator, position: float, attitude_deg: float) -> Trial:
    """Register a frame from a pose with random errors."""
    truth = flight.shots[frame]
    found = register_image(
        flight.sensor,
        disturbed(truth, rng, metres=position, degrees=attitude_deg),
        flight.image(frame),
        flight.reference(REFERENCES[frame]),
        flight.terrain,
        errors(position, attitude_deg),
        tie_errors(),
    )
    if not found.accepted or found.update is None:
        nothing = np.full(len(PIXELS), np.nan)
        return Trial(found, nothing, nothing, np.full(6, np.nan))
    enu = np.array([_off(flight, truth, found, uv) for uv in PIXELS])
    sigma = np.sqrt(np.diagonal(np.asarray(found.update.cov_error)))[:6]
    return Trial(
        found,
        np.hypot(enu[:, 0, 0], enu[:, 0, 1]),
        np.abs(enu[:, 0] / enu[:, 1]).max(axis=1),
        _pose_error(found.shot, truth) / sigma,
    )


def _off(flight: Flight, truth: Shot, found: Registration, uv: np.ndarray) -> np.ndarray:
    """(offset to the east and north in m, its standard deviations)."""
    fix = found.fix(uv, terrain_sigma=HEIGHT)
    there = _ground(flight, truth, uv, flight.terrain)
    offset = np.asarray(fix.nominal.R_ecef_from_enu).T @ (np.asarray(fix.fix.ecef) - there)
    return np.stack([offset[:2], np.sqrt(np.diagonal(np.asarray(fix.cov_enu)))[:2]])


def _ground(flight: Flight, shot: Shot, uv: np.ndarray, terrain: Dem) -> np.ndarray:
    return np.asarray(locate(flight.sensor, shot, uv, terrain).ecef)


def _pose_error(found: Shot, truth: Shot) -> np.ndarray:
    """North, east, down in m and heading, pitch, roll in rad of one pose minus the other."""
    R = np.asarray(R_ecef_from_ned(truth.pose.position))
    step = R.T @ (np.asarray(WGS84.to_ecef(found.pose.position)) - np.asarray(WGS84.to_ecef(truth.pose.position)))
    angles = jax.tree.map(
        lambda a, b: float(a) - float(b),
        (found.pose.heading, found.pose.pitch, found.pose.roll),
        (truth.pose.heading, truth.pose.pitch, truth.pose.roll),
    )
    return np.concatenate([step, angles])

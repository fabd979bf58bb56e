"""Table 1: accuracy of an oblique image before and after the update, and its dependencies."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._locate import locate
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.register import FullJacobian, LevelGround, TieErrors, TiePoints, update_orientation
from jaxgeo.register.gu2017 import CASES, Case, Row, error_table
from jaxgeo.register.tie_errors import AbstractTiePropagation
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.studies.gu2017 import printed
from jaxgeo.studies.gu2017.scene import looking_at
from jaxgeo.studies.scenes import tangent_dem
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import ErrorModel, Propagation, sources
from jaxgeo.uncertainty.metrics import circular_error, circular_probability

COUNTS = {5: (5, 1), 10: (5, 2), 20: (5, 4), 30: (6, 5)}  # ties: columns and rows
FIELDS = (1.0, 2.0, 5.0, 10.0, 20.0)  # deg
SLOPES = (-10.0, 0.0, 5.0, 10.0, 20.0)  # deg, rising away from the camera
MIDDLE = CASES[3]  # 100 m, 1 deg, 20 m, 10 m
ELLIPSE = (278.0, 68.0)  # m, axes of an error ellipse typical of oblique images
SPACING, POSTS = 100.0, 401  # m
WIDTH = 500  # px of the image over a slope


class Accuracy(NamedTuple):
    """Table 1, by number of ties, by field of view, and over slopes (full derivatives, Eq 6)."""

    table: tuple[Row, ...]
    by_ties: dict[int, Row]
    by_field: dict[float, Row]
    on_slopes: dict[float, tuple[float, float]]


class Radii(NamedTuple):
    """Circles of an ellipse: radius in m with probability 90 %, that by factors of the RMS axis, and their
    probabilities."""

    exact: float
    printed: float
    printed_holds: float
    round_factor: float
    rounded: float
    rounded_holds: float


def accuracy() -> Accuracy:
    """All accuracy results."""
    by_field = {field: error_table((MIDDLE,), field_of_view_deg=field)[0] for field in FIELDS}
    by_ties = {count: error_table((MIDDLE,), ties=ties)[0] for count, ties in COUNTS.items()}
    slopes = {slope: over_slope(slope) for slope in SLOPES}
    return Accuracy(error_table(), by_ties, by_field, slopes)


def radii(axes: tuple[float, float] = ELLIPSE, probability: float = 0.9) -> Radii:
    """Circles about an error ellipse of two axes, m."""
    cov = jnp.diag(jnp.asarray(axes) ** 2)
    usual = math.sqrt(0.5 * sum(axis**2 for axis in axes))
    factor = math.sqrt(-2.0 * math.log1p(-probability))
    shown, rounded = printed.CIRCLE_90 * usual, factor * usual
    holds = [float(circular_probability(cov, radius)) for radius in (shown, rounded)]
    return Radii(float(circular_error(cov, probability)), shown, holds[0], factor, rounded, holds[1])


def within(sigmas: float) -> float:
    """Probability that an isotropic two-axis error is within `sigmas` standard deviations."""
    return -math.expm1(-0.5 * sigmas**2)


def over_slope(slope_deg: float, case: Case = MIDDLE) -> tuple[float, float]:
    """Contribution of the pose to the centre pixel's fix (full derivatives, Eq 6 as if level), on rising ground, m.

    Root mean square in plan, without the ground height error at the centre. The camera is 10 km above ground, 75 deg
    off nadir, and looks north.
    """
    sensor, shot, terrain, ties = _over(slope_deg)
    rms = [_rms(sensor, shot, terrain, ties, case, how) for how in (FullJacobian(), LevelGround())]
    return rms[0], rms[1]


def pose_rms(fix: Propagation) -> float:
    """The part of a fix's root mean square error in plan, m, without its last source, the terrain height."""
    by_pose = np.asarray(fix.jacobian)[:2, :-1]
    return float(np.sqrt(np.trace(by_pose @ np.asarray(fix.cov_error)[:-1, :-1] @ by_pose.T)))


def _rms(sensor: Sensor, shot: Shot, terrain: Dem, ties: TiePoints, case: Case, how: AbstractTiePropagation) -> float:
    angle = case.attitude_deg
    errors = ErrorModel(
        (
            sources.Position.from_ned(north=case.position, east=case.position, down=case.position),
            sources.CameraMounting.from_degrees(forward=angle, right=angle, down=angle),
        )
    )
    tie_errors = TieErrors(registration=case.registration, terrain=case.terrain)
    found = update_orientation(sensor, shot, ties, terrain, errors, tie_errors, propagation=how)
    middle = (0.5 * (WIDTH - 1), 0.5 * (WIDTH - 1))
    return pose_rms(found.fix(middle, case.terrain))


def _over(slope_deg: float) -> tuple[Sensor, Shot, Dem, TiePoints]:
    """A camera that looks 75 deg off nadir at a slope around its centre, with 5 by 4 ties."""
    north = SPACING * (0.5 * (POSTS - 1) - np.arange(POSTS))
    posts = 3000.0 + math.tan(math.radians(slope_deg)) * np.clip(north, -8000.0, 8000.0)
    target = Geodetic.from_degrees(lat=30.0, lon=104.0, height=3000.0)
    terrain = tangent_dem(np.repeat(posts[:, None], POSTS, axis=1), SPACING, target)
    focal = 0.5 * WIDTH / math.tan(math.radians(2.0))
    camera = FrameCamera.from_pixels(focal_px=focal, width=WIDTH, height=WIDTH)
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    shot = looking_at(target, off_nadir=75.0, azimuth=0.0, above=10_000.0)
    sides = [(np.arange(count) + 0.5) / count * WIDTH - 0.5 for count in (5, 4)]
    uv = jnp.asarray(np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2))
    place = _places(sensor, shot, uv, terrain)
    if not bool(jnp.all(jnp.isfinite(place.lat))):
        raise ValueError(f"a slope of {slope_deg} deg is not seen at all ties.")
    return sensor, shot, terrain, TiePoints(uv, place, jnp.zeros((len(uv), 2, 2)))


@functools.partial(jax.jit)
def _places(sensor: Sensor, shot: Shot, uv: Any, terrain: Dem) -> Geodetic:
    found = jax.vmap(lambda pixel: locate(sensor, shot, pixel, terrain).ecef)(uv)
    return jax.vmap(WGS84.to_geodetic)(found)

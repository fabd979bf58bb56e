"""Eqs 3, 4, 13 to 16 and 23 to 26: rotation matrices, lines of sight, ground intersections, and compensation."""

from __future__ import annotations

import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo._locate import locate
from jaxgeo.coverage import transform
from jaxgeo.coverage.compensation_formulas import compensation_of_eqs_25_26, line_of_sight_head
from jaxgeo.earth import Geodetic
from jaxgeo.rotations import R_from_heading_pitch_roll
from jaxgeo.sensor import Gimbal, Pose, Shot
from jaxgeo.sensor.conventions import li_2020_uv
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.equations.common import (
    ANGLES,
    ATTITUDES,
    A,
    B,
    C_aircraft_from_ned,
    C_camera_from_aircraft,
    claim,
)
from jaxgeo.studies.li2020.equations.gauss_krueger import map_of_eq_10


def frames() -> list[Claim]:
    """Eqs 3 and 4."""
    gimbal = Gimbal.two_axis()
    theta, phi = ANGLES[1]
    ours = gimbal.R_base_from_head(jnp.array([-theta, phi])).T
    turned = _R_ned_from_body(ATTITUDES[1]).T
    return [
        claim(
            3,
            "aircraft to camera, entries of the matrix",
            C_camera_from_aircraft(*ANGLES[1]),
            ours,
            "sensor.Gimbal.R_base_from_head",
        ),
        claim(
            4,
            "north-east-down to aircraft, entries of the matrix",
            C_aircraft_from_ned(*ATTITUDES[1]),
            turned,
            "rotations.R_from_heading_pitch_roll",
        ),
    ]


def rays() -> list[Claim]:
    """Eqs 13 to 16."""
    sensor, ground = printed.sensor(mirror=False), printed.ground()
    camera, f, pitch = sensor.camera, printed.FOCAL_LENGTH, printed.PIXEL_PITCH
    pixels = ((1, 1), (1000, 3000))
    detector = [  # Eq 13: T' = [a ((M + 1) / 2 - i), a (j - (N + 1) / 2), -f]
        np.array([pitch * (0.5 * (printed.ALONG + 1) - i), pitch * (j - 0.5 * (printed.ACROSS + 1)), -f])
        for i, j in pixels
    ]
    R_head_from_camera = np.asarray(sensor.mount.R_head_from_camera)
    rays = [R_head_from_camera @ np.asarray(camera.ray(li_2020_uv(i, j))[0]) for i, j in pixels]
    shot = Shot(printed.pose_of(printed.TABLE_4[0]), jnp.array([math.radians(74.0), 0.05]))
    fixes = [locate(sensor, shot, li_2020_uv(i, j), ground) for i, j in pixels]
    centre = np.asarray(sensor.perspective_centre(shot))
    R_ecef_from_head = np.asarray(sensor.R_ecef_from_camera(shot)) @ R_head_from_camera.T
    images = [R_ecef_from_head @ one for one in detector]
    sights = [np.asarray(fix.ecef) - centre for fix in fixes]
    ratio = [-float(fix.slant_range) / float(np.linalg.norm(one)) for fix, one in zip(fixes, detector, strict=True)]
    ranges = [
        float(fix.slant_range) for fix in (locate(sensor, shot, li_2020_uv(i, j), _raised(500.0)) for i, j in pixels)
    ]
    points = [(strip.lat, strip.lon) for strip in printed.TABLE_4[:3]]
    pairs = list(itertools.pairwise(points))
    gauss_krueger = printed.gauss_krueger()
    return [
        claim(
            13,
            "line of sight of pixels, -T' / |T'|",
            [-one / np.linalg.norm(one) for one in detector],
            rays,
            "sensor.conventions.li_2020_sensor",
        ),
        claim(
            14,
            "the three ratios of a target and its image",
            [[sight[0] / sight[1], 1.0, 1.0] for sight in sights],
            [[one] * 3 for one in ratio],
            "locate",
            tolerance=[1e-7 * abs(one) for one in ratio for _ in range(3)],
            cause="every denominator is the same coordinate of T' - S",
            right=[sight / image for sight, image in zip(sights, images, strict=True)],
            reason="The print has the target's coordinates over the target's.",
        ),
        claim(
            15,
            "range to the ground at 500 m",
            [_range_of_eq_15(centre, sight, 500.0) for sight in sights],
            ranges,
            "locate",
            unit="m",
            tolerance=0.03,
            reason="The axes lengthened by the height are good to 6 mm of height, here some 2 cm of range.",
        ),
        claim(
            16,
            "step of two places on the map",
            [math.dist(map_of_eq_10(*np.radians(before)), map_of_eq_10(*np.radians(after))) for before, after in pairs],
            [transform.euclidean_step(gauss_krueger, *(_place(*np.radians(one)) for one in pair)) for pair in pairs],
            "coverage.transform.euclidean_step",
            unit="m",
            tolerance=1e-5,
        ),
    ]


def _raised(height: float) -> Any:
    return type(printed.ground())(jnp.asarray(height))


def _place(lat: float, lon: float) -> Geodetic:
    return Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.zeros(()))


def _range_of_eq_15(centre: np.ndarray, sight: np.ndarray, height: float) -> float:
    """Eq 15: intersection of a line (Eq 14) with the ellipsoid of axes RE + h and RP + h."""
    axes = np.array([A + height, A + height, B + height])
    o, d = centre / axes, sight / np.linalg.norm(sight) / axes
    aa, bb, cc = d @ d, o @ d, o @ o - 1.0
    return float((-bb - math.sqrt(bb * bb - aa * cc)) / aa)


def compensation() -> list[Claim]:
    """Eqs 23 to 26."""
    sensor = printed.sensor(mirror=False)
    cases = list(zip(ATTITUDES, ANGLES, strict=True))
    sights = [_sight_of_eq_23(attitude, angles) for attitude, angles in cases]
    engine = [
        sensor.R_ned_from_camera(Shot(_pose(attitude), jnp.array([-theta, phi])))[:, 2]
        for attitude, (theta, phi) in cases
    ]
    changed = [(heading - 0.0175, pitch + 0.0175, roll + 0.0175) for heading, pitch, roll in ATTITUDES]
    straight = [(theta, 0.0) for theta, _ in ANGLES]  # Eqs 25 and 26 are exact for an inner angle of 0
    aims = [_sight_of_eq_23(attitude, angles) for attitude, angles in zip(ATTITUDES, straight, strict=True)]
    heads = [_sight_of_eq_24(*one) for one in zip(changed, straight, aims, strict=True)]
    ours = [
        compensation_of_eqs_25_26(_R_ned_from_body(attitude), *angles, jnp.asarray(aim))
        for attitude, angles, aim in zip(changed, straight, aims, strict=True)
    ]
    by_eq_25 = [-math.atan(x / math.sqrt(y**2 + z**2)) for x, y, z in heads]
    return [
        claim(
            23,
            "line of sight in north-east-down",
            sights,
            engine,
            "sensor.Sensor.R_ned_from_camera",
            tolerance=1e-9,
        ),
        claim(
            24,
            "line of sight in the camera after a change of attitude",
            heads,
            [
                line_of_sight_head(_R_ned_from_body(attitude), *angles, jnp.asarray(aim))
                for attitude, angles, aim in zip(changed, straight, aims, strict=True)
            ],
            "coverage.compensation_formulas.line_of_sight_head",
            tolerance=1e-12,
        ),
        claim(  # Eq 25: dphi = -arctan(x / sqrt(y^2 + z^2))
            25,
            "change of the inner angle",
            by_eq_25,
            [one.phi for one in ours],
            "coverage.compensation_formulas.compensation_of_eqs_25_26",
            unit="rad",
            cause="the minus is that of the mirror's drive; of the angle of Eq 3 it is a plus",
            right=[-change for change in by_eq_25],
            independent=[_needed(*one)[1] for one in zip(changed, straight, aims, strict=True)],
        ),
        claim(  # Eq 26: dtheta = -arctan(y / z)
            26,
            "change of the outer angle",
            [-math.atan(y / z) for _, y, z in heads],
            [one.theta for one in ours],
            "coverage.compensation_formulas.compensation_of_eqs_25_26",
            unit="rad",
        ),
    ]


def _R_ned_from_body(attitude: tuple[float, ...]) -> Any:
    return R_from_heading_pitch_roll(*(jnp.asarray(angle) for angle in attitude))


def _pose(attitude: tuple[float, float, float]) -> Pose:
    return Pose(Geodetic(lat=0.6, lon=1.9, height=8143.0), *attitude)


def _sight_of_eq_23(attitude: tuple[float, float, float], angles: tuple[float, float]) -> np.ndarray:
    """Eq 23: C_AC^NED C_S^AC [0, 0, 1]."""
    return C_aircraft_from_ned(*attitude).T @ C_camera_from_aircraft(*angles).T @ np.array([0.0, 0.0, 1.0])


def _sight_of_eq_24(attitude: Any, angles: tuple[float, float], sight: np.ndarray) -> np.ndarray:
    """Eq 24: C_AC^S C_NED^AC LOS."""
    return C_camera_from_aircraft(*angles) @ C_aircraft_from_ned(*attitude) @ sight


def _needed(attitude: Any, angles: tuple[float, float], aim: np.ndarray) -> tuple[float, float]:
    """Changes (theta, phi) from `angles` that put the line of sight on the aim: Rx(theta) Ry(phi) [0, 0, 1] in the
    body is (sin phi, -sin theta cos phi, cos theta cos phi)."""
    x, y, z = C_aircraft_from_ned(*attitude) @ aim
    return math.atan2(-y, z) - angles[0], math.asin(x) - angles[1]

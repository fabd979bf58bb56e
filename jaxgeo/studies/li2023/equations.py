"""The numbered equations of Li et al. (2023) as printed, compared with the corresponding functions of the package.

Inputs are the three rows of Table 2: aircraft, frame angles, and the printed targets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np

from jaxgeo._intersection import FIRST_HIT
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.earth.classical.iterated import to_geodetic_simultaneous, to_geodetic_successive
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.studies import in_numpy
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.in_numpy import E2, A, R_about_x, R_about_y, R_ned_from_body, ecef
from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty.model_inputs import ModelInputs

PAPER = "Li 2023"
B = A * math.sqrt(1.0 - E2)
ROUNDING = 1e-12
MICROMETRE = 1e-6
ROUNDS = 12  # iterations of the latitude, to full precision
PIXEL = (100.0, -250.0)  # columns and rows from the middle of the image, for Eq. 1
ITERATIONS = 4  # "more than four" of them give the accuracy that section 2.1 states
LAT_CLAIMED, HEIGHT_CLAIMED = 1e-5, 1e-3  # arcsec, m


def equations() -> list[Claim]:
    """Eqs 1 to 9, and the accuracy that the text states of the iteration."""
    return [_eq_1(), *_eq_2_and_3(), _eq_4(), _eq_5(), _eq_6(), *_eqs_7_and_8(), _iterations(), _eq_9()]


def _eq_1() -> Claim:
    # T_s = [a m, a n, -f]: the ray continues through the perspective centre to the other side.
    sensor, (m, n) = printed.sensor(), PIXEL
    pitch, focal = 10e-6, 1.9
    print_ = np.array([pitch * m, pitch * n, -focal])
    ray = np.asarray(sensor.camera.ray(jnp.asarray(printed.UV) + jnp.asarray(PIXEL))[0])
    return Claim(
        PAPER,
        "Eq. 1",
        f"tangents of the ray of a pixel {m:g} columns and {n:g} rows from the middle of the image",
        tuple((-print_[:2] / print_[2]).tolist()),
        tuple((ray[:2] / ray[2]).tolist()),
        ROUNDING,
        function="jaxgeo.FrameCamera.ray",
    )


def _eq_2_and_3() -> Iterator[Claim]:
    sights, places = [], []
    for row in printed.TERRAINS.values():
        origin, direction, *_ = line_of_sight(
            printed.sensor(), printed.shot_of(row), jnp.zeros(()), jnp.asarray(printed.UV)
        )
        sights.append((sight_as_printed(row), np.asarray(direction)))
        places.append((ecef_as_printed(row.lat, row.lon, printed.ALTITUDE), np.asarray(origin)))
    for item, what, pairs, tolerance, unit in (
        ("Eq. 2", "line of sight in the Earth's frame, three rows of Table 2", sights, ROUNDING, ""),
        ("Eq. 3", "camera in the Earth's frame, three rows of Table 2", places, MICROMETRE, "m"),
    ):
        first, second = (tuple(np.concatenate([pair[k] for pair in pairs]).tolist()) for k in (0, 1))
        yield Claim(PAPER, item, what, first, second, tolerance, unit, "jaxgeo.sensor.exposure.line_of_sight")


def _eq_4() -> Claim:
    # (X - X_S) / (X' - X_S) = (Y - Y_S) / (Y' - Y_S) = (Z - Z_S) / (Z' - Z_S)
    ratios = []
    for row in printed.TERRAINS.values():
        fix, origin = _fix(row), ecef_as_printed(row.lat, row.lon, printed.ALTITUDE)
        ratios.append((fix - origin) / sight_as_printed(row))
    found = np.array(ratios)
    return Claim(
        PAPER,
        "Eq. 4",
        "target on the line of sight: the ratios of Y and Z are that of X, three rows of Table 2",
        tuple(np.repeat(found[:, 0], 2).tolist()),
        tuple(found[:, 1:].ravel().tolist()),
        1e-5,
        "m",
        "jaxgeo.locate",
    )


def _eq_5() -> Claim:
    # x^2 / (a + h)^2 + y^2 / (a + h)^2 + z^2 / ((a + h)^2 (1 - e^2)) = 1
    printed_heights, ours, mended = [], [], []
    for row in printed.TERRAINS.values():
        origin, direction = ecef_as_printed(row.lat, row.lon, printed.ALTITUDE), sight_as_printed(row)
        height = row.target[2]
        axes = np.array([A + height, A + height, (A + height) * math.sqrt(1.0 - E2)])
        printed_heights.append(_height_of(origin + near_range(origin / axes, direction / axes) * direction))
        axes = np.array([A + height, A + height, B + height])
        mended.append(_height_of(origin + near_range(origin / axes, direction / axes) * direction))
        ours.append(_height_of(_fix(row)))
    return Claim(
        PAPER,
        "Eq. 5",
        "height of the point met at the heights of Table 2's targets",
        tuple(printed_heights),
        tuple(ours),
        1e-3,
        "m",
        "jaxgeo.locate",
        Explanation("the polar axis is to be b + h, not (a + h) sqrt(1 - e²)", tuple(mended), tuple(ours), 0.01),
        digits=".3f",
    )


def _eq_6() -> Claim:
    ours = [np.asarray(WGS84.to_ecef(printed.target_of(row))) for row in printed.TERRAINS.values()]
    return Claim(
        PAPER,
        "Eq. 6",
        "printed targets in the Earth's frame",
        tuple(np.concatenate([ecef_as_printed(*row.target) for row in printed.TERRAINS.values()]).tolist()),
        tuple(np.concatenate(ours).tolist()),
        MICROMETRE,
        "m",
        "jaxgeo.earth.Ellipsoid.to_ecef",
        digits=".3f",
    )


def _eqs_7_and_8() -> Iterator[Claim]:
    points = [ecef_as_printed(*row.target) for row in printed.TERRAINS.values()]
    true = [_exact(point)[0] for point in points]
    heights = [row.target[2] for row in printed.TERRAINS.values()]
    radii = (A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2) for lat in true)
    right = list(zip(radii, heights, strict=True))
    ours = [float(WGS84.to_geodetic(jnp.asarray(point)).lat) for point in points]
    starts = [(A, float(np.linalg.norm(point)) - math.sqrt(A * B)) for point in points]
    kinds = {
        "Eq. 7": ("latitude that the step gives at the right radius and height", right, 1e-10),
        "Eq. 8": ("latitude that the iteration starts from; within 0.001° of the right one", starts, 1e-3),
    }
    for item, (what, values, tolerance) in kinds.items():
        as_printed, mended = (
            tuple(math.degrees(_latitude(p, N, h, inverted)) for p, (N, h) in zip(points, values, strict=True))
            for inverted in (True, False)
        )
        found = tuple(math.degrees(lat) for lat in ours)
        cause = "the fraction of the latitude is inverted: tan(lat) = Z (N + h) / (p ((1 - e²) N + h))"
        yield Claim(
            PAPER,
            item,
            what,
            as_printed,
            found,
            tolerance,
            "°",
            "jaxgeo.earth.Ellipsoid.to_geodetic",
            Explanation(cause, mended, found, tolerance),
            digits=".7f",
        )


def _iterations() -> Claim:
    """Error left by four iterations of Eq. 7, with the previous iteration's values as printed, and with the newest."""

    def left(iterate: Callable[..., Geodetic]) -> tuple[float, float]:
        lat, height = 0.0, 0.0
        for row in printed.TERRAINS.values():
            found = iterate(WGS84, jnp.asarray(ecef_as_printed(*row.target)), iterations=ITERATIONS)
            lat = max(lat, abs(math.degrees(float(found.lat)) - row.target[0]) * 3600.0)
            height = max(height, abs(float(found.height) - row.target[2]))
        return lat, height

    lat, height = left(to_geodetic_simultaneous)
    new_lat, new_height = left(to_geodetic_successive)
    cause = f"each line with the newest values leaves {new_lat:.1e} arcsec and {new_height:.1e} m"
    return Claim(
        PAPER,
        "Section 2.1",
        f"{ITERATIONS} rounds of Eq. 7, its fraction put right, leave less than 1e-5 arcsec and 1 mm",
        True,
        lat < LAT_CLAIMED and height < HEIGHT_CLAIMED,
        function="jaxgeo.earth.classical.iterated.to_geodetic_simultaneous",
        explanation=Explanation(cause, new_lat < LAT_CLAIMED and new_height < HEIGHT_CLAIMED, True, 0.0),
        reason=f"With the indices as printed {lat:.1e} arcsec and {height:.1e} m are left.",
    )


def _eq_9() -> Claim:
    # lon = arctan(X / Y), + pi or - pi where X < 0
    points = [ecef_as_printed(*row.target) for row in printed.TERRAINS.values()]
    ours = tuple(math.degrees(float(WGS84.to_geodetic(jnp.asarray(point)).lon)) for point in points)
    return Claim(
        PAPER,
        "Eq. 9",
        "longitude of the printed targets",
        tuple(math.degrees(math.atan(point[0] / point[1])) for point in points),
        ours,
        1e-10,
        "°",
        "jaxgeo.earth.Ellipsoid.to_geodetic",
        Explanation(
            "the fraction is inverted: arctan(Y / X)",
            tuple(math.degrees(math.atan(point[1] / point[0])) for point in points),
            ours,
            1e-10,
        ),
        digits=".7f",
    )


def ecef_as_printed(lat_deg: float, lon_deg: float, height: float) -> np.ndarray:
    """Eq. 6."""
    return ecef(math.radians(lat_deg), math.radians(lon_deg), height)


def sight_as_printed(row: printed.Terrain) -> np.ndarray:
    """Eq. 2 for the line of sight, with explicit matrices: Earth from NED, NED from body, body from camera."""
    return in_numpy.R_ecef_from_ned(math.radians(row.lat), math.radians(row.lon)) @ sight_ned_as_printed(row)


def sight_ned_as_printed(row: printed.Terrain) -> np.ndarray:
    """The same in north, east, down."""
    heading, pitch, roll = (math.radians(x) for x in (printed.HEADING, printed.PITCH, printed.ROLL))
    outer, inner = math.radians(-row.outer), math.radians(row.inner)
    R_head = R_about_x(outer) @ R_about_y(inner)
    return R_ned_from_body(heading, pitch, roll) @ R_head @ np.array([0.0, 0.0, 1.0])


def sight_ned(row: printed.Terrain) -> np.ndarray:
    """The package's line of sight of a row of Table 2, in north, east, down."""
    shot = printed.shot_of(row)
    direction = line_of_sight(printed.sensor(), shot, jnp.zeros(()), jnp.asarray(printed.UV))[1]
    return np.asarray(R_ecef_from_ned(shot.pose.position)).T @ np.asarray(direction)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in deg between two directions."""
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def _fix(row: printed.Terrain) -> np.ndarray:
    """The point located at the height of a printed target, in ECEF."""
    inputs = ModelInputs.of(printed.sensor(), printed.shot_of(row), printed.UV, printed.level_ground(row.target[2]))
    return np.asarray(inputs.nominal_fix(FIRST_HIT).fix.ecef)


def near_range(origin: np.ndarray, direction: np.ndarray) -> float:
    """Range to the near intersection with the unit sphere; NaN if the ray misses."""
    a, b, c = direction @ direction, origin @ direction, origin @ origin - 1.0
    return float((-b - math.sqrt(b * b - a * c)) / a) if b * b >= a * c else math.nan


def _latitude(point: np.ndarray, N: float, height: float, inverted: bool) -> float:
    above, below = N + height, (1.0 - E2) * N + height
    ratio = below / above if inverted else above / below
    return math.atan(point[2] / math.hypot(point[0], point[1]) * ratio)


def _exact(point: np.ndarray) -> tuple[float, float]:
    """(latitude in rad, height in m): tan(lat) = (z + e2 N sin(lat)) / p, each iteration reduces the error by e2."""
    p, z = math.hypot(point[0], point[1]), float(point[2])
    lat, N = math.atan2(z, p), A
    for _ in range(ROUNDS):
        N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
        lat = math.atan2(z + E2 * N * math.sin(lat), p)
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    return lat, p / math.cos(lat) - N


def _height_of(point: np.ndarray) -> float:
    return _exact(point)[1]

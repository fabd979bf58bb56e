"""Eqs 5 to 9: the ellipsoid and its coordinates."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.earth.classical import to_geodetic_successive
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020.equations.common import E2, PLACES, ROUNDS, A, B, claim


def earth() -> list[Claim]:
    """Eqs 5 to 9."""
    places = [Geodetic(lat=lat, lon=lon, height=height) for lat, lon, height in PLACES]
    two = PLACES[:2]
    ecef = [np.asarray(WGS84.to_ecef(place)) for place in places]
    on_it = [np.asarray(WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=0.0))) for lat, lon, _ in PLACES]
    points = [p + np.array([1000.0, -2000.0, 500.0]) for p in ecef[:2]]
    exact = [WGS84.to_geodetic(jnp.asarray(p)) for p in ecef]
    degrees_and_metres = [3e-9, 1e-3] * 2
    return [
        claim(  # Eq 5: x^2 / RE^2 + y^2 / RE^2 + z^2 / RP^2 = 1
            5,
            "left side at points of height 0",
            [1.0] * len(PLACES),
            [x**2 / A**2 + y**2 / A**2 + z**2 / B**2 for x, y, z in on_it],
            "earth.WGS84.to_ecef",
            tolerance=1e-12,
        ),
        claim(
            6,
            "ECEF to north-east-down, of points 2 km away",
            [_ned_of_eq_6(p, *place) for p, place in zip(points, two, strict=True)],
            [R_ecef_from_ned(place).T @ (p - q) for p, q, place in zip(points, ecef[:2], places[:2], strict=True)],
            "earth.R_ecef_from_ned",
            unit="m",
            tolerance=1e-6,
            cause="sin B in the first row lacks its minus, and the last shift is R_N e1^2 sin B, not of H",
            right=[_ned_of_eq_6(p, *place, put_right=True) for p, place in zip(points, two, strict=True)],
        ),
        claim(
            7,
            "geodetic to ECEF",
            [_ecef_of_eq_7(*place, sine_of=place[1]) for place in two],
            ecef[:2],
            "earth.WGS84.to_ecef",
            unit="m",
            tolerance=1e-6,
            cause="z has the sine of the latitude B, not of the longitude L",
            right=[_ecef_of_eq_7(*place, sine_of=place[0]) for place in two],
        ),
        claim(
            8,
            f"latitude in deg and height after {ROUNDS} rounds",
            [_geodetic_of_eq_8(p, 0.5) for p in ecef[:2]],
            [
                [np.rad2deg(found.lat), found.height]
                for found in (to_geodetic_successive(WGS84, jnp.asarray(p), iterations=ROUNDS) for p in ecef[:2])
            ],
            "earth.classical.to_geodetic_successive",
            unit="°, m",
            tolerance=degrees_and_metres,
            digits=".11g",
            cause="the exponent of the radius N is -1/2",
            right=[_geodetic_of_eq_8(p, -0.5) for p in ecef[:2]],
            independent=[[np.rad2deg(found.lat), found.height] for found in exact[:2]],
        ),
        claim(
            9,
            "longitude",
            [_longitude_of_eq_9(x, y) for x, y, _ in ecef],
            [found.lon for found in exact],
            "earth.WGS84.to_geodetic",
            unit="rad",
            tolerance=1e-12,
        ),
    ]


def _ned_of_eq_6(p: np.ndarray, lat: float, lon: float, height: float, *, put_right: bool = False) -> np.ndarray:
    """Eq 6: shift, turn by L, turn by B, shift. Printed are sin B at the upper left and a shift of R_N e1 sin H."""
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    shift = N * E2 * math.sin(lat) if put_right else N * math.sqrt(E2) * math.sin(height)
    sine = -math.sin(lat) if put_right else math.sin(lat)
    by_lon = np.array([[math.cos(lon), math.sin(lon), 0.0], [-math.sin(lon), math.cos(lon), 0.0], [0.0, 0.0, 1.0]])
    by_lat = np.array([[sine, 0.0, math.cos(lat)], [0.0, 1.0, 0.0], [-math.cos(lat), 0.0, -math.sin(lat)]])
    return by_lat @ by_lon @ (p + np.array([0.0, 0.0, shift])) + np.array([0.0, 0.0, N + height])


def _ecef_of_eq_7(lat: float, lon: float, height: float, *, sine_of: float) -> list[float]:
    """Eq 7: [(N + H) cos B cos L, (N + H) cos B sin L, (N (1 - e^2) + H) sin L]."""
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    across = (N + height) * math.cos(lat)
    return [across * math.cos(lon), across * math.sin(lon), (N * (1.0 - E2) + height) * math.sin(sine_of)]


def _geodetic_of_eq_8(p: np.ndarray, exponent: float) -> tuple[float, float]:
    """Eq 8: start, then N = RE (1 - e^2 sin^2 B)^(1/2), h = p / cos B - N, tan(lat) = z / p / (1 - e^2 N / (N + h))."""
    x, y, z = p
    across = math.hypot(x, y)
    N, height = A, math.sqrt(x * x + y * y + z * z) - math.sqrt(A * B)
    lat = math.atan(z / across / (1.0 - E2 * N / (N + height)))
    for _ in range(ROUNDS):
        N = A * (1.0 - E2 * math.sin(lat) ** 2) ** exponent
        height = across / math.cos(lat) - N
        lat = math.atan(z / across / (1.0 - E2 * N / (N + height)))
    return math.degrees(lat), height


def _longitude_of_eq_9(x: float, y: float) -> float:
    """Eq 9: arctan(y / x), plus or minus pi where x < 0, by the sign of that."""
    lon = math.atan(y / x)
    if x > 0.0:
        return lon
    return lon + math.pi if lon < 0.0 else lon - math.pi

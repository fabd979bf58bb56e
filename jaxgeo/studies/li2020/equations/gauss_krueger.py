"""Eqs 10 to 12: the Gauss-Krueger map."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxgeo.earth.classical import GaussKruegerSeries, meridian_arc
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.equations.common import E2, MAP_PLACES, MERIDIAN, A, claim


def gauss_krueger() -> list[Claim]:
    """Eqs 10 to 12."""
    series, exact = GaussKruegerSeries(lon0=MERIDIAN), printed.gauss_krueger()
    wanted = [map_of_eq_10(lat, lon) for lat, lon in MAP_PLACES]
    ours = [_xy(series, lat, lon) for lat, lon in MAP_PLACES]
    lats = (0.6085, 0.5 * math.pi)
    arcs, rights = [meridian_arc(lat) for lat in lats], [_arc(lat) for lat in lats]
    return [
        claim(
            10,
            "x (north) and y (east), to 1.5° from the meridian",
            wanted,
            ours,
            "earth.classical.GaussKruegerSeries",
            unit="m",
            tolerance=1e-6,
            reason="With the meridian's arc by quadrature.",
        ),
        claim(
            10,
            "the same beside the exact map",
            wanted,
            [_xy(exact, lat, lon) for lat, lon in MAP_PLACES],
            "earth.TransverseMercator",
            unit="m",
            tolerance=2e-6,
        ),
        claim(
            11,
            "arc of the meridian",
            [_arc_of_eq_11(lat, second=0, last=693_693) for lat in lats],
            arcs,
            "earth.classical.meridian_arc",
            unit="m",
            tolerance=1e-6,
            digits=".10g",
            cause="the second term is -B1 sin 2B, not -A1 sin 2B",
            right=[_arc_of_eq_11(lat, second=1, last=693_693) for lat in lats],
            independent=rights,
        ),
        claim(
            12,
            "arc of the meridian with the printed coefficients",
            [_arc_of_eq_11(lat, second=1, last=6_936_933) for lat in lats],
            arcs,
            "earth.classical.meridian_arc",
            unit="m",
            tolerance=1e-7,
            digits=".15g",
            cause="the last term of A1 is 693693/1048576, not 6936933/1048576",
            right=[_arc_of_eq_11(lat, second=1, last=693_693) for lat in lats],
            independent=rights,
        ),
    ]


def _xy(projection: Any, lat: float, lon: float) -> tuple[float, float]:
    east, north = projection.forward(lat, lon)
    return float(north), float(east) - 500_000.0


def map_of_eq_10(lat: float, lon: float) -> tuple[float, float]:
    """Eq 10 as printed: powers of the longitude difference l to the sixth."""
    dlon, t, eta2 = lon - MERIDIAN, math.tan(lat), E2 / (1.0 - E2) * math.cos(lat) ** 2
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    c2l2 = math.cos(lat) ** 2 * dlon**2
    x = _arc(lat) + N * t * c2l2 * (
        0.5
        + 1.0 / 24.0 * (5.0 - t**2 + 9.0 * eta2 + 4.0 * eta2**2) * c2l2
        + 1.0 / 720.0 * (61.0 - 58.0 * t**2 + t**4) * c2l2**2
    )
    y = (
        N
        * math.cos(lat)
        * dlon
        * (
            1.0
            + 1.0 / 6.0 * (1.0 - t**2 + eta2) * c2l2
            + 1.0 / 120.0 * (5.0 - 18.0 * t**2 + t**4 + 14.0 * eta2 - 58.0 * t**2 * eta2) * c2l2**2
        )
    )
    return x, y


def _arc(lat: float) -> float:
    """Meridian arc length by Gauss-Legendre quadrature of the meridian radius."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    at = 0.5 * lat * (nodes + 1.0)
    return float(0.5 * lat * np.sum(weights * A * (1.0 - E2) / (1.0 - E2 * np.sin(at) ** 2) ** 1.5))


def _arc_of_eq_11(lat: float, *, second: int, last: int) -> float:
    """Eq 11 with the coefficients of Eq 12: which of A1 and B1 multiplies sin 2B, and the last numerator of A1."""
    e = E2
    A1 = (
        1
        + 3 / 4 * e
        + 45 / 64 * e**2
        + 175 / 256 * e**3
        + 11025 / 16384 * e**4
        + 43659 / 65536 * e**5
        + last / 1048576 * e**6
    )
    B1 = (
        3 / 8 * e
        + 15 / 32 * e**2
        + 525 / 1024 * e**3
        + 2205 / 4096 * e**4
        + 72765 / 131072 * e**5
        + 297297 / 524288 * e**6
    )
    C1 = 15 / 256 * e**2 + 105 / 1024 * e**3 + 2205 / 16384 * e**4 + 10395 / 65536 * e**5 + 1486485 / 8388608 * e**6
    D1 = 35 / 3072 * e**3 + 105 / 4096 * e**4 + 10395 / 262144 * e**5 + 55055 / 1048576 * e**6
    E1 = 315 / 131072 * e**4 + 3465 / 524288 * e**5 + 99099 / 8388608 * e**6
    F1 = 693 / 1310720 * e**5 + 9009 / 5242880 * e**6
    G1 = 1001 / 8388608 * e**6
    waves = -(A1, B1)[second] * math.sin(2 * lat) + C1 * math.sin(4 * lat) - D1 * math.sin(6 * lat)
    waves += E1 * math.sin(8 * lat) - F1 * math.sin(10 * lat) + G1 * math.sin(12 * lat)
    return A * (1.0 - E2) * (A1 * lat + waves)

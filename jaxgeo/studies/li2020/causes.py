"""Tested causes of the factor in Table 2 of Li et al. (2020), whose entries are 2.155 % larger than Eq 19 gives.

Each cause is applied to the computation and compared with all five entries. None of them fits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.influence import Influence

THETA, OMEGA = math.radians(printed.OFF_NADIR), math.radians(printed.FIELD_OF_VIEW)
CHANGES = np.radians(printed.CHANGES)
PRINTED = -np.array(printed.TABLES["pitch"])
HALF_DIGIT = 5e-5
HEIGHT = printed.TABLE_4[0].height_above_ground
RADIUS = 6_371_000.0  # m
OPENING = 2.0 * math.tan(0.5 * OMEGA)


@dataclass(frozen=True)
class Cause:
    """A tested cause: the resulting factor on Eq 19 (at 1 deg), and the number of the five entries of Table 2 that
    it reproduces. `elsewhere` is the number of the ten entries of Tables 1 and 3 that stay right under the same
    change, None if the cause does not affect them."""

    tried: str
    factor: float
    entries: int
    elsewhere: int | None = None


@dataclass(frozen=True)
class Products:
    """Products of two powers of available quantities: their number, how many match the printed factor, and how many
    would match by chance."""

    count: int
    hits: int
    by_chance: float


def needed_factors() -> tuple[float, float]:
    """Range (from, to) of the factor on Eq 19 that gives all five entries as rounded."""
    formula = _eq_19(CHANGES)
    return float(np.max((PRINTED - HALF_DIGIT) / formula)), float(np.min((PRINTED + HALF_DIGIT) / formula))


def causes(influences: Sequence[Influence]) -> list[Cause]:
    """All tested causes, including the study's own coordinate transforms."""
    found = [_tried(name, rows) for name, rows in _variants().items()]
    for field, name in (
        ("by_slant_range", "coordinates transformed, frame by the slant range on the ellipsoid"),
        ("on_map", "coordinates transformed, frame and step on the map"),
        ("by_eq_16", "coordinates transformed, step of Eq 16"),
    ):
        values = np.array([-getattr(one, field) for one in influences if one.angle == "pitch"])
        found.append(_tried(name, values))
    return [*found, *_freed()]


def products() -> Products:
    """Whether products of two powers (-2 to 2) of available quantities match the factor, and the chance expectation."""
    low, high = needed_factors()
    quantities = _quantities()
    logs = []
    for (_, a), (_, b) in itertools.combinations(quantities.items(), 2):
        for m, n in itertools.product((-2, -1, 1, 2), repeat=2):
            logs.append(m * math.log(a) + n * math.log(b))
    logs = np.array([x for x in logs if abs(x) > 1e-6])
    near = np.abs(logs) < 0.1  # window of 20 % for the chance estimate
    hits = int(np.sum((logs > math.log(low)) & (logs < math.log(high))))
    return Products(len(logs), hits, float(near.sum() * math.log(high / low) / 0.2))


def _eq_19(change: np.ndarray, theta: float = THETA, opening: float = OPENING) -> np.ndarray:
    return math.cos(theta) * np.tan(change) / opening


def _eq_18(theta: float, opening: float) -> np.ndarray:
    return math.sin(theta) * np.sin(CHANGES) / opening


def _eq_22(theta: float) -> np.ndarray:
    return (1.0 - printed.OVERLAP) * (1.0 - np.cos(theta + CHANGES) / math.cos(theta))


def _tried(name: str, values: np.ndarray, elsewhere: int | None = None) -> Cause:
    entries = int(np.sum(np.abs(values - PRINTED) <= HALF_DIGIT))
    return Cause(name, float(values[-1] / _eq_19(CHANGES)[-1]), entries, elsewhere)


def _variants() -> dict[str, np.ndarray]:
    """Table 2 with one part of Eq 19 replaced."""
    incidence, slant, drop = _curved()
    flat_slant = HEIGHT / math.cos(THETA)
    first = printed.TABLE_4[0]
    found = {
        "omega in rad for 2 tan(omega/2)": _eq_19(CHANGES, opening=OMEGA),
        "tan(omega) for 2 tan(omega/2)": _eq_19(CHANGES, opening=math.tan(OMEGA)),
        "2 sin(omega/2) for 2 tan(omega/2)": _eq_19(CHANGES, opening=2.0 * math.sin(0.5 * OMEGA)),
        "sin of the pitch for its tangent": math.cos(THETA) * np.sin(CHANGES) / OPENING,
        "the pitch in rad for its tangent": math.cos(THETA) * CHANGES / OPENING,
        "pi as 3.14": _eq_19(CHANGES * 3.14 / math.pi, opening=2.0 * math.tan(0.5 * OMEGA * 3.14 / math.pi)),
        "pi as 3.14 in the pitch alone": _eq_19(CHANGES * 3.14 / math.pi),
        "57.3 deg for a radian, in the pitch alone": _eq_19(np.array(printed.CHANGES) / 57.3),
        "theta of the frame's near edge": _eq_19(CHANGES, theta=THETA - 0.5 * OMEGA),
        "theta of the frame's far edge": _eq_19(CHANGES, theta=THETA + 0.5 * OMEGA),
        "theta less the pitch": np.cos(THETA - CHANGES) * np.tan(CHANGES) / OPENING,
        "theta of Table 4's mean line of sight": _eq_19(CHANGES, theta=math.radians(90.0 - 16.047)),
        "incidence at the ground of a round Earth for theta": _eq_19(CHANGES, theta=incidence),
        "theta less the angle at the Earth's centre": _eq_19(CHANGES, theta=2.0 * THETA - incidence),
        "ground range for height over cosine in the frame's length": _eq_19(CHANGES) / math.sin(THETA),
        "slant range of a round Earth in the frame's length alone": _eq_19(CHANGES) * flat_slant / slant,
        "height over the point's tangent plane in the offset alone": _eq_19(CHANGES) * (HEIGHT + drop) / HEIGHT,
        "both of these the wrong way round": _eq_19(CHANGES) * ((HEIGHT + drop) / HEIGHT) ** 2,
        "the same, with rays bent as by an Earth of 7/6 of the radius": _eq_19(CHANGES)
        * ((HEIGHT + _curved(RADIUS * 7.0 / 6.0)[2]) / HEIGHT) ** 2,
        "arc for tangent and frame for its chord": math.cos(THETA) * CHANGES / OMEGA,
        "offset at the aircraft's radius": _eq_19(CHANGES) * (RADIUS + HEIGHT) / RADIUS,
        "frame's length of the pitched frame": _eq_19(CHANGES) * np.cos(CHANGES),
        "step as a distance, with the offset across": np.hypot(
            _eq_19(CHANGES), math.sin(THETA) * (1.0 / np.cos(CHANGES) - 1.0) / OPENING
        ),
        "offset over the step instead of the frame": _eq_19(CHANGES) / (1.0 - printed.OVERLAP),
        "pitch about the axis of the inner frame": np.tan(CHANGES) / OPENING,
        "from the attitude and drives of Table 4's first strip": _flat_from_attitude(first),
        "inner angle of Table 4's first strip": _flat(CHANGES, phi=2.0 * math.radians(45.0 - first.azimuth_drive)),
    }
    for digits in (2, 3, 4):
        found[f"cos(theta) to {digits} digits"] = _eq_19(CHANGES) * round(math.cos(THETA), digits) / math.cos(THETA)
    for digits in (3, 4, 5):
        found[f"2 tan(omega/2) to {digits} digits"] = _eq_19(CHANGES) * OPENING / round(OPENING, digits)
    heights = {8460.0: "of the mountain flight above the sea", 8080.0: "of the mountain flight above the plan"}
    for other, words in heights.items():
        found[f"height {words} in the offset alone"] = _eq_19(CHANGES) * other / HEIGHT
        found[f"height {words} in the length alone"] = _eq_19(CHANGES) * HEIGHT / other
    for meridian in (105.0, 108.0, 111.0, 114.0, 117.0, 120.0, 123.0):
        scale = _map_scale(meridian)
        found[f"offset on the map about {meridian:.0f} deg, length on the ground"] = _eq_19(CHANGES) * scale
    return found


def _freed() -> list[Cause]:
    """One quantity set to the value that gives the factor, and the effect on Tables 1 and 3."""
    factor = math.sqrt(math.prod(needed_factors()))
    theta = math.acos(math.cos(THETA) * factor)
    opening = OPENING / factor
    omega = 2.0 * math.atan(0.5 * opening)
    phi = math.atan(math.sqrt(factor - 1.0) * math.cos(THETA))
    return [
        _tried(
            f"theta of {math.degrees(theta):.3f} deg, as would be needed",
            _eq_19(CHANGES, theta=theta),
            _right("heading", _eq_18(theta, OPENING)) + _right("roll", _eq_22(theta)),
        ),
        _tried(
            f"field of view of {math.degrees(omega):.4f} deg, as would be needed",
            _eq_19(CHANGES, opening=opening),
            _right("heading", _eq_18(THETA, opening)) + _right("roll", _eq_22(THETA)),
        ),
        _tried(f"inner angle of {math.degrees(phi):.3f} deg, as would be needed", _flat(CHANGES, phi=phi)),
        _tried(f"height of {factor * HEIGHT:.0f} m in the offset alone, as would be needed", _eq_19(CHANGES) * factor),
    ]


def _right(angle: str, values: np.ndarray) -> int:
    return int(np.sum(np.abs(values - np.array(printed.TABLES[angle])) <= 2.0 * HALF_DIGIT))


def _flat(changes: np.ndarray, *, phi: float) -> np.ndarray:
    """Change of the overlap by pitch over a plane, with an inner angle phi, from level flight."""
    return np.array([_ahead(pitch, 0.0, -THETA, phi) - _ahead(0.0, 0.0, -THETA, phi) for pitch in changes]) / (
        OPENING / math.cos(THETA)
    )


def _flat_from_attitude(strip: printed.Strip) -> np.ndarray:
    """The same from a strip's attitude and drives; the frame length is that of its line of sight."""
    pitch, roll = math.radians(strip.pitch), math.radians(strip.roll)
    theta = -math.radians(90.0 - strip.depression_drive)
    phi = -2.0 * math.radians(strip.azimuth_drive - 45.0)
    down = _sight(pitch, roll, theta, phi)[2]
    before = _ahead(pitch, roll, theta, phi)
    return np.array([_ahead(pitch + change, roll, theta, phi) - before for change in CHANGES]) / (OPENING / down)


def _ahead(pitch: float, roll: float, theta: float, phi: float) -> float:
    """Distance ahead at which the line of sight meets a plane, divided by the height."""
    ahead, _, down = _sight(pitch, roll, theta, phi)
    return float(ahead / down)


def _sight(pitch: float, roll: float, theta: float, phi: float) -> np.ndarray:
    x, y, z = math.sin(phi), -math.sin(theta) * math.cos(phi), math.cos(theta) * math.cos(phi)
    y, z = math.cos(roll) * y - math.sin(roll) * z, math.sin(roll) * y + math.cos(roll) * z
    x, z = math.cos(pitch) * x + math.sin(pitch) * z, math.cos(pitch) * z - math.sin(pitch) * x
    return np.array([x, y, z])


def _curved(radius: float = RADIUS) -> tuple[float, float, float]:
    """On a sphere: incidence at the ground, slant range, and drop of the point below the tangent plane."""
    incidence = math.asin((radius + HEIGHT) / radius * math.sin(THETA))
    slant = radius * math.sin(incidence - THETA) / math.sin(THETA)
    return incidence, slant, slant * math.cos(THETA) - HEIGHT


def _map_scale(meridian: float) -> float:
    """Scale of the Gauss-Krueger map at Table 4's first strip, to the fourth power of the longitude."""
    first = printed.TABLE_4[0]
    lat, away = math.radians(first.lat), math.radians(first.lon - meridian)
    eta2 = WGS84.e2 / (1.0 - WGS84.e2) * math.cos(lat) ** 2
    part = (away * math.cos(lat)) ** 2
    return 1.0 + 0.5 * part * (1.0 + eta2) + part**2 * (5.0 - 4.0 * math.tan(lat) ** 2) / 24.0


def _quantities() -> dict[str, float]:
    """Quantities of the paper's computation that could form a factor."""
    incidence, slant, _ = _curved()
    return {
        "cos(theta)": math.cos(THETA),
        "sin(theta)": math.sin(THETA),
        "theta": THETA,
        "1 - overlap": 1.0 - printed.OVERLAP,
        "overlap": printed.OVERLAP,
        "omega": OMEGA,
        "omega in deg": printed.FIELD_OF_VIEW,
        "cos(incidence)": math.cos(incidence),
        "sin(incidence)": math.sin(incidence),
        "slant range over plane one": slant * math.cos(THETA) / HEIGHT,
        "(R + H) / R": (RADIUS + HEIGHT) / RADIUS,
        "8460 / 8143": 8460.0 / HEIGHT,
        "8080 / 8143": 8080.0 / HEIGHT,
        "map scale about 108": _map_scale(108.0),
        "map scale about 117": _map_scale(117.0),
        "pi / 3": math.pi / 3.0,
        "pi / 4": math.pi / 4.0,
        "1 + overlap": 1.0 + printed.OVERLAP,
        "2": 2.0,
        "axis ratio of the Earth": 1.0 - WGS84.f,
    }

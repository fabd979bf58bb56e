"""Number and status formatting for pages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxgeo.status import Status

UNKNOWN = "–"
STATUS_WORDS = {Status.hit: "Visible", Status.near_tangent: "Visible, grazing", Status.enters_from_side: "Doubtful"}


def length(value: float | None) -> str:
    """A length in m with three significant digits, in km from 10 km on."""
    if value is None or math.isnan(value):
        return UNKNOWN
    if math.isinf(value):
        return "infinite"
    if abs(value) >= 9_999.5:
        return f"{value / 1000.0:.3g} km" if abs(value) < 999_500.0 else f"{value / 1000.0:.0f} km"
    return f"{value:.0f} m" if abs(value) >= 999.5 else f"{_three(value)} m"


def _three(value: float) -> str:
    """Three significant digits, without exponent, with trailing zeros."""
    if value == 0.0:
        return "0"
    places = max(2 - math.floor(math.log10(abs(float(f"{value:.2e}")))), 0)
    return f"{value:.{min(places, 6)}f}"


def share(value: float) -> str:
    """A share in percent."""
    percent = 100.0 * value
    return f"{percent:.0f} %" if percent >= 99.95 or percent == 0.0 else f"{percent:.1f} %"


def coordinate(value: float | None, positive: str, negative: str, places: int = 7) -> str:
    """A latitude or longitude in degrees with its hemisphere."""
    if value is None or math.isnan(value):
        return UNKNOWN
    return f"{abs(value):.{places}f}° {positive if value >= 0.0 else negative}"


def sexagesimal(value: float, positive: str, negative: str) -> str:
    """Degrees, minutes and seconds to two decimals."""
    hundredths = round(abs(value) * 360_000.0)
    degrees, rest = divmod(hundredths, 360_000)
    minutes, rest = divmod(rest, 6_000)
    return f"{degrees}° {minutes:02d}' {rest / 100.0:05.2f}\" {positive if value >= 0.0 else negative}"


def metres(value: float | None, places: int = 2) -> str:
    """A height or a distance with fixed decimals."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:,.{places}f}".replace(",", "\u202f")


def number(value: Any, places: int = 1) -> str:
    """A number with fixed decimals, or a dash."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:z.{places}f}"


def count(value: int) -> str:
    """A whole number with narrow spaces between thousands."""
    return f"{value:,}".replace(",", "\u202f")


def status(code: Any) -> tuple[str, str]:
    """(short label, sentence) of a status."""
    found = Status(int(np.asarray(code)))
    return STATUS_WORDS.get(found, "No fix"), found.message


def percent_name(probability: float) -> str:
    """Probability in percent as text: the 90 of CE90."""
    return f"{100.0 * probability:.10g}"


def radius(value: float | None) -> str:
    """A radius in m without its unit, with three significant digits."""
    if value is None or math.isnan(value):
        return UNKNOWN
    return "∞" if math.isinf(value) else f"{value:.0f}" if value >= 999.5 else _three(value)

"""Vertical datums by the names that are in use for them."""

from __future__ import annotations

from typing import Any

ELLIPSOID, EGM96, EGM2008, NAVD88 = "ellipsoid", "EPSG:5773", "EPSG:3855", "EPSG:5703"
ACCEPTED = {
    ELLIPSOID: ("ellipsoid", "ellipsoidal", "hae", "wgs84 ellipsoid", "wgs84 hae", "height above ellipsoid"),
    EGM96: ("egm96", "egm1996", "egm96 geoid"),
    EGM2008: ("egm2008", "egm08", "egm2008 geoid"),
    NAVD88: ("navd88",),
}
UNCLEAR = {
    "does not say which geoid": ("msl", "amsl", "asl", "mean sea level", "sea level", "geoid", "orthometric", "egm"),
    "does not say whether heights are above its ellipsoid or a geoid": ("wgs84", "gps", "gnss"),
}
WAY = (
    'Give "ellipsoid" (or HAE) for heights above WGS 84, "EGM96" (EPSG:5773; what SRTM, most drones and GPS receivers '
    'call mean sea level), "EGM2008" (EPSG:3855) or "NAVD88" (EPSG:5703)'
)


def _plain(text: str) -> str:
    return "".join(one for one in text.casefold() if one.isalnum())


_CODES = {_plain(name): code for code, names in ACCEPTED.items() for name in names}
_REASONS = {_plain(name): reason for reason, names in UNCLEAR.items() for name in names}


def known_datum(asked: Any) -> Any:
    """A vertical datum by the name that the package uses: "ellipsoid" for HAE, an EPSG code for EGM96, EGM2008, NAVD88.

    Capitals, spaces and hyphens do not matter. Anything else, such as a number or a path, is returned as it is.
    """
    return _CODES.get(_plain(asked), asked) if isinstance(asked, str) else asked


def why_unclear(asked: Any) -> str | None:
    """Why a name in use stands for no one datum, and those to give instead; None for others."""
    reason = _REASONS.get(_plain(asked)) if isinstance(asked, str) else None
    return None if reason is None else f"{reason}. {WAY}"


def is_ellipsoid(asked: Any) -> bool:
    """Whether a datum is the ellipsoid, by any of its names."""
    return isinstance(asked, str) and known_datum(asked) == ELLIPSOID

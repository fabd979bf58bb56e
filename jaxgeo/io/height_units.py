"""Height units: spellings in files and options, and precedence where several are stated."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pyproj

from jaxgeo.io.errors import DemError
from jaxgeo.io.vertical import horizontal_part, vertical_part, vertical_unit

if TYPE_CHECKING:
    from jaxgeo.io.tiles import Tile

US_FOOT = 1200 / 3937
CHOICES = 'height_unit="m", "ft", "us-ft", "dm" or "cm"'
_SPELLINGS = {
    1.0: "m metre metres meter meters mtr mtrs",
    0.1: "dm decimetre decimetres decimeter decimeters",
    0.01: "cm centimetre centimetres centimeter centimeters",
    0.001: "mm millimetre millimetres millimeter millimeters",
    1000.0: "km kilometre kilometres kilometer kilometers",
    0.3048: "ft foot feet ftint ftintl intft intlft internationalfoot internationalfeet footinternational "
    "footintl feetintl internationalft",
    US_FOOT: "usft ftus footus feetus usfoot usfeet ussurveyfoot ussurveyfeet ussurveyft surveyfoot surveyfeet "
    "footussurvey feetussurvey ftussurvey usft1893 sft",
}
UNITS = {word: metres for metres, words in _SPELLINGS.items() for word in words.split()}
"""m per unit by its name, reduced to letters and digits in lower case."""
ALIKE = 1e-9  # relative; a US survey foot differs from the international one by 2e-6


def metres_in(name: str) -> float | None:
    """m per unit of height for a name in any spelling; None if unknown."""
    return UNITS.get(re.sub(r"[^a-z0-9]", "", name.lower()))


def metres_per_unit(tile: Tile, height_unit: str | None, by_datum: float | None) -> float:
    """m per unit of a tile's heights: by the caller, the band, the file's vertical CRS or the given datum; else 1.

    Raises for a horizontal CRS in feet without a stated height unit, and for a file that contradicts itself.
    """
    by_crs = unit_of_crs(tile.crs)
    if height_unit is not None:
        return _unit(height_unit, "height_unit")
    if tile.unit:
        by_band = _unit(tile.unit, f"{tile.path}: the unit of band {tile.band}")
        if by_crs is not None and not alike(by_band, by_crs):
            raise DemError(
                f"{tile.path}: band {tile.band} states heights in {tile.unit!r}, the file's vertical CRS has a unit of "
                f"{by_crs:g} m. State the right one: {CHOICES}."
            )
        return by_band
    if by_crs is not None:
        return by_crs
    if by_datum is not None and by_datum != 1.0:  # a datum in metres does not settle the unit of a map in feet
        return by_datum
    if not tile.is_geographic and tile.map_unit != 1.0:
        name = horizontal_part(tile.crs).axis_info[0].unit_name
        raise DemError(
            f"{tile.path}: the map is in {name} and nothing says whether the heights are too. Pass {CHOICES}."
        )
    return 1.0


def unit_of_crs(crs: pyproj.CRS) -> float | None:
    """m per unit of a CRS's vertical axis, also of one named "unknown"; None without such an axis."""
    return vertical_unit(vertical_part(crs, unnamed=True))


def stated_unit(tile: Tile) -> float | str | None:
    """m per unit of a file's heights as stated, by the band first; the text itself if the unit is unknown."""
    if tile.unit:
        known = metres_in(tile.unit)
        return tile.unit if known is None else known
    return unit_of_crs(tile.crs)


def alike(a: float | str | None, b: float | str | None) -> bool:
    """Whether two units from `stated_unit` are equal."""
    if isinstance(a, float) and isinstance(b, float):
        return abs(a / b - 1.0) <= ALIKE
    return a == b


def unit_shown(unit: float | str | None) -> str:
    """A unit from `stated_unit`, for messages."""
    if unit is None:
        return "no unit"
    if isinstance(unit, str):
        return repr(unit)
    name = next((words.split()[0] for metres, words in _SPELLINGS.items() if alike(metres, unit)), f"{unit:g} m")
    return "US survey feet" if name == "usft" else name


def _unit(name: str, whose: str) -> float:
    metres = metres_in(name)
    if metres is None:
        raise DemError(f"{whose} is {name!r}, no known unit of height; pass {CHOICES}.")
    return metres

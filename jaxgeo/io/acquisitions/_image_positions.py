"""Drone positions from image tags: latitude, longitude, and heights whose datum the caller may have to state."""

from __future__ import annotations

import contextlib

import numpy as np

from jaxgeo.io._csv import POSE_COLUMNS, Limits
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.acquisitions._makers import Maker
from jaxgeo.io.acquisitions._takeoff import heights_above_takeoff
from jaxgeo.io.acquisitions.record import UnstatedDatum
from jaxgeo.io.acquisitions.sentences import DOUBT, heights_are
from jaxgeo.io.datum_names import is_ellipsoid, known_datum
from jaxgeo.io.errors import A_WRONG_GUESS, OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights

LAT: Limits = (-90.0, 90.0, "deg")
LON: Limits = (-180.0, 180.0, "deg")
HEIGHT = POSE_COLUMNS["height_m"]
RTK = "drone-dji:RtkFlag"
FAR_TAKEOFF = 15.0  # m: three usual standard deviations of an elevation model


def lat_lon_of(tags: list[ImageTags], maker: Maker) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes in deg. Raises `TableError` if they are missing or mean "unknown"."""
    places = []
    for one in tags:
        _check_known(one, "position")
        lat, lon = one.first(maker.lat, LAT), one.first(maker.lon, LON)
        if lat is None or lon is None:
            _check_known(one, "EXIF position")
            lat, lon = _exif_angle(one, "GPSLatitude", "NS", LAT), _exif_angle(one, "GPSLongitude", "EW", LON)
        places.append((lat, lon))
    lat, lon = np.array(places).T
    return lat, lon


def _check_known(tags: ImageTags, quantity: str) -> None:
    if reason := tags.unknown(quantity):
        raise TableError(f"{tags.path}: its position is unknown: {reason}; it gives no fix.")


def _exif_angle(tags: ImageTags, name: str, signs: str, limits: Limits) -> float:
    """EXIF degrees, minutes and seconds in deg."""
    name = f"EXIF:{name}"
    parts, side = tags.numbers(name), tags.text(f"{name}Ref").upper()[:1]
    if not parts:
        raise TableError(f"{tags.path}: there is no position, neither of the maker's tags nor {name}; GPS was off.")
    if not side or side not in signs:
        raise tags.wrong(f"{name}Ref", f"{side!r}; expected {signs[0]} or {signs[1]}.")
    if len(parts) != 3:
        raise tags.wrong(name, f"{len(parts)} numbers; expected degrees, minutes and seconds.")
    value = (parts[0] + parts[1] / 60.0 + parts[2] / 3600.0) * (1.0 if side == signs[0] else -1.0)
    if min(parts) < 0.0 or not limits[0] <= value <= limits[1]:
        raise tags.wrong(name, f"{value:g} is outside [{limits[0]:g}, {limits[1]:g}] {limits[2]}.")
    return value


def heights_of(
    tags: list[ImageTags],
    maker: Maker,
    lat: np.ndarray,
    lon: np.ndarray,
    height_datum: str | float | None,
    takeoff_height: float | None,
) -> tuple[np.ndarray, list[str]]:
    """(heights in m above the ellipsoid, assumptions)."""
    first = tags[0]
    if takeoff_height is not None:
        if not maker.relative:
            raise TableError(f"{first.path}: its maker does not tell heights above the take-off; give height_datum=.")
        above = np.array([_needed(one, maker.relative) for one in tags])
        heights, where = heights_above_takeoff(first.path, lon, lat, above, takeoff_height, height_datum)
        notes = [f"Heights are {maker.relative} above {where}, as the barometer has them."]
        if takeoff_height != 0.0 or height_datum is not None:  # else the take-off is the level of reference
            notes += _other_takeoff(tags, maker, heights - above, above)
        return heights, notes
    heights = np.array([_altitude(one, maker) for one in tags])
    if maker.datum and all(one.text(maker.datum).lower().startswith("ellips") for one in tags):
        if not (height_datum is None or is_ellipsoid(height_datum)):
            raise TableError(f"{first.path}, {maker.datum}: heights are above the ellipsoid; leave height_datum= out.")
        return heights, []
    if height_datum is None:
        raise UnstatedDatum(_which_datum(first, maker))
    try:
        found = ellipsoidal_heights(lon, lat, heights, height_datum)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{first.path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{first.path}: {error}") from error
    notes = [heights_are(known_datum(height_datum))]
    if isinstance(height_datum, str) and not is_ellipsoid(height_datum) and any(map(_is_by_rtk, tags)):
        off = float(np.median(found - heights))
        notes.append(
            f"{DOUBT}Altitudes by RTK (RtkFlag {first.shown(RTK)}) are usually above the ellipsoid; above "
            f"{known_datum(height_datum)}, as given, they are {abs(off):.1f} m {'higher' if off > 0.0 else 'lower'}. "
            f'Give height_datum="ellipsoid", unless the reference station works with heights above that.'
        )
    return found, notes


def _other_takeoff(tags: list[ImageTags], maker: Maker, takeoff: np.ndarray, above: np.ndarray) -> list[str]:
    """A sentence if altitudes above the ellipsoid, less those above the take-off, contradict its height."""

    def altitude(one: ImageTags) -> float:
        with contextlib.suppress(TableError):  # unknown, and not needed here
            return _altitude(one, maker) if _is_by_rtk(one) else np.nan
        return np.nan

    told = np.array([altitude(one) for one in tags]) - above
    known = np.isfinite(told)
    off = float(np.median((told - takeoff)[known])) if known.any() else 0.0
    if abs(off) < FAR_TAKEOFF:
        return []
    side = "lower" if off < 0.0 else "higher"
    return [
        f"{DOUBT}Absolute less relative altitude gives {np.median(told[known]):.1f} m above the ellipsoid for the "
        f"take-off, {abs(off):.1f} m {side} than takeoff_height=: the take-off was elsewhere, or the elevation model "
        f'has trees there. Give height_datum="ellipsoid" in place of takeoff_height=, unless the altitude is the wrong '
        f"one, which has no part in heights above the take-off."
    ]


def _is_by_rtk(tags: ImageTags) -> bool:
    """Whether the altitude is a solution of RTK, which is above the ellipsoid."""
    return RTK in tags.values and not tags.unknown("position errors", (RTK,))


def above_takeoff_of(tags: list[ImageTags], maker: Maker) -> np.ndarray | None:
    """Heights (n,) in m above the take-off as far as the files tell them, NaN else; None if none does."""

    def above(one: ImageTags) -> float:
        with contextlib.suppress(TableError):  # a damaged tag, which no line of sight depends on
            return np.nan if (found := one.number(maker.relative, HEIGHT)) is None else found
        return np.nan

    found = np.array([above(one) for one in tags])
    return found if np.isfinite(found).any() else None


def _needed(tags: ImageTags, name: str) -> float:
    value = tags.number(name, HEIGHT)
    if value is None:
        raise TableError(f"{tags.path}: there is no {name}.")
    return value


def _altitude(tags: ImageTags, maker: Maker) -> float:
    exif = "EXIF:GPSAltitude"
    if maker.height != exif and maker.height in tags.values and not tags.unknown("height"):
        return _needed(tags, maker.height)
    if reason := tags.unknown("EXIF height"):
        raise TableError(f"{tags.path}: its height is unknown: {reason}.{_by_takeoff(tags, maker)}")
    value = _needed(tags, exif)
    return -value if tags.number("EXIF:GPSAltitudeRef", (0.0, 3.0, "")) in (1.0, 3.0) else value


def _by_takeoff(tags: ImageTags, maker: Maker) -> str:
    """Hint for an image without a height."""
    if maker.relative not in tags.values:
        return " It gives no fix."
    return (
        f" Its height above the point of take-off is {tags.shown(maker.relative)} m ({maker.relative}): give that "
        f"point's height in m above the ellipsoid as takeoff_height=."
    )


def _which_datum(tags: ImageTags, maker: Maker) -> str:
    evidence = altitude_shown(tags, maker)
    takeoff = (
        "; or takeoff_height=, the height of the point of take-off in m above the ellipsoid, to which the heights "
        f"above it ({maker.relative.partition(':')[2]}) are added"
        if maker.relative in tags.values
        else ""
    )
    return (
        f"{tags.path}: the vertical datum of its altitude is not stated ({evidence}); {A_WRONG_GUESS}. "
        f'Give height_datum=: "ellipsoid" (WGS 84; usual with RTK), "EPSG:5773" (EGM96 mean sea level), an '
        f"undulation in m, the path of a geoid grid{takeoff}."
    )


def altitude_shown(tags: ImageTags, maker: Maker) -> str:
    """The altitudes of a file, as text."""
    names = [maker.height if maker.height in tags.values else "EXIF:GPSAltitude", maker.relative, *maker.evidence]
    return ", ".join(f"{name.partition(':')[2]} {tags.shown(name)}" for name in names if name in tags.values)

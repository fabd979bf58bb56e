"""CRS of points with heights: name, vertical datum, and the transformation from WGS 84."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS
from pyproj.transformer import Transformer

from jaxgeo.io._proj import UNKNOWN_CRS, NoOperation, known_crs, operation
from jaxgeo.io.datum_names import is_ellipsoid, known_datum, why_unclear
from jaxgeo.io.errors import VerticalDatumError
from jaxgeo.io.vertical import INSTEAD, HeightShift, height_shift, horizontal_part, vertical_part, vertical_unit

ELLIPSOID = "WGS 84 ellipsoid"
TAKEOFF = "unknown (heights are above the take-off)"
CLOSE = 1.0  # m: tolerance of semi-axes of ellipsoids with equivalent heights, such as GRS 80

Area = tuple[float, float, float, float] | None


class MapCRS(NamedTuple):
    """The CRS of points, its horizontal part, the vertical datum, and the transformation from WGS 84.

    Without `to_space` and `shift` points have no heights in it (`flat_map_crs`): their third coordinate is as given.
    """

    crs: pyproj.CRS
    flat: pyproj.CRS
    vertical_datum: str
    to_flat: Transformer
    to_space: Transformer | None
    shift: HeightShift | None
    operation: str

    @property
    def turn(self) -> float | None:
        """360 deg of longitude in the unit of the CRS; None if it is projected."""
        return 2.0 * np.pi / self.flat.axis_info[0].unit_conversion_factor if self.flat.is_geographic else None

    def points(self, name: str, lon_deg: np.ndarray, lat_deg: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Coordinates (n, 3), x or longitude first, of WGS 84 positions with heights in m above its ellipsoid.

        NaN stays NaN. Raises `ValueError` for a position outside the CRS or its vertical datum; `name` is
        the file's, for messages.
        """
        places = np.full((len(lon_deg), 3), np.nan)
        known = np.isfinite(lon_deg) & np.isfinite(lat_deg) & np.isfinite(height)
        given = lon_deg[known], lat_deg[known], height[known]
        if self.shift is None and self.to_space is None:
            places[known] = np.stack([*self.to_flat.transform(*given[:2]), given[2]], axis=-1)
        elif self.shift is None:
            assert self.to_space is not None
            places[known] = np.stack(self.to_space.transform(*given), axis=-1)
        else:
            unit = vertical_unit(vertical_part(self.crs)) or 1.0
            x, y = self.to_flat.transform(*given[:2])
            places[known] = np.stack([x, y, self.shift.from_ellipsoid(*given) / unit], axis=-1)
        lost = np.flatnonzero(known & ~np.isfinite(places).all(axis=-1))
        if lost.size:
            i = lost[0]
            raise ValueError(
                f"{name}: point {i}, at {lat_deg[i]:.6f} deg, {lon_deg[i]:.6f} deg (lat, lon), lies outside of what "
                f"{self.crs.name!r} covers; choose another crs, or other heights."
            )
        return places


def map_crs(name: str, crs: Any, heights: Any, area: Area) -> MapCRS:
    """The caller's CRS, with heights above its own vertical datum, or above `heights`.

    `heights` is "ellipsoid", or a vertical CRS in any form that pyproj takes, such as "EPSG:5773"; None for that of
    `crs`, and if it has none, for the ellipsoid. `area` is (west, south, east, north) in deg. Raises `ValueError`,
    and `VerticalDatumError` where a grid is missing.
    """
    known = _known(name, "crs", crs)
    flat, vertical = horizontal_part(known), _vertical(name, known, heights)
    if not (flat.is_geographic or flat.is_projected):
        raise ValueError(f"{name}: a map needs a projected or geographic crs; {flat.name!r} is a {flat.type_name}.")
    to_flat = _operation(name, "EPSG:4326", flat, area)
    if vertical is not None:
        is_whole = known.is_compound and vertical_part(known) is not None
        whole = known if is_whole else CompoundCRS(f"{flat.name} + {vertical.name}", components=[flat, vertical])
        try:
            shift = height_shift(vertical, area=area)
        except VerticalDatumError as error:
            reason = f"{error}".replace(f" {INSTEAD}", "")  # which a file cannot name
            raise VerticalDatumError(f"{name}: {reason}") from error
        note = f"{to_flat}; heights: {shift.name}"
        return MapCRS(coded(whole), flat, vertical.name, to_flat.transformer, None, shift, note)
    if len(known.axis_info) != 3:
        _check_ellipsoid(name, flat)
    whole = known if len(known.axis_info) == 3 else flat.to_3d()
    to_space = _operation(name, "EPSG:4979", whole, area)
    datum = ELLIPSOID if _is_wgs84(whole) else f"ellipsoid of {whole.geodetic_crs.name}"  # pyright: ignore[reportOptionalMemberAccess]
    return MapCRS(coded(whole), flat, datum, to_flat.transformer, to_space.transformer, None, str(to_space))


def flat_map_crs(name: str, crs: Any, heights: Any, area: Area) -> MapCRS:
    """The caller's horizontal CRS, for points whose heights are above a take-off of unknown height.

    Raises `ValueError` as `map_crs`, and for `heights` and a CRS with heights, which are then unknown.
    """
    known = _known(name, "crs", crs)
    if heights is not None or len(known.axis_info) == 3 or known.is_compound:
        asked = f"heights = {heights!r}" if heights is not None else f"the crs {known.name!r}"
        raise ValueError(
            f"{name}: {asked} needs heights above a datum, and these are above a take-off of unknown height; leave "
            f"it out, or give the height of the take-off."
        )
    if not (known.is_geographic or known.is_projected):
        raise ValueError(f"{name}: a map needs a projected or geographic crs; {known.name!r} is a {known.type_name}.")
    to_flat = _operation(name, "EPSG:4326", known, area)
    return MapCRS(coded(known), known, TAKEOFF, to_flat.transformer, None, None, f"{to_flat}")


def degrees_outside(crs: Any, lat: float, lon: float) -> float:
    """How far in deg a place is outside the area of use of a CRS; 0 if that is unknown."""
    try:
        area = known_crs(crs).area_of_use
    except UNKNOWN_CRS:
        area = None
    if area is None:
        return 0.0
    width, past = (area.east - area.west) % 360.0 or 360.0, (lon - area.west) % 360.0
    across = 0.0 if past <= width else min(past - width, 360.0 - past)
    return max(across, area.south - lat, lat - area.north, 0.0)


def code_of(crs: pyproj.CRS) -> str | None:
    """Short code of a CRS: "EPSG:4979", "EPSG:25832+5773" for a compound one; None if it has no authority code."""
    authority = crs.to_authority()
    if authority is not None:
        return ":".join(authority)
    parts = [part.to_authority() for part in crs.sub_crs_list]
    if parts and all(part is not None and part[0] == "EPSG" for part in parts):
        return "EPSG:" + "+".join(part[1] for part in parts if part is not None)
    return None


def coded(crs: pyproj.CRS) -> pyproj.CRS:
    """The authority's CRS, with its code, if equal to one composed of parts."""
    authority = crs.to_authority()
    return crs if authority is None else pyproj.CRS.from_authority(*authority)


def described(chart: MapCRS) -> Mapping[str, Any]:
    """Description of a file's CRS by names and codes; of the horizontal part if the heights have none."""
    return {
        "crs": code_of(chart.crs) or code_of(chart.flat) or chart.crs.name,
        "crs_name": chart.crs.name,
        "vertical_datum": chart.vertical_datum,
        "operation": f"from WGS 84: {chart.operation}",
    }


def _known(name: str, what: str, given: Any) -> pyproj.CRS:
    try:
        return known_crs(given)
    except UNKNOWN_CRS as error:
        raise ValueError(f"{name}: PROJ does not know {what} = {given!r}: {error}") from error


def _vertical(name: str, crs: pyproj.CRS, heights: Any) -> pyproj.CRS | None:
    """The vertical CRS of heights; None for heights above an ellipsoid."""
    stated = vertical_part(crs)
    if heights is None:
        return None if stated is None or not stated.is_vertical else stated
    heights, is_above_ellipsoid = known_datum(heights), is_ellipsoid(heights)
    meant = None if is_above_ellipsoid else vertical_part(_named(name, heights))
    if not is_above_ellipsoid and meant is None:
        raise ValueError(f"{name}: heights = {heights!r} says nothing about heights; a vertical CRS is expected.")
    meant = meant if meant is not None and meant.is_vertical else None
    if stated is not None:
        own = stated if stated.is_vertical else None
        agree = own is meant or (own is not None and meant is not None and own.equals(meant))
        if not agree:
            raise ValueError(
                f"{name}: heights = {heights!r}, but the crs {crs.name!r} has its own; leave heights out, or give the "
                f"horizontal crs alone."
            )
    return meant


def _named(name: str, heights: Any) -> pyproj.CRS:
    """A CRS that names heights; a number or grid path could convert them, but cannot be named in the file."""
    unclear = why_unclear(heights)
    if unclear is not None:
        raise ValueError(f"{name}: heights = {heights!r} {unclear}.")
    try:
        return _known(name, "heights", heights)
    except (ValueError, TypeError) as error:
        raise ValueError(
            f'{name}: heights = {heights!r} is no vertical CRS that PROJ knows; "ellipsoid", "EPSG:5773" (EGM96), '
            f'"EPSG:3855" (EGM2008) or the code of a national height system can be named in a file.'
        ) from error


def _operation(name: str, source: str, target: pyproj.CRS, area: Area) -> Any:
    try:
        return operation(source, target, area)
    except NoOperation as error:
        raise ValueError(
            f"{name}: PROJ knows no transformation from WGS 84 to {target.name!r} but a ballpark one; "
            f"choose another crs."
        ) from error


def _check_ellipsoid(name: str, flat: pyproj.CRS) -> None:
    """Raises for an older ellipsoid, whose heights differ from those above WGS 84 by up to hundreds of metres."""
    own, wgs84 = flat.ellipsoid, pyproj.CRS("EPSG:4979").ellipsoid
    assert own is not None
    assert wgs84 is not None
    axes = (own.semi_major_metre, own.semi_minor_metre), (wgs84.semi_major_metre, wgs84.semi_minor_metre)
    if np.abs(np.subtract(*axes)).max() > CLOSE:
        raise ValueError(
            f"{name}: {flat.name!r} is on the ellipsoid {own.name}, above which the heights of fixes are not measured; "
            f'give heights a vertical datum, such as "EPSG:5773", or take a crs with heights of its own.'
        )


def _is_wgs84(crs: pyproj.CRS) -> bool:
    geodetic = crs.geodetic_crs
    return geodetic is not None and geodetic.name.startswith("WGS 84")

"""Vertical datums: conversion between a file's heights and heights above the WGS 84 ellipsoid."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from typing import Any

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS
from pyproj.enums import TransformDirection
from pyproj.transformer import Transformer

from jaxgeo.io._proj import UNKNOWN_CRS, NoOperation, how_to_get, known_crs, operation
from jaxgeo.io.datum_names import ELLIPSOID, is_ellipsoid, known_datum, why_unclear
from jaxgeo.io.errors import A_WRONG_GUESS, VerticalDatumError
from jaxgeo.io.geoid_grid import check_grids_of, grid_by_path, wrapped

USUAL_CHOICES = (
    'the usual choices are "EPSG:5773" (EGM96: SRTM, ASTER GDEM), "EPSG:3855" (EGM2008: Copernicus DEM, TanDEM-X '
    'products), the code of a national height system, "ellipsoid" (heights above WGS 84), a constant undulation in m, '
    "or the path of a geoid grid"
)
INSTEAD = "Pass a constant undulation in m or the path of a geoid grid as vertical_datum=..."
FILE, CALLER = "stated by the file", "stated by the caller"
LARGEST_UNDULATION = 200.0  # m; the geoid stays within -107 and +86 m of the ellipsoid, local datums a little beyond

VerticalDatum = str | int | float | pathlib.Path | pyproj.CRS | None


@dataclasses.dataclass(frozen=True)
class HeightShift:
    """Conversion between heights of a vertical datum and heights above the WGS 84 ellipsoid, both in m.

    Either a constant `undulation` or a PROJ operation on (lon_deg, lat_deg, height). Heights of a depth system are
    depths in m, positive downwards.
    """

    name: str
    undulation: float = 0.0
    transformer: Transformer | None = None
    unit: float = 1.0
    """m per unit of the heights that the operation takes: foot datums exist."""
    is_depth: bool = False
    """Whether heights are positive downwards, in the datum and for the operation."""
    west: float = -180.0
    """Lowest longitude in deg that the operation takes."""

    @property
    def sign(self) -> float:
        """m upwards per m of the datum's heights: 1, or -1 for depths."""
        return -1.0 if self.is_depth else 1.0

    @property
    def is_identity(self) -> bool:
        """Whether heights are already ellipsoidal."""
        return self.transformer is None and self.undulation == 0.0 and not self.is_depth

    def to_ellipsoid(self, lon_deg: np.ndarray, lat_deg: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Convert the datum's heights in m to ellipsoidal heights in m; NaN outside the datum's grid."""
        return self._shifted(lon_deg, lat_deg, height, inverse=False)

    def from_ellipsoid(self, lon_deg: np.ndarray, lat_deg: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Convert ellipsoidal heights in m to the datum's heights in m; NaN outside the datum's grid."""
        return self._shifted(lon_deg, lat_deg, height, inverse=True)

    def _shifted(self, lon: np.ndarray, lat: np.ndarray, height: np.ndarray, inverse: bool) -> np.ndarray:
        if self.transformer is None:
            if inverse:
                return self.sign * (height - self.undulation)
            return self.sign * height + self.undulation
        direction = TransformDirection.INVERSE if inverse else TransformDirection.FORWARD
        given = height if inverse else height / self.unit
        shifted = self.transformer.transform(wrapped(lon, self.west), lat, given, direction=direction)[2]
        shifted = np.where(np.isfinite(shifted), shifted, np.nan)
        return shifted * self.unit if inverse else shifted


def height_shift(
    asked: VerticalDatum, stated: pyproj.CRS | None = None, area: tuple[float, float, float, float] | None = None
) -> HeightShift:
    """The conversion for the caller's datum and the one that a file states (a vertical or a 3D CRS), if any.

    A stated one without a name defines only the direction of heights.
    Raises `VerticalDatumError` if neither is known, if they disagree, or if PROJ lacks a grid for it.
    """
    named = None if stated is None or is_unnamed(stated) else stated
    depths = is_depth(stated)
    if asked is None and named is None:
        raise VerticalDatumError(
            f"the file does not state the vertical datum of its heights; {A_WRONG_GUESS}. "
            f"Pass vertical_datum=...: {USUAL_CHOICES}."
        )
    if asked is None:
        return _of_crs(named, area, FILE)  # pyright: ignore[reportArgumentType]
    meant = _understood(asked)
    _check_agreement(meant, named)
    if isinstance(meant, pyproj.CRS) and stated is not None and is_depth(meant) != depths:
        counted = "depths, which count downwards" if depths else "heights, which count upwards"
        raise VerticalDatumError(
            f"the file says that it holds {counted}, and {meant.name!r} counts the other way. Give the datum that "
            f"counts as the file does, a constant undulation in m, or the path of a geoid grid as vertical_datum=..."
        )
    of = f" of {stated.name!r}, whose heights are depths" if depths and stated is not None else ""
    if isinstance(meant, int | float):
        return HeightShift(f"constant undulation {meant:g} m{of}", undulation=meant, is_depth=depths)
    if isinstance(meant, pathlib.Path):
        transformer, west = grid_by_path(meant, depths)
        return HeightShift(f"geoid grid {meant.name}{of}", transformer=transformer, is_depth=depths, west=west)
    if isinstance(meant, str):
        return HeightShift(f"WGS 84 ellipsoid, {CALLER}" + (", depths below it" if depths else ""), is_depth=depths)
    return _of_crs(meant, area, CALLER, is_alone=stated is None)


def vertical_part(crs: pyproj.CRS, *, unnamed: bool = False) -> pyproj.CRS | None:
    """The part of a CRS that defines the vertical datum: a vertical or a 3D CRS, or None.

    With `unnamed`, also a vertical CRS without a name: it defines the unit and direction of heights.
    """
    crs = _unbound(crs)
    if crs.is_compound:
        part = next((p for p in map(_unbound, crs.sub_crs_list) if p.is_vertical), None)
        return None if part is None or (is_unnamed(part) and not unnamed) else part
    if crs.is_vertical or len(crs.axis_info) == 3:
        return crs
    return None


def horizontal_part(crs: pyproj.CRS) -> pyproj.CRS:
    """The two-dimensional part of a CRS."""
    if crs.is_compound:
        return crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) == 3 else crs


def _unbound(crs: pyproj.CRS) -> pyproj.CRS:
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def is_unnamed(crs: pyproj.CRS) -> bool:
    """Whether a vertical CRS defines only the direction of heights, and not the datum."""
    return crs.name.strip().lower() in ("", "unknown", "unnamed")


def vertical_unit(crs: pyproj.CRS | None) -> float | None:
    """m per unit of the heights of a vertical or 3D CRS; None without one."""
    return None if crs is None else float(crs.axis_info[-1].unit_conversion_factor)


def is_depth(crs: pyproj.CRS | None) -> bool:
    """Whether the heights of a vertical or 3D CRS are positive downwards."""
    return crs is not None and crs.axis_info[-1].direction.lower() == "down"


def _understood(asked: Any) -> str | float | pathlib.Path | pyproj.CRS:
    """The caller's datum as "ellipsoid", an undulation, a path or a vertical CRS."""
    asked, unclear = known_datum(asked), why_unclear(asked)
    if isinstance(asked, pathlib.Path):
        return asked
    if unclear is not None:
        raise VerticalDatumError(f"vertical_datum={asked!r} {unclear}, or an undulation in m.")
    if is_ellipsoid(asked):
        return ELLIPSOID
    if isinstance(asked, bool) or not isinstance(asked, str | int | float | np.integer | np.floating | pyproj.CRS):
        raise VerticalDatumError(f"vertical_datum={asked!r} is not understood; {USUAL_CHOICES}.")
    if isinstance(asked, int | np.integer) and abs(asked) > LARGEST_UNDULATION:
        asked = f"EPSG:{asked}"
    if isinstance(asked, int | float | np.integer | np.floating):
        return _checked_undulation(float(asked))
    if isinstance(asked, str) and _looks_like_path(asked):
        return pathlib.Path(asked)
    try:
        crs = known_crs(asked)
    except UNKNOWN_CRS as error:
        raise VerticalDatumError(f"vertical_datum={asked!r} is unknown to PROJ; {USUAL_CHOICES}.") from error
    part = vertical_part(crs)
    if part is None:
        raise VerticalDatumError(f"vertical_datum={asked!r} ({crs.name}) says nothing about heights; {USUAL_CHOICES}.")
    return part


def _checked_undulation(value: float) -> float:
    if not abs(value) <= LARGEST_UNDULATION:
        raise VerticalDatumError(
            f"vertical_datum={value!r} would be a constant undulation in m, but the geoid stays within "
            f'{LARGEST_UNDULATION:g} m of the ellipsoid. An EPSG code is an integer or "EPSG:...".'
        )
    return value


def _looks_like_path(text: str) -> bool:
    return text.lower().endswith((".tif", ".tiff", ".gtx")) or os.path.isfile(text)


def _check_agreement(asked: str | float | pathlib.Path | pyproj.CRS, stated: pyproj.CRS | None) -> None:
    """A number or a grid may replace the geoid that a file names; a datum must equal it."""
    if stated is None:
        return
    says_ellipsoid = _is_ellipsoidal(stated)
    if isinstance(asked, pyproj.CRS):
        agrees = _same_datum(asked, stated)
    elif isinstance(asked, str):
        agrees = says_ellipsoid
    else:
        agrees = not says_ellipsoid
    if not agrees:
        shown = asked.name if isinstance(asked, pyproj.CRS) else str(asked)
        raise VerticalDatumError(
            f"the file says that its heights are measured from {stated.name!r}, the caller says {shown!r}. "
            f"Leave vertical_datum out, or correct the file's CRS if it is wrong (gdal_edit -a_srs)."
        )


def _same_datum(a: pyproj.CRS, b: pyproj.CRS) -> bool:
    if is_depth(a) != is_depth(b):
        return False
    if _is_ellipsoidal(a) or _is_ellipsoidal(b):
        return _is_ellipsoidal(a) and _is_ellipsoidal(b)
    codes = a.to_epsg(min_confidence=70), b.to_epsg(min_confidence=70)
    if None not in codes:
        return codes[0] == codes[1]
    return a.equals(b, ignore_axis_order=True) or a.name == b.name


def _is_ellipsoidal(crs: pyproj.CRS) -> bool:
    return not crs.is_vertical or "ellipsoid" in crs.name.lower()


def _of_crs(
    crs: pyproj.CRS, area: tuple[float, float, float, float] | None, by: str, is_alone: bool = False
) -> HeightShift:
    """The conversion for a CRS; `is_alone` if only the caller names it."""
    unit, depths = vertical_unit(crs) or 1.0, is_depth(crs)
    if _is_ellipsoidal(crs) and (crs.is_vertical or _is_wgs84(crs)):
        return HeightShift(f"WGS 84 ellipsoid, {by}" + (", depths below it" if depths else ""), is_depth=depths)
    if crs.is_vertical:
        source: pyproj.CRS = CompoundCRS(f"WGS 84 + {crs.name}", components=["EPSG:4326", crs])
    elif depths:
        raise VerticalDatumError(
            f"{crs.name!r} has ellipsoidal heights that count downwards, which are not read; change their sign, and "
            f"name a CRS whose heights count upwards."
        )
    else:
        source, unit = crs.geodetic_crs.to_2d().to_3d(), 1.0  # pyright: ignore[reportOptionalMemberAccess]
    try:
        found = operation(source, "EPSG:4979", area)
    except NoOperation as error:
        raise _unreachable(crs, is_alone, error) from error
    check_grids_of(found.transformer)
    name = f"{crs.name}{' (depths)' if depths else ''}, {by}: {found}"
    return HeightShift(name, transformer=found.transformer, unit=unit, is_depth=depths)


def _is_wgs84(crs: pyproj.CRS) -> bool:
    """Whether a 3D CRS is WGS 84's."""
    return crs.geodetic_crs.to_2d().to_3d().to_epsg() == 4979  # pyright: ignore[reportOptionalMemberAccess]


def _unreachable(crs: pyproj.CRS, is_alone: bool, error: NoOperation) -> VerticalDatumError:
    """Error with the remedy for a datum that PROJ cannot convert; never suggests taking depths as heights."""
    if is_alone and is_depth(crs):
        other = (
            "A constant undulation or a geoid grid alone would take these depths for heights: let the CRS of the file "
            "name the depth system and give the undulation or the grid as vertical_datum=..., or turn the depths into "
            "heights (change their sign)."
        )
    else:
        other = INSTEAD
        if is_alone and vertical_unit(crs) != 1.0:
            other += f", and where the file does not state the unit ({crs.axis_info[-1].unit_name}), height_unit=..."
    if error.missing:
        code = crs.to_authority() if crs.is_vertical else None
        how = how_to_get(error.missing, None if code is None else ":".join(code))
        return VerticalDatumError(f"heights above {crs.name!r} need a geoid grid, and {how} {other}")
    return VerticalDatumError(
        f"PROJ knows no transformation from heights above {crs.name!r} to the WGS 84 ellipsoid (a ballpark one, "
        f"which would be zero, is not taken). {other}"
    )

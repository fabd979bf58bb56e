"""Vertical datums: what the heights of a file are measured from, and the way to heights above the WGS 84 ellipsoid."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import Any

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS
from pyproj.enums import TransformDirection
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import Transformer

from jaxgeo.io._proj import NoOperation, how_to_get, operation
from jaxgeo.io.errors import VerticalDatumError

USUAL_CHOICES = (
    'the usual choices are "EPSG:5773" (EGM96: SRTM, ASTER GDEM), "EPSG:3855" (EGM2008: Copernicus DEM, TanDEM-X '
    'products), the code of a national height system, "ellipsoid" (heights above WGS 84), a constant undulation in m, '
    "or the path of a geoid grid"
)
LARGEST_UNDULATION = 200.0  # m; the geoid stays within -107 and +86 m of the ellipsoid, local datums a little beyond

VerticalDatum = str | int | float | pathlib.Path | pyproj.CRS | None


@dataclasses.dataclass(frozen=True)
class HeightShift:
    """The way between heights above a vertical datum and heights above the WGS 84 ellipsoid, both in m.

    Either a constant `undulation` or an operation of PROJ on (lon_deg, lat_deg, height).
    """

    name: str
    undulation: float = 0.0
    transformer: Transformer | None = None
    unit: float = 1.0
    """m per unit of the heights that the operation takes: foot datums exist."""

    @property
    def is_identity(self) -> bool:
        """Whether heights are ellipsoidal already."""
        return self.transformer is None and self.undulation == 0.0

    def to_ellipsoid(self, lon_deg: np.ndarray, lat_deg: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Ellipsoidal heights in m of heights in m above the datum; NaN outside the grid that the datum needs."""
        return self._shifted(lon_deg, lat_deg, height, inverse=False)

    def from_ellipsoid(self, lon_deg: np.ndarray, lat_deg: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Heights in m above the datum of ellipsoidal heights in m; NaN outside the grid that the datum needs."""
        return self._shifted(lon_deg, lat_deg, height, inverse=True)

    def _shifted(self, lon: np.ndarray, lat: np.ndarray, height: np.ndarray, inverse: bool) -> np.ndarray:
        if self.transformer is None:
            return height - self.undulation if inverse else height + self.undulation
        direction = TransformDirection.INVERSE if inverse else TransformDirection.FORWARD
        given = height if inverse else height / self.unit
        shifted = self.transformer.transform((lon + 180.0) % 360.0 - 180.0, lat, given, direction=direction)[2]
        shifted = np.where(np.isfinite(shifted), shifted, np.nan)
        return shifted * self.unit if inverse else shifted


def height_shift(
    asked: VerticalDatum, stated: pyproj.CRS | None = None, area: tuple[float, float, float, float] | None = None
) -> HeightShift:
    """The shift for the datum a caller asked for and the one a file states (a vertical or a 3D CRS), where it does.

    Raises `VerticalDatumError` if neither says it, if they disagree, or if PROJ cannot do it with the grids at hand.
    """
    if asked is None and stated is None:
        raise VerticalDatumError(
            f"the file does not say what its heights are measured from, and a guess may be off by 100 m. "
            f"Pass vertical_datum=...: {USUAL_CHOICES}."
        )
    if asked is None:
        return _of_crs(stated, area, "stated by the file")  # pyright: ignore[reportArgumentType]
    meant = _understood(asked)
    _check_agreement(meant, stated)
    if isinstance(meant, int | float):
        return HeightShift(f"constant undulation {meant:g} m", undulation=meant)
    if isinstance(meant, pathlib.Path):
        return _of_grid(meant)
    if isinstance(meant, str):
        return HeightShift("WGS 84 ellipsoid, stated by the caller")
    return _of_crs(meant, area, "stated by the caller")


def vertical_part(crs: pyproj.CRS) -> pyproj.CRS | None:
    """The part of a CRS that says what heights are measured from: a vertical or a 3D CRS, or None."""
    crs = _unbound(crs)
    if crs.is_compound:
        part = next((p for p in map(_unbound, crs.sub_crs_list) if p.is_vertical), None)
        return None if part is None or part.name.strip().lower() in ("", "unknown", "unnamed") else part
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


def vertical_unit(crs: pyproj.CRS | None) -> float | None:
    """m per unit of the heights of a vertical or 3D CRS; None without one."""
    return None if crs is None else float(crs.axis_info[-1].unit_conversion_factor)


def _understood(asked: Any) -> str | float | pathlib.Path | pyproj.CRS:
    """A caller's datum as "ellipsoid", an undulation, a path or a vertical CRS."""
    if isinstance(asked, pathlib.Path):
        return asked
    if isinstance(asked, str) and asked.strip().lower() == "ellipsoid":
        return "ellipsoid"
    if isinstance(asked, bool) or not isinstance(asked, str | int | float | np.integer | np.floating | pyproj.CRS):
        raise VerticalDatumError(f"vertical_datum={asked!r} is not understood; {USUAL_CHOICES}.")
    if isinstance(asked, int | np.integer) and abs(asked) > LARGEST_UNDULATION:
        asked = f"EPSG:{asked}"
    if isinstance(asked, int | float | np.integer | np.floating):
        return _checked_undulation(float(asked))
    if isinstance(asked, str) and _looks_like_path(asked):
        return pathlib.Path(asked)
    try:
        crs = pyproj.CRS.from_user_input(asked)
    except CRSError as error:
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
    return text.lower().endswith((".tif", ".tiff", ".gtx")) or pathlib.Path(text).is_file()


def _check_agreement(asked: str | float | pathlib.Path | pyproj.CRS, stated: pyproj.CRS | None) -> None:
    """A number or a grid may stand in for the geoid that a file names; a datum must be the one that it names."""
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
    if _is_ellipsoidal(a) or _is_ellipsoidal(b):
        return _is_ellipsoidal(a) and _is_ellipsoidal(b)
    codes = a.to_epsg(min_confidence=70), b.to_epsg(min_confidence=70)
    if None not in codes:
        return codes[0] == codes[1]
    return a.equals(b, ignore_axis_order=True) or a.name == b.name


def _is_ellipsoidal(crs: pyproj.CRS) -> bool:
    return not crs.is_vertical or "ellipsoid" in crs.name.lower()


def _of_crs(crs: pyproj.CRS, area: tuple[float, float, float, float] | None, by: str) -> HeightShift:
    unit = vertical_unit(crs) or 1.0
    if crs.is_vertical and _is_ellipsoidal(crs):
        return HeightShift(f"WGS 84 ellipsoid, {by}")
    if crs.is_vertical:
        source: pyproj.CRS = CompoundCRS(f"WGS 84 + {crs.name}", components=["EPSG:4326", crs])
    else:
        source = crs.geodetic_crs.to_3d()  # pyright: ignore[reportOptionalMemberAccess]
        if source.to_epsg() == 4979:
            return HeightShift(f"WGS 84 ellipsoid, {by}")
        unit = 1.0
    try:
        found = operation(source, "EPSG:4979", area)
    except NoOperation as error:
        if error.missing:
            raise VerticalDatumError(
                f"heights above {crs.name!r} need a geoid grid, and {how_to_get(error.missing)}"
            ) from error
        raise VerticalDatumError(
            f"PROJ knows no transformation from heights above {crs.name!r} to the WGS 84 ellipsoid (a ballpark one, "
            f"which would be zero, is not taken). Pass a constant undulation in m or the path of a geoid grid."
        ) from error
    return HeightShift(f"{crs.name}, {by}: {found}", transformer=found.transformer, unit=unit)


def _of_grid(path: pathlib.Path) -> HeightShift:
    """Bilinear undulations from a geoid grid that PROJ can read; its longitudes and latitudes taken as WGS 84's."""
    if not path.is_file():
        raise VerticalDatumError(f"vertical_datum: the geoid grid {path} does not exist.")
    if any(character in str(path) for character in '",'):
        raise VerticalDatumError(f"vertical_datum: PROJ cannot take a path with a comma or a quote in it: {path}")
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f'+step +proj=vgridshift +grids="{path.resolve()}" +multiplier=1 '
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    try:
        transformer = Transformer.from_pipeline(pipeline)
    except ProjError as error:
        raise VerticalDatumError(
            f"vertical_datum: PROJ cannot read {path} as a geoid grid (it takes GeoTIFF and GTX files with the "
            f"undulation in m in the first band)."
        ) from error
    return HeightShift(f"geoid grid {path.name}", transformer=transformer)

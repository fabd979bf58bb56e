"""Map grid of an image block: geographic positions, convergence and scale."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyproj

from jaxgeo.earth import WGS84
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs, unit_normals
from jaxgeo.io.errors import DemError, TableError
from jaxgeo.io.mapping import FileMap, file_map
from jaxgeo.io.vertical import horizontal_part, vertical_part

# Half chord length for measuring grid north, m: the grid's curvature then causes 1e-12 rad, and the rounding
# of positions 1e-11.
HALF_CHORD = 30.0

Pair = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class MapGrid:
    """Conversion between easting and northing (or longitude and latitude) in the units of a CRS, and WGS 84 in deg."""

    map: FileMap

    @classmethod
    def about(cls, where: Any, crs: pyproj.CRS, x: np.ndarray, y: np.ndarray) -> MapGrid:
        """The grid of a CRS near given coordinates, which select the operation to WGS 84.

        Raises `TableError`, prefixed by `where`, if PROJ has only a ballpark one.
        """
        known = np.isfinite(x) & np.isfinite(y)
        x, y = (u[known] if known.any() else np.zeros(1) for u in (x, y))
        shape = math.ceil(np.ptp(y)) + 1, math.ceil(np.ptp(x)) + 1
        try:
            return cls(file_map(str(where), crs, (1.0, 0.0, float(x.min()), 0.0, 1.0, float(y.min())), shape))
        except DemError as error:
            raise TableError(
                f"{where}: PROJ knows no transformation from {crs.name!r} to WGS 84 but a ballpark one, which may be "
                f"off by hundreds of metres; name the CRS by its EPSG code, or say its datum (+datum=WGS84)."
            ) from error

    @classmethod
    def about_lonlat(cls, where: Any, crs: pyproj.CRS, lon_deg: np.ndarray, lat_deg: np.ndarray) -> MapGrid:
        """The same for geographic positions."""
        rough = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
        return cls.about(where, crs, *rough.transform(lon_deg, lat_deg))

    def to_lonlat(self, x: np.ndarray, y: np.ndarray) -> Pair:
        """Longitude and latitude in deg; NaN outside the map's domain."""
        return _finite(*self.map.to_lonlat(x, y))

    def from_lonlat(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> Pair:
        """Map coordinates; NaN outside its domain."""
        return _finite(*self.map.from_lonlat(lon_deg, lat_deg))

    def convergence(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Grid convergence: direction of grid north, rad clockwise from true north; NaN if the map is mirrored."""
        north, east = self._azimuth(x, y, 0.0, HALF_CHORD), self._azimuth(x, y, HALF_CHORD, 0.0)
        return np.where(np.sin(east - north) > 0.0, north, np.nan)

    def scale(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        """The map's scale along the meridian, on the ellipsoid: in a conformal map that in any direction."""
        return np.asarray(pyproj.Proj(self.map.crs).get_factors(lon_deg, lat_deg).meridional_scale)

    def _azimuth(self, x: np.ndarray, y: np.ndarray, dx: float, dy: float) -> np.ndarray:
        """Direction of the chord from (x, y) - (dx, dy) to (x, y) + (dx, dy), clockwise from true north, rad."""
        lon, lat = (np.radians(angle) for angle in self.to_lonlat(x, y))
        chord = _on_ellipsoid(*self.to_lonlat(x + dx, y + dy)) - _on_ellipsoid(*self.to_lonlat(x - dx, y - dy))
        north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
        east = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
        return np.arctan2(np.sum(chord * east, axis=-1), np.sum(chord * north, axis=-1))


def understood_crs(where: Any, crs: Any) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """(the horizontal part, the vertical one if any) of a CRS from the caller or a file.

    Raises `TableError` for one that is unknown to PROJ or without plane or geographic coordinates.
    """
    try:
        whole = known_crs(crs)
    except UNKNOWN_CRS as error:
        raise TableError(f"{where}: crs = {crs!r} is unknown to PROJ; expected for example 'EPSG:32617'.") from error
    horizontal = horizontal_part(whole)
    if not (horizontal.is_projected or horizontal.is_geographic):
        raise TableError(f"{where}: crs = {_stated(crs, whole)} is no map; expected a projected CRS.")
    return horizontal, vertical_part(whole, unnamed=True)


def metric_map(where: Any, crs: Any) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """As `understood_crs`, for a map in metres; raises `TableError` for anything else."""
    horizontal, vertical = understood_crs(where, crs)
    if not horizontal.is_projected:
        raise TableError(f"{where}: crs = {_stated(crs, horizontal)} is no map; expected a projected CRS.")
    axes = [*horizontal.axis_info, *([] if vertical is None else vertical.axis_info[-1:])]
    units = {axis.unit_name: None for axis in axes if axis.unit_conversion_factor != 1.0}
    if units:
        raise TableError(f"{where}: crs = {_stated(crs, horizontal)} is in {', '.join(units)}, but the columns are in "
                         f"metres.")  # fmt: skip
    return horizontal, vertical


def _stated(crs: Any, known: pyproj.CRS) -> str:
    """A CRS as the caller wrote it, with its name; an object, such as one read from a file, by its name."""
    return repr(known.name) if isinstance(crs, pyproj.CRS) else f"{crs!r} ({known.name})"


def _finite(x: np.ndarray, y: np.ndarray) -> Pair:
    """A pair with infinities replaced by NaN, to avoid warnings of trigonometric functions."""
    return np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)


def _on_ellipsoid(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Positions in ECEF m, (..., 3), at height zero."""
    normals = unit_normals(lon_deg, lat_deg)
    radius = WGS84.a / np.sqrt(1.0 - WGS84.e2 * normals[..., 2] ** 2)
    return radius[..., None] * normals * np.array([1.0, 1.0, 1.0 - WGS84.e2])


def projection_text(text: str) -> str:
    """The projection of the first line in PROJ's notation."""
    if text.upper() in ("WGS84", "EPSG:4326"):
        return "EPSG:4326"
    utm = re.fullmatch(r"WGS84\s+UTM\s+([0-9]{1,2})\s*([NS]?)", text, re.IGNORECASE)
    if utm and 1 <= int(utm[1]) <= 60:
        return f"EPSG:{327 if utm[2].upper() == 'S' else 326}{int(utm[1]):02d}"
    return text

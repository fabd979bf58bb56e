"""Mapping between a file's map and WGS 84 by PROJ, and the measured error of a grid against it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import numpy as np
import pyproj
from pyproj.exceptions import ProjError

from jaxgeo._compile import batch_filter_jit
from jaxgeo.earth import WGS84
from jaxgeo.io._proj import NoOperation, operation, unit_normals
from jaxgeo.io.errors import DemError
from jaxgeo.terrain.grid import AbstractGrid

LEAST_DRIFT, MOST_DRIFT = 1e-6, 0.1  # m: range of round-trip errors of PROJ's projections that are corrected
Affine6 = tuple[float, float, float, float, float, float]
OTHER_BODY = 0.01  # of the semi-axes; ellipsoids and spheres of the Earth lie within 0.4 % of each other
XY = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclasses.dataclass(frozen=True)
class FileMap:
    """PROJ's mapping of a file: between longitude and latitude of WGS 84 in deg and (row, col)."""

    affine: Affine6
    shape: tuple[int, int]
    crs: pyproj.CRS
    to_lonlat: XY
    from_lonlat: XY
    horizontal: str

    def lonlat(self, row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Longitude and latitude in deg at (row, col); infinite outside the map's domain."""
        a, b, c, d, e, f = self.affine
        return self.to_lonlat(a * col + b * row + c, d * col + e * row + f)

    def rowcol(self, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row, col) at longitude and latitude in deg; on a geographic map within 180 deg of the centre."""
        a, b, c, d, e, f = self.affine
        x, y = self.from_lonlat(lon, lat)
        if self.crs.is_geographic:
            turn = 2.0 * np.pi / self.crs.axis_info[0].unit_conversion_factor
            centre = c + a * (self.shape[1] - 1) / 2 + b * (self.shape[0] - 1) / 2
            with np.errstate(invalid="ignore"):
                x = x - turn * np.round((x - centre) / turn)
        x, y, det = x - c, y - f, a * e - b * d
        with np.errstate(invalid="ignore"):  # infinite outside the map's domain
            return (a * y - d * x) / det, (e * x - b * y) / det

    def turn(self) -> np.ndarray:
        """(rows, cols) of 360 degrees of longitude, on a geographic map."""
        a, b, _, d, e, _ = self.affine
        turn = 2.0 * np.pi / self.crs.axis_info[0].unit_conversion_factor
        return turn * np.array([-d, e]) / (a * e - b * d)

    def window(self, row: int, col: int, shape: tuple[int, int]) -> FileMap:
        """The mapping of a part that starts at (row, col)."""
        a, b, c, d, e, f = self.affine
        moved = (a, b, c + a * col + b * row, d, e, f + d * col + e * row)
        return dataclasses.replace(self, affine=moved, shape=shape)


@dataclasses.dataclass(frozen=True)
class MapError:
    """Largest differences between a grid and PROJ over independent posts: forward in m and cells, and inverse in m.

    Forward is the worse of two: by PROJ's positions of posts, and by PROJ's posts of those positions, since on some
    maps PROJ's round trip is not exact.
    """

    metres: float
    cells: float
    back_metres: float

    @property
    def worst(self) -> float:
        """The larger of both directions, m."""
        return max(self.metres, self.back_metres)


def file_map(
    name: str, crs: pyproj.CRS, affine: Affine6, shape: tuple[int, int], *, assume_wgs84: bool = False
) -> FileMap:
    """PROJ's mapping of a file's horizontal CRS.

    One operation serves the whole file. A null transformation in the EPSG registry (ETRS89, NAD83 or RGF93 to
    WGS 84) is accepted, with its stated accuracy; a ballpark one is refused with `DemError` unless `assume_wgs84`
    declares the file's latitudes and longitudes to be those of WGS 84. Between two ellipsoids PROJ shifts
    a position as if at height zero: the shift of an old national datum is then off by a decimetre or two at
    3000 m, well within its stated accuracy.
    """
    geographic = crs.geodetic_crs
    check_is_earth(name, crs)
    if assume_wgs84 and geographic is not None:
        if crs.is_geographic:
            return FileMap(affine, shape, crs, _keep, _keep, "taken as WGS 84 by the caller")
        found = operation(crs, geographic)
        horizontal = f"{found.name}, then taken as WGS 84 by the caller"
    else:
        try:
            found = operation(crs, "EPSG:4326", _area(crs, affine, shape))
        except NoOperation as error:
            raise DemError(
                f"{name}: PROJ knows no transformation from {crs.name!r} to WGS 84 but a ballpark one, which may be "
                f"off by hundreds of metres. If the file's datum is WGS 84 in all but name, pass assume_wgs84=True."
            ) from error
        horizontal = str(found)
    forward = _true_projection(crs, affine, shape, found.transformer.transform)
    return FileMap(affine, shape, crs, forward, _true_inverse(found.transformer, forward), horizontal)


def check_is_earth(name: str, crs: pyproj.CRS) -> None:
    """Raise `DemError` for a map of a body other than the Earth, by the size of its ellipsoid."""
    body = crs.ellipsoid
    if body is None:
        return
    sizes = body.semi_major_metre / WGS84.a, body.semi_minor_metre / WGS84.b
    if max(abs(size - 1.0) for size in sizes) > OTHER_BODY:
        raise DemError(
            f"{name}: the map {crs.name!r} is of a body with semi-axes of {body.semi_major_metre:.0f} and "
            f"{body.semi_minor_metre:.0f} m, which is not the Earth ({WGS84.a:.0f} and {WGS84.b:.0f} m). Only maps of "
            f"the Earth are read."
        )


def measure(grid: AbstractGrid, mapping: FileMap) -> MapError:
    """Largest error of a grid against PROJ, over a lattice of posts including edges and as many random ones."""
    rows, cols = (np.asarray(n - 1.0) for n in mapping.shape)
    lattice = np.stack(np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41), indexing="ij"), -1).reshape(-1, 2)
    scattered = np.random.default_rng(20).uniform(size=lattice.shape)
    rowcol = np.concatenate([lattice, scattered]) * np.array([rows, cols])
    normals = unit_normals(*mapping.lonlat(rowcol[:, 0], rowcol[:, 1]))
    if not np.all(np.isfinite(normals)):
        return MapError(np.inf, np.inf, np.inf)
    found, back = _both_ways(grid, *jax.device_put((normals, rowcol)))
    off = np.asarray(found) - rowcol
    if mapping.crs.is_geographic:  # columns beyond 360 deg coincide with others
        off = off - mapping.turn() * np.round(off @ mapping.turn() / np.sum(mapping.turn() ** 2))[:, None]
    cells = np.abs(off)
    if not mapping.crs.is_geographic:
        again = np.stack(mapping.rowcol(*mapping.lonlat(rowcol[:, 0], rowcol[:, 1])), axis=-1)
        cells = np.fmax(cells, np.abs(np.asarray(found) - again))
    size = np.asarray(grid.cell_size())
    metres = np.linalg.norm(cells * size, axis=1).max()
    return MapError(
        float(metres), float(cells.max()), float(np.linalg.norm(np.asarray(back) - normals, axis=1).max() * WGS84.a)
    )


@batch_filter_jit
def _both_ways(grid: AbstractGrid, normals: jax.Array, rowcol: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(grid.rowcol)(normals), jax.vmap(grid.normal)(rowcol)


def _area(crs: pyproj.CRS, affine: Affine6, shape: tuple[int, int]) -> tuple[float, float, float, float] | None:
    """Rough (west, south, east, north) in deg, for PROJ's choice of an operation; None if unknown."""
    if crs.geodetic_crs is None:
        return None
    a, b, c, d, e, f = affine
    row, col = (u.ravel() for u in np.meshgrid(np.linspace(0, shape[0] - 1, 9), np.linspace(0, shape[1] - 1, 9)))
    x, y = a * col + b * row + c, d * col + e * row + f
    if not crs.is_geographic:
        try:
            x, y = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
        except ProjError:  # damaged definition
            return None
    x, y = x[np.isfinite(x)], y[np.isfinite(y)]
    if not x.size or not y.size or np.ptp(x) > 180.0:
        return None
    west, east = ((lon + 180.0) % 360.0 - 180.0 for lon in (x.min(), x.max()))
    return float(west), float(np.clip(y.min(), -90, 90)), float(east), float(np.clip(y.max(), -90, 90))


def _true_projection(crs: pyproj.CRS, affine: Affine6, shape: tuple[int, int], to_lonlat: XY) -> XY:
    """`to_lonlat`, corrected where PROJ's inverse projection differs from its forward formula, the reference.

    By up to some mm in equal-area maps, whose inverse PROJ computes from a short series.
    """
    if crs.is_geographic or crs.geodetic_crs is None:
        return to_lonlat
    projection = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
    unit = crs.axis_info[0].unit_conversion_factor

    def drift(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        again = projection.transform(*projection.transform(x, y, direction="INVERSE"))
        with np.errstate(invalid="ignore"):  # infinite outside the map's domain
            off = np.stack([again[0] - x, again[1] - y])
        return tuple(np.where(np.isfinite(off), off, 0.0))

    a, b, c, d, e, f = affine
    row, col = (u.ravel() for u in np.meshgrid(np.linspace(0, shape[0] - 1, 9), np.linspace(0, shape[1] - 1, 9)))
    off = np.abs(drift(a * col + b * row + c, d * col + e * row + f)).max() * unit
    if not LEAST_DRIFT < off < MOST_DRIFT:  # larger ones are not rounding but positions that the map shows twice
        return to_lonlat

    def mended(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off_x, off_y = drift(x, y)
        return to_lonlat(x - off_x, y - off_y)

    return mended


def _true_inverse(transformer: pyproj.Transformer, forward: XY) -> XY:
    """The exact inverse of `transformer.transform`; between two ellipsoids PROJ's own is exact only to millimetres.

    There PROJ assumes height zero on either side; the posts are defined by the forward transformation to WGS 84.
    """

    def inverse(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = transformer.transform(lon, lat, direction="INVERSE")
        again = forward(x, y)
        with np.errstate(invalid="ignore"):  # infinite outside the map's domain
            off_lon, off_lat = (lon - again[0] + 180.0) % 360.0 - 180.0, lat - again[1]
            off = np.maximum(np.abs(off_lon) * np.cos(np.radians(lat)), np.abs(off_lat))
        if not np.any((off > 1e-11) & np.isfinite(off)):
            return x, y
        return transformer.transform(lon + off_lon, np.clip(lat + off_lat, -90.0, 90.0), direction="INVERSE")

    return inverse


def _keep(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return x, y

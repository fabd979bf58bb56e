"""Grid of a file's map projection: exact if available, otherwise Chebyshev polynomials fitted to PROJ."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev

from jaxgeo.earth import WGS84, Ellipsoid
from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.io._proj import lonlat_of, unit_normals
from jaxgeo.io.errors import DemError
from jaxgeo.io.mapping import FileMap, MapError, measure
from jaxgeo.terrain.grid import AbstractGrid, FittedGrid, GeographicGrid, TransverseMercatorGrid

EXACT = 1e-4  # m; an exact grid must agree with PROJ to this, otherwise it is rejected
FITTED = 1e-3  # m and cells; the largest error that a fitted grid may have
DEGREES = (4, 8, 12, 16, 20)  # few, since JAX compiles for each
ROOM = 50_000.0  # m; minimum half width of a fit around the centre, so that rays enter over mapped ground


def make_grid(name: str, mapping: FileMap) -> tuple[AbstractGrid, MapError]:
    """The grid of a file: exact if available, otherwise fitted; verified against PROJ. Raises `DemError`."""
    for exact in _exact_candidates(mapping):
        error = measure(exact, mapping)
        if error.worst <= EXACT:
            return exact, error
    return fit(name, mapping)


def _exact_candidates(mapping: FileMap) -> list[AbstractGrid]:
    crs = mapping.crs.source_crs if mapping.crs.is_bound and mapping.crs.source_crs is not None else mapping.crs
    if crs.is_geographic:
        return [GeographicGrid.from_affine(mapping.affine, mapping.shape)]
    conversion = crs.coordinate_operation
    if conversion is None or conversion.method_code not in ("9807", "9808"):
        return []
    value = {p.code: float(p.value) * float(p.unit_conversion_factor) for p in conversion.params}
    ellipsoid, meridian = crs.ellipsoid, crs.prime_meridian
    if ellipsoid is None or not {"8801", "8802", "8805", "8806", "8807"} <= value.keys():
        return []
    f = 1.0 / ellipsoid.inverse_flattening if ellipsoid.inverse_flattening else 0.0
    origin = 0.0 if meridian is None else float(meridian.longitude) * float(meridian.unit_conversion_factor)
    projection = TransverseMercator(
        lon0=float(value["8802"] + origin),
        lat0=float(value["8801"]),
        k0=float(value["8805"]),
        false_easting=float(value["8806"]),
        false_northing=float(value["8807"]),
        ellipsoid=Ellipsoid(a=float(ellipsoid.semi_major_metre), f=float(f)),
    )
    unit = crs.axis_info[0].unit_conversion_factor
    if conversion.method_code == "9808":  # south-orientated: westing and southing axes
        unit = -unit
    return [TransverseMercatorGrid.from_affine(projection, tuple(unit * x for x in mapping.affine), mapping.shape)]


def fit(name: str, mapping: FileMap) -> tuple[FittedGrid, MapError]:
    """Chebyshev polynomials in the tangent plane; the degree rises until the error on independent posts is small.

    The fit covers the file and `ROOM` around its centre, where PROJ maps that too. Raises `DemError`.
    """
    smallest = np.inf
    for room in (ROOM, 0.0):
        frame = _frame(name, mapping, room)
        both, rough = None, np.inf
        for degree in DEGREES:
            candidate = _fitted(mapping, frame, degree)
            error = _rough_error(mapping, frame, candidate)
            if error < rough:
                both, rough = candidate, error
            if candidate is None or rough < FITTED / 10:
                break
        smallest = min(smallest, rough)
        if both is None or rough >= FITTED:
            continue
        leaves = dataclasses.astuple(frame)
        grid = FittedGrid(*map(jnp.asarray, (*leaves, both[..., :2], both[..., 2:])))
        measured = measure(grid, mapping)
        if measured.worst < FITTED and measured.cells < FITTED:
            return grid, measured
        smallest = max(smallest, measured.worst)
    reason = f"the best fit is off by {smallest:.3g} m" if np.isfinite(smallest) else "PROJ does not map all of it"
    raise DemError(
        f"{name}: the map {mapping.crs.name!r} could not be followed to 1 mm over this area: {reason}. "
        f"Read a part with bounds=, or warp the file to UTM or to geographic coordinates first."
    )


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Domain of a fit: the tangent frame, and half widths in the plane and in (row, col)."""

    rowcol0: np.ndarray
    R_enu_from_ecef: np.ndarray
    plane_half: np.ndarray
    rowcol_half: np.ndarray

    def plane_at(self, mapping: FileMap, rowcol: np.ndarray) -> np.ndarray:
        """Plane coordinates (n, 2) of (row, col); not finite where PROJ fails or beyond the horizon."""
        enu = unit_normals(*mapping.lonlat(rowcol[:, 0], rowcol[:, 1])) @ self.R_enu_from_ecef.T
        return enu[:, :2] / np.where(enu[:, 2:] > 0.1, enu[:, 2:], np.nan)


def _frame(name: str, mapping: FileMap, room: float) -> _Frame:
    rowcol0 = (np.asarray(mapping.shape) - 1.0) / 2.0
    lon, lat = np.radians(np.array(mapping.lonlat(rowcol0[:1], rowcol0[1:]))[:, 0])
    R = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    edge = np.linspace(-1.0, 1.0, 41)
    ring = np.concatenate([np.stack([edge, s * np.ones(41)], 1) for s in (-1, 1)])
    ring = np.concatenate([ring, ring[:, ::-1]]) * rowcol0 + rowcol0
    enu = unit_normals(*mapping.lonlat(ring[:, 0], ring[:, 1])) @ R.T
    if not np.all(np.isfinite(enu)):
        raise DemError(f"{name}: PROJ cannot say where some posts at the file's edge lie ({mapping.crs.name!r}).")
    if enu[:, 2].min() < 0.2:
        raise DemError(f"{name}: the file covers too much of the Earth for one map; read a part with bounds=.")
    plane_half = np.maximum(1.05 * np.abs(enu[:, :2] / enu[:, 2:]).max(axis=0), room / WGS84.a)
    cell = 2.0 * np.linalg.norm(enu[:, :2], axis=1).max() * WGS84.a / np.linalg.norm(2.0 * rowcol0)
    return _Frame(rowcol0, R, plane_half, np.maximum(1.05 * rowcol0, room / cell))


def _fitted(mapping: FileMap, frame: _Frame, degree: int) -> np.ndarray | None:
    """Coefficients (degree + 1, degree + 1, 4) of (row, col) in the plane and of the plane in (row, col).

    Least squares on Chebyshev nodes, in units of the half widths; None if PROJ does not map the whole area.
    """
    t = np.cos(np.pi * (np.arange(2 * degree + 2) + 0.5) / (2 * degree + 2))
    nodes = np.stack(np.meshgrid(t, t, indexing="ij"), -1).reshape(-1, 2)
    plane = nodes * frame.plane_half
    normals = np.concatenate([plane, np.ones((len(plane), 1))], axis=1) @ frame.R_enu_from_ecef
    rowcol = np.stack(mapping.rowcol(*lonlat_of(normals)), axis=-1)
    there = (rowcol - frame.rowcol0) / frame.rowcol_half
    back = frame.plane_at(mapping, nodes * frame.rowcol_half + frame.rowcol0) / frame.plane_half
    if not (np.all(np.isfinite(there)) and np.all(np.isfinite(back))):
        return None
    solve = np.linalg.pinv(chebyshev.chebvander(t, degree))
    values = np.concatenate([there, back], axis=1).reshape(len(t), len(t), 4)
    return np.einsum("iu,jv,uvk->ijk", solve, solve, values, optimize=True)


def _rough_error(mapping: FileMap, frame: _Frame, both: np.ndarray | None) -> float:
    """Largest error in m of a fit on a lattice of posts between the nodes, both ways; infinite without a fit."""
    if both is None:
        return np.inf
    u, v = np.meshgrid(np.linspace(0.0, 2.0, 38), np.linspace(0.0, 2.0, 38))
    posts = np.stack([u.ravel(), v.ravel()], axis=1) * frame.rowcol0
    plane = frame.plane_at(mapping, posts)
    cell = np.linalg.norm(frame.plane_half) / np.linalg.norm(frame.rowcol_half)
    (x, y), (r, c) = (plane / frame.plane_half).T, ((posts - frame.rowcol0) / frame.rowcol_half).T
    there = chebyshev.chebval2d(x, y, both[..., :2]).T * frame.rowcol_half + frame.rowcol0
    back = chebyshev.chebval2d(r, c, both[..., 2:]).T * frame.plane_half
    error = max(np.abs(there - posts).max() * cell, np.abs(back - plane).max()) * WGS84.a
    return float(error) if np.isfinite(error) else np.inf

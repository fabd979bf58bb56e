"""Post grids: maps between positions and (row, col), smooth and exact in both directions.

A position is given by the outward unit normal of the WGS 84 ellipsoid, which unlike latitude and longitude is smooth at
the poles and across the date line. Posts (pixel centres) are at integers of (row, col); row 0 is the file's first row.
All leaves are floats, so another window or another file of the same kind needs no recompilation.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from jaxgeo._checks import as_float64, require_x64
from jaxgeo._compile import one_program, quick_filter_jit
from jaxgeo._elementary import arctangent_of_neighbours
from jaxgeo._numerics import larger, safe_sqrt, times, within
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, Vector3
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.earth.geodetic import checked_position
from jaxgeo.earth.projection import TransverseMercator

RowCol = Float[Array, "2"]
Pair = Num[Array, "... 2"]  # fields may carry batch axes
Step = Num[Array, "... 2 2"]
Rotation = Num[Array, "... 3 3"]
GridT = TypeVar("GridT", bound="AbstractGrid")

_EDGE = 2.0  # a fitted map is valid to twice the half width of the fitted area, and linear beyond
_HORIZON = 0.05  # cosine of the angle from a tangent frame's centre beyond which plane coordinates are clamped


class AbstractGrid(Record):
    """A map between positions and (row, col), smooth over its area and the surroundings."""

    rowcol0: eqx.AbstractVar[Pair]
    """(row, col) of the reference point, the centre of the grid."""

    @abc.abstractmethod
    def row_and_col(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
        """Row and column of the position with ellipsoid normal (x, y, z); outside the grid too."""

    def rowcol(self, normal: Vector3) -> RowCol:
        """(row, col) of the position with ellipsoid normal `normal`; outside the grid too."""
        return jnp.stack(self.row_and_col(*normal))

    @abc.abstractmethod
    def normal(self, rowcol: RowCol) -> Vector3:
        """Outward unit normal of WGS 84 (ECEF axes) at (row, col); the inverse of `rowcol`."""

    def _from_reference(self, a: Scalar, b: Scalar) -> tuple[Scalar, Scalar]:
        """Row and column of an offset from the reference point, in the units of the steps."""
        row, col = times(_inverse(self.step), (a, b))  # pyright: ignore[reportAttributeAccessIssue]
        row0, col0 = self.rowcol0
        return row0 + row, col0 + col

    def cell_size(self) -> Float[Array, "2"]:
        """Length in m of one step in row and one in col, on the ellipsoid at the grid's centre."""
        return _cell_size(self, jnp.asarray(self.rowcol0, jnp.float64))

    def cell_size_at(self, rowcol: Float[Array, "2"]) -> Float[Array, "2"]:
        """`cell_size` at (row, col)."""
        return _cell_size(self, rowcol)

    def coarser(self: GridT, factor: float | int) -> GridT:
        """The grid with cells `factor` posts long and wide: its post (0, 0) is at the centre of the first such square.

        A factor below one makes a finer grid.
        """
        first = (jnp.asarray(factor, jnp.float64) - 1.0) / 2.0
        grid = eqx.tree_at(lambda grid: grid.rowcol0, self, (jnp.asarray(self.rowcol0, jnp.float64) - first) / factor)
        return grid._with_steps(float(factor))

    def _with_steps(self: GridT, factor: float) -> GridT:
        """The grid with steps scaled about its reference point."""
        return eqx.tree_at(lambda grid: grid.step, self, jnp.asarray(self.step) * factor)  # pyright: ignore

    def window(self: GridT, row: ScalarField, col: ScalarField) -> GridT:
        """The grid of a window whose first post is this grid's post (row, col)."""
        first = jnp.stack([jnp.asarray(row, jnp.float64), jnp.asarray(col, jnp.float64)])
        return eqx.tree_at(lambda grid: grid.rowcol0, self, jnp.asarray(self.rowcol0, jnp.float64) - first)


class GeographicGrid(AbstractGrid):
    """Rows and columns affine in WGS 84 longitude and latitude, including rotation and shear.

    Longitude is relative to the grid's centre, so files across the date line or in 0..360 need no special handling.
    `lonlat0` in rad at `rowcol0`; `step` is d(lon, lat) / d(row, col) in rad. Columns jump by a full turn opposite to
    the centre: a grid around the whole Earth needs posts on both sides of that line at either end for rays to cross it.
    """

    rowcol0: Pair
    lonlat0: Pair
    step: Step

    @classmethod
    def from_affine(cls, affine: Sequence[float | int], shape: tuple[int, int]) -> GeographicGrid:
        """From (a, b, c, d, e, f) at post centres, lon_deg = a col + b row + c, lat_deg = d col + e row + f."""
        return cls(*_centred(affine, shape, math.pi / 180.0))

    def row_and_col(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
        lon0, lat0 = self.lonlat0
        c, s = jnp.cos(lon0), jnp.sin(lon0)
        x, y = c * x + s * y, c * y - s * x
        at_pole = (x == 0.0) & (y == 0.0)
        lon = arctangent_of_neighbours(jnp.where(at_pole, 0.0, y), jnp.where(at_pole, 1.0, x))
        lat = arctangent_of_neighbours(z, safe_sqrt(x * x + y * y))
        return self._from_reference(lon, lat - lat0)

    def normal(self, rowcol: RowCol) -> Vector3:
        lon, lat = self.lonlat0 + jnp.stack(times(self.step, rowcol - self.rowcol0))
        cos_lat = jnp.cos(lat)
        return jnp.stack([cos_lat * jnp.cos(lon), cos_lat * jnp.sin(lon), jnp.sin(lat)])

    def lonlat_at(self, rowcol: np.ndarray) -> np.ndarray:
        """Longitudes and latitudes (n, 2) in rad at places (n, 2), on the host."""
        return np.asarray(self.lonlat0) + (rowcol - np.asarray(self.rowcol0)) @ np.asarray(self.step).T

    def places_of(self, lonlat: np.ndarray) -> np.ndarray:
        """Places (n, 2) of longitudes and latitudes (n, 2) in rad, on the host."""
        offset = lonlat - np.asarray(self.lonlat0)
        offset[:, 0] = np.remainder(offset[:, 0] + np.pi, 2.0 * np.pi) - np.pi
        return np.asarray(self.rowcol0) + offset @ np.linalg.inv(np.asarray(self.step)).T


class TransverseMercatorGrid(AbstractGrid):
    """Rows and columns affine in a transverse Mercator map (UTM, Gauss-Krueger, Lo, custom), by Krueger's series.

    `easting_northing0` in m at `rowcol0`; `step` is d(easting, northing) / d(row, col) in m. Latitude and longitude of
    the projection's datum are taken as WGS 84; where they differ by more than 0.1 mm, use `FittedGrid`.
    """

    rowcol0: Pair
    easting_northing0: Pair
    step: Step
    projection: TransverseMercator

    @classmethod
    def from_affine(
        cls, projection: TransverseMercator, affine: Sequence[float | int], shape: tuple[int, int]
    ) -> TransverseMercatorGrid:
        """From (a, b, c, d, e, f) at post centres, easting = a col + b row + c, northing = d col + e row + f in m."""
        return cls(*_centred(affine, shape, 1.0), as_float64(projection, "projection"))

    def row_and_col(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
        easting, northing = self.projection.forward_from_normal(jnp.stack([x, y, z]))
        easting0, northing0 = self.easting_northing0
        return self._from_reference(easting - easting0, northing - northing0)

    def normal(self, rowcol: RowCol) -> Vector3:
        easting, northing = self.easting_northing0 + jnp.stack(times(self.step, rowcol - self.rowcol0))
        return self.projection.inverse_normal(easting, northing)


class TangentGrid(AbstractGrid):
    """Rows and columns affine in the gnomonic plane at a point: for synthetic terrain, exact anywhere on Earth.

    `R_enu_from_ecef` rotates ECEF axes to east, north, up at the plane's centre; `plane0` is (0, 0) if the grid is
    centred there; `step` is d(x, y) / d(row, col), with x and y as tangents of the angle between normals.
    """

    rowcol0: Pair
    plane0: Pair
    step: Step
    R_enu_from_ecef: Rotation

    @classmethod
    def centred(
        cls, centre: Geodetic, *, spacing: tuple[float, float], shape: tuple[int, int], heading: float = 0.0
    ) -> TangentGrid:
        """A grid of (rows, cols) posts centred at `centre`, `spacing` m apart in row and col at the centre's height.

        Rows run south and columns east; `heading` in rad rotates the grid clockwise. The spacing is exact at the centre
        and grows outwards with the square of the distance, by 1e-6 at 6 km.
        """
        spacings, turn = jnp.asarray(spacing, jnp.float64), jnp.asarray(heading, jnp.float64)
        posts = jnp.asarray(shape, jnp.float64)
        return cls(*_centred_in_plane(checked_position(centre, "centre"), spacings, posts, turn))

    def row_and_col(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
        east, north = _plane(self.R_enu_from_ecef, x, y, z)
        east0, north0 = self.plane0
        return self._from_reference(east - east0, north - north0)

    def normal(self, rowcol: RowCol) -> Vector3:
        return _normal_of_plane(self.R_enu_from_ecef, self.plane0 + jnp.stack(times(self.step, rowcol - self.rowcol0)))


class FittedGrid(AbstractGrid):
    """Rows and columns as Chebyshev polynomials in the gnomonic plane at the grid's centre: for all other maps.

    Made by `jaxgeo.io`, which fits it to PROJ and measures its error. `plane_half` is the half width of the fitted area
    in the plane, `rowcol_half` in posts; `coefficients[i, j]` belongs to T_i(x) T_j(y), `inverse` to the inverse map,
    made consistent by one Newton step. No singularity at a pole or the date line.
    """

    rowcol0: Pair
    R_enu_from_ecef: Rotation
    plane_half: Pair
    rowcol_half: Pair
    coefficients: Num[Array, "... n n 2"]
    inverse: Num[Array, "... n n 2"]

    def row_and_col(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
        row, col = self._rowcol_of_plane(jnp.stack(_plane(self.R_enu_from_ecef, x, y, z)) / self.plane_half)
        return row, col

    def normal(self, rowcol: RowCol) -> Vector3:
        plane = chebyshev_map(self.inverse, (rowcol - self.rowcol0) / self.rowcol_half)
        slope = jax.jacfwd(self._rowcol_of_plane)(plane)
        plane = plane - jnp.stack(times(_inverse(slope), self._rowcol_of_plane(plane) - rowcol))
        return _normal_of_plane(self.R_enu_from_ecef, plane * self.plane_half)

    def _with_steps(self, factor: float) -> FittedGrid:
        return eqx.tree_at(lambda grid: grid.rowcol_half, self, jnp.asarray(self.rowcol_half) / factor)

    def _rowcol_of_plane(self, plane: Float[Array, "2"]) -> RowCol:
        return self.rowcol0 + self.rowcol_half * chebyshev_map(self.coefficients, plane)


def chebyshev_map(coefficients: Num[Array, "n n 2"], xy: Float[Array, "2"]) -> Float[Array, "2"]:
    """Two polynomials in T_i(x) T_j(y), extrapolated linearly beyond twice the fitted area [-1, 1]^2."""
    near = within(xy, -_EDGE, _EDGE)
    x, y = (_chebyshev(t, coefficients.shape[0]) for t in near)
    linear = jnp.stack([coefficients[1, 0], coefficients[0, 1]], axis=1)
    return jnp.einsum("i,j,ijk->k", x, y, coefficients) + jnp.stack(times(linear, xy - near))


@one_program
def _centred_in_plane(
    centre: Geodetic, spacing: Float[Array, "2"], shape: Float[Array, "2"], heading: Scalar
) -> tuple[Pair, Pair, Step, Rotation]:
    """Reference post, its place in the tangent plane, steps and rotation of a grid that is centred at `centre`."""
    radii = jnp.stack([WGS84.prime_vertical_radius(centre.lat), WGS84.meridian_radius(centre.lat)]) + centre.height
    c, s = jnp.cos(heading), jnp.sin(heading)
    directions = jnp.array([[-s, c], [-c, -s]])  # columns: direction of a step in row and in col, (east, north)
    return (shape - 1.0) / 2.0, jnp.zeros(2), directions * spacing[None, :] / radii[:, None], R_ecef_from_enu(centre).T


@quick_filter_jit
def _cell_size(grid: AbstractGrid, place: Float[Array, "2"]) -> Float[Array, "2"]:
    steps = jax.jacfwd(lambda rowcol: surface_point(grid.normal(rowcol)))(place)
    return jnp.sqrt(jnp.sum(steps**2, axis=0))


def surface_point(normal: Vector3) -> Vector3:
    """ECEF coordinates in m of the WGS 84 surface point with outward unit normal `normal`."""
    N = WGS84.a / jnp.sqrt(1.0 - WGS84.e2 * normal[2] ** 2)
    return N * normal * jnp.array([1.0, 1.0, 1.0 - WGS84.e2])


def _chebyshev(x: Float[Array, ""], count: int) -> Float[Array, " n"]:
    terms = [jnp.ones_like(x), x]
    while len(terms) < count:
        terms.append(2.0 * x * terms[-1] - terms[-2])
    return jnp.stack(terms[:count])


def _plane(R_enu_from_ecef: Num[Array, "3 3"], x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    east, north, up = times(R_enu_from_ecef, (x, y, z))
    nearer = 1.0 / larger(up, _HORIZON)
    return east * nearer, north * nearer


def _normal_of_plane(R_enu_from_ecef: Num[Array, "3 3"], plane: Float[Array, "2"]) -> Vector3:
    enu = jnp.append(plane, 1.0)
    return R_enu_from_ecef.T @ (enu / jnp.sqrt(jnp.sum(enu**2)))


def _inverse(m: Float[Array, "2 2"]) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    (a, b), (c, d) = m
    shrinking = 1.0 / (a * d - b * c)
    return (d * shrinking, -b * shrinking), (-c * shrinking, a * shrinking)


def _centred(affine: Sequence[float | int], shape: tuple[int, int], unit: float) -> tuple[Array, Array, Array]:
    """(row, col) of the centre, map position there and steps; the latter two times `unit`."""
    require_x64()
    a, b, c, d, e, f = (float(x) for x in affine[:6])
    row, col = (shape[0] - 1) / 2.0, (shape[1] - 1) / 2.0
    position = (c + a * col + b * row) * unit, (f + d * col + e * row) * unit
    step = [[b * unit, a * unit], [e * unit, d * unit]]
    return jax.device_put((np.array([row, col]), np.array(position), np.array(step)))

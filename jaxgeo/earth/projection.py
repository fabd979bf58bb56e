"""Transverse Mercator (Gauss-Krueger, UTM): forward, inverse, convergence and scale by the Krueger series."""

from __future__ import annotations

import functools
import math
from dataclasses import KW_ONLY

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._checks import as_float64, check_range
from jaxgeo._numerics import safe_norm
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, ScalarLike, Vector3
from jaxgeo.earth import _krueger
from jaxgeo.earth.ellipsoid import WGS84, Ellipsoid

LATITUDE_STEPS = 4  # Newton squares an initial error of e2 / 2: three reach the last bit, the fourth is a margin


class TransverseMercator(Record):
    """A transverse Mercator map: central meridian `lon0` and latitude of origin `lat0` in rad, false origin in m.

    `k0` is the scale on the central meridian. Krueger series to the eighth order of the third flattening (Karney 2011,
    "Transverse Mercator with an accuracy of a few nanometers"): on terrestrial ellipsoids the truncation error stays
    below a nanometre to 30 degrees from the central meridian. No branches and no early termination: every derivative is
    finite at the central meridian, the equator, the poles and the date line. The two points on the equator 90 degrees
    from the central meridian lie outside the map and get large finite values without meaning.

    All methods take one point; use `jax.vmap` for many.
    """

    _: KW_ONLY
    lon0: ScalarField
    lat0: ScalarField = 0.0
    k0: ScalarField = 1.0
    false_easting: ScalarField = 0.0
    false_northing: ScalarField = 0.0
    ellipsoid: Ellipsoid = eqx.field(static=True, default=WGS84)

    @classmethod
    def utm(cls, zone: int, *, north: bool = True, ellipsoid: Ellipsoid = WGS84) -> TransverseMercator:
        """UTM of a zone 1 to 60, for the northern or southern hemisphere. Raises `ValueError` for any other zone."""
        check_range(zone, "zone", "(UTM zone number)", 1.0, 60.0)
        return cls(
            lon0=math.radians(6.0 * zone - 183.0),
            k0=0.9996,
            false_easting=500_000.0,
            false_northing=0.0 if north else 10_000_000.0,
            ellipsoid=ellipsoid,
        )

    @classmethod
    def gauss_krueger(
        cls, lon0: ScalarField, *, false_easting: ScalarField = 500_000.0, ellipsoid: Ellipsoid = WGS84
    ) -> TransverseMercator:
        """Gauss-Krueger map with the central meridian `lon0` in rad: scale 1, northing from the equator.

        Where a country prefixes the easting with a zone number, include it in `false_easting`.
        """
        return cls(lon0=lon0, false_easting=false_easting, ellipsoid=ellipsoid)

    def forward(self, lat: ScalarLike, lon: ScalarLike) -> tuple[Scalar, Scalar]:
        """(easting, northing) in m of a latitude and longitude in rad; `lon` may be off by multiples of 2 pi."""
        lat, lon, projection = as_float64((lat, lon, self), "(lat, lon, projection)")
        return projection._easting_northing(_normal(lat, lon - projection.lon0))

    def forward_from_normal(self, normal: Vector3) -> tuple[Scalar, Scalar]:
        """(easting, northing) in m of the point whose outward unit normal on the ellipsoid is `normal` (ECEF axes).

        Smooth across the date line and at the poles, unlike longitude.
        """
        normal, projection = as_float64((normal, self), "(normal, projection)")
        return projection._easting_northing(_turned(normal, -projection.lon0))

    def inverse(self, easting: ScalarLike, northing: ScalarLike) -> tuple[Scalar, Scalar]:
        """(lat, lon) in rad of a map position in m; the longitude lies in [-pi, pi], and is `lon0` at a pole."""
        easting, northing, projection = as_float64((easting, northing, self), "(easting, northing, projection)")
        x, y, z = normal = projection._turned_normal(easting, northing)
        at_pole = (x == 0.0) & (y == 0.0)
        lon = projection.lon0 + jnp.arctan2(jnp.where(at_pole, 0.0, y), jnp.where(at_pole, 1.0, x))
        turns = jnp.round(lon / (2.0 * jnp.pi))
        return jnp.arctan2(z, safe_norm(normal[:2])), lon - 2.0 * jnp.pi * turns

    def inverse_normal(self, easting: ScalarLike, northing: ScalarLike) -> Vector3:
        """The ellipsoid's outward unit normal (ECEF axes) at a map position in m; smooth everywhere."""
        easting, northing, projection = as_float64((easting, northing, self), "(easting, northing, projection)")
        return _turned(projection._turned_normal(easting, northing), projection.lon0)

    def convergence_and_scale(self, lat: ScalarLike, lon: ScalarLike) -> tuple[Scalar, Scalar]:
        """Meridian convergence in rad and point scale factor at a latitude and longitude in rad.

        The convergence is the azimuth of grid north, clockwise from true north (PROJ's `meridian_convergence`), so
        azimuth = grid bearing + convergence: positive east of the central meridian in the northern hemisphere. At a
        pole it is that of the meridian `lon`. The scale is map length over ellipsoidal length, including `k0`.
        """
        lat, lon, projection = as_float64((lat, lon, self), "(lat, lon, projection)")
        dlon = lon - projection.lon0
        normal = _normal(lat, dlon)
        x, y, z, stretch = _conformal_sphere(projection.ellipsoid, normal)
        dmap_re, dmap_im = _krueger.rectifying_slope(projection.ellipsoid, x, y, z)
        on_sphere = jnp.arctan2(z * jnp.sin(dlon), jnp.cos(dlon))
        convergence = on_sphere + jnp.arctan2(-dmap_im, dmap_re)
        W = jnp.sqrt(1.0 - projection.ellipsoid.e2 * normal[2] ** 2)
        slope = jnp.sqrt(dmap_re**2 + dmap_im**2)
        radius = _krueger.rectifying_radius(projection.ellipsoid) / projection.ellipsoid.a
        return convergence, projection.k0 * radius * slope * W / (stretch * jnp.sqrt(x**2 + z**2))

    def _easting_northing(self, normal: Vector3) -> tuple[Scalar, Scalar]:
        """Map position of a normal rotated so that the central meridian has y = 0."""
        x, y, z, _ = _conformal_sphere(self.ellipsoid, normal)
        xi, eta = _krueger.map_from_sphere(self.ellipsoid, x, y, z)
        metres = self.k0 * _krueger.rectifying_radius(self.ellipsoid)
        return self.false_easting + metres * eta, self.false_northing + metres * (xi - self._xi_of_origin())

    def _turned_normal(self, easting: Scalar, northing: Scalar) -> Vector3:
        metres = self.k0 * _krueger.rectifying_radius(self.ellipsoid)
        xi = (northing - self.false_northing) / metres + self._xi_of_origin()
        eta = (easting - self.false_easting) / metres
        return _normal_from_conformal(self.ellipsoid, *_krueger.sphere_from_map(self.ellipsoid, xi, eta))

    def _xi_of_origin(self) -> Scalar:
        x, _, z, _ = _conformal_sphere(self.ellipsoid, _normal(self.lat0, jnp.zeros_like(self.lat0)))
        return _krueger.meridian_from_sphere(self.ellipsoid, jnp.arctan2(z, x))


def _normal(lat: Scalar, dlon: Scalar) -> Vector3:
    cos_lat = jnp.cos(lat)
    return jnp.stack([cos_lat * jnp.cos(dlon), cos_lat * jnp.sin(dlon), jnp.sin(lat)])


def _turned(normal: Vector3, angle: Scalar) -> Vector3:
    x, y, z = normal
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * x - s * y, s * x + c * y, z])


def _conformal_sphere(ellipsoid: Ellipsoid, normal: Vector3) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Unit vector on the conformal sphere and cos(lat) / cos(conformal latitude).

    With sinh and cosh of sigma = e atanh(e sin lat), the vector (x, y, z cosh - sinh) has length cosh - z sinh. It
    avoids the tangent, so nothing is singular at a pole.
    """
    x, y, z = normal
    sigma = _sigma(ellipsoid, z)
    sinh, cosh = jnp.sinh(sigma), jnp.cosh(sigma)
    stretch = cosh - z * sinh
    return x / stretch, y / stretch, (z * cosh - sinh) / stretch, stretch


def _normal_from_conformal(ellipsoid: Ellipsoid, x: Scalar, y: Scalar, z: Scalar) -> Vector3:
    """Inverse of `_conformal_sphere`."""
    s = _sin_lat(ellipsoid, z)
    stretch = _stretch(ellipsoid, s)
    return jnp.stack([x * stretch, y * stretch, s])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sin_lat(ellipsoid: Ellipsoid, z: Scalar) -> Scalar:
    """sin(lat) from z = sin(conformal latitude): Newton on s = (z + T(s)) / (1 + z T(s)), T = tanh(e atanh(e s))."""
    e2 = ellipsoid.e2
    s = z
    for _ in range(LATITUDE_STEPS):
        T = jnp.tanh(_sigma(ellipsoid, s))
        image = (z + T) / (1.0 + z * T)
        slope = (1.0 - image**2) * e2 / (1.0 - e2 * s**2)
        s = s + (image - s) / (1.0 - slope)
    return s


@_sin_lat.defjvp
def _(ellipsoid, primals, tangents):
    s = _sin_lat(ellipsoid, *primals)
    slope = _stretch(ellipsoid, s) ** 2 * (1.0 - ellipsoid.e2 * s**2) / (1.0 - ellipsoid.e2)
    return s, slope * tangents[0]


def _stretch(ellipsoid: Ellipsoid, sin_lat: Scalar) -> Scalar:
    """cos(lat) / cos(conformal latitude), finite at a pole."""
    sigma = _sigma(ellipsoid, sin_lat)
    return jnp.cosh(sigma) - sin_lat * jnp.sinh(sigma)


def _sigma(ellipsoid: Ellipsoid, sin_lat: Scalar) -> Scalar:
    e = math.sqrt(ellipsoid.e2)
    return e * jnp.arctanh(e * sin_lat)

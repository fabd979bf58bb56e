"""Krueger series between the transverse Mercator map of the conformal sphere and that of the ellipsoid.

The complex map coordinate is xi + i eta (northing and easting over the rectifying radius). Coefficients to the eighth
order of the third flattening n: Karney (2011), "Transverse Mercator with an accuracy of a few nanometers", Eqs 14, 35
and 36; recomputed from their defining integrals in exact rationals.
"""

from __future__ import annotations

import functools
from typing import TypeAlias

import jax
import jax.numpy as jnp

from jaxgeo._typing import Scalar
from jaxgeo.earth.ellipsoid import Ellipsoid

_Complex: TypeAlias = tuple[Scalar, Scalar]

# fmt: off
# Row j holds the factors of n^j, n^(j+1), ..., n^8 in the coefficient of sin 2j.
ALPHA = (
    (1/2, -2/3, 5/16, 41/180, -127/288, 7891/37800, 72161/387072, -18975107/50803200),
    (13/48, -3/5, 557/1440, 281/630, -1983433/1935360, 13769/28800, 148003883/174182400),
    (61/240, -103/140, 15061/26880, 167603/181440, -67102379/29030400, 79682431/79833600),
    (49561/161280, -179/168, 6601661/7257600, 97445/49896, -40176129013/7664025600),
    (34729/80640, -3418889/1995840, 14644087/9123840, 2605413599/622702080),
    (212378941/319334400, -30705481/10378368, 175214326799/58118860800),
    (1522256789/1383782400, -16759934899/3113510400),
    (1424729850961/743921418240,),
)
BETA = (
    (1/2, -2/3, 37/96, -1/360, -81/512, 96199/604800, -5406467/38707200, 7944359/67737600),
    (1/48, 1/15, -437/1440, 46/105, -1118711/3870720, 51841/1209600, 24749483/348364800),
    (17/480, -37/840, -209/4480, 5569/90720, 9261899/58060800, -6457463/17740800),
    (4397/161280, -11/504, -830251/7257600, 466511/2494800, 324154477/7664025600),
    (4583/161280, -108847/3991680, -8005831/63866880, 22894433/124540416),
    (20648693/638668800, -16363163/518918400, -2204645983/12915302400),
    (219941297/5535129600, -497323811/12454041600),
    (191773887257/3719607091200,),
)
# fmt: on


def rectifying_radius(ellipsoid: Ellipsoid) -> float:
    """Rectifying radius in m: radius of the circle with the circumference of a meridian ellipse."""
    n2 = ellipsoid.n**2
    series = 1.0 + n2 * (1 / 4 + n2 * (1 / 64 + n2 * (1 / 256 + n2 * 25 / 16384)))
    return ellipsoid.a / (1.0 + ellipsoid.n) * series


def map_from_sphere(ellipsoid: Ellipsoid, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    """(xi, eta) on the ellipsoid's map from a unit vector on the conformal sphere; y = 0 on the central meridian."""
    xi, eta = _spherical_map(x, y, z)
    d_xi, d_eta = _sine_sum(_coefficients(ALPHA, ellipsoid.n), xi, eta)
    return xi + d_xi, eta + d_eta


def meridian_from_sphere(ellipsoid: Ellipsoid, xi: Scalar) -> Scalar:
    """xi on the ellipsoid's central meridian from a conformal latitude in rad."""
    orders = 2.0 * jnp.arange(1.0, len(ALPHA) + 1.0)
    return xi + jnp.dot(jnp.array(_coefficients(ALPHA, ellipsoid.n)), jnp.sin(orders * xi))


def sphere_from_map(ellipsoid: Ellipsoid, xi: Scalar, eta: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Unit vector on the conformal sphere from (xi, eta) on the map of the ellipsoid."""
    d_xi, d_eta = _sine_sum(_coefficients(BETA, ellipsoid.n), xi, eta)
    xi, eta = xi - d_xi, eta - d_eta
    cosh = jnp.cosh(eta)
    return jnp.cos(xi) / cosh, jnp.tanh(eta), jnp.sin(xi) / cosh


def rectifying_slope(ellipsoid: Ellipsoid, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    """d(map of the ellipsoid) / d(map of the sphere) at a unit vector, real and imaginary part."""
    re, im = _cosine_sum(_times_order(_coefficients(ALPHA, ellipsoid.n)), *_spherical_map(x, y, z))
    return 1.0 + re, im


def _spherical_map(x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    """Transverse Mercator of the sphere; the two points at infinity are shifted so that results stay finite."""
    outside = x**2 + z**2 < 1e-8
    x = jnp.where(outside, 1e-4, x)
    return jnp.arctan2(z, x), jnp.arcsinh(y / jnp.sqrt(x**2 + z**2))


def _coefficients(table: tuple[tuple[float, ...], ...], n: float) -> tuple[float, ...]:
    return tuple(sum(c * n ** (j + k) for k, c in enumerate(row)) for j, row in enumerate(table, start=1))


def _times_order(coefficients: tuple[float, ...], sign: float = 1.0) -> tuple[float, ...]:
    return tuple(sign * 2.0 * j * c for j, c in enumerate(coefficients, start=1))


# Each sum is the derivative of the other, so the Clenshaw recurrence is never differentiated.


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sine_sum(coefficients: tuple[float, ...], xi: Scalar, eta: Scalar) -> tuple[Scalar, Scalar]:
    """Real and imaginary part of sum c_j sin(2 j (xi + i eta))."""
    (sin, _), b1, _ = _clenshaw(coefficients, xi, eta)
    return _product(sin, b1)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _cosine_sum(coefficients: tuple[float, ...], xi: Scalar, eta: Scalar) -> tuple[Scalar, Scalar]:
    """Real and imaginary part of sum c_j cos(2 j (xi + i eta)), j from 1."""
    (_, cos), b1, b2 = _clenshaw(coefficients, xi, eta)
    re, im = _product(cos, b1)
    return re - b2[0], im - b2[1]


@_sine_sum.defjvp
def _(coefficients, primals, tangents):
    slope = _cosine_sum(_times_order(coefficients), *primals)
    return _sine_sum(coefficients, *primals), _product(slope, tangents)


@_cosine_sum.defjvp
def _(coefficients, primals, tangents):
    slope = _sine_sum(_times_order(coefficients, -1.0), *primals)
    return _cosine_sum(coefficients, *primals), _product(slope, tangents)


def _clenshaw(
    coefficients: tuple[float, ...], xi: Scalar, eta: Scalar
) -> tuple[tuple[_Complex, _Complex], _Complex, _Complex]:
    """Sine and cosine of 2 (xi + i eta) and the last two terms of b_j = c_j + 2 cos b_(j+1) - b_(j+2)."""
    sin_xi, cos_xi, sinh_eta, cosh_eta = jnp.sin(2.0 * xi), jnp.cos(2.0 * xi), jnp.sinh(2.0 * eta), jnp.cosh(2.0 * eta)
    sin, cos = (sin_xi * cosh_eta, cos_xi * sinh_eta), (cos_xi * cosh_eta, -sin_xi * sinh_eta)
    zero = jnp.zeros_like(xi)
    b1, b2 = (zero, zero), (zero, zero)
    for c in reversed(coefficients):
        re, im = _product(cos, b1)
        b1, b2 = (c + 2.0 * re - b2[0], 2.0 * im - b2[1]), b1
    return (sin, cos), b1, b2


def _product(a: _Complex, b: _Complex) -> _Complex:
    """Product of two complex numbers as pairs."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

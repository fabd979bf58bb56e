"""Ellipsoid: geodetic and ECEF coordinates, radii of curvature, intersection of a ray with a constant height."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._checks import as_float64
from jaxgeo._compile import one_program
from jaxgeo._elementary import arctangent
from jaxgeo._numerics import dot, implicit_root, larger, safe_norm, safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar, Vector3
from jaxgeo.earth.geodetic import Geodetic, checked_position

BOWRING_STEPS = 2  # exact to the last bit on WGS 84 from -10 km to 100 000 km
BOWRING_STEPS_IF_FLAT = 6  # for a flattening above 0.01; four are exact to the last bit at 0.3
CLOSE_ENOUGH = 1e-7  # m of height before the last Newton step, which squares it; a tighter bound is below rounding


class Ellipsoid(Record):
    """An oblate ellipsoid of revolution (or a sphere): semi-major axis `a` in m and flattening `f`.

    >>> point = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
    >>> p_ecef = jaxgeo.WGS84.to_ecef(point)
    >>> print(np.round(p_ecef, 3))
    [4278026.393  831564.093 4642203.601]
    >>> print(*np.round(jaxgeo.WGS84.to_geodetic(p_ecef).to_degrees(), 6))
    47.0 11.0 600.0
    """

    a: float = eqx.field(static=True)
    f: float = eqx.field(static=True)

    @property
    def b(self) -> float:
        """Semi-minor axis, m."""
        return self.a * (1.0 - self.f)

    @property
    def e2(self) -> float:
        """First eccentricity squared."""
        return self.f * (2.0 - self.f)

    @property
    def n(self) -> float:
        """Third flattening."""
        return self.f / (2.0 - self.f)

    def to_ecef(self, position: Geodetic) -> Vector3:
        """ECEF coordinates in m of a geodetic position on this ellipsoid."""
        return _ecef(self, checked_position(position, "position"))

    def to_geodetic(self, p_ecef: Vector3) -> Geodetic:
        """Geodetic position of ECEF coordinates in m.

        A fixed number of Bowring steps and analytic derivatives: full precision from -10 to 1000 km and beyond, finite
        derivatives everywhere, including the poles and the date line. At a pole the longitude and its derivative are 0.
        """
        return _geodetic(self, as_float64(p_ecef, "p_ecef"))

    def normal_and_height(self, p_ecef: Vector3) -> tuple[Vector3, Scalar]:
        """Outward unit normal of the ellipsoid (local up) at an ECEF point, and the height of the point in m.

        Unlike latitude and longitude, both are smooth at the poles and across the date line.
        """
        return _normal_vector_and_height(self, p_ecef)

    def normal_and_height_of(self, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """`normal_and_height` by components; for batches, building and unpacking vectors of three is slow."""
        return _normal_and_height(self, x, y, z)

    def with_normal(self, normal: Sequence[Scalar], height: Scalar) -> Geodetic:
        """Geodetic position by its unit normal (ECEF axes, by components), of length 1, and height in m."""
        x, y, z = normal
        at_pole = (x == 0.0) & (y == 0.0)
        lon = arctangent(jnp.where(at_pole, 0.0, y), jnp.where(at_pole, 1.0, x))
        return Geodetic(lat=arctangent(z, safe_norm((x, y))), lon=lon, height=height)

    def prime_vertical_radius(self, lat: Scalar) -> Scalar:
        """Radius of curvature N in the prime vertical, m."""
        return self.a / jnp.sqrt(1.0 - self.e2 * jnp.sin(lat) ** 2)

    def meridian_radius(self, lat: Scalar) -> Scalar:
        """Radius of curvature M in the meridian, m."""
        return self.a * (1.0 - self.e2) / (1.0 - self.e2 * jnp.sin(lat) ** 2) ** 1.5

    def radius_in_azimuth(self, lat: Scalar, azimuth: Scalar) -> Scalar:
        """Radius of curvature of the normal section in an azimuth (Euler's formula), m."""
        M, N = self.meridian_radius(lat), self.prime_vertical_radius(lat)
        return M * N / (N * jnp.cos(azimuth) ** 2 + M * jnp.sin(azimuth) ** 2)

    def range_to_height(self, origin: Vector3, direction: Vector3, height: Scalar) -> tuple[Scalar, Flag]:
        """Range in m to the near intersection of a ray with the surface of constant geodetic `height`.

        Exact: uses geodetic height, not an inflated ellipsoid. `origin` in ECEF m, `direction` a unit vector. The flag
        is false, and the range NaN, if the ray misses the surface or the near intersection lies behind the origin.
        """
        near, _, meets = self.ranges_to_height(origin, direction, height)
        ahead = meets & (near >= 0.0)
        return jnp.where(ahead, near, jnp.nan), ahead

    def ranges_to_height(self, origin: Vector3, direction: Vector3, height: Scalar) -> tuple[Scalar, Scalar, Flag]:
        """Signed ranges in m at which a line enters and leaves the solid below a geodetic `height`, and a flag.

        The flag says whether the line meets the solid; if false, both ranges are those of the closest approach.
        """
        origin, direction, height = as_float64((origin, direction, height), "(origin, direction, height)")
        heights = jnp.stack([height, height])
        ranges, meets = self.crossings(*jax.lax.stop_gradient((origin, direction, heights)), jnp.array([-1.0, 1.0]))

        def excess(s: Scalar, world: tuple[Vector3, Vector3, Scalar]) -> Scalar:
            origin, direction, height = world
            return self.normal_and_height(origin + s * direction)[1] - height

        world = (origin, direction, height)
        near, far = (jnp.where(meets[0], implicit_root(excess, root, world), root) for root in ranges)
        return near, far, meets[0]

    def crossings(
        self, origin: Vector3, direction: Vector3, heights: Float[Array, " n"], sides: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
        """Signed ranges in m at which a line crosses surfaces of constant height, and which of them it meets at all.

        `sides` is -1 for the near crossing and +1 for the far one. For searches: the values of `ranges_to_height`
        without derivatives, vectorised.
        """
        return jax.vmap(lambda height, side: _crossing(self, origin, direction, height, side))(heights, sides)


WGS84 = Ellipsoid(a=6378137.0, f=1.0 / 298.257223563)
GRS80 = Ellipsoid(a=6378137.0, f=1.0 / 298.257222101)


@one_program
def _ecef(ellipsoid: Ellipsoid, position: Geodetic) -> Vector3:
    N = ellipsoid.prime_vertical_radius(position.lat)
    sin_lat, cos_lat = jnp.sin(position.lat), jnp.cos(position.lat)
    p = (N + position.height) * cos_lat
    z = (N * (1.0 - ellipsoid.e2) + position.height) * sin_lat
    return jnp.stack([p * jnp.cos(position.lon), p * jnp.sin(position.lon), z])


@one_program
def _geodetic(ellipsoid: Ellipsoid, p_ecef: Vector3) -> Geodetic:
    *normal, height = ellipsoid.normal_and_height_of(*p_ecef)
    return ellipsoid.with_normal(normal, height)


@one_program
def _normal_vector_and_height(ellipsoid: Ellipsoid, p_ecef: Vector3) -> tuple[Vector3, Scalar]:
    *normal, height = _normal_and_height(ellipsoid, *p_ecef)
    return jnp.stack(normal), height


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _normal_and_height(ellipsoid: Ellipsoid, x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Bowring (1976) for the reduced latitude, carried as a unit vector to avoid a division by zero at the poles."""
    a, b, e2 = ellipsoid.a, ellipsoid.b, ellipsoid.e2
    ratio = 1.0 - ellipsoid.f
    p = jnp.sqrt(x * x + y * y)
    s, c = _unit(z, ratio * p)
    for _ in range(BOWRING_STEPS if ellipsoid.f <= 0.01 else BOWRING_STEPS_IF_FLAT):
        s, c = _unit(ratio * (z + e2 / (1.0 - e2) * b * s * s * s), p - e2 * a * c * c * c)
    sin_lat, cos_lat = _unit(s, ratio * c)
    scale = cos_lat / jnp.where(p == 0.0, 1.0, p)
    height = p * cos_lat + z * sin_lat - a * jnp.sqrt(1.0 - e2 * sin_lat * sin_lat)
    return x * scale, y * scale, sin_lat, height


@_normal_and_height.defjvp
def _(ellipsoid, primals, tangents):
    """dh = n . dp; dn from the principal curvatures, written so that their difference vanishes at a pole."""
    *normal, height = _normal_and_height(ellipsoid, *primals)
    x, y, sin_lat = normal
    W2 = 1.0 - ellipsoid.e2 * sin_lat * sin_lat
    N = ellipsoid.a / jnp.sqrt(W2)
    M = N * (1.0 - ellipsoid.e2) / W2
    up = dot(normal, tangents)
    across = [moved - part * up for moved, part in zip(tangents, normal, strict=True)]
    poleward = (-sin_lat * x, -sin_lat * y, 1.0 - sin_lat * sin_lat)  # cos(lat) times north
    turn = 1.0 / (N + height)
    excess = N * ellipsoid.e2 * turn / (W2 * (M + height)) * dot(poleward, across)
    d_normal = [side * turn + excess * pole for side, pole in zip(across, poleward, strict=True)]
    return (*normal, height), (*d_normal, up)


def _unit(s: Scalar, c: Scalar) -> tuple[Scalar, Scalar]:
    length = jnp.sqrt(s * s + c * c)
    shortening = 1.0 / jnp.where(length == 0.0, 1.0, length)
    return s * shortening, c * shortening


def _crossing(
    ellipsoid: Ellipsoid, origin: Vector3, direction: Vector3, height: Scalar, side: Scalar
) -> tuple[Scalar, Flag]:
    """One crossing of a line and a surface of constant height, by Newton's method on the exact height.

    Height along a line is convex, so after at most one step the iterates approach the root monotonically from outside.
    If the line misses the surface, the range of its closest approach.
    """
    closest, half_chord, meets = _chord(ellipsoid, origin, direction, height)

    def refine(state: tuple[Scalar, Scalar, Index]) -> tuple[Scalar, Scalar, Index]:
        offset, _, count = state
        normal, h = ellipsoid.normal_and_height(origin + (closest + side * offset) * direction)
        slope = side * dot(normal, direction)
        step = jnp.where(slope > 0.0, (h - height) / jnp.where(slope > 0.0, slope, 1.0), 0.0)
        excess = jnp.where(slope > 0.0, jnp.abs(h - height), 0.0)
        return larger(offset - step, 0.0), excess, count + 1

    def unfinished(state: tuple[Scalar, Scalar, Index]) -> Flag:
        _, excess, count = state
        return meets & (excess > CLOSE_ENOUGH) & (count < 30)

    start = (half_chord, jnp.full_like(half_chord, jnp.inf), jnp.asarray(0))
    offset, _, _ = jax.lax.while_loop(unfinished, refine, start)
    return jnp.where(meets, closest + side * offset, closest), meets


def _chord(ellipsoid: Ellipsoid, origin: Vector3, direction: Vector3, height: Scalar) -> tuple[Scalar, Scalar, Flag]:
    """Range of closest approach to the surface, half the chord (initial value), and whether the line meets the surface.

    From the inflated ellipsoid (a + h, b + h), accurate to millimetres; for a line that grazes or misses, from the
    exact height.
    """
    axes = jnp.array([ellipsoid.a, ellipsoid.a, ellipsoid.b]) + height
    o, d = origin / axes, direction / axes
    dd = dot(d, d)
    inflated = -dot(o, d) / dd
    nearest = o + inflated * d
    squared = (1.0 - dot(nearest, nearest)) / dd
    grazes = squared * dd < 0.02  # less than about 64 km below the surface at its deepest, or a miss

    def normal_and_height(s: Scalar) -> tuple[Vector3, Scalar]:
        return ellipsoid.normal_and_height(origin + s * direction)

    def refine(_: Index, s: Scalar) -> Scalar:
        (normal, _), (turn, _) = jax.jvp(normal_and_height, (s,), (jnp.ones_like(s),))
        curvature = dot(turn, direction)
        return s - dot(normal, direction) / jnp.where(curvature > 0.0, curvature, 1.0)

    closest = jnp.where(grazes, jax.lax.fori_loop(0, 3, refine, inflated), inflated)
    (_, lowest), (turn, _) = jax.jvp(normal_and_height, (closest,), (jnp.ones_like(closest),))
    curvature = dot(turn, direction)
    local = 2.0 * (height - lowest) / jnp.where(curvature > 0.0, curvature, 1.0)
    half_chord = jnp.where(grazes, safe_sqrt(local), safe_sqrt(squared))
    return closest, half_chord, jnp.where(grazes, lowest <= height, squared > 0.0)

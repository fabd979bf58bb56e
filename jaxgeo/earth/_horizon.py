"""Distance and dip of the horizon, with or without refraction, and points that the Earth hides."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxgeo._checks import as_float64, check_finite, concrete
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, ScalarLike
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.refraction import MEAN_RADIUS, arc_between

VACUUM = Atmosphere(refractivity=0.0)
LOWEST = 500.0  # m below the ellipsoid: no land or sea surface is lower (Dead Sea: 420 m)
LIFT = 0.25  # share of the Earth's curvature that refraction takes back at most; 0.13 is usual


class Horizon(Record):
    """`distance` in m along the ground to the horizon, and its `dip` in rad below the observer's horizontal."""

    distance: ScalarField
    dip: ScalarField


def horizon(
    height: ScalarLike, *, ground: ScalarLike = 0.0, atmosphere: Atmosphere | None = None, radius: float = MEAN_RADIUS
) -> Horizon:
    """Horizon of smooth ground at the height `ground`, seen from `height` (m above the ellipsoid, not below `ground`).

    On a sphere of `radius` m (for one azimuth: `WGS84.radius_in_azimuth`). With an `atmosphere`, along the ray that
    grazes the ground, where n r sin z = n r (Snell on spherical shells). Differentiable in heights and atmosphere while
    `height` is above `ground`. Raises `ValueError` for concrete heights that are not finite or lie below the ground.

    >>> from jaxgeo.earth._horizon import horizon
    >>> bare, in_air = horizon(3000.0), horizon(3000.0, atmosphere=jaxgeo.Atmosphere())
    >>> print(f"{bare.distance / 1000:.0f} km, through the air {in_air.distance / 1000:.0f} km")
    195 km, through the air 214 km
    """
    check_finite(height, "height", "m above the ellipsoid")
    check_finite(ground, "ground", "m above the ellipsoid")
    high, low = as_float64((height, ground), "horizon")
    _check_above(high, low)
    air = as_float64(VACUUM if atmosphere is None else atmosphere, "atmosphere")
    constant = air.refractive_index(low) * (radius + low)
    thinner = air.refractivity * (air.density(high) - air.density(low))
    more = air.refractive_index(high) * (high - low) + thinner * (radius + low)  # change in n r, no cancellation
    dip = jnp.arctan2(safe_sqrt(more * (2.0 * constant + more)), constant)
    above = high > low
    level = jnp.zeros_like(constant)
    distance = arc_between(air, level, low=low, high=jnp.where(above, high, low + 1.0), radius=radius)
    return Horizon(jnp.where(above, distance, 0.0), dip)


def sight_range(
    height: ScalarLike,
    target_height: ScalarLike,
    *,
    ground: ScalarLike = 0.0,
    atmosphere: Atmosphere | None = None,
    radius: float = MEAN_RADIUS,
) -> Scalar:
    """Distance in m along smooth ground at which a target at `target_height` appears above the horizon of `height`.

    All heights in m above the ellipsoid; the sum of both horizon distances. Raises as `horizon`.

    >>> from jaxgeo.earth._horizon import sight_range
    >>> print(f"a mast of 200 m comes up over the horizon of 3 km at {sight_range(3000.0, 200.0) / 1000:.0f} km")
    a mast of 200 m comes up over the horizon of 3 km at 246 km
    """
    here, there = (horizon(h, ground=ground, atmosphere=atmosphere, radius=radius) for h in (height, target_height))
    return here.distance + there.distance


def hidden_by_earth(origin: Any, p_ecef: Any, xp: Any = jnp) -> Any:
    """Whether the Earth lies between an origin and a point (3,), ECEF m, whatever terrain and refraction there may be.

    So it is where the straight line comes more than 500 m, and what refraction can lift it, below the ellipsoid, or
    below the lower of its ends if that is deeper. False for numbers that are not finite. By NumPy with `xp=numpy`.
    """
    semi = xp.asarray([WGS84.a, WGS84.a, WGS84.b])
    start, end = origin / semi, p_ecef / semi  # lowest where the line is nearest to the centre of the unit sphere
    along = end - start
    squared = xp.sum(along * along)
    share = xp.clip(-xp.sum(start * along) / xp.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    lowest, *ends = (xp.sqrt(xp.sum(x * x)) for x in (start + share * along, start, end))
    depth = WGS84.a * (xp.minimum(1.0, xp.minimum(*ends)) - lowest)
    return depth > LOWEST + LIFT * WGS84.a * squared / 8.0


def _check_above(high: Scalar, low: Scalar) -> None:
    known_high, known_low = concrete(high), concrete(low)
    if known_high is not None and known_low is not None and (known_high < known_low).any():
        raise ValueError(f"no height may lie below the ground at {float(known_low):g} m; got {float(known_high):g} m.")

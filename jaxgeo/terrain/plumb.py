"""Heights of any terrain by plumb-line intersection."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._numerics import tree_where
from jaxgeo._typing import Scalar
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.geodetic import Geodetic, checked_position
from jaxgeo.earth.ray import Ray
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain.interface import AbstractTerrain
from jaxgeo.terrain.polish import polish
from jaxgeo.terrain.search.first_hit import FirstHit

ABOVE_ALL = 20_000.0  # m above the ellipsoid: higher than any ground


def height_by_plumb_line(terrain: AbstractTerrain, position: Geodetic) -> Scalar:
    """Height in m at which a plumb line from above meets the terrain; NaN without a hit.

    Differentiable in the position and the terrain, as a hit is.
    """
    position = checked_position(position, "position")
    is_place = jnp.isfinite(position.lat) & jnp.isfinite(position.lon)
    terrain, is_sound = terrain.made_safe()
    lat, lon = (jnp.where(is_place, angle, 0.0) for angle in (position.lat, position.lon))
    above = Geodetic(lat=lat, lon=lon, height=jnp.full_like(lat, ABOVE_ALL))
    ray, stand_in = Ray(WGS84.to_ecef(above), -R_ecef_from_enu(above)[:, 2]), terrain.safe_ray()
    searched = terrain.bracket(ray, FirstHit())
    found = is_place & is_sound & counts_as_fix(searched.status)
    bracket = tree_where(found, searched, jax.tree.map(jnp.zeros_like, searched))
    distance = polish(tree_where(found, ray, stand_in), terrain, bracket)
    return jnp.where(found, ABOVE_ALL - distance, jnp.nan)

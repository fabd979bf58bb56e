"""Where a lens is looked at to see whether it folds between the centre and a point."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import safe_norm
from jaxgeo.sensor._newton import PlanePoint

FIELD_SAMPLES = 32  # along the segment from the centre, at equal steps of the angle off the axis


def segment(end: PlanePoint) -> Float[Array, "samples 2"]:
    """Points from the centre to `end`, at equal steps of the angle off the axis, so that a far end hides no fold."""
    radius = safe_norm(end)
    fractions = jnp.linspace(0.0, 1.0, FIELD_SAMPLES + 1)[1:]
    radii = jnp.tan(fractions * jnp.arctan(radius)).at[-1].set(radius)
    return radii[:, None] * (end / jnp.where(radius == 0.0, 1.0, radius))[None, :]

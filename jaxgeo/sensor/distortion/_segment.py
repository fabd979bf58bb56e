"""Sample points between the image centre and a point, to detect folds of a lens model."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import safe_norm
from jaxgeo.sensor._newton import PlanePoint

FIELD_SAMPLES = 32  # along the segment from the centre, at equal steps of the off-axis angle


def segment(end: PlanePoint) -> Float[Array, "samples 2"]:
    """Points from the centre to `end` at equal steps of the off-axis angle, so that folds near the centre are sampled
    even for a far end."""
    radius = safe_norm(end)
    fractions = jnp.linspace(0.0, 1.0, FIELD_SAMPLES + 1)[1:]
    radii = jnp.tan(fractions * jnp.arctan(radius)).at[-1].set(radius)
    return radii[:, None] * (end / jnp.where(radius == 0.0, 1.0, radius))[None, :]

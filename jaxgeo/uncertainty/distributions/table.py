"""Quantile function as a table of polynomials over standard normal numbers, for distributions without a formula."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._typing import Numbers

EDGE = 8.5  # draws of standard normal numbers lie within; beyond, the table is constant


def nodes(parts: int) -> np.ndarray:
    """Standard normal numbers at which a table is exact."""
    return np.linspace(-EDGE, EDGE, parts + 1)


def polynomials(value: Any, slope: Any, curvature: Any) -> Any:
    """Coefficients (parts, 6), lowest power first, that take given values and two derivatives at both ends of a part.

    Quintic Hermite interpolation, continuous to the second derivative.
    """
    step = 2.0 * EDGE / (len(value) - 1)
    v, s, c = value, step * slope, step**2 * curvature
    rise = v[1:] - v[:-1] - s[:-1] - 0.5 * c[:-1]
    turn, bend = s[1:] - s[:-1] - c[:-1], c[1:] - c[:-1]
    cubic = 10.0 * rise - 4.0 * turn + 0.5 * bend
    quartic = -15.0 * rise + 7.0 * turn - bend
    quintic = 6.0 * rise - 3.0 * turn + 0.5 * bend
    stack = np.stack if isinstance(value, np.ndarray) else jnp.stack
    return stack([v[:-1], s[:-1], 0.5 * c[:-1], cubic, quartic, quintic], axis=-1)


def interpolate(table: Float[Array, "parts 6"], normal: Numbers) -> Numbers:
    """Value of the table at standard normal numbers, elementwise."""
    parts = table.shape[0]
    place = (jnp.clip(normal, -EDGE, EDGE) + EDGE) * (parts / (2.0 * EDGE))
    part = jnp.clip(jnp.floor(place), 0, parts - 1)
    x, powers = place - part, table[part.astype(jnp.int32)]
    value = powers[..., 5]
    for power in range(4, -1, -1):
        value = value * x + powers[..., power]
    return value

"""Local normalisation of brightness and contrast before matching."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

LEAST = 0.1  # of the standard deviation of the whole image: lower bound, so that flat areas are not amplified


def remove_illumination(image: Any, known: Any, width: int = 25) -> Float[Array, "rows cols"]:
    """Grey values less their local mean, divided by the local standard deviation; zero where unknown.

    `image` (rows, cols), `known` the same shape; mean and deviation are over the known cells of a square of `width`
    cells. A tenth of the whole image's deviation is added in quadrature, so that flat areas stay flat. Raises
    `ValueError` for shapes that do not fit and a width that is even or under 3.
    """
    image, known = np.asarray(image, np.float64), np.asarray(known, bool)
    if image.ndim != 2 or image.shape != known.shape:
        raise ValueError(f"image and known must be (rows, cols) and alike; got {image.shape} and {known.shape}.")
    if width < 3 or width % 2 == 0:
        raise ValueError(f"width must be an odd number of cells, 3 or more; got {width}.")
    return _flattened(jnp.asarray(image), jnp.asarray(known), width)


@partial(jax.jit, static_argnums=2)
def _flattened(
    image: Float[Array, "rows cols"], known: Bool[Array, "rows cols"], width: int
) -> Float[Array, "rows cols"]:
    count = jnp.maximum(jnp.sum(known), 1)
    values = jnp.where(known, image, 0.0)
    values = jnp.where(known, values - jnp.sum(values) / count, 0.0)
    whole = jnp.sum(values**2) / count
    cells = jnp.maximum(_box(known.astype(float), width), 1.0)
    mean = _box(values, width) / cells
    variance = jnp.maximum(_box(values**2, width) / cells - mean**2, 0.0) + LEAST**2 * whole
    return jnp.where(known, (values - mean) / jnp.sqrt(jnp.where(variance > 0.0, variance, 1.0)), 0.0)


def _box(values: Float[Array, "rows cols"], width: int) -> Float[Array, "rows cols"]:
    """Box sums about each cell, zero beyond the edges."""
    for window in ((width, 1), (1, width)):
        values = jax.lax.reduce_window(values, 0.0, jax.lax.add, window, (1, 1), "SAME")
    return values

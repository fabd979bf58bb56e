"""First and second derivatives of a function at zero, and the differences that they must equal, in one program."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp


class Derivatives(NamedTuple):
    """Forward, reverse and second derivatives, and differences of values and of first derivatives."""

    forward: jax.Array
    reverse: jax.Array
    second: jax.Array
    differences: jax.Array
    second_differences: jax.Array


def derivatives_at_zero(f: Callable[[jax.Array], jax.Array], size: int, step: float) -> Derivatives:
    """Derivatives of `f` by each of `size` numbers at zero; differences are central, of fourth order, for a step."""
    forward, differences, second_differences = _with_differences(f, size, step)
    second, reverse = jax.jacfwd(lambda x: (jax.jacrev(f)(x),) * 2, has_aux=True)(jnp.zeros(size))
    return Derivatives(forward, reverse, second, differences, second_differences)


def first_derivatives_at_zero(
    f: Callable[[jax.Array], jax.Array], size: int, step: float
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """(forward, reverse, differences of values, differences of forward derivatives)."""
    forward, *differences = _with_differences(f, size, step)
    return forward, jax.jacrev(f)(jnp.zeros(size)), *differences


def _with_differences(
    f: Callable[[jax.Array], jax.Array], size: int, step: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """(forward, differences of values, differences of forward derivatives)."""
    stencil = step * jnp.array([-2.0, -1.0, 1.0, 2.0])
    shifts = (stencil[:, None, None] * jnp.eye(size)[None]).reshape(-1, size)
    with_value = jax.jacfwd(lambda x: (f(x),) * 2, has_aux=True)
    slopes, values = jax.vmap(with_value)(jnp.concatenate([jnp.zeros((1, size)), shifts]))

    def central(x: jax.Array) -> jax.Array:
        x = x[1:].reshape(4, size, *x.shape[1:])
        change = jnp.tensordot(jnp.array([1.0, -8.0, 8.0, -1.0]), x, 1)
        return jnp.moveaxis(change, 0, -1) / (12.0 * step)

    return slopes[0], central(values), central(slopes)

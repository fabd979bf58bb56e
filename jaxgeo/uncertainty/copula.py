"""Gaussian copula: correlation of normal numbers that gives errors of any distribution a stated correlation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import one_program
from jaxgeo._numerics import covariance_root
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.distributions import AbstractDistribution

Shape: TypeAlias = AbstractDistribution | None  # None: normal
Square: TypeAlias = Float[Array, "axes axes"]
Expansion: TypeAlias = Float[Array, "axes terms"]

TERMS = 64  # of the expansion in Hermite polynomials; the rest counts as one more term
NODES = np.linspace(-8.5, 8.5, 2049)
DENSITY = np.exp(-0.5 * NODES**2) / math.sqrt(2.0 * math.pi) * (NODES[1] - NODES[0])
HALVINGS = 50


@one_program
def normal_correlation(correlation: Square, shapes: Sequence[Shape]) -> tuple[Square, Square, Square]:
    """(correlation of the normal numbers, least and largest reachable correlation of the errors).

    Errors q_i(z_i), q_j(z_j) of normal numbers with correlation r have the correlation sum_k c_ik c_jk r^k, with c the
    coefficients of q in normalised Hermite polynomials (Liu and Der Kiureghian 1986, "Multivariate distribution models
    with prescribed marginals and covariances"). It increases with r, and is solved by bisection. To 2e-4; to 1e-9
    between a normal axis and another one, and for smooth quantile functions.
    """
    terms = jnp.stack([_expansion(shape) for shape in shapes])
    both = terms[:, None, :] * terms[None, :, :]

    def of_errors(r: Square) -> Square:
        value = jnp.zeros_like(r)
        for term in range(TERMS, -1, -1):
            value = (value + both[:, :, term]) * r
        return value

    def halve(_: Any, ends: tuple[Square, Square]) -> tuple[Square, Square]:
        middle = 0.5 * (ends[0] + ends[1])
        is_low = of_errors(middle) < correlation
        return jnp.where(is_low, middle, ends[0]), jnp.where(is_low, ends[1], middle)

    whole = jnp.ones_like(correlation)
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, (-whole, whole))
    found = jnp.where(jnp.eye(len(shapes)) > 0.0, 1.0, 0.5 * (low + high))
    return found, of_errors(-whole), of_errors(whole)


def root_of_correlation(correlation: Square) -> Square:
    """L with rows of unit length and L L' close to a correlation; equal to it if that is positive semi-definite."""
    root = covariance_root(correlation)
    return root / jnp.sqrt(jnp.sum(root**2, axis=1))[:, None]


def _expansion(shape: Shape) -> Numbers:
    """Coefficients (terms + 1,) of a quantile function in normalised Hermite polynomials of orders 1 and up."""
    if shape is None:
        return jnp.zeros(TERMS + 1).at[0].set(1.0)
    nodes, density = jnp.asarray(NODES), jnp.asarray(DENSITY)
    values = shape.prepared().standardised(nodes)
    values = values - jnp.sum(density * values)
    values = values / jnp.sqrt(jnp.sum(density * values**2))

    def next_order(state: tuple[Numbers, Numbers], order: Numbers) -> tuple[tuple[Numbers, Numbers], Numbers]:
        before, here = state
        after = (nodes * here - jnp.sqrt(order - 1.0) * before) / jnp.sqrt(order)
        return (here, after), jnp.sum(density * values * after)

    start = jnp.zeros_like(nodes), jnp.ones_like(nodes)
    _, terms = jax.lax.scan(next_order, start, jnp.arange(1.0, TERMS + 1.0))
    rest = jnp.maximum(1.0 - jnp.sum(terms**2), 0.0)
    return jnp.append(terms, jnp.sqrt(rest))

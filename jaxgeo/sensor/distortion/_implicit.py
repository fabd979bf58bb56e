"""Derivatives of a lens's inverse by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
from jaxtyping import Array, Float

from jaxgeo.sensor._newton import PlanePoint, solve_2d

Lens = TypeVar("Lens")


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def inverse_at(
    formula: Callable[[Lens, PlanePoint], PlanePoint],
    jacobian: Callable[[Lens, PlanePoint], Float[Array, "2 2"]],
    lens: Lens,
    target: PlanePoint,
    root: PlanePoint,
) -> PlanePoint:
    """`root`, which the formula of `lens` maps to `target`, with its derivatives of every order.

    `formula` and its `jacobian` must not close over traced values.
    """
    return root


@inverse_at.defjvp
def _(formula, jacobian, primals, tangents):
    """d root = J^-1 (d target - d lens (root)); `root` itself is differentiated again at higher order."""
    lens, target, root = primals
    d_lens, d_target, _ = tangents
    root = inverse_at(formula, jacobian, lens, target, root)
    _, d_by_lens = jax.jvp(lambda lens: formula(lens, root), (lens,), (d_lens,))
    return root, solve_2d(jacobian(lens, root), d_target - d_by_lens)

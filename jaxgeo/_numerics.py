"""Small numerical tools that are safe to differentiate."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._typing import Flag, Scalar

T = TypeVar("T")


def dot(a: Any, b: Any) -> Scalar:
    """Scalar product of two short vectors, term by term.

    A batch of small `dot_general`s would be neither fused with its neighbours nor the same to the last bit for every
    batch size.
    """
    first, *others = zip(a, b, strict=True)
    total = first[0] * first[1]
    for x, y in others:
        total = total + x * y
    return total


def times(matrix: Any, vector: Any) -> tuple[Scalar, ...]:
    """Product of a small matrix (rows) and a short vector, component by component (see `dot`)."""
    return tuple(dot(row, vector) for row in matrix)


def matrix(rows: Any) -> Float[Array, "rows cols"]:
    """A small matrix from its entries, row by row.

    Stacked so, it is only a name for its entries: what takes it apart again gets them without its being made, which
    for a crowd takes several times as long as what is done with it.
    """
    return jnp.stack([jnp.stack(row) for row in rows])


def matmul3(A: Float[Array, "3 3"], B: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Matrix product, as a sum of three (see `dot`)."""
    return A[:, 0:1] * B[0:1, :] + A[:, 1:2] * B[1:2, :] + A[:, 2:3] * B[2:3, :]


def matvec(R: Float[Array, "3 3"], v: Float[Array, "3"]) -> Float[Array, "3"]:
    """Matrix times vector, as a sum of three (see `dot`)."""
    return R[:, 0] * v[0] + R[:, 1] * v[1] + R[:, 2] * v[2]


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root of max(x, 0); its gradient where x <= 0 is zero, not infinite."""
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def safe_norm(v: Float[Array, " n"]) -> Scalar:
    """Length of `v`; its gradient at zero is zero, not NaN."""
    return safe_sqrt(dot(v, v))


def safe_angle(a: Float[Array, "3"], b: Float[Array, "3"]) -> Scalar:
    """Angle between two vectors in [0, pi] rad, exact for small ones too; its gradient at zero is zero."""
    return jnp.arctan2(safe_norm(jnp.stack(cross(a, b))), dot(a, b))


def cross(a: Any, b: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Vector product, component by component (see `dot`)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def value_and_slope(function: Callable[[Scalar], Scalar], x: Scalar) -> tuple[Scalar, Scalar]:
    """A scalar function and its derivative, in forward mode."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


def newton_or_half(
    low: Scalar, high: Scalar, x: Scalar, value: Scalar, slope: Scalar, slack: Scalar | float
) -> tuple[Scalar, Scalar, Scalar]:
    """The bracket and the next place on the way to a falling root, from the value and slope at `x`.

    The function is positive at `low` and negative at `high`; the next place is Newton's, or half way between them where
    that would leave them by more than `slack`. At the root itself the sign is a matter of rounding, and two kernels of
    one program need not round alike: without slack such a root would be thrown away for the middle of the bracket.
    """
    low, high = jnp.where(value > 0.0, x, low), jnp.where(value > 0.0, high, x)
    newton = x - value / jnp.where(slope < 0.0, slope, -1.0)
    stays = (slope < 0.0) & (newton >= low - slack) & (newton <= high + slack)
    return low, high, jnp.where(stays, newton, 0.5 * (low + high))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_root(residual: Callable[[Scalar, Any], Scalar], root: Scalar, world: Any) -> Scalar:
    """`root` itself, a zero of `residual(root, world)`, with the derivatives by `world` that keep it one.

    Of every order, forward and reverse. `residual` must close over nothing that is traced.
    """
    return root


@implicit_root.defjvp
def _(residual, primals, tangents):
    """d root = -d residual / slope, at a root that moves along when this is differentiated again."""
    root, world = primals
    root = implicit_root(residual, root, world)
    _, change = jax.jvp(lambda world: residual(root, world), (world,), (tangents[1],))
    _, slope = value_and_slope(lambda x: residual(x, world), root)
    return root, -change / jnp.where(slope == 0.0, 1.0, slope)


def all_finite(tree: object) -> Flag:
    """Whether every floating leaf of `tree` is finite."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if _is_float(leaf)]
    finite = jnp.asarray(True)
    for leaf in leaves:
        finite = finite & jnp.all(jnp.isfinite(leaf))
    return finite


def finite_or(tree: T, substitute: float) -> T:
    """`tree` with `substitute` for every number that is not finite, so that no NaN enters a gradient."""
    return jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, substitute) if _is_float(x) else x, tree)


def tree_where(condition: Flag, if_true: T, if_false: T) -> T:
    """Leaf by leaf `jnp.where`; both trees must be finite where gradients are taken."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), if_true, if_false)


def _is_float(leaf: object) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)  # pyright: ignore

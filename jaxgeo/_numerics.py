"""Numerical helpers with finite derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._elementary import arctangent
from jaxgeo._typing import Flag, Numbers, Scalar, ScalarField

T = TypeVar("T")
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # its multiples are spread unevenly in [0, 1)


def dot(a: Any, b: Any) -> Scalar:
    """Dot product of two short vectors, term by term.

    A batched small `dot_general` is not fused with adjacent operations, and its rounding depends on the batch size.
    """
    first, *others = zip(a, b, strict=True)
    total = first[0] * first[1]
    for x, y in others:
        total = total + x * y
    return total


def times(matrix: Any, vector: Any) -> tuple[Scalar, ...]:
    """Product of a small matrix (rows) and a short vector, by components (see `dot`)."""
    return tuple(dot(row, vector) for row in matrix)


def matrix(rows: Any) -> Float[Array, "rows cols"]:
    """A small matrix from its entries, row by row.

    The compiler sees through the stack: code that takes the matrix apart gets the entries without building it. For a
    batch, building it takes several times as long as using it.
    """
    return jnp.stack([jnp.stack(row) for row in rows])


def matmul3(A: Float[Array, "3 3"], B: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Matrix product as a sum of three terms (see `dot`)."""
    return A[:, 0:1] * B[0:1, :] + A[:, 1:2] * B[1:2, :] + A[:, 2:3] * B[2:3, :]


def matvec(R: Float[Array, "3 3"], v: Float[Array, "3"]) -> Float[Array, "3"]:
    """Matrix times vector as a sum of three terms (see `dot`)."""
    return R[:, 0] * v[0] + R[:, 1] * v[1] + R[:, 2] * v[2]


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root of max(x, 0); its gradient where x <= 0 is zero, not infinite."""
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def safe_norm(v: Any) -> Scalar:
    """Euclidean norm of a short vector `v`; its gradient at zero is zero, not NaN."""
    return safe_sqrt(dot(v, v))


def safe_angle(a: Any, b: Any) -> Scalar:
    """Angle between two vectors of three in [0, pi] rad, accurate for small angles; its gradient at zero is zero."""
    return arctangent(safe_norm(cross(a, b)), dot(a, b))


def cross(a: Any, b: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Cross product, by components (see `dot`)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def covariance_root(covariance: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """L with L L' = covariance, if that is positive semi-definite: principal axes as columns, the largest first.

    A principal axis has no sign of its own, and libraries for CPUs and GPUs return different ones: here a sum of its
    components with uneven weights is positive, so that L z is the same everywhere. Without derivatives.
    """
    values, axes = jnp.linalg.eigh(jax.lax.stop_gradient(covariance))
    weights = 1.0 + jnp.arange(1, len(values) + 1) * GOLDEN % 1.0
    signs = jnp.where(jnp.sum(weights[:, None] * axes, axis=0) < 0.0, -1.0, 1.0)
    return (axes * (signs * jnp.sqrt(jnp.maximum(values, 0.0)))[None, :])[:, ::-1]


def value_and_slope(function: Callable[[Scalar], Scalar], x: Scalar) -> tuple[Scalar, Scalar]:
    """Value and derivative of a scalar function, in forward mode."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


def newton_or_half(
    low: Scalar, high: Scalar, x: Scalar, value: Scalar, slope: Scalar, slack: Scalar | float
) -> tuple[Scalar, Scalar, Scalar]:
    """Updated bracket and next iterate towards a falling root, from the value and slope at `x`.

    The function is positive at `low` and negative at `high`. The next iterate is Newton's, or the midpoint if Newton's
    leaves the bracket by more than `slack`. At the root the sign depends on rounding, and two kernels of one program
    may round differently: without slack, such a root would be replaced by the midpoint.
    """
    low, high = jnp.where(value > 0.0, x, low), jnp.where(value > 0.0, high, x)
    newton = x - value / jnp.where(slope < 0.0, slope, -1.0)
    stays = (slope < 0.0) & (newton >= low - slack) & (newton <= high + slack)
    return low, high, jnp.where(stays, newton, 0.5 * (low + high))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_root(residual: Callable[[Scalar, Any], Scalar], root: Scalar, world: Any) -> Scalar:
    """`root`, a zero of `residual(root, world)`, with its implicit derivatives with respect to `world`.

    All orders, forward and reverse. `residual` must not close over traced values.
    """
    return root


@implicit_root.defjvp
def _(residual, primals, tangents):
    """d root = -d residual / slope; when differentiated again, the root is differentiated too."""
    root, world = primals
    root = implicit_root(residual, root, world)
    _, change = jax.jvp(lambda world: residual(root, world), (world,), (tangents[1],))
    _, slope = value_and_slope(lambda x: residual(x, world), root)
    return root, -change / jnp.where(slope == 0.0, 1.0, slope)


def all_finite(tree: object) -> Flag:
    """Whether every floating-point leaf of `tree` is finite."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if _is_float(leaf)]
    finite = jnp.asarray(True)
    for leaf in leaves:
        finite = finite & jnp.all(jnp.isfinite(leaf))
    return finite


def finite_or(tree: T, substitute: float) -> T:
    """`tree` with `substitute` for every non-finite number, so that no NaN enters a gradient."""
    return jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, substitute) if _is_float(x) else x, tree)


def tree_where(condition: Flag, if_true: T, if_false: T) -> T:
    """`jnp.where` leaf by leaf; both trees must be finite where gradients are taken."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), if_true, if_false)


def _is_float(leaf: object) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)  # pyright: ignore


# JAX differentiates `maximum`, `minimum` and `clip` by testing which argument equals the result. XLA may compute an
# argument twice, once with a fused multiply-add: then neither does, and the derivative is wrong. These compare instead.


def larger(a: ScalarField, b: ScalarField) -> Numbers:
    """The larger of two numbers or arrays, NaN if either is; differentiable."""
    a, b = jnp.asarray(a), jnp.asarray(b)
    return jnp.where((a > b) | (a != a), a, b)


def smaller(a: ScalarField, b: ScalarField) -> Numbers:
    """The smaller of two numbers or arrays, NaN if either is; differentiable."""
    a, b = jnp.asarray(a), jnp.asarray(b)
    return jnp.where((a < b) | (a != a), a, b)


def within(x: ScalarField, low: ScalarField, high: ScalarField) -> Numbers:
    """Numbers limited to an interval; differentiable."""
    return smaller(larger(x, low), high)

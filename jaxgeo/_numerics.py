"""Small numerical tools that are safe to differentiate."""

from __future__ import annotations

import math
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


def product(A: Float[Array, "3 3"], B: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Matrix product, as a sum of three (see `dot`)."""
    return A[:, 0:1] * B[0:1, :] + A[:, 1:2] * B[1:2, :] + A[:, 2:3] * B[2:3, :]


def turned(R: Float[Array, "3 3"], v: Float[Array, "3"]) -> Float[Array, "3"]:
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


# Taylor's series of sine and cosine on [-pi/4, pi/4], their coefficients shifted for the least error there (Cephes).
_SINE = (-1.66666666666666307295e-1, 8.33333333332211858878e-3, -1.98412698295895385996e-4, 2.75573136213857245213e-6,
         -2.50507477628578072866e-8, 1.58962301576546568060e-10)  # fmt: skip
_COSINE = (4.16666666666665929218e-2, -1.38888888888730564116e-3, 2.48015872888517045348e-5,
           -2.75573141792967388112e-7, 2.08757008419747316778e-9, -1.13585365213876817300e-11)  # fmt: skip
_QUARTER = (1.5707963267341256, 6.0771005063039e-11, 2.9e-21)  # pi / 2, the first two parts with zeros at their end


_TO_INTEGER = 1.5 * 2.0**52  # added to a whole number, leaves it in the last bits
_NEAR_SINE = (-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0)  # Taylor's; enough to the last digit within
_NEAR_COSINE = (-1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40320.0)
_NEAR = 1.0 / 16.0  # rad
_CROWD = 512  # angles, from which on they are worth a place of their own in memory


@jax.custom_jvp
def sine_and_cosine(angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Both of an angle in rad below 10^5, to the last digit: for crowds, in a tenth of the time of the compiler's."""
    return _either_way(angle)


def _sine_and_cosine(angle: Array) -> tuple[Array, Array]:
    quarters = jnp.round(angle * (2.0 / math.pi))
    x = ((angle - quarters * _QUARTER[0]) - quarters * _QUARTER[1]) - quarters * _QUARTER[2]
    squared = x * x
    sine, cosine = jnp.full_like(x, _SINE[-1]), jnp.full_like(x, _COSINE[-1])
    for of_sine, of_cosine in zip(_SINE[-2::-1], _COSINE[-2::-1], strict=True):
        sine, cosine = sine * squared + of_sine, cosine * squared + of_cosine
    sine = x + x * squared * sine
    cosine = 1.0 - 0.5 * squared + squared * squared * cosine
    turn = jax.lax.bitcast_convert_type(quarters + _TO_INTEGER, jnp.int64)
    swapped = (turn & 1) == 1
    first, second = jnp.where(swapped, cosine, sine), jnp.where(swapped, sine, cosine)
    return jnp.where((turn & 2) == 2, -first, first), jnp.where(((turn + 1) & 2) == 2, -second, second)


_either_way = jax.custom_batching.custom_vmap(_sine_and_cosine)


@_either_way.def_vmap
def _(size: int, is_batched: list[bool], angle: Array) -> tuple[tuple[Array, Array], tuple[bool, bool]]:
    """A crowd's behind a branch: or the compiler makes all of them anew wherever one is used, and in loops that it does
    not make wide. Samples of one angle lie so near each other that a few terms about the first of them will do."""
    del is_batched
    if angle.ndim != 1 or size < _CROWD:
        return _sine_and_cosine(angle), (True, True)
    is_near = jnp.max(jnp.abs(angle - angle[0])) < _NEAR
    return jax.lax.cond(is_near, _about_first, _of_any, angle), (True, True)


def _about_first(angle: Array) -> tuple[Array, Array]:
    first = angle[0]
    x = angle - first
    squared = x * x
    sine, cosine = jnp.full_like(x, _NEAR_SINE[-1]), jnp.full_like(x, _NEAR_COSINE[-1])
    for coefficient in _NEAR_SINE[-2::-1]:
        sine = sine * squared + coefficient
    for coefficient in _NEAR_COSINE[-2::-1]:
        cosine = cosine * squared + coefficient
    sine, fall = x + x * squared * sine, squared * cosine  # of x, and its cosine less 1
    s, c = jnp.sin(first), jnp.cos(first)
    return s + (c * sine + s * fall), c + (c * fall - s * sine)


def _of_any(angle: Array) -> tuple[Array, Array]:
    is_small = jnp.max(jnp.abs(angle)) < 1e5
    return jax.lax.cond(is_small, _sine_and_cosine, lambda x: (jnp.sin(x), jnp.cos(x)), angle)


@sine_and_cosine.defjvp
def _(primals, tangents):
    sine, cosine = sine_and_cosine(*primals)
    (change,) = tangents
    return (sine, cosine), (cosine * change, -sine * change)


# fdlibm's series of log((1 + s) / (1 - s)) in s^2, and the two parts of log 2.
_LOGARITHM = (6.666666666666735130e-1, 3.999999999940941908e-1, 2.857142874366239149e-1, 2.222219843214978396e-1,
              1.818357216161805012e-1, 1.531383769920937332e-1, 1.479819860510658591e-1)  # fmt: skip
_LOG_2 = (6.93147180369123816490e-1, 1.90821492927058770002e-10)
_SQUARE_ROOT_OF_HALF = 0x3FE6A09E667F3BCD  # the bits of it


def logarithm(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Natural logarithm of positive numbers above 1e-300, to the last digit: for crowds in a quarter of the time of the
    compiler's, which asks the system's for one after the other. Not to be differentiated.
    """
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    doublings = (bits - _SQUARE_ROOT_OF_HALF) >> 52
    near_one = jax.lax.bitcast_convert_type(bits - (doublings << 52), jnp.float64)
    exponent = jax.lax.bitcast_convert_type(doublings + (0x4330000000000000 + 1024), jnp.float64) - (2.0**52 + 1024.0)
    beyond = near_one - 1.0
    s = beyond / (2.0 + beyond)
    squared = s * s
    series = jnp.full_like(s, _LOGARITHM[-1])
    for coefficient in _LOGARITHM[-2::-1]:
        series = series * squared + coefficient
    half = 0.5 * beyond * beyond
    return exponent * _LOG_2[0] - ((half - (s * (half + series * squared) + exponent * _LOG_2[1])) - beyond)


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

"""Probability that a normal vector lies in a ball about the origin, with derivatives valid for every covariance."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erfc
from jaxtyping import Array, Float

from jaxgeo._numerics import larger, safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Numbers, Scalar

FARTHEST = 8.0  # standard deviations; the probability beyond is 1e-15
MID_NODES = 48
OUTER_NODES = 64
FAR = 20.0


class Frame(Record):
    """Integration axes of the normal vector: inner, middle and outer, as many as there are dimensions.

    Along `axes[0]` the integral has a closed form; along the others it is a quadrature over a standard normal `u` that
    displaces the vector by `sigma[k]` along `axes[k]` and by `drag[k]` along `axes[0]`.
    """

    axes: Float[Array, "d d"]
    sigma: Float[Array, " d"]
    drag: Float[Array, " d"]


def frame_of(cov: Float[Array, "d d"], mean: Float[Array, " d"]) -> Frame:
    """Frame in which the integrand is smooth: the principal axes, or, for a distant mean, one aligned with the mean.

    Seen from far outside, the sphere is nearly a plane normal to the mean direction n; the inner axis is then the part
    of the vector that varies with its component along n. Constant under differentiation, which `spread` accounts for.
    """
    cov, mean = jax.lax.stop_gradient((cov, mean))
    principal = _principal(cov)
    distance = safe_sqrt(jnp.sum(mean**2))
    is_far = distance * principal.sigma[-1] > FAR * principal.sigma[0] ** 2
    looking = _looking_along(jnp.where(is_far, mean / jnp.where(is_far, distance, 1.0), principal.axes[0]), cov)
    return jax.tree.map(lambda far, near: jax.lax.stop_gradient(jnp.where(is_far, far, near)), looking, principal)


def _principal(cov: Float[Array, "d d"]) -> Frame:
    variances, axes = eigen(cov)
    return Frame(axes, safe_sqrt(variances), jnp.zeros_like(variances))


def eigen(cov: Float[Array, "d d"]) -> tuple[Float[Array, " d"], Float[Array, "d d"]]:
    """Eigenvalues in descending order, and eigenvectors as rows; closed form in 2D, which compiles faster."""
    if len(cov) == 1:
        return cov[0], jnp.ones_like(cov)
    if len(cov) != 2:
        variances, columns = jnp.linalg.eigh(cov)
        return variances[::-1], columns.T[::-1]
    half, cross = 0.5 * (cov[0, 0] - cov[1, 1]), 0.5 * (cov[0, 1] + cov[1, 0])
    angle = 0.5 * jnp.arctan2(cross, half)
    mean, swing = 0.5 * (cov[0, 0] + cov[1, 1]), jnp.hypot(half, cross)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([mean + swing, mean - swing]), jnp.stack([jnp.stack([c, s]), jnp.stack([-s, c])])


def _looking_along(n: Float[Array, " d"], cov: Float[Array, "d d"]) -> Frame:
    inner = cov @ n / jnp.sqrt(n @ cov @ n)
    sigma = jnp.sqrt(inner @ inner)
    axis = inner / sigma
    rest = cov - jnp.outer(inner, inner)
    across = jnp.eye(len(n)) - jnp.outer(axis, axis)
    variances, axes = eigen(across @ rest @ across + 2.0 * jnp.trace(cov) * jnp.outer(axis, axis))
    axes = axes.at[0].set(axis)
    sigmas = safe_sqrt(variances).at[0].set(sigma)
    drag = axes @ rest @ axis / jnp.where(sigmas > 0.0, sigmas, jnp.inf)
    return Frame(axes, sigmas, drag.at[0].set(0.0))


def in_ball(frame: Frame, place: Numbers) -> Scalar:
    """Probability that the vector lies within a radius of the origin; `place` is that radius, then the mean."""
    radius, mean = place[0], frame.axes @ place[1:]
    return (_in_interval, _in_disc, _in_sphere)[len(mean) - 1](radius, mean, frame)


def _in_interval(radius: Numbers, mean: Numbers, frame: Frame) -> Numbers:
    """Probability between -radius and radius; a difference of two small numbers if both ends lie in the same tail."""
    scale = frame.sigma[0] * np.sqrt(2.0)
    side = jnp.where(mean[0] < 0.0, -1.0, 1.0)
    return 0.5 * (erfc((side * mean[0] - radius) / scale) - erfc((side * mean[0] + radius) / scale))


def _in_disc(radius: Scalar, mean: Numbers, frame: Frame) -> Scalar:
    """Trapezoidal rule over an angle, in which the integrand is periodic whether the disc or the tail limits it."""
    angle = np.pi * (np.arange(MID_NODES) + 0.5) / MID_NODES
    u, chord, weight = _chords(radius, mean[1], frame.sigma[1], angle)
    inner = (mean[0] + frame.drag[1] * u)[None]
    return jnp.sum(np.pi / MID_NODES * weight * _in_interval(chord, inner, frame))


def _in_sphere(radius: Scalar, mean: Numbers, frame: Frame) -> Scalar:
    """Gauss-Legendre quadrature over discs."""
    nodes, weights = np.polynomial.legendre.leggauss(OUTER_NODES)
    u, chord, weight = _chords(radius, mean[2], frame.sigma[2], 0.5 * np.pi * (nodes + 1.0))

    def disc(u: Scalar, chord: Scalar) -> Scalar:
        return _in_disc(chord, jnp.stack([mean[0] + frame.drag[2] * u, mean[1]]), frame)

    return jnp.sum(0.5 * np.pi * weights * weight * jax.vmap(disc)(u, chord))


def _chords(
    radius: Scalar, mean: Scalar, sigma: Scalar, angle: np.ndarray
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Nodes u in standard deviations, half-chord of the ball at each, and normal density times du.

    u is the cosine of an angle over the range inside the ball; the square root at the end of the chord becomes a sine.
    Expressed by the distance to the ends, to avoid cancellation for a thin covariance.
    """
    low, to_low = _end(radius + mean, sigma)
    high, to_high = _end(radius - mean, sigma)
    width = larger(high + low, 0.0)
    below_high, above_low = width * np.sin(angle / 2.0) ** 2, width * np.cos(angle / 2.0) ** 2
    u = high - below_high
    chord = safe_sqrt((to_high + sigma * below_high) * (to_low + sigma * above_low))
    return u, chord, jnp.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi) * width / 2.0 * np.sin(angle)


def _end(room: Scalar, sigma: Scalar) -> tuple[Scalar, Scalar]:
    """Number of sigmas in `room`, at most `FARTHEST`, and the remaining room."""
    all_fits = room > FARTHEST * sigma
    fits = room / jnp.where(all_fits | (sigma == 0.0), 1.0, sigma)
    fits = jnp.where(all_fits, FARTHEST, jnp.maximum(jnp.where(sigma == 0.0, -FARTHEST, fits), -FARTHEST))
    return fits, jnp.where(all_fits, room - FARTHEST * sigma, 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def spread(kernel: Callable[[Frame, Numbers], Numbers], frame: Frame, cov: Numbers, place: Numbers) -> Numbers:
    """`kernel`, an expectation over the normal vector, with derivatives of every order with respect to the covariance.

    The expectation satisfies the heat equation: its derivative by the covariance is half its second derivative by the
    mean. That is smooth where eigenvectors are undefined and standard deviations are not differentiable.
    """
    return kernel(frame, place)


@spread.defjvp
def _(kernel, primals, tangents):
    frame, cov, place = primals
    _, cov_tangent, place_tangent = tangents
    slopes = spread(slopes_of(kernel), frame, cov, place)
    bends = spread(bends_of(kernel), frame, cov, place)
    return spread(kernel, *primals), slopes @ place_tangent + 0.5 * jnp.einsum("...ij,ij", bends, cov_tangent)


def slopes_of(kernel: Callable[[Frame, Numbers], Numbers]) -> Callable[[Frame, Numbers], Numbers]:
    """First derivatives with respect to radius and mean, along a last axis."""
    return jax.jacfwd(kernel, argnums=1)


def bends_of(kernel: Callable[[Frame, Numbers], Numbers]) -> Callable[[Frame, Numbers], Numbers]:
    """Second derivatives with respect to the mean, along two last axes."""

    def by_mean(frame: Frame, radius: Numbers, mean: Numbers) -> Numbers:
        return kernel(frame, jnp.concatenate([radius, mean]))

    bends = jax.jacfwd(jax.jacfwd(by_mean, argnums=2), argnums=2)
    return lambda frame, place: bends(frame, place[:1], place[1:])

"""Brown-Conrady distortion, radial and tangential, and its inverse by Newton's method."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64
from jaxgeo._numerics import larger, safe_norm
from jaxgeo._typing import Flag, Scalar, ScalarField, StatusCode
from jaxgeo.sensor._newton import PlanePoint, determinant, solve_2d
from jaxgeo.sensor.distortion._implicit import inverse_at
from jaxgeo.sensor.distortion._segment import segment
from jaxgeo.sensor.distortion.base import AbstractFormula
from jaxgeo.status import Status, status_where

# Longest step of the inverse; beyond radius 1, times the radius. With steps three times as long, one point in 200 of
# extreme rational lenses converges to a branch beyond a fold; with these, none of 81351.
LONGEST_STEP = 0.3
MAX_STEPS = 80  # Newton needs 4 to 8; near a fold the distance to it halves at each step
FOLD = 1e-3  # determinant below which an iteration without a root counts as stopped by a fold (1 at the centre)


class BrownConrady(AbstractFormula):
    """Radial (rational) and tangential distortion with OpenCV's formula and order of coefficients, all unitless.

    With r2 = x2 + y2, radial = (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6):
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x2), y' = y radial + p1 (r2 + 2 y2) + 2 p2 x y.

    >>> lens = jaxgeo.BrownConrady(k1=-0.1)
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1280, height=960, distortion=lens)
    >>> uv, status = camera.project(np.array([0.5, 0.0, 1.0]))
    >>> print(np.round(uv, 3))  # without the lens at column 1139.5
    [1127.   479.5]
    """

    k1: ScalarField = 0.0
    k2: ScalarField = 0.0
    p1: ScalarField = 0.0
    p2: ScalarField = 0.0
    k3: ScalarField = 0.0
    k4: ScalarField = 0.0
    k5: ScalarField = 0.0
    k6: ScalarField = 0.0

    names: ClassVar = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

    def distort(self, ideal: PlanePoint) -> PlanePoint:
        x, y = ideal
        r2 = x**2 + y**2
        radial = self._numerator(r2) / self._denominator(r2)
        cross = 2.0 * x * y
        return jnp.stack(
            [
                x * radial + self.p1 * cross + self.p2 * (r2 + 2.0 * x**2),
                y * radial + self.p1 * (r2 + 2.0 * y**2) + self.p2 * cross,
            ]
        )

    def jacobian(self, ideal: PlanePoint) -> Float[Array, "2 2"]:
        """Derivative of `distort`; symmetric. Written out because every step of the inverse needs it."""
        x, y = ideal
        r2 = x**2 + y**2
        denominator = self._denominator(r2)
        radial = self._numerator(r2) / denominator
        slope = self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3)
        slope = slope - radial * (self.k4 + r2 * (2.0 * self.k5 + 3.0 * r2 * self.k6))
        slope = 2.0 * slope / denominator
        xx = radial + x**2 * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        xy = x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y
        yy = radial + y**2 * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        return jnp.stack([xx, xy, xy, yy]).reshape(2, 2)

    def in_field(self, ideal: PlanePoint) -> Flag:
        distortion, ideal = jax.lax.stop_gradient((self, ideal))

        return jnp.all(jax.vmap(distortion._unfolded)(segment(ideal)))

    def nearest_image(self, ideal: PlanePoint) -> PlanePoint:
        distortion, ideal = jax.lax.stop_gradient((self, ideal))
        points = segment(ideal)
        folded = jnp.argmin(jax.vmap(distortion._unfolded)(points))  # the first folded one
        last = jnp.where(folded > 0, points[jnp.maximum(folded - 1, 0)], 0.0)
        return distortion.distort(last)

    def undistort(self, distorted: PlanePoint) -> tuple[PlanePoint, StatusCode]:
        lens, distorted = as_float64((self, distorted), "undistort")
        frozen, target = jax.lax.stop_gradient((lens, distorted))
        valid = jnp.all(jnp.isfinite(target))
        root, converged, at_fold = _find_root(frozen, jnp.where(valid, target, 0.0))
        status = status_where(~converged, Status.not_converged, Status.hit.code)
        beyond = at_fold | (converged & ~frozen.in_field(root))
        status = status_where(beyond, Status.outside_distortion_field, status)
        status = status_where(~valid, Status.invalid_input, status)
        found = status == Status.hit
        distorted, root = jnp.where(found, distorted, 0.0), jax.lax.stop_gradient(jnp.where(found, root, 0.0))
        return inverse_at(BrownConrady.distort, BrownConrady.jacobian, lens, distorted, root), status

    def _unfolded(self, ideal: PlanePoint) -> Flag:
        """Whether the formula keeps its orientation at a point, before any pole of the radial factor."""
        return (self._denominator(jnp.sum(ideal**2)) > 0.0) & (determinant(self.jacobian(ideal)) > 0.0)

    def _numerator(self, r2: Scalar) -> Scalar:
        return 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))

    def _denominator(self, r2: Scalar) -> Scalar:
        return 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))


def _find_root(lens: BrownConrady, target: PlanePoint) -> tuple[PlanePoint, Flag, Flag]:
    """Damped Newton from the centre: (root, whether it converged, whether a fold stopped it).

    A step that does not reduce the residual, or ends where the formula is folded, is halved and tried again, and none
    is longer than LONGEST_STEP, to avoid jumping over a fold. So the iterates stay on the branch of the centre; where
    that branch does not reach `target`, they end at its fold.
    """
    scale = 1.0 + safe_norm(target)

    def residual_norm(ideal: PlanePoint) -> Scalar:
        return safe_norm(lens.distort(ideal) - target)

    def newton_step(ideal: PlanePoint) -> PlanePoint:
        step = -solve_2d(lens.jacobian(ideal), lens.distort(ideal) - target)
        longest = LONGEST_STEP * larger(1.0, safe_norm(ideal))
        return step * (longest / larger(safe_norm(step), longest))

    def body(state):
        ideal, residual, step, damping, count = state
        trial = ideal + damping * step
        trial_residual = residual_norm(trial)
        accepted = (trial_residual < residual) & lens._unfolded(trial)
        ideal = jnp.where(accepted, trial, ideal)
        residual = jnp.where(accepted, trial_residual, residual)
        step = jnp.where(accepted, newton_step(ideal), step)
        damping = jnp.where(accepted, jnp.minimum(1.0, 2.0 * damping), 0.5 * damping)
        return ideal, residual, step, damping, count + 1

    def unfinished(state) -> Flag:
        ideal, residual, step, damping, count = state
        stuck = damping * safe_norm(step) < 1e-16 * (1.0 + safe_norm(ideal))
        return (residual > 1e-15 * scale) & ~stuck & (count < MAX_STEPS)

    centre = jnp.zeros_like(target)
    start = (centre, residual_norm(centre), newton_step(centre), jnp.asarray(1.0, target.dtype), jnp.asarray(0))
    ideal, residual, *_ = jax.lax.while_loop(unfinished, body, start)
    converged = residual <= 1e-13 * scale
    at_fold = ~converged & (determinant(lens.jacobian(ideal)) < FOLD)
    return ideal, converged, at_fold

"""Fisheye lens: equidistant projection with a polynomial of the off-axis angle, and its inverse by bisection."""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64
from jaxgeo._numerics import safe_norm
from jaxgeo._typing import Flag, Scalar, ScalarField, StatusCode
from jaxgeo.sensor._newton import PlanePoint
from jaxgeo.sensor.distortion._implicit import inverse_at
from jaxgeo.sensor.distortion._segment import segment
from jaxgeo.sensor.distortion.base import AbstractFormula
from jaxgeo.status import Status, status_where

NEAR = 1e-4  # squared tangent below which arctan(r) / r is a series: its error is below 1e-17 there
SERIES = (1.0, -1.0 / 3.0, 1.0 / 5.0, -1.0 / 7.0)  # of arctan(r) / r in r squared
WIDEST = 0.5 * jnp.pi - 1e-6  # rad: rays of a camera point forward
STEPS = 64  # of the angle, in which the branch of the centre is followed
HALVINGS = 52  # of one of them


class Fisheye(AbstractFormula):
    """Fisheye distortion with OpenCV's formula and order of coefficients, all unitless: pixels are by the angle.

    With r the tangent of the off-axis angle t = arctan(r), and t' = t (1 + k1 t2 + k2 t4 + k3 t6 + k4 t8):
    x' = x t' / r, y' = y t' / r. Of a fisheye that sees more than half a sphere, the rays within 90 deg of the axis are
    in the field. Source: Kannala and Brandt, 2006, A generic camera model and calibration method; OpenCV, fisheye.

    >>> camera = jaxgeo.FrameCamera.from_pixels(
    ...     focal_px=300.0, width=1280, height=960, distortion=jaxgeo.sensor.Fisheye()
    ... )
    >>> uv, status = camera.project(np.array([1.0, 0.0, 1.0]))  # 45 deg off the axis
    >>> print(np.round(uv, 3), round(300 * np.pi / 4, 3))
    [875.119 479.5  ] 235.619
    """

    k1: ScalarField = 0.0
    k2: ScalarField = 0.0
    k3: ScalarField = 0.0
    k4: ScalarField = 0.0

    names: ClassVar = ("k1", "k2", "k3", "k4")

    def distort(self, ideal: PlanePoint) -> PlanePoint:
        r2 = jnp.sum(ideal**2)
        is_near = r2 < NEAR
        far = jnp.sqrt(jnp.where(is_near, 1.0, r2))
        a, b, c, d = SERIES
        near = jnp.where(is_near, r2, 0.0)
        share = jnp.where(is_near, a + near * (b + near * (c + near * d)), jnp.arctan(far) / far)  # t / r
        return ideal * (share * self._polynomial(r2 * share**2))

    def jacobian(self, ideal: PlanePoint) -> Float[Array, "2 2"]:
        """Derivative of `distort`."""
        return jax.jacfwd(self.distort)(ideal)

    def in_field(self, ideal: PlanePoint) -> Flag:
        lens, ideal = jax.lax.stop_gradient((self, ideal))
        angles = jax.vmap(lambda point: jnp.arctan(safe_norm(point)))(segment(ideal))
        return jnp.all(jnp.isfinite(ideal)) & jnp.all(lens._slope(angles) > 0.0)

    def nearest_image(self, ideal: PlanePoint) -> PlanePoint:
        lens, ideal = jax.lax.stop_gradient((self, ideal))
        points = segment(ideal)
        angles = jax.vmap(lambda point: jnp.arctan(safe_norm(point)))(points)
        folded = jnp.argmax(~(lens._slope(angles) > 0.0))  # the first folded one
        return lens.distort(jnp.where(folded > 0, points[jnp.maximum(folded - 1, 0)], 0.0))

    def undistort(self, distorted: PlanePoint) -> tuple[PlanePoint, StatusCode]:
        lens, distorted = as_float64((self, distorted), "undistort")
        frozen, target = jax.lax.stop_gradient((lens, distorted))
        valid = jnp.all(jnp.isfinite(target))
        target = jnp.where(valid, target, 0.0)
        radius = safe_norm(target)
        angle, reached = frozen._angle_of(radius)
        status = status_where(~reached, Status.outside_distortion_field, Status.hit.code)
        status = status_where(~valid, Status.invalid_input, status)
        found = status == Status.hit
        longer = jnp.tan(angle) / jnp.where(radius == 0.0, 1.0, radius)
        root = jnp.where(found, target * jnp.where(radius == 0.0, 1.0, longer), 0.0)
        distorted = jnp.where(found, distorted, 0.0)
        return inverse_at(Fisheye.distort, Fisheye.jacobian, lens, distorted, root), status

    def _angle_of(self, radius: Scalar) -> tuple[Scalar, Flag]:
        """(off-axis angle with a distorted radius on the branch of the centre, whether there is one)."""
        steps = jnp.linspace(0.0, WIDEST, STEPS + 1)
        images = steps * self._polynomial(steps**2)
        beyond = images[1:] >= radius
        first = jnp.argmax(beyond)
        unfolded = jnp.all((self._slope(steps[:-1]) > 0.0) | (jnp.arange(STEPS) > first))

        def halved(_: Any, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = ends
            middle = 0.5 * (low + high)
            is_less = middle * self._polynomial(middle**2) < radius
            return jnp.where(is_less, middle, low), jnp.where(is_less, high, middle)

        low, high = jax.lax.fori_loop(0, HALVINGS, halved, (steps[first], steps[first + 1]))
        angle = 0.5 * (low + high)
        return angle, jnp.any(beyond) & unfolded & (self._slope(angle) > 0.0)

    def _polynomial(self, t2: Any) -> Any:
        """t' / t of the squared angle."""
        return 1.0 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4)))

    def _slope(self, t: Any) -> Any:
        """dt' / dt."""
        t2 = t**2
        return 1.0 + t2 * (3.0 * self.k1 + t2 * (5.0 * self.k2 + t2 * (7.0 * self.k3 + t2 * 9.0 * self.k4)))

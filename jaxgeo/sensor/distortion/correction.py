"""Self-calibration lenses: a polynomial of the measured coordinates, added to them, gives the ideal coordinates.

These are the additional parameters of bundle adjustment: x - x0 + dx = -f ..., where (dx, dy) depends on the measured
(x, y). So undistorting evaluates the formula, and distorting inverts it with a fixed number of Newton steps.
"""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Num

from jaxgeo._checks import as_array, as_float64, check_finite, concrete
from jaxgeo._numerics import matrix, safe_norm
from jaxgeo._typing import Flag, Numbers, Scalar, ScalarField, StatusCode
from jaxgeo.sensor._newton import PlanePoint, determinant
from jaxgeo.sensor.distortion._implicit import inverse_at
from jaxgeo.sensor.distortion._segment import segment
from jaxgeo.sensor.distortion.base import AbstractDistortion, Self, as_coefficients
from jaxgeo.status import Status, status_where

# Newton steps from the ideal coordinates. For random lenses that move some image point by 1 % of the half side, 4 steps
# are exact to the last bit everywhere; 10 % needs 5, 20 % needs 6 (except about 1 in 1000 points, close to a fold).
STEPS = 6
LAST_STEP = 1e-8  # in units of `scale`: largest last step of a converged iteration; the error is its square

Pair: TypeAlias = tuple[Scalar, Scalar]
Rows: TypeAlias = tuple[Pair, Pair]

if TYPE_CHECKING:
    CoefficientsField: TypeAlias = Any
else:
    CoefficientsField: TypeAlias = Num[ArrayLike, "... n"]


class AbstractCorrection(AbstractDistortion):
    """Polynomial correction added to distorted coordinates to give the ideal ones.

    ideal = distorted + scale * polynomial(distorted / scale): `scale` is a tangent, ideally of half the image's longer
    side, so that the coefficients in `values` are unitless and give the shift at the image edge in half sides. x points
    right and y down, from the principal point.

    The field ends at the fold, or shortly before it, where the fixed number of Newton steps does not converge.
    """

    values: CoefficientsField
    scale: ScalarField

    orders: ClassVar[tuple[int, ...]]  # power of length in the term of each coefficient
    mirrored: ClassVar[tuple[str, ...]]  # coefficients whose sign changes with the direction of y
    over_focal: ClassVar[tuple[str, ...]] = ()  # coefficients whose term is divided by the focal length

    @abc.abstractmethod
    def polynomial(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """The correction (dx, dy) at distorted coordinates (x, y), all in units of `scale`."""

    @classmethod
    def from_coefficients(cls, coefficients: Any, *, scale: Any) -> Self:
        """Lens of given unitless coefficients, in the order of `names`.

        Raises `ValueError` for a wrong number of coefficients, a non-finite one, or a scale that is not positive.
        """
        check_finite(as_array(coefficients, "coefficients"), "coefficients", "units of scale")
        check_positive(scale, "scale", "the tangent of half the image's longer side, width / 2 / focal_px")
        return cls(as_coefficients(coefficients, cls), as_float64(scale, "scale"))

    @classmethod
    def zero(cls, *, scale: Any) -> Self:
        """Lens with zero coefficients, the start of an adjustment."""
        return cls.from_coefficients(jnp.zeros(len(cls.names)), scale=scale)

    @classmethod
    def for_image(cls, *, focal_px: Any, width: int, height: int) -> Self:
        """Lens with zero coefficients and half the longer side of an image as its scale.

        `focal_px` is one number or (along columns, along rows) in pixels; `width` and `height` are in pixels.
        """
        return cls.zero(scale=jnp.max(half_sides(focal_px, width, height)))

    @classmethod
    def from_image_plane(cls, coefficients: Any, *, focal_length: Any, half_side: Any, y_up: bool = False) -> Self:
        """Lens of coefficients in the literature's formula, with lengths in the image plane, in any one unit.

        `half_side` is the length that becomes `scale`, ideally half the image's longer side. Set `y_up` if the
        y axis points up, as in photogrammetry, not down as rows. Raises `ValueError` as `from_coefficients` does.
        """
        check_positive(focal_length, "focal_length", "in the unit of the coefficients, mm for those of a formula in mm")
        check_positive(half_side, "half_side", "half the image's longer side, in the unit of focal_length")
        check_finite(as_array(coefficients, "coefficients"), "coefficients", "powers of the unit of focal_length")
        focal_length, half_side = as_float64((focal_length, half_side), cls.__name__)
        units = cls._units(focal_length, half_side, y_up)
        return cls.from_coefficients(as_coefficients(coefficients, cls) * units, scale=half_side / focal_length)

    def in_image_plane(self, *, focal_length: Any, y_up: bool = False) -> Float[Array, "... n"]:
        """Coefficients in the literature's formula, lengths in the unit of `focal_length`; see `from_image_plane`."""
        lens, focal_length = as_float64((self, focal_length), "in_image_plane")
        return lens.values / self._units(focal_length, lens.scale * focal_length, y_up)

    def coefficients(self) -> Float[Array, "... n"]:
        return as_float64(self.values, "coefficients")

    def with_coefficients(self, vector: Any) -> Self:
        return eqx.tree_at(lambda lens: lens.values, self, as_coefficients(vector, type(self)))

    def correct(self, distorted: PlanePoint) -> PlanePoint:
        """Ideal coordinates of distorted ones by the formula alone, inside the field or not."""
        x, y = distorted
        dx, dy = self.polynomial(x / self.scale, y / self.scale)
        return jnp.stack([x + self.scale * dx, y + self.scale * dy])

    def jacobian(self, distorted: PlanePoint) -> Float[Array, "2 2"]:
        """Derivative of `correct`."""
        x, y = distorted
        return matrix(self._with_slopes(x / self.scale, y / self.scale)[1])

    def distort(self, ideal: PlanePoint) -> PlanePoint:
        """Distorted coordinates of ideal ones; beyond the field, where Newton does not converge, the ideal ones."""
        lens, ideal = as_float64((self, ideal), "distort")
        frozen, target = jax.lax.stop_gradient((lens, ideal))
        root, found = frozen._find_root(target)
        return inverse_at(_correct, _jacobian, lens, ideal, jax.lax.stop_gradient(jnp.where(found, root, target)))

    def in_field(self, ideal: PlanePoint) -> Flag:
        lens, ideal = jax.lax.stop_gradient(as_float64((self, ideal), "in_field"))
        root, found = lens._find_root(ideal)
        return found & lens._unfolded_to(jnp.where(found, root, 0.0))

    def undistort(self, distorted: PlanePoint) -> tuple[PlanePoint, StatusCode]:
        lens, distorted = as_float64((self, distorted), "undistort")
        valid = jnp.all(jnp.isfinite(distorted))
        found = valid & jax.lax.stop_gradient(lens)._is_inverted(jax.lax.stop_gradient(distorted))
        status = status_where(~found, Status.outside_distortion_field, Status.hit.code)
        status = status_where(~valid, Status.invalid_input, status)
        return jnp.where(found, lens.correct(jnp.where(found, distorted, 0.0)), 0.0), status

    def _is_inverted(self, distorted: PlanePoint) -> Flag:
        """Whether a point is before the fold and `distort` returns to it."""
        root, found = self._find_root(self.correct(distorted))
        comes_back = safe_norm(root - distorted) < LAST_STEP * self.scale
        return found & comes_back & self._unfolded_to(distorted)

    def _find_root(self, ideal: PlanePoint) -> tuple[PlanePoint, Flag]:
        """Newton from the ideal coordinates: (distorted coordinates, whether it converged).

        By component and unrolled, so that a batch is one kernel: a third of the time of small arrays.
        """
        target_x, target_y = ideal / self.scale

        def step(_, state):
            x, y, *_ = state
            (value_x, value_y), J = self._with_slopes(x, y)
            move_x, move_y = _solved(J, target_x - value_x, target_y - value_y)
            return x + move_x, y + move_y, move_x, move_y

        start = (target_x, target_y, target_x, target_y)
        x, y, move_x, move_y = jax.lax.fori_loop(0, STEPS, step, start, unroll=True)
        found = (jnp.abs(move_x) < LAST_STEP) & (jnp.abs(move_y) < LAST_STEP)
        return self.scale * jnp.stack([x, y]), found

    def _with_slopes(self, x: Scalar, y: Scalar) -> tuple[Pair, Rows]:
        """Ideal coordinates of distorted ones, in units of `scale`, and their derivative, by component."""

        def formula(x, y):
            dx, dy = self.polynomial(x, y)
            return x + dx, y + dy

        one, zero = jnp.ones_like(x), jnp.zeros_like(x)
        ideal, (xx, yx) = jax.jvp(formula, (x, y), (one, zero))
        _, (xy, yy) = jax.jvp(formula, (x, y), (zero, one))
        return ideal, ((xx, xy), (yx, yy))

    def _unfolded_to(self, distorted: PlanePoint) -> Flag:
        """Whether the formula keeps its orientation all the way from the centre."""
        points = segment(distorted / self.scale)
        return jnp.all(jax.vmap(lambda point: determinant(matrix(self._with_slopes(*point)[1])))(points) > 0.0)

    @classmethod
    def _units(cls, focal_length: Scalar, half_side: Scalar, y_up: bool) -> Float[Array, " n"]:
        """Factors that make image-plane coefficients unitless, with the y axis down."""
        units = []
        for name, order in zip(cls.names, cls.orders, strict=True):
            unit = half_side ** (order - 1) / (focal_length if name in cls.over_focal else 1.0)
            units.append(-unit if y_up and name in cls.mirrored else unit)
        return jnp.stack(units)


def half_sides(focal_px: Any, width: int, height: int) -> Float[Array, "2"]:
    """Tangents of half an image's width and height."""
    focal_px = as_array(focal_px, "focal_px")
    check_positive(focal_px, "focal_px", "in pixels: the focal length divided by the pixel pitch")
    check_positive(width, "width", "the columns of the image")
    check_positive(height, "height", "the rows of the image")
    size, focal = as_float64((jnp.array([width, height]), focal_px), "for_image")
    return 0.5 * size / focal


def check_positive(value: Any, name: str, hint: str) -> None:
    known = concrete(value)
    if known is not None and not ((known > 0.0) & (known < float("inf"))).all():
        raise ValueError(f"{name} must be positive and finite; got {known.tolist()!r}: it is {hint}.")


def _solved(J: Rows, x: Scalar, y: Scalar) -> Pair:
    """`solve_2d`, by component."""
    (xx, xy), (yx, yy) = J
    det = xx * yy - xy * yx
    det = jnp.where(det == 0.0, 1.0, det)
    return (yy * x - xy * y) / det, (xx * y - yx * x) / det


def _correct(lens: AbstractCorrection, distorted: PlanePoint) -> PlanePoint:
    return lens.correct(distorted)


def _jacobian(lens: AbstractCorrection, distorted: PlanePoint) -> Float[Array, "2 2"]:
    return lens.jacobian(distorted)

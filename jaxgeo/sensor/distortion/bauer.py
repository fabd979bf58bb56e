"""Bauer's three additional parameters: one for the lens, two for the film or the chip."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx

from jaxgeo._checks import as_float64
from jaxgeo._numerics import safe_sqrt
from jaxgeo._typing import Numbers, Scalar, ScalarField
from jaxgeo.sensor.distortion.base import Self
from jaxgeo.sensor.distortion.correction import AbstractCorrection, check_positive, half_sides

SQUARE_BALANCE = (14.0 / 15.0) ** 0.5  # `balance_radius` of a square, in units of half its side


class Bauer(AbstractCorrection):
    """Bauer's three parameters (1972): radial distortion that vanishes at `r0`, shear, and difference of scale.

    dx = a1 x (r2 - r0^2) - a3 x, dy = a1 y (r2 - r0^2) + a2 x + a3 y, with x, y and `r0` in units of `scale`. The
    default `r0` is the `balance_radius` of a square; `for_image` uses that of the image. There the radial term is
    orthogonal to a change of the focal length, so both can be estimated together.
    """

    r0: ScalarField = SQUARE_BALANCE

    names: ClassVar = ("a1", "a2", "a3")
    orders: ClassVar = (3, 1, 1)
    mirrored: ClassVar = ("a2",)

    def polynomial(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        a1, a2, a3 = self.values
        radial = a1 * (x * x + y * y - self.r0 * self.r0)
        return x * (radial - a3), y * (radial + a3) + a2 * x

    @classmethod
    def for_image(cls, *, focal_px: Any, width: int, height: int) -> Self:
        """Lens with zero coefficients, scale and `r0` of an image; see `AbstractCorrection.for_image`."""
        lens = super().for_image(focal_px=focal_px, width=width, height=height)
        across, down = half_sides(focal_px, width, height) / lens.scale
        return cls(lens.values, lens.scale, balance_radius(across, down))

    @classmethod
    def from_image_plane(
        cls, coefficients: Any, *, focal_length: Any, half_side: Any, y_up: bool = False, r0: Any = None
    ) -> Self:
        """As `AbstractCorrection.from_image_plane`; `r0` is a length too, by default that of a square image."""
        lens = super().from_image_plane(coefficients, focal_length=focal_length, half_side=half_side, y_up=y_up)
        if r0 is None:
            return lens
        check_positive(r0, "r0", "the radius at which the radial term vanishes, in the unit of focal_length")
        return eqx.tree_at(lambda lens: lens.r0, lens, as_float64(r0, "r0") / as_float64(half_side, "half_side"))


def balance_radius(across: Scalar, down: Scalar) -> Scalar:
    """r0 for which r (r2 - r0^2) is orthogonal to r over a rectangle with these half sides: r0^2 = <r4> / <r2>."""
    p, q = across**2, down**2
    return safe_sqrt((p * p / 5.0 + q * q / 5.0 + 2.0 * p * q / 9.0) / ((p + q) / 3.0))

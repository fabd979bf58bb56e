"""Ebner's twelve additional parameters, orthogonal to each other and to the exterior orientation."""

from __future__ import annotations

from typing import ClassVar

from jaxgeo._typing import Numbers
from jaxgeo.sensor.distortion.correction import AbstractCorrection

K = 2.0 / 3.0  # mean of x^2 over the grid, whose base b is one unit of `scale`


class Ebner(AbstractCorrection):
    """Ebner's twelve parameters (1976), orthogonal on a grid of 3 x 3 points with spacing b = `scale`.

    With k = 2/3 b^2, and x, y in units of b:
    dx = b1 x + b2 y - 2 b3 (x2 - k) + b4 x y + b5 (y2 - k) + b7 x (y2 - k) + b9 y (x2 - k) + b11 (x2 - k)(y2 - k),
    dy = -b1 y + b2 x + b3 x y - 2 b4 (y2 - k) + b6 (x2 - k) + b8 y (x2 - k) + b10 x (y2 - k) + b12 (x2 - k)(y2 - k).
    Over flat ground they are also orthogonal on the grid to the six parameters of the exterior orientation: shifts,
    rotation, scale, (x2, x y) and (x y, y2). As in the original, both axes share one base: with two, (x2, x y) would
    not stay orthogonal to b3. On a rectangular image b is half the longer side; another b spans the same corrections,
    apart from changes of the exterior orientation.
    """

    names: ClassVar = tuple(f"b{k}" for k in range(1, 13))
    orders: ClassVar = (1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4)
    mirrored: ClassVar = ("b2", "b4", "b6", "b9", "b10", "b12")

    def polynomial(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12 = self.values
        xy, xx, yy = x * y, x * x - K, y * y - K
        dx = b1 * x + b2 * y - 2.0 * b3 * xx + b4 * xy + b5 * yy + b7 * x * yy + b9 * y * xx + b11 * xx * yy
        dy = -b1 * y + b2 * x + b3 * xy - 2.0 * b4 * yy + b6 * xx + b8 * y * xx + b10 * x * yy + b12 * xx * yy
        return dx, dy

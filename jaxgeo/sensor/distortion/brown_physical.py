"""Brown's twenty-one additional parameters for film, lens and interior orientation."""

from __future__ import annotations

from typing import ClassVar

from jaxgeo._typing import Numbers
from jaxgeo.sensor.distortion.correction import AbstractCorrection


class BrownPhysical(AbstractCorrection):
    """Brown's twenty-one parameters (1976), each with a physical cause.

    In-plane film or chip (a1 to a12), out-of-plane (a13 to a15), lens (a16 to a18), interior orientation (a19 to a21).
    With P = a13 (x2 - y2) + a14 x2 y2 + a15 (x4 - y4), Q = a16 r2 + a17 r4 + a18 r6, and the focal length c:
    dx = a1 x + a2 y + a3 x y + a4 y2 + a5 x2 y + a6 x y2 + a7 x2 y2 + (x/c) P + x Q + a19 + a21 x/c,
    dy = a8 x y + a9 x2 + a10 x2 y + a11 x y2 + a12 x2 y2 + (y/c) P + y Q + a20 + a21 y/c.
    Here x and y are in units of `scale`, and c is absorbed into a13, a14, a15 and a21.
    a19, a20 and a21 (`interior`) move principal point and focal length: never estimate them together with those.
    """

    names: ClassVar = tuple(f"a{k}" for k in range(1, 22))
    interior: ClassVar = ("a19", "a20", "a21")
    orders: ClassVar = (1, 1, 2, 2, 3, 3, 4, 2, 2, 3, 3, 4, 3, 5, 5, 3, 5, 7, 0, 0, 1)
    mirrored: ClassVar = ("a2", "a3", "a5", "a9", "a11", "a12", "a20")
    over_focal: ClassVar = ("a13", "a14", "a15", "a21")

    def polynomial(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11, a12, a13, a14, a15, a16, a17, a18, a19, a20, a21 = self.values
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        flatness = (xx - yy) * (a13 + a15 * r2) + a14 * xx * yy
        radial = r2 * (a16 + r2 * (a17 + r2 * a18)) + flatness + a21
        dx = x * (a1 + radial) + a2 * y + a3 * xy + a4 * yy + xy * (a5 * x + a6 * y + a7 * xy) + a19
        dy = y * radial + a8 * xy + a9 * xx + xy * (a10 * x + a11 * y + a12 * xy) + a20
        return dx, dy

"""The bilinear surface of one cell."""

from __future__ import annotations

from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField


class Patch(Record):
    """Bilinear surface of a cell's four posts, heights in m: `first`, then the next in col, in row, in both.

    Offsets are in cells from the first post, and may be outside the cell.
    """

    first: ScalarField
    next_col: ScalarField
    next_row: ScalarField
    last: ScalarField

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        """Height in m at an offset."""
        near = self.first + (self.next_col - self.first) * col
        far = self.next_row + (self.last - self.next_row) * col
        return near + (far - near) * row

    def gradient(self, row: Scalar, col: Scalar) -> tuple[Scalar, Scalar]:
        """Height gradient in m per cell along rows and along columns, at an offset."""
        twist = self.last - self.next_row - self.next_col + self.first
        return self.next_row - self.first + twist * col, self.next_col - self.first + twist * row

"""The bilinear surface of one cell."""

from __future__ import annotations

from jaxtyping import Array, Float

from jaxgeo._typing import Scalar


def bilinear(posts: Float[Array, "2 2"], offset: Float[Array, "2"]) -> Scalar:
    """The bilinear patch through four posts [row, col] at an `offset` in cells from the first."""
    row, col = offset
    first = posts[0, 0] + (posts[0, 1] - posts[0, 0]) * col
    second = posts[1, 0] + (posts[1, 1] - posts[1, 0]) * col
    return first + (second - first) * row

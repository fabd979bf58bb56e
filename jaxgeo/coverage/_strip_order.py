"""Order of the images of one strip along its course."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxgeo._record import portable
from jaxgeo.coverage.exposure import Image, local_projection
from jaxgeo.coverage.strips import STANDING, place_on_map

MOST = 400  # images whose pairs give the course
AROUND = 2  # images on either side with which an image is compared
OFF_STEP = 0.7  # of the step along the course, and
OFF_LENGTH = 0.01  # of the strip's length: an image farther off its neighbours across the course is not on their line


@portable
class NotOnLine(ValueError):
    """Images that do not lie on a line: the `index` of the one farthest `off`, in m across the course."""

    def __init__(self, index: int, off: float) -> None:
        super().__init__(f"the images do not lie on a line: image {index} is {off:.0f} m off its neighbours.")
        self.index, self.off = index, off


def strip_order(images: Sequence[Image]) -> list[int]:
    """Indices of the images of a strip in order of flight: as given, unless a step goes back along the course.

    Otherwise they are sorted along the course, in the direction in which most of those given follow each other. Each
    image is compared across the course with the median of its neighbours, two on either side. Raises `NotOnLine` if
    one is off by more than 0.7 of the median step and 0.01 of the length, as an image of another strip is.
    """
    projection = local_projection(images[0])
    places = np.array([np.asarray(place_on_map(image, projection)) for image in images])
    course = _course(places)
    along, across = places @ course, places @ np.array([course[1], -course[0]])
    steps = np.diff(along)
    if np.sum(np.sign(steps)) < 0.0:
        along, steps = -along, -steps
    order = np.argsort(along, kind="stable")
    _check_line(order, along[order], across[order])
    return list(range(len(images))) if np.all(steps > -STANDING) else order.tolist()


def _course(places: np.ndarray) -> np.ndarray:
    """Unit vector along a strip (images, 2), in one of its two directions: the mean of twice the angle over all pairs
    of images, in which a few that are off have little weight."""
    some = places[:: -(-len(places) // MOST)]
    first, second = np.triu_indices(len(some), 1)
    ways = (some[second] - some[first]) @ np.array([1.0, 1.0j])
    lengths = np.abs(ways)
    doubled = np.sum(ways[lengths > STANDING] ** 2 / lengths[lengths > STANDING])
    angle = 0.5 * np.angle(doubled)
    return np.array([np.cos(angle), np.sin(angle)])


def _check_line(order: np.ndarray, along: np.ndarray, across: np.ndarray) -> None:
    if len(order) < 3:
        return
    count = len(order)
    around = [across[max(0, k - AROUND) : k + AROUND + 1] for k in range(count)]
    off = np.abs(across - np.array([np.median(one) for one in around]))
    allowed = max(OFF_STEP * float(np.median(np.diff(along))), OFF_LENGTH * float(along[-1] - along[0]))
    worst = int(np.argmax(off))
    if off[worst] > max(allowed, STANDING):
        raise NotOnLine(int(order[worst]), float(off[worst]))

"""The part of a block that its measurements join, and its solution."""

from __future__ import annotations

import numpy as np

from jaxgeo.adjust import Block, GroundPoints, HeightObservations, ImagePoints, Unknowns
from jaxgeo.adjust.kept import Kept
from jaxgeo.adjust.unknowns import spread
from jaxgeo.ties.block_of_views import STRIP, block_of_views
from jaxgeo.ties.connections import largest_part, of_images
from jaxgeo.ties.solutions import Final, least_squares, robust_solution, without_unchecked
from jaxgeo.ties.views import Views

UNTIED = "no two images share enough tie points{}to be adjusted; check the navigation and its errors."


def solved(
    views: Views,
    observations: ImagePoints,
    unknowns: Unknowns,
    terrain: HeightObservations | None,
    ground: GroundPoints | None,
    late: Views,
) -> tuple[Block, Final, list[str]]:
    """(the largest part of the images that measurements which fit join, its least squares, names of the images that
    all measurements join). `late` are the views with the errors of an unknown time offset.

    Raises `ValueError` if no images are joined.
    """
    joined, is_by_pairs = largest_part(views, observations, ground), False
    while True:
        part = largest_part(views, observations, ground)
        if len(part) < 2:
            raise ValueError(UNTIED.format(" that agree " if len(joined) > 1 else " "))
        block = block_of_views(views, of_images(views, observations, part, ground), ground)
        found, final = robust_solution(block, unknowns, terrain, late, is_by_pairs), None
        if _ties_all(views, block, found.kept, ground) and found.is_by_pairs:
            found, final = without_unchecked(block, unknowns, terrain, found)
        if _ties_all(views, block, found.kept, ground):
            return block, final or least_squares(block, unknowns, terrain, found), joined
        left, is_by_pairs = block.observations.of(found.kept.rows), found.is_by_pairs  # an image has lost its ties
        if is_by_pairs:
            left = of_images(views, block.observations, largest_part(views, left, ground), ground)
        observations = left


def with_unknown_time_offset(views: Views, unknowns: Unknowns) -> Views:
    """The views with the errors of a time offset that is unknown with a prior; as they are without one."""
    sigma = float(spread(unknowns.time_offset, [STRIP], 1, "time_offset")[0, 0])
    return views.with_time_offset(sigma) if np.isfinite(sigma) else views


def mostly_left_out(block: Block, kept: Kept) -> list[str]:
    """Names of images of which more than half of the measurements are left out."""
    names, _ = block.observations.image_numbers
    few = kept.of_images(block) < 0.5 * Kept.all(block).of_images(block)
    return [str(name) for name in names[few]]


def _ties_all(views: Views, block: Block, kept: Kept, ground: GroundPoints | None) -> bool:
    """Whether what is kept of a block still joins all its images."""
    left = block.observations.of(kept.rows)
    return set(largest_part(views, left, ground)) >= {str(name) for name in block.images.name}

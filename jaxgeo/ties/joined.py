"""The part of a block that its measurements join, and its solution."""

from __future__ import annotations

import numpy as np

from jaxgeo.adjust import Block, GroundPoints, HeightObservations, ImagePoints, Unknowns
from jaxgeo.adjust.initial_points import of_parallel_rays
from jaxgeo.adjust.kept import Kept
from jaxgeo.ties.block_of_views import block_of_views
from jaxgeo.ties.solutions import Final, least_squares, robust_solution, without_unchecked
from jaxgeo.ties.tracks import connected
from jaxgeo.ties.views import Views

GROUND = "\n"  # name of an image that shows all control points: none of a file has it
UNTIED = "no two images share enough tie points{}to be adjusted; check the navigation and its errors."


def solved(
    views: Views,
    observations: ImagePoints,
    unknowns: Unknowns,
    terrain: HeightObservations | None,
    ground: GroundPoints | None,
) -> tuple[Block, Final, list[str]]:
    """(the largest part of the images that measurements which fit join, its least squares, names of the images that
    all measurements join). Raises `ValueError` if no images are joined."""
    joined, is_by_pairs = _largest_part(views, observations, ground), False
    while True:
        part = _largest_part(views, observations, ground)
        if len(part) < 2:
            raise ValueError(UNTIED.format(" that agree " if len(joined) > 1 else " "))
        block = block_of_views(views, _of_images(observations, part, ground), ground)
        found, final = robust_solution(block, unknowns, terrain, views, is_by_pairs), None
        if _ties_all(views, block, found.kept, ground) and found.is_by_pairs:
            found, final = without_unchecked(block, unknowns, terrain, found)
        if _ties_all(views, block, found.kept, ground):
            return block, final or least_squares(block, unknowns, terrain, found), joined
        left, is_by_pairs = block.observations.of(found.kept.rows), found.is_by_pairs  # an image has lost its ties
        if is_by_pairs:
            left = _of_images(block.observations, _largest_part(views, left, ground), ground)
        observations = left


def mostly_left_out(block: Block, kept: Kept) -> list[str]:
    """Names of images of which more than half of the measurements are left out."""
    names, _ = block.observations.image_numbers
    few = kept.of_images(block) < 0.5 * Kept.all(block).of_images(block)
    return [str(name) for name in names[few]]


def of_places(views: Views, observations: ImagePoints, ground: GroundPoints | None) -> ImagePoints:
    """The measurements of points that are control, or whose rays are not parallel. Raises `ValueError` if there are
    none."""
    parallel = of_parallel_rays(block_of_views(views, observations, ground))
    if ground is not None:
        parallel &= ~np.isin(observations.point, ground.name)
    if np.all(parallel):
        raise ValueError(
            "the rays of all tie points are parallel, so that these have no place; are the images of one position, or "
            "one image under several names?"
        )
    return observations.of(~parallel) if np.any(parallel) else observations


def _largest_part(views: Views, observations: ImagePoints, ground: GroundPoints | None) -> list[str]:
    """Names of the images of the largest connected part; images with three control points are connected."""
    if ground is None:
        return connected(views.name, observations)[0]
    all_control = np.unique(observations.point[np.isin(observations.point, ground.name)])
    of_ground = ImagePoints(np.full(len(all_control), GROUND), all_control, np.zeros((len(all_control), 2)))
    parts = connected(np.append(views.name, GROUND), ImagePoints.joined([observations, of_ground]))
    return max(([name for name in part if name != GROUND] for part in parts), key=len)


def _ties_all(views: Views, block: Block, kept: Kept, ground: GroundPoints | None) -> bool:
    """Whether what is kept of a block still joins all its images."""
    left = block.observations.of(kept.rows)
    return set(_largest_part(views, left, ground)) >= {str(name) for name in block.images.name}


def _of_images(observations: ImagePoints, names: list[str], ground: GroundPoints | None) -> ImagePoints:
    known = () if ground is None else ground.name.tolist()
    return observations.of(np.isin(observations.image, names)).seen_often(known=known)

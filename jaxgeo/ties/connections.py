"""Images of a block that tie points, control points and shots connect, and the points that have a place."""

from __future__ import annotations

import numpy as np

from jaxgeo.adjust import GroundPoints, ImagePoints
from jaxgeo.adjust.initial_points import of_parallel_rays
from jaxgeo.ties.block_of_views import block_of_views, in_several
from jaxgeo.ties.tracks import connected
from jaxgeo.ties.views import Views

GROUND = "\n"  # name of an image that shows all control points: none of a file has it
JOINING = 3  # points that connect two images


def largest_part(views: Views, observations: ImagePoints, ground: GroundPoints | None) -> list[str]:
    """Names of the images of the largest connected part; images with three control points are connected, and so are
    those of one shot that have measurements."""
    names, parts = views.name, [observations]
    if ground is not None:
        all_control = np.unique(observations.point[np.isin(observations.point, ground.name)])
        parts.append(_points(np.full(len(all_control), GROUND), all_control))
        names = np.append(names, GROUND)
    if views.shot is not None:
        rows = np.flatnonzero(np.isin(views.name, observations.image))
        for k in range(JOINING):
            parts.append(_points(views.name[rows], np.array([f"\nshot {one}, {k}" for one in views.shot[rows]], str)))
    if len(parts) == 1:
        return connected(names, observations)[0]
    found = connected(names, ImagePoints.joined(parts))
    return max(([name for name in part if name != GROUND] for part in found), key=len)


def _points(image: np.ndarray, point: np.ndarray) -> ImagePoints:
    return ImagePoints(image, point, np.zeros((len(point), 2)))


def of_places(views: Views, observations: ImagePoints, ground: GroundPoints | None) -> ImagePoints:
    """The measurements of points that are control, or whose rays are not parallel. Raises `ValueError` if there are
    none."""
    known = () if ground is None else tuple(ground.name.tolist())
    observations = of_several_shots(views, observations, known)
    parallel = of_parallel_rays(block_of_views(views, observations, ground)) if len(observations) else np.zeros(0, bool)
    parallel &= ~np.isin(observations.point, known)
    if np.all(parallel):
        raise ValueError(
            "the rays of all tie points are parallel, so that these have no place; are the images of one position, or "
            "one image under several names?"
        )
    return observations.of(~parallel) if np.any(parallel) else observations


def of_several_shots(views: Views, observations: ImagePoints, known: tuple[str, ...]) -> ImagePoints:
    """The measurements of points that are `known`, or that two shots or more show: the rays of one shot are as good as
    parallel."""
    if views.shot is None:
        return observations
    by_name = dict(zip(views.name.tolist(), views.shot.tolist(), strict=True))
    shot = np.array([by_name[name] for name in observations.image.tolist()], int)
    return observations.of(in_several(observations, shot, np.ones(len(observations), bool), known))


def of_images(views: Views, observations: ImagePoints, names: list[str], ground: GroundPoints | None) -> ImagePoints:
    """The measurements in some images, of points that are still in two of them, and in two shots."""
    known = () if ground is None else tuple(ground.name.tolist())
    kept = observations.of(np.isin(observations.image, names)).seen_often(known=known)
    return of_several_shots(views, kept, known)

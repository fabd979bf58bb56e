"""Measurements of a block that agree pair by pair, within the covariance of the navigation."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Block
from jaxgeo.adjust.exposures import LEAST_ATTITUDE, LEAST_POSITION
from jaxgeo.adjust.kept import Kept, control_of
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.ray_consensus import Rays, turns
from jaxgeo.adjust.tie_start import adjusted_start
from jaxgeo.adjust.values import Values
from jaxgeo.ties.epipolar import coplanarity
from jaxgeo.ties.pair_consensus import agreement
from jaxgeo.ties.views import Views

LARGEST = 300  # images of a block whose orientations are improved together before its adjustment
STEPS = 3
WIDTH = 3.0  # px: of the weights


def agreeing(block: Block, views: Views) -> np.ndarray:
    """Flags (k,) of the measurements of a block that agree with others of their points.

    Each pair of images votes on its common points, if more than five agree. Of the measurements of a point, those with
    the most votes against them are left out until there is none, and then those without a vote for them that had one
    against them.
    """
    rays = Rays.of(block)
    index = {str(name): row for row, name in enumerate(views.name)}
    row_of = np.array([index[str(name)] for name in block.images.name])
    px = _pixels_of_sigma(block, rays)
    first, second = _couples(rays)
    both = rays.image[first] * len(block.images) + rays.image[second]
    order = np.argsort(both, kind="stable")
    vote = np.zeros(len(first), int)
    for part in np.split(order, np.flatnonzero(np.diff(both[order])) + 1):
        if not len(part):
            continue
        found = coplanarity(rays, first[part], second[part])
        i, j = rays.image[first[part[0]]], rays.image[second[part[0]]]
        covariance = views.covariance_of_pair(int(row_of[i]), int(row_of[j]))
        result = agreement(found.off, found.by_pose, covariance, np.sqrt(px[first[part]] * px[second[part]]))
        if result is not None:
            vote[part] = np.where(result, 1, -1)
    return _by_votes(len(rays.image), rays.point, first, second, vote)


def by_coplanarity(block: Block, views: Views, kept: np.ndarray) -> Block:
    """The block with orientations to start from that make the rays of what is kept coplanar, pair by pair.

    The navigation's errors are those of least squares with their covariance as prior (Gauss-Newton, Cauchy weights).
    Points whose rays part by the navigation, which start behind the cameras, then start before them. Blocks of more
    than `LARGEST` images are left as they are.
    """
    count = len(block.images)
    if count > LARGEST:
        return block
    rays = Rays.of(block)
    first, second = _couples(rays)
    both = kept[first] & kept[second]
    first, second = first[both], second[both]
    if not len(first):
        return block
    index = {str(name): row for row, name in enumerate(views.name)}
    rows = np.array([index[str(name)] for name in block.images.name])
    prior = np.linalg.inv(_covariance(views, rows))
    centre, R, error = rays.centre, rays.R, np.zeros(6 * count)
    px = _pixels_of_sigma(block, rays)[first]
    for _ in range(STEPS):
        found = coplanarity(rays, first, second)
        weight = 1.0 / (1.0 + px**2 + (found.off / WIDTH) ** 2)
        J = np.zeros((len(first), count, 6))
        at = np.arange(len(first))
        J[at, rays.image[first]], J[at, rays.image[second]] = found.by_pose[:, :6], found.by_pose[:, 6:]
        J = J.reshape(len(first), -1)
        right = J.T @ (weight * (J @ error - found.off))
        error = np.linalg.solve(prior + (J.T * weight) @ J, right)
        moves = error.reshape(count, 6)
        rays.centre, rays.R = centre + moves[:, :3], R @ turns(moves[:, 3:])
    return replace(block, images=replace(block.images, centre=rays.centre, R_frame_from_camera=rays.R))


def _covariance(views: Views, rows: np.ndarray) -> np.ndarray:
    """Covariance (6 n, 6 n) of the navigation errors of some images, with the least standard deviations."""
    common = np.zeros((6 * len(rows), 6 * len(rows)))
    for one in views.common.values():
        common += np.outer(one[rows], one[rows])
    least = np.diag(np.repeat([LEAST_POSITION, LEAST_ATTITUDE], 3) ** 2)
    for k, row in enumerate(rows):
        common[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += views.own[row] + least
    return common


def _pixels_of_sigma(block: Block, rays: Rays) -> np.ndarray:
    """Number (k,) of standard deviations of the directions in a pixel."""
    focal = {name: float(np.mean(np.asarray(camera.focal_px))) for name, camera in block.cameras.items()}
    return 1.0 / (rays.sigma * np.array([focal[str(name)] for name in block.images.camera])[rays.image])


def with_points_again(block: Block, full: Prepared, values: Values, kept: Kept) -> Values:
    """Values where points without any measurement kept lie where their rays meet, by the adjusted orientations."""
    names, point = block.observations.point_numbers
    gone = np.bincount(point, weights=kept.rows, minlength=len(names)) == 0
    gone &= ~np.isin(names, control_of(block).name)
    if not np.any(gone):
        return values
    rays = Rays.of(adjusted_start(block, full, values))
    places = np.array(values.points)
    places[full.order.row_of_point[gone]] = rays.place[gone]
    return eqx.tree_at(lambda v: v.points, values, jnp.asarray(places))


def _couples(rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,), (m,) of all pairs of rays of one point, from the image of lower number to the higher."""
    order = np.lexsort((rays.image, rays.point))
    order = order[rays.used[order]]
    point, firsts, seconds = rays.point[order], [], []
    for step in range(1, len(order)):
        same = np.flatnonzero(point[step:] == point[:-step])
        if not len(same):
            break
        firsts.append(order[same])
        seconds.append(order[same + step])
    first = np.concatenate(firsts) if firsts else np.zeros(0, int)
    second = np.concatenate(seconds) if seconds else np.zeros(0, int)
    apart = rays.image[first] != rays.image[second]
    return first[apart], second[apart]


def _by_votes(count: int, point: np.ndarray, first: np.ndarray, second: np.ndarray, vote: np.ndarray) -> np.ndarray:
    """Flags (count,) of measurements after the votes of pairs on them: 1 for, -1 against, 0 neither."""
    kept = np.ones(count, bool)
    while True:
        live = kept[first] & kept[second]
        against = np.bincount(first, live & (vote < 0), count) + np.bincount(second, live & (vote < 0), count)
        if not np.any(against):
            break
        most = np.zeros(int(point.max()) + 1)
        np.maximum.at(most, point, against)
        kept &= (against == 0) | (against < most[point])
    live = kept[first] & kept[second] & (vote > 0)
    favour = np.bincount(first, live, count) + np.bincount(second, live, count)
    judged = np.bincount(first, vote != 0, count) + np.bincount(second, vote != 0, count)
    return kept & ((favour > 0) | (judged == 0))

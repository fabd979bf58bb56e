"""Initial values of object points by ray intersection."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import sized_filter_jit
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.readout import has_readout, in_motion
from jaxgeo.sensor import FrameCamera

SIZES = (64, 1024, 65536)  # batch sizes of the ray computation
NEVER_MEETING = 1e-10  # smallest eigenvalue of the mean of I - d d': rays parallel to about 1e-5 rad


def started(
    block: Block, place: np.ndarray, row: np.ndarray, image: np.ndarray, used: np.ndarray | None = None
) -> np.ndarray:
    """Start positions (rows, 3); NaN coordinates are replaced by the intersection of the rays, also in padding rows.

    `row` and `image` are those of the measurements, `used` flags of those to use. Raises `ValueError` for a point whose
    rays do not intersect.
    """
    unknown = np.any(np.isnan(place), axis=1)
    if not np.any(unknown[row]):
        return np.where(unknown[:, None], place[row[0]], place)
    chosen = np.flatnonzero(unknown[row] if used is None else unknown[row] & used)
    if not chosen.size:
        return np.where(np.isnan(place), np.nanmean(place[row], axis=0), place)
    origin, direction = rays_of(block, chosen, image[chosen])
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    normal, right = np.zeros((len(place), 3, 3)), np.zeros((len(place), 3))
    np.add.at(normal, row[chosen], across)
    np.add.at(right, row[chosen], np.einsum("nij,nj->ni", across, origin))
    rows = np.unique(row[chosen])
    count = np.bincount(row[chosen], minlength=len(place))[rows]
    least = np.linalg.eigvalsh(normal[rows])[:, 0] / count
    if np.any(least < NEVER_MEETING):
        worst = chosen[np.argmax(row[chosen] == rows[np.argmin(least)])]
        raise ValueError(
            f"the rays of point {block.observations.point[worst]} are parallel, so that it has no place to start from; "
            f"leave it out, or give one with points=."
        )
    met = np.linalg.solve(normal[rows], right[rows][:, :, None])[:, :, 0]
    place = place.copy()
    place[rows] = np.where(np.isnan(place[rows]), met, place[rows])
    return np.where(np.isnan(place[:, :1]), place[rows[0]], place)


def of_parallel_rays(block: Block) -> np.ndarray:
    """Flags (k,) of the measurements of points whose rays are parallel, from the start orientations.

    Such points have no place, as those of images from one position. Raises `ValueError` as `rays_of`.
    """
    observations = block.observations
    image = block.images.rows_of(observations.image)
    _, point, count = np.unique(observations.point, return_inverse=True, return_counts=True)
    _, direction = rays_of(block, np.arange(len(point)), image)
    normal = np.zeros((len(count), 3, 3))
    np.add.at(normal, point, np.eye(3) - direction[:, :, None] * direction[:, None, :])
    return (np.linalg.eigvalsh(normal)[:, 0] / count < NEVER_MEETING)[point]


def rays_of(block: Block, chosen: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(perspective centres (k, 3), unit directions (k, 3) in the block's frame) of the chosen measurements, each at the
    time of its row.

    Raises `ValueError` naming image and point where the lens has no ray for a pixel.
    """
    observations, images = block.observations, block.images
    direction = np.empty((len(chosen), 3))
    for name, camera in block.cameras.items():
        own = np.flatnonzero(images.camera[image] == name)
        if own.size:
            direction[own] = camera_rays(camera, observations.uv[chosen[own]])
    lost = ~np.all(np.isfinite(direction), axis=1)
    if np.any(lost):
        row = chosen[int(np.argmax(lost))]
        raise ValueError(
            f"point {observations.point[row]} in image {observations.image[row]}: the camera sees nothing "
            f"at {observations.uv[row].tolist()} "
            f"px, as its lens folds there; is the pixel, or the lens, that of another camera?"
        )
    centre, direction = images.centre[image], np.einsum("nij,nj->ni", images.R_frame_from_camera[image], direction)
    if not has_readout(block):
        return centre, direction
    shift, turn = in_motion(block, image, observations.uv[chosen, 1])
    return centre + shift, np.einsum("nij,nj->ni", turn, direction)


def camera_rays(camera: FrameCamera, uv: np.ndarray) -> np.ndarray:
    """Unit directions (k, 3) in the camera frame of pixels (k, 2); NaN where the lens has no ray."""
    size = next((size for size in SIZES if len(uv) <= size), SIZES[-1])  # few sizes, so that few programs are compiled
    filled = np.concatenate([uv, np.repeat(uv[:1], -len(uv) % size, axis=0)])
    parts = np.split(filled, len(filled) // size)
    return np.concatenate([np.asarray(_rays(camera, jnp.asarray(part, jnp.float64))) for part in parts])[: len(uv)]


@sized_filter_jit
def _rays(camera: FrameCamera, uv: jax.Array) -> jax.Array:
    return jax.vmap(camera.ray)(uv)[0]

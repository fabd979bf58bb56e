"""Ground of image points: first hits on the terrain, and the planes that best fit the terrain around them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.adjust import LocalFrame
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.ortho.cells import height_on
from jaxgeo.ortho.rendering import met
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.ties.views import CHUNK, Views

ACROSS = 5  # positions along a side of a patch, to which a plane is fitted
STEEPEST = 0.05  # sine of the angle between line of sight and plane; flatter views show too little of it


class Planes(NamedTuple):
    """Ground planes of image points, in the frame of the views: `origin` (n, 3) in m, where the line of sight of the
    image point meets the plane; unit `normal` (n, 3) and direction `up` (n, 3) of height; and whether all is `known`.
    """

    origin: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    up: Float[np.ndarray, "n 3"]
    known: Bool[np.ndarray, " n"]


def ground_of(views: Views, row: int, uv: np.ndarray, terrain: AbstractTerrain) -> tuple[np.ndarray, np.ndarray]:
    """((n, 3) points in the frame of the views, m, flags) where lines of sight of an image meet the terrain."""
    found = met(views.inputs(row, terrain), np.asarray(uv, np.float64))
    hit = np.asarray(found.status) == Status.hit
    return np.asarray(views.frame.from_ecef(np.asarray(found.p_ecef))), hit


def planes_at(views: Views, row: int, uv: np.ndarray, terrain: AbstractTerrain, side: float) -> Planes:
    """Planes that best fit the terrain under a square of `side` pixels around each of the pixels (n, 2)."""
    points, hit = ground_of(views, row, uv, terrain)
    focal = float(np.min(np.asarray(views.camera_of(row).focal_px)))
    ranges = np.linalg.norm(points - views.centre[row], axis=1)[hit]
    reach = 0.5 * side * float(np.median(ranges)) / focal if len(ranges) else 1.0
    up, normal, lift, known = _fit_planes(views.frame, points, terrain, reach)
    centre = views.centre[row]
    foot, away = points + lift[:, None] * up, points - centre
    steep = np.sum(normal * away, axis=1)
    known = known & hit & (-steep > STEEPEST * np.linalg.norm(away, axis=1))
    along = np.sum(normal * (foot - centre), axis=1) / np.where(known, steep, 1.0)
    known &= along > 0.0
    return Planes(np.where(known[:, None], centre + along[:, None] * away, points), normal, up, known)


def _fit_planes(
    frame: LocalFrame, points: np.ndarray, terrain: AbstractTerrain, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    count = len(points)
    padded = np.resize(points, (max(-(-count // CHUNK), 1) * CHUNK, 3))
    parts = [
        _fit_chunk(frame, terrain, jnp.asarray(padded[k : k + CHUNK]), jnp.asarray(float(reach)))
        for k in range(0, len(padded), CHUNK)
    ]
    up, normal, lift, known = (np.concatenate([np.asarray(x) for x in one])[:count] for one in zip(*parts, strict=True))
    return up, normal, lift, known


@batch_filter_jit
def _fit_chunk(
    frame: LocalFrame, terrain: AbstractTerrain, points: Float[Array, "n 3"], reach: Scalar
) -> tuple[Array, Array, Array, Array]:
    t = jnp.linspace(-1.0, 1.0, ACROSS)
    steps = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(t, t)], axis=1)
    rows = jnp.concatenate([jnp.ones((ACROSS**2, 1)), steps], axis=1)

    def one(point: Vector3) -> tuple[Array, Array, Array, Array]:
        p_ecef = frame.to_ecef(point)
        position = WGS84.to_geodetic(p_ecef)
        R = R_ecef_from_enu(position)

        def lift(step: Float[Array, "2"]) -> tuple[Scalar, Array]:
            normal, height = WGS84.normal_and_height(p_ecef + reach * (R[:, :2] @ step))
            ground, _, status = height_on(terrain, normal)
            return ground - height, status == Status.hit.code

        lifts, known = jax.vmap(lift)(steps)
        share = known.astype(jnp.float64)
        matrix = (rows * share[:, None]).T @ rows + 1e-9 * jnp.eye(3)
        plane = jnp.linalg.solve(matrix, rows.T @ (share * jnp.where(known, lifts, 0.0)))
        normal = jnp.stack([-plane[1] / reach, -plane[2] / reach, jnp.ones(())])
        R_local = frame.R_ecef_from_local.T @ R
        normal = R_local @ (normal / jnp.sqrt(jnp.sum(normal**2)))
        return R_local[:, 2], normal, plane[0], jnp.sum(share) >= 0.5 * ACROSS**2

    return jax.vmap(one)(points)

"""Predicted pixels of ground points, with derivatives by orientation, camera and place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import quick_filter_jit
from jaxgeo._typing import Matrix3, Vector3
from jaxgeo.adjust.collinearity import pixel_of
from jaxgeo.adjust.values import interior_of, with_interior
from jaxgeo.sensor import FrameCamera

CHUNK = 32  # points per call: one size, so that other counts need no compilation


class Predicted(NamedTuple):
    """Pixels `uv` (n, 2) of points, their derivatives by centre in m and rotation in rad about the camera's axes
    (n, 2, 6), by all entries of the camera's interior (`interior_of`; n, 2, entries), and by the place in m (n, 2, 3);
    whether the point lies in front of the camera and in the field of its lens."""

    uv: Float[Any, "n 2"]
    by_pose: Float[Any, "n 2 6"]
    by_lens: Float[Any, "n 2 entries"]
    by_place: Float[Any, "n 2 3"]
    ahead: Bool[Any, " n"]


def predicted(
    cameras: Mapping[str, FrameCamera], camera: Any, centre: Any, R_frame_from_camera: Any, place: Any
) -> Predicted:
    """Pixels of points, each in one image: `camera` (n,) names of `cameras`, which have lenses of one kind, `centre`
    (n, 3), `R_frame_from_camera` (n, 3, 3), and `place` (n, 3), in m in one frame."""
    names = np.asarray(camera).astype(str)
    entries = len(np.asarray(interior_of(next(iter(cameras.values())))))
    pixel = len(names), 2
    found = Predicted(
        np.zeros(pixel), np.zeros((*pixel, 6)), np.zeros((*pixel, entries)), np.zeros((*pixel, 3)),
        np.zeros(len(names), bool),
    )  # fmt: skip
    for name in np.unique(names):
        rows = np.flatnonzero(names == name)
        for first in range(0, len(rows), CHUNK):
            part = rows[first : first + CHUNK]
            given = [np.asarray(x, float)[part] for x in (centre, R_frame_from_camera, place)]
            given = [np.resize(x, (CHUNK, *x.shape[1:])) for x in given]
            for whole, new in zip(found, _predicted(cameras[str(name)], *map(jnp.asarray, given)), strict=True):
                whole[part] = np.asarray(new)[: len(part)]
    return found


@quick_filter_jit
def _predicted(
    camera: FrameCamera, centre: Float[Array, "n 3"], R: Float[Array, "n 3 3"], place: Float[Array, "n 3"]
) -> Predicted:
    lens = interior_of(camera)

    def one(centre: Vector3, R: Matrix3, place: Vector3) -> tuple[Array, ...]:
        def pixel(pose: Float[Array, "6"], interior: Array, step: Vector3) -> Array:
            away = R.T @ (place + step - centre - pose[:3])
            away = away - jnp.cross(pose[3:], away)  # transposed small rotation of the camera
            return pixel_of(with_interior(camera, interior), away)

        given = jnp.zeros(6), lens, jnp.zeros(3)
        d = R.T @ (place - centre)
        ahead = d[2] > 0.0
        ahead = ahead & camera.distortion.in_field(d[:2] / jnp.where(ahead, d[2], 1.0))
        return pixel(*given), *jax.jacfwd(pixel, argnums=(0, 1, 2))(*given), ahead

    return Predicted(*jax.vmap(one)(centre, R, place))

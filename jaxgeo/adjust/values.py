"""Values of the unknowns of an adjustment, and their update by a step."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import matmul3
from jaxgeo._record import Record
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import FrameCamera

POSE = 6  # per image: shift of its perspective centre in m (frame axes), rotation in rad (camera axes)
MOUNT = 6  # per mount: boresight rotation in rad, lever arm in m (body axes)
STRIP = 6  # per strip: shift in m and drift in m/s of its positions (frame axes); 7 with a time offset in s
INTERIOR = ("focal", "aspect", "principal column", "principal row")  # px, 1, px, px


class Values(Record):
    """Values of all potential unknowns.

    `centre` (n, 3) m and `R_frame_from_camera` (n, 3, 3) of the images; `points` (rows, 3) m in the order of the
    layout; `lens` (cameras, all) interior orientation and coefficients, then the entries of `RayEffects`;
    `boresight` (mounts, 3, 3) the accumulated rotation; `lever` (mounts, 3) m; `strip` (strips, 6) m and m/s, or
    (strips, 7) with time offsets in s; `common` (k,) the standard normal numbers of the navigation errors that images
    share.
    """

    centre: Float[Array, "n 3"]
    R_frame_from_camera: Float[Array, "n 3 3"]
    points: Float[Array, "rows 3"]
    lens: Float[Array, "cameras all"]
    boresight: Float[Array, "mounts 3 3"]
    lever: Float[Array, "mounts 3"]
    strip: Float[Array, "strips of_strip"]
    common: Float[Array, " k"]


class Step(Record):
    """A change of all unknowns; for the lenses, only of the active columns."""

    pose: Float[Array, "n 6"]
    points: Float[Array, "rows 3"]
    lens: Float[Array, "cameras active"]
    mount: Float[Array, "mounts 6"]
    strip: Float[Array, "strips of_strip"]
    common: Float[Array, " k"]


def moved(values: Values, step: Step, active: tuple[int, ...]) -> Values:
    """The values after a step; rotations are composed, each about its own axes."""
    turn = jax.vmap(R_from_rotation_vector)
    lens = values.lens if not active else values.lens.at[:, jnp.array(active)].add(step.lens, unique_indices=True)
    return Values(
        centre=values.centre + step.pose[:, :3],
        R_frame_from_camera=jax.vmap(matmul3)(values.R_frame_from_camera, turn(step.pose[:, 3:])),
        points=values.points + step.points,
        lens=lens,
        boresight=jax.vmap(matmul3)(turn(step.mount[:, :3]), values.boresight),
        lever=values.lever + step.mount[:, 3:],
        strip=values.strip + step.strip,
        common=values.common + step.common,
    )


def interior_of(camera: FrameCamera) -> Float[Array, " all"]:
    """A camera's interior orientation (`INTERIOR`) and the coefficients of its lens, as one vector."""
    focal, principal = jnp.asarray(camera.focal_px), jnp.asarray(camera.principal_px)
    head = jnp.stack([focal[0], focal[1] / focal[0], principal[0], principal[1]])
    return jnp.concatenate([head, camera.distortion.coefficients()])


def with_interior(camera: FrameCamera, interior: Any) -> FrameCamera:
    """The camera with another interior orientation and lens; further entries are ignored."""
    focal = jnp.stack([interior[0], interior[0] * interior[1]])
    distortion = camera.distortion.with_coefficients(interior[4 : 4 + len(camera.distortion.names)])
    changed = (focal, interior[2:4], distortion)
    return eqx.tree_at(lambda c: (c.focal_px, c.principal_px, c.distortion), camera, changed)


def names_of_interior(camera: FrameCamera) -> tuple[str, ...]:
    """Names of the entries of `interior_of`."""
    return (*INTERIOR, *camera.distortion.names)

"""Collinearity and navigation observation equations of one image, with derivatives."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import matmul3, matvec
from jaxgeo._record import Record
from jaxgeo._typing import Matrix3, Pixel, Scalar, Vector3
from jaxgeo.adjust.values import with_interior
from jaxgeo.rotations import R_from_rotation_vector, rotation_vector_from_R
from jaxgeo.sensor import FrameCamera


def pixel_of(camera: FrameCamera, p_camera: Vector3) -> Pixel:
    """Pixel of a point in the camera frame, without the checks of `camera.project`.

    The adjustment applies those checks to its result.
    """
    return camera.principal_px + camera.focal_px * camera.distortion.distort(p_camera[:2] / p_camera[2])


def pixel_linear(
    camera: FrameCamera, lens: Any, active: tuple[int, ...], ideal: Pixel
) -> tuple[Pixel, list[Pixel], list[Pixel]]:
    """Pixel of a direction's tangents in the camera frame, with its derivatives by the tangents and by the active
    lens columns, by autodiff."""

    def pixel(ideal: Pixel, change: Any) -> Pixel:
        changed = with_interior(camera, _changed(lens, active, change))
        return changed.principal_px + changed.focal_px * changed.distortion.distort(ideal)

    # # Forward mode: reverse mode would reassemble the parameter vectors entry by entry.
    none = jnp.zeros(len(active))
    by_ideal = [jax.jvp(lambda x: pixel(x, none), (ideal,), (axis,))[1] for axis in jnp.eye(2)]
    by_lens = [jax.jvp(lambda x: pixel(ideal, x), (none,), (axis,))[1] for axis in jnp.eye(len(active))]
    return pixel(ideal, none), by_ideal, by_lens


def _changed(lens: Any, active: tuple[int, ...], change: Any) -> Any:
    """The lens with its active columns changed; entry by entry, since scattering into many short vectors is slower."""
    parts = [entry + change[active.index(i)] if i in active else entry for i, entry in enumerate(lens)]
    return jnp.stack(parts)


class ObservedRows(Record):
    """Further observations of an orientation, or of all (leading axis), with unit weights; see `PoseRows`. `by_common`
    (r, k) are in the order of the numbers that images share."""

    centre: Any
    R_frame_from_camera: Any
    offset: Any
    by_pose: Any
    by_lens: Any
    by_common: Any

    def residual(self, centre: Vector3, R: Matrix3, lens: Any, common: Float[Array, " k"]) -> Float[Array, " r"]:
        """Their residuals; `lens` is the change of the interior orientation and lens."""
        turn = rotation_vector_from_R(matmul3(self.R_frame_from_camera.T, R))
        change = jnp.concatenate([centre - self.centre, turn])
        return self.offset + self.by_pose @ change + self.by_lens @ lens + self.by_common @ common


class Observed(Record):
    """Navigation of an image, or of all (leading axis), and its mount; see `Navigation`.

    `centred_time` is s after the strip's mean time; `level` states whether the gimbal reports in local level. `common`
    (6, k) is the error of position and attitude for each of the numbers that images share. `rows` are further
    observations of the orientation, if any; `velocity` and `turn_rate` are there where time offsets are unknown.
    """

    position: Any
    R_frame_from_body: Any
    R_frame_from_reference: Any
    R_base_from_head: Any
    information_position: Any
    information_attitude: Any
    R_body_from_base: Any
    R_head_from_camera: Any
    lever_head: Any
    level: Any
    centred_time: Any
    common: Any
    rows: ObservedRows | None = None
    velocity: Any = None
    turn_rate: Any = None


def navigation_residual(
    observed: Observed,
    centre: Vector3,
    R: Matrix3,
    boresight: Matrix3,
    lever: Vector3,
    strip: Float[Array, " of_strip"],
    common: Float[Array, " k"],
    lens: Any = None,
) -> Float[Array, " rows"]:
    """Weighted residuals of position (m) and attitude (rad), predicted from an orientation less observed; with `lens`,
    the change of interior orientation and lens, also those of the further observations.

    Positions use the rigorous lever arm and the strip's shift and drift (Xue et al. 2019, Eq 4 and the G g and R r of
    Eq 5, where the lever arm's sign is that of the IMU seen from the camera). Attitudes are the rotation vector between
    the observed and predicted orientation of the reference, in its own axes (Eq 3, without the singularity of its
    angles). `common` numbers move both by the errors that images share. A time offset, the seventh number of a strip,
    moves positions by it times the velocity, and attitudes by it times the turn rate.
    """
    # # The boresight rotates base against body, or, for local level without a base, camera against head.
    before = jnp.where(observed.level, jnp.eye(3), matmul3(boresight, observed.R_body_from_base))
    R_head_from_camera = jnp.where(
        observed.level, matmul3(boresight, observed.R_head_from_camera), observed.R_head_from_camera
    )
    R_frame_from_head = matmul3(R, R_head_from_camera.T)
    R_reference_from_head = matmul3(before, observed.R_base_from_head)
    implied = matmul3(R_frame_from_head, R_reference_from_head.T)
    reported = implied
    if observed.velocity is not None:
        reported = matmul3(implied, R_from_rotation_vector(strip[6] * observed.turn_rate))
    turn = rotation_vector_from_R(matmul3(observed.R_frame_from_reference.T, reported))
    R_frame_from_body = jnp.where(observed.level, observed.R_frame_from_body, implied)
    imu = centre - matvec(R_frame_from_body, lever) - matvec(R_frame_from_head, observed.lever_head)
    shared = observed.common @ common
    off = imu + strip[:3] + observed.centred_time * strip[3:6] - observed.position - shared[:3]
    if observed.velocity is not None:
        off = off + strip[6] * observed.velocity
    turn = turn - shared[3:]
    found = [matvec(observed.information_position, off), matvec(observed.information_attitude, turn)]
    if observed.rows is not None and lens is not None:
        found.append(observed.rows.residual(centre, R, lens, common))
    return jnp.concatenate(found)


def navigation_linear(
    observed: Observed,
    centre: Vector3,
    R: Matrix3,
    boresight: Matrix3,
    lever: Vector3,
    strip: Float[Array, " of_strip"],
    common: Float[Array, " k"],
    lens: Any = None,
) -> tuple[Float[Array, " rows"], Float[Array, "rows columns"]]:
    """The same residuals and their derivatives by pose (6), mount (6), strip (6 or 7) and common numbers (k)."""

    def residual(step: Float[Array, " own"]) -> Float[Array, " rows"]:
        pose, mount, of_strip = step[:6], step[6:12], step[12:]
        return navigation_residual(
            observed,
            centre + pose[:3],
            matmul3(R, R_from_rotation_vector(pose[3:])),
            matmul3(R_from_rotation_vector(mount[:3]), boresight),
            lever + mount[3:],
            strip + of_strip,
            common,
            lens,
        )

    at = jnp.zeros(12 + strip.shape[0])
    weights = observed.information_position, observed.information_attitude
    by_common = [
        -weight @ part for weight, part in zip(weights, (observed.common[:3], observed.common[3:]), strict=True)
    ]
    if observed.rows is not None and lens is not None:
        by_common.append(observed.rows.by_common)
    return residual(at), jnp.concatenate([jax.jacfwd(residual)(at), jnp.concatenate(by_common)], axis=1)


def half_sum(x: Float[Array, "..."]) -> Scalar:
    """Half the sum of squares."""
    return 0.5 * jnp.sum(x * x)

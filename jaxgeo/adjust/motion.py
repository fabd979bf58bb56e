"""Velocities and turn rates of the platform at exposures: from a trajectory, or by differences between images."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_float64, check_is
from jaxgeo._compile import sized_filter_jit
from jaxgeo._numerics import matmul3
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.sensor import Sensor, Trajectory


def motion_by_differences(
    position: np.ndarray, R_frame_from_head: np.ndarray, R_frame_from_reference: np.ndarray, time: Any, strip: Any
) -> tuple[np.ndarray, np.ndarray]:
    """(velocities (n, 3) in m/s, frame axes; turn rates (n, 3) of the head in rad/s, axes of the reference) of images.

    Central differences over the `time` (n,) in s of neighbouring images of a strip, weighted so that a parabola is
    exact; one-sided at the ends of a strip. They are the true rates only where velocity and turn rate hardly change
    between neighbouring images: not those of turbulence, nor of a drone that stops for each image. NaN for images with
    no other time in their strip.
    """
    time, strip = np.asarray(time, np.float64), np.asarray(strip)
    velocity, turn_rate = np.full((2, len(time), 3), np.nan)
    for name in np.unique(strip):
        rows = np.flatnonzero(strip == name)
        rows = rows[np.argsort(time[rows], kind="stable")]
        dt = np.diff(time[rows])
        if len(rows) < 2 or not np.all(dt > 0.0):
            continue
        velocity[rows] = _central(np.diff(position[rows], axis=0) / dt[:, None], dt)
        turns = R_frame_from_head[rows[1:]] @ np.swapaxes(R_frame_from_head[rows[:-1]], 1, 2)
        rates = _central(_vectors(turns) / dt[:, None], dt)
        turn_rate[rows] = np.einsum("nji,nj->ni", R_frame_from_reference[rows], rates)
    return velocity, turn_rate


def _central(slopes: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """Derivatives (n, 3) at knots from the slopes (n - 1, 3) between them."""
    before, after = dt[:-1, None], dt[1:, None]
    inner = (after * slopes[:-1] + before * slopes[1:]) / (before + after)
    return np.concatenate([slopes[:1], inner, slopes[-1:]])


def _vectors(turns: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(turns).as_rotvec()


def motion_on_trajectory(
    frame: LocalFrame, sensor: Sensor, trajectory: Trajectory, time: Any
) -> tuple[np.ndarray, np.ndarray]:
    """(velocities (n, 3) of the IMU in m/s, frame axes; turn rates (n, 3) of the gimbal's head relative to the Earth in
    rad/s, axes of the gimbal's reference) at times (n,) in s. Raises `ValueError` for a time outside the trajectory."""
    check_is(trajectory, Trajectory, "trajectory")
    trajectory, time = as_float64((trajectory, time), "trajectory and time")
    time = jnp.atleast_1d(jnp.asarray(time))
    outside = ~np.asarray(jax.vmap(lambda t: trajectory.covers(t, jnp.zeros_like(t)))(time))
    if np.any(outside):
        at = float(time[int(np.argmax(outside))])
        raise ValueError(
            f"the trajectory is from {float(trajectory.start):.9g} to {float(trajectory.end):.9g} s; an image is at "
            f"{at:.9g} s. Are the times of images and trajectory on one clock?"
        )
    velocity, turn_rate = _on_trajectory(sensor, trajectory, time)
    return np.asarray(velocity) @ np.asarray(frame.R_ecef_from_local), np.asarray(turn_rate)


@sized_filter_jit
def _on_trajectory(sensor: Sensor, trajectory: Trajectory, time: Any) -> tuple[Any, Any]:
    legs, level = trajectory.legs(), sensor.gimbal.reference == "level"

    def state(moment: Any) -> tuple[Any, Any, Any]:
        station = legs.station(moment, jnp.zeros_like(moment))
        base = sensor.gimbal.R_base_from_head(station.gimbal_readings)
        if level:
            reference, head = station.R_ecef_from_level, matmul3(station.R_ecef_from_level, base)
        else:
            reference = station.R_ecef_from_body
            head = matmul3(matmul3(reference, jnp.asarray(sensor.mount.R_body_from_base)), base)
        return station.p_ecef, head, reference

    def one(moment: Any) -> tuple[Any, Any]:
        (_, head, reference), (velocity, change, _) = jax.jvp(state, (moment,), (jnp.ones_like(moment),))
        spin = matmul3(change, head.T)  # antisymmetric, of the rate in ECEF axes
        rate = jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
        return velocity, reference.T @ rate

    return jax.vmap(one)(time)


UNITS = {"velocity": "m/s", "turn_rate": "rad/s"}


def checked_motion(values: Any, count: int, name: str) -> np.ndarray | None:
    """A velocity or turn rate (n, 3) of n images, NaN where unknown. Raises `ValueError` for another shape."""
    if values is None:
        return None
    found = np.asarray(values, np.float64)
    if found.shape not in ((3,), (count, 3)) or np.any(np.isinf(found)):
        raise ValueError(
            f"{name} must be (3,) or ({count}, 3) finite numbers in {UNITS[name]}, NaN where it is not known; got "
            f"shape {found.shape}."
        )
    return np.broadcast_to(found, (count, 3)).copy()

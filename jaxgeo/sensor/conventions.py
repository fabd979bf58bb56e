"""Image and frame conventions of published oblique cameras, as complete sensors.

The papers write a detector point T' on the image side, at -f behind the projection centre; the ray of the pixel passes
through the centre along -T'. The axes are X forward, Y right, Z down at zero angles, and the line of sight of the
middle pixel in the body frame is Rx(theta) Ry(phi) [0, 0, 1].
"""

from __future__ import annotations

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64
from jaxgeo._typing import Matrix3Field, Vector3Field
from jaxgeo.sensor.camera import FrameCamera
from jaxgeo.sensor.distortion import AbstractDistortion
from jaxgeo.sensor.gimbal import Gimbal
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_LI_2020, R_HEAD_FROM_CAMERA_LI_2023, Mount
from jaxgeo.sensor.scanning import WhiskbroomCamera
from jaxgeo.sensor.sensor import Sensor

Detector = Float[Array, "... 2"]


def li_2023_sensor(
    *,
    focal_length: ArrayLike,
    pixel_pitch: ArrayLike,
    width: int,
    height: int,
    distortion: AbstractDistortion | None = None,
    R_body_from_base: Matrix3Field | None = None,
    lever_body: Vector3Field | None = None,
    lever_head: Vector3Field | None = None,
) -> Sensor:
    """Sensor of Li et al. (2023), "A target location method for aerial images through fast iteration of elevation based
    on DEM": two-axis frame, readings (outer, inner) in rad, outer positive to the right.

    Eq 1: T' = [a m, a n, -f], with m counted from the middle along X (columns of the image here) and n along Y (rows):
    uv = middle + (m, n), see `li_2023_uv`. The line of sight is [-a m, -a n, f] in head axes.
    `R_body_from_base` is the paper's INS calibration. Lengths in m.
    """
    camera = FrameCamera.from_metric(
        focal_length=focal_length, pixel_pitch=pixel_pitch, width=width, height=height, distortion=distortion
    )
    nadir = Mount.nadir(R_body_from_base=R_body_from_base, lever_body=lever_body, lever_head=lever_head)
    return Sensor(camera, Gimbal.two_axis(), _with_camera(nadir, R_HEAD_FROM_CAMERA_LI_2023))


def li_2023_sweep_sensor(
    *,
    focal_length: ArrayLike,
    pixel_pitch: ArrayLike,
    width: int,
    height: int,
    scan_start: ArrayLike,
    scan_end: ArrayLike,
    duration: ArrayLike,
    distortion: AbstractDistortion | None = None,
    R_body_from_base: Matrix3Field | None = None,
    lever_body: Vector3Field | None = None,
    lever_head: Vector3Field | None = None,
) -> Sensor:
    """The same sensor recording a whole strip: `width` pixels along the flight, `height` rows swept across it.

    `scan_start` and `scan_end` in rad are relative to the horizontal, negative below it, as printed in the paper
    (-6.44 and -18.21 deg), with the frame at readings (outer, inner) = (pi/2, inner): the line of sight is
    pi/2 + scan off nadir. The strips of Li et al. (2020), near to far end, are the same with scan = |theta| - pi/2.
    `duration` in s is that of the sweep. The scan rotates within the inner frame; if the inner angle is not zero and
    the outer frame itself scans, use a `PushbroomCamera` and a `Trajectory` with swept readings.
    """
    camera = WhiskbroomCamera.from_metric(
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        width=width,
        height=height,
        scan_start=-jnp.asarray(as_float64(scan_start, "scan_start")),
        scan_end=-jnp.asarray(as_float64(scan_end, "scan_end")),
        duration=duration,
        distortion=distortion,
    )
    nadir = Mount.nadir(R_body_from_base=R_body_from_base, lever_body=lever_body, lever_head=lever_head)
    gimbal = Gimbal.two_axis(limits=jnp.pi * jnp.array([[-1.0, 1.0], [-0.5, 0.5]]))  # the frame is about level
    return Sensor(camera, gimbal, _with_camera(nadir, R_HEAD_FROM_CAMERA_LI_2023))


def li_2023_uv(camera: FrameCamera, m: ArrayLike, n: ArrayLike) -> Detector:
    """Pixel `uv` of the detector coordinates (m, n) of Eq 1, in pixels from the middle of the detector."""
    m, n = as_float64((m, n), "(m, n)")
    return jnp.stack([(camera.width - 1) / 2.0 + m, (camera.height - 1) / 2.0 + n], axis=-1)


def li_2020_sensor(
    *,
    focal_length: ArrayLike,
    pixel_pitch: ArrayLike,
    along_flight: int,
    across_flight: int,
    distortion: AbstractDistortion | None = None,
    mirror: bool = True,
    R_body_from_base: Matrix3Field | None = None,
    lever_body: Vector3Field | None = None,
    lever_head: Vector3Field | None = None,
) -> Sensor:
    """Sensor of Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of oblique aerial
    camera": readings (depression, azimuth drive) in rad, see `Gimbal.mirror_two_axis`.

    Eq 13: T' = [a ((M + 1)/2 - i), a (j - (N + 1)/2), -f], pixel i of M = `along_flight` and j of N = `across_flight`,
    both counted from 1: the row of the image is i - 1, its column j - 1, see `li_2020_uv`. The line of sight is
    [a (i - (M + 1)/2), a ((N + 1)/2 - j), f] in head axes. Lengths in m.
    With `mirror=False` the readings are those of the paper's frame, (outer, inner) = (-theta, phi): `Gimbal.two_axis`.
    """
    camera = FrameCamera.from_metric(
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        width=across_flight,
        height=along_flight,
        distortion=distortion,
    )
    gimbal = Gimbal.mirror_two_axis() if mirror else Gimbal.two_axis()
    nadir = Mount.nadir(R_body_from_base=R_body_from_base, lever_body=lever_body, lever_head=lever_head)
    return Sensor(camera, gimbal, _with_camera(nadir, R_HEAD_FROM_CAMERA_LI_2020))


def li_2020_uv(i: ArrayLike, j: ArrayLike) -> Detector:
    """Pixel `uv` of the 1-based detector indices (i, j) of Eq 13."""
    i, j = as_float64((i, j), "(i, j)")
    return jnp.stack([j - 1.0, i - 1.0], axis=-1)


def _with_camera(mount: Mount, R_head_from_camera: Matrix3Field) -> Mount:
    return Mount(mount.R_body_from_base, R_head_from_camera, mount.lever_body, mount.lever_head)

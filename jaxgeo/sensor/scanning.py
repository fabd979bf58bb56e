"""Row-sequential cameras: rolling shutter, pushbroom, whiskbroom and panoramic cameras.

Row 0 is exposed at the time of the shot, row `v` at `line_time * v` s after it; a negative `line_time` reads from the
bottom. On a `Trajectory` each row has its own pose; from a single `Shot` all rows share one.
"""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_float64, check_finite, concrete
from jaxgeo._numerics import larger, matvec, smaller, value_and_slope
from jaxgeo._typing import Flag, Pixel, Scalar, ScalarField, ScalarLike, StatusCode, Vector3
from jaxgeo.rotations import Rx
from jaxgeo.sensor.camera import (
    AbstractCamera,
    FrameCamera,
    Numbers,
    PixelLike,
    Vector3Like,
    check_positive,
    check_size,
    inside_image,
)
from jaxgeo.sensor.distortion import AbstractDistortion
from jaxgeo.status import Status, status_where

NEWTON_STEPS = 4  # each squares the error; at the start it is a thousandth at most, due to lens distortion


class AbstractScanningCamera(AbstractCamera):
    """A camera whose row `v` is exposed `line_time * v` s after the time of the shot."""

    line_time: ScalarField

    @property
    @abc.abstractmethod
    def width(self) -> int:
        """Columns of the image."""

    @property
    @abc.abstractmethod
    def height(self) -> int:
        """Rows of the image."""

    def time_of(self, uv: PixelLike) -> Scalar:
        line_time, uv = as_float64((self.line_time, uv), "camera.time_of(uv)")
        return line_time * uv[1]

    def exposure(self) -> tuple[Scalar, Scalar]:
        line_time = as_float64(self.line_time, "line_time")
        edges = -0.5 * line_time, (self.height - 0.5) * line_time
        return smaller(*edges), larger(*edges)

    def inside(self, uv: PixelLike) -> Flag:
        """Whether a pixel position is on the image: [-0.5, width - 0.5] by [-0.5, height - 0.5]."""
        return inside_image(uv, self.width, self.height)

    def cause(self, uv: Pixel, status: StatusCode) -> StatusCode:
        """The status, with `outside_image` for a point beyond the lens's field whose approximate pixel is outside."""
        beside = (status == Status.outside_distortion_field) & ~self.inside(uv)
        return status_where(beside, Status.outside_image, status)

    def _on_image(self, uv: Pixel, status: StatusCode) -> StatusCode:
        """The status of the optics, with hit or outside_image decided by the bounds of the whole image."""
        seen = (status == Status.hit) | (status == Status.outside_image)
        beside = status_where(self.inside(uv), Status.hit, Status.outside_image.code)
        return jnp.where(seen, beside, status)


class RollingShutterCamera(AbstractScanningCamera):
    """Rolling-shutter camera: a frame camera that reads its rows one after another, `line_time` s apart."""

    frame: FrameCamera

    @classmethod
    def from_readout(cls, frame: FrameCamera, *, readout_time: ArrayLike) -> RollingShutterCamera:
        """Camera from the readout time in s of all rows, first row to the next image's first row, as in data sheets and
        calibrations; negative reads from the bottom. Raises `ValueError` for zero or a non-finite value."""
        readout_time = as_float64(_checked_time(readout_time, "readout_time"), "readout_time")
        return cls(frame=frame, line_time=readout_time / frame.height)

    @property
    def width(self) -> int:
        return self.frame.width

    @property
    def height(self) -> int:
        return self.frame.height

    def ray(self, uv: PixelLike) -> tuple[Vector3, StatusCode]:
        return self.frame.ray(uv)

    def project(self, p_camera: Vector3Like) -> tuple[Pixel, StatusCode]:
        return self.frame.project(p_camera)

    def image_at(self, p_camera: Vector3Like, time: ScalarLike) -> tuple[Pixel, Scalar, StatusCode]:
        camera, p, time = as_float64((self, p_camera, time), "camera.image_at(p_camera, time)")
        uv, status = _on_line(camera.frame, p)
        return uv, camera.time_of(uv) - time, status


class AbstractLineCamera(AbstractScanningCamera):
    """One detector line along the camera's right axis, recorded `rows` times: the height of the image.

    `optics` is a frame camera of height 1, the line with its lens; its principal point may lie off the line (forward-
    or backward-looking lines).
    """

    optics: FrameCamera
    rows: int = eqx.field(static=True)

    @property
    def width(self) -> int:
        return self.optics.width

    @property
    def height(self) -> int:
        return self.rows

    def _row_at(self, time: Scalar) -> Scalar:
        return time / jnp.where(self.line_time == 0.0, 1.0, self.line_time)  # only a traced line_time can be zero


class PushbroomCamera(AbstractLineCamera):
    """Pushbroom camera: a line camera carried over the ground by the motion of the platform."""

    @classmethod
    def from_metric(
        cls,
        *,
        focal_length: ArrayLike,
        pixel_pitch: Numbers,
        width: int,
        height: int,
        line_time: ArrayLike,
        principal_point: Numbers = (0.0, 0.0),
        distortion: AbstractDistortion | None = None,
    ) -> PushbroomCamera:
        """Line of `width` detectors recorded `height` times, `line_time` s apart; lengths in m.

        `principal_point` is the offset (right, down) of the principal point from the middle of the line.
        Raises `ValueError` as `FrameCamera.from_metric` does, and for a `line_time` of zero.
        """
        line = _line(focal_length, pixel_pitch, width, principal_point, distortion)
        return cls(optics=line, line_time=_checked_time(line_time, "line_time"), rows=check_size(height, "height"))

    def ray(self, uv: PixelLike) -> tuple[Vector3, StatusCode]:
        uv = as_float64(uv, "camera.ray(uv)")
        direction, status = self.optics.ray(jnp.stack([uv[0], 0.0 * uv[1]]))
        return direction, self._on_image(uv, status)

    def project(self, p_camera: Vector3Like) -> tuple[Pixel, StatusCode]:
        """Raises `ValueError`: the row of a point depends on the motion."""
        raise ValueError(
            "A pushbroom camera that stands still sees the same line in every row, so a point has no row. "
            "Give project a Trajectory in place of a Shot; Trajectory.steady makes one of a shot and its velocity."
        )

    def image_at(self, p_camera: Vector3Like, time: ScalarLike) -> tuple[Pixel, Scalar, StatusCode]:
        camera, p, time = as_float64((self, p_camera, time), "camera.image_at(p_camera, time)")
        on_line, status = _on_line(camera.optics, p)
        uv = jnp.stack([on_line[0], camera._row_at(time)])
        return uv, on_line[1] * camera.line_time, self._on_image(uv, status)


class WhiskbroomCamera(AbstractLineCamera):
    """Line camera that rotates while it exposes rows: a panoramic or whiskbroom camera.

    The line is parallel to the camera's right axis; the camera rotates about it, from `scan_start` at the upper edge of
    the first row to `scan_end` at the lower edge of the last (rad from the camera's forward towards its down).
    """

    scan_start: ScalarField
    scan_end: ScalarField

    @classmethod
    def from_metric(
        cls,
        *,
        focal_length: ArrayLike,
        pixel_pitch: Numbers,
        width: int,
        height: int,
        scan_start: ArrayLike,
        scan_end: ArrayLike,
        duration: ArrayLike,
        principal_point: Numbers = (0.0, 0.0),
        distortion: AbstractDistortion | None = None,
    ) -> WhiskbroomCamera:
        """Line of `width` detectors (lengths in m) that sweeps `height` rows between two angles (rad) in `duration` s.

        Raises `ValueError` as `FrameCamera.from_metric` does, for a duration that is not positive, and for a sweep of
        zero or more than a full turn.
        """
        line = _line(focal_length, pixel_pitch, width, principal_point, distortion)
        for value, name in ((scan_start, "scan_start"), (scan_end, "scan_end")):
            check_finite(value, name, "rad")
        check_positive(duration, "duration", "s", "it is the time from the first row's edge to the last's")
        given: Any = as_float64((scan_start, scan_end, duration), "WhiskbroomCamera.from_metric")
        start, end, duration = given
        known = concrete(jnp.abs(end - start))
        if known is not None and not np.all((known > 0.0) & (known <= 2.0 * np.pi)):
            raise ValueError(
                f"A sweep must turn by more than 0 and at most 2 pi rad; got {known.tolist()!r} rad from scan_start to "
                "scan_end. Are they in rad?"
            )
        rows = check_size(height, "height")
        return cls(optics=line, scan_start=start, scan_end=end, line_time=duration / rows, rows=rows)

    def scan_angle(self, row: ScalarLike) -> Scalar:
        """Scan angle in rad at a row, from the camera's forward towards its down."""
        camera, row = as_float64((self, row), "row")
        return camera.scan_start + (camera.scan_end - camera.scan_start) * ((row + 0.5) / self.rows)

    def axis(self) -> Vector3:
        """The ray in the middle of the sweep."""
        return self.ray(jnp.array([0.5 * (self.width - 1), 0.5 * (self.rows - 1)]))[0]

    def ray(self, uv: PixelLike) -> tuple[Vector3, StatusCode]:
        uv = as_float64(uv, "camera.ray(uv)")
        row = jnp.where(jnp.isfinite(uv[1]), uv[1], 0.0)
        direction, status = self.optics.ray(jnp.stack([uv[0], uv[1] - row]))  # NaN stays NaN
        return matvec(Rx(-self.scan_angle(row)), direction), self._on_image(uv, status)

    def project(self, p_camera: Vector3Like) -> tuple[Pixel, StatusCode]:
        camera, p = as_float64((self, p_camera), "camera.project(p_camera)")
        off_line = -camera.optics.principal_px[1] / camera.optics.focal_px[1]
        across, ahead = p[1] - off_line * p[2], p[2] + off_line * p[1]
        aside = (across != 0.0) | (ahead != 0.0)
        angle = jnp.arctan2(jnp.where(aside, across, 0.0), jnp.where(aside, ahead, 1.0))
        row = self._nearest_row(angle)
        for _ in range(NEWTON_STEPS):
            value, slope = value_and_slope(lambda row: camera._seen_from(p, row)[1], row)
            step = value / jnp.where(jnp.isfinite(slope) & (slope != 0.0), slope, -jnp.inf)
            row = row - jnp.where(jnp.isfinite(step), step, 0.0)
        uv, _, status = camera._image(p, row)
        has_image = (status == Status.hit) | (status == Status.outside_image)
        return jnp.where(has_image, uv, jnp.nan), camera.cause(uv, status)

    def image_at(self, p_camera: Vector3Like, time: ScalarLike) -> tuple[Pixel, Scalar, StatusCode]:
        camera, p, time = as_float64((self, p_camera, time), "camera.image_at(p_camera, time)")
        uv, rows, status = camera._image(p, camera._row_at(time))
        return uv, rows * camera.line_time, status

    def _image(self, p: Vector3, row: Scalar) -> tuple[Pixel, Scalar, StatusCode]:
        """(pixel, rows from it to the image of the point, status) at the exposure time of `row`."""
        column, rows, status = self._seen_from(p, row)
        uv = jnp.stack([column, row + 0.0 * column])
        return uv, rows, self._on_image(uv, status)

    def _seen_from(self, p: Vector3, row: Scalar) -> tuple[Scalar, Scalar, StatusCode]:
        on_line, status = _on_line(self.optics, matvec(Rx(self.scan_angle(row)), p))
        per_row = self.optics.focal_px[1] * (self.scan_end - self.scan_start) / self.rows
        return on_line[0], on_line[1] / per_row, status

    def _nearest_row(self, angle: Scalar) -> Scalar:
        """The row at an angle, taken modulo full turns nearest to the middle of the sweep."""
        middle = 0.5 * (self.scan_start + self.scan_end)
        angle = middle + jnp.mod(angle - middle + jnp.pi, 2.0 * jnp.pi) - jnp.pi
        return (angle - self.scan_start) / (self.scan_end - self.scan_start) * self.rows - 0.5


def _on_line(optics: FrameCamera, p: Vector3) -> tuple[Pixel, StatusCode]:
    """`optics.project`, with a pixel from the angles alone where it has none: behind it or outside the lens's field.

    Every point then lies on a definite side of the line, and no derivative is NaN.
    """
    uv, status = optics.project(p)
    known = jnp.all(jnp.isfinite(uv))
    beyond = (status == Status.outside_image) & ~known  # the full image may be larger than that of the optics
    status = status_where(beyond, Status.outside_distortion_field, status)
    p = jnp.where(known | ~jnp.all(jnp.isfinite(p)), jnp.array([0.0, 0.0, 1.0]), p)
    away = jnp.any(p != 0.0)
    across, ahead = jnp.where(away, p[:2], 0.0), jnp.where(away, p[2], 1.0)
    rough = optics.principal_px + optics.focal_px * jnp.arctan2(across, jnp.stack([ahead, ahead]))
    return jnp.where(known, uv, rough), status


def _line(
    focal_length: ArrayLike,
    pixel_pitch: Numbers,
    width: int,
    principal_point: Numbers,
    distortion: AbstractDistortion | None,
) -> FrameCamera:
    return FrameCamera.from_metric(
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        width=width,
        height=1,
        principal_point=principal_point,
        distortion=distortion,
    )


def _checked_time(value: ArrayLike, name: str) -> ArrayLike:
    check_finite(value, name, "s")
    known = concrete(value)
    if known is not None and np.any(known == 0.0):
        raise ValueError(f"{name} must not be zero, in s: a camera that exposes all rows at once is a FrameCamera.")
    return value

"""Camera models: pixel to ray and point to pixel. No files, no images, no terrain."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Int8, Num

from jaxgeo._checks import as_float64, by_numpy_if_known, check_finite, concrete
from jaxgeo._numerics import safe_angle, safe_norm
from jaxgeo._record import Record, has_numbers, range_text
from jaxgeo._typing import Flag, Flags, Pixel, PixelField, Scalar, ScalarLike, StatusCode, Vector3
from jaxgeo._typing import Numbers as CrowdNumbers
from jaxgeo.sensor.distortion import AbstractDistortion, NoDistortion
from jaxgeo.status import Status, status_where

IMAGE_PLANE = 1e-12  # directions this close (rad) to perpendicular to the axis count as behind the camera

if TYPE_CHECKING:  # type checkers cannot use a union of arrays and plain numbers
    Numbers: TypeAlias = Any
    PixelLike: TypeAlias = Any
    Vector3Like: TypeAlias = Any
else:
    Numbers: TypeAlias = ArrayLike | Sequence[Any]
    PixelLike: TypeAlias = Num[ArrayLike, "2"]
    Vector3Like: TypeAlias = Num[ArrayLike, "3"]


class AbstractCamera(Record):
    """Base class of cameras: pixel to ray, its inverse (point to pixel), and the exposure time of a pixel.

    The camera frame is (right, down, forward); `uv` is (column, row), with pixel centres at integers.
    """

    @abc.abstractmethod
    def ray(self, uv: PixelLike) -> tuple[Vector3, StatusCode]:
        """Unit direction of a pixel's ray in the camera frame.

        `outside_image` still has a direction, or NaN beyond the lens model's range; with any other status but `hit` the
        direction is NaN.
        """

    @abc.abstractmethod
    def project(self, p_camera: Vector3Like) -> tuple[Pixel, StatusCode]:
        """Pixel of a point or direction (any length) in the camera frame.

        `outside_image` still has a pixel, or NaN beyond the lens model's range; with any other status but `hit` the
        pixel is NaN.
        """

    @abc.abstractmethod
    def time_of(self, uv: PixelLike) -> Scalar:
        """Exposure time of a pixel, in s after the time of the shot."""

    def exposure(self) -> tuple[Scalar, Scalar] | None:
        """First and last `time_of` on the image, s; None for a camera that exposes the whole image at once."""
        return None

    def image_at(self, p_camera: Vector3Like, time: ScalarLike) -> tuple[Pixel, Scalar, StatusCode]:
        """(pixel, delay, status) of a point given in the camera frame at `time`, in s after the time of the shot.

        `delay` in s is approximately the time until the point is exposed (negative: since then), and exactly zero at
        its exposure; the pixel is valid only there. Pixel and delay are finite everywhere; see the status.
        """
        uv, status = self.project(p_camera)
        return uv, self.time_of(uv) - time, status

    def cause(self, uv: Pixel, status: StatusCode) -> StatusCode:
        """The status of `image_at`, refined by the approximate pixel of a point that has no image."""
        del uv
        return status

    def axis(self) -> Vector3:
        """Direction in the camera frame used if no pixel is given: the optical axis."""
        return jnp.array([0.0, 0.0, 1.0])


LONGEST = 10.0  # m, focal length
PITCHES = (5e-7, 1e-3)  # m


class FrameCamera(AbstractCamera):
    """Frame camera: pinhole with lens distortion; the whole image is exposed at once.

    `focal_px` along (columns, rows) and `principal_px` (column, row) in pixels; `width` and `height` in pixels.
    """

    focal_px: PixelField
    principal_px: PixelField
    distortion: AbstractDistortion
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)

    def __repr__(self) -> str:
        """Size, focal length and field of view, of several cameras their ranges; fields if they are traced."""
        if not has_numbers(self.focal_px, self.principal_px):
            return super().__repr__()
        focal = np.asarray(self.focal_px)
        fields = np.rad2deg(2.0 * np.arctan(0.5 * np.array([self.width, self.height]) / focal))
        across, down = (range_text(fields[..., axis], 2) for axis in (0, 1))
        count = f"{' x '.join(map(str, focal.shape[:-1]))} cameras, " if focal.ndim > 1 else ""
        lens = type(self.distortion).__name__
        return (
            f"{type(self).__name__}({count}{self.width} x {self.height} pixels, focal length {range_text(focal, 1)} "
            f"pixels, field of view {across} x {down} deg without distortion, {lens})"
        )

    @classmethod
    def from_metric(
        cls,
        *,
        focal_length: ArrayLike,
        pixel_pitch: Numbers,
        width: int,
        height: int,
        principal_point: Numbers = (0.0, 0.0),
        distortion: AbstractDistortion | None = None,
    ) -> FrameCamera:
        """Camera from lengths in m: `pixel_pitch` one number or (along columns, along rows).

        `principal_point` is the offset (right, down) of the principal point from the centre of the image.
        Raises `ValueError` for lengths that are not positive and finite, a focal length above 10 m or a pitch that is
        not from 0.5 um to 1 mm, or a size that is not a positive integer.

        >>> camera = jaxgeo.FrameCamera.from_metric(focal_length=0.05, pixel_pitch=4e-6, width=6000, height=4000)
        >>> across, down = camera.field_of_view()
        >>> print(camera.focal_px, f"{np.rad2deg(across):.2f} x {np.rad2deg(down):.2f} deg")
        [12500. 12500.] 26.99 x 18.18 deg
        """
        check_positive(focal_length, "focal_length", "m", "a 50 mm lens is focal_length=0.050")
        check_positive(pixel_pitch, "pixel_pitch", "m", "pixels of 5 um are pixel_pitch=5e-6")
        _check_length(focal_length, "focal_length", (0.0, LONGEST), "a 50 mm lens is focal_length=0.050")
        _check_length(pixel_pitch, "pixel_pitch", PITCHES, "pixels of 5 um are pixel_pitch=5e-6")
        _check_pair_or_number(pixel_pitch, "pixel_pitch")
        check_finite(principal_point, "principal_point", "m")
        focal_length, pitch, offset = as_float64(
            (focal_length, _array(pixel_pitch), _array(principal_point)), "FrameCamera.from_metric"
        )
        centre = _centre(check_size(width, "width"), check_size(height, "height"))
        focal_px, principal_px = by_numpy_if_known(
            lambda _, focal, pitch, offset: (focal / pitch, centre + offset / pitch), focal_length, pitch, offset
        )
        return cls.from_pixels(
            focal_px=focal_px, width=width, height=height, principal_px=principal_px, distortion=distortion
        )

    @classmethod
    def from_pixels(
        cls,
        *,
        focal_px: Numbers,
        width: int,
        height: int,
        principal_px: Numbers | None = None,
        distortion: AbstractDistortion | None = None,
    ) -> FrameCamera:
        """Camera from lengths in pixels: `focal_px` one number or (along columns, along rows).

        `principal_px` is (column, row) with pixel centres at integers, by default the centre of the image,
        ((width - 1) / 2, (height - 1) / 2). Raises `ValueError` as `from_metric` does.

        >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1280, height=960)
        >>> direction, status = camera.ray(np.array([1139.5, 479.5]))  # half a focal length right of the middle
        >>> print(np.round(direction / direction[2], 12), jaxgeo.Status(int(status)).name)
        [0.5 0.  1. ] hit
        """
        check_positive(focal_px, "focal_px", "pixels", "it is the focal length divided by the pixel pitch")
        _check_pair_or_number(focal_px, "focal_px")
        width, height = check_size(width, "width"), check_size(height, "height")
        centre = _centre(width, height) if principal_px is None else _array(principal_px)
        check_finite(centre, "principal_px", "pixels")
        distortion = NoDistortion() if distortion is None else distortion
        focal, centre, distortion = as_float64((_array(focal_px), centre, distortion), "FrameCamera.from_pixels")
        focal = by_numpy_if_known(lambda xp, focal: xp.broadcast_to(focal, (2,)), focal)
        return cls(focal, centre, distortion, width, height)

    def ray(self, uv: PixelLike) -> tuple[Vector3, StatusCode]:
        camera, uv = as_float64((self, uv), "camera.ray(uv)")
        valid = jnp.all(jnp.isfinite(uv))
        uv = jnp.where(valid, uv, camera.principal_px)
        ideal, status = camera.distortion.undistort((uv - camera.principal_px) / camera.focal_px)
        status = status_where(~valid, Status.invalid_input, status)
        failed = status != Status.hit
        v = jnp.stack([ideal[0], ideal[1], jnp.ones_like(ideal[0])])
        direction = jnp.where(failed, jnp.nan, v / safe_norm(v))
        return direction, status_where(valid & ~self.inside(uv), Status.outside_image, status)

    def project(self, p_camera: Vector3Like) -> tuple[Pixel, StatusCode]:
        camera, p = as_float64((self, p_camera), "camera.project(p_camera)")
        valid = jnp.all(jnp.isfinite(p))
        largest = jnp.max(jnp.abs(jnp.where(valid, p, 0.0)))
        ahead = valid & (p[2] > IMAGE_PLANE * largest)
        p = jnp.where(ahead, p, jnp.array([0.0, 0.0, 1.0]))
        ideal = p[:2] / p[2]
        in_field = camera.distortion.in_field(ideal)
        uv = camera.principal_px + camera.focal_px * camera.distortion.distort(jnp.where(in_field, ideal, 0.0))
        edge = camera.principal_px + camera.focal_px * camera.distortion.nearest_image(ideal)
        status = status_where(~in_field, Status.outside_distortion_field, Status.hit.code)
        status = status_where(~self.inside(jnp.where(in_field, uv, edge)), Status.outside_image, status)
        status = status_where(~ahead, Status.behind_camera, status)
        status = status_where(~valid, Status.invalid_input, status)
        return jnp.where(ahead & in_field, uv, jnp.nan), status

    def project_many(
        self, x: CrowdNumbers, y: CrowdNumbers, z: CrowdNumbers
    ) -> tuple[CrowdNumbers, CrowdNumbers, Int8[Array, "..."]]:
        """(columns, rows, statuses) of many points, as `project`, several times faster; components of any one shape."""
        valid = jnp.isfinite(x) & jnp.isfinite(y) & jnp.isfinite(z)
        ahead = valid & (z > IMAGE_PLANE * jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)))
        depth = jnp.where(ahead, z, 1.0)
        right, down = jnp.where(ahead, x, 0.0) / depth, jnp.where(ahead, y, 0.0) / depth
        in_field = jnp.ones(jnp.shape(x), bool)
        if type(self.distortion) is not NoDistortion:
            right, down, in_field = self._distorted(right, down)
        focal, principal = jnp.asarray(self.focal_px), jnp.asarray(self.principal_px)
        u, v = principal[0] + focal[0] * right, principal[1] + focal[1] * down
        inside = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        status = jnp.where(in_field, Status.hit.code, Status.outside_distortion_field.code)
        status = jnp.where(inside, status, Status.outside_image.code)
        status = jnp.where(ahead, status, Status.behind_camera.code)
        known = ahead & in_field
        u, v = jnp.where(known, u, jnp.nan), jnp.where(known, v, jnp.nan)
        return u, v, jnp.where(valid, status, Status.invalid_input.code)

    def _distorted(self, right: CrowdNumbers, down: CrowdNumbers) -> tuple[CrowdNumbers, CrowdNumbers, Flags]:
        """(distorted image-plane coordinates, whether the ideal ones are in the field of the distortion).

        Outside the field, the coordinates are those of the nearest image.
        """

        def one(x: Scalar, y: Scalar) -> tuple[Scalar, Scalar, Flag]:
            ideal = jnp.stack([x, y])
            in_field = self.distortion.in_field(ideal)
            bent = self.distortion.distort(jnp.where(in_field, ideal, 0.0))
            bent = jnp.where(in_field, bent, self.distortion.nearest_image(ideal))
            return bent[0], bent[1], in_field

        x, y, in_field = jax.vmap(one)(right.reshape(-1), down.reshape(-1))
        shape = jnp.shape(right)
        return x.reshape(shape), y.reshape(shape), in_field.reshape(shape)

    def time_of(self, uv: PixelLike) -> Scalar:
        return jnp.zeros((), jnp.float64)

    def inside(self, uv: PixelLike) -> Flag:
        """Whether a pixel position is on the image: [-0.5, width - 0.5] by [-0.5, height - 0.5]."""
        return inside_image(uv, self.width, self.height)

    def field_of_view(self) -> tuple[Scalar, Scalar]:
        """Angles of view in rad along the middle row and the middle column, edge to edge."""
        middle = _centre(self.width, self.height)
        size = jnp.array([self.width, self.height], jnp.float64)
        angles = []
        for axis in (0, 1):
            half = 0.5 * size * jnp.eye(2)[axis]
            angles.append(safe_angle(self.ray(middle - half)[0], self.ray(middle + half)[0]))
        return angles[0], angles[1]


def inside_image(uv: PixelLike, width: int, height: int) -> Flag:
    """Whether a pixel position is on an image of the given size, outer pixel edges included."""
    uv = as_float64(uv, "uv")
    return jnp.all((uv >= -0.5) & (uv <= jnp.array([width - 0.5, height - 0.5])))


def _centre(width: int, height: int) -> np.ndarray:
    return np.array([(width - 1) / 2.0, (height - 1) / 2.0])


def _array(value: Numbers) -> ArrayLike:
    return np.asarray(value) if isinstance(value, list | tuple) else value  # pyright: ignore[reportReturnType]


def check_positive(value: Numbers, name: str, unit: str, hint: str) -> None:
    check_finite(value, name, unit)
    known = concrete(value)
    if known is not None and not np.all(known > 0.0):
        raise ValueError(f"{name} must be positive, in {unit}; got {known.tolist()!r}: {hint}.")


def _check_length(value: Numbers, name: str, limits: tuple[float, float], hint: str) -> None:
    """Raises `ValueError` for a length in m that no camera has, as one in another unit."""
    known, (low, high) = concrete(value), limits
    if known is not None and not np.all((known >= low) & (known <= high)):
        raise ValueError(f"{name} must be in m, from {low:g} to {high:g}; got {known.tolist()!r}: {hint}.")


def _check_pair_or_number(value: Numbers, name: str) -> None:
    if np.shape(value) not in ((), (1,), (2,)):
        raise ValueError(f"{name} must be a number or a pair (along columns, along rows); got shape {np.shape(value)}.")


def check_size(value: int, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value <= 0:
        raise ValueError(f"{name} must be a whole number of pixels greater than zero; got {value!r}.")
    return int(value)

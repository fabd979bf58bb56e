"""Gimbal models: axis readings to head orientation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Num

from jaxgeo._checks import as_float64, by_numpy_if_known, check_finite
from jaxgeo._elementary import sine_and_cosine
from jaxgeo._numerics import matmul3, within
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Matrix3, Vector3
from jaxgeo.rotations import Components, Rx, Ry, Rz, turned_x, turned_y, turned_z

Axis: TypeAlias = Literal["x", "y", "z"]
Readings: TypeAlias = Float[Array, " axes"]
if TYPE_CHECKING:  # type checkers cannot use a union of arrays and plain numbers
    Numbers: TypeAlias = Any
    ReadingsLike: TypeAlias = Any
    ReadingsField: TypeAlias = Any
    LimitsField: TypeAlias = Any
else:
    Numbers: TypeAlias = ArrayLike | Sequence[Any]
    ReadingsLike: TypeAlias = Num[ArrayLike, " axes"]
    ReadingsField: TypeAlias = Num[ArrayLike, "... axes"]
    LimitsField: TypeAlias = Num[ArrayLike, "... axes 2"]

_ROTATIONS = {"x": Rx, "y": Ry, "z": Rz}
_TURNS = {"x": turned_x, "y": turned_y, "z": turned_z}
_RIGHT_ANGLE = math.pi / 2.0


class Gimbal(Record):
    """Gimbal with named axes in order from base to head; each axis rotates everything after it.

    Axis angle = sign * gain * (reading - offset), in rad; R_base_from_head = R_first(angle) R_second(angle) ...
    Base and head axes are (x forward, y right, z down) and coincide at zero axis angles.
    `limits` (axes, 2) bound the readings. `reference` is the frame of the reported angles: "body" (through the mount's
    R_body_from_base), or "level", where the base is north-east-down at the sensor, as drones report.

    >>> gimbal = jaxgeo.Gimbal.from_degrees(axes={"pan": "z", "tilt": "y"}, limits=[(-170.0, 170.0), (-90.0, 30.0)])
    >>> readings = gimbal.readings_from_degrees(pan=90.0, tilt=-90.0)
    >>> print(bool(gimbal.inside_limits(readings)))
    True
    >>> forward = gimbal.R_base_from_head(readings) @ np.array([1.0, 0.0, 0.0])
    >>> print(round(float(forward[2]), 6))  # the head's forward axis looks down
    1.0
    """

    axes: tuple[Axis, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    sign: ReadingsField
    gain: ReadingsField
    offset: ReadingsField
    limits: LimitsField
    reference: Literal["body", "level"] = eqx.field(static=True, default="body")

    @classmethod
    def fixed(cls) -> Gimbal:
        """Gimbal without axes: the head is the base. Its shots have no gimbal readings."""
        none = np.zeros(0)
        return cls((), (), none, none, none, np.zeros((0, 2)))

    @classmethod
    def two_axis(
        cls,
        *,
        limits: LimitsField | None = None,
        names: tuple[str, str] = ("outer", "inner"),
    ) -> Gimbal:
        """The two-axis frame of Li et al. (2020, 2023); readings (frame angle off nadir, inner angle) in rad.

        Positive outer readings point right: theta = -outer about body x, phi = inner about y, and the line of sight of
        a camera mounted `Mount.nadir()` is Rx(theta) Ry(phi) [0, 0, 1]. Default limits are +-90 deg.
        """
        limits = np.tile([-_RIGHT_ANGLE, _RIGHT_ANGLE], (2, 1)) if limits is None else limits
        return cls(("x", "y"), names, np.array([-1.0, 1.0]), np.ones(2), np.zeros(2), limits)

    @classmethod
    def mirror_two_axis(cls) -> Gimbal:
        """The drives of Li et al. (2020); readings (depression from the horizontal, azimuth drive) in rad.

        The azimuth drive turns a mirror, so the line of sight turns by twice its angle, with the null at 45 deg:
        phi = -2 (azimuth - 45 deg); theta = -(90 deg - depression). Limits: depression 0..90, azimuth 0..90 deg.
        """
        limits = np.tile([0.0, _RIGHT_ANGLE], (2, 1))
        offset = np.array([_RIGHT_ANGLE, _RIGHT_ANGLE / 2.0])
        return cls(("x", "y"), ("depression", "azimuth"), np.array([1.0, -1.0]), np.array([1.0, 2.0]), offset, limits)

    @classmethod
    def three_axis(
        cls,
        *,
        limits: LimitsField | None = None,
        reference: Literal["body", "level"] = "level",
    ) -> Gimbal:
        """Three-axis drone gimbal; readings (yaw, pitch, roll) in rad, R = Rz(yaw) Ry(pitch) Rx(roll).

        Referenced to local level by default: yaw is the true heading of the head's x axis, pitch its elevation (-90 deg
        is nadir). The camera looks along the head's x: `Mount.forward()`. Default limits: yaw +-360, pitch +-90,
        roll +-180 deg.
        """
        default = _RIGHT_ANGLE * np.array([[-4.0, 4.0], [-1.0, 1.0], [-2.0, 2.0]])
        limits = default if limits is None else limits
        return cls(("z", "y", "x"), ("yaw", "pitch", "roll"), np.ones(3), np.ones(3), np.zeros(3), limits, reference)

    @classmethod
    def from_degrees(
        cls,
        *,
        axes: Mapping[str, str],
        sign: Numbers = 1.0,
        gain: Numbers = 1.0,
        offset: Numbers = 0.0,
        limits: Numbers = (-180.0, 180.0),
        reference: str = "body",
    ) -> Gimbal:
        """General gimbal: `axes` maps names to "x", "y" or "z" in order from base to head; offset and limits in deg.

        Raises `ValueError` for an unknown axis or reference, a sign that is not +-1, a gain of zero, or limits whose
        lower bound exceeds the upper.
        """
        _check_choices(axes, reference)
        n = len(axes)
        arrays = [np.broadcast_to(np.asarray(value), (n,)) for value in (sign, gain, offset)]
        low_high = np.broadcast_to(np.asarray(limits), (n, 2))
        _check_constants(arrays, low_high)
        sign, gain, offset, low_high = as_float64((*arrays, low_high), "Gimbal.from_degrees")
        kinds = cast("tuple[Axis, ...]", tuple(axes.values()))
        reports = cast("Literal['body', 'level']", reference)
        return cls(kinds, tuple(axes), sign, gain, jnp.deg2rad(offset), jnp.deg2rad(low_high), reports)

    def readings_from_degrees(self, **readings: ArrayLike) -> Float[Array, "... axes"]:
        """Readings in rad, in axis order, from one named number (or batch) in deg per axis.

        Raises `ValueError` for a missing or unknown name, or a value that is not finite.

        >>> gimbal = jaxgeo.Gimbal.two_axis()
        >>> print(gimbal.readings_from_degrees(outer=72.0, inner=0.0))
        [1.25663706 0.        ]
        """
        if set(readings) != set(self.names):
            raise ValueError(f"This gimbal's readings are {', '.join(self.names) or 'none'}; got {sorted(readings)}.")
        for name, value in readings.items():
            check_finite(value, name, "deg")
        values = as_float64([readings[name] for name in self.names], "readings_from_degrees")
        if not values:
            return jnp.zeros(0)
        return by_numpy_if_known(lambda xp, values: xp.deg2rad(xp.stack(xp.broadcast_arrays(*values), axis=-1)), values)

    def angles(self, readings: ReadingsLike) -> Readings:
        """Axis angles in rad: sign * gain * (reading - offset)."""
        gimbal, readings = as_float64((self, readings), "gimbal_readings")
        if readings.shape != (len(self.axes),):
            raise ValueError(
                f"This gimbal has {len(self.axes)} axes ({', '.join(self.names) or 'none'}), so a shot needs readings "
                f"of shape ({len(self.axes)},); got {readings.shape}. For batches use jax.vmap."
            )
        return gimbal.sign * gimbal.gain * (readings - gimbal.offset)

    def neutral_readings(self) -> Readings:
        """Readings with zero axis angles, clipped to the limits."""
        offset, limits = as_float64((self.offset, self.limits), "gimbal")
        return within(offset, limits[:, 0], limits[:, 1])

    def R_base_from_head(self, readings: ReadingsLike) -> Matrix3:
        """Orientation of the head in the axes of the base."""
        angles = self.angles(readings)
        R = jnp.eye(3)
        for axis, angle in zip(self.axes, angles, strict=True):
            R = matmul3(R, _ROTATIONS[axis](angle))
        return R

    def base_from_head(self, readings: ReadingsLike) -> Callable[[Vector3], Vector3]:
        """Function that rotates a vector from head to base axes, axis by axis, without a matrix."""
        sines, cosines = sine_and_cosine(self.angles(readings))  # of all axes at once: less to compile

        def turned(v_head: Vector3) -> Vector3:
            v: Components = (v_head[0], v_head[1], v_head[2])
            for axis, s, c in reversed(list(zip(self.axes, sines, cosines, strict=True))):
                v = _TURNS[axis](s, c, v)
            return jnp.stack(v)

        return turned

    def inside_limits(self, readings: ReadingsLike) -> Flag:
        """Whether every reading is within its limits, bounds included."""
        limits, readings = as_float64((self.limits, readings), "gimbal_readings")
        return jnp.all((readings >= limits[:, 0]) & (readings <= limits[:, 1]))


def _check_choices(axes: Mapping[str, str], reference: str) -> None:
    for name, axis in axes.items():
        if axis not in _ROTATIONS:
            raise ValueError(f"Axis {name!r} must turn about 'x', 'y' or 'z' (forward, right, down); got {axis!r}.")
    if reference not in ("body", "level"):
        raise ValueError(f"reference must be 'body' or 'level' (north-east-down at the sensor); got {reference!r}.")


def _check_constants(arrays: list[np.ndarray], limits: np.ndarray) -> None:
    sign, gain, offset = arrays
    if not np.all(np.abs(sign) == 1.0):
        raise ValueError(f"sign must be +1 or -1 for each axis; got {sign.tolist()}.")
    check_finite(gain, "gain", "rad of axis per rad of reading")
    if np.any(gain == 0.0):
        raise ValueError(f"gain must not be zero, or the axis would not move; got {gain.tolist()}.")
    check_finite(offset, "offset", "deg")
    if not np.all(limits[:, 0] <= limits[:, 1]):
        raise ValueError(f"limits must be (lowest, highest) in deg for each axis; got {limits.tolist()}.")

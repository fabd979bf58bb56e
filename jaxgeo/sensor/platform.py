"""Sensor position and attitude: `Mount`, `Pose` and `Shot`."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_array, as_float64, by_numpy_if_known, check_finite, check_range, is_known
from jaxgeo._numerics import matmul3, safe_norm
from jaxgeo._record import Record, has_numbers, range_text
from jaxgeo._typing import Matrix3, Matrix3Field, Scalar, ScalarField, Vector3, Vector3Field
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.earth._horizon import hidden_by_earth
from jaxgeo.earth._on_host import ecef_of, normals_of
from jaxgeo.earth.geodetic import check_position
from jaxgeo.rotations import R_from_heading_pitch_roll, R_from_rotation_vector, Rx, Ry, Rz, heading_pitch_roll_from_R
from jaxgeo.sensor.gimbal import Readings, ReadingsField

# Columns: the camera's right, down and forward in head axes (x forward, y right, z down).
R_HEAD_FROM_CAMERA_NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
R_HEAD_FROM_CAMERA_FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
R_HEAD_FROM_CAMERA_LI_2020 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
R_HEAD_FROM_CAMERA_LI_2023 = np.diag([-1.0, -1.0, 1.0])
# The photogrammetric image frame is x right, y up, z backwards.
R_IMAGE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])


class Mount(Record):
    """Mounting of gimbal and camera on the platform: two rotations and two lever arms in m.

    `lever_body` runs from the IMU (the position of the pose) to the gimbal's centre, in body axes;
    `lever_head` from the gimbal's centre to the perspective centre, in head axes.
    `R_body_from_base` is not used for a gimbal referenced to local level.
    """

    R_body_from_base: Matrix3Field = eqx.field(default_factory=lambda: np.eye(3))
    R_head_from_camera: Matrix3Field = eqx.field(default_factory=lambda: np.eye(3))
    lever_body: Vector3Field = eqx.field(default_factory=lambda: np.zeros(3))
    lever_head: Vector3Field = eqx.field(default_factory=lambda: np.zeros(3))

    @classmethod
    def nadir(
        cls,
        *,
        R_body_from_base: Matrix3Field | None = None,
        lever_body: Vector3Field | None = None,
        lever_head: Vector3Field | None = None,
    ) -> Mount:
        """Camera looking along the head's z (down), with the top of its image towards the head's x (forward)."""
        return _mount(R_HEAD_FROM_CAMERA_NADIR, R_body_from_base, lever_body, lever_head)

    @classmethod
    def forward(
        cls,
        *,
        R_body_from_base: Matrix3Field | None = None,
        lever_body: Vector3Field | None = None,
        lever_head: Vector3Field | None = None,
    ) -> Mount:
        """Camera looking along the head's x (forward), with the top of its image up: drones and turrets."""
        return _mount(R_HEAD_FROM_CAMERA_FORWARD, R_body_from_base, lever_body, lever_head)


def boresight_from_degrees(*, heading: ArrayLike = 0.0, pitch: ArrayLike = 0.0, roll: ArrayLike = 0.0) -> Matrix3:
    """`R_body_from_base = Rz(heading) Ry(pitch) Rx(roll)` from angles in deg, small or large.

    Li et al. (2023) call it the INS-to-gimbal calibration. Raises `ValueError` beyond +-360 deg.
    """
    for value, name in ((heading, "heading"), (pitch, "pitch"), (roll, "roll")):
        check_range(value, f"boresight {name}", "deg", -360.0, 360.0)
    given = as_float64((heading, pitch, roll), "boresight_from_degrees")
    return R_from_heading_pitch_roll(*by_numpy_if_known(lambda xp, *angles: tuple(map(xp.deg2rad, angles)), *given))


class Deflection(Record):
    """Deflection of the vertical: the astronomic zenith is `xi` rad north and `eta` rad east of the ellipsoidal zenith.

    xi is astronomic minus geodetic latitude; eta is the same for longitude, times the cosine of latitude. An inertial
    system is levelled by gravity; in mountains the deflection reaches about 30 arc seconds, 9 m at 60 km.
    """

    xi: ScalarField
    eta: ScalarField

    @classmethod
    def from_arcseconds(cls, *, xi: ArrayLike, eta: ArrayLike) -> Deflection:
        """Deflection from arc seconds, as in geoid models. Raises `ValueError` beyond +-200 arc seconds."""
        for value, name in ((xi, "xi"), (eta, "eta")):
            check_range(value, name, "arc seconds", -200.0, 200.0)
        given: Any = as_float64((xi, eta), "Deflection.from_arcseconds")
        return cls(*(jnp.deg2rad(angle / 3600.0) for angle in given))

    @property
    def R_ned_from_level(self) -> Matrix3:
        """Smallest rotation from the gravity-levelled frame to north-east-down of the ellipsoid.

        It keeps north in the meridian: reduce an astronomic heading to a geodetic one first (Laplace: subtract
        eta tan(lat)).
        """
        xi, eta = as_float64((self.xi, self.eta), "deflection")
        return R_from_rotation_vector(jnp.stack([eta, -xi, jnp.zeros_like(xi)]))


class Pose(Record):
    """Position of the IMU and attitude of the body (forward, right, down); angles in rad, heading from true north.

    R_ned_from_body = Rz(heading) Ry(pitch) Rx(roll): positive is nose right, nose up, right wing down. With a
    `deflection` the attitude is relative to the gravity-levelled frame, as inertial systems report it.
    """

    position: Geodetic
    heading: ScalarField = 0.0
    pitch: ScalarField = 0.0
    roll: ScalarField = 0.0
    deflection: Deflection | None = None

    def __repr__(self) -> str:
        """Position and attitude in deg and m, or their ranges; fields if they are traced."""
        at, turned = self.position, (self.heading, self.pitch, self.roll)
        if not isinstance(at, Geodetic) or not has_numbers(at.lat, at.lon, at.height, *turned):
            return super().__repr__()
        place = (np.rad2deg(np.asarray(at.lat)), np.rad2deg(np.asarray(at.lon)), np.asarray(at.height))
        angles = tuple(np.rad2deg(np.asarray(angle)) for angle in turned)
        lat, lon, height = (range_text(one, digits) for one, digits in zip(place, (7, 7, 2), strict=True))
        heading, pitch, roll = (range_text(one, 3) for one in angles)
        shape = np.broadcast_shapes(*(np.shape(one) for one in (*place, *angles)))
        count = f"{' x '.join(map(str, shape))} poses, " if shape else ""
        more = "" if self.deflection is None else ", with a deflection of the vertical"
        return (
            f"Pose({count}lat {lat}, lon {lon} deg, height {height} m, heading {heading}, pitch {pitch}, roll {roll} "
            f"deg{more})"
        )

    @classmethod
    def from_degrees(
        cls,
        *,
        lat: ArrayLike,
        lon: ArrayLike,
        height: ArrayLike,
        heading: ArrayLike = 0.0,
        pitch: ArrayLike = 0.0,
        roll: ArrayLike = 0.0,
        deflection: Deflection | None = None,
    ) -> Pose:
        """Pose from degrees and m above the ellipsoid; shapes may carry a batch axis.

        Raises `ValueError` for a heading outside [-360, 360], a pitch outside [-90, 90], a roll outside [-180, 180]
        deg, and as `Geodetic.from_degrees` does.

        >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1300.0, heading=90.0, pitch=5.0, roll=0.0)
        >>> nose = pose.R_ned_from_body @ np.array([1.0, 0.0, 0.0])
        >>> print(f"{nose[1]:.4f} east, {-nose[2]:.4f} up")
        0.9962 east, 0.0872 up
        """
        position = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
        check_range(heading, "heading", "deg", -360.0, 360.0)
        check_range(pitch, "pitch", "deg", -90.0, 90.0)
        check_range(roll, "roll", "deg", -180.0, 180.0)
        angles = as_float64((heading, pitch, roll), "Pose.from_degrees(heading, pitch, roll)")
        heading, pitch, roll = (jnp.deg2rad(angle) for angle in angles)
        return cls(position, heading, pitch, roll, deflection)

    @classmethod
    def from_omega_phi_kappa(
        cls,
        position: Geodetic,
        omega: ScalarField,
        phi: ScalarField,
        kappa: ScalarField,
        *,
        convergence: ScalarField = 0.0,
    ) -> Pose:
        """Pose from omega, phi, kappa in a map grid, all in rad.

        R_map_from_image = Rx(omega) Ry(phi) Rz(kappa), with the image frame (right, up, out of the scene) and the map
        frame (easting, northing, up). `convergence` is the grid convergence at the position, positive if grid north is
        clockwise of true north. The camera has this orientation with `Gimbal.fixed()` and `Mount.nadir()`.
        """
        omega, phi, kappa, convergence = as_float64((omega, phi, kappa, convergence), "from_omega_phi_kappa")
        R_map_from_image = Rx(omega) @ Ry(phi) @ Rz(kappa)
        R_map_from_camera = R_map_from_image @ R_IMAGE_FROM_CAMERA
        R_ned_from_body = R_ned_from_map(convergence) @ R_map_from_camera @ R_HEAD_FROM_CAMERA_NADIR.T
        return cls(position, *heading_pitch_roll_from_R(R_ned_from_body))

    @classmethod
    def looking_at(cls, *, position: Geodetic, point: Geodetic, roll: ScalarField = 0.0) -> Pose:
        """Pose at `position` whose body x axis points at `point`; with `Mount.forward()` so does the camera.

        Ignores lever arms and boresight; `jaxgeo.sensor.point_shot` includes them, with a gimbal. Raises `ValueError`
        for a concrete point that the Earth hides from the position.
        """
        check_position(position, "position")
        check_position(point, "point")
        _check_above_horizon(position, point)
        position, point, roll = as_float64((position, point, roll), "Pose.looking_at")
        sight = R_ecef_from_ned(position).T @ (WGS84.to_ecef(point) - WGS84.to_ecef(position))
        north, east, down = sight
        upright = (north == 0.0) & (east == 0.0)
        heading = jnp.arctan2(jnp.where(upright, 0.0, east), jnp.where(upright, 1.0, north))
        return cls(position, heading, jnp.arctan2(-down, safe_norm(sight[:2])), roll)

    @property
    def R_ned_from_body(self) -> Matrix3:
        """Attitude as a rotation from body axes to north-east-down at the position."""
        heading, pitch, roll = as_float64((self.heading, self.pitch, self.roll), "pose")
        R_level_from_body = R_from_heading_pitch_roll(heading, pitch, roll)
        return R_level_from_body if self.deflection is None else matmul3(self.R_ned_from_level, R_level_from_body)

    @property
    def R_ned_from_level(self) -> Matrix3:
        """Rotation from the levelled frame of the attitude to north-east-down of the ellipsoid."""
        return jnp.eye(3) if self.deflection is None else self.deflection.R_ned_from_level

    def to_omega_phi_kappa(self, *, convergence: ScalarField = 0.0) -> tuple[Scalar, Scalar, Scalar]:
        """(omega, phi, kappa) in rad as in `from_omega_phi_kappa`, with phi in [-pi/2, pi/2]."""
        convergence = as_float64(convergence, "convergence")
        R_map_from_camera = R_ned_from_map(convergence).T @ self.R_ned_from_body @ R_HEAD_FROM_CAMERA_NADIR
        R = R_map_from_camera @ R_IMAGE_FROM_CAMERA.T
        # R = Rx(omega) Ry(phi) Rz(kappa) is the transpose of a heading-pitch-roll matrix with opposite signs.
        kappa, phi, omega = heading_pitch_roll_from_R(R.T)
        return -omega, -phi, -kappa


def _check_above_horizon(position: Geodetic, point: Geodetic) -> None:
    """Raise `ValueError` for a known point that the Earth hides from a known position; compiles nothing."""
    if not is_known((position, point)) or any(np.ndim(x) for x in jax.tree.leaves((position, point))):
        return
    origin, p_ecef = (ecef_of(normals_of(float(at.lat), float(at.lon)), float(at.height)) for at in (position, point))
    if hidden_by_earth(origin, p_ecef, np):
        raise ValueError(
            f"point is {np.linalg.norm(p_ecef - origin) / 1000.0:,.0f} km from position, below the horizon: the Earth "
            "is between them. Are latitude and longitude of one of them exchanged?"
        )


class Shot(Record):
    """One exposure: pose of the platform, gimbal readings (rad, in axis order) and time (s)."""

    pose: Pose
    gimbal_readings: ReadingsField = eqx.field(
        default_factory=lambda: np.zeros(0), converter=partial(as_array, name="gimbal_readings")
    )
    time: ScalarField = 0.0


class Station(NamedTuple):
    """A shot in ECEF: position in m, orientations of body and local level, gimbal readings in rad."""

    p_ecef: Vector3
    R_ecef_from_body: Matrix3
    R_ecef_from_level: Matrix3
    gimbal_readings: Readings

    @classmethod
    def of(cls, shot: Shot) -> Station:
        """The station of a shot."""
        given: Any = as_float64((shot.pose, shot.gimbal_readings), "shot")
        pose, readings = given
        R = R_ecef_from_ned(pose.position)
        R_ecef_from_body, R_ecef_from_level = (
            matmul3(R, local) for local in (pose.R_ned_from_body, pose.R_ned_from_level)
        )
        return cls(WGS84.to_ecef(pose.position), R_ecef_from_body, R_ecef_from_level, readings)


def R_ned_from_map(convergence: Scalar) -> Matrix3:
    """Rotation from (easting, northing, up) of a grid to north-east-down; `convergence` is positive clockwise."""
    R_gridned_from_map = jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Rz(convergence) @ R_gridned_from_map


def _mount(
    R_head_from_camera: np.ndarray,
    R_body_from_base: Matrix3Field | None,
    lever_body: Vector3Field | None,
    lever_head: Vector3Field | None,
) -> Mount:
    for lever, name in ((lever_body, "lever_body"), (lever_head, "lever_head")):
        check_finite(np.zeros(3) if lever is None else lever, name, "m")
    return Mount(
        np.eye(3) if R_body_from_base is None else R_body_from_base,
        R_head_from_camera,
        np.zeros(3) if lever_body is None else lever_body,
        np.zeros(3) if lever_head is None else lever_head,
    )

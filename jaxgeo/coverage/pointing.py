"""Gimbal readings that point a pixel at a ground point or hold a line of sight."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from jaxgeo._arguments import check_latitude, check_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_array, as_float64, check_is
from jaxgeo._compile import batch_filter_jit, quick_filter_jit
from jaxgeo._intersection import FIRST_HIT, hidden_or, visibility
from jaxgeo._numerics import matvec
from jaxgeo._record import Record
from jaxgeo._typing import ScalarField, StatusCode, StatusField
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.observation import accepts_exposure
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.sensor.aiming import Aimed, aim, aim_along
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import ReadingsField
from jaxgeo.sensor.line_of_sight import LineOfSight, Target
from jaxgeo.sensor.pointing import check_axes, for_each_knot
from jaxgeo.sensor.root_finder import check_solver
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain

HIDDEN_TOLERANCE = 0.01  # m: ground this far before the target hides it


class Pointing(Record):
    """Pointing solution: gimbal `readings` in rad, pointing error `miss` in rad, and a `Status`.

    `hit`; `hidden_by_terrain` (the readings are valid, but nearer ground is in the way), or why visibility is
    undecided; `below_horizon` (the readings are valid, but the Earth is in the way, whatever the terrain);
    `outside_gimbal_range` (the readings are the nearest within the limits, `miss` their pointing error; with long lever
    arms and a target at 50 m, other readings on the limits may be some 1e-5 rad nearer). With any other status, such as
    `not_converged` of a given solver, the readings are NaN.
    """

    readings: ReadingsField
    miss: ScalarField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the pixel is on the target and no known terrain hides it."""
        return jnp.asarray(self.status) == Status.hit


@accepts_exposure
def point_gimbal(
    sensor: Sensor,
    shot: Shot | Trajectory,
    *,
    target: Geodetic | LineOfSight,
    uv: Numbers | None = None,
    readings: Numbers | None = None,
    terrain: AbstractTerrain | None = None,
    atmosphere: Atmosphere | None = None,
    solver: Any = None,
) -> Pointing:
    """Gimbal readings that put the optical axis, or pixel `uv`, on a `target`: a point, or a `LineOfSight`.

    Accounts for lever arms, boresight, gains, offsets, limits, distortion and, if given, the atmosphere. Of `shot` only
    the pose is used. Of the two solutions of a two-axis gimbal, the one with the least rotation from zero angles, or
    from `readings`, is returned. With more than two axes, those that move the line of sight least (such as the roll of
    a drone's gimbal) keep their start readings. An axis parallel to the line of sight is undetermined and keeps its
    reading. With a `terrain` (and a point), ground more than 1 cm before the target hides it.

    `solver` finds the root, starting from the closed form, within the limits: an `optimistix` root finder or
    least-squares solver, or the package's `FixedNewton()`. By default a single pointing of concrete values uses
    `optimistix.Newton`, whose first call takes a fifth of the processor time; batches inside `vmap` and `jit`, and the
    knots of a `Trajectory`, use `FixedNewton`, which takes 0.4 to 0.8 of the time there. All find the same readings.
    The status is `not_converged` if the solver misses a target within reach.

    A shot gives one `Pointing` (use `jax.vmap` for many); a `Trajectory` gives one per knot, each started from the one
    before, so that axes do not jump. Its `target` is one for all knots, or has a leading axis of knots; apply the
    readings with `trajectory.with_readings`. First and second derivatives are those of the implicit function.
    Raises `TypeError` and `ValueError` for a gimbal without axes and for arguments of the wrong type or shape; an
    unreachable target sets the status.

    >>> from jaxgeo import coverage
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> gimbal = jaxgeo.Gimbal.two_axis(limits=np.deg2rad([[-60.0, 60.0], [-5.0, 5.0]]))
    >>> sensor = jaxgeo.Sensor(camera, gimbal, jaxgeo.Mount.nadir())
    >>> shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=3000.0), np.zeros(2))
    >>> target = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.1, height=600.0)
    >>> aimed = coverage.point_gimbal(sensor, shot, target=target)
    >>> outer, inner = np.rad2deg(aimed.readings)
    >>> print(f"outer {outer:.2f} deg, {np.rad2deg(aimed.miss):.2f} deg short: {jaxgeo.Status(int(aimed.status)).name}")
    outer 60.00 deg, 12.46 deg short: outside_gimbal_range
    """
    check_axes(sensor.gimbal)
    check_solver(solver)
    sensor, shot, _ = checked_exposure(sensor, shot, None)
    if not isinstance(target, Geodetic | LineOfSight):
        raise TypeError(
            f"target must be a Geodetic point or a LineOfSight; got {type(target).__name__}. Of a Fix, fix.position."
        )
    if terrain is not None:
        check_terrain(terrain, FIRST_HIT)
        check_is(
            target, Geodetic, "target", "With a terrain it must be a point: leave the terrain out for a direction."
        )
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((target, uv, readings), "point")
    target, uv, start = given
    if isinstance(target, Geodetic):
        check_latitude(target, "target")
    elif isinstance(shot, Shot) and jnp.shape(target.ned) != (3,):
        raise ValueError(
            f"target.ned must be one vector (3,); got shape {jnp.shape(target.ned)}. Use jax.vmap for many."
        )
    air = checked_air(atmosphere)
    if isinstance(shot, Shot):
        found = aim(sensor, shot.pose, target, uv, start, air, solver)
        return _judged(sensor, shot.pose, target, found, terrain, air)
    return _pointed_along(sensor, shot.poses, for_each_knot(shot, target, "target"), uv, start, terrain, air, solver)


@accepts_exposure
def line_of_sight(sensor: Sensor, shot: Shot, *, uv: Numbers | None = None) -> LineOfSight:
    """Line of sight (north-east-down) of the optical axis of a shot, or of pixel `uv`; a target for `point_gimbal`."""
    check_is(shot, Shot, "shot", "Of a Trajectory, trajectory.at(time) is one.")
    given: Any = checked_exposure(sensor, shot, None)
    sensor, shot, _ = given
    pixel: Any = as_float64(as_array(uv, "uv"), "uv")
    sight = sensor.camera.axis() if pixel is None else sensor.camera.ray(pixel)[0]
    return LineOfSight(matvec(sensor.R_ned_from_camera(shot), sight))


@batch_filter_jit
def _pointed_along(
    sensor: Sensor,
    poses: Pose,
    targets: Target,
    uv: Array | None,
    start: Array | None,
    terrain: AbstractTerrain | None,
    air: Atmosphere | None,
    solver: Any,
) -> Pointing:
    found = aim_along(sensor, poses, targets, uv, start, air, solver)
    return jax.vmap(lambda pose, target, one: _judged(sensor, pose, target, one, terrain, air))(poses, targets, found)


def _judged(
    sensor: Sensor,
    pose: Pose,
    target: Target,
    found: Aimed,
    terrain: AbstractTerrain | None,
    air: Atmosphere | None,
) -> Pointing:
    """The pointing solution with its visibility over the terrain."""
    status = found.status
    if terrain is not None and isinstance(target, Geodetic):
        status = hidden_or(status, _in_sight(sensor, pose, target, found.readings, terrain, air))
    return Pointing(found.readings, found.miss, status)


@quick_filter_jit
def _in_sight(
    sensor: Sensor, pose: Pose, target: Geodetic, readings: Array, terrain: AbstractTerrain, air: Atmosphere | None
) -> StatusCode:
    is_finite = jnp.all(jnp.isfinite(readings))
    centre = sensor.perspective_centre(Shot(pose, jnp.where(is_finite, readings, sensor.gimbal.neutral_readings())))
    return visibility(centre, WGS84.to_ecef(target), terrain, jnp.asarray(HIDDEN_TOLERANCE), air)


def compensate(
    sensor: Sensor, before: Shot, after: Shot | Trajectory, *, uv: ArrayLike | None = None, solver: Any = None
) -> Pointing:
    """Readings that give shot `after` the same line of sight (north-east-down) as shot `before`.

    The gimbal compensates attitude changes between two exposures, so that the image does not move. Of `after` only the
    poses are used; the search starts from the readings of `before`. The result is exact; Eqs 25-26 of Li et al. (2020)
    are exact only for an inner angle of zero (see `li_2020_compensation`). The corrections are `pointing.readings -
    before.gimbal_readings`. `solver` and exceptions as for `point_gimbal`.
    """
    wanted = line_of_sight(sensor, before, uv=uv)
    return point_gimbal(sensor, after, target=wanted, uv=uv, readings=before.gimbal_readings, solver=solver)

"""Where to turn the gimbal: readings that look at a place on the ground, or keep a line of sight."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from jaxgeo._arguments import check_latitude, check_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_array, as_float64, check_is
from jaxgeo._numerics import matvec
from jaxgeo._record import Record
from jaxgeo._typing import ScalarField, StatusCode, StatusField
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.locate import FIRST_HIT, visibility
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.sensor.aiming import Aimed, LineOfSight, Target, aim, aim_along
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import ReadingsField
from jaxgeo.sensor.pointing import check_axes, for_each_knot
from jaxgeo.sensor.root_finder import check_solver
from jaxgeo.status import Status, first_failure
from jaxgeo.terrain import AbstractTerrain

HIDDEN_TOLERANCE = 0.01  # m before the target at which ground that is met hides it


class Pointing(Record):
    """Where a gimbal is to go: `readings` in rad, the angle `miss` in rad by which they are off, and a `Status`.

    `hit`; `hidden_by_terrain` (the readings hold, but nearer ground is in the way), or why the terrain cannot tell;
    `outside_gimbal_range` (the readings are the nearest within the limits, `miss` how far off that is; with long lever
    arms and a target at 50 m, another place on the limits may come some 1e-5 rad nearer). With any other
    status, as `not_converged` of a solver that a caller chose, the readings are NaN.
    """

    readings: ReadingsField
    miss: ScalarField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the target comes under the pixel and nothing that is known hides it."""
        return jnp.asarray(self.status) == Status.hit


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

    Lever arms, boresight, gains, offsets, limits, distortion and, if given, the air are allowed for. Of `shot` only the
    pose counts. Of the two ways in which two axes can look at a point, it is the one less turned from angles of zero,
    or from `readings`, at which axes that are not needed are held (of more than two, those that move the line of sight
    least, like the roll of a drone's gimbal). Where the line of sight lies along an axis, which nothing then
    determines, that axis stays where it is. With a `terrain` (and a point), ground more than 1 cm before the target
    hides it.

    `solver` finds the root, started from the closed form and kept within the limits: an `optimistix` root finder or
    least-squares solver, or `FixedNewton()`, the package's own. By default a single pointing of known values goes by
    `optimistix.Newton`, whose first call takes a fifth of the processor time; batches inside `vmap` and `jit`, and the
    knots of a `Trajectory`, go by `FixedNewton`, which takes 0.4 to 0.8 of the time there. All find the same readings.
    A solver that ends off a target that is in reach has the status `not_converged`.

    One shot gives one `Pointing`, and `jax.vmap` many; a `Trajectory` one for each knot, each started from the one
    before, so that axes do not jump: its `target` is one for all knots, or of a leading axis of knots; put the readings
    on it with `trajectory.with_readings`. Derivatives, first and second, are those of the implicit function.
    Raises `TypeError` and `ValueError` for a gimbal without axes and for arguments of the wrong kind or shape; what
    cannot be reached has a status.

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


def line_of_sight(sensor: Sensor, shot: Shot, *, uv: Numbers | None = None) -> LineOfSight:
    """Line of sight (north-east-down) of the optical axis of a shot, or of pixel `uv`; a target for `point_gimbal`."""
    check_is(shot, Shot, "shot", "Of a Trajectory, trajectory.at(time) is one.")
    given: Any = checked_exposure(sensor, shot, None)
    sensor, shot, _ = given
    pixel: Any = as_float64(as_array(uv, "uv"), "uv")
    sight = sensor.camera.axis() if pixel is None else sensor.camera.ray(pixel)[0]
    return LineOfSight(matvec(sensor.R_ned_from_camera(shot), sight))


@eqx.filter_jit
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
    """With whether the terrain leaves the target in sight."""
    status = found.status
    if terrain is not None and isinstance(target, Geodetic):
        status = first_failure(status, _in_sight(sensor, pose, target, found.readings, terrain, air))
    return Pointing(found.readings, found.miss, status)


@eqx.filter_jit
def _in_sight(
    sensor: Sensor, pose: Pose, target: Geodetic, readings: Array, terrain: AbstractTerrain, air: Atmosphere | None
) -> StatusCode:
    is_finite = jnp.all(jnp.isfinite(readings))
    centre = sensor.perspective_centre(Shot(pose, jnp.where(is_finite, readings, sensor.gimbal.neutral_readings())))
    return visibility(centre, WGS84.to_ecef(target), terrain, jnp.asarray(HIDDEN_TOLERANCE), air)


def compensate(
    sensor: Sensor, before: Shot, after: Shot | Trajectory, *, uv: ArrayLike | None = None, solver: Any = None
) -> Pointing:
    """Readings with which the shot `after` looks in the very direction (north-east-down) of the shot `before`.

    So the attitude's changes between two exposures do not move the image: the gimbal takes them up. Of `after` only the
    poses count; the search starts from the readings of `before`. Exact, where Eqs 25-26 of Li et al. (2020) are so only
    for an inner angle of zero (see `li_2020_compensation`). The corrections are `pointing.readings -
    before.gimbal_readings`. `solver` as for `point_gimbal`, and raises as it.
    """
    wanted = line_of_sight(sensor, before, uv=uv)
    return point_gimbal(sensor, after, target=wanted, uv=uv, readings=before.gimbal_readings, solver=solver)

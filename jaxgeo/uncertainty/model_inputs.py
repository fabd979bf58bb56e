"""One look at the ground: all that a fix depends on, and where it comes down."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxgeo._arguments import check_terrain, checked_air, checked_observation
from jaxgeo._checks import as_float64
from jaxgeo._numerics import implicit_root, matvec, safe_norm, tree_where
from jaxgeo._record import Record
from jaxgeo._typing import Matrix3, PixelField, Scalar, StatusCode, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT, has_point, located_anywhere, met_by, touched_by
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.sensor.platform import Pose, Station
from jaxgeo.status import Status, counts_as_fix, seen_beside
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem, FirstHit
from jaxgeo.terrain.polish import polish

KNOTS = 8  # of a trajectory about an exposure, within which an error of its time leaves a look
FARTHER = 1000.0  # m


class Sightline(NamedTuple):
    """A line of sight as the sensor gives it, straight, and whether it does."""

    ray: Ray
    status: StatusCode


class Sweep(NamedTuple):
    """Offsets from a `NominalFix` in east, north, up, m: of the intersection of a line of sight with the surface of the
    same cell (`facet`), and of its points at the same range (`line`) and `FARTHER` behind it; and the height of the
    terrain at the fix above it, m. The error ellipse is made of them, before and after a slope turns it.
    """

    facet: Float[Array, "3 *axes"]
    line: Float[Array, "3 *axes"]
    farther: Float[Array, "3 *axes"]
    ground: Float[Array, "*axes"]


class NominalFix(NamedTuple):
    """Where a look comes down: its fix, the cell of the terrain there, and the frame in which misses are counted.

    `distance` in m is the range along the ray, `direction_enu` that of the ray as it arrives, `R_ecef_from_enu` the
    frame at the fix. Where there is no fix, a stand-in keeps all numbers but the fix's finite.
    """

    fix: Fix
    p_ecef: Vector3
    distance: Scalar
    cell: Int[Array, "2"]
    direction_enu: Vector3
    R_ecef_from_enu: Matrix3

    def offset_of(
        self, line: Sightline, terrain: AbstractTerrain, air: Atmosphere | None, search: AbstractSearch
    ) -> tuple[Vector3, StatusCode]:
        """(offset of the fix of a line of sight from this one in east, north, up here, m; status)."""
        ray, status = line
        if isinstance(search, FirstHit) and isinstance(terrain, Dem) and air is None:
            p_ecef, status = touched_by(ray, status, terrain, search)
            found = has_point(status)
        else:
            fix, _ = met_by(ray, status, terrain, search, air)
            p_ecef, found, status = fix.ecef, fix.found, jnp.asarray(fix.status)
        offset = jnp.where(found, p_ecef - self.p_ecef, 0.0)
        return matvec(self.R_ecef_from_enu.T, offset), status

    def require_fix(self) -> None:
        """Raise `ValueError` unless there is a fix, of a look that is not traced, whose ground is the first met."""
        code = jnp.asarray(self.fix.status)
        if not bool(counts_as_fix(code)):
            status = Status(int(code))
            raise ValueError(f"there is no fix to be sure of: {status.name}: {status.message}")


if TYPE_CHECKING:
    OptionalPixel: TypeAlias = Any
    OptionalTerrain: TypeAlias = Any
else:
    OptionalPixel: TypeAlias = PixelField | None
    OptionalTerrain: TypeAlias = AbstractTerrain | None


class ModelInputs(Record):
    """Inputs of the forward model that error sources perturb: an exposure, a pixel of it, and the terrain.

    `uv` is None where the exposure as a whole is meant, `terrain` where nothing depends on the ground. Made from user
    arguments by `ModelInputs.of`, which checks them.
    """

    exposure: Exposure
    uv: OptionalPixel = None
    terrain: OptionalTerrain = None

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        shot: Shot | Trajectory,
        uv: ArrayLike | Sequence[ArrayLike],
        terrain: AbstractTerrain,
        *,
        time: ArrayLike | None = None,
        search: AbstractSearch = FIRST_HIT,
        atmosphere: Atmosphere | None = None,
    ) -> ModelInputs:
        """Inputs of `jaxgeo.locate` for pixel `uv`, with its arguments and errors.

        Of a trajectory the knots about the exposure are kept.
        """
        check_terrain(terrain, search)
        given: Any = checked_observation(sensor, shot, time, uv)
        sensor, motion, moment, pixel = given
        if isinstance(motion, Trajectory):
            motion = motion.about(moment, sensor.camera.time_of(pixel), KNOTS)
        # A plain number would be a constant of the program, which then is compiled for every other one.
        terrain = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64) if isinstance(x, float | int) else x, terrain)
        return cls(Exposure(sensor, motion, moment, checked_air(atmosphere)), pixel, terrain)

    @property
    def sensor(self) -> Sensor:
        """The sensor of the exposure."""
        return self.exposure.sensor

    @property
    def motion(self) -> Shot | Trajectory:
        """The shot or trajectory of the exposure."""
        return self.exposure.motion

    @property
    def time(self) -> Any:
        """The time of the exposure, s."""
        return self.exposure.time

    @property
    def air(self) -> Atmosphere | None:
        """The atmosphere of the exposure."""
        return self.exposure.atmosphere

    def ground(self, search: AbstractSearch) -> Fix:
        """The fix, whether or not the pixel lies on the image."""
        return self._located(search)[0]

    def nominal_fix(self, search: AbstractSearch) -> NominalFix:
        """Where the look comes down; without derivatives."""
        return _aim(self, search)

    def linear_offset(self, aim: NominalFix) -> Vector3:
        """Offset from `aim` of the point where this look's line of sight meets the surface of the same cell.

        The derivatives, of every order, of `miss` where nothing has moved yet: the search only chose the cell.
        """
        return self.sweep(aim).facet

    def sweep(self, aim: NominalFix) -> Sweep:
        """Where this look's line of sight passes the fix of `aim`."""
        ray = self._ray()
        distance = implicit_root(_clearance, aim.distance, (ray, self.terrain, aim.cell))
        offset = lambda distance: aim.R_ecef_from_enu.T @ (ray.at(distance) - aim.p_ecef)  # noqa: E731
        ground = -self.terrain.clearance(aim.p_ecef, aim.cell)
        return Sweep(offset(distance), offset(aim.distance), offset(aim.distance + FARTHER), ground)

    def fix_offset(self, aim: NominalFix, search: AbstractSearch) -> tuple[Vector3, StatusCode]:
        """(offset of this look's fix from `aim` in east, north, up there in m, status)."""
        return aim.offset_of(self.sightline(), self.terrain, self.air, search)

    def sightline(self) -> Sightline:
        """The line of sight of a look whose numbers are finite, whether or not the pixel lies on the image.

        Those that are not leave a ray that is not, which is invalid input to any search.
        """
        if isinstance(self.motion, Shot):
            direction_camera, status = self.sensor.camera.ray(self.uv)
            origin, direction = self.sensor.line(Station.of(self.motion), direction_camera)
        else:
            origin, direction, status = line_of_sight(self.sensor, self.motion, jnp.asarray(self.time), self.uv)
        return Sightline(Ray(origin, direction), seen_beside(status, direction))

    @property
    def pose(self) -> Pose:
        """The pose of the shot, or the poses of the knots."""
        return self.motion.pose if isinstance(self.motion, Shot) else self.motion.poses

    def with_pose(self, pose: Pose) -> ModelInputs:
        """The look from another pose, or other poses at the knots."""
        where = (lambda look: look.motion.pose) if isinstance(self.motion, Shot) else (lambda look: look.motion.poses)
        return eqx.tree_at(where, self, pose)

    def _located(self, search: AbstractSearch) -> tuple[Fix, Any]:
        time = jnp.asarray(as_float64(self.time, "time"))
        return located_anywhere(self.sensor, self.motion, time, self.uv, self.terrain, search, self.air)

    def _ray(self) -> Ray:
        """The line of sight; a ray that stands in for one that is not finite."""
        origin, direction, _ = line_of_sight(self.sensor, self.motion, jnp.asarray(self.time), self.uv)
        sound = jnp.all(jnp.isfinite(origin)) & jnp.all(jnp.isfinite(direction))
        stand_in = Ray(jnp.array([WGS84.a + 1000.0, 0.0, 0.0]), jnp.array([-1.0, 0.0, 0.0]))
        return tree_where(sound, Ray(origin, direction), stand_in).through(self.air)


@eqx.filter_jit
def _aim(look: ModelInputs, search: AbstractSearch) -> NominalFix:
    look = jax.lax.stop_gradient(look)
    terrain, _ = look.terrain.made_safe()
    fix, bracket = look._located(search)
    seen = fix.found
    ray = tree_where(seen, look._ray(), terrain.safe_ray().through(look.air))
    bracket = tree_where(seen, bracket, jax.tree.map(jnp.zeros_like, bracket))
    distance = polish(ray, terrain, bracket) if look.air is not None else jnp.where(seen, fix.slant_range, 1000.0)
    p_ecef = ray.at(distance)
    R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))
    arriving = ray.heading_at(distance)
    return NominalFix(fix, p_ecef, distance, bracket.cell, R.T @ (arriving / safe_norm(arriving)), R)


def _clearance(distance: Scalar, world: tuple[Ray, AbstractTerrain, Array]) -> Scalar:
    ray, terrain, cell = world
    return terrain.clearance(ray.at(distance), cell)

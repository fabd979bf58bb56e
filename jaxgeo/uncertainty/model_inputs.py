"""Inputs of the forward model, the nominal fix, and offsets from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxgeo._arguments import check_on_image, check_terrain, checked_air, checked_observation, no_fix_because
from jaxgeo._compile import is_direct, quick_filter_jit, quick_jit
from jaxgeo._intersection import FIRST_HIT, has_point, met_apart, met_by, touched_by
from jaxgeo._numerics import implicit_root, matvec, safe_norm, tree_where
from jaxgeo._record import Record
from jaxgeo._typing import Matrix3, PixelField, Scalar, StatusCode, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.sensor.platform import Pose, Station
from jaxgeo.status import Status, have_fix, seen_beside
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket, Dem, FirstHit
from jaxgeo.terrain.polish import polish

KNOTS = 8  # trajectory knots kept about an exposure; its time error must stay within them
FARTHER = 1000.0  # m behind the fix: second point of `Sweep`


class Sightline(NamedTuple):
    """Straight line of sight of the sensor, and its status."""

    ray: Ray
    status: StatusCode


class Sweep(NamedTuple):
    """Offsets of a line of sight from a `NominalFix` in east, north, up, m; their derivatives give the error ellipse.

    `facet` is the intersection with the surface of the same cell, `line` the point at the same range, `farther` the
    point `FARTHER` m behind that; `ground` is the height in m of the terrain above the fix.
    """

    facet: Float[Array, "3 *axes"]
    line: Float[Array, "3 *axes"]
    farther: Float[Array, "3 *axes"]
    ground: Float[Array, "*axes"]


class Tangents(NamedTuple):
    """Derivatives by the errors (last axis) of what a `Sweep` depends on, or that itself without errors.

    `ray` is the straight line of sight, `air` the atmosphere, `ground` the height in m of the terrain above the fix.
    """

    ray: Ray
    air: Any
    ground: Float[Array, "*axes"]


class NominalFix(NamedTuple):
    """Nominal fix of an observation, with its terrain cell and the local frame of offsets.

    `distance` in m is the range along the ray, `direction_enu` the direction of the ray at the fix, `R_ecef_from_enu`
    the frame at the fix. Without a fix, a substitute ray keeps all values except those of `fix` finite.
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
        """(offset in m of a line of sight's fix from this one, in east, north, up at this one; status)."""
        ray, status = line
        if isinstance(search, FirstHit) and isinstance(terrain, Dem) and air is None:
            p_ecef, status = touched_by(ray, status, terrain, search)
            found = has_point(status)
        else:
            fix, _ = met_by(ray, status, terrain, search, air)
            p_ecef, found, status = fix.ecef, fix.found, jnp.asarray(fix.status)
        offset = jnp.where(found, p_ecef - self.p_ecef, 0.0)
        return matvec(self.R_ecef_from_enu.T, offset), status

    def require_fix(self, inputs: ModelInputs) -> None:
        """Raise `ValueError` unless there is a fix on the first ground met; not for traced input."""
        if not have_fix(self.fix.status):
            origin = lambda: _nominal_sightline(inputs).ray.origin  # noqa: E731
            why = no_fix_because(Status(int(self.fix.status)), origin, inputs.terrain)
            raise ValueError(f"cannot estimate accuracy, there is no fix: {why}")


if TYPE_CHECKING:
    OptionalPixel: TypeAlias = Any
    OptionalTerrain: TypeAlias = Any
else:
    OptionalPixel: TypeAlias = PixelField | None
    OptionalTerrain: TypeAlias = AbstractTerrain | None


class ModelInputs(Record):
    """Inputs of the forward model that error sources perturb: an exposure, a pixel of it, and the terrain.

    `uv` is None if the whole exposure is meant, `terrain` if nothing depends on the ground. `ModelInputs.of` makes them
    from user arguments and checks these.
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
        of_many: bool = False,
    ) -> ModelInputs:
        """Inputs of `jaxgeo.locate` for pixel `uv`; arguments and exceptions as there.

        Raises `ValueError` for a known pixel outside the image, where `locate` has no fix, unless it is one `of_many`,
        which has a status. Of a trajectory, only the knots around the exposure are kept.
        """
        check_terrain(terrain, search)
        sensor, motion, moment, pixel = checked_observation(sensor, shot, time, uv)
        if not of_many:
            check_on_image(sensor, pixel)
        return cls.of_checked(sensor, motion, moment, pixel, of_arrays(terrain), checked_air(atmosphere))

    @classmethod
    def of_checked(
        cls, sensor: Sensor, motion: Shot | Trajectory, time: Any, uv: Any, terrain: Any, air: Atmosphere | None
    ) -> ModelInputs:
        """As `of`, from arguments that are already checked and in float64."""
        if isinstance(motion, Trajectory):
            motion = motion.about(time, sensor.camera.time_of(uv), KNOTS)
        return cls(Exposure(sensor, motion, time, air), uv, terrain)

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
        """The fix that `locate` returns."""
        return met_by(*self.nominal_sightline(), self.terrain, search, self.air)[0]

    def nominal_fix(self, search: AbstractSearch) -> NominalFix:
        """Nominal fix of the observation, without derivatives."""
        inputs = self if is_direct() else jax.lax.stop_gradient(self)
        ray, status = _nominal_sightline(inputs)
        return _nominal_fix(inputs, *met_apart(ray, status, inputs.terrain, search, inputs.air))

    def linear_offset(self, nominal: NominalFix) -> Vector3:
        """Offset in m from `nominal` of the intersection of this line of sight with the surface of the same cell.

        At zero error its derivatives of every order are those of `fix_offset`: the search only selects the cell.
        """
        return self.sweep(nominal).facet

    def sweep(self, nominal: NominalFix) -> Sweep:
        """Offsets of this line of sight from the fix of `nominal`."""
        return swept_by(self.ray(), self.air, self.terrain, nominal)

    def range_to_surface(self, nominal: NominalFix) -> Scalar:
        """Range in m of `nominal`, with the derivatives of that of this line of sight to the same surface."""
        return _range_to_surface(self.ray().through(self.air), self.terrain, nominal, None)

    def fix_offset(self, nominal: NominalFix, search: AbstractSearch) -> tuple[Vector3, StatusCode]:
        """(offset in m of this fix from `nominal`, in east, north, up at `nominal`; status)."""
        return nominal.offset_of(self.sightline(), self.terrain, self.air, search)

    def sightline(self) -> Sightline:
        """The straight line of sight; a perturbed pixel may lie outside the image."""
        ray, status = self.nominal_sightline()
        return Sightline(ray, seen_beside(status, ray.direction))

    def nominal_sightline(self) -> Sightline:
        """The straight line of sight, with the status `outside_image` for a pixel outside the image.

        Non-finite inputs give a non-finite ray, which every search reports as invalid input.
        """
        if isinstance(self.motion, Shot):
            direction_camera, status = self.sensor.camera.ray(self.uv)
            origin, direction = self.sensor.line(Station.of(self.motion), direction_camera)
        else:
            origin, direction, status = line_of_sight(self.sensor, self.motion, jnp.asarray(self.time), self.uv)
        return Sightline(Ray(origin, direction), status)

    @property
    def pose(self) -> Pose:
        """The pose of the shot, or the poses of the knots."""
        return self.motion.pose if isinstance(self.motion, Shot) else self.motion.poses

    def with_pose(self, pose: Pose) -> ModelInputs:
        """The inputs with another pose, or other poses at the knots."""
        name = "pose" if isinstance(self.motion, Shot) else "poses"
        where = lambda inputs: getattr(inputs.motion, name)  # noqa: E731
        return eqx.tree_at(where, self, pose)

    def ray(self) -> Ray:
        """The straight line of sight, or a substitute ray if it is not finite."""
        origin, direction, _ = line_of_sight(self.sensor, self.motion, jnp.asarray(self.time), self.uv)
        sound = jnp.all(jnp.isfinite(origin)) & jnp.all(jnp.isfinite(direction))
        stand_in = Ray(jnp.array([WGS84.a + 1000.0, 0.0, 0.0]), jnp.array([-1.0, 0.0, 0.0]))
        return tree_where(sound, Ray(origin, direction), stand_in)


def located_each(inputs: ModelInputs, uv: Any, search: AbstractSearch = FIRST_HIT) -> tuple[Fix, Bracket]:
    """Fixes of pixels (n, 2) of one exposure, which may lie outside the image, and where the search found the ground.

    Called directly, by the programs that `locate` uses under a `jax.vmap`, since a search takes long to compile.
    """

    def one(inputs: ModelInputs, uv: Any, search: AbstractSearch) -> tuple[Fix, Bracket]:
        (ray, _), status = _sightlines_of(inputs, uv)
        return met_apart(ray, status, inputs.terrain, search, inputs.air)

    return jax.vmap(one, in_axes=(None, 0, None))(inputs, uv, search)


def located_apart(inputs: ModelInputs, uv: Any, search: AbstractSearch) -> tuple[Fix, Bracket]:
    """The fix that `locate` returns, and where the search found the ground, by programs apart."""
    (ray, status), _ = _sightlines_of(inputs, uv)
    return met_apart(ray, status, inputs.terrain, search, inputs.air)


@quick_jit
def _sightlines_of(inputs: ModelInputs, uv: Any) -> tuple[Sightline, StatusCode]:
    """The nominal line of sight of a pixel, and its status if the pixel may lie outside the image."""
    inputs = dataclasses.replace(inputs, uv=uv)
    line = inputs.nominal_sightline()
    return line, seen_beside(line.status, line.ray.direction)


def of_arrays(terrain: AbstractTerrain) -> AbstractTerrain:
    """The terrain with arrays for Python numbers, which would be constants of a program, recompiled for each value."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64) if isinstance(x, float | int) else x, terrain)


@quick_filter_jit
def _nominal_sightline(inputs: ModelInputs) -> Sightline:
    return inputs.nominal_sightline()


def nominal_fix_of(inputs: ModelInputs, fix: Fix, bracket: Bracket) -> NominalFix:
    """The nominal fix from the fix of `inputs` and what the search found."""
    terrain, _ = inputs.terrain.made_safe()
    seen = fix.found
    ray = tree_where(seen, inputs.ray(), terrain.safe_ray()).through(inputs.air)
    bracket = tree_where(seen, bracket, jax.tree.map(jnp.zeros_like, bracket))
    distance = polish(ray, terrain, bracket) if inputs.air is not None else jnp.where(seen, fix.slant_range, 1000.0)
    p_ecef = ray.at(distance)
    R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))
    arriving = ray.heading_at(distance)
    return NominalFix(fix, p_ecef, distance, bracket.cell, R.T @ (arriving / safe_norm(arriving)), R)


_nominal_fix = quick_filter_jit(nominal_fix_of)


def swept_by(
    ray: Ray, air: Atmosphere | None, terrain: AbstractTerrain, nominal: NominalFix, raised: Scalar | None = None
) -> Sweep:
    """Offsets of a straight line of sight, refracted by `air`, from a fix; of a terrain that lies `raised` m higher."""
    ray = ray.through(air)
    distance = _range_to_surface(ray, terrain, nominal, raised)
    offset = lambda distance: nominal.R_ecef_from_enu.T @ (ray.at(distance) - nominal.p_ecef)  # noqa: E731
    ground = -_clearance_at(nominal.p_ecef, terrain, nominal.cell, raised)
    return Sweep(offset(distance), offset(nominal.distance), offset(nominal.distance + FARTHER), ground)


def sweep_of(base: Tangents, terrain: AbstractTerrain, nominal: NominalFix, by_error: Tangents) -> Sweep:
    """Derivatives of `ModelInputs.sweep` by the errors, from those of the line of sight, the air and the ground.

    The chain rule over these keeps what is slow to compile the same for all error models. To first order only: the
    ground's derivative is that at the fix.
    """

    def swept(ray: Ray, air: Any, raised: Scalar) -> Sweep:
        return swept_by(ray, air, terrain, nominal, raised)

    along = lambda one: jax.jvp(swept, (base.ray, base.air, jnp.zeros(())), tuple(one))[1]  # noqa: E731
    return jax.vmap(along, in_axes=-1, out_axes=-1)(by_error)


def _range_to_surface(ray: Ray, terrain: AbstractTerrain, nominal: NominalFix, raised: Scalar | None) -> Scalar:
    """Range in m of the nominal fix; its derivatives are those of the range to the surface of the same cell."""
    return implicit_root(_clearance, nominal.distance, (ray, terrain, nominal.cell, raised))


def _clearance(distance: Scalar, world: tuple[Ray, AbstractTerrain, Array, Scalar | None]) -> Scalar:
    ray, terrain, cell, raised = world
    return _clearance_at(ray.at(distance), terrain, cell, raised)


def _clearance_at(p_ecef: Vector3, terrain: AbstractTerrain, cell: Array, raised: Scalar | None) -> Scalar:
    clearance = terrain.clearance(p_ecef, cell)
    return clearance if raised is None else clearance - raised

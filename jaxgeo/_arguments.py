"""Validation of public arguments and their conversion to float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_float64, check_is, concrete, given_array, is_known, require_x64
from jaxgeo._typing import Pixel, Scalar, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic, check_position
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix
from jaxgeo.sensor import FrameCamera, Sensor, Shot, Trajectory
from jaxgeo.sensor.scanning import AbstractScanningCamera
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, ConstantHeight, Dem, FirstHit

UNIT_TOLERANCE = 1e-6


def checked_observation(
    sensor: Sensor, shot: Shot | Trajectory, time: Any, uv: ArrayLike | Sequence[ArrayLike]
) -> tuple[Sensor, Shot | Trajectory, Scalar, Pixel]:
    """Validated sensor, shot or trajectory, image time and one pixel, in float64."""
    sensor, shot, time = checked_exposure(sensor, shot, time)
    pixel = as_float64(given_array(uv, "uv", "one pixel (column, row)"), "uv")
    if pixel.shape != (2,):
        raise ValueError(
            f"uv must be one pixel (column, row) of shape (2,); got shape {pixel.shape}. "
            "For many pixels use jax.vmap(locate, in_axes=(None, None, 0, None))."
        )
    return sensor, shot, time, pixel


def checked_exposure(sensor: Sensor, shot: Shot | Trajectory, time: Any) -> tuple[Sensor, Shot | Trajectory, Scalar]:
    """Validated sensor, shot or trajectory, and image time, in float64."""
    require_x64()
    check_is(sensor, Sensor, "sensor")
    if not isinstance(shot, Shot | Trajectory):
        raise TypeError(
            f"shot must be a jaxgeo Shot, or a Trajectory with the time of the image; got {type(shot).__name__}."
        )
    if isinstance(shot, Shot) and time is not None:
        raise ValueError("time goes with a Trajectory; a Shot is a moment already. Leave one of them out.")
    moment: Any = 0.0 if time is None else time
    sensor, shot, moment = as_float64((sensor, shot, moment), ("sensor", "shot", "time"))
    if isinstance(shot, Trajectory) and jnp.ndim(shot.times) != 1:
        raise ValueError(f"shot must be one trajectory; its times have the shape {shot.times.shape}. Use jax.vmap.")
    position = shot.pose.position if isinstance(shot, Shot) else shot.poses.position
    check_latitude(position, "shot.pose.position")
    moment = moment if isinstance(moment, jax.Array) else jnp.asarray(moment)
    if moment.shape != ():
        raise ValueError(f"time must be one number in s; got shape {moment.shape}. For many images use jax.vmap.")
    return sensor, shot, moment


def check_terrain(terrain: Any, search: Any) -> None:
    """Raise `TypeError` unless the arguments are a terrain and a search."""
    if not isinstance(terrain, AbstractTerrain):
        raise TypeError(
            f"terrain must be a jaxgeo terrain; got {type(terrain).__name__}. Read one with jaxgeo.io.read_dem(path), "
            "or make one with jaxgeo.Dem.from_array(posts, grid) or jaxgeo.ConstantHeight(height)."
        )
    check_is(search, AbstractSearch, "search")


def check_mapped_terrain(terrain: Any) -> None:
    """Raise `TypeError` unless the terrain is a `Dem` or a `ConstantHeight`, `ValueError` if it is not on WGS 84."""
    check_terrain(terrain, FirstHit())
    if not isinstance(terrain, Dem | ConstantHeight):
        raise TypeError(
            f"terrain must be a jaxgeo.Dem or a jaxgeo.ConstantHeight here: maps are made cell by cell from heights on "
            f"a grid, which a {type(terrain).__name__} does not have. Make one with jaxgeo.Dem.from_array(posts, grid) "
            "of the heights that its height_at gives at the posts."
        )
    if isinstance(terrain, ConstantHeight) and (terrain.ellipsoid.a, terrain.ellipsoid.f) != (WGS84.a, WGS84.f):
        raise ValueError(
            "terrain must lie on WGS 84 here; got a ConstantHeight on an ellipsoid of "
            f"a = {terrain.ellipsoid.a:.10g} m and f = {terrain.ellipsoid.f:.10g}. Leave its ellipsoid out."
        )


def checked_air(atmosphere: Any) -> Atmosphere | None:
    """The atmosphere in float64, or None for no refraction; raises `TypeError` for anything else."""
    if atmosphere is None:
        return None
    if not isinstance(atmosphere, Atmosphere):
        raise TypeError(
            f"atmosphere must be a jaxgeo.Atmosphere; got {type(atmosphere).__name__}. jaxgeo.Atmosphere() is the "
            "standard one, jaxgeo.Atmosphere.measured(...) follows a measurement; leave it out for no refraction."
        )
    return as_float64(atmosphere, "atmosphere")


def check_latitude(position: Geodetic, name: str) -> None:
    """Raise `ValueError` for a concrete latitude beyond a pole; the usual cause is degrees instead of radians. Raises
    `TypeError` for what is no position."""
    check_position(position, name)
    known = concrete(position.lat)
    if known is not None and np.any(np.abs(known) > 0.5 * np.pi + 1e-12):
        raise ValueError(
            f"{name}.lat must lie within pi/2 rad of the equator; got {np.max(np.abs(known)):.9g}. "
            "Geodetic takes radians; Geodetic.from_degrees takes degrees."
        )


def check_ray(ray: Ray) -> None:
    """Raise `ValueError` unless `ray` is a single ray; a concrete direction must have unit length."""
    for name, vector in (("origin", ray.origin), ("direction", ray.direction)):
        if jnp.shape(vector) != (3,):
            raise ValueError(
                f"ray.{name} must be one vector of shape (3,), ECEF; got shape {jnp.shape(vector)}. "
                "For many rays use jax.vmap(intersect, in_axes=(0, None))."
            )
    known = concrete(ray.direction)
    if known is None or not np.all(np.isfinite(known)):
        return
    length = float(np.linalg.norm(known))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(
            f"ray.direction must be a unit vector in ECEF; got one of length {length:.9g}. Divide it by its length."
        )


def check_on_image(sensor: Sensor, pixel: Pixel) -> None:
    """Raise `ValueError`, with the image size, for a concrete pixel outside the image; compiles nothing."""
    camera, known = sensor.camera, concrete(pixel)
    if known is None or not isinstance(camera, FrameCamera | AbstractScanningCamera):
        return
    size = np.array([camera.width, camera.height])
    if np.all(np.isfinite(known)) and not np.all((known >= -0.5) & (known <= size - 0.5)):
        raise ValueError(
            f"outside_image: the pixel uv = ({known[0]:g}, {known[1]:g}) lies outside the image of {size[0]} columns x "
            f"{size[1]} rows; uv is (column, row), with pixel centres at integers from 0."
        )


def check_throw(throw: bool, arguments: Any) -> None:
    """Raise `ValueError` if `throw` is set but the arguments are traced, so that no exception can be raised."""
    if throw and not is_known(arguments):
        raise ValueError(
            "throw=True needs values that are known now, but these are traced by JAX (inside jit, vmap or grad), where "
            "no exception can be raised. Leave throw off and look at `Fix.status`."
        )


def thrown(fix: Fix, origin: Callable[[], Vector3], terrain: AbstractTerrain) -> Fix:
    """The fix if it is a hit; otherwise raises `ValueError` with its status (`no_fix_because`)."""
    status = Status(int(np.asarray(fix.status)))
    if status is not Status.hit:
        raise ValueError(no_fix_because(status, origin, terrain))
    return fix


def no_fix_because(status: Status, origin: Callable[[], Vector3], terrain: AbstractTerrain) -> str:
    """A status as a sentence; of a camera below the terrain with both heights (`origin` gives it in ECEF m)."""
    words = f"{status.name}: {status.message}"
    if status is not Status.camera_below_terrain:
        return words
    at = WGS84.to_geodetic(origin())
    both = heights_of_camera_and_ground(at, terrain)
    return words if both is None else f"{words} {both}"


def heights_of_camera_and_ground(camera: Geodetic, terrain: AbstractTerrain) -> str | None:
    """Heights of a camera and of the ground below it as a sentence; None where the ground is unknown."""
    height, ground = float(camera.height), float(np.asarray(terrain.height_at(camera)))
    if not np.isfinite(ground):
        return None
    return (
        f"The camera is at {height:z.1f} m, the ground at {ground:z.1f} m above the ellipsoid, {ground - height:.1f} m "
        "higher."
    )

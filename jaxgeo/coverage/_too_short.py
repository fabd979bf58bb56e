"""Early detection of flights too short for a second image, before a plan is compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.coverage._checks import SeesNoGround
from jaxgeo.coverage.exposure import Along, image_size
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.sensor import Sensor, Trajectory
from jaxgeo.terrain import AbstractTerrain, ConstantHeight, Dem

if TYPE_CHECKING:
    from jaxgeo.coverage.timing import Course

MOMENTS = 33  # sample times of the flight
SURELY = 1.5  # safety factor on the distance flown, for relief and motion between the samples
SIDES = {"columns": ((0, 2), (1, 3)), "rows": ((0, 1), (2, 3))}


def too_few(last: float, first: float) -> ValueError:
    """Error for a flight with room for one image only."""
    return ValueError(
        f"the navigation is too short: the second exposure after that at {first:.9g} s is due later than {last:.9g} s, "
        "the time of the last whole image. Give longer navigation, or request more overlap."
    )


def refuse_too_short(course: Course, along: Along | None, start: float, goal: float) -> None:
    """Raise `ValueError` if the imaged ground surely moves by less than the share `goal` of an image's near length.

    Assumes level ground at the terrain's highest height, where images are shortest; one small program without a
    terrain search. Undecided flights are left to the timing itself.
    """
    last, top = float(course.last), _highest(course.terrain)
    if not last > start:
        raise too_few(last, start)
    if top is None:
        return
    times = jnp.linspace(start, last, MOMENTS)
    found = _corners(course.sensor, course.trajectory, times, jnp.asarray(top))
    corners, foot, height = (np.asarray(x) for x in found)
    if along is not None and (height > top).all():
        _refuse_unseen(corners, along, np.asarray(times))
    if not np.isfinite(corners).all():
        return
    course_of_feet = foot[-1] - foot[0]
    direction = course_of_feet / max(float(np.linalg.norm(course_of_feet)), 1e-9)
    way = np.linalg.norm(np.diff(foot, axis=0), axis=1).sum()
    turned = np.abs((corners.mean(axis=1) - corners[0].mean(axis=0)) @ direction).max()  # includes platform motion
    if SURELY * max(way, turned) < goal * _shortest(corners, direction, along):
        raise too_few(last, start)


def no_ground(time: float) -> SeesNoGround:
    """Error for an image whose near end sees no ground."""
    return SeesNoGround(f"the near end of the image sees no ground at {time:.9g} s: no image can be timed by it.")


def _refuse_unseen(corners: np.ndarray, along: Along, times: np.ndarray) -> None:
    """Raise `ValueError` for a sample time at which neither image side along the flight sees any ground."""
    seen: np.ndarray = np.all(np.isfinite(corners), axis=2)
    lost = ~np.logical_or(*(seen[:, i] & seen[:, j] for i, j in SIDES[along]))
    if lost.any():
        raise no_ground(float(times[int(np.argmax(lost))]))


def _highest(terrain: AbstractTerrain) -> float | None:
    if isinstance(terrain, Dem):
        return float(terrain.ceiling)
    return float(terrain.height) if isinstance(terrain, ConstantHeight) and np.ndim(terrain.height) == 0 else None


def _shortest(corners: np.ndarray, direction: np.ndarray, along: Along | None) -> float:
    """Shortest length in m of the image edges along the flight; of either pair, if the axis is ambiguous."""
    if along is None:
        along = _clear_axis(corners[0], direction)
    lengths = []
    for axis in SIDES if along is None else (along,):
        edges = np.stack([corners[:, j] - corners[:, i] for i, j in SIDES[axis]], axis=1)
        if along is None:
            lengths.append(np.sqrt(0.5) * np.linalg.norm(edges, axis=2).min())
        else:
            lengths.append(np.abs(edges @ direction).min())
    return float(min(lengths))


def _clear_axis(corners: np.ndarray, direction: np.ndarray) -> Along | None:
    """The image axis along a direction, if it is within 25 deg."""
    for axis, sides in SIDES.items():
        edge = np.mean([corners[j] - corners[i] for i, j in sides], axis=0)
        if abs(edge @ direction) > 0.9 * np.linalg.norm(edge):
            return axis  # pyright: ignore[reportReturnType]
    return None


@batch_filter_jit
def _corners(
    sensor: Sensor, trajectory: Trajectory, times: Float[Array, " moments"], height: Scalar
) -> tuple[Float[Array, "moments 4 3"], Float[Array, "moments 3"], Float[Array, " moments"]]:
    """(corner intersections with level ground, NaN without one; the ellipsoid point below the platform, ECEF m; the
    platform's height) at sample times."""
    width, rows = image_size(sensor)
    places = jnp.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, rows - 0.5)])

    def at(time: Scalar) -> tuple[Float[Array, "4 3"], Vector3, Scalar]:
        shot = trajectory.at(time)

        def seen(uv: Float[Array, "2"]) -> Vector3:
            origin, direction, _ = sensor.ray_ecef(shot, uv)
            near, _, meets = WGS84.ranges_to_height(origin, direction, height)
            return jnp.where(meets & (near > 0.0), origin + near * direction, jnp.nan)

        position = shot.pose.position
        foot = WGS84.to_ecef(Geodetic(lat=position.lat, lon=position.lon, height=jnp.zeros(())))
        return jax.vmap(seen)(places), foot, jnp.asarray(position.height)

    return jax.vmap(at)(times)

"""Status codes of rays and projections: an int8 code with a full-sentence message."""

from __future__ import annotations

import enum

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._typing import Flag, Flags, Indices, Numbers, StatusCode


class Status(enum.IntEnum):
    """Outcome of one ray or one projection. Records store it as an int8 array; `Status(code).message` is the sentence.

    Only `hit` is an unconditional result. `near_tangent` and `enters_from_side` keep their coordinates for callers who
    accept them; every other member has NaN coordinates (`hits_void` gives the point of entry).
    """

    hit = 0
    near_tangent = 1
    enters_from_side = 2
    hits_void = 3
    rises_away = 4
    leaves_terrain = 5
    ray_misses_terrain = 6
    enters_below_terrain = 7
    camera_below_terrain = 8
    invalid_input = 9
    not_converged = 10
    behind_camera = 11
    outside_image = 12
    outside_distortion_field = 13
    hidden_by_terrain = 14
    never_seen = 15
    outside_trajectory = 16
    outside_gimbal_range = 17
    crosses_horizon = 18
    images_apart = 19
    too_few_rays = 20
    weak_intersection = 21
    file_not_read = 22
    below_horizon = 23
    images_turned = 24

    @property
    def message(self) -> str:
        """The status as a full sentence."""
        return _MESSAGES[self]

    @property
    def code(self) -> StatusCode:
        """The status as the int8 scalar that records store."""
        return jnp.asarray(self.value, jnp.int8)


_MESSAGES = {
    Status.hit: "Visible: no known terrain in the way.",
    Status.near_tangent: "The ray grazes the terrain: the position is valid, its derivatives are not.",
    Status.enters_from_side: "The ray enters over the edge below the highest ground: unknown ground may hide it.",
    Status.hits_void: "The ray passes below the highest ground over a void: the ground is unknown from here on.",
    Status.rises_away: "The ray rises above the highest ground without meeting the terrain.",
    Status.leaves_terrain: "The ray leaves the terrain's area before it meets the ground; load a larger area.",
    Status.ray_misses_terrain: "The ray does not cross the terrain's area at a height where ground may be.",
    Status.enters_below_terrain: "The ray enters over the terrain's edge below the ground there.",
    Status.camera_below_terrain: "The camera is below the terrain; check the vertical datum of its height.",
    Status.invalid_input: "An input is not a number, infinite or out of range.",
    Status.not_converged: "An iteration did not converge.",
    Status.behind_camera: "The point is behind the camera.",
    Status.outside_image: "The pixel, or the image of the point, is outside the image.",
    Status.outside_distortion_field: "The pixel or point is outside the field where lens distortion can be inverted.",
    Status.hidden_by_terrain: "Terrain hides the point from the camera.",
    Status.never_seen: "No line of the image sees the point during its exposure.",
    Status.outside_trajectory: "The exposure is before the first or after the last record of the trajectory.",
    Status.outside_gimbal_range: "The target is outside the gimbal's limits: the readings are the nearest within them.",
    Status.crosses_horizon: "The footprint crosses the horizon: part of the image sees no ground.",
    Status.images_apart: "The images share no ground across the flight, so their overlap along it is undefined.",
    Status.too_few_rays: "Fewer than two rays are used: the distance of the point is undetermined.",
    Status.weak_intersection: "The rays are too nearly parallel to intersect within their errors.",
    Status.file_not_read: "The file of the exposure could not be read; its row states the reason.",
    Status.below_horizon: "The Earth hides the point from the camera: it is below the horizon, whatever the terrain.",
    Status.images_turned: "The images are turned against each other by more than 30 deg, so lengths along and across a "
    "flight are undefined.",
}


def first_failure(*statuses: StatusCode) -> StatusCode:
    """The first status that is not `hit`, in the order given; `hit` if all are."""
    merged = statuses[-1]
    for status in reversed(statuses[:-1]):
        merged = jnp.where(status != Status.hit, status, merged)
    return merged


def status_where(condition: Flag, status: Status, otherwise: StatusCode) -> StatusCode:
    """`status` where `condition` holds, `otherwise` elsewhere."""
    return jnp.where(condition, status.code, otherwise)


def seen_beside(status: Indices, given: Numbers) -> Indices:
    """`hit` in place of `outside_image` if the pixel or direction `given` (last axis) is finite; others unchanged.

    A measured pixel may thus lie outside the image, but not where the lens has no ray.
    """
    is_beside = (status == Status.outside_image) & jnp.all(jnp.isfinite(given), axis=-1)
    return jnp.where(is_beside, Status.hit.code, status)


def counts_as_fix(code: Indices) -> Flags:
    """Whether a sample with this status counts as a fix: the position is valid, even if derivatives are not.

    For a void, or a ray that enters from the side, the first ground that the line of sight meets is unknown.
    """
    return (code == Status.hit) | (code == Status.near_tangent)


def have_fix(codes: ArrayLike) -> np.ndarray:
    """Which of a concrete array of codes count as a fix, by NumPy (see `counts_as_fix`)."""
    return np.isin(np.asarray(codes), [Status.hit.value, Status.near_tangent.value])


def count_statuses(codes: ArrayLike) -> dict[Status, int]:
    """Number of occurrences of each status in a concrete array of codes; only those that occur."""
    values, counts = np.unique(np.asarray(codes), return_counts=True)
    return {Status(int(value)): int(count) for value, count in zip(values, counts, strict=True)}

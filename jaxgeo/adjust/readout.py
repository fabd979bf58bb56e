"""Motion of cameras during the readout of their images, by image and by measurement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxgeo.adjust.block import Block
    from jaxgeo.adjust.navigation import Navigation

LONGEST = 10.0  # s
NEEDED = (
    "give Navigation(velocity=, turn_rate=), Block.from_shots(velocity=, turn_rate=), a trajectory=, or strips "
    "whose images have different times; with Views, Views.moving(velocity, turn_rate)"
)


def known_motion(block: Block, rows: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """(velocities, turn rates) (n, 3) of the navigation, zero where unknown. Raises `ValueError`, saying what is needed
    for `what`, if any of some images `rows` (n,), flags, has none."""
    navigation = block.navigation
    if navigation is None or navigation.velocity is None or navigation.turn_rate is None:
        raise ValueError(f"{what} needs the velocity and the turn rate of the navigation of each image: {NEEDED}.")
    both = np.concatenate([navigation.velocity, navigation.turn_rate], axis=1)
    unknown = rows & ~np.all(np.isfinite(both), axis=1)
    if np.any(unknown):
        image, count = block.images.name[int(np.argmax(unknown))], int(np.sum(unknown))
        raise ValueError(
            f"{what} needs the velocity and the turn rate of each image; those of image {image} are not known ({count} "
            f"such images): {NEEDED}."
        )
    both = np.nan_to_num(both)
    return both[:, :3], both[:, 3:]


def camera_motion(block: Block, rows: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """(velocities of the perspective centres, m/s; turn rates of the cameras, rad/s) (n, 3) in frame axes.

    The lever arms turn as the head does. Raises as `known_motion`.
    """
    velocity, turn_rate = known_motion(block, rows, what)
    navigation = block.navigation
    assert navigation is not None
    turn = np.einsum("nij,nj->ni", navigation.R_frame_from_reference, turn_rate)
    return velocity + np.cross(turn, _arms(navigation)), turn


def _arms(navigation: Navigation) -> np.ndarray:
    """Perspective centres less IMU positions (n, 3) m, frame axes; without that of a body that does not turn with its
    gimbal's head."""
    of_mount = [navigation.mounts[name] for name in navigation.mount.tolist()]
    body = np.array([np.zeros(3) if level else np.asarray(mount.lever_body, float) for mount, level in of_mount])
    head = np.array([np.asarray(mount.lever_head, float) for mount, _ in of_mount])
    R_head = navigation.R_frame_from_reference @ navigation.R_reference_from_head
    return np.einsum("nij,nj->ni", navigation.R_frame_from_body, body) + np.einsum("nij,nj->ni", R_head, head)


def has_readout(block: Block) -> bool:
    """Whether any camera of the block has a readout."""
    return any(value != 0.0 for value in block.readout.values())


def shares_of(block: Block, image: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Time after the middle of its image, over the readout of its camera, of pixels in `row` (k,) of the images with
    index `image` (k,)."""
    height = np.array([block.cameras[name].height for name in block.images.camera.tolist()], float)[image]
    return (row - 0.5 * (height - 1.0)) / height


def in_motion(block: Block, image: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(shifts (k, 3) in m of perspective centres, rotations (k, 3, 3), both in frame axes) of pixels by the readouts
    of the block, from the middle of their image: the orientation at the pixel is the rotation times that of the
    image."""
    readout = np.array([block.readout.get(name, 0.0) for name in block.images.camera.tolist()])
    velocity, turn = camera_motion(block, readout != 0.0, "Block.readout")
    seconds = readout[image] * shares_of(block, image, row)
    return seconds[:, None] * velocity[image], _rotations(seconds[:, None] * turn[image])


def _rotations(vectors: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vectors).as_matrix()


def checked_readout(given: Any, cameras: Mapping[str, Any]) -> dict[str, float]:
    """Readouts in s by camera, from a number for all or a mapping. Raises `ValueError` for unknown cameras, for what is
    no number, and for readouts of more than `LONGEST`."""
    readout = dict(given) if isinstance(given, Mapping) else dict.fromkeys(cameras, given)
    unknown = [name for name in readout if name not in cameras]
    if unknown:
        raise ValueError(f"readout: there is no camera {unknown[0]!r}; known are {', '.join(cameras)}.")
    found = {}
    for name, value in readout.items():
        number = np.asarray(value)
        if number.shape != () or number.dtype.kind not in "fiu" or not abs(number) <= LONGEST:
            raise ValueError(
                f"readout of camera {name} must be a number up to {LONGEST:g}, in s (0.03 is 30 ms); got {value!r}."
            )
        found[name] = float(number)
    return found

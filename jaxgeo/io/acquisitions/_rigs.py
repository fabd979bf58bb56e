"""Cameras of several bands on one mount (MicaSense, Parrot Sequoia): the rotation of each against the mount."""

from __future__ import annotations

import dataclasses

import numpy as np

from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.sensor import Mount

RELATIVES, BAND = "Camera:RigRelatives", "Camera:BandName"
NOTE = (
    "The camera is turned on its mount by Camera:RigRelatives: Rx Ry Rz from its axes (right, down, forward) to those "
    "of the reference camera, as in MicaSense's library; angles of the image are the reference camera's. The distance "
    "between both, some cm, is not taken."
)


def on_rig(tags: list[ImageTags], mount: Mount, notes: dict[str, None]) -> Mount:
    """The mounts (n) of the cameras of n images, turned by their rig relatives; raises `TableError`."""
    angles = np.array([_relatives(one) for one in tags])
    if not np.any(angles):
        return mount
    notes |= {NOTE: None}
    return dataclasses.replace(mount, R_head_from_camera=mount.R_head_from_camera @ _rotations(np.deg2rad(angles)))


def band_of(tags: ImageTags) -> str:
    """The name of the band, empty if it is not stated."""
    return tags.text(BAND)


def _relatives(tags: ImageTags) -> list[float]:
    """Angles about x, y and z in deg; zeros if they are not stated."""
    found = tags.numbers(RELATIVES)
    if len(found) not in (0, 3):
        raise tags.wrong(RELATIVES, f"{len(found)} numbers; expected 3 angles in deg.")
    return found or [0.0] * 3


def _rotations(angles: np.ndarray) -> np.ndarray:
    """Rx Ry Rz (n, 3, 3) of angles (n, 3) in rad."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cy * cz, -cy * sz, sy],
        [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
        [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

"""Heading, pitch and roll of many rotation matrices, without a program of JAX."""

from __future__ import annotations

import numpy as np


def attitudes_of(R: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(heading, pitch, roll) in rad of rotations (n, 3, 3), as `heading_pitch_roll_from_R`.

    The roll is what is left after the heading is taken out: near a pitch of 90 deg (with `Mount.nadir()` a camera that
    looks to the horizon) both are uncertain, and together right.
    """
    horizontal = np.hypot(R[:, 0, 0], R[:, 1, 0])
    locked = horizontal < 1e-15
    heading = np.where(locked, np.arctan2(-R[:, 0, 1], R[:, 1, 1]), np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    sine, cosine = np.sin(heading), np.cos(heading)
    right, down = (cosine * R[:, 1, k] - sine * R[:, 0, k] for k in (1, 2))
    roll = np.where(locked, 0.0, np.arctan2(-down, right))
    return heading, np.arctan2(-R[:, 2, 0], horizontal), roll

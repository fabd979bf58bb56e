"""Velocities and turn rates of the cameras of views, by differences between neighbouring images."""

from __future__ import annotations

import numpy as np

from jaxgeo.adjust.motion import motion_by_differences

GAP = 1.8  # median intervals: a longer one ends a run of images, as at a turn between strips
TURN = 0.5  # of the larger speed: by which the velocity of an interval differs from those beside it, if it is a turn


def runs_of(time: np.ndarray, camera: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Number (n,) of the run of each image: those of one camera that follow each other without a gap, and without an
    interval whose velocity is unlike those on both sides, as the way from strip to strip is."""
    found, first = np.zeros(len(time), int), 0
    for name in np.unique(camera):
        rows = np.flatnonzero(camera == name)
        rows = rows[np.argsort(time[rows], kind="stable")]
        intervals = np.diff(time[rows])
        usual = np.median(intervals) if len(intervals) else 0.0
        ends = (intervals > GAP * usual) | _is_turn(np.diff(centre[rows], axis=0), intervals)
        number = np.concatenate([[0], np.cumsum(ends)])
        found[rows] = first + number
        first += int(number[-1]) + 1
    return found


def _is_turn(step: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """Flags (m,) of the intervals whose velocities are unlike those before and after; not of the first and last."""
    with np.errstate(divide="ignore", invalid="ignore"):
        velocity = step / interval[:, None]
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
        speed = np.linalg.norm(velocity, axis=1)
        is_unlike = change > TURN * np.maximum(speed[:-1], speed[1:])
    found = np.zeros(len(interval), bool)
    found[1:-1] = is_unlike[:-1] & is_unlike[1:]
    return found


def motion_of(
    centre: np.ndarray, R_frame_from_camera: np.ndarray, time: np.ndarray, camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(velocities (n, 3) in m/s, frame axes; turn rates (n, 3) in rad/s about the camera's axes) of images at `time`
    (n,) in s of named cameras: `motion_by_differences` over their runs."""
    return motion_by_differences(centre, R_frame_from_camera, R_frame_from_camera, time, runs_of(time, camera, centre))

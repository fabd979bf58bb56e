"""Telemetry whose images are level although the packets state a roll of the sensor: seen by the reported corners."""

from __future__ import annotations

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.io.acquisitions._klv_columns import Columns
from jaxgeo.io.acquisitions.sentences import DOUBT

CLEAR = np.radians(1.0)  # least median turn of the corners that is worth a sentence
BETTER = 3.0  # by this factor the corners must be turned less against level images


def level_images(
    columns: Columns, level: np.ndarray, position: Geodetic, corners: np.ndarray, centre_height: np.ndarray
) -> list[str]:
    """A sentence if the corners (n, 4, 2) of the images, latitude and longitude in rad, fit level images better.

    `level` (n,) is the roll of the head in rad at which the image is level.
    """
    if np.isnan(corners).any(axis=(1, 2)).all():
        return []
    of_level = _turn(columns, position, corners, centre_height)
    of_angles = _wrapped(of_level - np.nan_to_num(columns["turn"]) + level)
    each = [one[np.isfinite(one)] for one in (of_angles, of_level)]
    if not len(each[1]):
        return []
    believed, upright = (np.median(np.abs(one)) for one in each)
    if believed < CLEAR or believed < BETTER * upright:
        return []
    shown = [f"{np.degrees(np.median(one)):+z.1f} deg" for one in each]
    return [
        f"{DOUBT}The packets' own corners are turned by {shown[0]} against these angles, and by {shown[1]} with "
        f"upright=True: the turret holds the image level. Give upright=True."
    ]


def _turn(columns: Columns, position: Geodetic, corners: np.ndarray, centre_height: np.ndarray) -> np.ndarray:
    """The clockwise turn (n,) of reported corners against a level image on the same optical axis, rad."""
    lat, lon, height = (np.asarray(x, np.float64)[:, None] for x in (position.lat, position.lon, position.height))
    curvature = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    north = (corners[..., 0] - lat) * WGS84.a * (1.0 - WGS84.e2) / curvature**1.5
    east = _wrapped(corners[..., 1] - lon) * np.cos(corners[..., 0]) * WGS84.a / np.sqrt(curvature)
    places = np.stack([north, east, np.broadcast_to(height - centre_height[:, None], north.shape)], axis=-1)
    axis = _axis(columns)
    right = np.stack([-axis[:, 1], axis[:, 0], np.zeros(len(axis))], axis=-1)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    ahead, across, below = (np.sum(places * one[:, None], -1) for one in (axis, right, np.cross(axis, right)))
    x, y = (np.where(ahead > 0.0, one, np.nan) / ahead for one in (across, below))
    x, y = (one - one.mean(axis=1, keepdims=True) for one in (x, y))
    half = np.tan(0.5 * np.stack([columns["field_across"], columns["field_down"]]))[..., None]
    half = np.nan_to_num(np.where(np.isfinite(half), half, half[::-1]), nan=1.0)  # only weights
    u, v = half[0] * [-1.0, 1.0, 1.0, -1.0], half[1] * [-1.0, -1.0, 1.0, 1.0]
    return np.arctan2(np.sum(u * y - v * x, axis=1), np.sum(u * x + v * y, axis=1))


def _axis(columns: Columns) -> np.ndarray:
    """The optical axis (n, 3), north, east, down."""
    names = ("heading", "pitch", "roll", "azimuth", "elevation")
    (sh, ch), (sp, cp), (sr, cr), (sa, ca), (se, ce) = ((np.sin(columns[one]), np.cos(columns[one])) for one in names)
    forward, right, down = ca * ce, sa * ce, -se
    right, down = cr * right - sr * down, sr * right + cr * down
    forward, down = cp * forward + sp * down, cp * down - sp * forward
    return np.stack([ch * forward - sh * right, sh * forward + ch * right, down], axis=-1)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """An angle in [-pi, pi)."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi

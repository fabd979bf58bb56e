"""Ground tilts that would explain the errors printed by Li et al. (2023) for hill and mountain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.targets import metres_per_radian
from jaxgeo.uncertainty import Propagation, presets, propagate

WIDEST, NARROWEST, ACROSS = 0.75, 1e-5, 13  # range of the slope grid, and its nodes per side


@dataclass(frozen=True)
class Tilt:
    """The best-fit plane to a row of Table 3: slopes in deg along the view (rising away) and across (to its left).

    `rms_enu` in m are the errors on it, beside the printed ones; two slopes are fitted to three numbers.
    """

    terrain: str
    along_deg: float
    across_deg: float
    rms_enu: np.ndarray
    printed_enu: np.ndarray


def implied_tilts() -> list[Tilt]:
    """The tilts of all three rows."""
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    rows = []
    for name, row in printed.TERRAINS.items():
        ground = printed.level_ground(row.target[2])
        found = propagate(printed.sensor(), printed.shot_of(row), printed.UV, ground, model)
        rows.append(_tilt(name, found, printed_rms(row)))
    return rows


def printed_rms(row: printed.Terrain) -> np.ndarray:
    """Printed RMS in east, north, up, in m."""
    along_meridian, along_parallel = metres_per_radian(printed.target_of(row))
    lat, lon = math.radians(row.lat_rms), math.radians(row.lon_rms)
    return np.array([lon * along_parallel, lat * along_meridian, row.height_rms])


def rms_on_slope(level: Propagation, slope_en: np.ndarray) -> np.ndarray:
    """RMS in east, north, up (m) on a plane with slopes to east and north, from a propagation over level ground.

    Each error moves the point along the line of sight from the level plane to the tilted one; the last axis of the
    error vector, the ground height, also raises the plane.
    """
    jacobian, direction = np.asarray(level.jacobian), np.asarray(level.nominal.direction_enu)
    normal = np.append(-slope_en, 1.0)
    raised = np.zeros(jacobian.shape[1])
    raised[-1] = 1.0
    slid = jacobian + np.outer(direction, (raised - normal @ jacobian) / (normal @ direction))
    return np.sqrt(np.diag(slid @ np.asarray(level.cov_error) @ slid.T))


def _tilt(name: str, level: Propagation, wanted: np.ndarray) -> Tilt:
    ahead = np.asarray(level.nominal.direction_enu)[:2]
    ahead = ahead / np.linalg.norm(ahead)
    axes = np.stack([ahead, [-ahead[1], ahead[0]]])
    slopes = _best(lambda slopes: float(np.sum(np.log(rms_on_slope(level, slopes @ axes) / wanted) ** 2)))
    along, across = np.rad2deg(np.arctan(slopes)).tolist()
    return Tilt(name, along, across, rms_on_slope(level, slopes @ axes), wanted)


def _best(cost: Callable[[np.ndarray], float]) -> np.ndarray:
    """The two slopes of lowest cost, by a grid around the current best that shrinks to a third each time."""
    centre, half = np.zeros(2), WIDEST
    while half > NARROWEST:
        offsets = half * np.linspace(-1.0, 1.0, ACROSS)
        grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2) + centre
        centre, half = grid[np.argmin([cost(slopes) for slopes in grid])], half / 3.0
    return centre

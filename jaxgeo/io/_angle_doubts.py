"""Angles of orientation tables that look like radians but are taken in degrees."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jaxgeo.io._columns import Columns
from jaxgeo.io._orientation_columns import ANGLES, IN_UNIT

FEWEST = 10  # images from which the spread of the angles alone is looked at
FEWEST_LEVEL = 3  # and from which it is where the other angles are those of a level camera, too
LEVEL_TILT = 0.2  # largest other angle then: 11 deg as rad, but a camera held level better than most as deg
DECIMALS = 2  # and one of them at least has more, as written radians do
TURN = 2.0 * np.pi + 1e-3  # rad
SPREAD = 3.0  # least difference of the largest and smallest kappa: nearly half a turn, in rad
OPPOSITE = 0.9  # least resultant length of twice the angle: along one line
BOTH_WAYS = 0.8  # largest resultant length of the angle: not all in one direction
ROUND = 5.5  # difference from which angles are in all directions, in rad
LEVEL = 0.5  # largest spread of the other angles, in rad: beside kappas in all directions


def angle_doubts(columns: Columns, numbers: Mapping[str, np.ndarray]) -> list[str]:
    """[a sentence that angles in deg look like radians], or [].

    They do if all are within 2 pi, and either of these holds:

    - there are at least 10 images, and their kappas (headings), as radians, are along one line in both directions, as
      of strips flown to and fro, or go round while the other angles hardly change. Degrees would be so only for images
      that all look one way;
    - there are at least 3, their kappas, as radians, are along one line, and the other angles are below 0.2, not all
      rounded to two decimals. Degrees are so only if one strip is flown and the camera is held level to 0.2 deg.
    """
    names = [name for name in ANGLES if name in numbers]
    if columns.notes or len(names) != 3 or len(columns) < FEWEST_LEVEL:  # angles of PAT-B and BINGO have their unit
        return []
    if any(np.max(np.abs(numbers[name])) > TURN for name in names):
        return []
    about = "kappa_deg" if "kappa_deg" in names else "heading_deg"
    angle, others = numbers[about], [numbers[name] for name in names if name != about]
    if not (_are_of_level_cameras(angle, others) or (len(columns) >= FEWEST and _is_radians(angle, others))):
        return []
    wanted = ", ".join(IN_UNIT["rad"][name][0] for name in names)
    called = columns.called[about]
    return [
        f"{_doubt()}All angles are within 2 pi ({called} from {np.min(angle):.3g} to {np.max(angle):.3g}), as those in "
        f"radians are, and are taken in deg. If they are in radians, name the columns {wanted}."
    ]


def _are_of_level_cameras(angle: np.ndarray, others: list[np.ndarray]) -> bool:
    tilts = np.concatenate(others)
    are_fine = np.any(np.abs(tilts - np.round(tilts, DECIMALS)) > 1e-9)
    return bool(are_fine and np.max(np.abs(tilts)) < LEVEL_TILT and _along_a_line(angle) >= OPPOSITE)


def _along_a_line(angle: np.ndarray) -> float:
    """Length of the mean of unit vectors at twice the angle, in rad: 1 if all are along one line."""
    return float(abs(np.mean(np.exp(2j * angle))))


def _is_radians(angle: np.ndarray, others: list[np.ndarray]) -> bool:
    spread = np.ptp(angle)
    if spread < SPREAD:
        return False
    to_and_fro = _along_a_line(angle) >= OPPOSITE and abs(np.mean(np.exp(1j * angle))) <= BOTH_WAYS
    return bool(to_and_fro or (spread >= ROUND and all(np.ptp(one) <= LEVEL for one in others)))


def _doubt() -> str:
    from jaxgeo.io.acquisitions.sentences import DOUBT  # whose package reads tables with this module

    return DOUBT

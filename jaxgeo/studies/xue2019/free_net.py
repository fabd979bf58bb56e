"""Candidate explanations of the paper's free network results: one free network per assumption."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np

from jaxgeo.adjust import Block, Free, Unknowns, adjust
from jaxgeo.sensor import AbstractCorrection
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import strips_apart
from jaxgeo.studies.xue2019.simulation import Simulated, flown, measured

APART = "strips apart"
APART_OFF = "strips apart, POS off north"
OFF = "POS off north"
OFF_UP = "POS off north and up"
FOCAL = "focal length free"


@dataclass(frozen=True)
class FreeNet:
    """A free network under one assumption: errors at the surveyed points (`differences` (m, 3), m), and its sigma0."""

    name: str
    assumption: str
    differences: np.ndarray
    sigma0: float

    @property
    def rms(self) -> np.ndarray:
        """Root mean square (3,) in x, y and z, m."""
        return np.sqrt(np.mean(self.differences**2, axis=0))

    @property
    def mean(self) -> np.ndarray:
        """Mean (3,), m."""
        return np.mean(self.differences, axis=0)


def off_by_compensated(pair: np.ndarray) -> float:
    """Common position offset in y, m, that would explain the compensated row's excess over the error of a `pair`.

    A y error that remains after calibration beyond the noise (`pair` (3,), RMS in m) must be common to all images: the
    boresight is estimated from orientations alone, which are insensitive to a shift of the positions.
    """
    return float(np.sqrt(max(printed.RMS["compensated"][1] ** 2 - float(pair[1]) ** 2, 0.0)))


def free_nets(
    found: Simulated,
    lens: type[AbstractCorrection],
    pair: np.ndarray,
    seed: int = 0,
    callback: Callable[[str], None] = lambda _: None,
) -> list[FreeNet]:
    """Free networks of one block (and of one flown with one heading), one per assumption.

    `pair` (3,) are the errors of compensated direct georeferencing from pairs, see `off_by_compensated`.
    """
    plain, apart = found.block(lens, control=False), found.block(lens, control=False, observations=strips_apart(found))
    north = np.array([0.0, -off_by_compensated(pair), 0.0])
    up = np.array([0.0, 0.0, printed.RMS["compensated"][2]])
    no_lever = eqx.tree_at(lambda sensor: sensor.mount.lever_body, found.given, np.zeros(3))
    other = measured(flown(found.size, one_heading=True), seed)
    nets = []

    def add(name: str, assumption: str, block: Block, unknowns: Unknowns | None = None, of: Simulated = found) -> None:
        callback(f"free net: {name}")
        adjustment = adjust(block, unknowns, screen=None)
        nets.append(FreeNet(name, assumption, adjustment.differences(of.ground), adjustment.sigma0))

    add("as navigated", "position and attitude with the sigmas of Table 1", plain)
    add(
        "attitude tight",
        "sigmas of attitude a tenth: the boresight cannot go into the orientations",
        weighed(plain, 1.0, 0.1),
    )
    add("position loose", "sigmas of position 100 times as large: attitudes hold the block", weighed(plain, 100.0, 1.0))
    add(
        "navigation loose",
        "all sigmas 100 times as large: it is the datum alone",
        weighed(plain, 100.0, 100.0),
    )
    add("no lever arm", "lever arm left out", found.block(lens, sensor=no_lever, control=False))
    add(OFF, f"positions off the control's datum by {-north[1]:.2f} m to the south", moved(plain, north))
    add(OFF_UP, f"the same, and by {up[2]:.2f} m upwards", moved(plain, north + up))
    add(FOCAL, "focal length unknown", plain, Unknowns(focal=Free()))
    add("one heading", "every second strip flown backwards", other.block(lens, control=False), of=other)
    add(APART, "no tie points between strips", apart)
    add(APART_OFF, f"the same, and positions off by {-north[1]:.2f} m to the south", moved(apart, north))
    return nets


def weighed(block: Block, position: float, attitude: float) -> Block:
    """The block with the navigation's standard deviations multiplied by `position` and `attitude`."""
    navigation = block.navigation
    assert navigation is not None
    return replace(
        block,
        navigation=replace(
            navigation,
            information_position=navigation.information_position / position,
            information_attitude=navigation.information_attitude / attitude,
        ),
    )


def moved(block: Block, shift: np.ndarray) -> Block:
    """The block with its observed positions shifted by (3,) m in the frame."""
    navigation = block.navigation
    assert navigation is not None
    return replace(block, navigation=replace(navigation, position=navigation.position + shift))

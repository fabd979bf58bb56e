"""What it saves to search only where the navigation's errors allow, and what that does to the choice of matches."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from jaxgeo.register import AbstractChoice, AffineCheck, Clusters, PoseConsensus
from jaxgeo.register.choice import Chosen
from jaxgeo.studies.gu2017 import printed
from jaxgeo.studies.gu2017.accuracy import within
from jaxgeo.studies.gu2017.mapped import Blocks, blocks, mapped, unknowns
from jaxgeo.studies.gu2017.scene import Imaged, disturbed, navigation, spoilt

FAR = 180.0  # cells to all sides: far beyond what the navigation allows
WARM = 8  # blocks that go through a program at once
CHOICES: dict[str, AbstractChoice] = {
    "K-means": Clusters(),
    "affine": AffineCheck(),
    "pose": PoseConsensus(),
}


class Sought(NamedTuple):
    """What is searched: standard deviations of the navigation, m and deg, side of a block in cells, noise of the image,
    times its own standard deviation, and how far above chance a candidate has to correlate: zero takes all, as the
    paper seems to."""

    position: float
    attitude_deg: float
    block: int
    noise: float
    above_chance: float


SCENES = (
    Sought(10.0, 0.05, 100, 0.1, 1.0),  # the navigations of the paper's first two rows; some 16 blocks
    Sought(50.0, 0.5, 100, 0.1, 1.0),
    Sought(50.0, 0.5, 64, 1.0, 0.0),  # a poor image in small blocks
)
CONSTRAINED, WHOLE = "3 sigma", "unconstrained"


class Searched(NamedTuple):
    """One search of all blocks: whole shifts compared, seconds (compiled before), how many blocks have a candidate, and
    of how many the best one is wrong; by each choice how many were chosen, and how many of these wrong. Blocks count
    whose true place is known."""

    sought: Sought
    search: str
    blocks: int
    cells: int
    seconds: float
    candidates: int
    best_wrong: int
    chosen: dict[str, tuple[int, int]]
    found: Blocks
    of_choices: dict[str, Chosen]


def searches(im: Imaged, seed: int = 0) -> list[Searched]:
    """Constrained and unconstrained search of the same blocks, in each of the `SCENES`; none but of an image made."""
    if im.true is None or im.clear is None:
        return []
    rows = []
    for sought in SCENES:
        rng = np.random.default_rng([seed, 5])
        given = disturbed(im.true, rng, metres=sought.position, degrees=sought.attitude_deg)
        spoiled = im._replace(image=spoilt(im.clear, seed, noise=sought.noise)[0])
        here = mapped(spoiled, given, navigation(sought.position, sought.attitude_deg))
        probability = within(printed.SEARCHED)
        for name, cov in ((CONSTRAINED, None), (WHOLE, ((FAR - 1.0) / printed.SEARCHED) ** 2 * np.eye(2))):
            options = (sought.block, probability, cov, sought.above_chance)
            blocks(here, *options, most=None if cov is None else WARM)  # compiles: all sizes of windows
            began = time.perf_counter()
            found = blocks(here, *options)
            rows.append(_counted((sought, name), found, time.perf_counter() - began, unknowns(here.errors)))
    return rows


def _counted(case: tuple[Sought, str], found: Blocks, seconds: float, cov: np.ndarray) -> Searched:
    known = np.isfinite(found.true).all(axis=1) & np.asarray(found.shifts.seen)
    has_any = found.matches.is_candidate.any(axis=1) & known
    best = np.asarray(found.matches.shift)[:, 0]
    of_choices = {name: choice.choose(found.matches, found.jacobian, cov) for name, choice in CHOICES.items()}
    chosen = {}
    for name, one in of_choices.items():
        mine = one.is_chosen & known
        chosen[name] = int(mine.sum()), int((found.is_off(one.of(found.matches.shift)) & mine).sum())
    return Searched(
        *case,
        blocks=int(known.sum()),
        cells=int(np.sum(np.asarray(found.matches.searched)[known])),
        seconds=seconds,
        candidates=int(has_any.sum()),
        best_wrong=int((found.is_off(best) & has_any).sum()),
        chosen=chosen,
        found=found,
        of_choices=of_choices,
    )

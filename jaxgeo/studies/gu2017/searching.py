"""Cost savings of a search limited by the navigation errors, and its effect on the selection of matches."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxgeo.register import AbstractChoice, AffineCheck, Clusters, PoseConsensus
from jaxgeo.register.choice import Chosen
from jaxgeo.studies.gu2017 import printed
from jaxgeo.studies.gu2017.accuracy import within
from jaxgeo.studies.gu2017.mapped import Blocks, Mapped, allowed, blocks, mapped, unknowns
from jaxgeo.studies.gu2017.scene import Imaged, disturbed, navigation, repeated, seen_again, shows

FAR = 160.0  # cells in every direction: far beyond the navigation errors
DRAWS = 3  # redraws of noise, navigation errors and elevation model errors, in each scene
LOOSE = 20.0  # cells: with this limit on a match's standard deviation none is rejected, as in the paper
SPOILT = 0.1  # share of the chosen blocks: with more wrong ones a choice is useless
CHOICES: dict[str, AbstractChoice] = {
    "K-means": Clusters(),
    "affine": AffineCheck(),
    "pose": PoseConsensus(),
}


class Sought(NamedTuple):
    """Search parameters: standard deviations of the navigation, m and deg, block side in cells, image noise as a
    multiple of the image's own standard deviation, required correlation above chance (zero accepts all, as the paper
    seems to), largest standard deviation in cells of an accepted match, and the period of a repeating texture in
    cells, with its share of the variance."""

    name: str
    position: float
    attitude_deg: float
    block: int
    noise: float = 0.1
    above_chance: float = 1.0
    largest_sigma: float = 1.0
    period: int = 0
    share: float = 0.0


SCENES = (
    Sought("plain", 10.0, 0.05, 100),  # navigation as in the paper's first two rows; about 16 blocks
    Sought("plain, far off", 50.0, 0.5, 100),
    Sought("small, far off", 50.0, 0.5, 40),
    Sought("repeated", 10.0, 0.05, 64, 4.0, 0.0, LOOSE, period=24, share=0.97),
    Sought("repeated, far off", 50.0, 0.5, 64, 4.0, 0.0, LOOSE, period=24, share=0.97),
    Sought("noisy", 10.0, 0.05, 64, 25.0, 0.0, LOOSE),
)
CONSTRAINED, WHOLE = "3 sigma", "unconstrained"


class Searched(NamedTuple):
    """One search of all blocks in several draws: whole shifts compared, seconds per draw (without the first, which
    compiles), number of blocks with known content, with a candidate, with their true shift inside the search window,
    and with a wrong best candidate; for each choice the number chosen, the number of these that are wrong, and the
    number of draws in which it is useless: more than `SPOILT` of its blocks wrong, or fewer than 3 chosen. `found`
    and `of_choices` are of the first draw."""

    sought: Sought
    search: str
    draws: int
    blocks: int
    cells: int
    seconds: float
    candidates: int
    inside: int
    best_wrong: int
    chosen: dict[str, tuple[int, int]]
    useless: dict[str, int]
    found: Blocks
    of_choices: dict[str, Chosen]


def searches(im: Imaged, seed: int = 0, draws: int = DRAWS, scenes: Sequence[Sought] = SCENES) -> list[Searched]:
    """Constrained and unconstrained search of the same blocks, in each scene; empty unless the image is simulated."""
    if im.true is None or im.clear is None:
        return []
    rows = []
    for sought in scenes:
        here = shows(im, repeated(im.reference, sought.period, sought.share)) if sought.period else im
        rows += _of_scene(here, sought, range(seed, seed + draws))
    return rows


def _of_scene(im: Imaged, sought: Sought, seeds: Sequence[int]) -> list[Searched]:
    assert im.true is not None
    errors = navigation(sought.position, sought.attitude_deg)
    windows: dict[str, np.ndarray] = {WHOLE: ((FAR - 1.0) / printed.SEARCHED) ** 2 * np.eye(2)}
    found: dict[str, list[Searched]] = {CONSTRAINED: [], WHOLE: []}
    for seed in seeds:
        rng = np.random.default_rng([seed, 5])
        given = disturbed(im.true, rng, metres=sought.position, degrees=sought.attitude_deg)
        here = mapped(seen_again(im, seed, sought.noise), given, errors)
        windows.setdefault(CONSTRAINED, allowed(here, sought.block))
        for name, rows in found.items():
            rows.append(_searched(here, sought, name, windows[name]))
    return [_summed(rows) for rows in found.values()]


def _searched(here: Mapped, sought: Sought, name: str, cov: np.ndarray) -> Searched:
    began = time.perf_counter()
    found = blocks(
        here, sought.block, within(printed.SEARCHED), cov, sought.above_chance, largest_sigma=sought.largest_sigma
    )
    seconds = time.perf_counter() - began
    known = np.isfinite(found.true).all(axis=1) & np.asarray(found.shifts.visible)
    has_any = found.matches.is_candidate.any(axis=1) & known
    true = found.true[known]
    inside = np.einsum("ni,ni->n", true, np.linalg.solve(cov, true.T).T) <= printed.SEARCHED**2
    of_choices = {
        way: choice.choose(found.matches, found.jacobian, unknowns(here.errors)) for way, choice in CHOICES.items()
    }
    chosen, useless = {}, {}
    for way, one in of_choices.items():
        mine = one.is_chosen & known
        number, wrong = int(mine.sum()), int((found.is_off(one.of(found.matches.shift)) & mine).sum())
        chosen[way], useless[way] = (number, wrong), int(number < 3 or wrong > SPOILT * number)
    return Searched(
        sought,
        name,
        1,
        blocks=int(known.sum()),
        cells=int(np.sum(np.asarray(found.matches.searched)[known])),
        seconds=seconds,
        candidates=int(has_any.sum()),
        inside=int(inside.sum()),
        best_wrong=int((found.is_off(np.asarray(found.matches.shift)[:, 0]) & has_any).sum()),
        chosen=chosen,
        useless=useless,
        found=found,
        of_choices=of_choices,
    )


def _summed(rows: Sequence[Searched]) -> Searched:
    """All draws combined."""
    names = ("draws", "blocks", "cells", "candidates", "inside", "best_wrong")
    totals: dict[str, Any] = {name: sum(getattr(row, name) for row in rows) for name in names}
    later = rows[1:] if len(rows) > 1 else rows
    totals["seconds"] = float(np.mean([row.seconds for row in later]))
    totals["chosen"] = {
        way: (sum(row.chosen[way][0] for row in rows), sum(row.chosen[way][1] for row in rows)) for way in CHOICES
    }
    totals["useless"] = {way: sum(row.useless[way] for row in rows) for way in CHOICES}
    return rows[0]._replace(**totals)

"""Significance of a block agreement: expected number of false alarms, and the second-best set."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import AbstractChoice, Chosen


def false_alarms(matches: Matches, chosen: Chosen) -> float:
    """Expected number of sets as large as the chosen one if all candidates were random: smaller is more significant.

    A-contrario reasoning after Desolneux, Moisan and Morel (2000), "Meaningful alignments", and Moisan and Stival
    (2004), "A probabilistic criterion to detect rigid point matches between two images": the number of hypotheses
    compared, times the probability that at least as many blocks agree with one by chance. A block agrees by chance with
    probability 1 - (1 - area / searched)^candidates, its candidates spread evenly over the searched area. The blocks
    that define a hypothesis agree with it in any case and are not counted: those with the least probability are left
    out. One alarm in a million images is a usual limit. The result is at most `chosen.hypotheses`, which is also its
    value without agreement, and at least 1 if there are no candidates.
    """
    candidates = np.sum(matches.is_candidate, axis=1)
    offered = candidates > 0
    if chosen.count == 0 or not offered.any():
        return float(max(chosen.hypotheses, 1))
    share = np.clip(np.asarray(chosen.area)[offered] / np.maximum(np.asarray(matches.searched)[offered], 1), 0.0, 1.0)
    probability = np.sort(1.0 - (1.0 - share) ** candidates[offered])[chosen.fitted :]
    return float(chosen.hypotheses * at_least(probability, chosen.count - chosen.fitted))


def at_least(probability: Float[np.ndarray, " n"], count: int) -> float:
    """Probability that `count` or more of independent events occur (tail of the Poisson-binomial distribution)."""
    if count <= 0:
        return 1.0
    if count > len(probability):
        return 0.0
    happened = np.zeros(len(probability) + 1)
    happened[0] = 1.0
    for p in probability:
        happened[1:] = happened[1:] * (1.0 - p) + happened[:-1] * p
        happened[0] *= 1.0 - p
    return float(min(np.sum(happened[count:]), 1.0))


def second_best(
    choice: AbstractChoice,
    matches: Matches,
    chosen: Chosen,
    jacobian: Any = None,
    cov_error: Any = None,
    *,
    apart: float = 6.0,
) -> Chosen:
    """The best set that shares no candidate with the chosen one and has none within `apart` cells of one.

    Blocks without a chosen candidate keep all their candidates. Over repetitive texture this set is about as large as
    the chosen one, and neither is reliable.
    """
    return choice.choose(matches.only(_elsewhere(matches, chosen, apart)), jacobian, cov_error)


def _elsewhere(matches: Matches, chosen: Chosen, apart: float) -> Bool[np.ndarray, "n peaks"]:
    """Flags of candidates farther than `apart` from the chosen one of their block."""
    taken = chosen.of(matches.shift)
    squared = np.sum((np.asarray(matches.shift) - taken[:, None, :]) ** 2, axis=-1)
    with np.errstate(invalid="ignore"):
        return matches.is_candidate & ~(squared < apart**2)

"""Blunders of all kinds in simulated blocks: what can be told by dense algebra is named, and little else.

Held against what can be told by an independent computation; `benchmarks/blunders.py` is the whole study.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from jaxgeo.adjust import adjust, without_blunders
from tests.support import blunder_study as study

pytestmark = pytest.mark.costly

SMALL = study.LAYOUTS[:1]


@pytest.mark.slow
def test_blunders_that_can_be_told_are_named_and_good_measurements_are_not() -> None:
    outcomes = []
    for layout, seed, kinds in study.drawn(24, SMALL):
        case = study.spoiled(layout, seed, kinds)
        found = without_blunders(case.block, alpha=study.familywise(case.block))[1]
        outcomes.append(study.outcome(case, found))
    told = [named for outcome in outcomes for one, named in outcome.named if one.can_be_told]
    assert len(told) > 40
    assert sum(told) >= 0.99 * len(told)
    false = sum(bool(outcome.false) for outcome in outcomes)
    assert false <= stats.binom.ppf(0.999, len(outcomes), 0.05)
    case, off = study.all_in_wrong_zone(SMALL[0], 900, neighbour=True)
    error = study.refusal(adjust, case)
    assert error is not None
    np.testing.assert_allclose(error.shift, off, atol=0.01 * np.linalg.norm(off))


@pytest.mark.slow
def test_in_good_blocks_nothing_is_named_but_by_chance() -> None:
    names = 0
    for seed in range(12):
        block = study.clean(SMALL[0], 500 + seed).block
        names += bool(without_blunders(block, alpha=study.familywise(block))[1])
    assert names <= stats.binom.ppf(0.999, 12, 0.05)


def test_of_two_rays_an_error_along_the_epipolar_line_cannot_be_told_and_one_across_can_be_told_of_both() -> None:
    case = study.clean(SMALL[0], 1)
    of, seen = study.truth(SMALL[0]), case.block.observations
    names, counts = np.unique(seen.point, return_counts=True)
    pair = next(name for name in names[counts == 2].tolist() if name.startswith("tie"))
    row, other = np.flatnonzero(seen.point == pair).tolist()
    away = of.places[of.point[row]] + 0.1 * (of.places[of.point[row]] - of.centre[of.image[other]])
    uv, _ = study._pixels(of.centre[of.image[row]], of.R[of.image[row]], away)
    along = (uv - of.uv[row]) / np.linalg.norm(uv - of.uv[row])
    across = np.array([-along[1], along[0]])
    judged = [
        study._judged(case, [study.Wrong("image measurement", "image point", row, 20.0 * way)], 1e-4)[0]
        for way in (along, across)
    ]
    assert [one.detectable for one in judged] == [False, True]
    assert [one.separable for one in judged] == [False, False]

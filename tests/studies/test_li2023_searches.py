"""The searches of Li et al. (2023): their cost on planes, over synthetic terrain, and beside the printed Table 4."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from jaxgeo.studies import li2023
from jaxgeo.studies.claims import Verdict, resolve
from jaxgeo.studies.li2023 import claims_on_searches as claims
from jaxgeo.studies.li2023 import searches
from jaxgeo.studies.li2023.search_sheets import nearest_segments, savings_note, search_sheets, settings_verdict
from jaxgeo.studies.li2023.searches import KINDS, Choice, Comparison, Trial, interval, printed_ratios
from jaxgeo.studies.terrain_searches import Found
from jaxgeo.terrain import Outcome

IN_TEXT = [f"Fig. {n}" for n in ("6", "7, (a)", "7, (b)", "8, (a)", "8, (b)", "9", "10", "11")]
IN_TEXT += [*(f"Table 4, {kind}" for kind in ("plain", "hill", "mountain")), "Abstract", "Section 5.2", "Section 6"]


def found_of(evaluations: list[float], outcomes: list[Outcome] | None = None) -> Found:
    asked = np.array(evaluations, float)
    codes = np.array([one.value for one in outcomes or [Outcome.first_hit] * len(asked)])
    return Found(asked, codes, np.zeros(asked.size), np.full(asked.size, 0.1), 1.0)


@pytest.fixture(scope="module")
def made() -> Comparison:
    """Two terrains of each kind with costs like those of the print, and one mountain ray in ten in the tail."""
    trials = []
    for kind in KINDS:
        of_fast = (10.0, 10.0, 10.0, 12.0)
        for seed in (1, 2):
            for name, times in zip(searches.IN_PRINT, (*printed_ratios(kind), 1.0), strict=True):
                trials.append(Trial(kind, seed, name, found_of([times * x for x in of_fast])))
            for name in ("photogrammetric", "first hit"):
                lost = [Outcome.first_hit] * 3 + [Outcome.cycled if kind == "mountain" else Outcome.first_hit]
                trials.append(Trial(kind, seed, name, found_of([5.0] * 4, lost)))
    spread = {(k, m): interval(np.mean, [0.1 * k + 0.001 * m] * 2) for k in searches.STEPS for m in searches.SEGMENTS}
    printed = {kind: (*printed_ratios(kind), 1.0) for kind in KINDS}
    groups = (searches.FREE, searches.FREE_AND_CONSTANT, searches.SINGLE, searches.SINGLE_AND_CONSTANT)
    return Comparison(trials, spread, [Choice(group, "as printed", printed) for group in groups], 4)


def test_evaluations_on_planes() -> None:
    """From 200 m above to 0.2 m: every step leaves (1 - k) / 2 of the error, and D is (1 + k) times it."""
    for k, expected in zip(claims.SLOPES, (91, 23, 11, 7, 4), strict=True):
        steps = math.ceil(math.log(0.2 / (200.0 * (1.0 + k))) / math.log((1.0 - k) / 2.0))
        assert claims.evaluations_as_printed(k) == expected == steps + 1


@pytest.mark.slow
def test_what_is_said_of_planes() -> None:
    found = {one.item: one for one in li2023.plane_claims()}
    assert found["Fig. 11"].obtained == [91.0, 23.0, 11.0, 7.0, 4.0]
    unexplained = [item for item, one in found.items() if one.verdict is not Verdict.reproduced]
    assert unexplained == ["Fig. 8, (b)"]  # on a plane that falls away the improved iteration converges


def test_a_table_as_printed_is_reproduced(made) -> None:
    """Costs in the printed ratios give the printed table, the printed saving and no other."""
    rows = {one.item: one for one in claims._table_4(made)}
    assert all(one.verdict is Verdict.reproduced for one in rows.values())
    assert made.saving("mountain").value == pytest.approx(0.4548, abs=1e-4)
    assert made.saving("mountain", np.median).value == pytest.approx(0.4548, abs=1e-4)
    assert "Of 2 choices over many rays 2 gives the three ratios" in settings_verdict(made)
    doubled = [
        dataclasses.replace(one, found=found_of(list(2.0 * one.found.evaluations))) if one.search == "fast" else one
        for one in made.trials
    ]
    other = dataclasses.replace(made, trials=doubled)
    assert all(
        one.verdict is not Verdict.reproduced or one.item.startswith("Section 5.2, T")
        for one in [*claims._savings(other)]
    )
    assert all(one.verdict is Verdict.explained for one in claims._table_4(other))


def test_tables_of_what_was_made(made) -> None:
    sheets = {one.name: one for one in search_sheets(made)}
    assert list(sheets) == ["searches", "savings", "segments", "settings"]
    rows = {(row[0], row[1]): row for row in sheets["searches"].texts()}
    assert len(rows) == 18
    assert rows["mountain", "improved"][11:14] == ["4.29", "4.29", "4.29"]
    assert rows["mountain", "photogrammetric"][5:9] == ["75.0", "0.0", "25.0", "0.0"]
    assert nearest_segments(made)[0] == (4, 32)
    assert "costs 4.29 times as much" in savings_note(made)
    assert "saves 45 % by the mean" in savings_note(made)


def test_distances() -> None:
    """Every ratio twice the printed one is off by 2; times about their best common factor."""
    twice = {kind: (*(2.0 * x for x in printed_ratios(kind)), 1.0) for kind in KINDS}
    choice = Choice("", "", twice)
    assert choice.distance() == pytest.approx(2.0)
    assert choice.farthest(["hill"]) == pytest.approx(2.0)
    assert not choice.gives_print(["hill"])
    times = Choice("", "", {kind: tuple(7.0 * x for x in searches.printed_times(kind)) for kind in KINDS})
    assert times.distance_of_times() == pytest.approx(1.0)
    assert times.gives_print()


def test_the_nearest_of_all_is_found() -> None:
    """Among costs drawn at random the variants and rays that were made to fit are found."""
    rng = np.random.default_rng(3)
    sizes, fitting, rays = (3, 4, 5, 2), (1, 3, 2, 1), {"plain": 4, "hill": 0, "mountain": 6}
    costs = {}
    for kind in KINDS:
        of = {name: rng.uniform(1.0, 500.0, (n, 8)) for name, n in zip(searches.IN_PRINT, sizes, strict=True)}
        for name, i, ratio in zip(searches.IN_PRINT, fitting, (*printed_ratios(kind), 1.0), strict=True):
            of[name][i, rays[kind]] = 20.0 * ratio
        costs[kind] = of
    distance, chosen, found = searches._nearest(costs)
    assert distance == pytest.approx(0.0, abs=1e-12)
    assert (tuple(chosen.values()), found) == (fitting, rays)


def test_intervals() -> None:
    """The bootstrap's standard error is that of a mean, and pairs stay pairs."""
    values = np.random.default_rng(1).normal(5.0, 1.0, 40)
    found = interval(np.mean, list(values))
    assert found.error == pytest.approx(values.std() / math.sqrt(40.0), rel=0.1)
    assert found.low < found.value < found.high
    same = interval(searches._saving, list(values), list(0.5 * values))
    assert (same.value, same.low, same.high) == pytest.approx((0.5, 0.5, 0.5))


def test_refusals() -> None:
    with pytest.raises(ValueError, match="terrains must be at least 2; got 1"):
        li2023.compare_searches(terrains=1)
    with pytest.raises(ValueError, match="rays must be at least 8; got 7"):
        li2023.run(rays=7)


@pytest.mark.slow
def test_the_searches_over_terrains() -> None:
    """Of two small terrains of each kind: what is cheap is not what is right, and the claims are complete."""
    found = li2023.compare_searches(terrains=2, rays=100, size=401)
    for kind in KINDS:
        exhaustive, fast = (found.evaluations(kind, name).mean() for name in ("exhaustive", "fast"))
        assert exhaustive > 5.0 * fast
        assert found.share(kind, "first hit", Outcome.first_hit).value > 0.98  # by the exhaustive search
    right = {name: found.share("mountain", name, Outcome.first_hit).value for name in searches.SEARCHES}
    assert right["photogrammetric"] < 0.5 < right["segmented"] < right["fast"] <= 1.0
    assert found.saving("mountain", np.median).value < 0.0
    assert found.ratio("mountain", "improved").value < 4.0
    shares = [found.segmented[k, 16].value for k in searches.STEPS]
    assert shares == sorted(shares, reverse=True)  # the fewer steps before, the more is saved
    single = found.nearest(searches.SINGLE_AND_CONSTANT)
    assert single.distance() <= found.nearest(searches.SINGLE).distance() <= found.nearest(searches.FREE).distance()
    made = li2023.search_claims(found)
    items = {one.item for one in made}
    assert items >= set(IN_TEXT)
    assert all(resolve(one.function) is not None for one in made if one.function)
    verdicts = {one.item: one.verdict for one in made}
    assert {verdicts[f"Table 4, {kind}"] for kind in KINDS} == {Verdict.unexplained}
    assert verdicts["Section 5.2, Table 4"] is Verdict.reproduced
    assert verdicts["Section 5.2, plain"] is Verdict.unexplained

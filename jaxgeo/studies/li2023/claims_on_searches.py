"""Claims of Li et al. (2023) about the searches, compared with the results obtained here."""

from __future__ import annotations

import functools
import math

import jax
import numpy as np

from jaxgeo.earth.ray import Ray
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2023.search_sheets import PRINTED_SAVING, nearest_segments, settings_verdict
from jaxgeo.studies.li2023.searches import (
    FREE,
    GIVES_PRINT,
    IN_PRINT,
    KINDS,
    NOT_CONVERGED,
    Comparison,
    printed_ratios,
    printed_times,
)
from jaxgeo.studies.scenes import profile_dem, profile_ray
from jaxgeo.studies.terrain_searches import approaches, run_from
from jaxgeo.terrain import Dem, Ending, FastIteration, HeightsBetween, ImprovedLiteral, Outcome, Photogrammetric, Run
from jaxgeo.terrain.search.literature.studied import AbstractStudiedSearch

PAPER = "Li 2023"
SLOPES = (-0.9, -0.5, 0.0, 0.5, 0.9)  # k: tan(ground slope along the view) / tan(depression)
ABOVE, EPS = 200.0, 0.2  # m: start height of the search above the target, and its tolerance
SPACING = 30.0  # m between posts
STANDARD_ERRORS = 3.0
SIMILAR = 1.2  # times the smallest: "equally efficient"; the printed times of the plain differ by 1.17
CONVERGES = 0.99  # share of rays

FAST = "jaxgeo.terrain.FastIteration"
RUN = "jaxgeo.studies.li2023.searches.compare_searches"


def plane_claims() -> list[Claim]:
    """Statements of sections 3 and 4 on planes, one run each: the steps of Fig. 11 and the cases of Figs 6 to 8."""
    fast = FastIteration(eps=EPS, window=HeightsBetween(0.0, ABOVE))
    photogrammetric = Photogrammetric(eps=EPS, start=ABOVE)
    improved = ImprovedLiteral(eps=EPS, start=ABOVE)
    counted = [int(_on_plane(k, fast).evaluations) for k in SLOPES]
    ends = {k: Ending(int(_on_plane(k, photogrammetric).ending)) for k in (0.5, 1.0, 1.2)}
    facing, behind = (Ending(int(_on_plane(k, improved).ending)) for k in (1.2, -0.9))
    slopes = ", ".join(f"{k:g}" for k in SLOPES)
    claims = [
        Claim(
            PAPER,
            "Fig. 11",
            f"evaluations of the printed steps on planes from {ABOVE:.0f} m above the target, k = {slopes}",
            [float(evaluations_as_printed(k)) for k in SLOPES],
            [float(n) for n in counted],
            function=FAST,
            digits=".0f",
        )
    ]
    statements = {
        "Fig. 6": (
            "photogrammetric iteration converges where the ground is flatter than the line of sight",
            ends[0.5],
            0,
        ),
        "Fig. 7, (a)": ("where slope and depression are equal it goes round between four corners", ends[1.0], 1),
        "Fig. 7, (b)": ("on a steeper slope it swings and does not approach the target", ends[1.2], None),
        "Fig. 8, (a)": ("the improved iteration converges where the ground faces the camera", facing, 0),
        "Fig. 8, (b)": ("it does not where the ground faces away", behind, None),
    }
    for item, (statement, ending, expected) in statements.items():
        came = ending != Ending.converged if expected is None else ending == Ending(expected)
        method = "ImprovedLiteral" if item.startswith("Fig. 8") else "Photogrammetric"
        function, reason = f"jaxgeo.terrain.{method}", f"On a plane: {ending.message}"
        if item == "Fig. 8, (b)" and not came:
            reason += " Outward from above a falling plane there is no ground, and the step is a photogrammetric one."
        claims.append(Claim(PAPER, item, statement, True, came, function=function, reason=reason))
    return claims


def evaluations_as_printed(k: float, above: float = ABOVE, eps: float = EPS) -> int:
    """Ground height evaluations of the steps of Fig. 11 on a plane, from `above` m over the target to `eps` in m.

    Over a plane through the target the ground below the ray's point at height Z is at -k Z.
    """
    high, low, asked = above, -k * above, 1  # Zmax and the ground height below it
    while True:
        middle = (high + low) / 2.0
        difference, asked = middle - (-k * middle), asked + 1
        if difference > eps:
            high, low = middle, -k * middle
        elif difference < 0.0:
            low = middle
        else:
            return asked


def _on_plane(k: float, search: AbstractStudiedSearch) -> Run:
    """A search along a ray with 45 deg depression onto a plane of slope k along it."""
    dem, rays = _plane(k)
    return jax.tree.map(lambda x: x[0], run_from(approaches(rays, dem), dem, search))


@functools.cache
def _plane(k: float) -> tuple[Dem, Ray]:
    dem = profile_dem(k * SPACING * np.arange(-64, 65), SPACING)
    ray = profile_ray(dem, 0.0, 0.0, depression=math.radians(45.0), altitude=3000.0)
    return dem, jax.tree.map(lambda x: x[None], ray)


def search_claims(found: Comparison) -> list[Claim]:
    """Table 4, the 45.5 %, and the statements of text and figures on the searches."""
    return [*plane_claims(), *_sketches(), *_table_4(found), *_savings(found), *_statements(found)]


def _sketches() -> list[Claim]:
    what = {"Fig. 9": "segments of the line of sight", "Fig. 10": "fast iteration"}
    return [Claim(PAPER, item, what[item], None, None, reason="A sketch without numbers.") for item in what]


def _table_4(found: Comparison) -> list[Claim]:
    """A row for each terrain: evaluation ratios to the fast search, explained by the closest of all settings."""
    names, free = ", ".join(IN_PRINT[:-1]), found.nearest(FREE)
    claims = []
    for kind in KINDS:
        printed = printed_ratios(kind)
        ratios = [found.ratio(kind, name) for name in IN_PRINT[:-1]]
        cause = Explanation(
            f"what the paper leaves open, chosen to suit: {free.name}",
            [ratio for one in KINDS for ratio in free.ratios(one)],
            [ratio for one in KINDS for ratio in printed_ratios(one)],
            [ratio * (GIVES_PRINT - 1.0) for one in KINDS for ratio in printed_ratios(one)],
        )
        statement = f"cost of {names} search over that of the fast one"
        tolerance = [STANDARD_ERRORS * ratio.error + 0.005 for ratio in ratios]
        claims.append(
            Claim(
                PAPER,
                f"Table 4, {kind}",
                statement,
                list(printed),
                [ratio.value for ratio in ratios],
                tolerance,
                function=RUN,
                explanation=cause,
                reason="Printed: times; obtained: mean evaluations. " + settings_verdict(found),
                digits=".2f",
            )
        )
    return claims


def _savings(found: Comparison) -> list[Claim]:
    _, _, segmented, fast = printed_times("mountain")
    mean, median = found.saving("mountain"), found.saving("mountain", np.median)
    (k, m), nearest = nearest_segments(found)
    with_segments = Explanation(
        f"K and M, which are not printed: with K = {k}, M = {m} for K = 6, M = 16 the saving is as printed",
        100.0 * nearest.value,
        100.0 * PRINTED_SAVING,
        100.0 * STANDARD_ERRORS * nearest.error,
    )
    share = float(np.mean(found.single_savings("mountain") >= PRINTED_SAVING))
    saved = [
        Claim(
            PAPER,
            "Section 5.2, Table 4",
            "time saved against the segmented search on mountains, from the printed times",
            100.0 * PRINTED_SAVING,
            100.0 * (1.0 - fast / segmented),
            0.05,
            "%",
            function="jaxgeo.studies.li2023.searches.printed_times",
            digits=".2f",
        )
    ]
    for item in ("Abstract", "Section 5.2", "Section 6"):
        saved.append(
            Claim(
                PAPER,
                item,
                "saved against the segmented search on mountains, mean of evaluations",
                100.0 * PRINTED_SAVING,
                100.0 * mean.value,
                100.0 * STANDARD_ERRORS * mean.error,
                "%",
                function=RUN,
                explanation=with_segments,
                reason=f"By the median {100.0 * median.value:.0f} %; so much of {100.0 * share:.0f} % of single rays.",
                digits=".1f",
            )
        )
    return saved


def _statements(found: Comparison) -> list[Claim]:
    """Statements of sections 3 to 5, tested by the shares and costs of the run."""

    def lost(kind: str, name: str) -> float:
        return found.share(kind, name, *NOT_CONVERGED).value

    def cost(kind: str, name: str) -> float:
        return float(found.evaluations(kind, name).mean())

    def claim(item: str, statement: str, holds: bool, reason: str, function: str = RUN) -> Claim:
        return Claim(PAPER, item, statement, True, bool(holds), function=function, reason=reason)

    def spread(kind: str, names: tuple[str, ...]) -> float:
        costs = [cost(kind, name) for name in names]
        return max(costs) / min(costs)

    def shares(names: tuple[str, ...], kind: str) -> str:
        return ", ".join(f"{name} {100.0 * lost(kind, name):.2f} %" for name in names)

    plain, hill = spread("plain", IN_PRINT), spread("hill", IN_PRINT[1:])
    over_fast = found.ratio("hill", "exhaustive").value
    flat = {kind: found.share(kind, "photogrammetric", Outcome.first_hit).value for kind in KINDS}
    both, exhaustive = ("segmented", "fast"), ("exhaustive",)
    ends = [one.found.clearance[one.found.outcomes < Outcome.cycled] for k in KINDS for one in found.of(k, "fast")]
    lowest = float(np.concatenate(ends).min())
    right = {name: found.share("mountain", name, Outcome.first_hit).value for name in (*both, "first hit")}
    return [
        claim(
            "Section 3, photogrammetric",
            "it suits flat terrain",
            flat["plain"] >= CONVERGES > flat["mountain"],
            "Right: " + ", ".join(f"{kind} {100.0 * share:.1f} %" for kind, share in flat.items()),
            "jaxgeo.terrain.Photogrammetric",
        ),
        claim(
            "Section 3, exhaustive",
            "it converges, with very many iterations in mountains",
            lost("mountain", "exhaustive") == 0.0 and cost("mountain", "exhaustive") > 10.0 * cost("mountain", "fast"),
            f"{cost('mountain', 'exhaustive'):.0f} evaluations a ray; not converged {shares(exhaustive, 'mountain')}",
            "jaxgeo.terrain.ExhaustiveFirst",
        ),
        claim(
            "Section 3, segmented",
            "it settles what the iterations before it leave unsettled",
            lost("mountain", "segmented") <= 1.0 - CONVERGES,
            f"Not converged on mountains: {shares(('improved', 'segmented'), 'mountain')}",
            "jaxgeo.terrain.Segmented",
        ),
        claim(
            "Section 4, always above the ground",
            "the fast search's points stay above the ground, so that it never goes round",
            lowest >= 0.0 and lost("mountain", "fast") == 0.0,
            f"Lowest end {lowest:.3f} m above the ground; not converged {shares(('fast',), 'mountain')}",
            FAST,
        ),
        claim(
            "Section 5.2, plain",
            "all searches converge and are equally efficient",
            plain <= SIMILAR and all(lost("plain", name) <= 1.0 - CONVERGES for name in IN_PRINT),
            f"Costs differ by a factor {plain:.1f}, without the exhaustive one {spread('plain', IN_PRINT[1:]):.1f}",
        ),
        claim(
            "Section 5.2, hill, exhaustive",
            "the exhaustive search is too tedious",
            over_fast >= printed_ratios("hill")[0],
            f"{over_fast:.0f} times the fast one's evaluations",
        ),
        claim(
            "Section 5.2, hill",
            "improved, segmented and fast search converge and are about equally efficient",
            hill <= SIMILAR and all(lost("hill", name) <= 1.0 - CONVERGES for name in IN_PRINT[1:]),
            f"Costs differ by a factor {hill:.1f}, the fast one's being the "
            + ("greatest" if cost("hill", "fast") == max(cost("hill", name) for name in IN_PRINT[1:]) else "lesser"),
        ),
        claim(
            "Section 5.2, mountain, improved",
            "the improved search tends not to converge",
            lost("mountain", "improved") > max(1.0 - CONVERGES, lost("hill", "improved")),
            f"Not converged: {shares(('improved',), 'mountain')}, in hills {shares(('improved',), 'hill')}",
        ),
        claim(
            "Section 5.2, mountain",
            "segmented and fast search converge",
            all(lost("mountain", name) <= 1.0 - CONVERGES for name in both),
            f"Not converged: {shares(both, 'mountain')}",
        ),
        claim(
            "Section 5.2, correct and robust",
            "the results show the fast search to be right",
            right["fast"] >= CONVERGES,
            "Right on mountains: " + ", ".join(f"{name} {100.0 * share:.1f} %" for name, share in right.items()),
            FAST,
        ),
    ]

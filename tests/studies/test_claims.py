"""Verdicts follow from the numbers, and from them alone."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from jaxgeo.studies.claims import Claim, Explanation, Verdict, claims_sheet, is_within, resolve

CLAIM = Claim("Paper", "Table 1", "a length", 1.25, 1.254, tolerance=0.005, unit="m", function="math.hypot")


def but(**changes: Any) -> Claim:
    return dataclasses.replace(CLAIM, **changes)


@pytest.mark.parametrize(
    "claim, verdict",
    [
        (CLAIM, Verdict.reproduced),
        (but(obtained=1.26), Verdict.unexplained),
        (but(obtained=math.nan), Verdict.unexplained),
        (but(obtained=1.26, explanation=Explanation("a factor", 1.2501, 1.25, 1e-3)), Verdict.explained),
        (but(obtained=1.26, explanation=Explanation("a factor", 1.2601, 1.25, 1e-3)), Verdict.unexplained),
        (but(obtained=1.26, explanation=Explanation("a factor", math.nan, 1.25, 1e-3)), Verdict.unexplained),
        (but(printed=None, reason="a sketch"), Verdict.not_from_print),
        (but(printed=True, obtained=False), Verdict.unexplained),
        (but(printed=True, obtained=True), Verdict.reproduced),
        (but(printed=(1.0, 2.0), obtained=(1.0, 2.006)), Verdict.unexplained),
        (but(printed=(1.0, 2.0), obtained=(1.0, 2.006), tolerance=(0.0, 0.01)), Verdict.reproduced),
    ],
)
def test_the_verdict_follows_from_the_numbers(claim: Claim, verdict: Verdict) -> None:
    assert claim.verdict is verdict
    row = claims_sheet([claim]).texts()[0]
    assert row[:3] == ["Paper", "Table 1", "a length"]
    assert row[6] == verdict.value


def test_an_explanation_that_does_not_hold_is_not_told() -> None:
    wrong = but(obtained=1.26, explanation=Explanation("a factor", 1.27, 1.25, 1e-3))
    assert "a factor" not in wrong.remark
    right = but(obtained=1.26, explanation=Explanation("a factor", 1.25, 1.25, 1e-3))
    assert right.remark == "a factor (with it 1.25, expected 1.25)"


def test_a_claim_is_complete() -> None:
    with pytest.raises(ValueError, match="a reason is needed"):
        but(printed=None)
    with pytest.raises(ValueError, match="needs an obtained one"):
        but(obtained=None)
    with pytest.raises(ValueError, match="2 obtained, 1 expected"):
        but(obtained=(1.0, 2.0))
    with pytest.raises(ValueError, match="3 tolerances"):
        is_within((1.0, 2.0), (1.0, 2.0), (0.1, 0.1, 0.1))


def test_functions_are_found_by_their_names() -> None:
    assert resolve("math.hypot") is math.hypot
    assert resolve("jaxgeo.studies.claims.Claim.verdict") is Claim.verdict
    for name in ("math.nothing", "nothing.at.all"):
        with pytest.raises(ValueError, match="names nothing that can be imported"):
            resolve(name)

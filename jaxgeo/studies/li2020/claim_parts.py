"""Shared helpers for the claims of Li et al. (2020)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020.equations import PAPER
from jaxgeo.studies.li2020.strips import AS_IN_THE_PAPER

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report
    from jaxgeo.studies.li2020.strips import Strips

LAST_DIGIT = 1e-4  # of Tables 1 to 3
ERRORS = 2.0  # standard errors within which a random result counts as reproduced
HELD = 0.02  # deg, deviation of a drive from the attitude: the control errors seen in Table 4
LEFT_OUT = "The flights were left out of this run."


def claim(item: str, statement: str, wanted: object, obtained: object, function: str, **more: object) -> Claim:
    """A claim of this paper; `function` is given without the package's name."""
    return Claim(PAPER, item, statement, wanted, obtained, function=f"jaxgeo.{function}", **more)  # type: ignore[arg-type]


def in_flight(
    report: Report, item: str, statement: str, function: str, of: Callable[[], tuple[object, object, dict[str, object]]]
) -> Claim:
    """A claim that needs the flights: `of` returns the printed and obtained values and further arguments."""
    if not report.strips:
        return claim(item, statement, None, None, function, reason=LEFT_OUT)
    wanted, obtained, more = of()
    return claim(item, statement, wanted, obtained, function, **more)


def strips_of(report: Report, ground: str, timing: str = AS_IN_THE_PAPER) -> Strips:
    """The strips over a ground with one timing method."""
    return next(one for one in report.strips if (one.ground, one.timing) == (ground, timing))


def column_of(report: Report, angle: str, field: str) -> list[float]:
    """A field of the rows of Tables 1 to 3 for one angle."""
    return [getattr(one, field) for one in report.influences if one.angle == angle]

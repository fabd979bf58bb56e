"""Claims of a paper: printed and obtained values, and the verdict that follows from them."""

from __future__ import annotations

import contextlib
import enum
import importlib
import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxgeo.studies.sheet import Cell, Sheet

Values = float | bool | Sequence[float]


class Verdict(enum.Enum):
    """Outcome of a claim."""

    reproduced = "reproduced"
    explained = "differs, explained"
    unexplained = "differs, unexplained"
    not_from_print = "not reproducible from print"


@dataclass(frozen=True)
class Explanation:
    """A possible cause of a difference, with a test run: including the cause gives `obtained`, compared with
    `expected`.

    For a result the expected values are the printed ones, for a misprinted formula those of the corrected formula.
    """

    cause: str
    obtained: Values
    expected: Values
    tolerance: Values

    @property
    def holds(self) -> bool:
        """Whether the run supports the cause."""
        return is_within(self.obtained, self.expected, self.tolerance)


@dataclass(frozen=True)
class Claim:
    """An equation, table, figure or statement of a paper: the printed and the obtained values, in the same unit.

    - `paper` as in "Li 2023"; `item` as in "Eq. 7", "Table 3, hill", "Fig. 5" or "Section 5.1"; `statement` describes
      the numbers.
    - `printed` is a number, several, or whether something holds; None if the paper gives no value to compare with;
      `reason` then explains why.
    - `tolerance` is the largest difference that counts as reproduced: the last printed digit or, for random results, a
      number of standard errors. Absolute, one for all values or one for each.
    - `function` is the full name of the function that computes it here.

    Raises `ValueError` if the numbers of values differ, or if both a printed value and a reason are missing.
    """

    paper: str
    item: str
    statement: str
    printed: Values | None
    obtained: Values | None
    tolerance: Values = 0.0
    unit: str = ""
    function: str = ""
    explanation: Explanation | None = None
    reason: str = ""
    digits: str = ".5g"

    def __post_init__(self) -> None:
        if self.printed is None and not self.reason:
            raise ValueError(f"{self.paper}, {self.item}: without a printed value a reason is needed.")
        if self.printed is not None and self.obtained is None:
            raise ValueError(f"{self.paper}, {self.item}: a printed value needs an obtained one.")
        if self.printed is not None and self.obtained is not None:
            is_within(self.obtained, self.printed, self.tolerance)

    @property
    def verdict(self) -> Verdict:
        """Verdict from the numbers; an explanation counts only if its own run supports it."""
        if self.printed is None or self.obtained is None:
            return Verdict.not_from_print
        if is_within(self.obtained, self.printed, self.tolerance):
            return Verdict.reproduced
        return Verdict.explained if self.explanation is not None and self.explanation.holds else Verdict.unexplained

    @property
    def remark(self) -> str:
        """The reason or the cause, with the numbers of its test run."""
        if self.explanation is None:
            return self.reason
        with_it, expected = (shown(x, self.digits) for x in (self.explanation.obtained, self.explanation.expected))
        bears = f"with it {with_it}, expected {expected}"
        explained = f"{self.explanation.cause} ({bears})" if self.verdict is Verdict.explained else ""
        return " ".join(text for text in (self.reason, explained) if text)


def is_within(obtained: Values, expected: Values, tolerance: Values) -> bool:
    """Whether every value is finite and within the tolerance of the expected one. Raises `ValueError` if the sizes
    differ."""
    found, wanted = _numbers(obtained), _numbers(expected)
    bounds = _numbers(tolerance) * (len(wanted) if len(_numbers(tolerance)) == 1 else 1)
    if not len(found) == len(wanted) == len(bounds):
        raise ValueError(f"{len(found)} obtained, {len(wanted)} expected values and {len(bounds)} tolerances.")
    return all(math.isfinite(a) and abs(a - b) <= bound for a, b, bound in zip(found, wanted, bounds, strict=True))


def shown(values: Values | None, digits: str) -> str:
    """Values as text."""
    if values is None:
        return "–"
    if isinstance(values, bool):
        return "yes" if values else "no"
    return " / ".join(format(value, digits) for value in _numbers(values))


def claims_sheet(claims: Sequence[Claim]) -> Sheet:
    """Table of all claims with their verdicts."""
    rows: list[list[Cell]] = []
    for one in claims:
        printed, obtained = (shown(values, one.digits) for values in (one.printed, one.obtained))
        rows.append(
            [
                one.paper,
                one.item,
                one.statement,
                printed,
                obtained,
                one.unit,
                one.verdict.value,
                one.function,
                one.remark,
            ]
        )
    names = ("paper", "item", "what", "printed", "obtained", "unit", "verdict", "function", "remark")
    counts = ", ".join(f"{sum(one.verdict is kind for one in claims)} {kind.value}" for kind in Verdict)
    return Sheet("claims", "Verdicts", dict.fromkeys(names, ""), rows, f"{len(claims)} in all: {counts}.")


def resolve(name: str) -> object:
    """The function or class with this full name. Raises `ValueError` if it does not exist."""
    first, *others = name.split(".")
    found: list[object] = [importlib.import_module(first)] if importlib.util.find_spec(first) is not None else []
    for count, part in enumerate(others, 1):  # a function may have the same name as its module: both are tried
        here: list[object] = [getattr(one, part) for one in found if hasattr(one, part)]
        with contextlib.suppress(ImportError):
            here.append(importlib.import_module(".".join([first, *others[:count]])))
        found = here
    if not found:
        raise ValueError(f"{name} names nothing that can be imported.")
    return found[0]


def _numbers(values: Values) -> list[float]:
    return [float(value) for value in values] if isinstance(values, Sequence) else [float(values)]

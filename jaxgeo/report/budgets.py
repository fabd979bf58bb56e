"""Template data of an error budget: bars and tooltips."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from jaxgeo.plot import words
from jaxgeo.uncertainty import Budget
from jaxgeo.uncertainty._budget import READ_AS, SigmaShare, SourceShare, Variance

MOST = 12  # bars; the rest are one bar
SMALL = 1e-4  # share of variance below which (in both) a source is not listed


class _Line(NamedTuple):
    name: str
    sigma: str
    variance: Variance
    without: float
    slope: str


def budget_of(budget: Budget) -> dict[str, Any]:
    """Rows, largest first, with their shares in percent, and the totals as text."""
    lines = sorted(_lines(budget), key=lambda one: (-one.variance.horizontal, -one.variance.vertical))
    shown = [one for one in lines[: MOST - 1] if max(_shares(one.variance, budget.total)) > SMALL]
    rest = lines[len(shown) :]
    if len(rest) == 1:
        shown, rest = lines, []
    name = f"CE{words.percent_name(budget.probability)}"
    rows = [_row(one, budget, name) for one in shown]
    if rest:
        variance = Variance(*(sum(parts) for parts in zip(*(one.variance for one in rest), strict=True)))
        rows.append(_row(_Line(f"{len(rest)} others", "", variance, math.nan, ""), budget, name))
    widest = max([max(row["horizontal"], row["vertical"]) for row in rows], default=1.0)
    return {
        "rows": rows,
        "scale": max(widest, 1e-9),
        "figure": name,
        "radius": words.length(budget.circular_error),
        "horizontal": words.length(math.sqrt(budget.total.horizontal)),
        "vertical": words.length(math.sqrt(budget.total.vertical)),
        "note": budget.note or "",
    }


def _row(one: _Line, budget: Budget, name: str) -> dict[str, Any]:
    across, up = _shares(one.variance, budget.total)
    known = math.isfinite(one.without)
    saved = 1.0 - one.without / budget.circular_error if known and budget.circular_error > 0.0 else math.nan
    tip = [
        (
            "alone, horizontal",
            f"{words.length(math.sqrt(one.variance.horizontal))} (1 sigma), {words.share(across)} of the variance",
        ),
        (
            "alone, vertical",
            f"{words.length(math.sqrt(one.variance.vertical))} (1 sigma), {words.share(up)} of the variance",
        ),
    ]
    if known:
        tip.append((f"{name} without it", f"{words.length(one.without)}, {words.share(saved)} less"))
    if known and one.slope:
        tip.append((f"{name} sensitivity", one.slope))
    return {
        "name": one.name,
        "sigma": one.sigma,
        "horizontal": 100.0 * across,
        "vertical": 100.0 * up,
        "without": words.length(one.without) if known else "",
        "tip": tip,
    }


def _shares(variance: Variance, total: Variance) -> tuple[float, float]:
    across, up = (part / whole if whole > 0.0 else 0.0 for part, whole in zip(variance, total, strict=True))
    return across, up


def _lines(budget: Budget) -> Iterator[_Line]:
    """Lines of a budget: each independent standard deviation, each block of correlated ones."""
    for source in budget.sources:
        if source.is_block:
            yield _block(source)
        for line in source.sigmas:
            if line.variance is not None:
                yield _Line(line.name, _sigma(line), line.variance, line.without, _slope(line))


def _block(source: SourceShare) -> _Line:
    return _Line(source.label, "", source.variance, source.without, "")


def _sigma(line: SigmaShare) -> str:
    """A standard deviation in display units."""
    unit, factor = READ_AS.get(line.unit, (line.unit, 1.0))
    return f"{line.sigma * factor:.3g}°" if unit == "deg" else f"{line.sigma * factor:.3g} {unit}"


def _slope(line: SigmaShare) -> str:
    unit, factor = READ_AS.get(line.unit, (line.unit, 1.0))
    return f"{line.slope / factor:.3g} m per {unit}"

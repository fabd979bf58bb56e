"""Error budgets as bar charts: the share of each error source in the variance, and the CE without it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import ScaledTranslation

from jaxgeo._checks import check_is
from jaxgeo.plot.legends import legend_of
from jaxgeo.plot.style import HAIR, HORIZONTAL, MUTED, VERTICAL, house_axes, metres
from jaxgeo.uncertainty import Budget
from jaxgeo.uncertainty._budget import SigmaShare

MOST = 10
ROOM = 1.14  # times the longest bar: axis limit, leaves space for the numbers
TALL, THIN = 0.46, 0.22  # of a row's height: the bar of the horizontal variance, and the vertical one below it
HEADER = 7.0  # points: the header of the column of numbers
DEGREES = 180.0 / math.pi


class _Row(NamedTuple):
    name: str
    sigma: str
    horizontal: float
    vertical: float
    without: float


def budget_bars(budget: Budget, ax: Axes | None = None, *, most: int = MOST, legend: bool = True) -> Axes:
    """Share of each error source in the horizontal and the vertical variance, %, the largest first.

    Beside each bar is the circular error in m that would remain without this source, all others unchanged. The `most`
    largest have bars of their own; the rest are summed in one. Raises `TypeError` for another record, `ValueError` for
    a `most` below 2 and for a budget without horizontal variance.
    """
    check_is(budget, Budget, "budget", "Make one with jaxgeo.uncertainty.budget.")
    if most < 2:
        raise ValueError(f"most must be 2 bars or more; got {most!r}.")
    if not budget.total.horizontal > 0.0:
        raise ValueError("the horizontal variance of this budget is zero: there is nothing to share.")
    rows = _shown(sorted(_rows(budget), key=lambda row: (-row.horizontal, -row.vertical)), most)
    title = f"{_figure(budget)} {budget.circular_error:.3g} m, sigma of height {math.sqrt(budget.total.vertical):.3g} m"
    with house_axes(ax, tall=0.55) as ax:
        handles = _bars(rows, ax)
        _figures(rows, budget, ax)
        ax.set_yticks(np.arange(len(rows)), [_label(row) for row in rows])
        ax.set_ylim(len(rows) - 0.45, -0.55)
        ax.set_xlim(0.0, ROOM * max(100.0 * max(row.horizontal, row.vertical) for row in rows))
        ax.set_xlabel("share of the variance, %")
        ax.tick_params(axis="y", length=0.0)
        ax.grid(True, axis="x")
        ax.set_axisbelow(True)
        ax.set_title(title, loc="right", fontsize="medium", fontweight="normal", pad=2.2 * HEADER)
        if legend:
            legend_of(ax, handles, loc="upper right", bbox_to_anchor=(1.0, 0.0))
    return ax


def _rows(budget: Budget) -> list[_Row]:
    """One row for each independent standard deviation and each block of correlated ones."""
    rows = []
    for source in budget.sources:
        lines = [] if source.is_block else source.sigmas
        parts = [(source.label, "", source.variance, source.without)] if source.is_block else []
        parts += [(one.name, _sigma(one), one.variance, one.without) for one in lines if one.variance is not None]
        for name, sigma, variance, without in parts:
            vertical = variance.vertical / budget.total.vertical if budget.total.vertical > 0.0 else 0.0
            rows.append(_Row(name, sigma, variance.horizontal / budget.total.horizontal, vertical, without))
    return rows


def _sigma(line: SigmaShare) -> str:
    """A standard deviation as display text."""
    if line.unit == "rad":
        return f"{DEGREES * line.sigma:.3g}°"
    return f"{line.sigma:.3g} {line.unit}"


def _shown(rows: list[_Row], most: int) -> list[_Row]:
    """The largest rows, with the others summed in one row if there are more than `most`."""
    if len(rows) <= most:
        return rows
    rest = rows[most - 1 :]
    others = (sum(row.horizontal for row in rest), sum(row.vertical for row in rest), math.nan)
    return [*rows[: most - 1], _Row(f"{len(rest)} others", "", *others)]


def _label(row: _Row) -> str:
    return f"{row.name}, {row.sigma}" if row.sigma else row.name


def _bars(rows: list[_Row], ax: Axes) -> list[Any]:
    """Draw the bars of both variances with their values."""
    place = np.arange(len(rows))
    across, up = (100.0 * np.array([getattr(row, name) for row in rows]) for name in ("horizontal", "vertical"))
    wide = ax.barh(place - 0.5 * THIN, across, TALL, color=HORIZONTAL, label="horizontal variance", zorder=2)
    thin = ax.barh(place + 0.5 * TALL, up, THIN, color=VERTICAL, label="vertical variance", zorder=2)
    ax.bar_label(wide, [f"{share:.1f}" for share in across], padding=2.5, fontsize="small")
    return [wide, thin]


def _figures(rows: list[_Row], budget: Budget, ax: Axes) -> None:
    """Draw a column right of the axes: the circular error without each source, m."""
    figure = ax.get_figure(root=False)
    assert figure is not None
    right = ScaledTranslation(30.0 / 72.0, 0.0, figure.dpi_scale_trans)
    style: dict[str, Any] = {"ha": "right", "fontsize": "small", "clip_on": False}
    for place, row in enumerate(rows):
        if math.isfinite(row.without):
            where = ax.get_yaxis_transform() + right
            ax.text(1.0, place, metres(row.without), transform=where, va="center", **style)
    where = ax.transAxes + right
    ax.text(1.0, 1.01, f"{_figure(budget)} without", transform=where, va="bottom", color=MUTED, **style)
    ax.axhline(-0.55, color=HAIR, linewidth=0.6)


def _figure(budget: Budget) -> str:
    return f"CE{100.0 * budget.probability:g}"

"""The bars of an error budget, and maps of accuracy."""

from __future__ import annotations

from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.container import BarContainer
from matplotlib.lines import Line2D

from jaxgeo._checks import check_is
from jaxgeo.earth import Geodetic
from jaxgeo.plot.cloud import JUMPED, SAMPLE
from jaxgeo.plot.maps import lonlat_deg
from jaxgeo.uncertainty import Budget, Trust

MOST_BARS = 12
MARKS = {Trust.facet: "o", Trust.footprint: "s", Trust.samples: "^"}
EDGES = {Trust.facet: "none", Trust.footprint: "white", Trust.samples: JUMPED}
COLOURS = "cividis"


def budget_bars(budget: Budget, ax: Axes, *, most: int = MOST_BARS) -> BarContainer:
    """Shares of an error budget in the horizontal variance, the largest first, with the circular error without each.

    The `most` largest are shown, all others as one. Raises `TypeError` for another record, `ValueError` for a `most`
    below 2 and for a budget of nothing.
    """
    check_is(budget, Budget, "budget", "Make one with jaxgeo.uncertainty.budget.")
    if most < 2:
        raise ValueError(f"most must be 2 bars or more; got {most!r}.")
    if not budget.total.horizontal > 0.0:
        raise ValueError("the horizontal variance of this budget is zero: there is nothing to share.")
    rows = sorted(_rows(budget), key=lambda row: -row[1])
    shown, rest = (rows, []) if len(rows) <= most else (rows[: most - 1], rows[most - 1 :])
    names = [name for name, _, _ in shown] + [f"{len(rest)} others"] * bool(rest)
    shares = [share for _, share, _ in shown] + [sum(share for _, share, _ in rest)] * bool(rest)
    place = np.arange(len(names))
    bars = ax.barh(place, 100.0 * np.array(shares), color=SAMPLE, height=0.68, zorder=2)
    ax.bar_label(bars, [f"{100.0 * share:.1f}" for share in shares], padding=3, fontsize=8.5)
    ax.set_yticks(place, names)
    ax.invert_yaxis()
    ax.set_xlim(0.0, 118.0 * max(shares))
    ax.set_xlabel("share of the horizontal variance, %")
    figure = f"CE{100.0 * budget.probability:g}"
    style: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "va": "center", "ha": "right", "fontsize": 9}
    for y, (_, _, without) in enumerate(shown):
        ax.text(1.14, y, f"{without:.2f}", **style)
    above = {**style, "transform": ax.transAxes, "va": "bottom"}
    ax.text(1.14, 1.01, f"{figure} without, m", **above)
    ax.set_title(f"{figure} {budget.circular_error:.2f} m", loc="left")
    return bars


def _rows(budget: Budget) -> list[tuple[str, float, float]]:
    """(name, share of the horizontal variance, circular error without) of all that has a share of its own."""
    rows = []
    for source in budget.sources:
        if source.is_block:
            rows.append((source.label, source.variance.horizontal, source.without))
        rows += [(one.name, one.variance.horizontal, one.without) for one in source.sigmas if one.variance is not None]
    return [(name, part / budget.total.horizontal, without) for name, part, without in rows]


def accuracy_map(
    error: Any,
    trust: Any,
    where: Any,
    ax: Axes,
    *,
    limits: tuple[float, float] | None = None,
    size: float = 16.0,
) -> tuple[ScalarMappable, list[Line2D]]:
    """A figure of accuracy in m at many places, by colour, and which method can be trusted there, by mark.

    `error` and `trust` (of `Trust`) have one shape; places without a positive `error` stay blank, an infinite one has
    the last colour. `where` is a `Geodetic` of that shape, for a map, or (..., 2) in px across and up, for an image: a
    lattice (rows, columns) of these is drawn as cells. `limits` are those of the colours in m, by default the 2nd and
    98th percentile of what is finite; `size` is that of the marks in points2. Returns what a colour bar needs, and
    handles for a legend. Raises `ValueError` for shapes that differ, codes that are no `Trust`, and errors of which
    none can be drawn.
    """
    error, trust = np.asarray(error, float), np.asarray(trust)
    on_map = isinstance(where, Geodetic)
    x, y = lonlat_deg(where) if on_map else np.moveaxis(np.asarray(where, float), -1, 0)
    for name, shape in (("trust", trust.shape), ("where", x.shape)):
        if shape != error.shape:
            raise ValueError(f"{name} must have the shape of error, {error.shape}; got {shape}.")
    if not np.isin(trust, list(Trust)).all():
        raise ValueError(f"trust must hold codes of Trust, {[int(one) for one in Trust]}; got {np.unique(trust)}.")
    known = (error > 0.0) & np.isfinite(x) & np.isfinite(y)
    finite = error[known & np.isfinite(error)]
    if not finite.size:
        raise ValueError("no place has an error that is positive and finite: there is nothing to draw.")
    low, high = np.quantile(finite, [0.02, 0.98]) if limits is None else limits
    error = np.minimum(error, high)
    colours = ScalarMappable(matplotlib.colors.LogNorm(low, max(high, 1.001 * low)), COLOURS)
    as_cells = error.ndim == 2 and not on_map
    if as_cells:
        cells = np.where(known[..., None], colours.to_rgba(error), 0.0)
        ax.pcolormesh(x, y, cells, shading="nearest", rasterized=True, zorder=1)
    return colours, [_marks(one, x, y, error, known & (trust == one), colours, ax, as_cells, size) for one in Trust]


def _marks(
    one: Trust,
    x: np.ndarray,
    y: np.ndarray,
    error: np.ndarray,
    here: np.ndarray,
    colours: ScalarMappable,
    ax: Axes,
    as_cells: bool,
    size: float,
) -> Line2D:
    """The places at which one method is trusted, and a handle; on cells, the cheapest method has no mark."""
    share = f"{one.words}, {100.0 * np.count_nonzero(here) / max(np.count_nonzero(np.isfinite(error)), 1):.0f} %"
    if as_cells and one is Trust.facet:
        return Line2D([], [], linestyle="none", label=f"no mark: {share}")
    edge = "black" if as_cells else EDGES[one]
    style: dict[str, Any] = {"marker": MARKS[one], "linewidths": 0.7, "edgecolors": edge, "zorder": 3 + 0.1 * one}
    ax.scatter(x[here], y[here], s=size, c="white" if as_cells else colours.to_rgba(error[here]), **style)
    fill = "white" if as_cells else "0.5"
    return Line2D([], [], linestyle="none", marker=MARKS[one], color=fill, markeredgecolor=edge, label=share)

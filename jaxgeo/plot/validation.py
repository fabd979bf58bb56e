"""A page on the comparison of actual with stated errors at check points."""

from __future__ import annotations

import textwrap
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from jaxgeo._checks import check_is
from jaxgeo.plot.style import BLUE, HAIR, HORIZONTAL, INK, MUTED, PAGE, SHADE, SKY, VERMILLION, VERTICAL, style
from jaxgeo.uncertainty import Validation
from jaxgeo.uncertainty.validation import LEVELS, SIGNIFICANCE, Dependence

TALL = 0.76  # of the width
WIDE = 84  # letters of a line of the title
CLOSE = 6.0  # sigmas of the axes up to which circles have labels
CIRCLES = ((0.5, 1.17741), (0.9, 2.14597), (0.95, 2.44775))  # probability and radius of the standard normal in 2D
SIZE_LIMITS = (0.268, 1.765)  # of the size of three standard normal errors, 95 %: roots of chi-square quantiles / 3


def validation_figure(found: Validation) -> Figure:
    """A page of six charts: normalised errors across, their transform's histogram, coverage, and dependences.

    - Errors east and north in their own sigmas, made independent, with the circles that contain 50, 90 and 95 % of
      them if the model is true.
    - Histogram of the probability integral transform: level within the band (95 %) if the model is true, high at both
      ends if it is too optimistic, high in the middle if too pessimistic.
    - Coverage of CE and LE against its nominal value, with intervals.
    - Size of the errors of each point in those of the model against range, look angle and slope; the band contains 95 %
      if the model is true. The line is the root mean square of groups of points, the correlation that of ranks.

    Returns the figure. Raises `TypeError` for another record.
    """
    check_is(found, Validation, "found", "Make one with jaxgeo.uncertainty.validate.")
    with mpl.rc_context(style(PAGE)):
        figure = Figure(figsize=(PAGE, TALL * PAGE), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 3)
        _scatter(found, axes[0, 0])
        _histogram(found, axes[0, 1])
        _coverage(found, axes[0, 2])
        for ax, one in zip(axes[1], found.dependence, strict=True):
            _dependence(found, one, ax)
        axes[1, 0].set_ylabel("errors / errors of the model")
        verdict, _, count = found.words.splitlines()[0].rpartition(". ")
        title = "\n".join([*textwrap.wrap(f"{verdict}.", WIDE), count])
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize="large")
    return figure


def _scatter(found: Validation, ax: Axes) -> None:
    points = found.normalised[:, :2]
    limit = max(3.2, 1.08 * float(np.abs(points).max()))
    for (level, radius), angle in zip(CIRCLES, np.deg2rad((225.0, 245.0, 295.0)), strict=True):
        ax.add_artist(Circle((0.0, 0.0), radius, fill=False, color=MUTED, linewidth=0.8, linestyle="--"))
        if limit < CLOSE:
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
            where = radius * np.cos(angle), radius * np.sin(angle)
            ax.text(*where, f"{100 * level:g}", ha="center", va="center", fontsize="small", color=MUTED, bbox=box)
    ax.axhline(0.0, color=HAIR, linewidth=0.6, zorder=0)
    ax.axvline(0.0, color=HAIR, linewidth=0.6, zorder=0)
    ax.plot(*points.T, "o", color=HORIZONTAL, markersize=3.0, markeredgewidth=0.0, alpha=0.75)
    inside = np.mean(np.hypot(*points.T) <= CIRCLES[1][1])
    ax.set_xlim(-limit, limit)
    ax.set_ylim(-limit, limit)
    ax.set_aspect("equal")
    ax.set_xlabel("east, sigmas")
    ax.set_ylabel("north, sigmas")
    ax.set_title("Normalised errors across")
    _note(ax, f"{100 * inside:.0f} % within the 90 % circle")


def _histogram(found: Validation, ax: Axes) -> None:
    counts = found.uniformity.counts
    total, bins = int(counts.sum()), len(counts)
    expected = total / bins
    half = 1.96 * np.sqrt(expected * (1.0 - 1.0 / bins))
    edges = np.linspace(0.0, 1.0, bins + 1)
    ax.axhspan(max(expected - half, 0.0), expected + half, color=SHADE, zorder=0)
    ax.axhline(expected, color=MUTED, linewidth=0.8, linestyle="--", zorder=3)
    ax.bar(edges[:-1], counts, width=1.0 / bins, align="edge", color=SKY, edgecolor="white", linewidth=0.6, zorder=2)
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(0.0, 1.25 * max(float(counts.max()), expected + half))
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_xlabel("probability of a smaller error")
    ax.set_ylabel("errors")
    ax.set_title("Are they normal?")
    _verdict(ax, "normal" if found.uniformity.p >= SIGNIFICANCE else "not standard normal", found.uniformity.p)


def _coverage(found: Validation, ax: Axes) -> None:
    for place, level in enumerate(LEVELS):
        ax.plot([place - 0.32, place + 0.32], [100.0 * level] * 2, color=MUTED, linewidth=1.0, linestyle="--", zorder=1)
    marks: Any = {"CE": ("o", HORIZONTAL, -0.12, "across (CE)"), "LE": ("s", VERTICAL, 0.12, "up (LE)")}
    for name, (marker, colour, aside, label) in marks.items():
        some = sorted((one for one in found.coverage if one.name.startswith(name)), key=lambda one: one.level)
        x, y = np.arange(len(some)) + aside, np.array([100.0 * one.share for one in some])
        ends = np.array([[100.0 * one.low, 100.0 * one.high] for one in some]).T
        bars = np.abs(ends - y)
        ax.errorbar(x, y, bars, fmt=marker, color=colour, markersize=4.0, capsize=2.0, linewidth=1.0, label=label)
    ax.set_xlim(-0.5, len(LEVELS) - 0.5)
    ax.set_ylim(0.0, 118.0)
    ax.set_yticks([0.0, 25.0, 50.0, 75.0, 100.0])
    ax.set_xticks(range(len(LEVELS)), [f"{100.0 * level:g} %" for level in LEVELS])
    ax.tick_params(axis="x", length=0.0)
    ax.set_xlabel("stated probability")
    ax.set_ylabel("points inside, %")
    ax.set_title("Coverage")
    ax.legend(loc="lower right")
    if found.effective < len(found.index):
        _note(ax, f"{len(found.index)} pixels count as {found.effective:.2g}", top=True)


def _dependence(found: Validation, one: Dependence, ax: Axes) -> None:
    size = np.sqrt(np.mean(found.normalised**2, axis=1))
    scale, unit = (1e-3, "km") if one.unit == "m" and one.values.max() >= 5000.0 else (1.0, one.unit)
    values = scale * one.values
    ax.axhspan(*SIZE_LIMITS, color=SHADE, zorder=0)
    ax.axhline(1.0, color=MUTED, linewidth=0.8, linestyle="--", zorder=1)
    ax.plot(values, size, "o", color=BLUE, markersize=3.0, markeredgewidth=0.0, alpha=0.75)
    known = np.isfinite(one.p)
    if known and len(values) >= 12:
        order = np.argsort(values)
        parts = np.array_split(order, min(6, len(values) // 4))
        x = [float(np.median(values[part])) for part in parts]
        y = [float(np.sqrt(np.mean(size[part] ** 2))) for part in parts]
        ax.plot(x, y, "-", color=VERMILLION, linewidth=1.5)
    ax.set_ylim(0.0, max(2.4, 1.25 * float(size.max())))
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.set_xlabel(f"{one.name}, {unit}")
    ax.set_title(f"By {one.name}")
    if known:
        _verdict(ax, f"correlation {one.correlation:+.2f}", one.p)
    else:
        _note(ax, "the same for all: not tested", top=True)


def _verdict(ax: Axes, words: str, p: float) -> None:
    shown = f"p = {p:.2g}" if p >= 1e-4 else "p < 0.0001"
    text = ax.text(0.03, 0.97, f"{words}, {shown}", transform=ax.transAxes, va="top", fontsize="small")
    text.set_color(INK if p >= SIGNIFICANCE else VERMILLION)


def _note(ax: Axes, words: str, top: bool = False) -> None:
    place = (0.03, 0.97, "top") if top else (0.03, 0.03, "bottom")
    ax.text(*place[:2], words, transform=ax.transAxes, va=place[2], fontsize="small", color=INK)

"""Figure style: colour-blind safe colours with fixed meanings, font sizes, axes of new figures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

COLUMN, PAGE = 80.0 / 25.4, 7.0  # inches: a column of 80 mm, and both columns of a page

# Okabe and Ito (2008), "Color universal design". Colours that occur together in a figure stay distinct under all colour
# vision types (tests/test_plot_style.py); markers, widths or dashes differ too, for print in grey.
INK, MUTED, HAIR = "#1a1a1a", "#5f5f5f", "#d0d0d0"
BLUE, SKY, GREEN = "#0072b2", "#56b4e9", "#009e73"
ORANGE, VERMILLION, PURPLE = "#e69f00", "#d55e00", "#8f3f71"
VIOLET = "#4a148c"
EARTH, SHADE = "#cdb896", "#eeeeee"

# Meaning of each colour, in every figure.
FIX = VERMILLION  # first intersection of a line of sight; errors
SIGHT = CAMERA = BLUE  # the camera and its lines of sight
HIDDEN = PURPLE  # ground hidden by terrain
EDGE = INK  # edges of images
TERRAIN = EARTH  # terrain in a profile
SAMPLE, SAMPLED = SKY, BLUE  # sampled errors, and their statistics
JUMPED = VERMILLION  # sampled errors on other ground
REGION = VIOLET  # highest-density regions
LINEAR = (INK, ORANGE, PURPLE)  # linear propagation: over the facet, over the footprint, any other
METHODS = ("#cfe6f6", GREEN, ORANGE)  # cheapest valid one: over the facet, over the footprint, samples
HORIZONTAL, VERTICAL = BLUE, ORANGE  # variances
REGISTERED = ORANGE  # results of a registration
OUTLINES = (INK, BLUE, ORANGE, PURPLE, GREEN, SKY)  # of images, in turn


def style(width: float = PAGE) -> dict[Any, Any]:
    """Matplotlib settings for a figure `width` inches wide: `with matplotlib.rc_context(style(3.3)): ...`.

    Text is 7 pt in a column and 8.5 pt over a page at the printed size: do not rescale figures in print. Raises
    `ValueError` for a width that is not a positive length.
    """
    if not (math.isfinite(width) and width > 0.0):
        raise ValueError(f"width must be a positive length in inches; got {width!r}. A column has {COLUMN:.2f}.")
    share = min(max((width - COLUMN) / (PAGE - COLUMN), 0.0), 1.0)
    type_size, line = 7.0 + 1.5 * share, 0.8 + 0.2 * share
    return {
        "font.size": type_size,
        "axes.labelsize": type_size,
        "axes.titlesize": type_size + 1.0,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.titlepad": 5.0,
        "axes.labelpad": 2.5,
        "axes.linewidth": 0.7 * line,
        "axes.edgecolor": MUTED,
        "axes.labelcolor": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "xtick.labelsize": type_size - 0.5,
        "ytick.labelsize": type_size - 0.5,
        "xtick.color": MUTED,
        "ytick.color": MUTED,
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "xtick.major.width": 0.7 * line,
        "ytick.major.width": 0.7 * line,
        "xtick.major.size": 3.0,
        "ytick.major.size": 3.0,
        "text.color": INK,
        "grid.color": HAIR,
        "grid.linewidth": 0.5 * line,
        "hatch.linewidth": 0.6,
        "lines.linewidth": 1.3 * line,
        "lines.markersize": 4.5 * line,
        "legend.fontsize": type_size - 0.5,
        "legend.frameon": False,
        "legend.borderaxespad": 0.0,
        "legend.handlelength": 2.2,
        "legend.columnspacing": 1.2,
        "legend.labelspacing": 0.35,
        "figure.dpi": 110,
        "savefig.dpi": 300,
        "svg.fonttype": "none",
    }


@contextmanager
def house_axes(ax: Axes | None, *, width: float = PAGE, tall: float = 0.62) -> Iterator[Axes]:
    """The given axes, or the only axes of a new figure in this style.

    A new figure is `width` inches wide and `tall` times as high, and has no window.
    """
    if ax is not None:
        yield ax
        return
    with mpl.rc_context(style(width)):
        figure = Figure(figsize=(width, tall * width), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure.add_subplot()


def halo(width: float) -> list[Any]:
    """A light outline `width` points wide, for lines and text over an image."""
    return [matplotlib.patheffects.withStroke(linewidth=width, foreground="white", alpha=0.9)]


def grid_behind(ax: Axes) -> None:
    """Draw thin grid lines at the ticks, behind all artists."""
    ax.grid(True)
    ax.set_axisbelow(True)


def percent(share: float) -> str:
    """A share in percent with two significant digits, without an exponent."""
    value = 100.0 * share
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %"


def metres(length: float) -> str:
    """A length with three significant digits, in m or km; "without end" where it is infinite."""
    if not math.isfinite(length):
        return "without end" if length > 0.0 else "unknown"
    if abs(length) >= 9_999.5:
        return f"{length / 1000.0:.3g} km"
    return f"{length:.0f} m" if abs(length) >= 999.5 else f"{length:.3g} m"


def round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that does not exceed a positive length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-12))

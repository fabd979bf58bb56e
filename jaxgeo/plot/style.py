"""One look for all figures: colours that all eyes tell apart, sizes of type, legends that cover no data."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.legend import Legend
from matplotlib.transforms import ScaledTranslation

COLUMN, PAGE = 80.0 / 25.4, 7.0  # inches: a column of 80 mm, and both columns of a page
BESIDE = 5.0  # inches from which on a legend may stand beside square axes
MARGIN = 0.5  # inches left of the axes, of tick labels and the axis's name
LETTER = 0.54  # of the size of type: the mean width of a letter
HANDLE = 4.2  # of the size of type: what stands before a letter, and between columns
RIGHT = 0.36  # of the room: how much of it a legend beside square axes has
GRID_SHARE = 0.775  # of a figure's width, which matplotlib's grid fills before it is laid out

# Okabe and Ito (2008), "Color universal design". What one figure has beside each other is told apart by all eyes
# (tests/test_plot_figures.py), and by its mark, width or dashes too, which is what is left in grey.
INK, MUTED, HAIR = "#1a1a1a", "#5f5f5f", "#d0d0d0"
BLUE, SKY, GREEN = "#0072b2", "#56b4e9", "#009e73"
ORANGE, VERMILLION, PURPLE = "#e69f00", "#d55e00", "#8f3f71"
EARTH, SHADE = "#cdb896", "#eeeeee"


def style(width: float = PAGE) -> dict[Any, Any]:
    """Settings of matplotlib for a figure `width` inches wide: `with matplotlib.rc_context(style(3.3)): ...`.

    Type is 7 pt in a column and 8.5 pt over a page, as read and not as drawn: put figures into print unscaled. Raises
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


def legend_below(axes: Axes, handles: Sequence[Any], *, title: str = "", beside: bool = False, **given: Any) -> Legend:
    """A legend under the labels of the axes, where it covers no data, in as many columns as there is room for.

    The `title` is words that belong to it, broken into lines. With `beside` it stands right of the axes where their
    place in the figure is as wide as a page. `given` go to matplotlib's own.
    """
    figure = axes.get_figure(root=False)
    assert figure is not None
    room, size = _room(axes), _points(mpl.rcParams["legend.fontsize"])
    beside = beside and room > BESIDE
    width = 72.0 * (RIGHT * room if beside else room - MARGIN)
    said: dict[str, Any] = {"title": "\n".join(textwrap.wrap(title, max(int(width / (LETTER * size)), 20)))}
    said |= {"title_fontsize": size, "alignment": "left"}
    if beside:
        axes.set_anchor("W")
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.03, 1.0)}
        return axes.legend(handles=list(handles), **{**place, **said, **given})
    longest = max(len(str(handle.get_label())) for handle in handles)
    columns = min(max(int(width / (size * (LETTER * longest + HANDLE))), 1), len(handles))
    type_sizes = (mpl.rcParams["xtick.labelsize"], mpl.rcParams["axes.labelsize"])
    down = sum(_points(one) * 1.3 for one in type_sizes) + 12.0
    below = axes.transAxes + ScaledTranslation(0.0, -down / 72.0, figure.dpi_scale_trans)
    place = {"loc": "upper left", "bbox_to_anchor": (0.0, 0.0), "bbox_transform": below}
    return axes.legend(handles=list(handles), ncols=columns, **{**place, **said, **given})


def _room(axes: Axes) -> float:
    """Width of the place that the axes have in their figure, inches."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    spec = axes.get_subplotspec()
    share = axes.get_position().width if spec is None else spec.get_position(figure).width / GRID_SHARE
    return float(figure.get_size_inches()[0]) * min(share, 1.0)


def grid_behind(axes: Axes) -> None:
    """Hairlines at the ticks, behind all that is drawn."""
    axes.grid(True)
    axes.set_axisbelow(True)


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


def _points(size: Any) -> float:
    """The size of type in points, of a number or one of matplotlib's words."""
    from matplotlib.font_manager import FontProperties

    return float(FontProperties(size=size).get_size_in_points())

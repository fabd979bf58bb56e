"""Legends outside the data area, and colour bars, built from the labels on the axes."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator
from matplotlib.transforms import ScaledTranslation

BESIDE = 5.0  # inches: minimum width for a legend beside square axes
MARGIN = 0.5  # inches left of the axes, of tick labels and the axis's name
LETTER = 0.54  # mean width of a letter, in font sizes
HANDLE = 4.2  # width of the handle and column gap, in font sizes
RIGHT = 0.36  # share of the width for a legend beside square axes
GRID_SHARE = 0.775  # of a figure's width: matplotlib's default subplot area before layout
COLOURED = "jaxgeo: colours"  # label of the artist that a colour bar refers to


def legend(ax: Axes, *, title: str = "", beside: bool = False, **given: Any) -> Axes:
    """A legend of all labelled artists, below the axis labels, outside the data area.

    The number of columns depends on the available width. `title` is wrapped. With `beside` the legend is right of the
    axes if their part of the figure is as wide as a page. `given` are passed to `Axes.legend`, such as
    `loc="upper left"` for a legend inside. Returns the axes.
    """
    handles = {str(one.get_label()): one for one in ax.get_legend_handles_labels()[0]}
    legend_of(ax, list(handles.values()), title=title, beside=beside, **given)
    return ax


def legend_of(ax: Axes, handles: Sequence[Any], *, title: str = "", beside: bool = False, **given: Any) -> Legend:
    """As `legend`, for chosen handles."""
    figure = ax.get_figure(root=False)
    assert figure is not None
    if "loc" in given and "bbox_to_anchor" not in given:
        inside = {"frameon": True, "framealpha": 0.9, "edgecolor": "none", "borderaxespad": 0.6}
        return ax.legend(handles=list(handles), title=title or None, **{**inside, **given})
    room, size = _room(ax), _points(mpl.rcParams["legend.fontsize"])
    beside = beside and room > BESIDE
    width = 72.0 * (RIGHT * room if beside else room - MARGIN)
    said: dict[str, Any] = {"title": "\n".join(textwrap.wrap(title, max(int(width / (LETTER * size)), 20)))}
    said |= {"title_fontsize": size, "alignment": "left", "frameon": False, "borderaxespad": 0.0}
    if beside:
        ax.set_anchor("W")
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.03, 1.0)}
        return ax.legend(handles=list(handles), **{**place, **said, **given})
    longest = max((len(line) for one in handles for line in str(one.get_label()).split("\n")), default=1)
    columns = min(max(int(width / (size * (LETTER * longest + HANDLE))), 1), max(len(handles), 1))
    type_sizes = (mpl.rcParams["xtick.labelsize"], mpl.rcParams["axes.labelsize"])
    down = sum(_points(one) * 1.3 for one in type_sizes) + 12.0
    below = ax.transAxes + ScaledTranslation(0.0, -down / 72.0, figure.dpi_scale_trans)
    place = {"loc": "upper left", "bbox_to_anchor": (0.0, 0.0), "bbox_transform": below}
    return ax.legend(handles=list(handles), ncols=columns, **{**place, **said, **given})


def colour_bar(ax: Axes, label: str, *, beside: Any = None, **given: Any) -> Colorbar:
    """A colour bar for `accuracy_map` on the axes; its `label` names the unit.

    It is right of the axes and as high as they are, or takes its space from the axes in `beside`. `given` are passed to
    `Figure.colorbar`. Raises `ValueError` for axes without such colours.
    """
    found = [one for one in ax.get_children() if one.get_gid() == COLOURED]
    if not found:
        raise ValueError("these axes have no colours to tell: draw an accuracy_map on them first.")
    figure, coloured = ax.get_figure(root=False), found[-1]
    assert figure is not None
    assert isinstance(coloured, ScalarMappable)
    place = {"cax": ax.inset_axes((1.03, 0.0, 0.045, 1.0))} if beside is None else {"ax": beside}
    bar = figure.colorbar(coloured, label=label, **{**place, "ticks": LogLocator(subs=(1.0, 2.0, 5.0)), **given})
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.minorticks_off()
    return bar


def keyed(ax: Axes, label: str, *, area: bool = False, **style: Any) -> Artist:
    """A proxy legend entry: a line, marker or `area` that is not drawn on the axes."""
    one: Artist = (
        Rectangle((0.0, 0.0), 0.0, 0.0, label=label, **style) if area else Line2D([], [], label=label, **style)
    )
    if area:
        one.set_transform(ax.transAxes)
    ax.add_artist(one)
    one.set_in_layout(False)
    return one


def _room(ax: Axes) -> float:
    """Width in inches of the axes' subplot area in their figure or subfigure."""
    figure: Any = ax.get_figure(root=False)
    spec = ax.get_subplotspec()
    share = ax.get_position().width if spec is None else spec.get_position(figure).width / GRID_SHARE
    return float(figure.bbox.width / figure.dpi) * min(share, 1.0)


def _points(size: Any) -> float:
    """Font size in points, from a number or a matplotlib name."""
    from matplotlib.font_manager import FontProperties

    return float(FontProperties(size=size).get_size_in_points())

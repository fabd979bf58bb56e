"""Legends that cover no data, and colour bars: gathered from the labels of what lies on the axes."""

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

BESIDE = 5.0  # inches from which on a legend may stand beside square axes
MARGIN = 0.5  # inches left of the axes, of tick labels and the axis's name
LETTER = 0.54  # of the size of type: the mean width of a letter
HANDLE = 4.2  # of the size of type: what stands before a letter, and between columns
RIGHT = 0.36  # of the room: how much of it a legend beside square axes has
GRID_SHARE = 0.775  # of a figure's width, which matplotlib's grid fills before it is laid out
COLOURED = "jaxgeo: colours"  # the name of what a colour bar tells


def legend(ax: Axes, *, title: str = "", beside: bool = False, **given: Any) -> Axes:
    """A legend of all that has a label, under the labels of the axes, where it covers no data.

    It has as many columns as there is room for. The `title` is words that belong to it, broken into lines. With
    `beside` it stands right of the axes where their place in the figure is as wide as a page. `given` go to
    `Axes.legend`, such as `loc="upper left"` for one inside. Returns the axes.
    """
    handles = {str(one.get_label()): one for one in ax.get_legend_handles_labels()[0]}
    legend_of(ax, list(handles.values()), title=title, beside=beside, **given)
    return ax


def legend_of(ax: Axes, handles: Sequence[Any], *, title: str = "", beside: bool = False, **given: Any) -> Legend:
    """As `legend`, of chosen handles."""
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
    """A bar of the colours of `accuracy_map` on the axes; its `label` names the unit.

    It stands right of the axes, as high as they are, or takes its room from those named by `beside`. `given` go to
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


def keyed(ax: Axes, label: str, *, area: bool = False, **look: Any) -> Artist:
    """An entry of the legend for what has none of its own: a line or mark, or an `area`, that is drawn nowhere else."""
    one: Artist = Rectangle((0.0, 0.0), 0.0, 0.0, label=label, **look) if area else Line2D([], [], label=label, **look)
    if area:
        one.set_transform(ax.transAxes)
    ax.add_artist(one)
    one.set_in_layout(False)
    return one


def _room(ax: Axes) -> float:
    """Width of the place that the axes have in their figure, or in its part that they are in, inches."""
    figure: Any = ax.get_figure(root=False)
    spec = ax.get_subplotspec()
    share = ax.get_position().width if spec is None else spec.get_position(figure).width / GRID_SHARE
    return float(figure.bbox.width / figure.dpi) * min(share, 1.0)


def _points(size: Any) -> float:
    """The size of type in points, of a number or one of matplotlib's words."""
    from matplotlib.font_manager import FontProperties

    return float(FontProperties(size=size).get_size_in_points())

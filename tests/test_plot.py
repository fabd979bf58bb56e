"""What holds for every drawing: axes in and out, a unit on each axis, nothing cut off or covered, no traces left."""

from __future__ import annotations

import importlib
import inspect
import itertools
import re
import sys
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from jaxgeo import plot
from jaxgeo.plot.style import COLUMN, PAGE, style
from jaxgeo.uncertainty import Sampled
from tests.support import clouds, drawn
from tests.support.drawn import new_axes

CAMERA = drawn.Geodetic.from_degrees(lat=44.0, lon=5.0, height=3000.0)


def with_places(draw: Callable[[Axes], Any]) -> Callable[[Axes | None], Axes]:
    """A drawing that adds to a map."""

    def drawn_on(ax: Axes | None) -> Axes:
        return draw(plot.map_axes(drawn.north_up(), ax))

    return drawn_on


def two_hills() -> Sampled:
    return clouds.cloud(clouds.two_hills(1000, seed=1))


def with_legend(ax: Axes | None) -> Axes:
    return plot.legend(plot.fixes(drawn.fixes(), ax))


def with_bar(ax: Axes | None) -> Axes:
    ax = plot.accuracy_map(drawn.accuracies(), ax)
    plot.colour_bar(ax, "CE90, m")
    return ax


DRAWINGS: dict[str, Callable[[Axes | None], Axes]] = {
    "accuracy_map": lambda ax: plot.accuracy_map(drawn.accuracies(), ax),
    "budget_bars": lambda ax: plot.budget_bars(drawn.a_budget(), ax),
    "camera": lambda ax: plot.camera(CAMERA, 0.5, ax),
    "checkerboard": lambda ax: plot.checkerboard(drawn.image(1.0), drawn.image(0.5), ax),
    "circles_on_map": lambda ax: plot.circles_on_map(
        drawn.image(1.0), drawn.image(0.5), drawn.a_fix(40.0), drawn.a_fix(4.0), ax
    ),
    "cloud_on_map": lambda ax: plot.cloud_on_map(drawn.compared(jumps=60), ax),
    "colour_bar": with_bar,
    "convention": lambda ax: plot.convention("heading", ax),
    "ellipses_on_map": lambda ax: plot.ellipses_on_map(drawn.level(), ax),
    "error_cloud": lambda ax: plot.error_cloud(drawn.compared(jumps=60, failed=100), ax),
    "fixes": lambda ax: plot.fixes(drawn.fixes(), ax),
    "footprints": lambda ax: plot.footprints(drawn.outlined(lost=(2,), hidden=(3,)), ax, dem=drawn.north_up()),
    "hidden_ground": lambda ax: plot.hidden_ground(drawn.north_up(), drawn.hill() > 700.0, ax),
    "hillshade": lambda ax: plot.hillshade(drawn.north_up(), ax),
    "legend": with_legend,
    "map_axes": lambda ax: plot.map_axes(drawn.north_up(), ax),
    "method_map": lambda ax: plot.method_map(drawn.accuracies(), ax),
    "north_arrow": with_places(plot.north_arrow),
    "overlap_along": lambda ax: plot.overlap_along(drawn.overlaps([[-0.05, 0.1, 0.2]]), ax, required=0.15),
    "probability_on_map": lambda ax: plot.probability_on_map(two_hills().probability_map(), ax),
    "region_on_map": lambda ax: plot.region_on_map(two_hills().region(0.9), ax),
    "residual_arrows": lambda ax: plot.residual_arrows(drawn.adjusted(), ax),
    "residual_histogram": lambda ax: plot.residual_histogram(drawn.adjusted(), ax, checked=drawn.judged(wrong=(4, 9))),
    "scale_bar": with_places(plot.scale_bar),
    "shifts": lambda ax: plot.shifts(drawn.a_pass(), ax, covariance=np.diag([100.0, 400.0])),
    "sight_lines": lambda ax: plot.sight_lines(CAMERA, drawn.fixes(), ax),
    "sight_section": lambda ax: plot.sight_section(drawn.a_section(), ax),
    "ties_on_map": lambda ax: plot.ties_on_map(drawn.image(1.0), drawn.registration(), drawn.block_places(), ax),
}
ADDS = {"colour_bar", "legend", "north_arrow", "scale_bar"}  # to axes that hold something
UNITS = re.compile(r", (m|km|px|°|%|count|cells|cells of [\d.]+ m)$|, in its own standard deviations$")
NAMED = {("budget_bars", "y")}  # axes whose ticks are names
SLOW = {"residual_arrows", "residual_histogram"}  # a block is adjusted for them
TALL = {"residual_arrows": 1.2, "convention": 1.0}  # height over width in a column, where it is not 1.5


def test_the_table_has_every_drawing() -> None:
    public = {name: getattr(plot, name) for name in plot.__all__}
    takes_axes = {name for name, one in public.items() if callable(one) and "ax" in inspect.signature(one).parameters}
    assert takes_axes == set(DRAWINGS)
    assert {name for name in dir(plot) if name in public} == set(public)


@pytest.mark.parametrize("name", DRAWINGS)
def test_records_come_first_then_axes_and_all_else_by_keyword(name) -> None:
    parameters = list(inspect.signature(getattr(plot, name)).parameters.values())
    order = [one.name for one in parameters]
    after = parameters[order.index("ax") + 1 :]
    if name in ADDS:
        assert order[0] == "ax"
        return
    assert parameters[order.index("ax")].default is None
    keywords = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD)
    assert all(one.kind in keywords for one in after), order
    before = parameters[: order.index("ax")]
    assert all(one.default is inspect.Parameter.empty for one in before), order


@pytest.mark.costly
@pytest.mark.parametrize("width", [COLUMN, PAGE])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in DRAWINGS]
)
def test_axes_in_and_out_and_all_of_it_is_read(name, width) -> None:
    """In a column on axes that are given, on a page on the drawing's own."""
    given = new_axes(COLUMN, TALL.get(name, 1.5)) if width == COLUMN else None
    with mpl.rc_context({} if given is None else style(COLUMN)):
        settings, window = dict(mpl.rcParams), "matplotlib.pyplot" in sys.modules
        ax = DRAWINGS[name](given)
        assert dict(mpl.rcParams) == settings
    assert isinstance(ax, Axes)
    assert given is None or ax is given
    assert ("matplotlib.pyplot" in sys.modules) == window
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    assert figure.get_figwidth() <= width
    figure.draw_without_rendering()
    figure.draw_without_rendering()
    assert_units(name, ax)
    assert_whole(figure)
    assert_apart(ax)
    legend = ax.get_legend()
    if legend is not None:
        place, box = legend.get_window_extent(), ax.get_window_extent()
        assert place.y1 <= box.y0 or place.x0 >= box.x1, "the legend covers the data"


def assert_units(name: str, ax: Axes) -> None:
    if not ax.axison:
        return
    for side, label in (("x", ax.get_xlabel()), ("y", ax.get_ylabel())):
        assert (name, side) in NAMED or UNITS.search(label), f"{side}: {label!r}"


def assert_whole(figure: Figure) -> None:
    """Words end within the figure; those of a picture, at its edges, with it."""
    edge = figure.bbox.padded(1.0)
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text() and text.get_visible() and not text.get_clip_on() and is_shown(text, figure):
            box = text.get_window_extent()
            inside = box.x0 >= edge.x0 and box.x1 <= edge.x1 and box.y0 >= edge.y0 and box.y1 <= edge.y1
            assert inside, f"{text.get_text()!r} at {box.extents}, of {edge.extents}"


def is_shown(text: Text, figure: Figure) -> bool:
    """Whether the words belong to axes that are drawn, and are no tick beyond their limits."""
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if text in (*axis.get_majorticklabels(), *axis.get_minorticklabels(), axis.offsetText, axis.label):
                return ax.axison and text in shown_ticks(ax, axis)
    return True


def shown_ticks(ax: Axes, axis: Any) -> list[Text]:
    low, high = sorted(axis.get_view_interval())
    ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [*ticks, axis.label]


def assert_apart(ax: Axes) -> None:
    """Labels of ticks do not run into each other."""
    if not ax.axison:
        return
    for axis, side in ((ax.xaxis, "intervalx"), (ax.yaxis, "intervaly")):
        boxes = [text.get_window_extent() for text in shown_ticks(ax, axis)[:-1] if text.get_text()]
        spans = sorted(tuple(getattr(box, side)) for box in boxes)
        assert all(one[1] < other[0] + 1.0 for one, other in itertools.pairwise(spans)), spans


@pytest.mark.costly
@pytest.mark.parametrize("width", [COLUMN, pytest.param(PAGE, marks=pytest.mark.slow)])  # where there is more room
def test_all_conventions_fit_into_one_figure(width) -> None:
    figure = plot.conventions_figure(width)
    assert figure.get_figwidth() == width
    assert len(figure.axes) == 8
    figure.draw_without_rendering()
    assert_whole(figure)


@pytest.mark.costly
def test_a_page_of_a_registration_is_whole() -> None:
    page = plot.registration_figure(
        drawn.registration(),
        drawn.image(1.0),
        places=drawn.block_places(),
        before=drawn.image(0.5),
        after=drawn.image(0.7),
        direct=drawn.a_fix(40.0),
        updated=drawn.a_fix(4.0),
    )
    page.draw_without_rendering()
    assert sum(ax.axison for ax in page.axes) == 5
    assert_whole(page)


def test_legends_tell_each_label_once() -> None:
    ax = new_axes(PAGE)
    for _ in range(2):
        plot.fixes(drawn.fixes(), ax)
    assert plot.legend(ax) is ax
    assert sorted(drawn.words(ax)) == ["fixes", "fixes, with reserve"]
    with pytest.raises(ValueError, match="draw an accuracy_map on them first"):
        plot.colour_bar(ax, "CE90, m")


def test_without_matplotlib_the_import_says_what_to_install(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "jaxgeo.plot")
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgeo\[plot\]'"):
        importlib.import_module("jaxgeo.plot")

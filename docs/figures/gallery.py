"""The figures of the gallery: what each shows, the call that makes it, and how it is drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import records
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxgeo import plot
from jaxgeo.io import example_dem

NARROW = 5.0  # inches, below which drawings stand under each other


class Drawing(NamedTuple):
    """A figure; `wide` and `tall` are its height over its width on the page and in the column."""

    draw: Callable[[Figure], object]
    wide: float
    tall: float


def pair(figure: Figure) -> tuple[Axes, Axes]:
    """Two axes beside each other on a page, under each other in a column."""
    narrow = figure.get_figwidth() < NARROW
    left, right = figure.subplots(2, 1) if narrow else figure.subplots(1, 2)
    return left, right


def a_map(figure: Figure) -> None:
    demo = records.demo()
    ax = figure.add_subplot()
    plot.map_axes(demo.dem, ax)
    plot.hillshade(demo.dem, ax)
    plot.hidden_ground(demo.dem, demo.hidden, ax, label="hidden by terrain")
    plot.footprints(demo.outline, ax, labels=["image footprint"])
    plot.sight_lines(demo.centre, demo.fix, ax)
    plot.fixes(demo.fix, ax)
    plot.ellipses_on_map(records.of_fixes(), ax)
    plot.camera(demo.centre, float(demo.shot.pose.heading), ax)
    ax.set(xlim=(-84.40, -84.085), ylim=(36.175, 36.345))
    plot.scale_bar(ax)
    plot.north_arrow(ax, anchor=(0.05, 0.88))
    plot.legend(ax)


def regions(figure: Figure) -> None:
    found = records.two_hills()
    several = [found.region(probability) for probability in (0.5, 0.9, 0.99)]
    west, south, east, north = several[-1].polygon.bounds
    left, right = pair(figure)
    for ax, title in ((left, "Regions of the truth"), (right, "Probability of the truth")):
        ax.set(xlim=(west - 0.0012, east + 0.0012), ylim=(south - 0.0016, north + 0.0016), title=title)
        plot.hillshade(example_dem(), ax)
    plot.region_on_map(several, left)
    plot.probability_on_map(found, right)
    plot.colour_bar(right, "probability per m²")
    for ax in (left, right):
        plot.fixes(found.fix, ax, label="fix")
        plot.legend(ax)
    plot.scale_bar(left, anchor=(0.7, 0.05))
    plot.north_arrow(left, anchor=(0.06, 0.88))


def errors_on_map(figure: Figure) -> None:
    demo = records.demo()
    ax = figure.add_subplot()
    plot.map_axes(demo.dem, ax)
    plot.hillshade(demo.dem, ax)
    ax.set(xlim=(-84.362, -84.222), ylim=(36.228, 36.302))
    plot.cloud_on_map(records.clouds(), ax, times=5.0)
    plot.ellipses_on_map(records.of_fixes(), ax, times=5.0)
    plot.fixes(demo.fix, ax)
    plot.scale_bar(ax)
    plot.north_arrow(ax, anchor=(0.96, 0.9))
    plot.legend(ax)


def accuracy(figure: Figure) -> None:
    left, right = pair(figure)
    found = records.accuracies()
    seen = records.demo().outline
    lon, lat = plot.lonlat_deg(seen)
    for ax in (left, right):
        plot.map_axes(records.demo().dem, ax)
        plot.hillshade(records.demo().dem, ax)
    plot.accuracy_map(found, left)
    plot.colour_bar(left, "CE90, m")
    plot.method_map(found, right)
    for ax, title in ((left, "How sure a fix would be"), (right, "By which method")):
        ax.set(xlim=(lon.min() - 0.01, lon.max() + 0.01), ylim=(lat.min() - 0.01, lat.max() + 0.01))
        ax.set_title(title)
        plot.legend(ax)


def sight_section(figure: Figure) -> None:
    section = records.section()
    whole, near = pair(figure)
    plot.sight_section(section, whole, legend=False).set_title("The whole way")
    first = float(section.hits[0, 0])
    plot.sight_section(section, near, window=(first - 2500.0, float(section.distance[-1])), legend=False)
    near.set_title("Where it comes down")
    handles, columns = whole.get_legend_handles_labels()[0], 2 if figure.get_figwidth() < NARROW else 5
    figure.legend(handles=handles, loc="outside lower left", ncols=columns)


def coverage(figure: Figure) -> None:
    seen, shared = records.strips()
    left, right = pair(figure)
    plot.footprints(seen, left, labels=["first strip", "second strip"], dem=records.demo().dem)
    plot.overlap_along(shared, right, required=records.STRIPS["required"])
    plot.legend(left)
    plot.legend(right)


def residuals(figure: Figure) -> None:
    found, checked = records.adjusted()
    plot.residual_arrows(found, figure.add_subplot(), checked=checked)


def residual_histogram(figure: Figure) -> None:
    found, checked = records.adjusted()
    plot.residual_histogram(found, figure.add_subplot(), checked=checked)


def ties(figure: Figure) -> None:
    left, right = pair(figure)
    made = records.registered()
    plot.shifts(made.found.passes[0], left, covariance=made.covariance, legend=False)
    plot.legend(left)
    plot.ties_on_map(made.reference, made.found, made.places, right)


def boards(figure: Figure) -> None:
    made, part = records.registered(), (190, 150, (150, 150))
    sides = zip(pair(figure), ((made.before, "By the navigation"), (made.after, "Registered")), strict=True)
    for ax, (image, title) in sides:
        plot.checkerboard(made.reference.window(*part), image.window(*part), ax, squares=4).set_title(title)


def circles(figure: Figure) -> None:
    made = records.registered()
    plot.circles_on_map(made.reference, made.after, made.direct, made.updated, figure.add_subplot())


def registration_page() -> Figure:
    made = records.registered()
    return plot.registration_figure(
        made.found,
        made.reference,
        places=made.places,
        before=made.before,
        after=made.after,
        direct=made.direct,
        updated=made.updated,
        covariance=made.covariance,
    )


FIGURES = {
    "map": Drawing(a_map, 0.78, 1.0),
    "errors_on_map": Drawing(errors_on_map, 0.75, 0.95),
    "error_cloud": Drawing(
        lambda figure: plot.error_cloud(records.demo().errors.checked, figure.add_subplot(), dem=records.demo().dem),
        0.6,
        1.5,
    ),
    "regions": Drawing(regions, 0.4, 1.45),
    "budget": Drawing(lambda figure: plot.budget_bars(records.demo().errors.budget, figure.add_subplot()), 0.55, 0.95),
    "accuracy": Drawing(accuracy, 0.47, 1.9),
    "sight_section": Drawing(sight_section, 0.42, 1.3),
    "coverage": Drawing(coverage, 0.42, 1.6),
    "residuals": Drawing(residuals, 0.8, 0.95),
    "residual_histogram": Drawing(residual_histogram, 0.6, 0.9),
    "ties": Drawing(ties, 0.62, 2.3),
    "boards": Drawing(boards, 0.52, 2.0),
    "circles": Drawing(circles, 0.6, 1.35),
}

"""Figures of the study. Needs matplotlib."""

from __future__ import annotations

import itertools
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxgeo.plot import EDGE, FIX, HIDDEN, SIGHT, footprints, legend
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.attitude import ACTUAL, COMPENSATED, EXPECTED, FIRST, Outlines, outlines
from jaxgeo.studies.li2020.control import Control
from jaxgeo.studies.li2020.flight import Sighting, StripPair
from jaxgeo.studies.li2020.influence import folding
from jaxgeo.studies.li2020.relief import Relief
from jaxgeo.studies.li2020.report import Report
from jaxgeo.studies.li2020.strips import AS_IN_THE_PAPER, MOUNTAINS, PLAIN, PLANNED, Strips
from jaxgeo.studies.pictures import draw_all

COLOURS = {FIRST: EDGE, EXPECTED: SIGHT, ACTUAL: FIX, COMPENSATED: "#1a7f5a"}
TIMINGS = {
    "fixed period": (HIDDEN, "d"),
    AS_IN_THE_PAPER: (FIX, "o"),
    "velocity-height": ("#b3893b", "s"),
    "ground shared": (SIGHT, "^"),
}
GROUNDS = {
    PLAIN: f"Level ground at {PLANNED:.0f} m, as planned (Fig. 11 in kind)",
    MOUNTAINS: f"Mountains, planned as level ground at {PLANNED:.0f} m (Fig. 12 in kind)",
}
TURNS = np.linspace(0.0, 1.2, 61)  # deg


def write(report: Report, folder: pathlib.Path) -> None:
    """Write all figures to a folder."""
    pictures: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]] = {
        "footprints.png": (lambda figure: draw_footprints(report.outlines or outlines(), figure), (11.0, 3.9)),
        "attitude.png": (lambda figure: draw_attitude(report.sightings, report.pairs, figure), (10.0, 4.2)),
        "folding.png": (draw_folding, (6.4, 4.4)),
    }
    if report.strips:
        pictures["strips.png"] = (lambda figure: draw_strips(report.strips, figure), (10.0, 6.4))
        pictures["later_work.png"] = (
            lambda figure: draw_later_work(report.controls, report.reliefs, figure),
            (10.0, 4.2),
        )
    draw_all(pictures, folder)


def draw_footprints(found: Outlines, figure: Figure) -> None:
    """Figs. 7 and 8: a strip, the next as planned, and the next with another attitude."""
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    titles = {ACTUAL: "Without compensation (Fig. 7)", COMPENSATED: "With compensation (Fig. 8)"}
    for ax, (last, title) in zip(panels, titles.items(), strict=True):
        names = [FIRST, EXPECTED, last]
        footprints(
            [found.footprints[name] for name in names],
            ax,
            labels=[_with_overlap(name, found) for name in names],
            origin=found.middle,
            colours=[COLOURS[name] for name in names],
        )
        for outline, dashes in zip(ax.get_legend_handles_labels()[0], ("-.", "-", "--"), strict=False):
            assert isinstance(outline, Line2D)
            outline.set_linestyle(dashes)
        ax.set_title(title)
        legend(ax, loc="upper right", fontsize=9, frameon=False)
    reach = np.concatenate([_places(panel) for panel in panels])
    low, high = np.nanmin(reach, axis=0), np.nanmax(reach, axis=0)
    panels[0].set(xlim=(low[0] - 0.15, high[0] + 0.15), ylim=(low[1] - 0.15, high[1] + 0.75))
    panels[1].set_ylabel("")


def _with_overlap(name: str, found: Outlines) -> str:
    if name == FIRST:
        return name
    along = np.asarray(found.overlaps[name].along)  # the required overlap applies at the centre of the common range
    middle = float(along[len(along) // 2])
    return f"{name}: {middle:.1%} overlap" if middle >= 0.0 else f"{name}: a gap of {-middle:.0%} of a frame"


def _places(ax: Axes) -> np.ndarray:
    return np.concatenate([np.asarray(line.get_xydata()) for line in ax.lines])


def draw_attitude(seen: Sequence[Sighting], pairs: Sequence[StripPair], figure: Figure) -> None:
    """Fig. 10: changes of the attitude and of the line of sight from strip to strip."""
    left, right = figure.subplots(1, 2)
    names = [pair.strips for pair in pairs]
    rows = {
        "heading": (SIGHT, "o", [strip.heading for strip in printed.TABLE_4]),
        "roll": (FIX, "^", [strip.roll for strip in printed.TABLE_4]),
        "pitch": (HIDDEN, "s", [strip.pitch for strip in printed.TABLE_4]),
    }
    for name, (colour, marker, angles) in rows.items():
        left.plot(names, np.diff(angles), color=colour, marker=marker, label=name)
    left.set(title="Attitude, from strip to strip (Fig. 10)")
    lines = {
        "azimuth": (SIGHT, "o", [one.azimuth for one in seen]),
        "depression": (FIX, "^", [one.depression for one in seen]),
    }
    for name, (colour, marker, angles) in lines.items():
        right.plot(names, np.diff(angles), color=colour, marker=marker, label=f"{name} of the line of sight")
    right.set(title="Line of sight, with the drives of Table 4")
    for ax in (left, right):
        ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
        ax.set(xlabel="strips", ylabel="change, °", ylim=(-0.32, 0.32))
        ax.legend(frameon=False, fontsize=9, loc="lower right")


def draw_strips(found: Sequence[Strips], figure: Figure) -> None:
    """Counterpart of Figs. 11 and 12: overlap from strip to strip over level ground and mountains, by timing method."""
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    for ax, (ground, title) in zip(panels, GROUNDS.items(), strict=True):
        for one in [one for one in found if one.ground == ground]:
            colour, marker = TIMINGS[one.timing]
            label = f"{one.timing}: mean {one.near.mean():.1%}, least {one.near.min():.1%}"
            style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.2}
            ax.plot(one.times[1:], 100.0 * one.near, label=label, **style)
        ax.axhline(100.0 * printed.OVERLAP, color=EDGE, linewidth=1.0, linestyle="--", zorder=0, label="required")
        ax.set(title=title, ylabel="overlap at the near end, %", ylim=(0.0, 33.0))
        ax.legend(frameon=False, fontsize=9, loc="upper left", ncols=2)
    panels[1].set_xlabel("time, s")


def draw_later_work(control: Sequence[Control], relief: Sequence[Relief], figure: Figure) -> None:
    """Scatter of the overlap from gimbal control errors, and its deviation from the required overlap over relief."""
    left, right = figure.subplots(1, 2)
    rows = [one for one in control if one.control > 0.0]
    sigmas = np.array([one.control for one in rows])
    left.plot(sigmas, [100.0 * one.formula for one in rows], color="0.6", linewidth=3.0, label="by formula")
    left.errorbar(
        sigmas,
        [100.0 * one.spread for one in rows],
        yerr=[200.0 * one.spread_error for one in rows],
        color=FIX,
        marker="o",
        linestyle="none",
        capsize=3,
        label="drawn, ± 2 standard errors",
    )
    left.set(xscale="log", yscale="log", xlabel="error of each drive, °", ylabel="spread of the overlap, points")
    left.set_xticks(sigmas, [f"{sigma:g}" for sigma in sigmas], minor=False)
    left.set_xticks([], minor=True)
    left.set_yticks([1.0, 2.0, 5.0, 10.0, 20.0], ["1", "2", "5", "10", "20"])
    left.set_yticks([], minor=True)
    left.set(title="Errors of the gimbal's control")
    styles = {"planned height": (FIX, "-"), "velocity-height": (SIGHT, "--")}
    markers = {"fractal": "o", "example terrain": "s"}
    kinds = itertools.product(styles.items(), markers.items())
    for beside, ((timing, (colour, line)), (ground, marker)) in zip((-3.0, -1.0, 1.0, 3.0), kinds, strict=True):
        some = [one for one in relief if (one.timing, one.ground) == (timing, ground)]
        right.errorbar(
            [one.relief + beside for one in some],  # m, offset so that the bars do not cover each other
            [100.0 * one.off for one in some],
            yerr=[100.0 * one.off_error for one in some],
            color=colour,
            linestyle=line,
            marker=marker,
            markersize=4.5,
            capsize=3,
            label=f"{timing}, {ground}",
        )
    planned = sorted({(one.relief, one.by_height) for one in relief})
    right.plot([x for x, _ in planned], [100.0 * y for _, y in planned], color="0.6", zorder=0, label="by Eq 28")
    right.set(
        xlabel="relief, standard deviation of heights, m",
        ylabel="rms off the required overlap, points",
        ylim=(0.0, 4.2),
    )
    right.set(xlim=(0.0, 215.0), xticks=[x for x, _ in planned])
    right.set(title="Relief of the ground, ± 95 % over places")
    for ax in (left, right):
        ax.legend(frameon=False, fontsize=9, loc="upper left")


def draw_folding(figure: Figure) -> None:
    """The unsigned distance of Eq 16, which folds back where the step along the flight continues."""
    ax = figure.subplots()
    formula, along, distance = (100.0 * values for values in folding(TURNS))
    ax.plot(TURNS, formula, color="0.6", linewidth=4.0, label="Eq 18")
    ax.plot(TURNS, along, color=SIGHT, label="step along the flight")
    ax.plot(TURNS, distance, color=FIX, linestyle="--", label="distance of Eq 16")
    table = 100.0 * np.array(printed.TABLES["heading"])
    ax.plot(printed.CHANGES, table, "o", color=EDGE, markersize=5, label="Table 1")
    top = int(np.argmax(distance))
    note = f"folds at {TURNS[top]:.2f}°"
    ax.annotate(
        note,
        (TURNS[top], distance[top]),
        (TURNS[top] + 0.02, distance[top] - 50.0),
        arrowprops={"arrowstyle": "->", "color": FIX},
        color=FIX,
        va="top",
    )
    ax.set(xlabel="change of heading, °", ylabel="change of overlap, % of a frame", title="A distance is no step")
    ax.set(xlim=(0.0, 1.2), ylim=(0.0, None))
    ax.legend(frameon=False, loc="upper left")

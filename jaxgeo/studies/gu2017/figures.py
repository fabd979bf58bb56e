"""Figures of the study. Needs matplotlib."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxgeo.ortho import Orthoimage
from jaxgeo.plot import EDGE, FIX, SIGHT, checkerboard, circles_on_map
from jaxgeo.studies.gu2017.density import Dense
from jaxgeo.studies.gu2017.flow import Flow
from jaxgeo.studies.gu2017.frames import Frame
from jaxgeo.studies.gu2017.intervals import rms
from jaxgeo.studies.gu2017.report import Report
from jaxgeo.studies.gu2017.scene import CELL, Imaged
from jaxgeo.studies.gu2017.searching import WHOLE, Searched
from jaxgeo.studies.pictures import draw_all

Drawn = tuple[Callable[[Figure], None], tuple[float, float]]


def write(report: Report, folder: pathlib.Path) -> None:
    """Write all figures to a folder."""
    pictures: dict[str, Drawn] = {
        "images.png": (lambda figure: draw_images(report.image, report.flow, figure), (13.0, 4.8)),
        "boards.png": (lambda figure: draw_boards(report.flow, figure), (11.0, 6.4)),
        "circles.png": (lambda figure: draw_circles(report.flow, figure), (9.0, 5.4)),
    }
    if report.searches:
        pictures["shifts.png"] = (lambda figure: draw_shifts(report.searches, figure), (19.0, 8.6))
    if report.by_size:
        pictures["blocks.png"] = (lambda figure: draw_blocks(report.by_size, report.by_ties, figure), (13.0, 4.4))
    if report.frames:
        pictures["frames.png"] = (lambda figure: draw_frames(report.frames, figure), (10.5, 4.2))
    draw_all(pictures, folder)


def draw_shifts(found: Sequence[Searched], figure: Figure) -> None:
    """Fig. 2: shifts of all candidates, with those chosen by K-means ringed, in each search."""
    for ax, one in zip(np.ravel(figure.subplots(2, len(found) // 2).T), found, strict=False):
        _shifts(one, ax)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=4, loc="outside lower center")


def _shifts(one: Searched, ax: Axes) -> None:
    shift = CELL * np.asarray(one.found.matches.shift)
    candidates = shift[one.found.matches.is_candidate]
    chosen = CELL * one.of_choices["K-means"].of(one.found.matches.shift)
    pose = CELL * one.of_choices["pose"].of(one.found.matches.shift)
    ax.plot(candidates[:, 1], -candidates[:, 0], "*", color=EDGE, markersize=5, label="candidates")
    true = CELL * one.found.true
    ax.plot(true[:, 1], -true[:, 0], ".", color=SIGHT, markersize=4, label="true shifts")
    ring: dict[str, Any] = {"markerfacecolor": "none", "linestyle": "none"}
    ax.plot(chosen[:, 1], -chosen[:, 0], "o", color=FIX, markersize=10, label="chosen by K-means", **ring)
    ax.plot(pose[:, 1], -pose[:, 0], "s", color="#e69f00", markersize=7, label="by the pose", **ring)
    name = WHOLE if one.search == WHOLE else "within 3 sigma"
    ax.set(aspect="equal", adjustable="datalim", xlabel="east, m", ylabel="north, m")
    sought = one.sought
    ax.set_title(f"{sought.name}: {name}", fontsize=10)


def draw_images(im: Imaged, found: Flow, figure: Figure) -> None:
    """Fig. 4: the image, rectified from the navigation, and rectified after registration."""
    axes = figure.subplots(1, 3)
    axes[0].imshow(np.where(im.known, im.image, np.nan), cmap="gray")
    axes[0].set(title="Image", xlabel="column", ylabel="row")
    for ax, title, ortho in zip(
        axes[1:], ("Rectified by the navigation", "Rectified after the update"), _both(found), strict=True
    ):
        ax.set_title(title)
        _show(ortho, ax)


def _both(found: Flow) -> tuple[Orthoimage, Orthoimage | None]:
    return found.by_navigation, found.registered


def _show(ortho: Orthoimage | None, ax: Axes) -> None:
    if ortho is None:
        ax.text(0.5, 0.5, "not registered", ha="center", transform=ax.transAxes)
        return
    side = 1e-3 * ortho.ground_sampling
    rows, cols = ortho.shape
    values = np.asarray(ortho.values, float).mean(axis=0)
    extent = (0.0, cols * side, 0.0, rows * side)
    ax.imshow(np.where(np.asarray(ortho.known), values, np.nan), cmap="gray", extent=extent)
    ax.set(xlabel="across the map, km", ylabel="up the map, km", facecolor="0.93")


def draw_boards(found: Flow, figure: Figure) -> None:
    """Checkerboards of the map and the rectified image, before and after."""
    for ax, title, ortho in zip(
        figure.subplots(1, 2), ("By the navigation", "After the update"), _both(found), strict=True
    ):
        ax.set_title(title)
        if ortho is None:
            _show(None, ax)
            continue
        checkerboard(found.reference, ortho, ax)


def draw_circles(found: Flow, figure: Figure) -> None:
    """Fig. 5: the rectified image over the map, and 90 % circles before and after, with ellipses."""
    ax = figure.subplots()
    shown = found.by_navigation if found.registered is None else found.registered
    circles_on_map(found.reference, shown, found.direct, found.updated, ax)
    ax.set_title("A pixel's fix, and where it is with 90 % (Fig. 5)")


def draw_blocks(by_size: Sequence[Dense], by_ties: Sequence[Dense], figure: Figure) -> None:
    """Errors of fixes by block size, for each noise, and by number of ties, with 95 % intervals."""
    left, middle, right = figure.subplots(1, 3)
    for noise, colour in zip(dict.fromkeys(one.noise for one in by_size), (FIX, EDGE, SIGHT), strict=False):
        rows = [one for one in by_size if one.noise == noise]
        at = [float(one.size) for one in rows]
        beside = 1.0 if noise == by_size[0].noise else 1.06
        _whiskers(left, [beside * size for size in at], rows, colour, f"noise {noise:g}")
        middle.plot(at, [100.0 * one.failed for one in rows], "o-", color=colour, label=f"noise {noise:g}")
        for one in rows if noise == by_size[0].noise else ():
            top = (one.size, one.pose + one.half)
            left.annotate(f"{one.ties:.0f}", top, xytext=(0, 3), textcoords="offset points", ha="right")
    counts = [float(one.ties) for one in by_ties]
    _whiskers(right, counts, by_ties, FIX, "")
    left.set(
        title="Size of blocks (numbers: ties)", xlabel="block, cells", ylabel="error of the pose, px", ylim=(0.0, None)
    )
    middle.set(title="Blocks that fail", xlabel="block, cells", ylabel="%", ylim=(0.0, None))
    left.margins(x=0.1)
    sizes = sorted({one.size for one in by_size})
    for ax in (left, middle):
        ax.set_xscale("log")
        ax.minorticks_off()
        ax.set_xticks(sizes, [str(size) for size in sizes])
    right.set(title="Number of ties", xlabel="ties", ylabel="error of the pose, px", xscale="log", ylim=(0.0, None))
    right.minorticks_off()
    right.set_xticks(counts, [f"{count:.0f}" for count in counts])
    figure.legend(*left.get_legend_handles_labels(), frameon=False, ncols=2, loc="outside lower center")


def _whiskers(ax: Axes, at: Sequence[float], rows: Sequence[Dense], colour: str, label: str) -> None:
    pose, half = [one.pose for one in rows], [one.half for one in rows]
    ax.errorbar(at, pose, yerr=half, fmt="o-", color=colour, capsize=3, label=label)


def draw_frames(found: Sequence[Frame], figure: Figure) -> None:
    """Errors of position and fix, frame by frame, by each method; predicted values dashed."""
    left, right = figure.subplots(1, 2)
    ways = list(dict.fromkeys(one.way for one in found))
    for way, colour in zip(ways, (EDGE, FIX, SIGHT), strict=True):
        rows = [one for one in found if one.way == way]
        at = [one.number for one in rows]
        for ax, what, sigma in ((left, "position", "sigma_position"), (right, "fix", "sigma_fix")):
            usual, half = zip(*(rms(getattr(one, what)) for one in rows), strict=True)
            ax.errorbar(at, usual, yerr=half, fmt="o-", color=colour, capsize=3, label=way)
            ax.plot(at, [getattr(one, sigma) for one in rows], "--", color=colour)
    left.set(title="Position of the aircraft", xlabel="frame", ylabel="m (dashed: predicted)", ylim=(0.0, None))
    right.set(title="Fix in the middle", xlabel="frame", ylabel="m (dashed: predicted)", yscale="log")
    figure.legend(*left.get_legend_handles_labels(), frameon=False, ncols=3, loc="outside lower center")

"""Figures of the study. Needs matplotlib."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxgeo.plot import EDGE, FIX, SIGHT
from jaxgeo.studies.pictures import draw_all
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import Case, Cases
from jaxgeo.studies.xue2019.report import Report
from jaxgeo.studies.xue2019.simulation import Simulated, height_at
from jaxgeo.studies.xue2019.trials import NAMES, Trials

PANELS = (  # residuals, by figure of the paper
    ("direct", "Fig. 6"),
    ("direct pair", ""),
    ("free net position", ""),
    ("free net", "Fig. 7"),
    ("control", "Fig. 9"),
    ("Bauer", "Fig. 10"),
    ("Ebner", "Fig. 11"),
    ("Brown", "Fig. 12"),
    ("compensated", ""),
    ("compensated pair", ""),
)
UP, DOWN = "#1a7f5a", "#b3893b"
MOST = 22.0  # um, largest interior orientation error shown
ARROW = 0.17  # key length in each panel, as a share of the area's side


def write(report: Report, folder: pathlib.Path) -> None:
    """Write all figures to a folder."""
    pictures: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]] = {
        "layout.png": (lambda figure: draw_layout(report.block, figure), (7.4, 6.2)),
        "residuals.png": (lambda figure: draw_residuals(report.cases, report.block.size, figure), (16.0, 7.6)),
        "parameters.png": (lambda figure: draw_parameters(report.cases, figure), (10.5, 4.4)),
        "correlations.png": (lambda figure: draw_correlations(report.cases, figure), (7.6, 6.6)),
    }
    if report.trials is not None:
        trials = report.trials
        pictures["trials.png"] = (lambda figure: draw_trials(trials, figure), (10.5, 4.2))
    draw_all(pictures, folder)


def draw_layout(block: Simulated, figure: Figure) -> None:
    """Figs. 3, 5 and 8: exposures, ground, control and check points."""
    ax = figure.subplots()
    place = np.asarray(block.frame.from_geodetic(block.shots.pose.position))
    reach = np.abs(place[:, :2]).max(axis=0) + 60.0
    east, north = np.meshgrid(*(np.linspace(-side, side, 240) for side in reach))
    ground = ax.contourf(east, north, height_at(east, north), levels=12, cmap="YlOrBr", alpha=0.45)
    figure.colorbar(ground, ax=ax, label="height of the ground, m", shrink=0.8)
    for strip in np.unique(block.strip):
        ax.plot(*place[block.strip == strip, :2].T, color="0.55", linewidth=0.8, zorder=2)
    ax.plot(*place[:, :2].T, ".", color=EDGE, markersize=4, label=f"{len(place)} exposures")
    for points, marker, colour, label in (
        (block.control, "^", FIX, "control"),
        (block.checks, "o", SIGHT, "check points"),
    ):
        style: dict[str, Any] = {"color": colour, "markersize": 8, "markeredgecolor": "white", "zorder": 4}
        ax.plot(*points.place[:, :2].T, marker, label=f"{len(points)} {label}", **style)
    ax.set(
        xlabel="east, m", ylabel="north, m", aspect="equal", title="Strips, control and check points (Figs. 3 and 8)"
    )
    figure.legend(*ax.get_legend_handles_labels(), frameon=False, ncols=3, loc="outside lower center")


def draw_residuals(found: Cases, size: float, figure: Figure) -> None:
    """Figs. 6 and 7 and 9 to 12: residuals in plan as arrows, in height as bars, scaled per panel."""
    there = {case.name for case in found.cases}
    shown = [panel for panel in PANELS if panel[0] in there]
    panels = figure.subplots(2, -(-len(shown) // 2), sharex=True, sharey=True)
    for ax, (name, number) in zip(panels.ravel(), shown, strict=False):
        _residuals(found.of(name), size, number, ax)
    for ax in panels[1]:
        ax.set_xlabel("east, m")
    for ax in panels[:, 0]:
        ax.set_ylabel("north, m")
    handles = [
        panels[0, 0].plot([], [], color=FIX, linewidth=1.6, label="residual in plan")[0],
        panels[0, 0].plot([], [], color=UP, linewidth=4.0, label="too high")[0],
        panels[0, 0].plot([], [], color=DOWN, linewidth=4.0, label="too low")[0],
    ]
    figure.legend(handles=handles, frameon=False, ncols=3, loc="outside lower center")


def _residuals(case: Case, size: float, number: str, ax: Axes) -> None:
    """One case, with separate scales for plan and height."""
    plan, height = case.differences[:, :2], case.differences[:, 2]
    keys = _round(np.abs(plan).max()), _round(np.abs(height).max())
    east, north = case.checks.place[:, :2].T
    in_plan, in_height = (ARROW * size / key for key in keys)
    colours = np.where(height > 0.0, UP, DOWN)
    ax.bar(east, height * in_height, 0.022 * size, bottom=north, color=colours, alpha=0.75, zorder=2)
    style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "zorder": 3, "width": 0.007}
    ax.quiver(east, north, *(plan * in_plan).T, color=FIX, **style)
    ax.plot(east, north, "o", color=EDGE, markersize=3, zorder=4)
    y = -0.72 * size
    ax.quiver([-0.55 * size], [y], [ARROW * size], [0.0], color=FIX, **style)
    ax.text(-0.36 * size, y, f"{keys[0]:g} m", va="center", fontsize=9, color=FIX)
    ax.bar([0.2 * size], [ARROW * size], 0.022 * size, bottom=y - 0.5 * ARROW * size, color="0.5")
    ax.text(0.24 * size, y, f"{keys[1]:g} m", va="center", fontsize=9, color="0.3")
    x, y, z = case.rms
    label = f"{number}: RMS" if number else "RMS"
    ax.set_title(f"{case.title}\n", fontsize=9.5)
    ax.text(0.0, 1.015, f"{label} {x:.3f}  {y:.3f}  {z:.3f} m", transform=ax.transAxes, fontsize=9, color="0.3")
    ax.set(xlim=(-0.65 * size, 0.65 * size), ylim=(-0.85 * size, 0.75 * size), aspect="equal")


def _round(value: float) -> float:
    """Smallest 1, 2 or 5 times a power of ten such that the value is at most five quarters of it."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min(step * power for step in (1.0, 2.0, 5.0, 10.0) if value <= 1.25 * step * power))


def draw_parameters(found: Cases, figure: Figure) -> None:
    """Errors of interior orientation and boresight, with bars of three standard deviations."""
    left, right = figure.subplots(1, 2, width_ratios=(1, 1))
    true = printed.INTERIORS["Brown"]
    colours = {"Bauer": DOWN, "Ebner": SIGHT, "Brown": FIX}
    for row, one in enumerate(found.recovered):
        shift = 0.18 * (row - 1.5)
        style: dict[str, Any] = {"fmt": "o", "capsize": 3, "markersize": 4, "color": colours.get(one.model, UP)}
        label = one.model if "steps" in one.model else f"{one.model}, one step"
        at = np.arange(3) + shift
        off, sigma = np.subtract(one.interior, true), np.array(one.sigma_interior)
        left.errorbar(at, 1e3 * off, 3e3 * sigma, label=label, **style)
        if 3e3 * sigma[0] > MOST:
            words = f"{1e3 * off[0]:+.0f} ± {3e3 * sigma[0]:.0f}"
            left.text(at[0] + 0.04, -0.95 * MOST, words, color=style["color"], fontsize=9)
        off = one.boresight - np.array(printed.BORESIGHT)
        right.errorbar(at, off, 3.0 * one.sigma_boresight, label=label, **style)
    for row, one in enumerate(printed.INTERIORS.values()):
        off = 1e3 * np.subtract(one, true)
        left.plot(np.arange(3) + 0.18 * (row - 1.5), off, "x", color="0.4", label="printed" if row == 0 else None)
    left.set(
        title="Interior orientation (bars: 3 sigma)", ylabel="off the truth, um", xticks=range(3), ylim=(-MOST, MOST)
    )
    left.set_xticklabels(["f", "xp", "yp"])
    right.set(title="Boresight (bars: 3 sigma)", ylabel="off the truth, minutes of arc", xticks=range(3))
    right.set_xticklabels(["x", "y", "z"])
    for ax in (left, right):
        ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
        ax.spines["bottom"].set_visible(False)
        ax.tick_params(axis="x", length=0)
    figure.legend(*left.get_legend_handles_labels(), frameon=False, ncols=5, loc="outside lower center", fontsize=9)


def draw_correlations(found: Cases, figure: Figure) -> None:
    """Correlations of all parameters of the Brown model."""
    ax = figure.subplots()
    names = [p.name for p in found.adjustment.parameters]
    image = ax.imshow(found.adjustment.correlations, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set_title("Correlations of the parameters, Brown, one step")
    ax.spines[:].set_visible(False)
    figure.colorbar(image, ax=ax, shrink=0.8)


def draw_trials(found: Trials, figure: Figure) -> None:
    """Squared errors against chi-square with six degrees of freedom, and the single parameters."""
    from scipy.stats import chi2  # imported on first use

    left, right = figure.subplots(1, 2)
    squares = np.sort(found.squares)
    ranks = (np.arange(len(squares)) + 0.5) / len(squares)
    left.plot(chi2.ppf(ranks, len(NAMES)), squares, "o", color=SIGHT, markersize=3.5)
    most = float(max(squares[-1], chi2.ppf(ranks[-1], len(NAMES)))) * 1.05
    left.plot([0.0, most], [0.0, most], color="0.6", linewidth=0.8, zorder=0)
    left.set(title=f"Squared errors of {len(squares)} blocks", xlabel="chi-square, 6 degrees of freedom")
    left.set(ylabel="e' C⁻¹ e", xlim=(0.0, most), ylim=(0.0, most))
    for row, values in enumerate(found.normalised.T):
        jitter = np.linspace(-0.25, 0.25, len(values))
        right.plot(values, row + jitter, ".", color=FIX, markersize=4, alpha=0.6)
    for bound in (-1.96, 1.96):
        right.axvline(bound, color="0.6", linewidth=0.8, linestyle="--", zorder=0)
    right.set_yticks(range(len(NAMES)), NAMES)
    right.invert_yaxis()
    right.set(title="Errors over their standard deviations", xlabel="standard deviations (dashed: 95 %)")

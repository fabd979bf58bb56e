"""Figures of the study. Needs matplotlib."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from jaxgeo.plot import EDGE, FIX, SIGHT
from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.inclination import Inclination
from jaxgeo.studies.li2023.pointing import GRID, Pointing
from jaxgeo.studies.li2023.positions import LEVEL_GROUND, Accuracy
from jaxgeo.studies.li2023.report import Report
from jaxgeo.studies.li2023.searches import IN_PRINT, KINDS, SEARCHES, Comparison, printed_ratios
from jaxgeo.studies.li2023.sheets import groups
from jaxgeo.studies.pictures import draw_all
from jaxgeo.terrain import Outcome

QUIET, BAND = "#9db7d5", "#f1e3c6"
SHOWN_SIGMAS = (10.0, 50.0, 100.0, 150.0, 190.0)  # m
MOST_POINTS = 4000  # in a scatter plot
LOOKS = {
    "linear": ("#8a8a8a", "o"),
    "linear, facet": ("#c9b27c", "D"),
    "linear, footprint": (SIGHT, "s"),
    "sampled": (EDGE, "o"),
}
LOG_TICKS = (70.0, 100.0, 200.0, 500.0, 1000.0)  # m
LEVEL_AT = {"linear": -0.28, "sampled": -0.14}
FRACTAL_AT = {"linear, facet": -0.02, "linear, footprint": 0.16, "sampled": 0.34}
REAL_BY = 0.09
KIND_COLOURS = dict(zip(KINDS, ("#9db7d5", "#c9b27c", EDGE), strict=True))
BESIDE = 0.22  # offset between kinds of terrain; searches are 1 apart


def write(report: Report, folder: pathlib.Path) -> None:
    """Write all figures to a folder."""
    pictures: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]] = {
        "pointing.png": (lambda figure: draw_pointing(report.pointing[0], figure), (10.0, 4.0)),
        "inclination.png": (lambda figure: draw_inclination(report.inclination, figure), (10.0, 4.4)),
        "positions.png": (lambda figure: draw_positions(report.positions, figure), (10.0, 4.8)),
        "searches.png": (lambda figure: draw_searches(report.searches, figure), (10.0, 4.6)),
    }
    draw_all(pictures, folder)


def draw_pointing(found: Pointing, figure: Figure) -> None:
    """Fig. 12: distribution of the pointing errors, and the shares stated in the paper."""
    left, right = figure.subplots(1, 2)
    low, high = printed.LOS_BAND
    claim = f"{low}° to {high}°: {found.in_band[0]:.0%}, printed > 50 %"
    left.axvspan(low, high, color=BAND, zorder=0, label=claim)
    left.hist(
        found.angles,
        bins=GRID[::2].tolist(),
        density=True,
        color=QUIET,
        alpha=0.8,
        label=f"{found.angles.size} samples",
    )
    left.plot(GRID[:-1] + 0.5 * np.diff(GRID), np.diff(found.chance) / np.diff(GRID), color=SIGHT, label="linear")
    left.axvline(found.linear_rms, color=EDGE, linewidth=1.0, label=f"RMS {found.linear_rms:.4f}°")
    left.axvline(printed.LOS_RMS, color=FIX, linewidth=1.0, linestyle="--", label=f"RMS printed {printed.LOS_RMS}°")
    left.set(
        xlabel="pointing error, °", ylabel="density, 1/°", title="Distribution of the pointing error", xlim=(0.0, 0.25)
    )
    left.legend(frameon=False, fontsize=9)
    right.plot(GRID, 100.0 * found.chance, color=SIGHT, label="linear")
    right.plot(np.sort(found.angles), np.linspace(0.0, 100.0, found.angles.size), ":", color=EDGE, label="sampled")
    for limit, share in printed.LOS_WITHIN.items():
        ours = f"{found.linear_within[limit]:.2%}"
        right.plot(
            [limit], [100.0 * share], "o", color=FIX, label=f"printed {share:.2%} below {limit:.2f}°, linear {ours}"
        )
    right.set(
        xlabel="pointing error, °",
        ylabel="share below, %",
        title="Share below an angle",
        xlim=(0.0, 0.25),
        ylim=(0, 101),
    )
    right.legend(frameon=False, fontsize=9, loc="lower right")


def draw_inclination(found: Inclination, figure: Figure) -> None:
    """Fig. 5: curves over the frame angle, and the map over both."""
    left, right = figure.subplots(1, 2)
    shades = np.linspace(0.35, 0.95, len(SHOWN_SIGMAS))
    for sigma, shade in zip(SHOWN_SIGMAS, shades, strict=True):
        row = int(np.argmin(np.abs(found.sigmas - sigma)))
        colour = mpl.colormaps["Blues"](shade)
        left.plot(found.frames, found.full[row], color=colour)
        left.plot(found.frames, found.height_only[row], color=colour, linestyle="--", linewidth=1.0)
        left.text(found.frames[-1] + 0.3, found.full[row, -1], f"{sigma:.0f} m", va="center", fontsize=9)
    left.plot([], [], color=EDGE, label="height and the ten angles of Table 1")
    left.plot([], [], color=EDGE, linestyle="--", linewidth=1.0, label="height alone")
    left.set(xlabel="outer frame angle, °", ylabel="RMS of the position, m", title="RMS, by the error of height")
    left.set(xlim=(found.frames[0], found.frames[-1] + 2.0), ylim=(0.0, None))
    left.set_xticks(ticks := np.arange(60.0, found.frames[-1] + 0.1, 3.0))
    left.legend(frameon=False, loc="upper left")
    filled = right.contourf(found.frames, found.sigmas, found.full, levels=np.arange(0.0, 1001.0, 100.0), cmap="Blues")
    levels = [50.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0, 900.0]
    lines = right.contour(found.frames, found.sigmas, found.full, levels=levels, colors=EDGE, linewidths=0.7)
    right.clabel(lines, fmt="%.0f m", fontsize=8)
    figure.colorbar(filled, ax=right, label="RMS of the position, m")
    right.set(xlabel="outer frame angle, °", ylabel="σ of height, m", title="RMS with all errors", xticks=ticks)


def draw_positions(found: list[Accuracy], figure: Figure) -> None:
    """Table 3: every prediction beside the printed one, and the share inside the printed circle of the plain."""
    left, right = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
    _draw_rms(found, left)
    plain = {one.method: one for one in found if (one.terrain, one.ground) == ("plain", LEVEL_GROUND)}
    _draw_circles(plain["linear"], plain["sampled"].errors_enu, right)


def _draw_rms(found: list[Accuracy], ax: Any) -> None:
    """RMS by terrain: printed, obtained on level and synthetic ground, and the error against a map."""
    seen: set[str] = set()
    for base, (name, row) in enumerate(printed.TERRAINS.items()):
        first = {"label": "printed"} if base == 0 else {}
        ax.plot([base - 0.4, base + 0.4], [row.rms, row.rms], color=FIX, linewidth=2.0, zorder=1, **first)
        first = {"label": "actual error against a map"} if base == 0 else {}
        ax.plot([base - 0.4], [row.actual], "*", color=FIX, markersize=13, zorder=3, **first)
        ours = {key: group for key, group in groups(found).items() if key[0] == name}
        for (_, ground, method), group in ours.items():
            is_real = ground.startswith("real")
            offset = LEVEL_AT.get(method, 0.0) if ground == LEVEL_GROUND else FRACTAL_AT[method] + REAL_BY * is_real
            colour, marker = LOOKS[method]
            rms = np.array([one.rms for one in group])
            label = f"{method}, {'level' if ground == LEVEL_GROUND else 'synthetic (left) and real terrain (right)'}"
            face = "white" if ground == LEVEL_GROUND else colour
            jitter = np.linspace(-0.03, 0.03, rms.size) if rms.size > 1 else np.zeros(1)
            ax.plot(
                base + offset + jitter, rms, marker, color=colour, markersize=3.5, alpha=0.5 if rms.size > 1 else 0.0
            )
            style = {"markerfacecolor": face, "markersize": 6.0, "linestyle": "none", "zorder": 4}
            shown = {} if label in seen else {"label": label}
            ax.plot([base + offset], [np.median(rms)], marker, color=colour, **style, **shown)
            seen.add(label)
    ax.set_xticks(range(len(printed.TERRAINS)), list(printed.TERRAINS))
    ax.set(ylabel="m (logarithmic)", title="RMS of the position (small: single places)", xlim=(-0.55, 2.5))
    ax.set(yscale="log", ylim=(70.0, 3000.0), yticks=LOG_TICKS, yticklabels=[f"{tick:.0f}" for tick in LOG_TICKS])
    ax.minorticks_off()
    ax.legend(frameon=False, fontsize=8.5, loc="upper left")


def _draw_circles(cloud: Accuracy, errors: np.ndarray | None, ax: Any) -> None:
    """Linear radii over a scatter plot of samples."""
    errors = np.zeros((0, 3)) if errors is None else errors[:MOST_POINTS]
    ax.plot(errors[:, 0], errors[:, 1], ".", color=QUIET, markersize=2.0, zorder=0, rasterized=True)
    actual = printed.TERRAINS[cloud.terrain].actual
    circles = [
        (cloud.ce50, SIGHT, "-", f"CE50 {cloud.ce50:.1f} m"),
        (cloud.rms_over_1_2, EDGE, "--", f"RMS / 1.2 {cloud.rms_over_1_2:.1f} m holds {cloud.held:.1%}"),
        (cloud.ce90, SIGHT, ":", f"CE90 {cloud.ce90:.1f} m"),
        (actual, FIX, "-", f"actual error {actual} m; {cloud.beyond:.0%} lie beyond"),
    ]
    for radius, colour, line, label in circles:
        ax.add_patch(Circle((0.0, 0.0), radius, fill=False, color=colour, linestyle=line, linewidth=1.5))
        ax.plot([], [], color=colour, linestyle=line, label=label)
    reach = 1.65 * cloud.ce90
    ax.set(xlabel="east, m", ylabel="north, m", title=f"The {cloud.terrain}: circles", aspect="equal")
    ax.set(xlim=(-reach, reach), ylim=(-reach, 1.75 * reach))
    ax.legend(frameon=False, fontsize=8.5, loc="upper left")


def draw_searches(found: Comparison, figure: Figure) -> None:
    """Table 4: height evaluations of each search, its cost beside the printed one, and its success rate."""
    left, right = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
    for k, (kind, colour) in enumerate(KIND_COLOURS.items()):
        across = np.arange(len(SEARCHES)) + BESIDE * (k - 1)
        asked = [found.evaluations(kind, name) for name in SEARCHES]
        low, high = (np.array([np.quantile(x, q) for x in asked]) for q in (0.05, 0.95))
        left.vlines(across, low, high, color=colour, linewidth=4.0, alpha=0.6)
        left.plot(across, [np.median(x) for x in asked], "_", color="black", markersize=9)
        left.plot(across, [np.mean(x) for x in asked], "o", color=colour, markeredgecolor="black", label=kind)
        for x, top, name in zip(across, high, SEARCHES, strict=True):
            share = found.share(kind, name, Outcome.first_hit).value
            left.annotate(
                f"{share:.0%}", (x, top), (0, 4), textcoords="offset points", ha="center", fontsize=7, rotation=90
            )
        others = IN_PRINT[:-1]
        ratios = [found.ratio(kind, name) for name in others]
        at = np.arange(len(others)) + BESIDE * (k - 1)
        away = np.array([[one.value - one.low, one.high - one.value] for one in ratios]).T
        ours = np.array([one.value for one in ratios])
        right.errorbar(at, ours, yerr=away, fmt="o", color=colour, markeredgecolor="black", label=f"{kind}, ours")
        first = {"label": "printed (times)"} if k == 0 else {}
        right.plot(at, printed_ratios(kind), "_", color=FIX, markersize=14, markeredgewidth=2.5, **first)
    left.set(yscale="log", ylabel="heights asked for, of a ray", title="Cost, and share that finds the first hit")
    left.set_ylim(top=left.get_ylim()[1] * 3.0)
    left.set_xticks(range(len(SEARCHES)), [name.replace("photogrammetric", "photo-\ngrammetric") for name in SEARCHES])
    left.tick_params(axis="x", labelsize=8)
    left.plot([], [], "_", color="black", markersize=9, label="median")
    left.plot([], [], color="grey", linewidth=4.0, alpha=0.6, label="5 % to 95 % of rays; circles: means")
    left.legend(frameon=False, fontsize=8, loc="upper right")
    right.axhline(1.0, color=EDGE, linewidth=0.8)
    right.set(yscale="log", ylabel="over the fast one", title="Mean cost over the fast iteration's")
    right.set_xticks(range(len(IN_PRINT) - 1), IN_PRINT[:-1])
    right.legend(frameon=False, fontsize=8)

"""Residuals of an adjustment: vectors over the image, and a histogram against the normal distribution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from jaxgeo._checks import check_is
from jaxgeo.adjust import Adjustment, Reliability, reliability
from jaxgeo.plot.legends import keyed, legend_of
from jaxgeo.plot.style import BLUE, INK, MUTED, ORANGE, VERMILLION, grid_behind, house_axes, round_length

LONG = 0.06  # of the image's width: default limit on the drawn length of most residuals
WIDEST = 5.0  # standard deviations on either side of a histogram
BINS = 40
SHAFT = 0.010  # inches: the width of an arrow


def residual_arrows(
    adjustment: Adjustment,
    ax: Axes | None = None,
    *,
    image: str | None = None,
    exaggeration: float | None = None,
    checked: Reliability | None = None,
    legend: bool = True,
) -> Axes:
    """Image residuals (adjusted minus measured) as exaggerated arrows over the image plane.

    Axes are columns to the right and rows downwards, px. With `image` only its residuals are drawn; by default those of
    all images together, which shows common systematic errors such as a mismodelled lens. `exaggeration` is the ratio
    of drawn to true length, by default a round number that makes most arrows visible. With `checked`
    (`jaxgeo.adjust.reliability`) residuals that exceed the critical value are drawn in another colour. Raises
    `TypeError` for other records, `ValueError` for an image without measurements, for all images of more than one
    camera, and an exaggeration that is not positive.
    """
    check_is(adjustment, Adjustment, "adjustment", "Make one with jaxgeo.adjust.adjust.")
    if checked is not None:
        check_is(checked, Reliability, "checked", "Make one with jaxgeo.adjust.reliability.")
    rows, name = _measured(adjustment, image)
    seen, camera = adjustment.block.observations, adjustment.block.cameras[name]
    uv, residuals = seen.uv[rows], adjustment.residuals[rows]
    times = _times(residuals, camera.width) if exaggeration is None else exaggeration
    if not (math.isfinite(times) and times > 0.0):
        raise ValueError(f"exaggeration must be a positive number; got {exaggeration!r}.")
    wrong = np.zeros(len(uv), bool) if checked is None else _exceeds(checked)[rows]
    edge = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]])
    drawn = np.concatenate([edge, uv, uv + times * residuals])  # some tips lie beyond the image's edge
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    which = f"image {image}" if image is not None else f"{len(np.unique(seen.image[rows]))} images"
    frame: dict[str, Any] = {"facecolor": "none", "edgecolor": MUTED, "linewidth": 0.8}
    with house_axes(ax, tall=0.8) as ax:
        handles = _arrows(uv, residuals, wrong, times, checked, ax)
        ax.add_patch(Rectangle((-0.5, -0.5), camera.width, camera.height, **frame))
        ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        ax.set(aspect="equal", xlabel="column, px", ylabel="row, px")
        ax.spines[:].set_visible(True)
        handles.append(_key(times, camera.width, ax))
        ax.set_title(f"{which}: rms {rms[0]:.2g}, {rms[1]:.2g} px", pad=9.0)
        if legend:
            legend_of(ax, handles)
    return ax


def residual_histogram(
    adjustment: Adjustment, ax: Axes | None = None, *, checked: Reliability | None = None, legend: bool = True
) -> Axes:
    """Histogram of standardised image residuals (columns and rows) and the distribution expected from their sigmas.

    Each residual is divided by its own standard deviation, which is that of the measurement times the root of its
    redundancy number; `checked` gives it, and is computed if left out. The curve is the normal distribution scaled to
    the same count. Uncontrolled residuals and those beyond five standard deviations are counted in a note. Raises
    `TypeError` for other records, `ValueError` where no residual is controlled.
    """
    check_is(adjustment, Adjustment, "adjustment", "Make one with jaxgeo.adjust.adjust.")
    checked = reliability(adjustment) if checked is None else checked
    check_is(checked, Reliability, "checked", "Make one with jaxgeo.adjust.reliability.")
    values = np.asarray(checked.standardised)
    known = np.isfinite(values)
    if not known.any():
        raise ValueError("no residual is checked by another measurement: there is nothing to compare.")
    edges = np.linspace(-WIDEST, WIDEST, _bins(int(known.sum())) + 1)
    x = np.linspace(-WIDEST, WIDEST, 401)
    whole = 0.5 * known.sum() * (edges[1] - edges[0])  # of either axis
    expected = whole * np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)
    with house_axes(ax) as ax:
        handles: list[Artist] = []
        for column, (label, filled) in enumerate((("columns", True), ("rows", False))):
            own = values[known[:, column], column]
            count, _ = np.histogram(own, edges)
            handles.append(_steps(count, edges, f"{label}, spread {_spread(own)}", filled, ax))
        handles += ax.plot(x, expected, color=INK, linewidth=1.3, zorder=4, label="expected, spread 1")
        _limits(checked, ax)
        ax.set(xlim=(-WIDEST, WIDEST), ylim=(0.0, 1.12 * ax.dataLim.y1))
        ax.set(xlabel="residual, in its own standard deviations", ylabel="residuals in a bin, count")
        grid_behind(ax)
        ax.set_title(f"\N{GREEK SMALL LETTER SIGMA}0 {adjustment.sigma0:.3f}, redundancy {adjustment.redundancy}")
        if legend:
            legend_of(ax, handles, title=_remark(checked, values))
    return ax


def _measured(adjustment: Adjustment, image: str | None) -> tuple[np.ndarray, str]:
    """(which measurements are drawn, the name of their camera)."""
    block = adjustment.block
    camera = dict(zip(block.images.name.tolist(), block.images.camera.tolist(), strict=True))
    measured = block.observations.image
    if image is None:
        names = sorted({camera[name] for name in np.unique(measured).tolist()})
        if len(names) > 1:
            raise ValueError(f"the images are of {len(names)} cameras ({', '.join(names)}): name one image.")
        return np.ones(len(measured), bool), names[0]
    rows = np.asarray(measured == image)
    if not rows.any():
        some = ", ".join(np.unique(measured).tolist()[:5])
        raise ValueError(f"image {image!r} has no measurements in this block; others are {some}.")
    return rows, camera[image]


def _exceeds(checked: Reliability) -> np.ndarray:
    """For each image point, whether its residual along columns or rows exceeds the critical value."""
    with np.errstate(invalid="ignore"):
        return np.any(np.abs(checked.standardised) > checked.critical, axis=1)


def _times(residuals: np.ndarray, width: int) -> float:
    """A round exaggeration at which most residuals are visible and few are long."""
    longest = float(np.quantile(np.linalg.norm(residuals, axis=1), 0.95))
    return round_length(LONG * width / longest) if longest > 0.0 else 1.0


def _arrows(
    uv: np.ndarray, residuals: np.ndarray, wrong: np.ndarray, times: float, checked: Reliability | None, ax: Axes
) -> list[Artist]:
    """Draw arrows from the measured points; returns handles with their counts."""
    handles: list[Artist] = []
    words = "residuals" if checked is None else "residuals within the test"
    for which, colour, label in ((~wrong, BLUE, words), (wrong, VERMILLION, "beyond it")):
        if not which.any():
            continue
        style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0 / times}
        style |= {"units": "inches", "width": SHAFT if colour == BLUE else 1.7 * SHAFT}
        heads: dict[str, Any] = {"headwidth": 4.0, "headlength": 5.0, "headaxislength": 4.5, "minlength": 0.5}
        zorder = 4 if colour == VERMILLION else 3
        arrows = ax.quiver(*uv[which].T, *residuals[which].T, color=colour, zorder=zorder, **style, **heads)
        arrows.set_in_layout(False)
        handles.append(keyed(ax, f"{which.sum()} {label}", color=colour, linewidth=1.4))
    return handles


def _key(times: float, width: int, ax: Axes) -> Artist:
    """A scale bar above the image, as long as a residual of a round number of px, and its handle."""
    length = round_length(0.15 * width / times)
    bar: dict[str, Any] = {"color": INK, "linewidth": 2.0, "solid_capstyle": "butt", "clip_on": False, "zorder": 5}
    x = width - 0.5 - np.array([length * times, 0.0])
    ax.plot(x, [1.025, 1.025], label="_key", transform=ax.get_xaxis_transform(), **bar)
    return keyed(ax, f"a residual of {length:g} px ({times:g} times)", color=INK, linewidth=2.0)


def _bins(count: int) -> int:
    """Even number of histogram bins: fewer for few residuals."""
    return int(np.clip(2 * round(0.5 * WIDEST * count ** (1.0 / 3.0) / 1.5), 10, BINS))


def _steps(count: np.ndarray, edges: np.ndarray, label: str, filled: bool, ax: Axes) -> Artist:
    """Draw one histogram, filled or as an outline."""
    if filled:
        style: dict[str, Any] = {"facecolor": "#a9cbe3", "edgecolor": BLUE, "linewidth": 0.8}
        ax.stairs(count, edges, fill=True, zorder=2, label=f"_{label}", **style)
        return keyed(ax, label, area=True, **style)
    line: dict[str, Any] = {"edgecolor": ORANGE, "linewidth": 1.4}
    ax.stairs(count, edges, zorder=3, label=f"_{label}", **line)
    return keyed(ax, label, color=ORANGE, linewidth=1.4)


def _spread(values: np.ndarray) -> str:
    """Root mean square about zero."""
    return f"{math.sqrt(float(np.mean(values**2))):.2f}" if len(values) else "unknown"


def _limits(checked: Reliability, ax: Axes) -> None:
    """Draw lines at the critical value of the test on either side."""
    for side in (-1.0, 1.0):
        if checked.critical < WIDEST:
            ax.axvline(side * checked.critical, color=MUTED, linewidth=0.9, linestyle="--", zorder=1)


def _remark(checked: Reliability, values: np.ndarray) -> str:
    """Note: values outside the histogram, and the observed and expected counts beyond the critical value."""
    known = values[np.isfinite(values)]
    size = np.abs(known)
    beyond, chance = int(np.count_nonzero(size > checked.critical)), checked.alpha * len(known)
    said = [f"{beyond} beyond ±{checked.critical:.2f}, by chance {chance:.2g}"]
    outside, unchecked = int(np.count_nonzero(size > WIDEST)), values.size - len(known)
    said += [f"{outside} outside the picture"] * bool(outside)
    said += [f"{unchecked} of {values.size} checked by nothing"] * bool(unchecked)
    return "; ".join(said)

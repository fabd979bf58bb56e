"""Linear propagation against samples: what each says of one fix, in one picture, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxgeo._checks import check_is
from jaxgeo.plot.style import BLUE, GREEN, INK, ORANGE, SKY, VERMILLION, grid_behind, legend_below, metres, percent
from jaxgeo.uncertainty import Comparison, Propagation

PROBABILITY, FIGURE = 0.9, 1  # CE90, and where it stands among the figures of a comparison
METHODS = ("linear, facet",)
LOOKS = ((INK, 1.5), (ORANGE, 1.5), (GREEN, 1.2))  # colour and width of linear methods, in turn
MOST_POINTS = 5000  # of a cloud; more make it no clearer
SHOWN = 0.99  # of the samples, and of those that jumped, which a picture holds that is not told its reach
FAR = 8.0  # times the largest circle: no picture goes farther by itself


def draw_comparison(
    axes: Axes, comparison: Comparison, *, methods: Sequence[str] = METHODS, reach: float | None = None
) -> Axes:
    """The cloud of sampled errors with its ellipse and CE90, those of linear `methods`, and the verdict in words.

    In m east and north of the fix. Full lines are ellipses of the covariances at 90 %, dashed ones circles that hold
    90 %: where the samples are normal, an ellipse holds as many as its circle. Crosses are samples beyond a gap of
    unseen ground. `reach` is half the side in m, by default such that 99 % of the samples, of those that jumped too,
    and all circles are inside, or eight times the largest circle; what is outside is counted in words.
    Raises `TypeError` for another record, `ValueError` for samples that were not kept, that have no fix, for methods
    that are not linear ones of the comparison, and a reach that is not positive.
    """
    check_is(comparison, Comparison, "comparison", "Make one with jaxgeo.uncertainty.compare.")
    unknown = [name for name in methods if name not in comparison.propagations]
    if unknown or len(methods) > len(LOOKS):
        known = "; ".join(comparison.propagations) or "none"
        raise ValueError(f"methods must be up to {len(LOOKS)} of the linear ones ({known}); got {list(methods)}.")
    points, jumped = _cloud(comparison)
    sampled = comparison.quantiles[FIGURE]
    circles = [one.value for one in (sampled,) if math.isfinite(one.value)]
    handles = _points(axes, points, jumped, comparison)
    handles.append(_sampled(axes, comparison))
    for name, (colour, width) in zip(methods, LOOKS, strict=False):
        one = comparison.propagations[name]
        handles.append(_linear(axes, name, one, comparison, {"color": colour, "linewidth": width}))
        circles.append(float(one.circular_error(PROBABILITY)))
    axes.plot([0.0], [0.0], "+", color=INK, markersize=8.0, markeredgewidth=1.2, zorder=7, label="_fix")
    half = _reach(points, jumped, circles, reach)
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="east, m", ylabel="north, m")
    grid_behind(axes)
    handles.append(Line2D([], [], color="0.4", linewidth=1.0, label="ellipse of the covariance, 90 %"))
    handles.append(Line2D([], [], color="0.4", linewidth=1.0, linestyle=(0, (4, 2)), label="circle of 90 %, CE90"))
    outside = float(np.mean(np.abs(points).max(axis=1) > half))
    said = comparison.verdict + (f" Outside the picture: {percent(outside)}." if outside > 0.0 else "")
    legend_below(axes, handles, beside=True, title=said)
    return axes


def _cloud(comparison: Comparison) -> tuple[np.ndarray, np.ndarray]:
    """(errors (n, 2) of the samples that have a fix, which of them jumped)."""
    sampled = comparison.sampled
    if sampled.errors_enu is None:
        raise ValueError("the samples of this comparison were not kept: compare again.")
    found = np.isfinite(sampled.errors_enu[:, 0])
    if not found.any():
        raise ValueError("none of the samples has a fix: there is nothing to draw.")
    beyond = np.zeros(len(found), bool) if comparison.beyond_gap is None else np.asarray(comparison.beyond_gap, bool)
    return (sampled.errors_enu + sampled.centre_enu)[found, :2], beyond[found]


def _points(axes: Axes, points: np.ndarray, jumped: np.ndarray, comparison: Comparison) -> list[Artist]:
    """The cloud, thinned to what can be seen, and handles that say how many samples there are."""
    step = -(-len(points) // MOST_POINTS)
    points, jumped = points[::step], jumped[::step]
    label = f"{comparison.sampled.count:,} samples".replace(",", " ")
    size = 1.9 if len(points) > 1500 else 2.8
    dots: dict[str, Any] = {"marker": "o", "color": SKY, "linestyle": "none", "markeredgewidth": 0.0}
    axes.plot(*points[~jumped].T, alpha=0.7, markersize=size, rasterized=True, zorder=2, label="_samples", **dots)
    handles: list[Artist] = [Line2D([], [], markersize=4.0, label=label, **dots)]
    if jumped.any():
        cross: dict[str, Any] = {"marker": "x", "color": VERMILLION, "linestyle": "none", "markeredgewidth": 0.6}
        axes.plot(*points[jumped].T, markersize=2.6, rasterized=True, zorder=3, label="_jumped", **cross)
        label = f"on other ground, {percent(comparison.jumped)}"
        handles.append(Line2D([], [], markersize=4.5, label=label, **cross))
    return handles


def _sampled(axes: Axes, comparison: Comparison) -> Artist:
    """Ellipse and circle of the samples."""
    sampled, figure = comparison.sampled, comparison.quantiles[FIGURE]
    style: dict[str, Any] = {"color": BLUE, "linewidth": 1.8, "zorder": 5}
    centre = np.asarray(sampled.centre_enu)[:2]
    _ellipse(axes, "sampled", np.asarray(sampled.mean_enu)[:2], np.asarray(sampled.cov_enu)[:2, :2], style)
    _circle(axes, "sampled", centre, figure.value, style)
    between = f" ({figure.low:.3g} to {figure.high:.3g})" if math.isfinite(figure.high) else ""
    return Line2D([], [], color=BLUE, linewidth=1.8, label=f"sampled: CE90 {metres(figure.value)}{between}")


def _linear(axes: Axes, name: str, one: Propagation, comparison: Comparison, style: dict[str, Any]) -> Artist:
    """Ellipse and circle of one linear method, and whether the samples bear its CE90 out."""
    radius = float(one.circular_error(PROBABILITY))
    _ellipse(axes, name, np.asarray(one.bias_enu)[:2], np.asarray(one.cov_enu)[:2, :2], {**style, "zorder": 6})
    _circle(axes, name, np.zeros(2), radius, {**style, "zorder": 6})
    validity = [row.validity[FIGURE] for row in comparison.rows if row.method == name]
    words = f", {validity[0]}" if validity else ""
    return Line2D([], [], label=f"{name}: CE90 {metres(radius)}{words}", **style)


def _ellipse(axes: Axes, name: str, mean: np.ndarray, cov: np.ndarray, style: dict[str, Any]) -> None:
    """The ellipse that holds 90 % of a normal distribution."""
    values, vectors = np.linalg.eigh(cov)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) * math.sqrt(-2.0 * math.log1p(-PROBABILITY))
    axes.plot(*(mean[:, None] + root @ _ring()), label=f"_ellipse, {name}", **style)


def _circle(axes: Axes, name: str, centre: np.ndarray, radius: float, style: dict[str, Any]) -> None:
    """A circle; none where its radius has no end."""
    if math.isfinite(radius):
        axes.plot(*(centre[:, None] + radius * _ring()), linestyle=(0, (4, 2)), label=f"_circle, {name}", **style)


def _ring() -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, 241)
    return np.stack([np.cos(turn), np.sin(turn)])


def _reach(points: np.ndarray, jumped: np.ndarray, circles: Sequence[float], reach: float | None) -> float:
    """Half the side of the picture, m."""
    if reach is None:
        away = np.abs(points).max(axis=1)
        far = [float(np.quantile(away[kind], SHOWN)) for kind in (~jumped, jumped) if kind.any()]
        most = FAR * max(circles) if circles else math.inf
        return 1.06 * max(min(max(far), most), *circles, 1e-3)
    if not (math.isfinite(reach) and reach > 0.0):
        raise ValueError(f"reach must be a positive length in m; got {reach!r}.")
    return reach

"""Charts of one fix: terrain section under its line of sight, and its error cloud with the accuracy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.models import BoxZoomTool, HoverTool, PanTool, Range1d, ResetTool, WheelZoomTool
from bokeh.plotting import figure

from jaxgeo.plot import words
from jaxgeo.plot.sightline import Section
from jaxgeo.plot.style import BLUE, EARTH, INK, JUMPED, MUTED, SHADE, SIGHT, SKY, VERMILLION
from jaxgeo.report.details import Detail
from jaxgeo.report.map import draw_region, dress
from jaxgeo.report.places import rings_of, samples_of
from jaxgeo.uncertainty import Accuracy

MOST_POINTS = 900  # per section, enough for a screen
MOST_DOTS = 3000
CASING = "#fefefe"  # around lines over the ground: white, and as dark as the page on a dark one
SHOWN = 0.99  # share of the samples
FAR = 8.0  # times the largest circle: limit of the initial extent


def section_chart(section: Section, name: str, above: str = "above WGS 84") -> Any:
    """Chart of the line of sight over its terrain section, with its intersections; `above` is what heights are."""
    keep = _thinned(section)
    unit, scale = ("km", 1e-3) if section.distance[-1] >= 3000.0 else ("m", 1.0)
    km, sight, ground = scale * section.distance[keep], section.sight[keep], section.ground[keep]
    known = np.isfinite(ground)
    low = float(np.nanmin(ground)) if known.any() else float(sight.min())
    high = float(max(np.nanmax(ground) if known.any() else low, sight.max()))
    room = max(high - low, 1.0)
    bottom = low - 0.12 * room
    x_range, y_range = Range1d(start=0.0, end=float(km[-1])), Range1d(start=bottom, end=high + 0.08 * room)
    chart = _empty(name, f"distance on the ellipsoid, {unit}", f"height {above}, m", x_range, y_range)
    for first, last in _runs(known):
        part = slice(first, last + 1)
        chart.varea(km[part], bottom, ground[part], fill_color=EARTH)
        chart.line(km[part], ground[part], line_color=INK, line_width=1.0)
    for first, last in _runs(section.void[keep]):
        style: dict[str, Any] = {"fill_color": SHADE, "hatch_pattern": "/", "hatch_color": MUTED, "hatch_alpha": 0.5}
        chart.quad(km[max(first - 1, 0)], km[min(last + 1, len(km) - 1)], high + room, bottom, line_color=None, **style)
    end = scale * float(section.hits[0, 0]) if len(section.hits) else float(km[-1])
    before, behind = km <= end, km >= end
    at = float(np.interp(end, km, sight))
    chart.line(np.append(km[before], end), np.append(sight[before], at), line_color=SIGHT, line_width=2.2)
    if behind.any() and len(section.hits):
        x, y = np.insert(km[behind], 0, end), np.insert(sight[behind], 0, at)
        chart.line(x, y, line_color=CASING, line_width=4.0, line_alpha=0.7)
        chart.line(x, y, line_color=SIGHT, line_width=1.6, line_dash="dashed")
    _add_tips(chart, km, sight, ground, unit)
    _hits(chart, section, scale)
    chart.scatter([0.0], [float(section.sight[0])], marker="triangle", size=13, fill_color=SIGHT, line_color="#ffffff")
    return chart


def _thinned(section: Section) -> np.ndarray:
    """Indices of the samples shown: evenly spaced, plus those around the hits."""
    count = len(section.distance)
    even = np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int)
    near = [np.searchsorted(section.distance, hit) + np.arange(-20, 21) for hit in section.hits[:, 0]]
    return np.unique(np.clip(np.concatenate([even, *near]), 0, count - 1))


def _add_tips(chart: Any, along: np.ndarray, sight: np.ndarray, ground: np.ndarray, unit: str) -> None:
    """Add tooltips at the nearest sample."""
    source = {
        "x": along,
        "y": sight,
        "distance": [f"{value:.{3 if unit == 'km' else 1}f} {unit}" for value in along],
        "sight": [f"{words.metres(float(value), 1)} m" for value in sight],
        "ground": ["unknown" if np.isnan(value) else f"{words.metres(float(value), 1)} m" for value in ground],
        "clear": [
            "" if np.isnan(g) else f"{words.metres(float(s - g), 1)} m" for s, g in zip(sight, ground, strict=True)
        ],
    }
    glyph = chart.scatter("x", "y", size=6, fill_alpha=0.0, line_alpha=0.0, source=source)
    tip = [("distance", "@distance"), ("line of sight", "@sight"), ("ground", "@ground"), ("above ground", "@clear")]
    chart.add_tools(HoverTool(renderers=[glyph], tooltips=tip, mode="vline", limit=1, visible=False))


def _hits(chart: Any, section: Section, scale: float) -> None:
    if not len(section.hits):
        return
    x, y = scale * section.hits[:, 0], section.hits[:, 1]
    chart.scatter(x[:1], y[:1], size=12, fill_color=VERMILLION, line_color="#ffffff", line_width=1.5)
    if len(x) > 1:
        chart.scatter(x[1:], y[1:], size=9, fill_color="#ffffff", line_color=VERMILLION, line_width=2)


def cloud_chart(detail: Detail, name: str, probability: float = 0.9) -> Any:
    """Chart of the sampled errors of a fix, m east and north, with their highest-density region, the ellipse where it
    is valid, and the circle; None without samples.
    """
    points, jumped = samples_of(detail, MOST_DOTS)
    if detail.checked is None or not len(points):
        return None
    answer = detail.checked.accuracy
    radius = float(answer.circular)
    circles = [radius] if math.isfinite(radius) else []
    away = np.abs(points[:, :2]).max(axis=1)
    reach = max([float(np.quantile(away[kind], SHOWN)) for kind in (~jumped, jumped) if kind.any()])
    regions = [] if detail.region is None else [float(np.abs(detail.region.polygon_enu.bounds).max())]
    half = 1.06 * max(min(reach, FAR * max(circles, default=math.inf)), *circles, *regions, 1e-3)
    chart = _empty(name, "east, m", "north, m", Range1d(start=-half, end=half), Range1d(start=-half, end=half))
    dots = [_dots(chart, points[~jumped], SKY)]
    if jumped.any():
        dots.append(_dots(chart, points[jumped], JUMPED))
    tip = [("east", "@x{0.00} m"), ("north", "@y{0.00} m"), ("up", "@up{0.00} m"), ("horizontal", "@off{0.00} m")]
    chart.add_tools(HoverTool(renderers=dots, tooltips=tip, point_policy="snap_to_data", limit=1, visible=False))
    _region(chart, detail, probability)
    lines = _curves(chart, answer, probability, radius)
    chart.add_tools(HoverTool(renderers=lines, tooltips=[("", "@what")], line_policy="interp", visible=False))
    chart.scatter([0.0], [0.0], marker="cross", size=16, line_color=INK, line_width=2)
    return chart


def _dots(chart: Any, points: np.ndarray, colour: str) -> Any:
    off = np.hypot(points[:, 0], points[:, 1])
    source = {"x": points[:, 0], "y": points[:, 1], "up": points[:, 2], "off": off}
    return chart.scatter("x", "y", source=source, size=3.5, fill_color=colour, line_color=None, fill_alpha=0.6)


def _region(chart: Any, detail: Detail, probability: float) -> None:
    """Draw the region of the samples, piece by piece."""
    if detail.region is None:
        return
    lines = draw_region(chart, [(*rings_of(mode.polygon_enu), mode.words) for mode in detail.region.modes])
    tip = [("", f"{words.percent_name(probability)} % region of samples"), ("", "@what")]
    chart.add_tools(HoverTool(renderers=[lines], tooltips=tip, visible=False))


def _curves(chart: Any, answer: Accuracy, probability: float, radius: float) -> list[Any]:
    """Draw the ellipse of linear propagation, where it is valid, and the circle of `radius` in m."""
    percent = words.percent_name(probability)
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    ring = np.stack([np.cos(turn), np.sin(turn)])
    curves = []
    cov = np.asarray(answer.cov_enu)[:2, :2]
    if np.isfinite(cov).all():
        values, vectors = np.linalg.eigh(cov)
        root = vectors * np.sqrt(np.maximum(values, 0.0)) * math.sqrt(-2.0 * math.log1p(-probability))
        mean = np.asarray(answer.bias_enu)[:2, None]
        curves.append((f"covariance ellipse, {percent} %", mean + root @ ring, "solid"))
    if math.isfinite(radius):
        curves.append((f"CE{percent} {words.length(radius)}", radius * ring, "dashed"))
    lines = []
    for what, (x, y), dash in curves:
        source = {"x": x, "y": y, "what": [what] * len(x)}
        lines.append(chart.line("x", "y", source=source, line_color=BLUE, line_width=2.2, line_dash=dash))
    return lines


def _empty(name: str, x_label: str, y_label: str, x_range: Range1d, y_range: Range1d) -> Any:
    chart: Any = figure(
        name=name,
        tools=[PanTool(), WheelZoomTool(), BoxZoomTool(), ResetTool()],
        active_scroll=None,
        active_drag=None,
        sizing_mode="stretch_both",
        toolbar_location="above",
        x_axis_label=x_label,
        y_axis_label=y_label,
        x_range=x_range,
        y_range=y_range,
        min_height=160,
    )
    dress(chart)
    for grid in chart.grid:
        grid.grid_line_color = "#e4e4e4"
        grid.grid_line_alpha = 1.0
    return chart


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of true flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))

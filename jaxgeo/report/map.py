"""Interactive map of a report: relief, footprints, lines of sight, samples, ellipses, cameras and fixes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import BoxZoomTool, ColumnDataSource, HoverTool, PanTool, Range1d, ResetTool, ScaleBar, WheelZoomTool
from bokeh.models.annotations.dimensional import ImperialLength
from bokeh.plotting import figure

from jaxgeo.plot import words
from jaxgeo.plot.relief import Box, Relief, metres_per_degree
from jaxgeo.plot.style import BLUE, HAIR, INK, JUMPED, MUTED, PURPLE, REGION, SHADE, SIGHT, SKY, VERMILLION
from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail
from jaxgeo.report.places import Places, cloud_of, ellipse_of, rings_of, unwrapped

Row = Mapping[str, Any]
MOST_ELLIPSES = 600
REGION_FILL = 0.22  # opacity of regions
FIX_TIP = [
    ("", "@name"),
    ("latitude", "@lat"),
    ("longitude", "@lon"),
    ("height", "@height"),
    ("accuracy", "@sure"),
    ("range", "@range"),
    ("status", "@status"),
]


def map_of(
    subject: ReportData, details: Sequence[Detail], rows: Sequence[Row], places: Places, reliefs: Sequence[Relief]
) -> Any:
    """The map, longitude and latitude in deg, with named layers."""
    chart = _empty(places.box)
    for relief in reliefs:
        box = relief.box
        size: dict[str, Any] = {"w": box.east - box.west, "h": box.north - box.south}
        chart.image_url(
            url=[relief.url], x=box.west, y=box.north, anchor="top_left", name="relief", level="image", **size
        )
    _outlines(chart, details, places)
    _sights(chart, subject, places)
    _clouds(chart, subject, details)
    _regions(chart, details, places)
    _ellipses(chart, subject, details, places)
    _cameras(chart, subject, places)
    _fixes(chart, subject, rows, places)
    return chart


def _empty(box: Box) -> Any:
    ranges: dict[str, Any] = {
        "x_range": Range1d(start=box.west, end=box.east),
        "y_range": Range1d(start=box.south, end=box.north),
    }
    wheel = WheelZoomTool()
    chart: Any = figure(
        name="map",
        tools=[PanTool(), wheel, BoxZoomTool(match_aspect=True), ResetTool()],
        active_scroll=wheel,
        sizing_mode="stretch_both",
        toolbar_location="above",
        background_fill_color=SHADE,
        output_backend="canvas",
        x_axis_label="longitude, deg",
        y_axis_label="latitude, deg",
        min_height=200,
        **ranges,
    )
    dress(chart)
    east, _ = metres_per_degree(box.centre[1])
    scale = ImperialLength(  # its basis can be set; CustomDimensional is not available in pages
        basis={"m": (1.0, "m", "metre"), "km": (1000.0, "km", "kilometre"), "deg": (east, "deg", "degree")},
        ticks=[1, 2, 5, 10, 20, 50, 100, 200, 500],
    )
    bar = ScaleBar(
        range=chart.x_range,
        unit="deg",
        dimensional=scale,
        orientation="horizontal",
        location="bottom_left",
        bar_length=0.12,
        bar_line_width=3,
        background_fill_alpha=0.75,
        border_line_color=None,
        label="@{value} @{unit}",
    )
    chart.add_layout(bar)
    return chart


def dress(chart: Any) -> None:
    """Apply the common chart style."""
    chart.toolbar.logo = None
    chart.outline_line_color = HAIR
    for axis in chart.axis:
        axis.axis_line_color = MUTED
        axis.major_tick_line_color = MUTED
        axis.minor_tick_line_color = None
        axis.major_label_text_color = INK
        axis.axis_label_text_color = INK
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "13px"
        axis.major_label_text_font_size = "12px"
        axis.formatter.use_scientific = False
        axis.ticker.desired_num_ticks = 5
    for axis in chart.xaxis:
        axis.ticker.desired_num_ticks = 3  # long degree labels must fit on a phone
    for grid in chart.grid:
        grid.grid_line_color = "#ffffff"
        grid.grid_line_alpha = 0.5


def _outlines(chart: Any, details: Sequence[Detail], places: Places) -> None:
    unique = {detail.outline.tobytes(): detail.outline for detail in details}
    rings = [np.column_stack([unwrapped(one[:, 0], places.box.centre[0]), one[:, 1]]) for one in unique.values()]
    rings = [ring for ring in rings if np.isfinite(ring).all(axis=1).any()]
    if rings:
        xs, ys = [ring[:, 0] for ring in rings], [ring[:, 1] for ring in rings]
        chart.multi_line(xs, ys, line_color="#ffffff", line_width=4.0, line_alpha=0.7, name="outline")
        chart.multi_line(xs, ys, line_color=INK, line_width=1.6, name="outline")


def _sights(chart: Any, subject: ReportData, places: Places) -> None:
    if len(places.index):
        ends = {"x0": places.camera[:, 0], "y0": places.camera[:, 1], "x1": places.fix[:, 0], "y1": places.fix[:, 1]}
        is_few = len(places.index) <= 20
        style: dict[str, Any] = {"line_color": SIGHT, "line_width": 1.6 if is_few else 0.7}
        chart.segment(**ends, line_alpha=0.85 if is_few else 0.15, name="sight", **style)
    if not places.is_one_camera:
        chart.line(places.camera[:, 0], places.camera[:, 1], line_color=PURPLE, line_width=1.6, name="camera")


def _clouds(chart: Any, subject: ReportData, details: Sequence[Detail]) -> None:
    for detail in details:
        cloud, jumped = cloud_of(subject, detail)
        for which, colour in ((~jumped, SKY), (jumped, JUMPED)):
            if which.any():
                style: dict[str, Any] = {"fill_color": colour, "line_color": None, "fill_alpha": 0.6, "size": 3.5}
                chart.scatter(cloud[which, 0], cloud[which, 1], name="samples", **style)


def _regions(chart: Any, details: Sequence[Detail], places: Places) -> None:
    """Draw the regions of the samples, piece by piece."""
    modes = [mode for detail in details if detail.region is not None for mode in detail.region.modes]
    rings = [(*rings_of(mode.polygon), mode.words) for mode in modes]
    if rings:
        middle = places.box.centre[0]  # no tip: the fix lies within, and has one
        draw_region(chart, [([unwrapped(x, middle) for x in xs], ys, text) for xs, ys, text in rings])


def draw_region(chart: Any, pieces: Sequence[tuple[list[np.ndarray], list[np.ndarray], str]]) -> Any:
    """Draw pieces of regions of samples, (x and y of their rings, words); returns the outlines, with `what` of each."""
    chart.multi_polygons(
        [[xs] for xs, _, _ in pieces],
        [[ys] for _, ys, _ in pieces],
        line_color=None,
        fill_color=REGION,
        fill_alpha=REGION_FILL,
        name="region",
    )
    source = {
        "xs": [x for xs, _, _ in pieces for x in xs],
        "ys": [y for _, ys, _ in pieces for y in ys],
        "what": [text for xs, _, text in pieces for _ in xs],
    }
    style: dict[str, Any] = {"line_color": REGION, "line_width": 1.8, "name": "region"}
    return chart.multi_line("xs", "ys", source=ColumnDataSource(source), **style)


def _ellipses(chart: Any, subject: ReportData, details: Sequence[Detail], places: Places) -> None:
    by_index = {detail.index: detail for detail in details}
    shown = places.index if len(places.index) <= MOST_ELLIPSES else np.array(sorted(by_index), int)
    found = [(int(i), ellipse_of(subject, int(i), by_index.get(int(i)))) for i in shown]
    with_region = {index for index, detail in by_index.items() if detail.region is not None}
    ellipses = [(i, one) for i, one in found if one is not None and (one.is_linear or i not in with_region)]
    if not ellipses:
        return
    source = {
        "xs": [unwrapped(one.ring[:, 0], places.box.centre[0]) for _, one in ellipses],
        "ys": [one.ring[:, 1] for _, one in ellipses],
        "name": [subject.name(index) for index, _ in ellipses],
        "what": [one.what for _, one in ellipses],
        "axes": [f"{words.length(one.major)} by {words.length(one.minor)}" for _, one in ellipses],
        "azimuth": [words.number(one.azimuth_deg, 0) + "°" if one.major > one.minor else "–" for _, one in ellipses],
    }
    style: dict[str, Any] = {"source": ColumnDataSource(source), "name": "ellipse"}
    chart.patches("xs", "ys", line_color=None, fill_color=VERMILLION, fill_alpha=0.08, **style)
    glyph = chart.multi_line("xs", "ys", line_color=VERMILLION, line_width=2.0, **style)
    tip = [("", "@name"), ("", "@what"), ("semi-axes", "@axes"), ("azimuth of major axis", "@azimuth")]
    chart.add_tools(HoverTool(renderers=[glyph], tooltips=tip, name="tip of ellipses", visible=False))


def _cameras(chart: Any, subject: ReportData, places: Places) -> None:
    camera = places.camera[:1] if places.is_one_camera else places.camera
    heading = np.rad2deg(np.broadcast_to(np.asarray(subject.shots.pose.heading), (len(subject),)))
    height = np.broadcast_to(np.asarray(subject.shots.pose.position.height), (len(subject),))
    index = places.index if len(places.index) else np.arange(len(places.camera))
    index = index[:1] if places.is_one_camera else index
    source = {
        "x": camera[:, 0],
        "y": camera[:, 1],
        "name": [f"camera{'' if places.is_one_camera else f' of {subject.name(int(i))}'}" for i in index],
        "height": [f"{words.metres(float(height[i]), 1)} m {subject.above_in_short}" for i in index],
        "heading": [f"{words.number(float(heading[i]) % 360.0, 1)}°" for i in index],
        "lat": [words.coordinate(float(y), "N", "S") for y in camera[:, 1]],
        "lon": [words.coordinate(float((x + 180.0) % 360.0 - 180.0), "E", "W") for x in camera[:, 0]],
        "angle": -np.deg2rad(heading[index]),
    }
    size = 15 if len(index) == 1 else 6
    glyph = chart.scatter(
        "x",
        "y",
        angle="angle",
        marker="triangle",
        size=size,
        fill_color=SIGHT,
        line_color="#ffffff",
        source=source,
        name="camera",
    )
    tip = [("", "@name"), ("latitude", "@lat"), ("longitude", "@lon"), ("height", "@height"), ("heading", "@heading")]
    chart.add_tools(HoverTool(renderers=[glyph], tooltips=tip, name="tip of cameras", visible=False))


def _fixes(chart: Any, subject: ReportData, rows: Sequence[Row], places: Places) -> None:
    if not len(places.index):
        return
    percent = words.percent_name(subject.probability)
    shown = [rows[i] for i in places.index]
    is_fix = subject.is_fix[places.index]
    source = {
        "x": places.fix[:, 0],
        "y": places.fix[:, 1],
        "name": [subject.name(int(i)) for i in places.index],
        "lat": [words.coordinate(row["fix_lat_deg"], "N", "S") for row in shown],
        "lon": [words.coordinate(row["fix_lon_deg"], "E", "W") for row in shown],
        "height": [f"{words.metres(row[subject.height_column])} m {subject.above_in_short}" for row in shown],
        "sure": [_sure(subject, int(i), percent) for i in places.index],
        "range": [words.length(row["slant_range_m"]) for row in shown],
        "status": [row["status"].replace("_", " ") for row in shown],
        "fill": [VERMILLION if ok else "#ffffff" for ok in is_fix],
    }
    size = 11 if len(shown) <= 20 else 7
    glyph = chart.scatter(
        "x",
        "y",
        size=size,
        fill_color="fill",
        line_color="#ffffff" if is_fix.all() else BLUE,
        line_width=1.5 if len(shown) <= 20 else 0.6,
        source=source,
        name="fix",
    )
    chart.add_tools(HoverTool(renderers=[glyph], tooltips=FIX_TIP, name="tip of fixes", visible=False))


def _sure(subject: ReportData, index: int, percent: str) -> str:
    if subject.accuracy is None or not subject.is_fix[index]:
        return "unknown"
    radii = (float(np.asarray(x)[index]) for x in (subject.accuracy.circular, subject.accuracy.linear))
    circular, linear = (words.length(radius) for radius in radii)
    return f"CE{percent} {circular}, LE{percent} {linear}"

"""The report page: one self-contained HTML text with styles, scripts and images."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jinja2
import numpy as np
from bokeh.document import Document
from bokeh.embed.util import standalone_docs_json_and_render_items
from bokeh.resources import Resources
from markupsafe import Markup

from jaxgeo._destination import destination
from jaxgeo.coverage.exposure import image_size
from jaxgeo.io._fix_columns import figures_of, rows_of
from jaxgeo.io.registration_report import versions
from jaxgeo.plot import words
from jaxgeo.plot.relief import Box, Heights, Relief, heights_of, metres_per_degree, relief_of
from jaxgeo.plot.style import INK, JUMPED, PURPLE, REGION, SIGHT, SKY, VERMILLION
from jaxgeo.report.answers import answer_of, camera_of, summary_of
from jaxgeo.report.budgets import budget_of
from jaxgeo.report.charts import cloud_chart, section_chart
from jaxgeo.report.chips import MOST, chip_of
from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail, details_of
from jaxgeo.report.map import map_of
from jaxgeo.report.places import Places, ellipse_of, places_of
from jaxgeo.report.table import table_of
from jaxgeo.terrain import Dem

CLOSE = 6.0  # half side of the close-up of a fix, times the major semi-axis
NAMED = {"height_datum": "camera datum", "vertical_datum": "DEM datum", "level": "ground, m"}  # inputs, as options
ROOM = 2.5  # half side of the close-up, at least, times the reach of the region of samples
LEAST_CLOSE = 60.0  # m, least half side of the close-up
CLOSE_ACROSS = 600  # pixels of the close-up image
LAYERS = (  # key, label, (swatch kind, colour)
    ("relief", "relief", ("area", "#c5b48f")),
    ("outline", "image footprint", ("line", INK)),
    ("sight", "line of sight", ("line", SIGHT)),
    ("camera", "camera", ("dot", SIGHT)),
    ("samples", "samples", ("dots", SKY)),
    ("region", "region of samples", ("area", REGION)),
    ("ellipse", "error ellipse (linear), or circle of samples", ("ring", VERMILLION)),
    ("fix", "fix", ("dot", VERMILLION)),
)


@dataclass(frozen=True)
class ReportHeader:
    """Title, inputs and assumptions shown on a page.

    `made` is the creation time; now by default. `notice` is a sentence shown above the results.
    """

    title: str = "Ground coordinates and accuracy"
    inputs: Mapping[str, Any] = field(default_factory=dict)
    assumed: Sequence[str] = ()
    made: datetime.datetime | None = None
    notice: str = ""


def write_report(
    path: str | os.PathLike[str],
    subject: ReportData,
    *,
    header: ReportHeader | None = None,
    details: Sequence[Detail] | None = None,
    most: int = 3,
    images: Mapping[int, str | os.PathLike[str]] | None = None,
) -> None:
    """Write a report to a file atomically; arguments as for `report_html`.

    Raises `ValueError` for a path that cannot be written to.
    """
    with destination("path", pathlib.Path(path)) as stream:
        stream.write(report_html(subject, header=header, details=details, most=most, images=images))


def report_html(
    subject: ReportData,
    *,
    header: ReportHeader | None = None,
    details: Sequence[Detail] | None = None,
    most: int = 3,
    images: Mapping[int, str | os.PathLike[str]] | None = None,
) -> str:
    """Self-contained HTML page of a report; needs no network.

    `details` are the details of selected pixels, by default `details_of(subject, most=most)`. `images` are image files
    by pixel: of the first pixels in detail, a part of the image is shown beside the map, as far as it can be read.
    """
    header = ReportHeader() if header is None else header
    details = details_of(subject, most=most) if details is None else details
    rows = rows_of(
        subject.fixes,
        figures_of("report", subject.fixes, subject.accuracy, None, None, None),
        is_above_takeoff=subject.is_above_takeoff,
    )
    places = places_of(subject, details)
    reliefs, heights = _ground(subject, details, places)
    charts: dict[str, Any] = {"map": map_of(subject, details, rows, places, reliefs)}
    shown = [_shown(subject, number, detail, rows, charts) for number, detail in enumerate(details)]
    return (
        environment()
        .get_template("page.html")
        .render(
            header=header,
            made=created(header),
            version=versions().get("jaxgeo", "not installed"),
            percent=words.percent_name(subject.probability),
            summary=summary_of(subject, rows) if len(subject) > len(details) or not details else None,
            shown=shown,
            chips=_chips(subject, details, images or {}),
            layers=[layer for layer in LAYERS if _is_there(charts["map"], layer[0])],
            has_jumped=any(one["has_jumped"] for one in shown),
            jumped_colour=JUMPED,
            region_colour=REGION,
            track_colour=None if places.is_one_camera else PURPLE,
            zooms=_zooms(subject, details, places),
            has_ground=isinstance(subject.terrain, Dem),
            has_heights=bool(heights),
            table=table_of(subject, rows),
            camera=camera_of(subject, details[0].index if details else 0),
            inputs=plain_inputs(header.inputs),
            versions=versions() | {"bokeh": importlib.metadata.version("bokeh")},
            numbers=_script_data(_for_script(charts, places, heights, subject, details)),
            library=Markup(_library()),
        )
    )


def _ground(subject: ReportData, details: Sequence[Detail], places: Places) -> tuple[list[Relief], list[Heights]]:
    """Relief images and height grids of the whole area and around the fixes shown in detail."""
    dem = subject.terrain
    if not isinstance(dem, Dem):
        return [], []
    box = places.box.squared().grown(0.12)
    whole = relief_of(dem, box)
    if whole is None:
        return [], []
    reliefs, heights = [whole], [heights_of(dem, box)]
    for detail in details:
        near = close_to(subject, detail)
        if near is not None and near.sides[0] < 0.4 * box.sides[0]:
            one = relief_of(dem, near, across=CLOSE_ACROSS, between=whole.between)
            reliefs += [] if one is None else [one]
            heights.append(heights_of(dem, near))
    return reliefs, heights


def close_to(subject: ReportData, detail: Detail) -> Box | None:
    """Box around a fix, somewhat larger than its error ellipse and its region of samples; None without a fix."""
    if not subject.has_place[detail.index]:
        return None
    position = subject.fix(detail.index).position
    lon, lat = np.rad2deg(float(position.lon)), np.rad2deg(float(position.lat))
    ring = ellipse_of(subject, detail.index, detail)
    reach = 0.0 if detail.region is None else ROOM * float(np.abs(detail.region.polygon_enu.bounds).max())
    half = max(LEAST_CLOSE, CLOSE * (0.0 if ring is None else ring.major), reach)
    east, north = metres_per_degree(lat)
    return Box(lon - half / east, lat - half / north, lon + half / east, lat + half / north)


def _shown(
    subject: ReportData, number: int, detail: Detail, rows: Sequence[Mapping[str, Any]], charts: dict[str, Any]
) -> dict[str, Any]:
    """Template data of one pixel; its charts are added to `charts`."""
    is_dull = not isinstance(subject.terrain, Dem) and len(subject) > 1  # the same section for every line of sight
    section = None
    if detail.section is not None and not is_dull:
        section = section_chart(detail.section, f"section-{number}", subject.above_in_short)
    cloud = cloud_chart(detail, f"cloud-{number}", subject.probability)
    charts |= {f"section-{number}": section} if section is not None else {}
    charts |= {f"cloud-{number}": cloud} if cloud is not None else {}
    return {
        "number": number,
        "name": subject.name(detail.index),
        "chosen": detail.chosen,
        "answer": answer_of(subject, detail, rows[detail.index]),
        "section": detail.section,
        "has_section": section is not None,
        "has_cloud": cloud is not None,
        "has_region": detail.region is not None,
        "has_ellipse": subject.has_ellipse(detail.index),
        "has_jumped": detail.checked is not None and detail.checked.jumped > 0.0,
        "budget": None if detail.budget is None else budget_of(detail.budget),
        "unsure": detail.unsure,
    }


def _chips(
    subject: ReportData, details: Sequence[Detail], images: Mapping[int, str | os.PathLike[str]]
) -> list[dict[str, Any]]:
    """Template data of the parts of images around pixels in detail."""
    found: list[dict[str, Any]] = []
    for number, detail in enumerate(details):
        if detail.index not in images or len(found) == MOST:
            continue
        sensor, _, uv, _, _ = subject.look(detail.index)
        width, height = image_size(sensor)
        u, v = (float(x) for x in np.asarray(uv, np.float64))
        chip = chip_of(images[detail.index], (width, height), (u, v))
        if chip is not None:
            name = f"Fix {number + 1}: {subject.name(detail.index)}" if len(details) > 1 else subject.name(detail.index)
            found.append({"chip": chip, "name": name, "pixel": f"{u:.10g}, {v:.10g}"})
    return found


def _is_there(chart: Any, layer: str) -> bool:
    return any(getattr(one, "name", None) == layer for one in chart.renderers)


def _zooms(subject: ReportData, details: Sequence[Detail], places: Places) -> list[dict[str, Any]]:
    """Zoom targets of the map."""
    zooms = [{"label": "All", "box": list(places.box)}]
    outlines = [d.outline[np.isfinite(d.outline).all(axis=1)] for d in details]
    ground = np.concatenate([*outlines, places.fix[np.isfinite(places.fix).all(axis=1)]])
    if len(ground):
        lon = places.box.centre[0] + np.remainder(ground[:, 0] - places.box.centre[0] + 180.0, 360.0) - 180.0
        box = Box(float(lon.min()), float(ground[:, 1].min()), float(lon.max()), float(ground[:, 1].max()))
        zooms.append({"label": "Footprint", "box": list(box.grown(0.08, LEAST_CLOSE))})
    for number, detail in enumerate(details):
        near = close_to(subject, detail)
        if near is not None:
            inside = near.grown(-0.27)
            name = "Fix" if len(details) == 1 else f"Fix {number + 1}"
            zooms.append({"label": name, "box": list(inside)})
    return zooms


def _for_script(
    charts: Mapping[str, Any],
    places: Places,
    heights: Sequence[Heights],
    subject: ReportData,
    details: Sequence[Detail],
) -> dict[str, Any]:
    """Data of the page script: charts and their elements, aspect ratios, heights, and fix positions."""
    document = Document()
    for chart in charts.values():
        document.add_root(chart)
    docs, _ = standalone_docs_json_and_render_items([document], suppress_callback_warning=True)
    roots = {chart.id: f"chart-{name}" for name, chart in charts.items()}
    docid = next(iter(docs))
    east, north = metres_per_degree(places.box.centre[1])
    equal = {name: 1.0 for name in charts if name.startswith("cloud")} | {"map": east / north}
    position = subject.fixes.position
    fixes = [
        {
            "name": f"fix {number + 1}" if len(details) > 1 else "the fix",
            "lonlat": [float(np.rad2deg(np.asarray(x)[d.index])) for x in (position.lon, position.lat)],
        }
        for number, d in enumerate(details)
        if subject.has_place[d.index]
    ]
    return {
        "docs": docs,
        "items": [{"docid": docid, "roots": roots, "root_ids": list(roots)}],
        "equal": equal,
        "metres": [east, north],
        "zooms": _zooms(subject, details, places),
        "heights": [one.to_dict() for one in heights],
        "fixes": fixes,
    }


def _script_data(content: Any) -> Markup:
    """JSON escaped for an HTML script element."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=True)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _library() -> str:
    """The bokeh script."""
    (script, *_) = Resources(mode="inline", components=["bokeh"]).js_raw
    return script.replace("</script", "<\\/script")


def environment() -> jinja2.Environment:
    """Templates of the pages."""
    loader = jinja2.PackageLoader("jaxgeo.report", "templates")
    return jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)


def created(header: ReportHeader) -> str:
    """Creation time of a page as text."""
    made = datetime.datetime.now(datetime.UTC) if header.made is None else header.made
    return made.astimezone(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def plain_inputs(inputs: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names and values as text."""
    return [(NAMED.get(name, str(name).replace("_", " ")), _in_words(value)) for name, value in inputs.items()]


def _in_words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{str(key).replace('_', ' ')} {_in_words(one)}" for key, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_in_words, value))
    return "yes" if value is True else "no" if value is False else str(value)

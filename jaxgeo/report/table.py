"""Template data of the sortable table of all pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxgeo.io._utc import utc_text
from jaxgeo.plot import words
from jaxgeo.report.data import ReportData
from jaxgeo.status import Status

MOST = 2000  # rows per page
OF_MSL = "; msl above mean sea level (EGM96)."
A_YEAR = 3.2e7  # s; later times are counted from 1970, earlier ones from the start of a file


def table_of(subject: ReportData, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Headers, the first `MOST` rows of cells with text and sort key, and the total count."""
    percent = words.percent_name(subject.probability)
    has_names = any(label.get("name") for label in subject.labels)
    has_times = any(label.get("time_s") is not None for label in subject.labels)
    is_sure = subject.accuracy is not None
    headers = [("name", "")] if has_names else []
    headers += [("time", "by the clock of the camera, or UTC where it ends with Z")] if has_times else []
    headers += [("column", ""), ("row", ""), ("latitude, deg", ""), ("longitude, deg", "")]
    headers += [("height, m", subject.above)]
    headers += [] if subject.is_above_takeoff else [("msl, m", "above mean sea level, EGM96")]
    headers += [(f"CE{percent}, m", "horizontal"), (f"LE{percent}, m", "vertical")] if is_sure else []
    headers += [("status", ""), ("range, m", "slant range"), ("incidence, deg", "at the surface")]
    headers += [("by", "method")] if is_sure else []
    ce, le = (f"{kind}{percent.replace('.', '_')}_m" for kind in ("ce", "le"))
    body = []
    for index, row in enumerate(rows[:MOST]):
        label = subject.labels[index] if subject.labels else {}
        u, v = (float(x) for x in subject.uv[index])
        cells = [_text(label.get("name"))] if has_names else []
        cells += [_time(label)] if has_times else []
        cells += [_pixel(u), _pixel(v)]
        cells += [_cell(row["fix_lat_deg"], 7), _cell(row["fix_lon_deg"], 7)]
        cells += [_cell(row[subject.height_column], 2)]
        cells += [] if subject.is_above_takeoff else [_cell(row["fix_height_msl_m"], 2)]
        cells += [_radius(row.get(ce)), _radius(row.get(le))] if is_sure else []
        status = Status[row["status"]]
        cells.append({"text": status.name.replace("_", " "), "key": int(status), "title": status.message, "kind": ""})
        cells += [_cell(row["slant_range_m"], 1), _cell(row["incidence_surface_deg"], 1)]
        cells += [_text(row.get("accuracy_method"))] if is_sure else []
        kind = "" if status == Status.hit else "doubtful" if row["slant_range_m"] is not None else "none"
        body.append({"cells": cells, "kind": kind})
    of_heights = f"Heights are {subject.above}" + ("." if subject.is_above_takeoff else OF_MSL)
    left_out = max(len(rows) - MOST, 0)
    return {"headers": headers, "rows": body, "count": len(rows), "left_out": left_out, "of_heights": of_heights}


def _text(value: Any) -> dict[str, Any]:
    text = "" if value is None else str(value)
    return {"text": text, "key": text, "title": "", "kind": "text"}


def _as_number(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except ValueError:
        return None


def _cell(value: float | None, places: int) -> dict[str, Any]:
    return {"text": words.number(value, places), "key": "" if value is None else value, "title": "", "kind": ""}


def _time(label: Mapping[str, Any]) -> dict[str, Any]:
    """The time of an exposure as ISO 8601 where it is a date, else in s."""
    seconds = _as_number(label.get("time_s"))
    text = utc_text(seconds) if seconds is not None and seconds > A_YEAR else None
    if text is None:
        return _cell(seconds, 3)
    own = str(label.get("time_utc") or text.removesuffix("Z"))
    return {"text": own.replace(".000", ""), "key": seconds, "title": f"{seconds:.3f} s from 1970", "kind": ""}


def _pixel(value: float) -> dict[str, Any]:
    return {"text": f"{value:g}", "key": value, "title": "", "kind": ""}


def _radius(value: float | None) -> dict[str, Any]:
    return {"text": words.radius(value), "key": "" if value is None else value, "title": "", "kind": ""}

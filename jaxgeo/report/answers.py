"""Template data of fixes: coordinates, accuracy, method and its reason, the samples that check it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo.coverage.exposure import image_size
from jaxgeo.io._mgrs import mgrs_of
from jaxgeo.plot import words
from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail
from jaxgeo.status import Status
from jaxgeo.uncertainty import NO_FIX, Method

Row = Mapping[str, Any]
VERDICTS = {
    Method.facet: "Linear propagation is valid here.",
    Method.footprint: "Linear propagation is valid with the mean slope over the error footprint, not that at the fix.",
    Method.samples: "Linear propagation is not valid here; the figures are from Monte Carlo samples.",
}


def answer_of(subject: ReportData, detail: Detail, row: Row) -> dict[str, Any]:
    """Coordinates and accuracy of one pixel; without a fix, the reason."""
    index = detail.index
    word, sentence = words.status(np.asarray(subject.fixes.status)[index])
    found = bool(subject.has_place[index])
    answer: dict[str, Any] = {"found": found, "is_fix": bool(subject.is_fix[index]), "status": row["status"]}
    answer |= {"word": word, "sentence": sentence, "figures": [], "facts": []}
    if not found:
        return answer
    lat, lon = row["fix_lat_deg"], row["fix_lon_deg"]
    answer["lat"], answer["lon"] = words.coordinate(lat, "N", "S"), words.coordinate(lon, "E", "W")
    answer["sexagesimal"] = f"{words.sexagesimal(lat, 'N', 'S')}, {words.sexagesimal(lon, 'E', 'W')}"
    answer["mgrs"] = _mgrs(lat, lon)
    answer["height"] = words.metres(row[subject.height_column])
    answer["above"] = subject.above
    answer["msl"] = None if subject.is_above_takeoff else words.metres(row["fix_height_msl_m"])
    answer["facts"] = [
        ("slant range", words.length(row["slant_range_m"])),
        ("incidence", f"{words.number(row['incidence_surface_deg'])}°"),
        ("ground slope", f"{words.number(row['slope_deg'])}°"),
    ]
    return answer | _sure(subject, detail, row)


def _sure(subject: ReportData, detail: Detail, row: Row) -> dict[str, Any]:
    """Accuracy of a fix, its method and reason, and what samples say of it."""
    if subject.accuracy is None or not subject.is_fix[detail.index]:
        return {"verdict": "", "because": detail.unsure, "agreed": "", "region": "", "drawn": ""}
    one, index = subject.accuracy, detail.index
    percent = words.percent_name(subject.probability)
    radii = (
        ("CE", one.circular, "horizontal"),
        ("LE", one.linear, "vertical"),
        ("SE", one.spherical, "3-D"),
    )
    figures = [(f"{kind}{percent}", words.length(float(np.asarray(x)[index])), what) for kind, x, what in radii]
    method = Method(int(np.asarray(one.method)[index]))
    agreed = "" if detail.checked is None else detail.checked.words
    said = {"figures": figures, "method": method.words, "verdict": VERDICTS[method], "because": row["accuracy_text"]}
    return said | {"agreed": agreed, **_region(detail, method)}


def _region(detail: Detail, method: Method) -> dict[str, str]:
    """The region of the samples in words, and which areas are drawn."""
    if detail.region is None:
        return {"region": detail.no_region, "drawn": ""}
    if method == Method.samples:
        return {"region": detail.region.words, "drawn": "The map shows this region; an ellipse would be wrong."}
    drawn = "The map shows the ellipse of linear propagation, and this region of the samples that check it."
    return {"region": detail.region.words, "drawn": drawn}


def _mgrs(lat: float, lon: float) -> str | None:
    """MGRS coordinates to 1 m; None without the library or outside the grid."""
    try:
        (square,) = mgrs_of(np.array([lat]), np.array([lon]))
    except ImportError:
        return None
    if square is None or len(square) < 13:
        return square
    return f"{square[:-12]} {square[-12:-10]} {square[-10:-5]} {square[-5:]}"


def summary_of(subject: ReportData, rows: Sequence[Row]) -> dict[str, Any]:
    """Summary of many pixels: number of fixes, status counts, accuracy, methods."""
    names = [row["status"] for row in rows]
    statuses = [
        (name.replace("_", " "), words.count(names.count(name)), Status[name].message)
        for name in sorted(set(names), key=lambda name: int(Status[name]))
    ]
    found = int(subject.is_fix.sum())
    figures: list[tuple[str, str, str]] = []
    if subject.accuracy is not None and found:
        percent = words.percent_name(subject.probability)
        for kind, values in (("CE", subject.accuracy.circular), ("LE", subject.accuracy.linear)):
            radii = np.asarray(values, np.float64)[subject.is_fix]
            low, middle, high = (
                float(np.quantile(np.nan_to_num(radii, nan=np.inf), q, method="nearest")) for q in (0, 0.5, 1)
            )
            between = f"median; {words.length(low)} to {words.length(high)}"
            figures.append((f"{kind}{percent}", words.length(middle), between))
        method = np.asarray(subject.accuracy.method)
        methods = [f"{words.count(int((method == m).sum()))} by {m.words}" for m in Method if (method == m).any()]
    else:
        methods = []
    return {
        "count": words.count(len(subject)),
        "found": words.count(found),
        "is_all": found == len(subject),
        "statuses": statuses,
        "figures": figures,
        "methods": methods,
        "unsure": subject.accuracy is None or not (np.asarray(subject.accuracy.method) != NO_FIX).any(),
    }


def camera_of(subject: ReportData, index: int) -> list[tuple[str, str]]:
    """Camera and pose of one pixel's exposure as (name, text) pairs."""
    sensor, shot, _, _, _ = subject.look(index)
    width, height = image_size(sensor)
    pose = shot.pose
    facts = [("image", f"{width} by {height} pixels")]
    if hasattr(sensor.camera, "focal_px"):
        focal = np.asarray(sensor.camera.focal_px, np.float64).reshape(-1)
        facts.append(("focal length", f"{focal[0]:.2f} pixels"))
    lat, lon = (float(np.rad2deg(float(x))) for x in (pose.position.lat, pose.position.lon))
    facts.append(("position", f"{words.coordinate(lat, 'N', 'S')}, {words.coordinate(lon, 'E', 'W')}"))
    facts.append(("height", f"{words.metres(float(pose.position.height))} m {subject.above}"))
    angles = ((name, float(np.rad2deg(float(getattr(pose, name))))) for name in ("heading", "pitch", "roll"))
    facts.append(("attitude", ", ".join(f"{name} {value:.3f}°" for name, value in angles)))
    readings = np.rad2deg(np.asarray(shot.gimbal_readings, np.float64).reshape(-1))
    if readings.size:
        shown = ", ".join(f"{name} {value:.3f}°" for name, value in zip(sensor.gimbal.names, readings, strict=True))
        facts.append(("gimbal", shown))
    return facts

"""Page of a mutual correction: residuals over the images, corrections with their sigmas, check points, map."""

from __future__ import annotations

import os
import pathlib
from typing import Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io.registration_report import versions
from jaxgeo.plot import words
from jaxgeo.report.correction_map import block_map
from jaxgeo.report.page import ReportHeader, created, environment, plain_inputs
from jaxgeo.report.residual_maps import camera_maps, image_maps
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.ties import Correction

MOST = 2000  # images in the table
TITLE = "Mutual correction of images"
AXES = ("east", "north", "up")


def write_correction_report(
    path: str | os.PathLike[str],
    found: Correction,
    terrain: AbstractTerrain | None = None,
    *,
    header: ReportHeader | None = None,
) -> None:
    """Write the page of a correction to a file atomically; arguments as for `correction_html`.

    Raises `ValueError` for a path that cannot be written to.
    """
    with destination("path", pathlib.Path(path)) as stream:
        stream.write(correction_html(found, terrain, header=header))


def correction_html(
    found: Correction, terrain: AbstractTerrain | None = None, *, header: ReportHeader | None = None
) -> str:
    """Self-contained HTML page of a correction; needs no network and no script to be read.

    Residual vectors over the image, all images of a camera together and of single images; a table of the images with
    their corrections and the standard deviations before and after; control and check points; what images alone do not
    show; and a map with footprints on the `terrain`, if it is given.
    """
    check_is(found, Correction, "found", "Make one with jaxgeo.ties.correct.")
    header = ReportHeader(TITLE) if header is None else header
    maps, left_out = image_maps(found)
    return (
        environment()
        .get_template("correction.html")
        .render(
            header=header,
            made=created(header),
            version=versions().get("jaxgeo", "not installed"),
            versions=versions(),
            inputs=plain_inputs(header.inputs),
            count=len(found.names),
            figures=_figures(found),
            sentences=found.words().splitlines(),
            map=block_map(found, terrain),
            cameras=camera_maps(found),
            images=maps,
            images_left_out=left_out,
            parameters=[_parameter(one) for one in found.adjustment.parameters],
            points=_points(found),
            table=_table(found),
        )
    )


def _figures(found: Correction) -> list[tuple[str, str, str]]:
    """(label, value, remark) of the main results."""
    points = len(found.adjustment.points)
    moved = float(np.sqrt(np.mean(np.sum(found.moved**2, axis=1))))
    turned = float(np.rad2deg(np.sqrt(np.mean(np.sum(found.turned**2, axis=1)))))
    east, north, up = found.sigma_of_mean
    figures = [
        ("residuals", f"{found.rms_after:.2f} px", f"{found.rms_before:.2f} px before (RMS per axis)"),
        ("points", words.count(points), f"{words.count(len(found.adjustment.block.observations))} measurements used"),
        ("left out", words.count(found.left_out), "measurements that do not fit"),
        ("moved", words.length(moved), "RMS of the positions"),
        ("turned", f"{turned:.3f}°", "RMS of the attitudes"),
        ("mean position", words.length(float(np.hypot(east, north))), f"sigma E and N; up {words.length(float(up))}"),
    ]
    residuals = found.control_residuals
    if residuals is not None and np.any(residuals.role == "check"):
        off, expected = residuals.rms_enu(), residuals.rms_sigma_enu()
        if np.all(np.isfinite(off)):
            remark = f"E and N, RMS; predicted {words.length(float(np.hypot(*expected[:2])))}"
            figures.append(("check points", words.length(float(np.hypot(*off[:2]))), remark))
            figures.append(
                ("check points, up", words.length(float(off[2])), f"RMS; predicted {words.length(float(expected[2]))}")
            )
    return figures


def _parameter(one: Any) -> tuple[str, str, str, str]:
    prior = f"{one.prior:.3g}" if np.isfinite(one.prior) else words.UNKNOWN
    whose = "navigation" if one.name == "time offset" else one.whose
    return f"{whose}: {one.name}", f"{one.value:.7g} {one.unit}", f"{one.sigma:.3g}", prior


def _points(found: Correction) -> dict[str, Any] | None:
    """Table of control and check points; None without any."""
    residuals = found.control_residuals
    if residuals is None:
        return None
    rows = []
    for k, name in enumerate(residuals.name.tolist()):
        own = residuals.point == name
        numbers = [*residuals.enu[k], *residuals.sigma_enu[k]]
        pixels = [_rms(residuals.px[own]), _rms(residuals.sigma_px[own])]
        role = str(residuals.role[k])
        cells = [_text(name), _text(role), _cell(float(residuals.images[k]), 0)]
        cells += [_cell(x, 3) for x in numbers] + [_cell(x, 2) for x in pixels]
        rows.append({"cells": cells, "kind": "none" if role == "left out" else ""})
    headers = ["point", "role", "images", *(f"{axis}, m" for axis in AXES), *(f"sigma {axis}, m" for axis in AXES)]
    return {"headers": [*headers, "px", "sigma, px"], "rows": rows}


def _table(found: Correction) -> dict[str, Any]:
    """Table of the images: corrections, standard deviations before and after, residuals."""
    rows_of = {str(name): row for row, name in enumerate(found.views.name)}
    before = np.array([np.sqrt(np.diagonal(found.views.covariance[rows_of[name]])) for name in found.names])
    after = np.sqrt(np.maximum(np.diagonal(found.adjustment.covariance_of_images, axis1=1, axis2=2), 0.0))
    turned = np.rad2deg(np.linalg.norm(found.turned, axis=1))
    of_turn = (np.rad2deg(np.sqrt(np.mean(x[:, 3:] ** 2, axis=1))) for x in (before, after))
    turn_before, turn_after = of_turn
    observed, residuals = found.adjustment.block.observations, found.adjustment.residuals
    doubtful = set(found.doubtful)
    rows = []
    for k, name in enumerate(found.names[:MOST]):
        own = observed.image == name
        cells = [_text(name)]
        for axis in range(3):
            cells += [_cell(found.moved[k, axis], 3), _cell(before[k, axis], 3), _cell(after[k, axis], 3)]
        cells += [_cell(turned[k], 4), _cell(turn_before[k], 4), _cell(turn_after[k], 4)]
        cells += [_cell(found.sigmas[k], 1), _cell(float(np.count_nonzero(own)), 0), _cell(_rms(residuals[own]), 2)]
        rows.append({"cells": cells, "kind": "doubtful" if name in doubtful else ""})
    headers = ["image"]
    for axis in AXES:
        headers += [f"{axis}, m", "sigma before", "after"]
    headers += ["turned, deg", "sigma before", "after", "sigmas", "points", "px"]
    lost = found.unconnected[:MOST]
    return {"headers": headers, "rows": rows, "lost": lost, "left_out": max(len(found.names) - MOST, 0)}


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _cell(value: float, places: int) -> dict[str, Any]:
    value = float(value)
    is_known = np.isfinite(value)
    return {"text": words.number(value, places), "key": value if is_known else "", "kind": ""}


def _text(value: str) -> dict[str, Any]:
    return {"text": value, "key": value, "kind": "text"}

"""Residual vectors over the image as SVG: all images of a camera together, and single images."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup, escape

from jaxgeo.plot.style import round_length
from jaxgeo.ties import Correction

CELLS = 12  # of the mean vectors, along the longer side
LEAST = 3  # residuals of a cell with a mean vector
MOST_VECTORS, MOST_OF_IMAGE, MOST_IMAGES = 3000, 400, 24
LONG = 0.05  # of the longer side: a residual vector of the size of the 90 % quantile
PAD = 0.02  # of the longer side, around the image
SEED = 0


def camera_maps(found: Correction) -> list[dict[str, Any]]:
    """A map for each camera: residuals of all its images, and their means over cells of the image."""
    observed, residuals = found.adjustment.block.observations, found.adjustment.residuals
    camera_of = dict(zip(found.names, found.adjustment.images.camera.tolist(), strict=True))
    camera = np.array([camera_of[str(name)] for name in observed.image])
    maps = []
    for name, one in found.adjustment.cameras.items():
        rows = np.flatnonzero(camera == name)
        if not len(rows):
            continue
        size, uv, off = (one.width, one.height), observed.uv[rows], residuals[rows]
        scale, reference = _scale(off, size)
        centres, means, counts = _means(uv, off, size)
        drawn = rows if len(rows) <= MOST_VECTORS else np.random.default_rng(SEED).choice(rows, MOST_VECTORS, False)
        parts = [_frame(size), *_vectors(observed.uv[drawn], residuals[drawn], scale, "vector")]
        titles = [f"mean of {n}: {u:+.2f}, {v:+.2f} px" for n, (u, v) in zip(counts, means, strict=True)]
        parts += _vectors(centres, means, scale, "mean", titles)
        maps.append(
            {
                "name": name,
                "images": sum(x == name for x in camera_of.values()),
                "measurements": len(rows),
                "drawn": len(drawn),
                "rms": _rms(off),
                "mean_rms": _rms(means) if len(means) else None,
                "svg": _svg(size, parts),
                **_reference(reference, scale, size),
            }
        )
    return maps


def image_maps(found: Correction) -> tuple[list[dict[str, Any]], int]:
    """(maps of single images, the largest residuals first; the number of images without one)."""
    observed, residuals = found.adjustment.block.observations, found.adjustment.residuals
    camera_of = dict(zip(found.names, found.adjustment.images.camera.tolist(), strict=True))
    rows_of = {name: np.flatnonzero(observed.image == name) for name in found.names}
    order = sorted(found.names, key=lambda name: -_rms(residuals[rows_of[name]]))
    largest = max(((c.width, c.height) for c in found.adjustment.cameras.values()), key=max)
    scale, reference = _scale(residuals, largest, 2.0)
    maps = []
    for name in order[:MOST_IMAGES]:
        rows, camera = rows_of[name], found.adjustment.cameras[camera_of[name]]
        size = camera.width, camera.height
        drawn = rows[:MOST_OF_IMAGE]
        titles = [f"{observed.point[k]}: {residuals[k, 0]:+.2f}, {residuals[k, 1]:+.2f} px" for k in drawn]
        parts = [_frame(size), *_vectors(observed.uv[drawn], residuals[drawn], scale, "vector", titles)]
        one = {"name": name, "count": len(rows), "rms": _rms(residuals[rows]), "svg": _svg(size, parts)}
        maps.append(one | _reference(reference, scale, size))
    return maps, max(len(order) - MOST_IMAGES, 0)


def _scale(off: np.ndarray, size: tuple[int, int], times: float = 1.0) -> tuple[float, float]:
    """(factor of residual vectors, a round residual in px for reference)."""
    typical = float(np.quantile(np.linalg.norm(off, axis=1), 0.9)) if len(off) else 0.0
    typical = max(typical, 1e-6)
    return times * LONG * max(size) / typical, round_length(typical)


def _reference(residual: float, scale: float, size: tuple[int, int]) -> dict[str, Any]:
    """A reference residual, and the width of its vector in percent of the map."""
    width = size[0] + 2.0 * PAD * max(size)
    return {"reference": f"{residual:g} px", "reference_percent": 100.0 * residual * scale / width}


def _means(uv: np.ndarray, off: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(centres (n, 2), mean residuals (n, 2), counts (n,)) of the cells of the image with enough residuals."""
    side = max(size) / CELLS
    across = int(np.ceil(size[0] / side))
    cell = (np.clip(uv, 0.0, np.array(size) - 1.0) // side).astype(int)
    number, index, counts = np.unique(cell[:, 1] * across + cell[:, 0], return_inverse=True, return_counts=True)
    sums = np.zeros((len(number), 2))
    np.add.at(sums, index, off)
    enough = counts >= LEAST
    centres = (np.column_stack([number % across, number // across]) + 0.5) * side
    return centres[enough], (sums / counts[:, None])[enough], counts[enough]


def _frame(size: tuple[int, int]) -> str:
    return f'<rect class="frame" x="-0.5" y="-0.5" width="{size[0]}" height="{size[1]}"/>'


def _vectors(uv: np.ndarray, off: np.ndarray, scale: float, kind: str, titles: list[str] | None = None) -> list[str]:
    """Lines from pixels along their residuals, with a dot where they begin, and a text for the pointer."""
    parts = []
    for k, ((u, v), (du, dv)) in enumerate(zip(uv, off * scale, strict=True)):
        title = "" if titles is None else f"<title>{escape(titles[k])}</title>"
        parts.append(
            f'<g class="{kind}">{title}<path d="M{u:.1f} {v:.1f}h0"/>'
            f'<line x1="{u:.1f}" y1="{v:.1f}" x2="{u + du:.1f}" y2="{v + dv:.1f}"/></g>'
        )
    return parts


def _svg(size: tuple[int, int], parts: list[str]) -> Markup:
    pad = PAD * max(size)
    box = f"{-pad:.1f} {-pad:.1f} {size[0] + 2.0 * pad:.1f} {size[1] + 2.0 * pad:.1f}"
    return Markup(
        f'<svg class="residuals" viewBox="{box}" role="img" aria-label="residual vectors">{"".join(parts)}</svg>'
    )


def _rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(off**2))) if len(off) else 0.0

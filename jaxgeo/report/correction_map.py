"""Map of a corrected block as SVG: relief, footprints, perspective centres, tie points, control and check points."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from markupsafe import Markup, escape

from jaxgeo.io import exposures_of
from jaxgeo.observation import Exposure
from jaxgeo.ortho.rendering import met
from jaxgeo.plot.relief import Box, relief_of
from jaxgeo.plot.style import round_length
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.ties import Correction
from jaxgeo.uncertainty.model_inputs import ModelInputs

EDGE = 8  # points along an edge of an image
MOST_POINTS, MOST_LABELS, MOST_FOOTPRINTS = 3000, 40, 500
MARGIN = 0.04
LONG = 0.06  # of the width: a residual or a correction of the size of the largest
ACROSS = 1000  # pixels of the relief
SEED = 0
ROLES = {"control": "control", "check": "check", "left out": "wrong"}


def block_map(found: Correction, terrain: AbstractTerrain | None) -> dict[str, Any]:
    """The map as `svg`, its `labels` (text, left and top in percent), and scales in words and percent of the width."""
    frame = found.views.frame
    centres, points = found.adjustment.images.centre, found.adjustment.points.place
    rings = [] if terrain is None else _footprints(found, terrain)
    everything = np.concatenate([centres[:, :2], points[:, :2], *(ring for ring in rings if ring is not None)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = MARGIN * float(np.max(high - low)) + 1.0
    low, high = low - pad, high + pad
    width = float(high[0] - low[0])

    def at(place: np.ndarray) -> np.ndarray:
        """Coordinates of the drawing: m to the right and down from the corner."""
        return np.column_stack([place[:, 0] - low[0], high[1] - place[:, 1]])

    parts = [_relief(frame, terrain, low, high)]
    shown = zip(found.names, rings, strict=False)
    parts += [_ring(name, at(ring)) for name, ring in list(shown)[:MOST_FOOTPRINTS] if ring is not None]
    some = np.random.default_rng(SEED).permutation(len(points))[:MOST_POINTS]
    parts.append(f'<path class="ties" d="{"".join(f"M{x:.2f} {y:.2f}h0" for x, y in at(points[some]))}"/>')
    moved, of_moved = _arrows(found, at, width)
    parts += moved
    marks, of_marks, labels = _surveyed(found, at, width)
    parts += marks
    height = float(high[1] - low[1])
    percent = [(text, 100.0 * x / width, 100.0 * y / height) for text, x, y in labels]
    if len(found.names) <= MOST_LABELS // 2:
        percent += [
            (name, 100.0 * x / width, 100.0 * y / height) for name, (x, y) in zip(found.names, at(centres), strict=True)
        ]
    bar = round_length(0.25 * width)
    svg = f'<svg class="block" viewBox="0 0 {width:.2f} {height:.2f}" role="img" aria-label="map of the block">'
    return {
        "ratio": f"{width / height:.4f}",
        "svg": Markup(f"{svg}{''.join(parts)}</svg>"),
        "labels": percent[:MOST_LABELS],
        "bar": f"{bar:g} m",
        "bar_percent": 100.0 * bar / width,
        "moved": of_moved,
        "residuals": of_marks,
        "ties_drawn": len(some),
        "ties": len(points),
        "footprints": sum(ring is not None for ring in rings[:MOST_FOOTPRINTS]),
        "has_control": found.control_residuals is not None,
    }


def _footprints(found: Correction, terrain: AbstractTerrain) -> list[np.ndarray | None]:
    """Outlines (k, 2) of the images on the terrain, east and north in m; None where no edge point meets it."""
    frame, rings = found.views.frame, []
    air = {name: one.atmosphere for name, one in zip(found.views.name, found.views.exposure, strict=True)}
    for name, given in zip(found.names, exposures_of(found.adjustment), strict=True):
        camera = found.views.camera_of(found.views.name.tolist().index(name))
        exposure = Exposure(given.sensor, given.motion, jnp.zeros(()), air[name])
        u, v = np.linspace(0.0, camera.width - 1.0, EDGE), np.linspace(0.0, camera.height - 1.0, EDGE)
        edges = [(u, 0.0 * u), (0.0 * v + u[-1], v), (u[::-1], 0.0 * u + v[-1]), (0.0 * v, v[::-1])]
        uv = np.concatenate([np.column_stack(edge) for edge in edges])
        hits = met(ModelInputs(exposure, terrain=terrain), uv)
        is_hit = np.asarray(hits.status) == Status.hit
        place = np.asarray(frame.from_ecef(np.asarray(hits.p_ecef)))[is_hit, :2]
        rings.append(place if len(place) > 2 else None)
    return rings


def _relief(frame: Any, terrain: AbstractTerrain | None, low: np.ndarray, high: np.ndarray) -> str:
    """The relief as an image, stretched between the corners; nothing where the terrain is no elevation model."""
    if not isinstance(terrain, Dem):
        return ""
    corners = np.array([[*low, 0.0], [*high, 0.0]])
    lat, lon, _ = (np.asarray(x) for x in frame.to_geodetic(corners).to_degrees())
    relief = relief_of(terrain, Box(float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])), across=ACROSS)
    if relief is None:
        return ""
    width, height = high - low
    size = f'width="{width:.2f}" height="{height:.2f}" preserveAspectRatio="none"'
    return f'<image class="relief" href="{relief.url}" {size}/>'


def _ring(name: str, ring: np.ndarray) -> str:
    path = "L".join(f"{x:.2f} {y:.2f}" for x, y in ring)
    return f'<path class="footprint" d="M{path}Z"><title>{escape(name)}</title></path>'


def _arrows(found: Correction, at: Any, width: float) -> tuple[list[str], dict[str, Any]]:
    """Perspective centres with their corrections, exaggerated; and the scale of these."""
    centres, moved = at(found.adjustment.images.centre), found.moved[:, :2] * [1.0, -1.0]
    factor, scale = _exaggerated(found.moved[:, :2], width)
    parts = []
    for name, (x, y), (dx, dy), (east, north, up) in zip(
        found.names, centres, factor * moved, found.moved, strict=True
    ):
        title = escape(f"{name}: moved by {east:+.3f}, {north:+.3f}, {up:+.3f} m (east, north, up)")
        parts.append(
            f'<g class="centre"><title>{title}</title><line x1="{x - dx:.2f}" y1="{y - dy:.2f}" x2="{x:.2f}" '
            f'y2="{y:.2f}"/><path d="M{x:.2f} {y:.2f}h0"/></g>'
        )
    return parts, scale


def _surveyed(
    found: Correction, at: Any, width: float
) -> tuple[list[str], dict[str, Any] | None, list[tuple[str, float, float]]]:
    """Control and check points with their residuals, exaggerated; the scale of these; and their labels."""
    residuals, control = found.control_residuals, found.control
    if residuals is None or control is None:
        return [], None, []
    places = at(control.ground(found.views.frame).place)
    plane = np.nan_to_num(residuals.enu[:, :2])
    factor, scale = _exaggerated(plane, width)
    parts, labels = [], []
    for k, name in enumerate(residuals.name.tolist()):
        (x, y), (east, north) = places[k], factor * plane[k]
        known = residuals.enu[k]
        off = ", ".join(f"{value:+.3f}" for value in known) + " m (east, north, up)"
        title = escape(f"{name}, {residuals.role[k]}: " + (off if np.all(np.isfinite(known)) else "in one image"))
        parts.append(
            f'<g class="point {ROLES[str(residuals.role[k])]}"><title>{title}</title><line x1="{x:.2f}" y1="{y:.2f}" '
            f'x2="{x + east:.2f}" y2="{y - north:.2f}"/><path d="M{x:.2f} {y:.2f}h0"/></g>'
        )
        labels.append((name, float(x), float(y)))
    return parts, scale, labels


def _exaggerated(vectors: np.ndarray, width: float) -> tuple[float, dict[str, Any]]:
    """(factor of vectors in m, a round length with its percent of the width)."""
    longest = max(float(np.max(np.linalg.norm(vectors, axis=1), initial=0.0)), 1e-6)
    factor, reference = LONG * width / longest, round_length(longest)
    return factor, {"words": f"{reference:g} m", "percent": 100.0 * factor * reference / width}

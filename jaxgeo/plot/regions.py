"""Highest-density regions and probability maps over terrain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from jaxgeo._checks import check_is
from jaxgeo.plot.legends import COLOURED, keyed
from jaxgeo.plot.maps import degrees, lonlat_deg
from jaxgeo.plot.style import INK, REGION, halo, house_axes, percent
from jaxgeo.uncertainty import ProbabilityMap, Region

FILLED = 0.35  # opacity of the smallest region
TOLD = 0.01  # share of the samples; smaller pieces have no label
MOST_CELLS = 2**23  # drawn
MARGIN = 0.35  # of the extent, about a region on empty axes
COLOURS = matplotlib.colors.LinearSegmentedColormap.from_list(
    "probability", ["#fff3c4", "#fdbb63", "#ee6f37", "#b8234a", "#5c1150"]
)


def region_on_map(
    region: Region | Sequence[Region] | Any,
    ax: Axes | None = None,
    *,
    shares: bool = True,
    label: str = "region of",
) -> Axes:
    """Highest-density regions on a map, in degrees: filled areas with outlines, the smallest on top.

    `region` is one or several (`Sampled.region`). With `shares` the pieces of the largest one are labelled with their
    shares if there are several. Raises `TypeError` for other objects, `ValueError` for none.
    """
    several = _checked(region)
    with house_axes(ax, tall=0.8) as ax:
        bounds = several[-1].polygon.bounds
        lon, lat = (float(x) for x in lonlat_deg(several[0].fix.position))
        degrees(ax, lat)
        if ax.get_autoscale_on() and not ax.has_data():
            _about(ax, bounds, lon, lat)
        for one, style in zip(several[::-1], _styles(len(several))[::-1], strict=True):
            _draw(ax, one.polygon, style)
        for one, style in zip(several, _styles(len(several)), strict=True):
            keyed(ax, f"{label} {percent(one.probability)}", area=True, **style)
        if shares and len(several[-1].modes) > 1:
            for mode in several[-1].modes:
                if mode.share.value >= TOLD:
                    _told(ax, mode.polygon, percent(mode.share.value))
    return ax


def draw_region(ax: Axes, region: Any, label: str = "") -> Any:
    """A region in m east and north of the fix; returns its entry of a legend."""
    style = _styles(1)[0]
    _draw(ax, region.polygon_enu, style | {"zorder": 4.8})
    return keyed(ax, label, area=True, **style)


def probability_on_map(found: ProbabilityMap | Any, ax: Axes | None = None, *, held: float = 0.999) -> Axes:
    """Probability per m² on a map, in degrees, on a logarithmic scale: the cells of the region of `held`.

    `colour_bar(ax, "probability per m²")` shows the colours. Raises `TypeError` for another object, `ValueError` for a
    share outside (0, 1], and for cells far apart.
    """
    check_is(found, ProbabilityMap, "found", "Make it with Sampled.probability_map.")
    if not 0.0 < held <= 1.0:
        raise ValueError(f"held must lie in (0, 1]; got {held!r}.")
    count = min(int(np.searchsorted(np.cumsum(found.probability), held * found.found)) + 1, len(found.probability))
    rowcol = np.round(found.cells[:count] / found.size - 0.5).astype(int)
    first, last = rowcol.min(axis=0), rowcol.max(axis=0)
    if math.prod((last - first + 1).tolist()) > MOST_CELLS:
        raise ValueError(f"the cells of {percent(held)} lie too far apart to be drawn at once; name a smaller held=.")
    cells = np.full(last - first + 1, np.nan)
    cells[tuple((rowcol - first).T)] = found.probability[:count] / math.prod(found.cell_size)
    corners = np.stack(np.meshgrid(*(np.arange(a, b + 2) for a, b in zip(first, last, strict=True)), indexing="ij"), -1)
    lon, lat = found.lonlat_deg(corners.reshape(-1, 2) * found.size)
    lon, lat = (x.reshape(corners.shape[:2]) for x in (lon, lat))
    high = float(np.nanmax(cells))
    norm = matplotlib.colors.LogNorm(max(float(np.nanmin(cells)), 1e-3 * high), high)
    with house_axes(ax, tall=0.8) as ax:
        place = lonlat_deg(found.fix.position)
        degrees(ax, float(place[1]))
        if ax.get_autoscale_on() and not ax.has_data():
            _about(ax, (lon.min(), lat.min(), lon.max(), lat.max()), *(float(x) for x in place))
        drawn = ax.pcolormesh(lon, lat, np.ma.masked_invalid(cells), cmap=COLOURS, norm=norm, rasterized=True, zorder=1)
        drawn.set_gid(COLOURED)
    return ax


def _checked(region: Any) -> list[Region]:
    several = [region] if isinstance(region, Region) else list(region)
    for one in several:
        check_is(one, Region, "region", "Make it with Sampled.region.")
    if not several:
        raise ValueError("region must be one or more; got none.")
    return sorted(several, key=lambda one: one.probability)


def _about(ax: Axes, bounds: Sequence[float], lon: float, lat: float) -> None:
    """Limits about a region and its fix."""
    west, south, east, north = min(bounds[0], lon), min(bounds[1], lat), max(bounds[2], lon), max(bounds[3], lat)
    stretch = 1.0 / math.cos(math.radians(lat))
    margin = max(MARGIN * max((east - west) / stretch, north - south), 1e-6)
    ax.set(xlim=(west - margin * stretch, east + margin * stretch), ylim=(south - margin, north + margin))


def _styles(count: int) -> list[dict[str, Any]]:
    """Fill and edge of each of several regions, the smallest first."""
    rgb = matplotlib.colors.to_rgb(REGION)
    fills = [FILLED * 0.55**k for k in range(count)]
    return [
        {
            "facecolor": (*rgb, fill),
            "edgecolor": REGION,
            "linewidth": 1.5 - 0.3 * min(k, 2),
        }
        for k, fill in enumerate(fills)
    ]


def _draw(ax: Axes, polygon: Any, style: dict[str, Any]) -> None:
    """Polygons with their holes."""
    edge = halo(style["linewidth"] + 1.2)
    place: dict[str, Any] = {"zorder": 4.2, "label": "_region"} | style
    fill = PathPatch(_path(polygon), **{**place, "edgecolor": "none"})
    line = PathPatch(_path(polygon), **{**place, "facecolor": "none"}, joinstyle="round", path_effects=edge)
    for patch in (fill, line):
        ax.add_artist(patch)


def _path(polygon: Any) -> Path:
    """All rings of a multipolygon; holes run the other way."""
    rings = [ring for part in polygon.geoms for ring in (part.exterior, *part.interiors)]
    vertices = [np.asarray(ring.coords) for ring in rings]
    codes = [np.full(len(ring), Path.LINETO) for ring in vertices]
    for code in codes:
        code[0], code[-1] = Path.MOVETO, Path.CLOSEPOLY
    return Path(np.concatenate(vertices), np.concatenate(codes))


def _told(ax: Axes, polygon: Any, text: str) -> None:
    """A share above a piece."""
    west, _, east, north = polygon.bounds
    font: dict[str, Any] = {"fontsize": "large", "fontweight": "bold", "color": INK}
    place: dict[str, Any] = {"xytext": (0.0, 3.0), "textcoords": "offset points", "ha": "center", "va": "bottom"}
    ax.annotate(text, (0.5 * (west + east), north), path_effects=halo(3.0), zorder=7, **place, **font)

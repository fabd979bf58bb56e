"""Accuracy maps: error radii and the cheapest valid propagation method at each map cell."""

from __future__ import annotations

from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes

from jaxgeo._checks import check_is
from jaxgeo.plot.legends import COLOURED, keyed
from jaxgeo.plot.maps import degrees, lonlat_deg
from jaxgeo.plot.style import HIDDEN, METHODS, house_axes
from jaxgeo.status import Status
from jaxgeo.uncertainty import AccuracyMap, Method

COLOURS = "cividis"
SEEN_THROUGH = 0.85  # opacity of the colours, so that the relief below stays visible
MARK = 14.0  # points2, of points that are not on a lattice


def accuracy_map(
    found: AccuracyMap,
    ax: Axes | None = None,
    *,
    values: Any = None,
    limits: tuple[float, float] | None = None,
    hidden: str = "hidden by terrain",
) -> Axes:
    """Error radii in m at the points of a map, colour-coded on a logarithmic scale; hidden ground has its own colour.

    `values` are the radii to draw, of the shape of `found`, by default its `circular`. Infinite values get the last
    colour; unknown ones are not drawn. `limits` of the colours are in m, by default the 2nd and 98th percentile of the
    finite values; `colour_bar(ax, "CE90, m")` shows them. Points on a lattice are drawn as cells, others as markers.
    Raises `TypeError` for another record, `ValueError` for another shape and where there is nothing to draw.
    """
    check_is(found, AccuracyMap, "found", "Make one with jaxgeo.uncertainty.accuracy_map.")
    error = np.asarray(found.circular if values is None else values, float)
    if error.shape != np.shape(found.status):
        raise ValueError(f"values must have the shape of found, {np.shape(found.status)}; got {error.shape}.")
    finite = error[np.isfinite(error) & (error > 0.0)]
    if not finite.size:
        raise ValueError("no place has an error that is positive and finite: there is nothing to draw.")
    low, high = np.quantile(finite, [0.02, 0.98]) if limits is None else limits
    norm = matplotlib.colors.LogNorm(low, max(high, 1.001 * low))
    error = np.where(error > 0.0, np.minimum(error, 1e9), np.nan)
    with house_axes(ax, tall=0.8) as ax:
        _cells(found, ax, error, norm=norm, cmap=COLOURS, zorder=1.0).set_gid(COLOURED)
        _hidden(found, ax, hidden)
    return ax


def method_map(found: AccuracyMap, ax: Axes | None = None, *, hidden: str = "hidden by terrain") -> Axes:
    """Cheapest valid propagation method at the points of a map, with its share of the points that have a fix.

    Raises `TypeError` for another record, `ValueError` where there is no fix.
    """
    check_is(found, AccuracyMap, "found", "Make one with jaxgeo.uncertainty.accuracy_map.")
    method = np.asarray(found.method)
    count = np.count_nonzero(method >= 0)
    if not count:
        raise ValueError("no place of this map has a fix: there is nothing to draw.")
    with house_axes(ax, tall=0.8) as ax:
        for one, colour in zip(Method, METHODS, strict=True):
            here = method == one
            _one_colour(found, ax, here, colour, f"{one.words}, {100.0 * np.count_nonzero(here) / count:.0f} %")
        _hidden(found, ax, hidden)
    return ax


def _hidden(found: AccuracyMap, ax: Axes, label: str) -> None:
    here = np.isin(np.asarray(found.status), (Status.hidden_by_terrain, Status.below_horizon))
    if here.any():
        _one_colour(found, ax, here, HIDDEN, label)


def _one_colour(found: AccuracyMap, ax: Axes, here: np.ndarray, colour: str, label: str) -> None:
    if here.any():
        only = matplotlib.colors.ListedColormap([colour])
        _cells(found, ax, np.where(here, 1.0, np.nan), cmap=only, vmin=0.0, vmax=2.0, zorder=1.1)
    keyed(ax, label, area=True, facecolor=colour, alpha=SEEN_THROUGH)


def _cells(found: AccuracyMap, ax: Axes, values: np.ndarray, **style_options: Any) -> Any:
    """Draw known values: lattice points as cells, others as markers."""
    lon, lat = lonlat_deg(found.position)
    degrees(ax, float(np.nanmean(lat)))
    style: dict[str, Any] = {"alpha": SEEN_THROUGH, "rasterized": True, "label": "_places", **style_options}
    if values.ndim == 2 and min(values.shape) > 1 and np.isfinite(lon).all():
        return ax.pcolormesh(lon, lat, values, shading="nearest", **style)
    known = np.isfinite(values) & np.isfinite(lon)
    return ax.scatter(lon[known], lat[known], c=values[known], s=MARK, linewidths=0.0, **style)

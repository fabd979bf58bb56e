"""Maps of accuracy: how large errors are by colour, and which method can be trusted by mark."""

from __future__ import annotations

from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable

from jaxgeo.earth import Geodetic
from jaxgeo.plot.legends import COLOURED, keyed
from jaxgeo.plot.maps import degrees, lonlat_deg
from jaxgeo.plot.style import JUMPED, house_axes
from jaxgeo.uncertainty import Trust

MARKS = {Trust.facet: "o", Trust.footprint: "s", Trust.samples: "^"}
EDGES = {Trust.facet: "none", Trust.footprint: "white", Trust.samples: JUMPED}
COLOURS = "cividis"


def accuracy_map(
    error: Any,
    trust: Any,
    where: Any,
    ax: Axes | None = None,
    *,
    limits: tuple[float, float] | None = None,
    size: float = 16.0,
) -> Axes:
    """A figure of accuracy in m at many places, by colour, and which method can be trusted there, by mark.

    `error` and `trust` (of `Trust`) have one shape; places without a positive `error` stay blank, an infinite one has
    the last colour. `where` is a `Geodetic` of that shape, for a map, or (..., 2) in px across and up, for an image: a
    lattice (rows, columns) of these is drawn as cells. `limits` are those of the colours in m, by default the 2nd and
    98th percentile of what is finite; `size` is that of the marks in points2. `colour_bar(ax, "CE90, m")` tells the
    colours. Raises `ValueError` for shapes that differ, codes that are no `Trust`, and errors of which none can be
    drawn.
    """
    error, trust = np.asarray(error, float), np.asarray(trust)
    on_map = isinstance(where, Geodetic)
    x, y = lonlat_deg(where) if on_map else np.moveaxis(np.asarray(where, float), -1, 0)
    for name, shape in (("trust", trust.shape), ("where", x.shape)):
        if shape != error.shape:
            raise ValueError(f"{name} must have the shape of error, {error.shape}; got {shape}.")
    if not np.isin(trust, list(Trust)).all():
        raise ValueError(f"trust must hold codes of Trust, {[int(one) for one in Trust]}; got {np.unique(trust)}.")
    known = (error > 0.0) & np.isfinite(x) & np.isfinite(y)
    finite = error[known & np.isfinite(error)]
    if not finite.size:
        raise ValueError("no place has an error that is positive and finite: there is nothing to draw.")
    low, high = np.quantile(finite, [0.02, 0.98]) if limits is None else limits
    error = np.minimum(error, high)
    norm = matplotlib.colors.LogNorm(low, max(high, 1.001 * low))
    colours = ScalarMappable(norm, COLOURS)
    as_cells = error.ndim == 2 and not on_map
    with house_axes(ax, tall=0.8) as ax:
        if on_map:
            degrees(ax, float(np.mean(y[np.isfinite(y)])))
        else:
            _image(ax)
        if as_cells:
            cells = np.where(known[..., None], colours.to_rgba(error), 0.0)
            ax.pcolormesh(x, y, cells, shading="nearest", rasterized=True, zorder=1)
        told = ax.scatter([], [], c=[], norm=norm, cmap=COLOURS, label="_colours")
        told.set_gid(COLOURED)
        for one in Trust:
            _marks(one, x, y, error, known & (trust == one), colours, ax, as_cells, size)
    return ax


def _image(ax: Axes) -> None:
    """Names of the axes of an image, where they have none."""
    ax.set(xlabel=ax.get_xlabel() or "across the image, px", ylabel=ax.get_ylabel() or "up the image, px")


def _marks(
    one: Trust,
    x: np.ndarray,
    y: np.ndarray,
    error: np.ndarray,
    here: np.ndarray,
    colours: ScalarMappable,
    ax: Axes,
    as_cells: bool,
    size: float,
) -> None:
    """The places at which one method is trusted; on cells, the cheapest method has no mark."""
    share = f"{one.words}, {100.0 * np.count_nonzero(here) / max(np.count_nonzero(np.isfinite(error)), 1):.0f} %"
    if as_cells and one is Trust.facet:
        keyed(ax, f"no mark: {share}", linestyle="none")
        return
    edge = "black" if as_cells else EDGES[one]
    style: dict[str, Any] = {"marker": MARKS[one], "linewidths": 0.7, "edgecolors": edge, "zorder": 3 + 0.1 * one}
    ax.scatter(x[here], y[here], s=size, c="white" if as_cells else colours.to_rgba(error[here]), **style)
    fill = "white" if as_cells else "0.5"
    keyed(ax, share, linestyle="none", marker=MARKS[one], color=fill, markeredgecolor=edge)

"""What images cover of the ground, and what they share along the flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxgeo._checks import check_is
from jaxgeo.coverage import Footprint, Overlap
from jaxgeo.earth import Geodetic, TransverseMercator
from jaxgeo.plot.maps import EDGE, FIX, HIDDEN, MOST_POSTS, SIGHT, lonlat_deg, post_positions, shaded_relief
from jaxgeo.status import Status
from jaxgeo.terrain import Dem

OUTLINES = (EDGE, SIGHT, FIX, HIDDEN, "#1a7f5a", "#b35806")  # colours of outlines, in turn
GAP = "#f3d9d3"
PARTS: dict[str, tuple[Any, str]] = {
    "hidden": ("--", "nearer ground hides the way"),
    "missed": (":", "no ground is seen between"),
}


def footprints(
    seen: Sequence[Footprint],
    ax: Axes,
    *,
    labels: Sequence[str] | None = None,
    dem: Dem | None = None,
    origin: Geodetic | None = None,
    colours: Sequence[Any] = OUTLINES,
) -> list[Line2D]:
    """Outlines of images on a map: full lines where ground is seen, dashed over ground that nearer ground hides, dotted
    from where the outline leaves the ground to where it comes back.

    Axes are in deg of longitude and latitude, or with an `origin` in km east and north of it, on the Gauss-Krueger map
    about its meridian. A `dem` is drawn below, as a relief. Returns handles for a legend: one for each outline
    (`labels`, or its number), and one for each other kind of line there is. Raises `ValueError` for no footprints and
    for another number of labels.
    """
    if not seen or (labels is not None and len(labels) != len(seen)):
        raise ValueError(f"labels must name each of one or more footprints; got {len(seen)} footprints and {labels}.")
    for one in seen:
        check_is(one, Footprint, "seen", "A list of what jaxgeo.coverage.footprint gives.")
    on_axes = [_on_axes(one.fix.position, origin) for one in seen]
    if not any(np.isfinite(places).any() for places in on_axes):
        raise ValueError(f"none of the footprints sees any ground: {Status(int(seen[0].status)).message}")
    if dem is not None:
        _relief(dem, origin, ax)
    handles: list[Line2D] = []
    kinds: set[str] = set()
    for index, (one, places) in enumerate(zip(seen, on_axes, strict=True)):
        style: dict[str, Any] = {"color": colours[index % len(colours)], "linewidth": 1.8, "zorder": 4}
        lines = _parts(one, places)
        for kind, (dashes, _) in PARTS.items():
            ax.plot(*lines[kind].T, linestyle=dashes, **style)
        label = f"footprint {index}" if labels is None else labels[index]
        handles += ax.plot(*lines["seen"].T, label=label, **style)
        kinds |= {kind for kind in PARTS if len(lines[kind])}
    _prepare(ax, origin, np.concatenate(on_axes))
    others = {kind: look for kind, look in PARTS.items() if kind in kinds}
    return handles + [Line2D([], [], color="0.3", linestyle=dashes, label=text) for dashes, text in others.values()]


def overlap_along(
    found: Overlap, ax: Axes, *, wished: float | None = None, label: str = "overlap", colour: Any = SIGHT
) -> list[Artist]:
    """Overlap along the flight over the distance across it, from the near end to the far end; gaps are shaded.

    `found` holds one overlap, or with a leading axis a row of them, drawn as one bundle; what is not `ok` has no line.
    Returns handles for a legend. Raises `ValueError` where there is nothing to draw.
    """
    check_is(found, Overlap, "found", "Make one with jaxgeo.coverage.overlap.")
    along, across = (np.atleast_2d(np.asarray(x)) for x in (found.along, found.across))
    known = np.isfinite(along).all(axis=1)
    if not known.any():
        why = Status(int(np.ravel(found.status)[0]))
        raise ValueError(f"none of the overlaps has a line along the flight: {why.message}")
    style: dict[str, Any] = {"linewidth": 1.8} if known.sum() == 1 else {"linewidth": 0.8, "alpha": 0.6}
    from_near, percent = 1e-3 * (across - across[:, :1])[known], 100.0 * along[known]
    ax.plot(from_near.T, percent.T, color=colour, zorder=3, **style)
    handles: list[Artist] = [Line2D([], [], color=colour, linewidth=1.8, label=label)]
    if wished is not None:
        dashed: dict[str, Any] = {"color": EDGE, "linewidth": 1.0, "linestyle": "--", "label": f"wished {wished:.0%}"}
        handles.append(ax.axhline(100.0 * wished, **dashed))
    if percent.min() < 0.0:
        low, high = ax.get_ylim()
        ax.axhspan(low, 0.0, color=GAP, zorder=0)
        ax.set_ylim(low, high)
        handles.append(Patch(color=GAP, label="gap between the images"))
    ax.set_xlim(0.0, float(from_near.max()))
    ax.set_xlabel("across the flight from the near end, km")
    ax.set_ylabel("overlap, %")
    return handles


def _parts(one: Footprint, places: np.ndarray) -> dict[str, np.ndarray]:
    """Lines of each kind around a ring of places (n, 2), parted by rows of NaN."""
    found, hidden = one.found, np.asarray(one.hidden)
    following = np.roll(places, -1, axis=0)
    known = found & np.roll(found, -1)
    ring = np.concatenate([places, places[:1]])
    seen = np.insert(ring, np.flatnonzero(~known | hidden) + 1, np.nan, axis=0)
    there = np.flatnonzero(found)
    back = np.roll(there, -1)
    leaves = ~known[there]
    return {
        "seen": seen,
        "hidden": _pieces(places[known & hidden], following[known & hidden]),
        "missed": _pieces(places[there[leaves]], places[back[leaves]]),
    }


def _pieces(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Straight pieces as one line, parted by rows of NaN."""
    return np.stack([starts, ends, np.full_like(starts, np.nan)], axis=1).reshape(-1, 2)


def _on_axes(position: Geodetic, origin: Geodetic | None) -> np.ndarray:
    """Positions (...,) as (..., 2): longitude and latitude in deg, or km east and north of an origin."""
    if origin is None:
        return np.stack(lonlat_deg(position), axis=-1)
    projection = TransverseMercator.gauss_krueger(jnp.asarray(origin.lon))
    lat, lon = (np.ravel(x) for x in (position.lat, position.lon))
    east, north = (np.asarray(x).reshape(np.shape(position.lat)) for x in _forward(projection, lat, lon))
    east0, north0 = projection.forward(jnp.asarray(origin.lat), jnp.asarray(origin.lon))
    return 1e-3 * np.stack([east - float(east0), north - float(north0)], axis=-1)


@jax.jit
def _forward(projection: TransverseMercator, lat: jax.Array, lon: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(projection.forward)(lat, lon)


def _relief(dem: Dem, origin: Geodetic | None, ax: Axes) -> None:
    """As `hillshade`, on axes in deg or in km."""
    step = max(1, math.ceil(int(np.max(np.asarray(dem.extent))) / MOST_POSTS))
    x, y = np.moveaxis(_on_axes(post_positions(dem, step), origin), -1, 0)
    ax.pcolormesh(x, y, shaded_relief(dem, step), shading="nearest", rasterized=True, zorder=0)


def _prepare(ax: Axes, origin: Geodetic | None, places: np.ndarray) -> None:
    """Labels, equal lengths north and east, and limits around what is seen."""
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    margin = 0.08 * (high - low)
    ax.set_xlim(low[0] - margin[0], high[0] + margin[0])
    ax.set_ylim(low[1] - margin[1], high[1] + margin[1])
    if origin is None:
        ax.set_aspect(1.0 / math.cos(math.radians(0.5 * (low[1] + high[1]))))
        ax.set_xlabel("longitude, °")
        ax.set_ylabel("latitude, °")
    else:
        ax.set_aspect("equal")
        ax.set_xlabel("east, km")
        ax.set_ylabel("north, km")

"""Image footprints and along-track overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from jaxgeo._checks import check_is
from jaxgeo._renamed import renamed_argument
from jaxgeo.coverage import Footprint, Overlap
from jaxgeo.earth import Geodetic, TransverseMercator
from jaxgeo.plot.legends import keyed
from jaxgeo.plot.maps import MOST_POSTS, degrees, lonlat_deg, post_positions, shaded_relief
from jaxgeo.plot.style import INK, OUTLINES, SIGHT, halo, house_axes, percent
from jaxgeo.status import Status
from jaxgeo.terrain import Dem

GAP = "#f3d9d3"
PARTS: dict[str, tuple[Any, str]] = {
    "hidden": ("--", "nearer ground hides the way"),
    "missed": (":", "no ground is seen between"),
}


def footprints(
    seen: Footprint | Geodetic | Sequence[Footprint | Geodetic],
    ax: Axes | None = None,
    *,
    labels: Sequence[str] | None = None,
    dem: Dem | None = None,
    origin: Geodetic | None = None,
    colours: Sequence[Any] = OUTLINES,
) -> Axes:
    """Image outlines on a map: full lines on visible ground, dashed across hidden ground, dotted across gaps where the
    outline leaves the ground.

    `seen` are footprints, or outlines as positions (n,) in order, NaN where no ground is seen. Axes are in deg of
    longitude and latitude, or with an `origin` in km east and north of it, on the Gauss-Krueger map about its meridian.
    A `dem` is drawn below as a relief. Empty axes get limits around the footprints. `labels` are the legend's texts, by
    default numbers. Raises `TypeError` for other records, `ValueError` for no footprints, for a wrong number of labels,
    and where no footprint has ground.
    """
    rows = [seen] if isinstance(seen, Footprint | Geodetic) else list(seen)
    if not rows or (labels is not None and len(labels) != len(rows)):
        raise ValueError(f"labels must name each of one or more footprints; got {len(rows)} footprints and {labels}.")
    for one in rows:
        if not isinstance(one, Geodetic):
            check_is(one, Footprint, "seen", "What jaxgeo.coverage.footprint gives, or an outline as a Geodetic.")
    places = [_on_axes(one if isinstance(one, Geodetic) else one.fix.position, origin) for one in rows]
    if not any(np.isfinite(ring).any() for ring in places):
        why = Status(int(rows[0].status)).message if isinstance(rows[0], Footprint) else "all positions are NaN."
        raise ValueError(f"none of the footprints sees any ground: {why}")
    with house_axes(ax, tall=0.8) as ax:
        is_empty = not ax.has_data() and ax.get_autoscale_on()
        if dem is not None:
            _relief(dem, origin, ax)
        kinds: set[str] = set()
        for index, (one, ring) in enumerate(zip(rows, places, strict=True)):
            style: dict[str, Any] = {"color": colours[index % len(colours)], "linewidth": 1.8, "zorder": 4}
            hidden = np.zeros(len(ring), bool) if isinstance(one, Geodetic) else np.asarray(one.hidden)
            lines = _parts(np.all(np.isfinite(ring), axis=1), hidden, ring)
            for kind, (dashes, _) in PARTS.items():
                ax.plot(*lines[kind].T, linestyle=dashes, label=f"_{kind}", **style)
            label = f"footprint {index + 1}" if labels is None else labels[index]
            ax.plot(*lines["seen"].T, label=label, path_effects=halo(2.8), **style)
            kinds |= {kind for kind in PARTS if len(lines[kind])}
        _prepare(ax, origin, np.concatenate(places), is_empty)
        for kind in sorted(kinds):
            keyed(ax, PARTS[kind][1], color="0.3", linestyle=PARTS[kind][0])
    return ax


@renamed_argument("wished", "required")
def overlap_along(
    found: Overlap,
    ax: Axes | None = None,
    *,
    required: float | None = None,
    label: str = "overlap",
    colour: Any = SIGHT,
) -> Axes:
    """Along-track overlap over the across-track distance, from the near edge to the far edge; gaps are shaded.

    `found` holds one overlap, or with a leading axis several, drawn as a bundle of lines. Those that are not `ok` are
    left out. Raises `ValueError` where there is nothing to draw.
    """
    check_is(found, Overlap, "found", "Make one with jaxgeo.coverage.overlap.")
    along, across = (np.atleast_2d(np.asarray(x)) for x in (found.along, found.across))
    known = np.isfinite(along).all(axis=1)
    if not known.any():
        why = Status(int(np.ravel(found.status)[0]))
        raise ValueError(f"none of the overlaps has a line along the flight: {why.message}")
    style: dict[str, Any] = {"linewidth": 1.8} if known.sum() == 1 else {"linewidth": 0.8, "alpha": 0.6}
    from_near, shared = 1e-3 * (across - across[:, :1])[known], 100.0 * along[known]
    with house_axes(ax) as ax:
        ax.plot(from_near.T, shared.T, color=colour, zorder=3, **style)
        keyed(ax, label, color=colour, linewidth=1.8)
        if required is not None:
            ax.axhline(
                100.0 * required, color=INK, linewidth=1.0, linestyle="--", label=f"required, {percent(required)}"
            )
        if shared.min() < 0.0:
            low, high = ax.get_ylim()
            ax.axhspan(low, 0.0, color=GAP, zorder=0)
            ax.set_ylim(low, high)
            keyed(ax, "gap between the images", area=True, color=GAP)
        ax.set_xlim(0.0, float(from_near.max()))
        ax.set(xlabel="across the flight from the near end, km", ylabel="overlap, %")
    return ax


def _parts(found: np.ndarray, hidden: np.ndarray, places: np.ndarray) -> dict[str, np.ndarray]:
    """Lines of each kind along a ring of points (n, 2), separated by rows of NaN."""
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
    """Line segments as one array, separated by rows of NaN."""
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
    """`hillshade` on axes in deg or in km."""
    step = max(1, math.ceil(int(np.max(np.asarray(dem.extent))) / MOST_POSTS))
    x, y = np.moveaxis(_on_axes(post_positions(dem, step), origin), -1, 0)
    ax.pcolormesh(x, y, shaded_relief(dem, step), shading="nearest", rasterized=True, zorder=0)


def _prepare(ax: Axes, origin: Geodetic | None, places: np.ndarray, is_empty: bool) -> None:
    """Set labels, equal scale north and east, and limits around the footprints."""
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    margin = 0.08 * (high - low)
    if is_empty:
        ax.set(xlim=(low[0] - margin[0], high[0] + margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    if origin is None:
        degrees(ax, 0.5 * (low[1] + high[1]))
    else:
        ax.set(aspect="equal", xlabel="east, km", ylabel="north, km")

"""Error ellipses and sample clouds of fixes on the map, true to scale or enlarged by a stated factor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from jaxgeo._checks import check_is
from jaxgeo.earth import Geodetic
from jaxgeo.plot.legends import keyed
from jaxgeo.plot.maps import degrees, lonlat_deg, radii_of_curvature
from jaxgeo.plot.style import FIX, JUMPED, SAMPLE, halo, house_axes, round_length
from jaxgeo.uncertainty import Accuracy, Comparison, Propagation, Sampled

SEEN = 0.05  # of the map's width: target for the median major axis of enlarged ellipses
ENOUGH = 0.01  # of the map's width: larger major axes need no enlargement
MOST_POINTS = 2000  # drawn of a cloud; more do not make it clearer
RING = np.stack([np.cos(turn := np.linspace(0.0, 2.0 * np.pi, 121)), np.sin(turn)])


def ellipses_on_map(
    found: Propagation | Accuracy | Sequence[Propagation | Accuracy],
    ax: Axes | None = None,
    *,
    probability: float | None = None,
    times: float | None = None,
    label: str = "error ellipses",
) -> Axes:
    """Error ellipses of fixes on a map: regions that contain the ground point with a `probability`.

    `found` is one record, several, or one with a leading axis. `probability` defaults to that of the records, 0.9 for a
    `Propagation`. Where linear propagation is not valid, a dashed circle with the CE of the samples replaces the
    ellipse. Both are enlarged `times`, 1 for true scale; by default 1 where they are visible at true scale, else a
    round factor, named in the legend. Fixes of unknown accuracy are left out. Raises `TypeError` for other records,
    `ValueError` for a probability outside (0, 1), or one that differs from that of accuracy records, for a factor that
    is not positive, and where there is nothing to draw.
    """
    parts = [_normal(one) for one in ([found] if isinstance(found, _RECORDS) else found)]
    if not parts:
        raise ValueError("found must hold one fix or more; got none.")
    share = _share(parts, probability)
    position = _joined([one.position for one in parts])
    mean, cov, radius = (np.concatenate([getattr(one, name) for one in parts]) for name in ("mean", "cov", "radius"))
    placed = np.all(np.isfinite(lonlat_deg(position)), axis=0)
    normal = placed & np.all(np.isfinite(cov), axis=(1, 2))
    round_one = placed & ~normal & np.isfinite(radius)
    if not (normal | round_one).any():
        raise ValueError("none of the fixes has an error ellipse: there is nothing to draw.")
    values, vectors = np.linalg.eigh(np.where(normal[:, None, None], cov, 0.0))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :] * math.sqrt(-2.0 * math.log1p(-share))
    root = np.where(round_one[:, None, None], radius[:, None, None] * np.eye(2), root)
    rings = np.where(normal[:, None], mean, 0.0)[:, None, :] + np.moveaxis(root @ RING, 1, 2)
    with house_axes(ax, tall=0.8) as ax:
        _around(ax, position, placed)
        times = _times(ax, position, 2.0 * np.linalg.norm(root, axis=(1, 2))[normal | round_one], times)
        lon, lat = _places(position, times * rings)
        words = {f"{label}, {100.0 * share:g} %": (normal, "-"), f"circles of CE{100.0 * share:g}": (round_one, "--")}
        for text, (which, dashes) in words.items():
            lines = [np.stack([lon[k], lat[k]], axis=1) for k in np.flatnonzero(which)]
            style: dict[str, Any] = {"linewidths": 1.2, "linestyles": dashes, "zorder": 4.5, "label": f"_{text}"}
            if lines:
                ax.add_collection(LineCollection(lines, colors=FIX, path_effects=halo(2.4), **style), autolim=False)
                keyed(ax, text + _enlarged(times), color=FIX, linewidth=1.2, linestyle=dashes)
    return ax


def cloud_on_map(
    errors: Comparison | Sampled | Sequence[Comparison | Sampled],
    ax: Axes | None = None,
    *,
    times: float | None = None,
    label: str = "samples",
) -> Axes:
    """Sampled errors of one or several fixes, on a map about these fixes.

    Offsets are enlarged `times`, as in `ellipses_on_map`. Samples that jumped to other ground, as marked in a
    `Comparison`, are crosses. Raises `TypeError` for other records, `ValueError` for samples that were not kept.
    """
    clouds = [_kept(one) for one in ([errors] if isinstance(errors, Comparison | Sampled) else errors)]
    if not clouds:
        raise ValueError("errors must hold samples of one fix or more; got none.")
    position = _joined([one[0] for one in clouds])
    known = np.all(np.isfinite(lonlat_deg(position)), axis=0)
    with house_axes(ax, tall=0.8) as ax:
        _around(ax, position, known)
        sizes = np.array([2.0 * np.sqrt(np.mean(np.sum(points**2, axis=1))) for _, points, _ in clouds])
        times = _times(ax, position, sizes, times)
        dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "color": SAMPLE, "rasterized": True}
        crosses: dict[str, Any] = {"linestyle": "none", "marker": "x", "color": JUMPED, "markeredgewidth": 0.6}
        jumps = False
        for number, (_, points, jumped) in enumerate(clouds):
            one = jax.tree.map(lambda leaf, k=number: leaf[k : k + 1], position)
            lonlat = np.stack(_places(one, times * points[None]), axis=-1)[0]
            ax.plot(*lonlat[~jumped].T, label="_samples", alpha=0.6, markersize=2.2, zorder=3.4, **dots)
            if jumped.any():
                ax.plot(*lonlat[jumped].T, label="_jumped", markersize=2.6, zorder=3.5, rasterized=True, **crosses)
                jumps = True
        keyed(ax, f"{label}{_enlarged(times)}", markersize=6.0, **{**dots, "rasterized": False})
        if jumps:
            keyed(ax, "on other ground", markersize=4.5, **crosses)
    return ax


class _Normal(NamedTuple):
    """n fixes: positions, means (n, 2) and covariances (n, 2, 2) on the level plane in m and m2 (NaN where linear
    propagation is not valid), radii in m of the circles drawn instead, and their probability."""

    position: Geodetic
    mean: np.ndarray
    cov: np.ndarray
    radius: np.ndarray
    probability: float | None


def _normal(one: Any) -> _Normal:
    """Convert a record to `_Normal`."""
    if isinstance(one, Accuracy):
        position, mean, cov, radius = one.fix.position, one.bias_enu, one.cov_enu, one.circular
    else:
        check_is(one, Propagation, "found", "Make it with jaxgeo.uncertainty.propagate or accuracy.")
        position, mean, cov, radius = one.fix.position, one.bias_enu, one.cov_enu, np.nan
    flat = jax.tree.map(lambda leaf: np.ravel(np.asarray(leaf)), position)
    count = len(flat.lat)
    mean, cov = np.asarray(mean).reshape(count, 3)[:, :2], np.asarray(cov).reshape(count, 3, 3)[:, :2, :2]
    return _Normal(
        flat, mean, cov, np.broadcast_to(np.ravel(radius), (count,)), one.level() if isinstance(one, Accuracy) else None
    )


_RECORDS = (Propagation, Accuracy)


def _share(parts: Sequence[_Normal], probability: float | None) -> float:
    """The common probability of all ellipses and circles."""
    own = {one.probability for one in parts if one.probability is not None}
    share = probability if probability is not None else min(own, default=0.9)
    if not 0.0 < share < 1.0:
        raise ValueError(f"probability must lie between 0 and 1; got {share!r}.")
    if own - {share}:
        raise ValueError(f"probability must be that of the records of accuracy, {sorted(own)}; got {share!r}.")
    return share


def _joined(positions: Sequence[Geodetic]) -> Geodetic:
    return jax.tree.map(lambda *leaves: np.concatenate([np.ravel(leaf) for leaf in leaves]), *positions)


def _kept(one: Comparison | Sampled) -> tuple[Geodetic, np.ndarray, np.ndarray]:
    """(position of the fix, errors (n, 2) east and north of it, mask of those that jumped), subsampled."""
    sampled = one.sampled if isinstance(one, Comparison) else one
    check_is(sampled, Sampled, "errors", "Make them with jaxgeo.uncertainty.sample or compare.")
    if sampled.errors_enu is None:
        raise ValueError("the samples were not kept: sample again with keep=True.")
    beyond = one.beyond_gap if isinstance(one, Comparison) else None
    jumped = np.zeros(sampled.count, bool) if beyond is None else np.asarray(beyond, bool)
    found = np.flatnonzero(np.isfinite(sampled.errors_enu[:, 0]))
    found = found[:: max(1, -(-len(found) // MOST_POINTS))]
    points = (np.asarray(sampled.errors_enu) + np.asarray(sampled.centre_enu))[found, :2]
    return sampled.fix.position, points, jumped[found]


def _around(ax: Axes, position: Geodetic, known: np.ndarray) -> None:
    """Set limits about the fixes if the axes are empty."""
    lon, lat = (x[known] for x in lonlat_deg(position))
    degrees(ax, float(lat.mean()) if len(lat) else 0.0)
    if len(lat) and ax.get_autoscale_on() and not ax.has_data():
        margin = max(0.2 * float(np.ptp(lat)), 0.2 * float(np.ptp(lon)), 1e-3)
        ax.set(xlim=(lon.min() - margin, lon.max() + margin), ylim=(lat.min() - margin, lat.max() + margin))


def _times(ax: Axes, position: Geodetic, across: np.ndarray, times: float | None) -> float:
    """Enlargement factor for features `across` m wide."""
    if times is not None:
        if not (math.isfinite(times) and times > 0.0):
            raise ValueError(f"times must be a positive number; got {times!r}.")
        return times
    lat = float(np.nanmean(np.asarray(position.lat)))
    west, east = ax.get_xlim()
    width = math.radians(east - west) * float(radii_of_curvature(lat)[1]) * math.cos(lat)
    middle = float(np.median(across))
    return 1.0 if middle >= ENOUGH * width or middle <= 0.0 else max(round_length(SEEN * width / middle), 1.0)


def _places(position: Geodetic, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longitude and latitude in deg, (n, m), of offsets (n, m, 2) in m east and north of positions (n,)."""
    lat = np.asarray(position.lat)
    M, N = radii_of_curvature(lat)
    height = np.asarray(position.height)
    lon0, lat0 = lonlat_deg(position)
    east, north = offsets[..., 0], offsets[..., 1]
    lon = lon0[:, None] + np.degrees(east / ((N + height) * np.cos(lat))[:, None])
    return lon, lat0[:, None] + np.degrees(north / (M + height)[:, None])


def _enlarged(times: float) -> str:
    return "" if times == 1.0 else f", {times:g} times as large"

"""The cloud of a fix's sampled errors, over the ground that it lies on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxgeo._checks import check_is
from jaxgeo._typing import Vector3
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.fix import Fix
from jaxgeo.plot.maps import EDGE, _halo, _slopes
from jaxgeo.terrain import Dem
from jaxgeo.terrain.grid import surface_point
from jaxgeo.uncertainty import Comparison, Propagation, Sampled

MOST_POINTS = 4000  # of a cloud; more make it no clearer
ACROSS = 240  # places from side to side at which the ground of a picture is drawn, at least
INTERVALS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # m, between contour lines
# Okabe and Ito (2008), "Color universal design": told apart by all eyes, and in print by their lightness.
SAMPLE, JUMPED = "#0072b2", "#d55e00"
ELLIPSES = (("black", "--"), ("#e69f00", "-"), ("#cc79a7", "-."), ("#56b4e9", ":"))
CIRCLE = "#7a0177"
SHOWN = ("linear, facet", "linear, footprint")  # of a comparison; level ground would only be in the way
GREYS = matplotlib.colors.LinearSegmentedColormap.from_list("greys", ["#a8a8a8", "#fbfbfb"])


def error_cloud(
    errors: Comparison | Sampled,
    ax: Axes,
    *,
    dem: Dem | None = None,
    propagations: Mapping[str, Propagation] | None = None,
    jumped: Any = None,
    probabilities: Sequence[float] = (0.5, 0.9),
    reach: float | None = None,
) -> list[Line2D]:
    """Sampled errors of one fix in m east and north of it, over the ground there, and what linear propagation says.

    `errors` are samples that were kept; `jumped` (count,) marks those in another colour. `propagations` are drawn by
    name as ellipses that hold the `probabilities`, the samples' circular errors as circles. Of a comparison both are
    known: its samples beyond a gap, and linear propagation by facet and footprint. `reach` is half the side in m; if
    left out, that of all but the farthest 1 %. Returns handles for a legend. Raises `TypeError` for other
    records, `ValueError` for samples that were not kept, marks of another number, and a reach that is not positive.
    """
    sampled = errors.sampled if isinstance(errors, Comparison) else errors
    if isinstance(errors, Comparison):
        jumped = errors.beyond_gap if jumped is None else jumped
        if propagations is None:
            propagations = {name: one for name, one in errors.propagations.items() if name in SHOWN}
    check_is(sampled, Sampled, "errors", "Make them with jaxgeo.uncertainty.sample or compare.")
    points, marked = _kept(sampled, jumped)
    reach = _reach(points, reach)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="east, m", ylabel="north, m")
    if dem is not None:
        _ground(dem, sampled.fix, reach, ax)
    handles = _points(points, marked, ax)
    for number, (name, one) in enumerate((propagations or {}).items()):
        check_is(one, Propagation, name, "Make it with jaxgeo.uncertainty.propagate.")
        colour, line = ELLIPSES[number % len(ELLIPSES)]
        style = {"color": colour, "linestyle": line, "zorder": 6.0 - 0.1 * number}  # the first on top
        handles.append(_ellipses(name, one, probabilities, ax, style))
    handles.extend(_circles(sampled, probabilities, ax))
    (cross,) = ax.plot([0.0], [0.0], "+", color=EDGE, markersize=11, markeredgewidth=1.8, label="fix", zorder=7)
    cross.set_path_effects(_halo(3.5))
    _remark(sampled, points, reach, ax)
    return [*handles, cross]


def _kept(sampled: Sampled, jumped: Any) -> tuple[np.ndarray, np.ndarray]:
    """(errors east and north of the samples with a fix, which of them are marked)."""
    if sampled.errors_enu is None:
        raise ValueError("the samples were not kept: sample again with keep=True.")
    marked = np.zeros(sampled.count, bool) if jumped is None else np.asarray(jumped, bool)
    if marked.shape != (sampled.count,):
        raise ValueError(f"jumped must mark each of the {sampled.count} samples; got the shape {marked.shape}.")
    found = np.isfinite(sampled.errors_enu[:, 0])
    if not found.any():
        raise ValueError("none of the samples has a fix: there is nothing to draw.")
    return (sampled.errors_enu + sampled.centre_enu)[found, :2], marked[found]


def _reach(points: np.ndarray, reach: float | None) -> float:
    if reach is None:
        return 1.1 * float(np.quantile(np.abs(points).max(axis=1), 0.99)) or 1.0
    if not (math.isfinite(reach) and reach > 0.0):
        raise ValueError(f"reach must be a positive length in m; got {reach!r}.")
    return reach


def _points(points: np.ndarray, marked: np.ndarray, ax: Axes) -> list[Line2D]:
    """The cloud, thinned; handles for the kinds of samples that there are."""
    step = -(-len(points) // MOST_POINTS)
    points, marked = points[::step], marked[::step]
    size = 2.2 if len(points) > 1000 else 4.0
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "markeredgewidth": 0.0, "rasterized": True}
    handles = []
    for which, colour, label in ((~marked, SAMPLE, "samples"), (marked, JUMPED, "samples that jumped")):
        if which.any():
            ax.plot(*points[which].T, color=colour, markersize=size, alpha=0.5, zorder=3, **style)
            handles.append(Line2D([], [], color=colour, markersize=5.0, label=label, **style))
    return handles


def _ellipses(name: str, one: Propagation, probabilities: Sequence[float], ax: Axes, style: dict[str, Any]) -> Line2D:
    """The error ellipses of a propagation about its mean, the larger ones thicker."""
    values, vectors = np.linalg.eigh(np.asarray(one.cov_enu)[:2, :2])
    unit = (vectors * np.sqrt(np.maximum(values, 0.0))) @ _unit_circle()
    mean = np.asarray(one.bias_enu)[:2, None]
    for probability, width in _widths(probabilities):
        ring = mean + math.sqrt(-2.0 * math.log1p(-probability)) * unit
        ax.plot(*ring, linewidth=width, path_effects=_halo(width + 1.0), **style)
    return Line2D([], [], linewidth=1.8, label=f"{name}, {_percents(probabilities)}", **style)


def _circles(sampled: Sampled, probabilities: Sequence[float], ax: Axes) -> list[Line2D]:
    """Circles that hold shares of the samples; a radius without end is only named."""
    style: dict[str, Any] = {"color": CIRCLE, "linestyle": ":"}
    names = []
    for probability, width in _widths(probabilities):
        radius = sampled.circular_error(probability).value
        if math.isfinite(radius):
            ring = np.asarray(sampled.centre_enu)[:2, None] + radius * _unit_circle()
            ax.plot(*ring, linewidth=width, zorder=6, path_effects=_halo(width + 1.4), **style)
        names.append(f"CE{100.0 * probability:g} {_length(radius)}")
    return [Line2D([], [], linewidth=1.8, label=f"sampled {', '.join(names)}", **style)]


def _length(radius: float) -> str:
    if not math.isfinite(radius):
        return "without end"
    return f"{radius:.3g} m" if radius < 1000.0 else f"{radius:.0f} m"


def _unit_circle() -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    return np.stack([np.cos(turn), np.sin(turn)])


def _widths(probabilities: Sequence[float]) -> list[tuple[float, float]]:
    """Each probability, from the least on, with the width of its line."""
    for probability in probabilities:
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probabilities must lie between 0 and 1; got {probability!r}.")
    ordered = sorted(probabilities)
    return list(zip(ordered, np.linspace(1.9, 1.1, len(ordered))[::-1], strict=True))


def _percents(probabilities: Sequence[float]) -> str:
    return " and ".join(f"{100.0 * probability:g}" for probability in sorted(probabilities)) + " %"


def _remark(sampled: Sampled, points: np.ndarray, reach: float, ax: Axes) -> None:
    """What the picture does not show: samples outside it, and those without a fix."""
    outside = float(np.mean(np.abs(points).max(axis=1) > reach)) * sampled.found / sampled.count
    shares = ((outside, "outside the picture"), (1.0 - sampled.found / sampled.count, "without a fix"))
    said = [f"{100.0 * share:.2g} % {what}" for share, what in shares if share > 0.0]
    text = ", ".join([f"{sampled.count} samples", *said])
    style: dict[str, Any] = {"ha": "left", "va": "bottom", "fontsize": 8.5, "zorder": 8}
    ax.text(0.02, 0.02, text, transform=ax.transAxes, path_effects=_halo(3.0), **style)


def _ground(dem: Dem, fix: Fix, reach: float, ax: Axes) -> None:
    """The surface about a fix, as rays meet it: grey under an oblique light, with contour lines of height."""
    (east, north), heights = ground_about(dem, fix, reach)
    slope_east, slope_north = _slopes(heights, east, north)
    shade = (0.64 + 0.54 * (slope_east - slope_north)) / np.sqrt(1.0 + slope_east**2 + slope_north**2)
    ax.pcolormesh(
        east, north, np.clip(shade, 0.0, 1.0), cmap=GREYS, vmin=0.0, vmax=1.0, shading="gouraud", rasterized=True
    )
    margin = 1.1 * reach
    heights = np.where((np.abs(east) <= margin) & (np.abs(north) <= margin), heights, np.nan)  # no labels outside
    if not np.isfinite(heights).any():
        return
    low, high = np.nanmin(heights), np.nanmax(heights)
    interval = next((step for step in INTERVALS if (high - low) / step <= 12.0), INTERVALS[-1])
    levels = interval * np.arange(2.0 * np.floor(0.5 * low / interval), np.ceil(high / interval) + 1)  # even ones named
    lines = ax.contour(east, north, heights, levels, colors="#5b4a35", linewidths=0.6, alpha=0.8, zorder=1)
    ax.clabel(lines, levels[::2], fontsize=7, fmt=lambda level: f"{level:g} m")


def ground_about(dem: Dem, fix: Fix, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(east and north (2, rows, cols), height above WGS 84) in m of places on a terrain within `reach` of a fix.

    Voids are NaN. Raises `ValueError` where no post is near enough.
    """
    rowcol = np.asarray(dem.over(jnp.asarray(fix.ecef))[0])
    cells = np.ceil(1.5 * reach / np.asarray(dem.grid.cell_size())).astype(int) + 1
    extent = np.asarray(dem.extent)
    first = np.maximum(np.floor(rowcol).astype(int) - cells, 0)
    last = np.minimum(np.ceil(rowcol).astype(int) + cells, extent - 1)
    if not np.all(np.isfinite(rowcol)) or np.any(last - first < 1):
        raise ValueError("no ground of this terrain lies within reach of the fix.")
    row, col = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    step = max(1, math.ceil(max(len(row), len(col)) / 600))
    row, col = row[::step], col[::step]
    corner = np.asarray(dem.posts, np.float64)[np.ix_(row, col)]
    corner = np.where(np.asarray(dem.void)[np.ix_(row, col)], np.nan, corner)
    offsets = _offsets(dem, fix, row, col)
    finer = math.ceil(ACROSS / max(len(row), len(col)))
    east, north, height = (_between(part, finer) for part in (offsets[..., 0], offsets[..., 1], corner))
    return np.stack([east, north]), height


def _offsets(dem: Dem, fix: Fix, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """East, north, up of posts from a fix, m; of voids as if they lay at the fix's height."""
    R = R_ecef_from_enu(fix.position)
    height = jnp.asarray(fix.position.height)

    def one(rowcol: jax.Array, p_ecef: Vector3) -> Vector3:
        normal = dem.grid.normal(rowcol)
        return R.T @ (surface_point(normal) + height * normal - p_ecef)

    rowcol = jnp.asarray(np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1), jnp.float64)
    return np.asarray(jax.jit(jax.vmap(jax.vmap(one, (0, None)), (0, None)))(rowcol, jnp.asarray(fix.ecef)))


def _between(posts: np.ndarray, finer: int) -> np.ndarray:
    """Bilinear between posts, `finer` steps from one to the next."""
    for axis in (0, 1):
        count = posts.shape[axis]
        place = np.arange((count - 1) * finer + 1) / finer
        before = np.minimum(place.astype(int), count - 2)
        share = np.expand_dims(place - before, 1 - axis)
        here, following = (np.take(posts, before + k, axis=axis) for k in (0, 1))
        posts = here + share * (following - here)
    return posts

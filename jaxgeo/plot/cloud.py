"""Sampled errors of a fix compared with linear propagation, over the surrounding terrain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes

from jaxgeo._checks import check_is
from jaxgeo.earth._on_host import R_ecef_from_enu_of, ecef_of, normals_of
from jaxgeo.fix import Fix
from jaxgeo.plot.legends import keyed, legend_of
from jaxgeo.plot.maps import normals_at, places_of, slopes
from jaxgeo.plot.regions import draw_region
from jaxgeo.plot.style import INK, JUMPED, LINEAR, SAMPLE, SAMPLED, grid_behind, halo, house_axes, metres, percent
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import AccuracyCheck, Comparison, Propagation, Region, Sampled
from jaxgeo.uncertainty._region_words import area_words

MOST_POINTS = 5000  # drawn of a cloud; more do not make it clearer
ACROSS = 240  # minimum samples across the drawn terrain
INTERVALS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # m, between contour lines
SHOWN = ("linear, facet", "linear, footprint")  # of a comparison; level ground would clutter the figure
MOST = 0.99  # of the samples, and of those that jumped, within the default reach
FAR = 8.0  # times the largest circle: limit of the default reach
JUDGED = 0.9, 1  # probability of the CE by which a comparison rates methods, and its index
DASHES = (0, (4, 2))
GREYS = matplotlib.colors.LinearSegmentedColormap.from_list("greys", ["#b4b4b4", "#fdfdfd"])


def error_cloud(
    errors: AccuracyCheck | Comparison | Sampled,
    ax: Axes | None = None,
    *,
    dem: Dem | None = None,
    propagations: Mapping[str, Propagation] | None = None,
    jumped: Any = None,
    region: Region | Any = None,
    probability: float = 0.9,
    reach: float | None = None,
    legend: bool = True,
) -> Axes:
    """Sampled errors of one fix in m east and north of it, and the ellipses of linear propagation.

    `errors` are samples that were kept; `jumped` (count,) marks those on other ground, drawn as crosses. Full lines are
    covariance ellipses, dashed ones circles, both of `probability`; they agree in content for normal samples.
    `region`, the highest-density region of the samples (`Sampled.region`), is drawn as an area. `propagations`, up to
    three by name, are drawn beside the samples. An `AccuracyCheck` provides samples and one answer: the circle of its
    accuracy at its probability, the share of the samples within, and the ellipse if it is by linear propagation. A
    `Comparison` provides samples and linear propagation over facet and footprint, and its verdict is in the legend.
    With a `dem` the terrain about the fix is drawn below. `reach` is half the side in m. By default it holds 99 % of
    the samples, 99 % of those that jumped, and all circles, but at most eight times the largest circle; samples outside
    are counted in a note. Raises `TypeError` for other records, `ValueError` for samples that were not kept or have no
    fix, marks of another number, a probability outside (0, 1), more than three propagations and a reach that is not
    positive.
    """
    compared = errors if isinstance(errors, Comparison) else None
    checked = errors if isinstance(errors, AccuracyCheck) else None
    sampled = errors.sampled if isinstance(errors, AccuracyCheck | Comparison) else errors
    check_is(sampled, Sampled, "errors", "Make them with jaxgeo.uncertainty.check_accuracy, sample or compare.")
    assert isinstance(sampled, Sampled)
    if checked is not None:
        jumped = checked.beyond_gap if jumped is None else jumped
        probability = checked.accuracy.level()
    if compared is not None:
        jumped = compared.beyond_gap if jumped is None else jumped
        if propagations is None:
            propagations = {name: compared.propagations[name] for name in SHOWN if name in compared.propagations}
    linear = _checked(propagations or {})
    if region is not None:
        check_is(region, Region, "region", "Make it with Sampled.region.")
    points, marked = _kept(sampled, jumped)
    own = sampled.circular_error(probability).value if checked is None else float(checked.accuracy.circular)
    radii = [own, *(float(x.circular_error(probability)) for x in linear.values())]
    half = _reach(points, marked, [one for one in radii if math.isfinite(one)], reach)
    with house_axes(ax) as ax:
        ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="east, m", ylabel="north, m")
        grid_behind(ax)
        if dem is not None:
            _ground(dem, sampled.fix, half, ax)
        handles = _points(points, marked, sampled, ax)
        handles.append(_sampled(sampled, probability, ax) if checked is None else _checked_answer(checked, ax))
        if region is not None:
            share = f"{100.0 * region.probability:g} %"
            handles.append(draw_region(ax, region, f"{share} region, {area_words(region.area)}"))
        for colour, (name, one) in zip(LINEAR, linear.items(), strict=False):
            judged = _judged(compared, name) if probability == JUDGED[0] else ""
            handles.append(_linear(name, one, probability, colour, judged, ax))
        ax.plot([0.0], [0.0], "+", color=INK, markersize=8.0, markeredgewidth=1.2, zorder=7, label="_fix")
        ax.lines[-1].set_path_effects(halo(3.0))
        share = f"{100.0 * probability:g} %"
        handles.append(keyed(ax, f"ellipse of the covariance, {share}", color="0.4", linewidth=1.0))
        handles.append(keyed(ax, f"circle of {share}, CE{share[:-2]}", color="0.4", linewidth=1.0, linestyle=DASHES))
        if legend:
            legend_of(ax, handles, beside=True, title=_remark(sampled, errors, points, half))
    return ax


def _checked(propagations: Mapping[str, Propagation]) -> dict[str, Propagation]:
    if len(propagations) > len(LINEAR):
        raise ValueError(f"propagations must be {len(LINEAR)} or fewer; got {len(propagations)}.")
    for name, one in propagations.items():
        check_is(one, Propagation, name, "Make it with jaxgeo.uncertainty.propagate.")
    return dict(propagations)


def _kept(sampled: Sampled, jumped: Any) -> tuple[np.ndarray, np.ndarray]:
    """(errors east and north of the samples with a fix, mask of the marked ones)."""
    if sampled.errors_enu is None:
        raise ValueError("the samples were not kept: sample again with keep=True.")
    marked = np.zeros(sampled.count, bool) if jumped is None else np.asarray(jumped, bool)
    if marked.shape != (sampled.count,):
        raise ValueError(f"jumped must mark each of the {sampled.count} samples; got the shape {marked.shape}.")
    found = np.isfinite(sampled.errors_enu[:, 0])
    if not found.any():
        raise ValueError("none of the samples has a fix: there is nothing to draw.")
    return (sampled.errors_enu + sampled.centre_enu)[found, :2], marked[found]


def _reach(points: np.ndarray, marked: np.ndarray, circles: list[float], reach: float | None) -> float:
    """Half the side of the figure, m."""
    if reach is None:
        away = np.abs(points).max(axis=1)
        far = [float(np.quantile(away[kind], MOST)) for kind in (~marked, marked) if kind.any()]
        most = FAR * max(circles) if circles else math.inf
        return 1.06 * max(min(max(far), most), *circles, 1e-3)
    if not (math.isfinite(reach) and reach > 0.0):
        raise ValueError(f"reach must be a positive length in m; got {reach!r}.")
    return reach


def _points(points: np.ndarray, marked: np.ndarray, sampled: Sampled, ax: Axes) -> list[Any]:
    """Draw the cloud, subsampled; returns handles with the sample counts."""
    share = float(np.count_nonzero(marked)) / sampled.count
    step = -(-len(points) // MOST_POINTS)
    points, marked = points[::step], marked[::step]
    dots: dict[str, Any] = {"marker": "o", "color": SAMPLE, "linestyle": "none", "markeredgewidth": 0.0}
    size = 1.9 if len(points) > 1500 else 2.8
    ax.plot(*points[~marked].T, alpha=0.7, markersize=size, rasterized=True, zorder=2, label="_samples", **dots)
    handles = [keyed(ax, f"{sampled.count:,} samples".replace(",", " "), markersize=4.0, **dots)]
    if marked.any():
        cross: dict[str, Any] = {"marker": "x", "color": JUMPED, "linestyle": "none", "markeredgewidth": 0.6}
        ax.plot(*points[marked].T, markersize=2.6, rasterized=True, zorder=3, label="_jumped", **cross)
        handles.append(keyed(ax, f"on other ground, {percent(share)}", markersize=4.5, **cross))
    return handles


def _sampled(sampled: Sampled, probability: float, ax: Axes) -> Any:
    """Draw the ellipse and circle of the samples."""
    figure = sampled.circular_error(probability)
    style: dict[str, Any] = {"color": SAMPLED, "linewidth": 1.8}
    mean, centre = np.asarray(sampled.mean_enu)[:2], np.asarray(sampled.centre_enu)[:2]
    _ellipse("sampled", mean, np.asarray(sampled.cov_enu)[:2, :2], probability, ax, {**style, "zorder": 5})
    _circle("sampled", centre, figure.value, ax, {**style, "zorder": 5})
    between = f" ({figure.low:.3g} to {figure.high:.3g})" if math.isfinite(figure.high) else ""
    return keyed(ax, f"sampled: CE{100.0 * probability:g} {metres(figure.value)}{between}", **style)


def _checked_answer(checked: AccuracyCheck, ax: Axes) -> Any:
    """Draw the circle of an accuracy, and its ellipse if it has one."""
    answer, radius = checked.accuracy, float(checked.accuracy.circular)
    style: dict[str, Any] = {"color": SAMPLED, "linewidth": 1.8}
    if np.isfinite(np.asarray(answer.cov_enu)).all():
        mean, cov = np.asarray(answer.bias_enu)[:2], np.asarray(answer.cov_enu)[:2, :2]
        _ellipse("linear", mean, cov, answer.level(), ax, {**style, "zorder": 5})
    _circle("accuracy", np.zeros(2), radius, ax, {**style, "zorder": 5})
    return keyed(ax, f"CE{100.0 * answer.level():g} {metres(radius)}, by {answer.words}", **style)


def _linear(name: str, one: Propagation, probability: float, colour: str, judged: str, ax: Axes) -> Any:
    """Draw the ellipse and circle of one linear method; the label tells whether the samples confirm its CE."""
    radius = float(one.circular_error(probability))
    style: dict[str, Any] = {"color": colour, "linewidth": 1.4}
    mean, cov = np.asarray(one.bias_enu)[:2], np.asarray(one.cov_enu)[:2, :2]
    _ellipse(name, mean, cov, probability, ax, {**style, "zorder": 6})
    _circle(name, np.zeros(2), radius, ax, {**style, "zorder": 6})
    return keyed(ax, f"{name}: CE{100.0 * probability:g} {metres(radius)}{judged}", **style)


def _judged(compared: Comparison | None, name: str) -> str:
    rows = [] if compared is None else [row for row in compared.rows if row.method == name]
    return f", {rows[0].validity[JUDGED[1]]}" if rows else ""


def _ellipse(name: str, mean: np.ndarray, cov: np.ndarray, probability: float, ax: Axes, style: dict[str, Any]) -> None:
    """Draw the ellipse that contains a share of a normal distribution."""
    values, vectors = np.linalg.eigh(cov)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) * math.sqrt(-2.0 * math.log1p(-probability))
    edge = halo(style["linewidth"] + 1.0)
    ax.plot(*(mean[:, None] + root @ unit_circle()), label=f"_ellipse, {name}", path_effects=edge, **style)


def _circle(name: str, centre: np.ndarray, radius: float, ax: Axes, style: dict[str, Any]) -> None:
    """Draw a circle, unless its radius is infinite."""
    if math.isfinite(radius):
        ring = centre[:, None] + radius * unit_circle()
        ax.plot(*ring, linestyle=DASHES, label=f"_circle, {name}", **style)


def unit_circle() -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, 241)
    return np.stack([np.cos(turn), np.sin(turn)])


def _remark(sampled: Sampled, errors: Any, points: np.ndarray, reach: float) -> str:
    """Note: what the samples say of the answer, samples outside the figure, and samples without a fix."""
    outside = float(np.mean(np.abs(points).max(axis=1) > reach)) * sampled.found / sampled.count
    said = [errors.words] if isinstance(errors, AccuracyCheck) else []
    said += [errors.verdict] if isinstance(errors, Comparison) else []
    said += [f"Outside the picture: {percent(outside)}."] if outside > 0.0 else []
    if errors is sampled and sampled.found < sampled.count:
        said.append(f"Without a fix: {percent(1.0 - sampled.found / sampled.count)}.")
    return " ".join(said)


def _ground(dem: Dem, fix: Fix, reach: float, ax: Axes) -> None:
    """Draw the terrain about a fix as rays intersect it: grey relief with height contours."""
    (east, north), heights = ground_about(dem, fix, reach)
    slope_east, slope_north = slopes(heights, east, north)
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
    lines = ax.contour(east, north, heights, levels, colors="#6b5a45", linewidths=0.6, alpha=0.8, zorder=1)
    ax.clabel(lines, levels[::2], fontsize="x-small", fmt=lambda level: f"{level:g} m")


def ground_about(dem: Dem, fix: Fix, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(east and north (2, rows, cols), height above WGS 84) in m of points on a terrain within `reach` of a fix.

    Voids are NaN. Raises `ValueError` where no post is within reach.
    """
    below = normals_of(float(fix.position.lat), float(fix.position.lon))
    rowcol = places_of(dem, below[None, :])[0]
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
    """East, north, up of posts from a fix, m; voids are placed at the fix's height."""
    normals = normals_at(dem, np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1).reshape(-1, 2).astype(float))
    lat, lon, height = (float(x) for x in (fix.position.lat, fix.position.lon, fix.position.height))
    offsets = (ecef_of(normals, height) - np.asarray(fix.ecef)) @ R_ecef_from_enu_of(lat, lon)
    return offsets.reshape(len(row), len(col), 3)


def _between(posts: np.ndarray, finer: int) -> np.ndarray:
    """Bilinear interpolation between posts, in `finer` steps per cell."""
    for axis in (0, 1):
        count = posts.shape[axis]
        place = np.arange((count - 1) * finer + 1) / finer
        before = np.minimum(place.astype(int), count - 2)
        share = np.expand_dims(place - before, 1 - axis)
        here, following = (np.take(posts, before + k, axis=axis) for k in (0, 1))
        posts = here + share * (following - here)
    return posts

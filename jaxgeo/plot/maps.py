"""Maps of terrain and fixes, in degrees of longitude and latitude."""

from __future__ import annotations

import math
from typing import Any

import jax
import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D

from jaxgeo._checks import check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.earth._on_host import normals_of
from jaxgeo.earth.geodetic import check_position
from jaxgeo.fix import Fix
from jaxgeo.plot.close_up import Posts, interpolated
from jaxgeo.plot.legends import keyed
from jaxgeo.plot.style import CAMERA, FIX, HIDDEN, INK, SIGHT, halo, house_axes, round_length
from jaxgeo.status import Status
from jaxgeo.terrain import Dem, GeographicGrid

MOST_POSTS = 1200  # per side of a figure; larger terrain is subsampled
BLOCK = 16_384  # places of a grid that are computed together
ALONE = 0.02  # deg: margin about an isolated point
STEPS = [1, 2, 5, 10]  # of ticks, times a power of ten
ARROWHEAD = Path([(0.0, 1.0), (-0.62, -0.8), (0.0, -0.45), (0.62, -0.8), (0.0, 1.0)], closed=True)  # to the north
TICK = 60.0  # points: width of a degree label
# Green valleys, tan slopes, light summits: muted, so that layers on top stand out.
RELIEF = matplotlib.colors.LinearSegmentedColormap.from_list(
    "relief", ["#93b48b", "#c5cf9f", "#e6dcb4", "#d3b78f", "#c09a80", "#efe9e4"]
)


def lonlat_deg(position: Geodetic) -> tuple[np.ndarray, np.ndarray]:
    """(longitude, latitude) in deg as NumPy arrays, in the order of axes."""
    check_position(position, "position")
    return np.asarray(np.rad2deg(position.lon)), np.asarray(np.rad2deg(position.lat))


def post_positions(dem: Dem, step: int = 1) -> Geodetic:
    """Every `step`-th post of a terrain as positions (rows, cols), with their ellipsoidal heights."""
    rows, cols = (int(n) for n in np.asarray(dem.extent))
    row, col = np.meshgrid(np.arange(0, rows, step), np.arange(0, cols, step), indexing="ij")
    normal = normals_at(dem, np.stack([row, col], axis=-1).reshape(-1, 2).astype(float)).reshape(*row.shape, 3)
    lat, lon = (
        np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1])),
        np.arctan2(normal[..., 1], normal[..., 0]),
    )
    centre = lon[lon.shape[0] // 2, lon.shape[1] // 2]
    lon = centre + np.remainder(lon - centre + np.pi, 2.0 * np.pi) - np.pi  # no jump at the date line
    return Geodetic(lat=lat, lon=lon, height=np.asarray(dem.posts, np.float64)[row, col])


def normals_at(dem: Dem, rowcol: np.ndarray) -> np.ndarray:
    """Ellipsoid normals (n, 3) at places (n, 2) on the grid of a terrain."""
    if isinstance(dem.grid, GeographicGrid):  # compiles nothing
        lon, lat = dem.grid.lonlat_at(rowcol).T
        return normals_of(lat, lon)
    return _in_blocks(_normals_of, dem.grid, rowcol)


def places_of(dem: Dem, normals: np.ndarray) -> np.ndarray:
    """Places (n, 2) on the grid of a terrain with ellipsoid normals (n, 3)."""
    if isinstance(dem.grid, GeographicGrid):
        x, y, z = normals.T
        return dem.grid.places_of(np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=1))
    return _in_blocks(_places_of, dem.grid, normals)


def _in_blocks(program: Any, grid: Any, rows: np.ndarray) -> np.ndarray:
    """`program` of rows, in blocks of one size, so that it is compiled once for any number of them."""
    padded = np.pad(rows, ((0, -len(rows) % BLOCK), (0, 0)), "edge")
    blocks = [np.asarray(program(grid, padded[start : start + BLOCK])) for start in range(0, len(rows), BLOCK)]
    return np.concatenate(blocks)[: len(rows)]


@quick_filter_jit
def _normals_of(grid: Any, rowcol: Any) -> Any:
    return jax.vmap(grid.normal)(rowcol)


@quick_filter_jit
def _places_of(grid: Any, normals: Any) -> Any:
    return jax.vmap(grid.rowcol)(normals)


def radii_of_curvature(lat: np.ndarray | float) -> tuple[Any, Any]:
    """Radii of curvature of the ellipsoid in the meridian and the prime vertical, m, at latitudes in rad."""
    flattened = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    return WGS84.a * (1.0 - WGS84.e2) / flattened**1.5, WGS84.a / np.sqrt(flattened)


def map_axes(dem: Dem, ax: Axes | None = None) -> Axes:
    """Map axes: limits of the terrain, equal scale north and east, tick labels in degrees."""
    check_is(dem, Dem, "dem", "Read one with jaxgeo.io.read_dem.")
    with house_axes(ax, tall=0.8) as ax:
        lon, lat = lonlat_deg(post_positions(dem, step=max(1, int(np.min(np.asarray(dem.extent))) // 32)))
        ax.set(xlim=(lon.min(), lon.max()), ylim=(lat.min(), lat.max()))
        degrees(ax, float(lat.mean()))
    return ax


def degrees(ax: Axes, lat_deg: float) -> None:
    """Set equal scale north and east at a latitude, and tick labels in degrees."""
    if ax.get_gid() == "jaxgeo: degrees":
        return
    ax.set_gid("jaxgeo: degrees")
    ax.set_aspect(1.0 / math.cos(math.radians(lat_deg)))
    ax.set(xlabel="longitude, °", ylabel="latitude, °")
    for axis, signs in ((ax.xaxis, "EW"), (ax.yaxis, "NS")):
        axis.set_major_formatter(FuncFormatter(lambda value, _, axis=axis, signs=signs: _named(axis, value, signs)))
    figure = ax.get_figure(root=True)
    assert figure is not None
    across = 72.0 * figure.get_figwidth() * ax.get_position().width
    ax.xaxis.set_major_locator(MaxNLocator(int(np.clip(across / TICK, 2, 7)), steps=STEPS))
    ax.yaxis.set_major_locator(MaxNLocator(7, steps=STEPS))


def _named(axis: Any, value: float, signs: str) -> str:
    """A tick label in degrees, with the decimals that all ticks need."""
    ticks = np.asarray(axis.get_majorticklocs(), float)
    step = float(np.min(np.diff(ticks), initial=1.0))
    decimals = next((n for n in range(8) if np.all(np.abs(np.round(ticks, n) - ticks) < 0.05 * step)), 8)
    turned = math.remainder(value, 360.0) if signs == "EW" else value
    return f"{abs(turned):.{decimals}f}° {signs[0] if turned >= 0 else signs[1]}"


def hillshade(dem: Dem, ax: Axes | None = None, **light: float) -> Axes:
    """Terrain in muted colours under an oblique light, as computed by `shaded_relief`; voids stay blank.

    If limits of the axes are set that show fewer than 100 posts, the relief is interpolated, for display only.
    """
    check_is(dem, Dem, "dem", "Read one with jaxgeo.io.read_dem.")
    step = max(1, math.ceil(int(np.max(np.asarray(dem.extent))) / MOST_POSTS))
    position, height = _known_posts(dem, step)
    posts = Posts(*lonlat_deg(position), height)
    with house_axes(ax, tall=0.8) as ax:
        lon, lat, height = interpolated(posts, ax)
        fine = Geodetic(lat=np.radians(lat), lon=np.radians(lon), height=height)
        rgba = _shaded(fine, height, _colour_range(posts.height), **light)
        ax.pcolormesh(lon, lat, rgba, shading="nearest", rasterized=True, zorder=0)
        degrees(ax, float(lat.mean()))
    return ax


def shaded_relief(
    dem: Dem,
    step: int = 1,
    *,
    light_azimuth_deg: float = 315.0,
    light_elevation_deg: float = 40.0,
    exaggeration: float = 1.5,
) -> np.ndarray:
    """Colours (rows, cols, red green blue alpha) of every `step`-th post, on any grid; voids are transparent."""
    return _shaded(
        *_known_posts(dem, step),
        light_azimuth_deg=light_azimuth_deg,
        light_elevation_deg=light_elevation_deg,
        exaggeration=exaggeration,
    )


def _known_posts(dem: Dem, step: int) -> tuple[Geodetic, np.ndarray]:
    """(positions of every `step`-th post, their heights with NaN for voids)."""
    position = post_positions(dem, step)
    rows, cols = (int(n) for n in np.asarray(dem.extent))
    return position, np.where(np.asarray(dem.void)[:rows:step, :cols:step], np.nan, np.asarray(position.height))


def _shaded(
    position: Geodetic,
    height: np.ndarray,
    between: tuple[float, float] | None = None,
    *,
    light_azimuth_deg: float = 315.0,
    light_elevation_deg: float = 40.0,
    exaggeration: float = 1.5,
) -> np.ndarray:
    """`relief_colours` of heights at positions."""
    light = math.radians(light_azimuth_deg), math.radians(light_elevation_deg)
    return relief_colours(height, *plane(position), light=light, exaggeration=exaggeration, between=between)


def _colour_range(height: np.ndarray) -> tuple[float, float]:
    """Lowest and highest height in m of the colour scale."""
    low, high = np.nanpercentile(height, [1.0, 99.5])
    return float(low), float(high)


def relief_colours(
    height: np.ndarray,
    east: np.ndarray,
    north: np.ndarray,
    *,
    light: tuple[float, float] = (math.radians(315.0), math.radians(40.0)),
    exaggeration: float = 1.5,
    between: tuple[float, float] | None = None,
) -> np.ndarray:
    """Colours (rows, cols, red green blue alpha) of heights in m at points in m; NaN is transparent.

    `light` is the azimuth and the elevation of the light in rad; the colour scale spans `between`, by default the
    lowest and highest of these heights.
    """
    slope_east, slope_north = slopes(height, east, north)
    normal = np.stack([-exaggeration * slope_east, -exaggeration * slope_north, np.ones_like(height)])
    azimuth, elevation = light
    horizontal = math.cos(elevation)
    towards = np.array([horizontal * math.sin(azimuth), horizontal * math.cos(azimuth), math.sin(elevation)])
    shade = np.tensordot(towards, normal / np.linalg.norm(normal, axis=0), axes=1) / math.sin(elevation)
    low, high = _colour_range(height) if between is None else between
    rgb = RELIEF((height - low) / max(high - low, 1.0))[..., :3]
    rgb = rgb * (0.25 + 0.75 * np.clip(shade, 0.0, 1.0))[..., None]
    rgb = rgb + (1.0 - rgb) * 0.6 * np.clip(shade - 1.0, 0.0, 0.6)[..., None]
    known = np.isfinite(shade)[..., None]
    return np.clip(np.where(known, np.concatenate([rgb, known], axis=-1), 0.0), 0.0, 1.0)


def hidden_ground(
    dem: Dem, hidden: np.ndarray, ax: Axes | None = None, *, label: str = "hidden from the camera"
) -> Axes:
    """Mark posts (rows, cols) hidden by terrain. Raises `ValueError` for a mask of another shape."""
    shape = tuple(int(n) for n in np.asarray(dem.extent))
    if np.shape(hidden) != shape:
        raise ValueError(f"hidden must flag each post, {shape}; got the shape {np.shape(hidden)}.")
    colour = (*matplotlib.colors.to_rgb(HIDDEN), 0.55)
    lon, lat = lonlat_deg(post_positions(dem))
    with house_axes(ax, tall=0.8) as ax:
        rgba = np.where(hidden[..., None], np.array(colour), 0.0)
        ax.pcolormesh(lon, lat, rgba, shading="nearest", rasterized=True, zorder=1)
        keyed(ax, label, area=True, facecolor=colour)
        degrees(ax, float(lat.mean()))
    return ax


def sight_lines(origin: Geodetic, fix: Fix, ax: Axes | None = None, *, label: str = "lines of sight") -> Axes:
    """Map lines from the camera to each fix of a batch (n,) that has coordinates."""
    check_is(fix, Fix, "fix", "Make one with jaxgeo.locate.")
    lon, lat = (np.ravel(x) for x in lonlat_deg(fix.position))
    lon0, lat0 = (float(x) for x in lonlat_deg(origin))
    known = np.isfinite(lon)
    segments = [[(lon0, lat0), point] for point in zip(lon[known], lat[known], strict=True)]
    with house_axes(ax, tall=0.8) as ax:
        lines = LineCollection(segments, colors=SIGHT, linewidths=0.7, alpha=0.6, zorder=3)
        ax.add_collection(lines, autolim=ax.get_autoscale_on() and not ax.has_data())
        keyed(ax, label, color=SIGHT, linewidth=1.2)
        degrees(ax, lat0)
        ax.autoscale_view()
    return ax


def fixes(fix: Fix, ax: Axes | None = None, *, label: str = "fixes") -> Axes:
    """A marker for each fix of a batch that has coordinates: filled if its status is ok, else open."""
    check_is(fix, Fix, "fix", "Make one with jaxgeo.locate.")
    lon, lat = (np.ravel(x) for x in lonlat_deg(fix.position))
    known, ok = np.isfinite(lon), np.ravel(np.asarray(fix.status) == Status.hit)
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": FIX, "zorder": 5}
    with house_axes(ax, tall=0.8) as ax:
        if (known & ~ok).any():
            others = f"{label}, with reserve" if ok.any() else label
            ax.plot(lon[known & ~ok], lat[known & ~ok], markerfacecolor="white", label=others, **style)
        ax.plot(
            lon[known & ok],
            lat[known & ok],
            markeredgecolor="white",
            markeredgewidth=0.8,
            label=label if ok.any() else f"_{label}",
            **style,
        )
        degrees(ax, float(np.mean(lat[known])) if known.any() else 0.0)
    return ax


def camera(position: Geodetic, heading: float, ax: Axes | None = None, *, label: str = "camera") -> Axes:
    """The camera as an arrowhead along its heading in rad; if outside the axes, an arrow at their edge."""
    lon, lat = (float(x) for x in lonlat_deg(position))
    marker = MarkerStyle(ARROWHEAD, transform=Affine2D().rotate(-heading))
    style: dict[str, Any] = {"color": CAMERA, "markersize": 13.0, "markeredgecolor": "white", "zorder": 6}
    with house_axes(ax, tall=0.8) as ax:
        if ax.has_data() or not ax.get_autoscale_on():
            (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
            if not (west <= lon <= east and south <= lat <= north):
                centre = ((west + east) / 2.0, (south + north) / 2.0)
                across, up = (east - west) / 2.0, (north - south) / 2.0
                reach = max(abs(lon - centre[0]) / across, abs(lat - centre[1]) / up)
                lon, lat = (c + (value - c) * 0.96 / reach for c, value in zip(centre, (lon, lat), strict=True))
        else:
            ax.set(xlim=(lon - ALONE, lon + ALONE), ylim=(lat - ALONE, lat + ALONE))
        ax.plot([lon], [lat], linestyle="none", marker=marker, label=label, **style)
        degrees(ax, lat)
    return ax


def scale_bar(ax: Axes, length_m: float | None = None, *, anchor: tuple[float, float] = (0.05, 0.05)) -> Axes:
    """A scale bar of a round length, about a fifth of the map, at `anchor` in fractions of the axes."""
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    lat = math.radians(south + anchor[1] * (north - south))
    metres_per_degree = math.radians(1.0) * float(radii_of_curvature(lat)[1]) * math.cos(lat)
    length = length_m or round_length(0.2 * (east - west) * metres_per_degree)
    x0, y0 = west + anchor[0] * (east - west), south + anchor[1] * (north - south)
    x1 = x0 + length / metres_per_degree
    style: dict[str, Any] = {"color": INK, "linewidth": 3.0, "solid_capstyle": "butt", "zorder": 7}
    ax.plot([x0, x1], [y0, y0], path_effects=halo(5.5), label="_scale", **style)
    text = f"{length / 1000.0:g} km" if length >= 1000.0 else f"{length:g} m"
    y_text = y0 + 0.012 * (north - south)
    ax.text((x0 + x1) / 2, y_text, text, ha="center", va="bottom", path_effects=halo(2.5), zorder=7)
    return ax


def north_arrow(ax: Axes, *, anchor: tuple[float, float] = (0.94, 0.9)) -> Axes:
    """An arrow to true north, at `anchor` in fractions of the axes."""
    x, y = anchor
    arrow = {"arrowstyle": "-|>", "linewidth": 1.6, "color": INK, "path_effects": halo(3.0)}
    ax.annotate("", (x, y + 0.06), (x, y - 0.02), xycoords="axes fraction", arrowprops=arrow, zorder=7)
    style: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": "large", "fontweight": "bold", "zorder": 7}
    ax.text(x, y - 0.025, "N", transform=ax.transAxes, path_effects=halo(2.5), **style)
    return ax


def plane(position: Geodetic) -> tuple[np.ndarray, np.ndarray]:
    """(east, north) in m about the centre, accurate enough for slopes."""
    lat, lon = np.asarray(position.lat), np.asarray(position.lon)
    M, N = radii_of_curvature(lat.mean())
    return N * np.cos(lat) * (lon - lon.mean()), M * (lat - lat.mean())


def slopes(height: np.ndarray, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d height / d east and d north, from differences along rows and columns of any orientation."""
    (h_r, h_c), (e_r, e_c), (n_r, n_c) = np.gradient(height), np.gradient(east), np.gradient(north)
    determinant = e_r * n_c - e_c * n_r
    return (h_r * n_c - h_c * n_r) / determinant, (e_r * h_c - e_c * h_r) / determinant

"""Maps of terrain and fixes, in degrees of longitude and latitude."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.colors
import matplotlib.patheffects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.terrain import Dem

MOST_POSTS = 1200  # along one side of a picture; larger terrain is thinned
SIGHT, FIX, EDGE, HIDDEN = "#1f5fbf", "#d7301f", "#111111", "#7a0177"
# Valleys green, slopes tan, summits light: quiet, so that what is drawn on top is seen.
RELIEF = matplotlib.colors.LinearSegmentedColormap.from_list(
    "relief", ["#93b48b", "#c5cf9f", "#e6dcb4", "#d3b78f", "#c09a80", "#efe9e4"]
)


def lonlat_deg(position: Geodetic) -> tuple[np.ndarray, np.ndarray]:
    """(longitude, latitude) in deg as NumPy arrays, in the order of axes."""
    lat, lon, _ = position.to_degrees()
    return np.asarray(lon), np.asarray(lat)


def post_positions(dem: Dem, step: int = 1) -> Geodetic:
    """Every `step`-th post of a terrain as positions (rows, cols), with their ellipsoidal heights."""
    rows, cols = (int(n) for n in np.asarray(dem.extent))
    row, col = np.meshgrid(np.arange(0, rows, step), np.arange(0, cols, step), indexing="ij")
    rowcol = jnp.asarray(np.stack([row, col], axis=-1), jnp.float64)
    normal = np.asarray(jax.jit(jax.vmap(jax.vmap(dem.grid.normal)))(rowcol))
    lat, lon = (
        np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1])),
        np.arctan2(normal[..., 1], normal[..., 0]),
    )
    centre = lon[lon.shape[0] // 2, lon.shape[1] // 2]
    lon = centre + np.remainder(lon - centre + np.pi, 2.0 * np.pi) - np.pi  # no jump at the date line
    return Geodetic(lat=lat, lon=lon, height=np.asarray(dem.posts, np.float64)[row, col])


def map_axes(ax: Axes, dem: Dem) -> None:
    """Limits of the terrain, equal lengths north and east, and degrees as labels."""
    lon, lat = lonlat_deg(post_positions(dem, step=max(1, int(np.min(np.asarray(dem.extent))) // 32)))
    ax.set_xlim(lon.min(), lon.max())
    ax.set_ylim(lat.min(), lat.max())
    ax.set_aspect(1.0 / math.cos(math.radians(float(lat.mean()))))
    ax.xaxis.set_major_formatter(lambda value, _: f"{abs(value):.2f}° {'E' if value >= 0 else 'W'}")
    ax.yaxis.set_major_formatter(lambda value, _: f"{abs(value):.2f}° {'N' if value >= 0 else 'S'}")
    ax.tick_params(labelsize=9)


def hillshade(dem: Dem, ax: Axes, **light: float) -> None:
    """Terrain in quiet colours under an oblique light, as `shaded_relief` makes it; voids stay blank."""
    step = max(1, math.ceil(int(np.max(np.asarray(dem.extent))) / MOST_POSTS))
    rgba = shaded_relief(dem, step, **light)
    ax.pcolormesh(*lonlat_deg(post_positions(dem, step)), rgba, shading="nearest", rasterized=True, zorder=0)


def shaded_relief(
    dem: Dem,
    step: int = 1,
    *,
    light_azimuth_deg: float = 315.0,
    light_elevation_deg: float = 40.0,
    exaggeration: float = 1.5,
) -> np.ndarray:
    """Colours (rows, cols, red green blue alpha) of every `step`-th post, on any grid; voids are transparent."""
    position = post_positions(dem, step)
    rows, cols = (int(n) for n in np.asarray(dem.extent))
    height = np.where(np.asarray(dem.void)[:rows:step, :cols:step], np.nan, np.asarray(position.height))
    slope_east, slope_north = _slopes(height, *_plane(position))
    normal = np.stack([-exaggeration * slope_east, -exaggeration * slope_north, np.ones_like(height)])
    azimuth, elevation = math.radians(light_azimuth_deg), math.radians(light_elevation_deg)
    horizontal = math.cos(elevation)
    light = np.array([horizontal * math.sin(azimuth), horizontal * math.cos(azimuth), math.sin(elevation)])
    shade = np.tensordot(light, normal / np.linalg.norm(normal, axis=0), axes=1) / math.sin(elevation)
    low, high = np.nanpercentile(height, [1.0, 99.5])
    rgb = RELIEF((height - low) / max(high - low, 1.0))[..., :3]
    rgb = rgb * (0.25 + 0.75 * np.clip(shade, 0.0, 1.0))[..., None]
    rgb = rgb + (1.0 - rgb) * 0.6 * np.clip(shade - 1.0, 0.0, 0.6)[..., None]
    known = np.isfinite(shade)[..., None]
    return np.clip(np.where(known, np.concatenate([rgb, known], axis=-1), 0.0), 0.0, 1.0)


def hidden_ground(dem: Dem, hidden: np.ndarray, ax: Axes, *, label: str = "hidden from the camera") -> Patch:
    """Marks posts (rows, cols) that terrain hides; returns the patch for a legend."""
    colour = (*matplotlib.colors.to_rgb(HIDDEN), 0.55)
    rgba = np.where(hidden[..., None], np.array(colour), 0.0)
    ax.pcolormesh(*lonlat_deg(post_positions(dem)), rgba, shading="nearest", rasterized=True, zorder=1)
    return Patch(facecolor=colour, label=label)


def footprint(outline: Geodetic, ax: Axes, *, label: str = "footprint") -> Line2D:
    """Outline of what an image sees: positions (n,) in order; a gap where one is unknown."""
    lon, lat = lonlat_deg(outline)
    style: dict[str, Any] = {"color": EDGE, "linewidth": 1.8, "label": label, "zorder": 4}
    (line,) = ax.plot(np.append(lon, lon[0]), np.append(lat, lat[0]), path_effects=_halo(3.2), **style)
    return line


def sight_lines(origin: Geodetic, fix: Fix, ax: Axes, *, label: str = "lines of sight") -> Line2D:
    """A line on the map from the camera to each fix of a batch (n,) that has coordinates."""
    lon, lat = (np.ravel(x) for x in lonlat_deg(fix.position))
    lon0, lat0 = (float(x) for x in lonlat_deg(origin))
    known = np.isfinite(lon)
    segments = [[(lon0, lat0), point] for point in zip(lon[known], lat[known], strict=True)]
    ax.add_collection(LineCollection(segments, colors=SIGHT, linewidths=0.7, alpha=0.6, zorder=3), autolim=False)
    return Line2D([], [], color=SIGHT, linewidth=1.2, label=label)


def fixes(fix: Fix, ax: Axes, *, label: str = "fixes") -> Line2D:
    """A point for each fix of a batch that has coordinates: full where it is ok, open where it is not."""
    lon, lat = (np.ravel(x) for x in lonlat_deg(fix.position))
    ok = np.ravel(np.asarray(fix.ok))
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5.5, "color": FIX, "zorder": 5}
    ax.plot(lon[~ok], lat[~ok], markerfacecolor="none", **style)
    (points,) = ax.plot(lon[ok], lat[ok], markeredgecolor="white", markeredgewidth=0.8, label=label, **style)
    return points


def camera(position: Geodetic, heading: float, ax: Axes, *, label: str = "camera") -> Line2D:
    """Where the camera is, as an arrowhead along its heading in rad; where outside the axes, an arrow at their edge."""
    lon, lat = (float(x) for x in lonlat_deg(position))
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    inside = west <= lon <= east and south <= lat <= north
    if not inside:
        centre = ((west + east) / 2.0, (south + north) / 2.0)
        reach = max(abs(lon - centre[0]) / ((east - west) / 2.0), abs(lat - centre[1]) / ((north - south) / 2.0))
        lon, lat = (c + (value - c) * 0.96 / reach for c, value in zip(centre, (lon, lat), strict=True))
    marker = (3, 0, -math.degrees(heading))
    style: dict[str, Any] = {"color": SIGHT, "markersize": 15, "markeredgecolor": "white", "zorder": 6}
    (point,) = ax.plot([lon], [lat], linestyle="none", marker=marker, label=label, **style)
    return point


def scale_bar(ax: Axes, length_m: float | None = None, *, anchor: tuple[float, float] = (0.05, 0.05)) -> None:
    """A bar of a round length, about a fifth of the map, at a place given in fractions of the axes."""
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    lat = math.radians(south + anchor[1] * (north - south))
    metres_per_degree = math.radians(1.0) * float(WGS84.prime_vertical_radius(jnp.asarray(lat))) * math.cos(lat)
    length = length_m or _round_length(0.2 * (east - west) * metres_per_degree)
    x0, y0 = west + anchor[0] * (east - west), south + anchor[1] * (north - south)
    x1 = x0 + length / metres_per_degree
    ax.plot([x0, x1], [y0, y0], color=EDGE, linewidth=4, solid_capstyle="butt", path_effects=_halo(7.0), zorder=7)
    text = f"{length / 1000.0:g} km" if length >= 1000.0 else f"{length:g} m"
    y_text = y0 + 0.012 * (north - south)
    ax.text((x0 + x1) / 2, y_text, text, ha="center", va="bottom", fontsize=10, path_effects=_halo(3.0), zorder=7)


def north_arrow(ax: Axes, *, anchor: tuple[float, float] = (0.94, 0.9)) -> None:
    """An arrow to true north, at a place given in fractions of the axes."""
    x, y = anchor
    arrow = {"arrowstyle": "-|>", "linewidth": 2.0, "color": EDGE}
    ax.annotate("", (x, y + 0.06), (x, y - 0.02), xycoords="axes fraction", arrowprops=arrow, zorder=7)
    style: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": 12, "fontweight": "bold", "zorder": 7}
    ax.text(x, y - 0.025, "N", transform=ax.transAxes, path_effects=_halo(3.0), **style)


def _halo(width: float) -> list[Any]:
    return [matplotlib.patheffects.withStroke(linewidth=width, foreground="white", alpha=0.9)]


def _round_length(length: float) -> float:
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)


def _plane(position: Geodetic) -> tuple[np.ndarray, np.ndarray]:
    """(east, north) in m about the middle, good enough for a slope."""
    lat, lon = np.asarray(position.lat), np.asarray(position.lon)
    middle = jnp.asarray(lat.mean())
    M, N = float(WGS84.meridian_radius(middle)), float(WGS84.prime_vertical_radius(middle))
    return N * np.cos(lat) * (lon - lon.mean()), M * (lat - lat.mean())


def _slopes(height: np.ndarray, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d height / d east and d north, from differences along rows and columns of any orientation."""
    (h_r, h_c), (e_r, e_c), (n_r, n_c) = np.gradient(height), np.gradient(east), np.gradient(north)
    determinant = e_r * n_c - e_c * n_r
    return (h_r * n_c - h_c * n_r) / determinant, (e_r * h_c - e_c * h_r) / determinant

"""Terrain profile under a line of sight, with its intersections."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxgeo._checks import check_is, require_x64
from jaxgeo._locate import intersect
from jaxgeo._numerics import safe_norm
from jaxgeo.earth import WGS84, Atmosphere
from jaxgeo.earth.ray import Ray
from jaxgeo.plot.legends import keyed, legend_of
from jaxgeo.plot.style import FIX, INK, MUTED, SHADE, SIGHT, TERRAIN, grid_behind, house_axes, metres
from jaxgeo.status import Status
from jaxgeo.terrain import Dem

SAMPLES = 4096  # along a line of sight; terrain between two samples is not resolved
FARTHEST = 600_000.0  # m: maximum range searched along a line of sight
PLUMB = 1e-4  # horizontal component of a direction, below which there is no profile
BEYOND = 1.06  # times the range at which the line is below all terrain


@dataclass(frozen=True)
class Section:
    """Profile of a line of sight and the terrain below it, in m, at samples (n,) in order.

    `distance` is along the ellipsoid from the point below the camera; `sight`, `ground` and `flat` are heights above
    WGS 84 of the line, of the terrain (NaN where unknown), and of the line over a flat Earth at the camera. `void`
    marks samples over terrain voids. `hits` (k, 2) are (distance, height) of the points where the line enters known
    terrain, in order; the first is the fix if `status` is a hit.
    """

    distance: np.ndarray
    sight: np.ndarray
    ground: np.ndarray
    flat: np.ndarray
    void: np.ndarray
    hits: np.ndarray
    status: Status

    @property
    def curved(self) -> float:
        """Height of the line above that over a flat Earth at the last hit, or at the end if there is none, m."""
        at = self.hits[-1, 0] if len(self.hits) else self.distance[-1]
        return float(np.interp(at, self.distance, self.sight - self.flat))


def section_under(ray: Ray, dem: Dem, *, atmosphere: Atmosphere | None = None, reach: float | None = None) -> Section:
    """The terrain profile under one line of sight (ECEF, m; `Ray(*sensor.ray_ecef(shot, uv)[:2])`).

    It ends where the line leaves the terrain or is below all of it, or at `reach` m along it. The first hit is that of
    `intersect` with the same `atmosphere`; later ones are found between 4096 samples. Raises `TypeError` for other
    records, `ValueError` for a ray that is not finite or never over the terrain, and a reach that is not positive.
    """
    require_x64()
    check_is(ray, Ray, "ray", "Make one with Ray(*sensor.ray_ecef(shot, uv)[:2]).")
    check_is(dem, Dem, "dem", "Read one with jaxgeo.io.read_dem.")
    if not all(np.isfinite(np.asarray(x)).all() for x in (ray.origin, ray.direction)):
        raise ValueError(f"ray must be finite; got origin {ray.origin} m, direction {ray.direction}. See its status.")
    if reach is not None and not (math.isfinite(reach) and reach > 0.0):
        raise ValueError(f"reach must be a positive length in m; got {reach!r}.")
    fix = intersect(ray, dem, atmosphere=atmosphere)
    ray = ray.through(atmosphere)
    reach = _reach(ray, dem) if reach is None else reach
    along = np.linspace(0.0, reach, SAMPLES)
    feet, sight, ground, inside, void = (np.asarray(x) for x in _sampled(ray, dem, jnp.asarray(along)))
    steps = np.linalg.norm(np.diff(feet, axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    ground = np.where(inside & ~void, ground, np.nan)
    if distance[-1] < PLUMB * reach:
        raise ValueError("the line of sight is plumb: there is no section under it.")
    flat = sight[0] + distance * float(_climb(ray))
    hits = _entered(distance, sight, ground)
    status = Status(int(fix.status))
    if bool(fix.found) and float(fix.slant_range) <= reach:
        first = float(np.interp(float(fix.slant_range), along, distance))
        spacing = 2.0 * float(steps.max())
        farther = hits[hits[:, 0] > first + spacing]
        hits = np.concatenate([[[first, float(fix.position.height)]], farther])
    return Section(distance, sight, ground, flat, inside & void, hits, status)


def sight_section(
    section: Section, ax: Axes | None = None, *, window: tuple[float, float] | None = None, legend: bool = True
) -> Axes:
    """A line of sight over its terrain profile, with the first hit and later ones.

    The line is full up to the first hit and dashed beyond; thin dots show the line over a flat Earth. Voids are
    hatched. `window` is the first and the last distance shown, in m; `legend=False` omits the legend below. Raises
    `TypeError` for another record, `ValueError` for a window outside the profile.
    """
    if not isinstance(section, Section):
        raise TypeError(f"section must be a Section; got {type(section).__name__}. Make one with section_under.")
    low, high = (0.0, float(section.distance[-1])) if window is None else window
    shown = (section.distance >= low) & (section.distance <= high)
    if not (low < high and np.count_nonzero(shown) > 1):
        end = section.distance[-1]
        raise ValueError(f"window must hold some of the section, 0 to {end:.0f} m; got {low!r} to {high!r} m.")
    km = 1e-3 * section.distance
    bottom, top = _limits(section, shown)
    with house_axes(ax, tall=0.5) as ax:
        handles: list[Artist] = [_sight(section, km, ax), _over_flat(section, km, ax)]
        handles += _ground(section, km, bottom, ax)
        handles += _hits(section, ax)
        ax.set(xlim=(1e-3 * low, 1e-3 * high), ylim=(bottom, top))
        ax.set(xlabel="distance on the ellipsoid, km", ylabel="height above WGS 84, m")
        grid_behind(ax)
        if legend:
            legend_of(ax, handles)
    return ax


def _limits(section: Section, shown: np.ndarray) -> tuple[float, float]:
    """Lowest and highest height of the figure, m: those of the terrain and the line, with a margin."""
    ground, sight = section.ground[shown], section.sight[shown]
    known = ground[np.isfinite(ground)]
    line = sight if not len(known) else sight[sight >= known.min()]
    values = np.concatenate([known, line])
    low, high = float(values.min()), float(values.max())
    room = max(high - low, 1.0)
    return low - 0.10 * room, high + 0.08 * room


def _sight(section: Section, km: np.ndarray, ax: Axes) -> Line2D:
    end = 1e-3 * section.hits[0, 0] if len(section.hits) else km[-1]
    height = np.interp(end, km, section.sight)
    before = km < end
    style: dict[str, Any] = {"color": SIGHT, "zorder": 4}
    x, y = np.append(km[before], end), np.append(section.sight[before], height)
    (line,) = ax.plot(x, y, label="line of sight", **style)
    if len(section.hits):
        x, y = np.insert(km[~before], 0, end), np.insert(section.sight[~before], 0, height)
        ax.plot(x, y, linestyle=(0, (3, 2)), alpha=0.8, label="_behind the first hit", **style)
    return line


def _over_flat(section: Section, km: np.ndarray, ax: Axes) -> Line2D:
    label = f"over a flat Earth, {metres(section.curved)} lower"
    (line,) = ax.plot(km, section.flat, color=MUTED, linestyle=":", linewidth=0.9, zorder=3, label=label)
    return line


def _ground(section: Section, km: np.ndarray, bottom: float, ax: Axes) -> list[Artist]:
    """Draw the terrain as an area and voids as hatched bands."""
    known = np.isfinite(section.ground)
    ground = np.where(known, section.ground, bottom)
    area = ax.fill_between(km, bottom, ground, where=known, color=TERRAIN, linewidth=0.0, zorder=1)
    ax.plot(km, section.ground, color=INK, linewidth=0.6, zorder=2, label="_surface")
    handles: list[Artist] = [keyed(ax, "ground", area=True, facecolor=TERRAIN, edgecolor=INK, linewidth=0.6)]
    area.set_label("_ground")
    void: dict[str, Any] = {"facecolor": SHADE, "edgecolor": MUTED, "hatch": "////", "linewidth": 0.0}
    for first, last in _runs(section.void):
        start, end = km[max(first - 1, 0)], km[min(last + 1, len(km) - 1)]
        ax.axvspan(start, end, zorder=0, **void)
    if section.void.any():
        handles.append(keyed(ax, "ground unknown", area=True, **void))
    return handles


def _hits(section: Section, ax: Axes) -> list[Artist]:
    """Draw the first hit as a filled marker and later ones open; without a fix the legend gives the reason."""
    handles: list[Artist] = []
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "zorder": 6}
    found = section.status in (Status.hit, Status.near_tangent, Status.enters_from_side, Status.hits_void)
    x, y = 1e-3 * section.hits[:, 0], section.hits[:, 1]
    first = x[:1] if found else x[:0]
    if len(first):
        label = "first hit" if section.status == Status.hit else f"first hit ({_words(section.status)})"
        full = {"color": FIX, "markeredgecolor": "white", "markeredgewidth": 0.8, "markersize": 7.0}
        handles += ax.plot(first, y[: len(first)], label=label, **style, **full)
    else:
        label = "the first hit is farther on" if found else f"no fix: {_words(section.status)}"
        handles.append(keyed(ax, label, linestyle="none"))
    if len(x) > len(first):
        count = len(x) - len(first)
        label = f"{count} crossing{'s' if count > 1 else ''} farther on"
        ring = {"color": FIX, "markerfacecolor": "white", "markeredgewidth": 1.2, "markersize": 5.5}
        handles += ax.plot(x[len(first) :], y[len(first) :], label=label, **style, **ring)
    return handles


def _words(status: Status) -> str:
    return status.name.replace("_", " ")


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of true flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def _entered(distance: np.ndarray, sight: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """(k, 2) distance and height of the points where the line enters known terrain."""
    above = sight - ground
    here = np.flatnonzero((above[:-1] > 0.0) & (above[1:] <= 0.0))
    share = above[here] / (above[here] - above[here + 1])
    parts = [values[here] + share * (values[here + 1] - values[here]) for values in (distance, sight)]
    return np.stack(parts, axis=1)


def _reach(ray: Ray, dem: Dem) -> float:
    """Range in m of the last point over the terrain and above its lowest height."""
    lowest = float(dem.known_heights[0])
    reach = FARTHEST
    for _ in range(2):  # the second pass samples at the density that the terrain's size needs
        along = np.linspace(0.0, reach, SAMPLES)
        _, sight, _, inside, _ = (np.asarray(x) for x in _sampled(ray, dem, jnp.asarray(along)))
        within = np.flatnonzero(inside & (sight >= lowest))
        if not len(within):
            raise ValueError(
                "the line of sight is nowhere above ground of this terrain: "
                f"{Status(int(intersect(ray, dem).status)).message}"
            )
        reach = min(BEYOND * float(along[min(within[-1] + 1, SAMPLES - 1)]), FARTHEST)
    return reach


@eqx.filter_jit
def _sampled(ray: Ray, dem: Dem, along: jax.Array) -> tuple[jax.Array, ...]:
    """(foot on the ellipsoid in ECEF, height, height of the ground, on the terrain, void) at ranges along a ray, m."""

    def one(distance: jax.Array) -> tuple[jax.Array, ...]:
        p_ecef = ray.at(distance)
        normal, height = WGS84.normal_and_height(p_ecef)
        rowcol = dem.grid.rowcol(normal)
        inside = dem.contains(rowcol)
        cell = dem.cell_of(jnp.where(inside, rowcol, 0.0))
        _, is_void = dem.patch(cell)
        ground = dem.surface(jnp.where(inside, rowcol, 0.0), cell)
        return p_ecef - height * normal, height, ground, inside, is_void

    return jax.vmap(one)(along)


@jax.jit
def _climb(ray: Ray) -> jax.Array:
    """Rise of the line above the camera's horizontal plane, m per m of distance along the ellipsoid."""
    up, height = WGS84.normal_and_height(ray.origin)
    rise = ray.direction @ up
    level = safe_norm(ray.direction - rise * up)
    radius = safe_norm(ray.origin)
    return rise / level * radius / (radius - height)

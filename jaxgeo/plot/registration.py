"""Registration figures: block shifts, tie points on the map, fixes with error circles, checkerboards."""

from __future__ import annotations

import math
from typing import Any

import matplotlib.patheffects
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from jaxgeo._checks import check_is
from jaxgeo.ortho.orthoimage import Orthoimage, cell_side
from jaxgeo.plot._orthoimages import drape, draw_map, on_map, over, show, stretched, turned
from jaxgeo.plot.cloud import unit_circle
from jaxgeo.plot.legends import keyed, legend_of
from jaxgeo.plot.style import FIX, INK, REGISTERED, SAMPLED, SKY, halo, house_axes, metres, round_length
from jaxgeo.register.passes import AT_FIRST, Pass
from jaxgeo.register.peaks import ellipses
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.registration import Registration
from jaxgeo.uncertainty import Propagation

CLOSEST = 60  # minimum cells across a figure
SQUARES = 6  # of a checkerboard, along its longer side
SMALL = 0.15  # of a figure's half side: smaller circles get an enlarged inset


def shifts(
    done: Pass,
    ax: Axes | None = None,
    *,
    covariance: Any = None,
    probability: float = 0.999,
    reach: float | None = None,
    legend: bool = True,
) -> Axes:
    """Shifts of image blocks against the reference, in cells to the right and upwards.

    After Fig. 2 of Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation": all candidates
    are small markers, those that agree are ringed. With the prior `covariance` of the errors and the map's shift for
    the first pass (`Prior.covariance`), the search region with `probability` is drawn for the block nearest to the
    centre. `reach` is half the side in cells; by default everything is shown. Raises `ValueError` where no block has a
    candidate.
    """
    check_is(done, Pass, "done", "One of the passes of a Registration.")
    candidates = _upwards(np.asarray(done.matches.shift)[done.matches.is_candidate])
    if not len(candidates):
        raise ValueError("no block of this pass has a candidate: there is nothing to draw.")
    chosen = _upwards(done.chosen.of(done.matches.shift)[np.asarray(done.chosen.is_chosen)])
    ellipse = None if covariance is None else _searched(done, np.asarray(covariance), probability)
    shown = [candidates] if ellipse is None else [candidates, ellipse.T]
    far = 1.08 * float(np.abs(np.concatenate(shown)).max()) if reach is None else reach
    count = np.count_nonzero(done.matches.is_candidate.any(axis=1))
    with house_axes(ax) as ax:
        dot: dict[str, Any] = {"linestyle": "none", "color": SAMPLED, "markersize": 4.0, "zorder": 3}
        handles = ax.plot(*candidates.T, ".", label=f"candidates of {count} blocks", **dot)
        if len(chosen):
            ring: dict[str, Any] = {"markerfacecolor": "none", "markersize": 6.0, "markeredgewidth": 0.8, "zorder": 4}
            handles += ax.plot(*chosen.T, "o", color=FIX, linestyle="none", label=f"{len(chosen)} that agree", **ring)
        if ellipse is not None:
            handles += ax.plot(*ellipse, color=INK, linewidth=1.2, label="searched", zorder=2)
        ax.axhline(0.0, color="0.8", linewidth=0.8, zorder=1)
        ax.axvline(0.0, color="0.8", linewidth=0.8, zorder=1)
        ax.set(xlim=(-far, far), ylim=(-far, far), aspect="equal")
        ax.set(xlabel=f"shift to the right, cells of {done.cell:.3g} m", ylabel="shift upwards, cells")
        if legend:
            legend_of(ax, handles, beside=True)
    return ax


def ties_on_map(
    reference: Orthoimage,
    registration: Registration,
    places: BlockPlaces,
    ax: Axes | None = None,
    *,
    exaggeration: float | None = None,
    legend: bool = True,
) -> Axes:
    """Blocks of the last pass on the reference: tie points with residuals between image and map, and rejected blocks.

    `places` come from `jaxgeo.register.places.places_of_blocks`. Arrows go from the block's position on the map,
    corrected for the map's shift, to its position by the image, enlarged by `exaggeration`; by default a round number
    that makes most of them visible. Axes are in km from the lower left corner of the reference.
    """
    check_is(registration, Registration, "registration", "Make one with jaxgeo.register.register_image.")
    check_is(places, BlockPlaces, "places", "Make them with jaxgeo.register.places.places_of_blocks.")
    spots = on_map(reference, places.ground)
    tied = (np.asarray(places.tie) >= 0) & places.known
    matched = np.asarray(registration.passes[-1].matches.is_candidate).any(axis=1)
    marks = (
        (~tied & ~matched, "x", INK, "not matched"),
        (~tied & matched, "s", SKY, "matched, but not in agreement"),
        (tied, "o", REGISTERED, "tie points"),
    )
    with house_axes(ax, tall=0.8) as ax:
        draw_map(reference, ax)
        handles: list[Artist] = []
        style: dict[str, Any] = {"markerfacecolor": "none", "markeredgewidth": 1.3, "linestyle": "none", "zorder": 4}
        style |= {"markersize": 5.5, "path_effects": halo(2.6)}
        for which, marker, colour, label in marks:
            here = which & places.known
            if here.any():
                handles += ax.plot(*spots[here].T, marker, color=colour, label=f"{label}, {here.sum()}", **style)
        if (tied & np.isfinite(np.asarray(places.residual)[:, 0])).any():
            handles.append(_arrows(reference, places, spots, tied, exaggeration, ax))
        if legend:
            legend_of(ax, handles)
    return ax


def circles_on_map(
    reference: Orthoimage,
    rectified: Orthoimage | None,
    direct: Propagation,
    updated: Propagation | None,
    ax: Axes | None = None,
    *,
    probability: float = 0.9,
    legend: bool = True,
) -> Axes:
    """Fixes of one pixel with their circles and ellipses, over the rectified image on the reference.

    After Fig. 5 of Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation": the outer
    circle is from the navigation alone, the inner one from the registration; each contains the point with
    `probability`. `rectified` is on the cells of the reference. Axes are in m east and north of the direct fix; labels
    give the coordinates. Raises `ValueError` where a fix has no coordinates.
    """
    fixes = [("by the navigation", direct, FIX)]
    fixes += [] if updated is None else [("registered", updated, REGISTERED)]
    for name, one, _ in fixes:
        check_is(one, Propagation, name, "Make it with jaxgeo.uncertainty.propagate, or Registration.fix.")
        if not np.isfinite(np.asarray(one.cov_enu)).all():
            raise ValueError(f"the fix {name} is none: there is nothing to draw.")
    frame = np.asarray(direct.nominal.R_ecef_from_enu)
    origin = np.asarray(direct.fix.ecef)
    middles = [(frame.T @ (np.asarray(one.fix.ecef) - origin))[:2] for _, one, _ in fixes]
    radii = [float(one.circular_error(probability)) for _, one, _ in fixes]
    far = [1.12 * (float(np.abs(middle).max()) + radius) for middle, radius in zip(middles, radii, strict=True)]
    reach = max(*far, 0.5 * CLOSEST * cell_side(reference.grid))
    ground = reference if rectified is None else over(reference, rectified)
    with house_axes(ax) as ax:
        handles: list[Artist] = []
        for (name, one, colour), middle in zip(fixes, middles, strict=True):
            handles.append(_circle(name, one, middle, probability, colour, ax))
        drape(ground, direct, reach, ax)
        if updated is not None:
            _closer(ground, updated, reach, probability, ax)
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="east, m", ylabel="north, m")
        words = f"ellipses of {100.0 * probability:g} %"
        handles.append(keyed(ax, words, color="0.3", linewidth=1.1, linestyle="--"))
        if legend:
            legend_of(ax, handles, beside=True)
    return ax


def checkerboard(
    reference: Orthoimage, rectified: Orthoimage, ax: Axes | None = None, *, squares: int = SQUARES
) -> Axes:
    """Checkerboard of the rectified image and the reference: roads and rivers continue across squares where they agree.

    Both are on the same cells; axes are in km from the lower left corner. Raises `ValueError` for other shapes.
    """
    if rectified.shape != reference.shape:
        raise ValueError(f"both must lie on the same cells; got shapes {rectified.shape} and {reference.shape}.")
    side = max(reference.shape) / squares
    row, col = (np.floor(x / side).astype(int) for x in np.indices(reference.shape))
    board = ((row + col) % 2 == 0) & np.asarray(rectified.known)
    grey = np.where(board, stretched(rectified), stretched(reference))
    known = board | np.asarray(reference.known)
    rows, cols = reference.shape
    with house_axes(ax, tall=0.8) as ax:
        show(np.where(known, grey, np.nan), reference.grid, ax)
        (_, wide), (_, tall) = ax.get_xlim(), ax.get_ylim()
        ax.vlines(wide / cols * np.arange(side, cols, side), 0.0, tall, color=REGISTERED, linewidth=0.6)
        ax.hlines(tall - tall / rows * np.arange(side, rows, side), 0.0, wide, color=REGISTERED, linewidth=0.6)
    return ax


def _upwards(shift: np.ndarray) -> np.ndarray:
    """Shifts (n, 2) = (rows, cols) as (n, 2) cells to the right and upwards."""
    return np.stack([shift[:, 1], -shift[:, 0]], axis=1)


def _searched(done: Pass, covariance: np.ndarray, probability: float) -> np.ndarray:
    """Search ellipse (2, n) of the block nearest to the centre, in cells to the right and upwards."""
    centre = np.asarray(done.matches.centre)
    was_searched = (np.asarray(done.matches.searched) > 0) & np.asarray(done.shifts.visible)
    off = np.linalg.norm(centre - centre.mean(axis=0), axis=1)
    block = int(np.argmin(np.where(was_searched, off, np.inf)))
    cells = np.asarray(done.shifts.covariance(covariance))[block] + AT_FIRST**2 * np.eye(2)
    whitening, _ = ellipses(0.5 * (cells + cells.T)[None], probability)
    return _upwards((np.linalg.inv(whitening[0]) @ unit_circle()).T).T


def _arrows(
    reference: Orthoimage, places: BlockPlaces, spots: np.ndarray, tied: np.ndarray, times: float | None, ax: Axes
) -> Artist:
    """Draw residuals at tie points on axes in km; returns a handle that states the exaggeration."""
    offset = turned(reference.grid, np.asarray(places.residual)[tied])
    width = ax.get_xlim()[1] - ax.get_xlim()[0]
    longest = 1e-3 * float(np.quantile(np.linalg.norm(offset, axis=1), 0.9))
    times = round_length(max(0.08 * width / max(longest, 1e-12), 1.0)) if times is None else times
    tips = spots[tied] + 1e-3 * times * offset
    for tail, tip in zip(spots[tied], tips, strict=True):
        arrow = {
            "arrowstyle": "-|>",
            "color": FIX,
            "linewidth": 1.3,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
            "mutation_scale": 8,
        }
        ax.annotate("", tip, tail, arrowprops=arrow, zorder=5, annotation_clip=False)
    rms = float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))
    label = f"image less map, {times:g} times as long; rms {metres(rms)}"
    return keyed(ax, label, color=FIX, linewidth=1.3)


def _circle(name: str, one: Propagation, middle: np.ndarray, probability: float, colour: Any, ax: Axes) -> Artist:
    """Draw a fix, its circle and the covariance ellipse of the same probability; returns a handle."""
    values, vectors = np.linalg.eigh(np.asarray(one.cov_enu)[:2, :2])
    style: dict[str, Any] = {"color": colour, "zorder": 4}
    radius = float(one.circular_error(probability))
    ax.plot(*(middle[:, None] + radius * unit_circle()), linewidth=1.8, path_effects=halo(3.0), **style)
    sides = 2.0 * math.sqrt(-2.0 * math.log1p(-probability)) * np.sqrt(np.maximum(values, 0.0))
    angle = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    outline: dict[str, Any] = {"angle": angle, "fill": False, "ec": colour, "ls": "--", "lw": 1.1, "zorder": 4}
    ax.add_patch(Ellipse((float(middle[0]), float(middle[1])), sides[1], sides[0], **outline))
    (cross,) = ax.plot(*middle[:, None], "+", markersize=10, markeredgewidth=1.8, **style)
    cross.set_path_effects(halo(3.2))
    lat, lon = (float(np.degrees(np.asarray(x))) for x in (one.fix.position.lat, one.fix.position.lon))
    label = f"{name}: CE{100.0 * probability:g} {metres(radius)}\n{_degrees(lat, lon)}"
    return keyed(ax, label, color=colour, linewidth=1.8, marker="+")


def _closer(ground: Orthoimage, updated: Propagation, reach: float, probability: float, ax: Axes) -> None:
    """Draw an enlarged inset of a small circle in a corner."""
    radius = float(updated.circular_error(probability))
    if radius > SMALL * reach:
        return
    inset = ax.inset_axes((0.67, 0.67, 0.31, 0.31))
    drape(ground, updated, 2.2 * radius, inset)
    _circle("", updated, np.zeros(2), probability, REGISTERED, inset)
    inset.set(xlim=(-2.2 * radius, 2.2 * radius), ylim=(-2.2 * radius, 2.2 * radius), xticks=[], yticks=[])
    inset.set_title(f"{metres(4.4 * radius)} across", fontsize="small", color="white", y=0.8, path_effects=_dark())
    inset.spines[:].set_color(REGISTERED)


def _dark() -> list[Any]:
    return [matplotlib.patheffects.withStroke(linewidth=2.5, foreground="black")]


def _degrees(lat: float, lon: float) -> str:
    return f"{abs(lat):.6f}° {'N' if lat >= 0 else 'S'}, {abs(lon):.6f}° {'E' if lon >= 0 else 'W'}"

"""What a registration found: shifts of blocks, tie points on the map, fixes with their circles, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib.patheffects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from jaxgeo._checks import check_is
from jaxgeo.plot._orthoimages import drape, draw_map, on_map, over, show, stretched, turned
from jaxgeo.plot.cloud import JUMPED, SAMPLE, _halo, _unit_circle
from jaxgeo.plot.maps import EDGE, FIX, _round_length
from jaxgeo.register.orthoimage import Orthoimage, cell_side
from jaxgeo.register.passes import AT_FIRST, Pass
from jaxgeo.register.peaks import ellipses
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.registration import Registration
from jaxgeo.uncertainty import Propagation

CLOSEST = 60  # cells from side to side of a picture, at least
UPDATED = "#e69f00"
SQUARES = 6  # of a checkerboard, along its longer side
SMALL = 0.15  # of a picture's half side: a smaller circle is drawn once more, closer
DETAIL = 210  # cells on a side of the part that shows before and after


def shifts(
    done: Pass, ax: Axes, *, covariance: Any = None, probability: float = 0.999, reach: float | None = None
) -> list[Line2D]:
    """By how many cells, to the right and upwards, blocks of an image lie elsewhere in the reference.

    After Fig. 2 of Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation": all candidates
    as small marks, those that agree ringed. With the `covariance` of the errors and the map's shift that a first pass
    starts from (`Prior.covariance`) the part that was searched, with `probability`, is drawn for the block nearest to
    the middle. `reach` is half the side in cells; if left out, all is shown. Returns handles for a legend. Raises
    `ValueError` where no block has a candidate.
    """
    check_is(done, Pass, "done", "One of the passes of a Registration.")
    candidates = _upwards(np.asarray(done.matches.shift)[done.matches.is_candidate])
    if not len(candidates):
        raise ValueError("no block of this pass has a candidate: there is nothing to draw.")
    style: dict[str, Any] = {"linestyle": "none", "color": SAMPLE}
    label = f"candidates of {np.count_nonzero(done.matches.is_candidate.any(axis=1))} blocks"
    handles: list[Line2D] = [*ax.plot(*candidates.T, ".", markersize=4, label=label, zorder=3, **style)]
    chosen = _upwards(done.chosen.of(done.matches.shift)[np.asarray(done.chosen.is_chosen)])
    if len(chosen):
        ring: dict[str, Any] = {"markerfacecolor": "none", "markersize": 9, "markeredgewidth": 1.2, "linestyle": "none"}
        handles += ax.plot(*chosen.T, "o", color=JUMPED, label=f"{len(chosen)} that agree", zorder=4, **ring)
    shown = [candidates]
    if covariance is not None:
        ellipse = _searched(done, np.asarray(covariance), probability)
        handles += ax.plot(*ellipse, color=EDGE, linewidth=1.2, label="searched", zorder=2)
        shown.append(ellipse.T)
    far = 1.08 * float(np.abs(np.concatenate(shown)).max()) if reach is None else reach
    ax.axhline(0.0, color="0.8", linewidth=0.8, zorder=1)
    ax.axvline(0.0, color="0.8", linewidth=0.8, zorder=1)
    ax.set(xlim=(-far, far), ylim=(-far, far), aspect="equal")
    ax.set(xlabel=f"shift to the right, cells of {done.cell:.3g} m", ylabel="shift upwards, cells")
    return handles


def ties_on_map(
    reference: Orthoimage,
    registration: Registration,
    places: BlockPlaces,
    ax: Axes,
    *,
    exaggeration: float | None = None,
) -> list[Line2D]:
    """Blocks of the last pass on the reference: ties with what is left between image and map, and those left out.

    `places` are those of `jaxgeo.register.places.places_of_blocks`. Arrows go from where the map shows a block, its
    shift taken off, to where the image has it, `exaggeration` times as long; by default a round number that makes most
    of them visible. Axes are in km from the lower left corner of the reference. Returns handles for a legend.
    """
    check_is(registration, Registration, "registration", "Make one with jaxgeo.register.register.")
    check_is(places, BlockPlaces, "places", "Make them with jaxgeo.register.places.places_of_blocks.")
    draw_map(reference, ax)
    spots = on_map(reference, places.ground)
    tied = (np.asarray(places.tie) >= 0) & places.known
    matched = np.asarray(registration.passes[-1].matches.is_candidate).any(axis=1)
    handles: list[Line2D] = []
    marks = (
        (~tied & ~matched, "x", EDGE, "not matched"),
        (~tied & matched, "s", JUMPED, "matched, but not in agreement"),
        (tied, "o", UPDATED, "tie points"),
    )
    for which, marker, colour, label in marks:
        here = which & places.known
        if here.any():
            style: dict[str, Any] = {
                "markerfacecolor": "none",
                "markeredgewidth": 1.4,
                "linestyle": "none",
                "zorder": 4,
            }
            style["path_effects"] = _halo(2.6)
            handles += ax.plot(
                *spots[here].T, marker, color=colour, markersize=6, label=f"{label}, {here.sum()}", **style
            )
    if (tied & np.isfinite(np.asarray(places.residual)[:, 0])).any():
        handles.append(_arrows(reference, places, spots, tied, exaggeration, ax))
    return handles


def circles_on_map(
    reference: Orthoimage,
    rectified: Orthoimage | None,
    direct: Propagation,
    updated: Propagation | None,
    ax: Axes,
    *,
    probability: float = 0.9,
) -> list[Line2D]:
    """Fixes of one pixel with their circles and ellipses, over the rectified image on the reference.

    After Fig. 5 of Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation": the outer
    circle, of the navigation alone, and the inner one, of the registration, with the `probability` that each holds the
    point. `rectified` lies on the cells of the reference. Axes are in m east and north of the direct fix, labels have
    the coordinates. Returns handles for a legend. Raises `ValueError` where a fix is none.
    """
    fixes = [("by the navigation", direct, FIX)]
    fixes += [] if updated is None else [("registered", updated, UPDATED)]
    for name, one, _ in fixes:
        check_is(one, Propagation, name, "Make it with jaxgeo.uncertainty.propagate, or Registration.fix.")
        if not np.isfinite(np.asarray(one.cov_enu)).all():
            raise ValueError(f"the fix {name} is none: there is nothing to draw.")
    frame = np.asarray(direct.aim.R_ecef_from_enu)
    origin = np.asarray(direct.fix.ecef)
    reach, handles = 0.0, []
    for name, one, colour in fixes:
        middle = (frame.T @ (np.asarray(one.fix.ecef) - origin))[:2]
        radius = float(one.circular_error(probability))
        handles.append(_circle(name, one, middle, probability, colour, ax))
        reach = max(reach, 1.12 * (float(np.abs(middle).max()) + radius))
    reach = max(reach, 0.5 * CLOSEST * cell_side(reference.grid))
    ground = reference if rectified is None else over(reference, rectified)
    drape(ground, direct, reach, ax)
    if updated is not None:
        _closer(ground, updated, reach, probability, ax)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="east, m", ylabel="north, m")
    words = f"dashed: ellipses of {100.0 * probability:g} %"
    return [*handles, Line2D([], [], color="0.3", linewidth=1.1, linestyle="--", label=words)]


def checkerboard(reference: Orthoimage, rectified: Orthoimage, ax: Axes, *, squares: int = SQUARES) -> None:
    """The rectified image and the reference in turn, as the squares of a board: roads and rivers go on over the edges
    where both agree. Both lie on the same cells; axes are in km from the lower left corner. Raises `ValueError` for
    other shapes.
    """
    if rectified.shape != reference.shape:
        raise ValueError(f"both must lie on the same cells; got shapes {rectified.shape} and {reference.shape}.")
    side = max(reference.shape) / squares
    row, col = (np.floor(x / side).astype(int) for x in np.indices(reference.shape))
    board = ((row + col) % 2 == 0) & np.asarray(rectified.known)
    grey = np.where(board, stretched(rectified), stretched(reference))
    known = board | np.asarray(reference.known)
    show(np.where(known, grey, np.nan), reference.grid, ax)
    (_, wide), (_, tall) = ax.get_xlim(), ax.get_ylim()
    rows, cols = reference.shape
    ax.vlines(wide / cols * np.arange(side, cols, side), 0.0, tall, color=UPDATED, linewidth=0.6)
    ax.hlines(tall - tall / rows * np.arange(side, rows, side), 0.0, wide, color=UPDATED, linewidth=0.6)


def before_after(reference: Orthoimage, before: Orthoimage, after: Orthoimage, axes: Sequence[Axes]) -> None:
    """Checkerboards of the reference with the image as the navigation has it, and as the registration has it.

    Of large images a part of the middle, `DETAIL` cells on a side.
    """
    names = ("before: by the navigation", "after: registered")
    both = np.asarray(before.known) & np.asarray(after.known) & np.asarray(reference.known)
    row, col = (int(np.median(x)) for x in np.nonzero(both)) if both.any() else (n // 2 for n in reference.shape)
    part = min(DETAIL, reference.shape[0]), min(DETAIL, reference.shape[1])
    middle = np.array([row, col]) - np.array(part) // 2
    corner = [int(x) for x in np.clip(middle, 0, np.array(reference.shape) - np.array(part))]
    for ax, image, name in zip(axes, (before, after), names, strict=True):
        checkerboard(reference.window(corner[0], corner[1], part), image.window(corner[0], corner[1], part), ax)
        ax.set_title(name, loc="left", fontsize=10)


def _upwards(shift: np.ndarray) -> np.ndarray:
    """(n, 2) cells to the right and upwards of shifts (n, 2) = (rows, cols)."""
    return np.stack([shift[:, 1], -shift[:, 0]], axis=1)


def _searched(done: Pass, covariance: np.ndarray, probability: float) -> np.ndarray:
    """The ellipse (2, n), cells to the right and upwards, in which the block nearest to the middle was sought."""
    centre = np.asarray(done.matches.centre)
    was_searched = (np.asarray(done.matches.searched) > 0) & np.asarray(done.shifts.seen)
    off = np.linalg.norm(centre - centre.mean(axis=0), axis=1)
    block = int(np.argmin(np.where(was_searched, off, np.inf)))
    cells = np.asarray(done.shifts.covariance(covariance))[block] + AT_FIRST**2 * np.eye(2)
    whitening, _ = ellipses(0.5 * (cells + cells.T)[None], probability)
    return _upwards((np.linalg.inv(whitening[0]) @ _unit_circle()).T).T


def _arrows(
    reference: Orthoimage, places: BlockPlaces, spots: np.ndarray, tied: np.ndarray, times: float | None, ax: Axes
) -> Line2D:
    """What is left at ties, on axes in km; a handle that says how much longer than true."""
    offset = turned(reference.grid, np.asarray(places.residual)[tied])
    width = ax.get_xlim()[1] - ax.get_xlim()[0]
    longest = 1e-3 * float(np.quantile(np.linalg.norm(offset, axis=1), 0.9))
    times = _round_length(max(0.08 * width / max(longest, 1e-12), 1.0)) if times is None else times
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
    label = f"image less map, {times:g} times as long; rms {_metres(rms)}"
    return Line2D([], [], color=FIX, linewidth=1.3, label=label)


def _circle(name: str, one: Propagation, middle: np.ndarray, probability: float, colour: Any, ax: Axes) -> Line2D:
    """A fix, its circle and the ellipse of its covariance that holds the same share; a handle."""
    values, vectors = np.linalg.eigh(np.asarray(one.cov_enu)[:2, :2])
    style: dict[str, Any] = {"color": colour, "zorder": 4}
    radius = float(one.circular_error(probability))
    ax.plot(*(middle[:, None] + radius * _unit_circle()), linewidth=1.8, path_effects=_halo(3.0), **style)
    sides = 2.0 * math.sqrt(-2.0 * math.log1p(-probability)) * np.sqrt(np.maximum(values, 0.0))
    angle = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    outline: dict[str, Any] = {"angle": angle, "fill": False, "ec": colour, "ls": "--", "lw": 1.1, "zorder": 4}
    ax.add_patch(Ellipse((float(middle[0]), float(middle[1])), sides[1], sides[0], **outline))
    (cross,) = ax.plot(*middle[:, None], "+", markersize=10, markeredgewidth=1.8, **style)
    cross.set_path_effects(_halo(3.2))
    lat, lon = (float(np.degrees(np.asarray(x))) for x in (one.fix.position.lat, one.fix.position.lon))
    label = f"{name}: CE{100.0 * probability:g} {_metres(radius)}\n{_degrees(lat, lon)}"
    return Line2D([], [], color=colour, linewidth=1.8, marker="+", label=label)


def _closer(ground: Orthoimage, updated: Propagation, reach: float, probability: float, ax: Axes) -> None:
    """A small circle once more, in a corner, where it can be seen."""
    radius = float(updated.circular_error(probability))
    if radius > SMALL * reach:
        return
    inset = ax.inset_axes((0.67, 0.67, 0.31, 0.31))
    drape(ground, updated, 2.2 * radius, inset)
    _circle("", updated, np.zeros(2), probability, UPDATED, inset)
    inset.set(xlim=(-2.2 * radius, 2.2 * radius), ylim=(-2.2 * radius, 2.2 * radius), xticks=[], yticks=[])
    inset.set_title(f"{_metres(4.4 * radius)} across", fontsize=8, color="white", y=0.8, path_effects=_dark())
    inset.spines[:].set_color(UPDATED)


def _dark() -> list[Any]:
    return [matplotlib.patheffects.withStroke(linewidth=2.5, foreground="black")]


def _degrees(lat: float, lon: float) -> str:
    return f"{abs(lat):.6f}° {'N' if lat >= 0 else 'S'}, {abs(lon):.6f}° {'E' if lon >= 0 else 'W'}"


def _metres(length: float) -> str:
    return f"{length:.3g} m" if length < 1000.0 else f"{length / 1000.0:.3g} km"

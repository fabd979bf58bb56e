"""Figures of the coordinate frames, the signs of angles and the image axes.

All rotations in the figures are computed by the package's own code, so the figures agree with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle

from jaxgeo._checks import require_x64
from jaxgeo.plot.style import BLUE, COLUMN, INK, MUTED, PAGE, house_axes, style
from jaxgeo.sensor import Gimbal, Mount, Pose

NED, BODY, HEAD, CAMERA = "#3f7a3a", BLUE, "#b26a00", "#b3293f"  # one colour per frame; light ones not for text
PLANE, OUTLINE = "#e4ecf3", "#8fa3b3"
N, E, D = np.eye(3)
WIDE = (-1.75, 2.05)  # horizontal limits of all panels
TURN = 60  # points along an arc
HEADING_NOTE = "clockwise from true north;\nRz(heading) Ry(pitch) Rx(roll)"
SLOT = 0.92  # aspect ratio (height / width) of a panel
WIDE_FIGURE = 5.0  # inches: minimum width for three panels per row

# Each view: the directions (north-east-down, with the aircraft flying north) that lie to the right and up on paper.
FROM_ABOVE, FROM_RIGHT, FROM_BEHIND = np.stack([E, N]), np.stack([N, -D]), np.stack([E, -D])
VIEWS = {"above": FROM_ABOVE, "right": FROM_RIGHT, "behind": FROM_BEHIND, "drone": FROM_RIGHT}
Place: TypeAlias = Any  # two numbers

PARTS: dict[str, list[list[tuple[float, float, float]]]] = {  # in body axes (forward, right, down)
    "above": [
        [(0.16, 0, 0), (-0.12, 0.95, 0), (-0.30, 0.95, 0), (-0.20, 0, 0), (-0.30, -0.95, 0), (-0.12, -0.95, 0)],
        [(-0.72, 0, 0), (-0.88, 0.34, 0), (-0.96, 0.34, 0), (-0.93, 0, 0), (-0.96, -0.34, 0), (-0.88, -0.34, 0)],
        [(0.9, 0, 0), (0.74, 0.075, 0), (-0.97, 0.03, 0), (-0.97, -0.03, 0), (0.74, -0.075, 0)],
    ],
    "right": [
        [(0.9, 0, 0.03), (0.7, 0, -0.08), (-0.97, 0, -0.05), (-0.97, 0, 0.0), (0.6, 0, 0.1)],
        [(-0.66, 0, -0.05), (-0.86, 0, -0.36), (-0.99, 0, -0.36), (-0.96, 0, -0.04)],
        [(0.14, 0, 0.04), (-0.3, 0, 0.045), (-0.3, 0, 0.01), (0.05, 0, 0.0)],
    ],
    "behind": [
        [(0, -0.95, -0.02), (0, -0.95, 0.01), (0, 0, 0.05), (0, 0.95, 0.01), (0, 0.95, -0.02), (0, 0, -0.03)],
        [(0, -0.025, 0), (0, -0.012, -0.38), (0, 0.012, -0.38), (0, 0.025, 0)],
        [(0, -0.34, -0.13), (0, -0.34, -0.15), (0, 0.34, -0.15), (0, 0.34, -0.13)],
        [(0, 0.11 * math.cos(t), 0.11 * math.sin(t)) for t in np.linspace(0, 2 * np.pi, 40)],
    ],
    "drone": [
        [(-0.42, 0, -0.02), (-0.42, 0, -0.1), (0.42, 0, -0.1), (0.42, 0, -0.02)],
        [(-0.75, 0, -0.13), (-0.75, 0, -0.16), (-0.1, 0, -0.16), (-0.1, 0, -0.13)],
        [(0.1, 0, -0.13), (0.1, 0, -0.16), (0.75, 0, -0.16), (0.75, 0, -0.13)],
    ],
}
FRAMES = (  # name, colour, transformation to the next frame, the same in code
    ("pixel", INK, "camera.ray", "ray_camera = camera.ray(uv)"),
    ("camera", CAMERA, "R_head_from_camera", "ray_head = R_head_from_camera @ ray_camera"),
    ("head", HEAD, "gimbal readings", "ray_base = R_base_from_head @ ray_head  # gimbal readings"),
    ("base", HEAD, "R_body_from_base", "ray_body = R_body_from_base @ ray_base"),
    ("body", BODY, "heading, pitch, roll", "ray_ned = R_ned_from_body @ ray_body  # heading, pitch, roll"),
    ("ned", NED, "position", "ray_ecef = R_ecef_from_ned @ ray_ned  # position"),
    ("ecef", INK, "", ""),
)


def convention(name: str, ax: Axes | None = None) -> Axes:
    """One panel of the conventions by its name in `PANELS`. Raises `ValueError` for another name."""
    require_x64()
    if name not in PANELS:
        raise ValueError(f"name must be one of {', '.join(PANELS)}; got {name!r}.")
    with house_axes(ax, width=COLUMN, tall=SLOT) as ax:
        PANELS[name](ax)
    return ax


def conventions_figure(width: float = PAGE) -> Figure:
    """All panels in one figure `width` inches wide: three per row on a page, two in a column."""
    columns = 3 if width > WIDE_FIGURE else 2
    rows = -(-len(PANELS) // columns)
    with mpl.rc_context(style(width)):
        figure = Figure(figsize=(width, SLOT * width * rows / columns), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(rows, columns)
        names = list(PANELS)
        for number, name in enumerate(names):
            row, column = divmod(number, columns)
            last = columns if number == len(names) - 1 else column + 1
            convention(name, figure.add_subplot(grid[row, column:last]))
    return figure


def _heading(axes: Axes) -> None:
    _panel(axes, "Heading, from above", HEADING_NOTE, (-1.25, 1.65))
    R = _attitude(heading=35.0)
    _aircraft(axes, "above", R, 0.8)
    _arrow(axes, (0, 0), (0, 1.3), NED, "north")
    _arrow(axes, (0, 0), (1.3, 0), NED, "east")
    x, y, _ = (FROM_ABOVE @ R).T
    _arrow(axes, (0, 0), 1.35 * x, BODY, "x forward", side="right")
    _arrow(axes, (0, 0), 1.2 * y, BODY, "y right")
    _turn(axes, (0, 1), x, 0.95, "heading", label=(-0.08, 1.0), ha="right")
    _into_page(axes, (0, 0), BODY, "z down", offset=(-0.16, 0.04))


def _pitch(axes: Axes) -> None:
    _panel(axes, "Pitch, from the right", "nose up is positive", (-1.5, 1.0))
    R = _attitude(pitch=20.0)
    _aircraft(axes, "right", R, 0.85)
    x, _, z = (FROM_RIGHT @ R).T
    _arrow(axes, (0, 0), (1.3, 0), NED, "level", dashed=True)
    _arrow(axes, (0, 0), (0, -1.15), NED, "down", dashed=True, side="left")
    _arrow(axes, (0, 0), 1.35 * x, BODY, "x forward", side="above")
    _arrow(axes, (0, 0), 1.15 * z, BODY, "z down", side="right")
    _turn(axes, (1, 0), x, 1.02, "pitch", label=(1.16, 0.22), ha="left")
    _into_page(axes, (0, 0), BODY, "y right", out=True, offset=(-0.2, 0.28))


def _roll(axes: Axes) -> None:
    _panel(axes, "Roll, from behind", "right wing down is positive", (-1.5, 1.0))
    R = _attitude(roll=22.0)
    _aircraft(axes, "behind", R, 0.95)
    _, y, z = (FROM_BEHIND @ R).T
    _arrow(axes, (0, 0), (1.3, 0), NED, "level", dashed=True)
    _arrow(axes, (0, 0), (0, -1.15), NED, "down", dashed=True, side="right")
    _arrow(axes, (0, 0), 1.3 * y, BODY, "y right", side="below")
    _arrow(axes, (0, 0), 1.15 * z, BODY, "z down", side="left")
    _turn(axes, (1, 0), y, 1.02, "roll", label=(1.16, -0.22), ha="left")
    _into_page(axes, (0, 0), BODY, "x forward", offset=(0.14, 0.5))


def _outer(axes: Axes) -> None:
    _panel(axes, "Gimbal, from behind", "outer: off nadir, to the right", (-1.5, 0.75))
    _aircraft(axes, "behind", np.eye(3), 0.95)
    _arrow(axes, (0, 0), (0, -1.2), HEAD, "nadir", dashed=True, side="left")
    sight = FROM_BEHIND @ _sight(Gimbal.two_axis(), Mount.nadir(), outer=52.0, inner=0.0)
    _arrow(axes, (0, 0), 1.45 * sight, CAMERA, "line of sight", side="below")
    _arrow(axes, (0, 0), (1.3, 0), BODY, "y right")
    _turn(axes, (0, -1), sight, 0.7, "outer", HEAD, label=(-0.08, -0.66), ha="right")
    _into_page(axes, (0, 0), BODY, "x forward", offset=(-0.1, 0.34))


def _inner(axes: Axes) -> None:
    _panel(axes, "Gimbal, from the right", "inner: positive looks ahead", (-1.5, 0.75))
    _aircraft(axes, "right", np.eye(3), 0.85)
    _arrow(axes, (0, 0), (0, -1.2), HEAD, "nadir", dashed=True, side="left")
    sight = FROM_RIGHT @ _sight(Gimbal.two_axis(), Mount.nadir(), outer=0.0, inner=30.0)
    _arrow(axes, (0, 0), 1.35 * sight, CAMERA, "line of sight", side="right")
    _arrow(axes, (0, 0), (1.3, 0), BODY, "x forward", side="above")
    _turn(axes, (0, -1), sight, 0.75, "inner", HEAD, label=(0.55, -0.55), ha="left")
    _into_page(axes, (0, 0), BODY, "y right", out=True, offset=(-0.2, -0.24))


def _level(axes: Axes) -> None:
    note = "yaw: true heading of the sight;\npitch: its elevation, -90° plumb"
    _panel(axes, "Drone gimbal", note, (-1.5, 0.75))
    _aircraft(axes, "drone", _attitude(pitch=-12.0))
    _arrow(axes, (0, 0), (1.3, 0), NED, "level", dashed=True)
    _arrow(axes, (0, 0), (0, -1.2), NED, "down", dashed=True, side="left")
    sight = FROM_RIGHT @ _sight(Gimbal.three_axis(), Mount.forward(), yaw=0.0, pitch=-42.0, roll=0.0)
    _arrow(axes, (0, 0), 1.45 * sight, CAMERA, "line of sight", side="below")
    _turn(axes, (1, 0), sight, 0.9, "pitch < 0", HEAD, label=(0.97, -0.3), ha="left")
    options: dict[str, Any] = {"color": MUTED, "fontsize": "small", "style": "italic", "ha": "center"}
    axes.text(0.0, 0.48, "the body's tilt does not matter", **options)


def _image(axes: Axes) -> None:
    _panel(axes, "Image, as it is seen", "uv = (column, row), px;\ncentres at integers", (-1.5, 0.75))
    width, height, step = 7, 5, 0.36
    left, top = -1.15, 0.4
    for row in range(height):
        for column in range(width):
            first = (row, column) == (0, 0)
            corner = (left + column * step, top - (row + 1) * step)
            fill = {"fc": "#f7dfe2" if first else "white", "ec": "#cfd6dc", "lw": 0.6}
            axes.add_patch(Rectangle(corner, step, step, **fill))
    centre = (left + width * step / 2, top - height * step / 2)
    _arrow(axes, centre, (centre[0] + 0.8, centre[1]), CAMERA, "right", side="above")
    _arrow(axes, centre, (centre[0], centre[1] - 0.72), CAMERA, "down", side="left")
    _into_page(axes, centre, CAMERA, "forward", offset=(-0.1, 0.17))
    _arrow(axes, (left + 0.95, top + 0.12), (left + 1.75, top + 0.12), INK, "u", thin=True)
    _arrow(axes, (left - 0.13, top - 0.55), (left - 0.13, top - 1.35), INK, "v", thin=True)
    last = (left + (width - 0.5) * step, top - (height - 0.5) * step)
    corners = (((left + step / 2, top - step / 2), "(0, 0)", "above"), (last, "(width-1,\nheight-1)", "beside"))
    for dot, text, side in corners:
        axes.plot(*dot, "o", ms=2.6, color=INK, zorder=6)
        at = (left + 0.05, top + 0.1) if side == "above" else (left + width * step + 0.07, last[1])
        options: dict[str, Any] = {"fontsize": "small", "va": "bottom" if side == "above" else "center"}
        axes.text(*at, text, color=INK, ha="left", **options)


def _frames(axes: Axes) -> None:
    """The chain of frames from a pixel to the Earth; with lines of code where space allows."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    wide = figure.get_figwidth() > WIDE_FIGURE
    words = ('reference="level": from head', "straight to ned, past the body")
    _panel(axes, "From pixel to Earth", (" " if wide else "\n").join(words))
    middle, half = (0.13, 0.06) if wide else (0.34, 0.13)
    places = np.linspace(0.94, 0.04, len(FRAMES))
    step = places[0] - places[1]
    for place, (name, colour, link, code) in zip(places, FRAMES, strict=True):
        patch = {"boxstyle": "round,pad=0.18", "fc": colour, "ec": "none"}
        box: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center", "fontsize": "small"}
        axes.text(middle, place, name, color="white", weight="bold", bbox=patch, **box)
        if not link:
            continue
        _arrow_in_axes(axes, (middle, place - 0.37 * step), (middle, place - 0.66 * step))
        beside: dict[str, Any] = {**box, "ha": "left"}
        if wide:
            axes.text(middle + 0.06, place - 0.5 * step, code, family="monospace", **beside)
        else:
            axes.text(middle + 0.1, place - 0.5 * step, link, **beside)
    line: dict[str, Any] = {"transform": axes.transAxes, "color": MUTED, "lw": 0.9, "ls": (0, (3, 2))}
    axes.plot([middle - half, 0.02, 0.02, middle - half - 0.02], places[[2, 2, 5, 5]], **line)
    _arrow_in_axes(axes, (middle - half - 0.02, places[5]), (middle - half, places[5]))
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))


def _arrow_in_axes(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A short arrow, in fractions of the axes."""
    options: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 6, "lw": 0.9, "color": MUTED}
    axes.add_patch(FancyArrowPatch(start, end, transform=axes.transAxes, shrinkA=0, shrinkB=0, **options))


PANELS: dict[str, Callable[[Axes], None]] = {
    "heading": _heading,
    "pitch": _pitch,
    "roll": _roll,
    "outer": _outer,
    "inner": _inner,
    "level": _level,
    "image": _image,
    "frames": _frames,
}


def _panel(axes: Axes, title: str, note: str, tall: tuple[float, float] | None = None) -> None:
    """Blank axes in units of half a wing span, with a title above and a note below."""
    if tall is not None:
        axes.set(xlim=WIDE, ylim=tall, aspect="equal")
    axes.axis("off")
    axes.set_title(title, fontsize="medium")
    options: dict[str, Any] = {"transform": axes.transAxes, "color": MUTED, "fontsize": "small", "va": "top"}
    axes.text(0.0, -0.02, note, **options)


def _attitude(heading: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """R_ned_from_body for angles in deg."""
    here = Pose.from_degrees(lat=0.0, lon=0.0, height=0.0).position
    return np.asarray(Pose(here, *np.deg2rad([heading, pitch, roll])).R_ned_from_body)


def _sight(gimbal: Gimbal, mount: Mount, **readings: float) -> np.ndarray:
    """Line of sight in the gimbal's base for gimbal readings in deg."""
    R = np.asarray(gimbal.R_base_from_head(gimbal.readings_from_degrees(**readings)))
    return R @ np.asarray(mount.R_head_from_camera) @ D


def _aircraft(axes: Axes, parts: str, R_ned_from_body: np.ndarray, size: float = 1.0) -> None:
    for part in PARTS[parts]:
        outline = size * np.array(part) @ R_ned_from_body.T @ VIEWS[parts].T
        axes.add_patch(Polygon(outline, closed=True, fc=PLANE, ec=OUTLINE, lw=0.7, zorder=1))


def _arrow(
    axes: Axes,
    start: Place,
    end: Place,
    colour: str,
    label: str,
    *,
    dashed: bool = False,
    thin: bool = False,
    side: str = "beyond",
) -> None:
    """A labelled arrow; the label is beyond its tip, or above, below, left or right of it."""
    tail, tip = np.asarray(start, float), np.asarray(end, float)
    width = 0.9 if dashed or thin else 1.5
    along = (tip - tail) / np.linalg.norm(tip - tail)
    line = np.stack([tail, tip - 0.08 * along]).T
    axes.plot(*line, color=colour, lw=width, ls=(0, (3, 2)) if dashed else "-", zorder=3, label=f"_{label}")
    _head(axes, tip - 0.1 * along, tip, colour, width)
    step = {"beyond": along, "above": E[:2], "below": -E[:2], "left": -N[:2], "right": N[:2]}[side]
    place = tip + (0.09 if side != "below" else 0.11) * step
    across = "center" if abs(step[0]) < 0.7 else "left" if step[0] > 0.0 else "right"
    up = "center" if abs(step[1]) < 0.7 else "bottom" if step[1] > 0.0 else "top"
    axes.text(float(place[0]), float(place[1]), label, color=colour, ha=across, va=up, zorder=5)


def _head(axes: Axes, start: Place, end: Place, colour: str, width: float) -> None:
    options: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 7.5, "lw": width, "shrinkA": 0, "shrinkB": 0}
    tail, tip = (tuple(np.asarray(x, float).tolist()) for x in (start, end))
    axes.add_patch(FancyArrowPatch(tail, tip, color=colour, zorder=4, **options))


def _into_page(
    axes: Axes, at: Place, colour: str, label: str, *, out: bool = False, offset: tuple[float, float]
) -> None:
    """An axis into the page (cross) or out of the page (dot)."""
    axes.add_patch(Circle(at, 0.085, fc="white", ec=colour, lw=1.1, zorder=6))
    if out:
        axes.add_patch(Circle(at, 0.026, color=colour, zorder=7))
    else:
        for slope in (1.0, -1.0):
            d = 0.055 * np.array([1.0, slope])
            axes.plot(*np.stack([np.asarray(at) - d, np.asarray(at) + d]).T, color=colour, lw=1.1, zorder=7)
    axes.text(
        at[0] + offset[0],
        at[1] + offset[1],
        label,
        color=colour,
        ha="left" if offset[0] > 0.0 else "right",
        va="center",
        zorder=7,
    )


def _turn(
    axes: Axes,
    first: Place,
    second: Place,
    radius: float,
    name: str,
    colour: str = INK,
    *,
    label: tuple[float, float],
    ha: str,
) -> None:
    """A curved arrow about the origin between two directions, along the shorter arc."""
    a, b = math.atan2(first[1], first[0]), math.atan2(second[1], second[0])
    b = a + math.remainder(b - a, 2.0 * math.pi)
    t = np.linspace(a, b, TURN)
    line = radius * np.stack([np.cos(t), np.sin(t)], axis=1)
    axes.plot(*line[:-6].T, color=colour, lw=1.1, zorder=5, label=f"_turn {name}")
    _head(axes, line[-12], line[-1], colour, 1.1)
    axes.text(*label, name, color=colour, weight="bold", ha=ha, va="center", zorder=6)

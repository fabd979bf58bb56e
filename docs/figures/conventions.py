"""Draw the frames, angles and pixel axes of jaxgeo: `python docs/figures/conventions.py` writes the PNG beside it.

Whatever turns in the drawing is turned by the package's own rotations, so that the figure cannot tell another story
than the code.
"""

from __future__ import annotations

import pathlib

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib as mpl  # noqa: E402

mpl.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle  # noqa: E402

from jaxgeo.sensor import Gimbal, Mount, Pose  # noqa: E402

INK, PALE, PLANE, EDGE = "#22303c", "#8b98a3", "#e4ecf3", "#8fa3b3"
NED, BODY, HEAD, CAMERA = "#4f7a46", "#1f6fb2", "#c77a0a", "#b3293f"
HERE = Pose.from_degrees(lat=0.0, lon=0.0, height=0.0).position
N, E, D = np.eye(3)

# Each view: the directions (north-east-down, with the aircraft flying north) that lie to the right and up on paper.
FROM_ABOVE, FROM_RIGHT, FROM_BEHIND = np.stack([E, N]), np.stack([N, -D]), np.stack([E, -D])

TOP = [
    [(0.16, 0.0), (-0.12, 0.95), (-0.30, 0.95), (-0.20, 0.0), (-0.30, -0.95), (-0.12, -0.95)],
    [(-0.72, 0.0), (-0.88, 0.34), (-0.96, 0.34), (-0.93, 0.0), (-0.96, -0.34), (-0.88, -0.34)],
    [(0.9, 0.0), (0.74, 0.075), (-0.97, 0.03), (-0.97, -0.03), (0.74, -0.075)],
]
PARTS = {  # in body axes (forward, right, down)
    "above": [[(x, y, 0.0) for x, y in part] for part in TOP],
    "right": [
        [(0.9, 0, 0.03), (0.7, 0, -0.08), (-0.97, 0, -0.05), (-0.97, 0, 0.0), (0.6, 0, 0.1)],
        [(-0.66, 0, -0.05), (-0.86, 0, -0.36), (-0.99, 0, -0.36), (-0.96, 0, -0.04)],
        [(0.14, 0, 0.04), (-0.3, 0, 0.045), (-0.3, 0, 0.01), (0.05, 0, 0.0)],
    ],
    "behind": [
        [(0, -0.95, -0.02), (0, -0.95, 0.01), (0, 0, 0.05), (0, 0.95, 0.01), (0, 0.95, -0.02), (0, 0, -0.03)],
        [(0, -0.025, 0), (0, -0.012, -0.38), (0, 0.012, -0.38), (0, 0.025, 0)],
        [(0, -0.34, -0.13), (0, -0.34, -0.15), (0, 0.34, -0.15), (0, 0.34, -0.13)],
        [(0, 0.11 * np.cos(t), 0.11 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 40)],
    ],
}


def attitude(heading: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """R_ned_from_body of angles in deg."""
    return np.asarray(Pose(HERE, *np.deg2rad([heading, pitch, roll])).R_ned_from_body)


def aircraft(ax, parts: str, view: np.ndarray, R: np.ndarray, size: float = 1.0) -> None:
    for part in PARTS[parts]:
        outline = size * np.array(part) @ R.T @ view.T
        ax.add_patch(Polygon(outline, closed=True, fc=PLANE, ec=EDGE, lw=0.9, zorder=1))


def arrow_head(ax, start, end, colour: str, width: float, scale: float) -> None:
    style = {"arrowstyle": "-|>", "mutation_scale": scale, "lw": width, "shrinkA": 0, "shrinkB": 0}
    ax.add_patch(FancyArrowPatch(tuple(start), tuple(end), color=colour, zorder=4, **style))


def arrow(ax, start, end, colour: str, label: str = "", width: float = 1.9, away: float = 0.13, dashed=False) -> None:
    start, end = np.asarray(start, float), np.asarray(end, float)
    ax.plot(
        *np.stack([start, start + 0.97 * (end - start)]).T, color=colour, lw=width, ls=(0, (4, 3)) if dashed else "-"
    )
    arrow_head(ax, start + 0.9 * (end - start), end, colour, width, 13)
    along = (end - start) / np.linalg.norm(end - start)
    side = "left" if along[0] > 0.7 else "center"
    ax.text(*(end + (0.06 if side == "left" else away) * along), label, color=colour, fontsize=10, ha=side, va="center",
            zorder=5)  # fmt: skip


def into_page(ax, at, colour: str, label: str, out: bool = False, offset=(0.16, -0.02)) -> None:
    """An axis that goes into the page (a cross) or comes out of it (a dot)."""
    ax.add_patch(Circle(at, 0.075, fc="white", ec=colour, lw=1.6, zorder=6))
    if out:
        ax.add_patch(Circle(at, 0.022, color=colour, zorder=7))
    else:
        for slope in (1, -1):
            d = 0.048 * np.array([1, slope])
            ax.plot(*np.stack([np.asarray(at) - d, np.asarray(at) + d]).T, color=colour, lw=1.6, zorder=7)
    ax.text(at[0] + offset[0], at[1] + offset[1], label, color=colour, fontsize=10, ha="left", va="center", zorder=7)


def turn(ax, first, second, radius: float, label: str, colour: str = INK, label_radius: float | None = None) -> None:
    """A curved arrow about the origin from one direction of the drawing to another, the short way."""
    a, b = np.arctan2(first[1], first[0]), np.arctan2(second[1], second[0])
    b = a + (b - a + np.pi) % (2 * np.pi) - np.pi
    t = np.linspace(a, b, 60)
    line = radius * np.stack([np.cos(t), np.sin(t)], axis=1)
    ax.plot(*line[:-4].T, color=colour, lw=1.4, zorder=5)
    arrow_head(ax, line[-9], line[-1], colour, 1.4, 11)
    middle = (label_radius or radius + 0.2) * np.array([np.cos((a + b) / 2), np.sin((a + b) / 2)])
    ax.text(*middle, label, color=colour, fontsize=10.5, weight="bold", ha="center", va="center", zorder=6)


def panel(ax, title: str, note: str) -> None:
    ax.set(xlim=(-1.7, 1.9), ylim=(-1.45, 1.45), aspect="equal")
    ax.axis("off")
    ax.set_title(title, fontsize=12, color=INK, loc="left", pad=4)
    ax.text(0.0, 0.0, note, transform=ax.transAxes, fontsize=9, color=PALE, va="bottom", linespacing=1.35)


def draw_heading(ax) -> None:
    panel(ax, "Heading, from above", "clockwise from true north\nR_ned_from_body = Rz(heading) Ry(pitch) Rx(roll)")
    R = attitude(heading=35.0)
    aircraft(ax, "above", FROM_ABOVE, R, 0.8)
    arrow(ax, (0, 0), (0, 1.3), NED, "north")
    arrow(ax, (0, 0), (1.3, 0), NED, "east", away=0.2)
    x, y, _ = (FROM_ABOVE @ R).T
    arrow(ax, (0, 0), 1.35 * x, BODY, "x forward", away=0.12)
    arrow(ax, (0, 0), 1.2 * y, BODY, "y right", away=0.16)
    turn(ax, (0, 1), x, 0.95, "heading", label_radius=1.08)
    into_page(ax, (0, 0), BODY, "z down", offset=(-0.62, 0.0))


def draw_pitch(ax) -> None:
    panel(ax, "Pitch, from the right", "nose up is positive")
    ax.set_ylim(-1.75, 1.15)
    R = attitude(pitch=20.0)
    aircraft(ax, "right", FROM_RIGHT, R, 0.85)
    x, _, z = (FROM_RIGHT @ R).T
    arrow(ax, (0, 0), (1.35, 0), NED, "level", dashed=True, width=1.3, away=0.14)
    arrow(ax, (0, 0), (0, -1.15), NED, "down", dashed=True, width=1.3)
    arrow(ax, (0, 0), 1.35 * x, BODY, "x forward", away=0.12)
    arrow(ax, (0, 0), 1.15 * z, BODY, "z down", away=0.14)
    turn(ax, (1, 0), x, 1.02, "pitch", label_radius=1.3)
    into_page(ax, (0, 0), BODY, "y right", out=True, offset=(-0.6, 0.16))


def draw_roll(ax) -> None:
    panel(ax, "Roll, from behind", "right wing down is positive")
    ax.set_ylim(-1.75, 1.15)
    R = attitude(roll=22.0)
    aircraft(ax, "behind", FROM_BEHIND, R, 0.95)
    _, y, z = (FROM_BEHIND @ R).T
    arrow(ax, (0, 0), (1.35, 0), NED, "level", dashed=True, width=1.3, away=0.14)
    arrow(ax, (0, 0), (0, -1.15), NED, "down", dashed=True, width=1.3)
    arrow(ax, (0, 0), 1.3 * y, BODY, "y right", away=0.14)
    arrow(ax, (0, 0), 1.15 * z, BODY, "z down", away=0.12)
    turn(ax, (1, 0), y, 1.02, "roll", label_radius=1.22)
    into_page(ax, (0, 0), BODY, "x forward", offset=(0.12, 0.34))


def sight(gimbal: Gimbal, mount: Mount, **readings: float) -> np.ndarray:
    """Line of sight in the gimbal's base."""
    R = np.asarray(gimbal.R_base_from_head(gimbal.readings_from_degrees(**readings)))
    return R @ np.asarray(mount.R_head_from_camera) @ np.array([0.0, 0.0, 1.0])


def draw_outer(ax) -> None:
    panel(ax, "Two-axis frame, from behind", "outer: off nadir, to the right\nsight = Rx(-outer) Ry(inner) [0, 0, 1]")
    ax.set_ylim(-1.85, 0.95)
    aircraft(ax, "behind", FROM_BEHIND, np.eye(3), 0.95)
    arrow(ax, (0, 0), (0, -1.25), HEAD, "nadir", dashed=True, width=1.3)
    los = FROM_BEHIND @ sight(Gimbal.two_axis(), Mount.nadir(), outer=52.0, inner=0.0)
    arrow(ax, (0, 0), 1.5 * los, CAMERA, "line of sight", away=0.1)
    arrow(ax, (0, 0), (1.35, 0), BODY, "y right", away=0.14)
    turn(ax, (0, -1), los, 0.85, "outer", HEAD, label_radius=1.08)
    into_page(ax, (0, 0), BODY, "x forward", offset=(-0.34, 0.5))


def draw_inner(ax) -> None:
    panel(ax, "Two-axis frame, from the right", "inner: positive looks ahead\nmirror: inner = -2 (azimuth drive - 45°)")
    ax.set_ylim(-1.85, 0.95)
    aircraft(ax, "right", FROM_RIGHT, np.eye(3), 0.85)
    arrow(ax, (0, 0), (0, -1.25), HEAD, "nadir", dashed=True, width=1.3)
    los = FROM_RIGHT @ sight(Gimbal.two_axis(), Mount.nadir(), outer=0.0, inner=30.0)
    arrow(ax, (0, 0), 1.45 * los, CAMERA, "line of sight", away=0.1)
    arrow(ax, (0, 0), (1.35, 0), BODY, "x forward", away=0.14)
    turn(ax, (0, -1), los, 0.9, "inner", HEAD, label_radius=1.1)
    into_page(ax, (0, 0), BODY, "y right", out=True, offset=(-0.56, -0.2))


def draw_level(ax) -> None:
    panel(ax, "Drone gimbal in local level, from its side", "yaw: true heading of the sight (from north)\n"
          "pitch: its elevation, -90° looks straight down")  # fmt: skip
    ax.set_ylim(-1.85, 0.95)
    drone = attitude(pitch=-12.0)
    for part in ([(-0.42, 0, -0.02), (-0.42, 0, -0.1), (0.42, 0, -0.1), (0.42, 0, -0.02)],
                 [(-0.75, 0, -0.13), (-0.75, 0, -0.16), (-0.1, 0, -0.16), (-0.1, 0, -0.13)],
                 [(0.1, 0, -0.13), (0.1, 0, -0.16), (0.75, 0, -0.16), (0.75, 0, -0.13)]):  # fmt: skip
        ax.add_patch(Polygon(np.array(part) @ drone.T @ FROM_RIGHT.T, closed=True, fc=PLANE, ec=EDGE, lw=0.9))
    arrow(ax, (0, 0), (1.35, 0), NED, "level", dashed=True, width=1.3, away=0.14)
    arrow(ax, (0, 0), (0, -1.25), NED, "down", dashed=True, width=1.3)
    los = FROM_RIGHT @ sight(Gimbal.three_axis(), Mount.forward(), yaw=0.0, pitch=-42.0, roll=0.0)
    arrow(ax, (0, 0), 1.5 * los, CAMERA, "line of sight", away=0.1)
    turn(ax, (1, 0), los, 0.95, "pitch < 0", HEAD, label_radius=1.3)
    ax.text(-0.95, 0.42, "the body's tilt does not matter", fontsize=8.5, color=PALE, style="italic")


def draw_image(ax) -> None:
    panel(ax, "Image, seen from behind the camera",
          "uv = (column, row), pixel centres at integers\n"
          "right, down, forward in the axes of the head:\n"
          "Mount.nadir() +y, -x, +z;  Mount.forward() +y, +z, +x")  # fmt: skip
    ax.set_ylim(-1.85, 0.95)
    width, height, step = 7, 5, 0.3
    left, top = -0.95, 0.62
    for row in range(height):
        for column in range(width):
            first = (row, column) == (0, 0)
            corner = (left + column * step, top - (row + 1) * step)
            ax.add_patch(Rectangle(corner, step, step, fc="#f7dfe2" if first else "white", ec="#cfd6dc", lw=0.8))
    centre = (left + width * step / 2, top - height * step / 2)
    arrow(ax, centre, (centre[0] + 0.95, centre[1]), CAMERA, "right", away=0.24)
    arrow(ax, centre, (centre[0], centre[1] - 0.62), CAMERA, "down", away=-0.25)
    ax.texts[-1].set_position((centre[0] - 0.25, centre[1] - 0.55))
    into_page(ax, centre, CAMERA, "forward", offset=(-0.62, 0.13))
    dot = (left + step / 2, top - step / 2)
    ax.plot(*dot, "o", ms=3.5, color=INK)
    ax.annotate("uv = (0, 0)", dot, (dot[0] - 0.45, dot[1] + 0.3), fontsize=9, color=INK, ha="center",
                arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.7})  # fmt: skip
    arrow(ax, (left + 0.75, top + 0.1), (left + 1.45, top + 0.1), INK, "u", width=1.3, away=0.13)
    arrow(ax, (left - 0.1, top - 0.55), (left - 0.1, top - 1.2), INK, "v", width=1.3, away=0.15)
    last = (left + (width - 0.5) * step, top - (height - 0.5) * step)
    ax.plot(*last, "o", ms=3.5, color=INK)
    ax.annotate("(width-1, height-1)", last, (last[0] - 0.1, last[1] - 0.32), fontsize=9, color=INK, ha="center",
                arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.7})  # fmt: skip


def draw_way(ax) -> None:
    """The staircase of frames, as a strip."""
    ax.axis("off")
    ax.set(xlim=(0, 100), ylim=(0, 10))
    frames = [
        ("pixel", INK),
        ("camera", CAMERA),
        ("head", HEAD),
        ("base", HEAD),
        ("body", BODY),
        ("ned", NED),
        ("ecef", INK),
    ]
    links = [
        "camera.ray",
        "R_head_from_camera",
        "gimbal readings",
        "R_body_from_base",
        "heading, pitch, roll",
        "position",
    ]
    places = np.linspace(4, 96, len(frames))
    for place, (name, colour) in zip(places, frames, strict=True):
        ax.text(place, 5.8, name, fontsize=12.5, weight="bold", color="white", ha="center", va="center",
                bbox={"boxstyle": "round,pad=0.42", "fc": colour, "ec": "none"})  # fmt: skip
    for a, b, link in zip(places[:-1], places[1:], links, strict=True):
        ax.add_patch(
            FancyArrowPatch((a + 3.6, 5.8), (b - 3.6, 5.8), arrowstyle="-|>", mutation_scale=14, lw=1.5, color=PALE)
        )
        ax.text((a + b) / 2, 7.9, link, fontsize=9.5, color=INK, ha="center", va="center")
    corner = [(places[2], 4.1), (places[2], 1.6), (places[5], 1.6)]
    ax.plot(*np.array(corner).T, color=PALE, lw=1.3, ls=(0, (4, 3)))
    ax.add_patch(
        FancyArrowPatch((places[5], 1.6), (places[5], 4.1), arrowstyle="-|>", mutation_scale=14, lw=1.3, color=PALE)
    )
    ax.text((places[2] + places[5]) / 2, 1.6, 'a gimbal with reference="level" goes straight to ned', fontsize=9.5,
            color=PALE, ha="center", va="center", bbox={"fc": "white", "ec": "none"})  # fmt: skip


def main() -> pathlib.Path:
    mpl.rcParams["font.family"] = "DejaVu Sans"
    figure = plt.figure(figsize=(16, 10.4), facecolor="white")
    grid = figure.add_gridspec(3, 12, height_ratios=[1.0, 1.0, 0.27], hspace=0.16, wspace=0.1,
                               left=0.02, right=0.985, top=0.95, bottom=0.02)  # fmt: skip
    for index, draw in enumerate([draw_heading, draw_pitch, draw_roll]):
        draw(figure.add_subplot(grid[0, 4 * index : 4 * index + 4]))
    for index, draw in enumerate([draw_outer, draw_inner, draw_level, draw_image]):
        draw(figure.add_subplot(grid[1, 3 * index : 3 * index + 3]))
    draw_way(figure.add_subplot(grid[2, :]))
    path = pathlib.Path(__file__).with_suffix(".png")
    figure.savefig(path, dpi=110)
    return path


if __name__ == "__main__":
    print(main())

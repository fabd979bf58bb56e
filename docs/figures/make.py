"""Draw the gallery of jaxgeo.plot: `python docs/figures/make.py [folder]` writes the PNGs, by default beside this file.

Each figure is drawn as wide as a column of 80 mm and as a page, with type of the size that is read: `sight_line.png`
is for the page, `sight_line_column.png` for the column. All is made from the demonstration's camera and terrain, which
come with the package, but for the adjustment, which is of a small block that is simulated here.
"""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib as mpl  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from jaxgeo import FrameCamera, Geodetic, Mount, Pose, Sensor, Shot  # noqa: E402
from jaxgeo.adjust import Adjustment, Block, ImagePoints, LocalFrame, adjust, reliability  # noqa: E402
from jaxgeo.demo.made import scene_file  # noqa: E402
from jaxgeo.earth.ray import Ray  # noqa: E402
from jaxgeo.io import example_dem  # noqa: E402
from jaxgeo.io.scene import read_scene  # noqa: E402
from jaxgeo.plot.adjustment import draw_residual_histogram, draw_residuals  # noqa: E402
from jaxgeo.plot.budgets import draw_budget  # noqa: E402
from jaxgeo.plot.comparison import draw_comparison  # noqa: E402
from jaxgeo.plot.conventions import conventions_figure  # noqa: E402
from jaxgeo.plot.sightline import draw_sight_line, section_under  # noqa: E402
from jaxgeo.plot.style import COLUMN, PAGE, style  # noqa: E402
from jaxgeo.uncertainty import Footprint, budget, compare, propagate  # noqa: E402

FAR_COLUMN = 2280.0  # px: a line of sight that meets the ground once more behind a ridge
DOUBTED_UV = np.array([1551.0, 3456.0])  # px: fix 13 of the demonstration, with a ridge behind it
SAMPLES, DPI = 20_000, 200
SIDE, STRIP, HIGH = 60.0, 4, 500.0  # m between images, images in each of two strips, height in m
SIGMA_UV = 0.5  # px

Draw = Callable[[Figure, float], Any]


def sight_line() -> Iterator[tuple[str, Draw, float, float]]:
    """The whole line of sight, and where it comes down."""
    scene = read_scene(scene_file())
    assert scene.shot is not None
    camera = scene.sensor.camera
    assert isinstance(camera, FrameCamera)
    uv = np.array([FAR_COLUMN, 0.5 * (camera.height - 1)])
    origin, direction, _ = scene.sensor.ray_ecef(scene.shot, uv)
    section = section_under(Ray(origin, direction), example_dem())

    def draw(figure: Figure, width: float) -> None:
        whole, near = figure.subplots(2, 1) if width < 5.0 else figure.subplots(1, 2)
        draw_sight_line(whole, section).set_title("The whole way")
        first = section.hits[0, 0]
        draw_sight_line(near, section, window=(first - 2500.0, section.distance[-1]), legend=False)
        near.set_title("Where it comes down")

    yield "sight_line", draw, 1.3, 0.5


def errors() -> Iterator[tuple[str, Draw, float, float]]:
    """How sure a fix is: linear propagation against samples, and the budget."""
    scene, dem = read_scene(scene_file()), example_dem()
    assert scene.shot is not None
    look = (scene.sensor, scene.shot, DOUBTED_UV, dem, scene.errors)
    compared = compare(*look, key=jax.random.key(0), count=SAMPLES, chunk=SAMPLES)
    shares = budget(propagate(*look, slope=Footprint()))
    yield "comparison", lambda figure, _: draw_comparison(figure.add_subplot(), compared), 1.4, 0.58
    yield "budget", lambda figure, _: draw_budget(figure.add_subplot(), shares), 0.95, 0.55


def residuals() -> Iterator[tuple[str, Draw, float, float]]:
    """What an adjustment leaves at the image points."""
    found = adjust(simulated_block())
    checked = reliability(found)
    yield "residuals", lambda figure, _: draw_residuals(figure.add_subplot(), found, checked=checked), 0.95, 0.8
    yield "residual_histogram", lambda figure, _: histogram(figure, found, checked), 0.9, 0.6


def histogram(figure: Figure, found: Adjustment, checked: Any) -> None:
    draw_residual_histogram(figure.add_subplot(), found, checked=checked)


def simulated_block() -> Block:
    """Two strips of images over hilly ground, their points measured with errors of `SIGMA_UV`."""
    rng = np.random.default_rng(5)
    camera = FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000)
    frame = LocalFrame(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0))
    north, east = (x.ravel() for x in np.meshgrid(SIDE * np.arange(STRIP), [0.0, 2.5 * SIDE], indexing="ij"))
    centre = np.stack([east, north, np.full(east.shape, HIGH)], axis=1)
    position = frame.to_geodetic(centre)
    zero = np.zeros(len(centre))
    shots = Shot(Pose(position, zero, zero, zero), np.zeros((len(centre), 0)), np.arange(len(centre)) * 2.0)
    ground = rng.uniform([-150.0, -150.0], [300.0, 330.0], (60, 2))
    points = np.column_stack([ground, 25.0 * np.sin(ground[:, 0] / 60.0)])
    sensor = Sensor(camera, mount=Mount.nadir())
    names = [f"image {k}" for k in range(len(centre))]
    block = Block.from_shots(sensor, names, shots, seen_by(camera, centre, points, names, rng, None), **SIGMAS)
    turned = block.images.R_frame_from_camera
    return Block.from_shots(sensor, names, shots, seen_by(camera, centre, points, names, rng, turned), **SIGMAS)


SIGMAS: dict[str, Any] = {"sigma_position": 0.1, "sigma_attitude": np.deg2rad(0.02)}


def seen_by(camera: Any, centre: Any, points: Any, names: list[str], rng: Any, turned: Any) -> ImagePoints:
    """The points that lie in each image, where it sees them; images level and northwards unless `turned`."""
    level = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # right, down, forward in east, north, up
    rows: list[tuple[str, str, np.ndarray]] = []
    for k, name in enumerate(names):
        R = level if turned is None else turned[k]
        d = (points - centre[k]) @ R
        uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * d[:, :2] / d[:, 2:]
        inside = np.all((uv > 0.0) & (uv < [camera.width - 1, camera.height - 1]), axis=1)
        measured = uv + rng.normal(0.0, SIGMA_UV, uv.shape)
        rows += [(name, f"point {j}", measured[j]) for j in np.flatnonzero(inside).tolist()]
    image, point, uv = zip(*rows, strict=True)
    return ImagePoints(list(image), list(point), np.array(uv), SIGMA_UV).seen_often(2)


def save(folder: pathlib.Path, name: str, draw: Draw, tall: float, wide: float) -> list[pathlib.Path]:
    """One drawing in both widths; `tall` and `wide` are height over width in the column and on the page."""
    written = []
    for width, ratio, ending in ((COLUMN, tall, "_column"), (PAGE, wide, "")):
        with mpl.rc_context(style(width)):
            figure = Figure(figsize=(width, ratio * width), layout="constrained")
            FigureCanvasAgg(figure)
            draw(figure, width)
            written.append(folder / f"{name}{ending}.png")
            figure.draw_without_rendering()  # axes of equal scales come to rest the second time they are laid out
            figure.savefig(written[-1], dpi=DPI)
    return written


def main() -> None:
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent
    for part in (sight_line, errors, residuals):
        for name, draw, tall, wide in part():
            print(*save(folder, name, draw, tall, wide), sep="\n")
    for width, ending in ((COLUMN, "_column"), (PAGE, "")):
        path = folder / f"conventions{ending}.png"
        conventions_figure(width).savefig(path, dpi=DPI)
        print(path)


if __name__ == "__main__":
    main()

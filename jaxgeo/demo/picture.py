"""Figure of the demo."""

from __future__ import annotations

import pathlib
from typing import Any, BinaryIO

import numpy as np

from jaxgeo.demo.scene import VIEW, Demo, Seen, sampled
from jaxgeo.earth._on_host import normals_of
from jaxgeo.sensor import FrameCamera

TYPE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 13,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.fontsize": 9.5,
    "grid.color": "0.85",
}


class Picture:
    """A figure of map, camera view and section, and of the accuracy of one fix once that is known. Needs matplotlib."""

    def __init__(self, seen: Seen) -> None:
        import matplotlib as mpl
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        with mpl.rc_context(TYPE):
            self._figure = Figure(figsize=(15.0, 14.0), layout="constrained")
            FigureCanvasAgg(self._figure)
            parts: Any = self._figure.subfigures(2, 1, height_ratios=[8.8, 5.2])
            ground, self._errors = parts
            grid = ground.add_gridspec(2, 2, width_ratios=[1.05, 1.0], height_ratios=[1.0, 0.85])
            _draw_map(seen, ground.add_subplot(grid[:, 0]))
            _draw_view(seen, ground.add_subplot(grid[0, 1]))
            _draw_section(seen, ground.add_subplot(grid[1, 1]))

    def write(self, demo: Demo, target: pathlib.Path | str | BinaryIO, picture_format: str | None = None) -> None:
        """Add the accuracy, and write the figure.

        `picture_format` is a matplotlib format, such as "png"; by default it is taken from the file name.
        """
        import matplotlib as mpl

        with mpl.rc_context(TYPE):
            cloud, shares = self._errors.subfigures(1, 2, width_ratios=[1.4, 1.0])
            _draw_errors(demo, cloud)
            _draw_budget(demo, shares)
            self._figure.savefig(target, dpi=110, format=picture_format)


def _draw_map(demo: Seen, ax: Any) -> None:
    from jaxgeo import plot

    plot.map_axes(demo.dem, ax)
    plot.hillshade(demo.dem, ax)
    plot.camera(demo.centre, float(demo.shot.pose.heading), ax, label="camera and heading")
    plot.footprints(demo.outline, ax, labels=["image footprint"])
    plot.sight_lines(demo.centre, demo.fix, ax)
    plot.fixes(demo.fix, ax, label="fixes")
    plot.hidden_ground(demo.dem, demo.hidden, ax, label="hidden by terrain")
    plot.scale_bar(ax)
    plot.north_arrow(ax)
    plot.legend(ax, loc="upper left")
    ax.set_title("Ground points of pixels")


def _draw_view(demo: Seen, ax: Any) -> None:
    """Draw the ground as seen by the camera: far at the top, flight direction to the left."""
    from jaxgeo import plot
    from jaxgeo.plot.maps import places_of

    camera = demo.sensor.camera
    assert isinstance(camera, FrameCamera)
    relief = plot.shaded_relief(demo.dem)[..., :3]
    seen = demo.view.position
    rowcol = places_of(demo.dem, normals_of(np.ravel(seen.lat), np.ravel(seen.lon))).reshape(*VIEW, 2)
    found = np.all(np.isfinite(rowcol), axis=-1)
    image = np.where(found[..., None], sampled(relief, np.where(found[..., None], rowcol, 0.0)), 1.0)
    distance = np.asarray(demo.view.slant_range)
    haze = np.clip((distance - np.nanmin(distance)) / (np.nanmax(distance) - np.nanmin(distance)), 0.0, 1.0)
    image = image + (np.array([0.86, 0.91, 0.97]) - image) * 0.45 * np.nan_to_num(haze)[..., None]
    ax.imshow(
        image, origin="lower", extent=(-0.5, camera.height - 0.5, -0.5, camera.width - 0.5), interpolation="bilinear"
    )
    ax.plot(demo.uv[:, 1], demo.uv[:, 0], "o", color=plot.FIX, markeredgecolor="white", markersize=5.5)
    ax.set_xlabel("row (against the flight), pixels")
    ax.set_ylabel("column (outwards), pixels")
    ax.set_title("Camera view, one ray per pixel")


def _draw_section(demo: Seen, ax: Any) -> None:
    from jaxgeo import plot

    distance, sight, ground, hidden = demo.section
    km = distance / 1000.0
    known = np.isfinite(ground)
    floor = np.nanmin(ground) - 200.0
    ax.fill_between(km[known], floor, ground[known], color="#b9a283", linewidth=0.0)
    shadow = np.where(hidden & known, ground, np.nan)
    ax.plot(km, shadow, color=plot.HIDDEN, linewidth=4.0, solid_capstyle="butt", label="hidden ground")
    hit = int(np.argmax(known & (sight <= ground))) or len(km) - 1
    ax.plot(km[: hit + 1], sight[: hit + 1], color=plot.SIGHT, linewidth=1.8, label="line of sight")
    ax.plot(km[hit], ground[hit], "o", color=plot.FIX, markeredgecolor="white", markersize=8, label="fix")
    reach = float(demo.axis.slant_range[0])
    ax.set_xlim(0.0, np.max(km[known]))
    ax.set_ylim(floor, 1.06 * np.max(sight))
    ax.set_xlabel("distance on the ground, km")
    ax.set_ylabel("height above WGS 84, m")
    ax.grid(alpha=0.3)
    ax.legend(loc="upper right", framealpha=0.92, fontsize=10.5)
    ax.set_title(f"Section under the optical axis: slant range {reach / 1000.0:.2f} km")


def _draw_errors(demo: Demo, part: Any) -> None:
    from jaxgeo import plot

    plot.error_cloud(demo.errors.checked, part.subplots(), dem=demo.dem)
    answer = demo.errors.accuracy
    _head(f"Accuracy of fix {demo.errors.number}: CE90 {answer.circular:.0f} m, by {answer.words}", part)


def _draw_budget(demo: Demo, part: Any) -> None:
    from jaxgeo import plot

    ax = part.subplots()
    ax.spines[["top", "right"]].set_visible(False)
    plot.budget_bars(demo.errors.budget, ax)
    _head("Error budget", part)


def _head(words: str, part: Any) -> None:
    """Set a title above the subfigure."""
    part.suptitle(words, x=0.02, ha="left", fontsize=13, fontweight="bold")

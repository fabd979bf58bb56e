"""The demonstration: an oblique camera over real terrain, its fixes, what it cannot see, and a picture of it all."""

from __future__ import annotations

import importlib.resources
import pathlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._numerics import safe_angle, safe_norm
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.locate import locate, project
from jaxgeo.sensor import AbstractCamera, FrameCamera, Sensor, Shot
from jaxgeo.terrain import Dem

GRID = (4, 5)  # fixes across the image, along columns and rows
VIEW = (100, 200)  # pixels of the camera's own view, along columns and rows
EDGE = 40  # points along each edge of the image
PROFILE = 800  # samples of the section under the optical axis
REACH = 24_000.0  # m along the optical axis
CHUNK = 4096  # pixels that are located at a time
HIDDEN_BY = 1.0  # m by which what is seen is nearer than what is hidden


class Demo(eqx.Module):
    """All that the demonstration shows; angles in rad, lengths in m."""

    title: str
    dem: Dem
    sensor: Sensor
    shot: Shot
    centre: Geodetic  # of projection
    uv: np.ndarray  # (n, 2)
    fix: Fix  # (n,)
    outline: Geodetic  # (m,)
    axis: Fix  # (1,), of the optical axis
    view: Fix  # (columns, rows)
    hidden: np.ndarray  # (rows, cols) of the DEM: inside the image but behind terrain
    section: tuple[np.ndarray, ...]  # distance on the ground, height of the optical axis, of the ground, hidden


def scene_file() -> pathlib.Path:
    """The packaged scene file."""
    return pathlib.Path(str(importlib.resources.files("jaxgeo") / "data" / "demo_scene.toml"))


def make_demo() -> Demo:
    """Locate a grid of pixels, the outline and the view of the demonstration's shot, and find the hidden ground."""
    scene = read_scene(scene_file())
    sensor, shot = scene.sensor, scene.shot
    assert shot is not None
    dem = example_dem()
    camera = sensor.camera
    assert isinstance(camera, FrameCamera)
    grid = np.round(_mesh(camera, GRID, 0.06)).reshape(-1, 2)
    edges, view = _edges(camera), _mesh(camera, VIEW, 0.5 / VIEW[0]).reshape(-1, 2)
    uv = np.concatenate([grid, edges, _middle(camera)[None], view])
    n, m = len(grid), len(grid) + len(edges)
    with ThreadPoolExecutor() as pool:  # XLA compiles the parts side by side
        posts = pool.submit(_posts_in_image, sensor, shot, dem)
        section = pool.submit(_section_under_axis, sensor, shot, dem)
        fix = _located(sensor, shot, uv, dem)
        return Demo(
            title=scene.title,
            dem=dem,
            sensor=sensor,
            shot=shot,
            centre=WGS84.to_geodetic(sensor.perspective_centre(shot)),
            uv=grid,
            fix=_part(fix, 0, n),
            outline=_part(fix, n, m).position,
            axis=_part(fix, m, m + 1),
            view=_part(fix, m + 1, len(uv), VIEW),
            hidden=_hidden(sensor, shot, dem, *posts.result()),
            section=section.result(),
        )


def _located(sensor: Sensor, shot: Shot, uv: np.ndarray, dem: Dem) -> Fix:
    """Fixes of pixels (n, 2), in chunks of one size, so that one compilation does for all."""
    chunks = []
    for start in range(0, len(uv), CHUNK):
        chunk = uv[start : start + CHUNK]
        fix = _locate_chunk(sensor, shot, np.resize(chunk, (CHUNK, 2)), dem)
        chunks.append(jax.tree.map(lambda leaf, n=len(chunk): np.asarray(leaf)[:n], fix))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *chunks)


@jax.jit
def _locate_chunk(sensor: Sensor, shot: Shot, uv: jax.Array, dem: Dem) -> Fix:
    return jax.vmap(locate, in_axes=(None, None, 0, None))(sensor, shot, uv, dem)


def _hidden(
    sensor: Sensor, shot: Shot, dem: Dem, posts: np.ndarray, uv: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Which posts (rows, cols) are hidden: at the pixel that they project to, the camera sees nearer ground."""
    nearer = _located(sensor, shot, uv, dem).slant_range < distance - HIDDEN_BY
    hidden = np.zeros(np.shape(dem.posts), bool)
    hidden[tuple(posts[nearer].T)] = True
    return hidden


def _posts_in_image(sensor: Sensor, shot: Shot, dem: Dem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row and col, pixel, distance in m) of the posts that project into the image, seen or hidden."""
    posts = np.indices(np.shape(dem.posts)).reshape(2, -1).T
    uv, distance, ok = (np.asarray(x) for x in _projected(sensor, shot, dem, posts))
    return posts[ok], uv[ok], distance[ok]


@jax.jit
def _projected(sensor: Sensor, shot: Shot, dem: Dem, posts: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    def project_one(rowcol: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        post = _post(dem, *rowcol)
        image = project(sensor, shot, post)
        return image.uv, safe_norm(sensor.to_camera(shot, WGS84.to_ecef(post))), image.ok

    return jax.vmap(project_one)(posts)


def _post(dem: Dem, row: jax.Array, col: jax.Array) -> Geodetic:
    x, y, z = dem.grid.normal(jnp.stack([row, col]).astype(jnp.float64))
    height = jnp.asarray(dem.posts)[row, col].astype(jnp.float64)
    return Geodetic(lat=jnp.arcsin(z), lon=jnp.arctan2(y, x), height=height)


def _section_under_axis(sensor: Sensor, shot: Shot, dem: Dem) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(distance, height of the optical axis, height of the ground, hidden) along the section under the optical axis."""
    distance, sight, ground, off_nadir = (
        np.asarray(x) for x in _section(sensor, shot, dem, jnp.linspace(0.0, REACH, PROFILE))
    )
    highest = np.fmax.accumulate(off_nadir)
    return distance, sight, ground, off_nadir < highest - 1e-6


@jax.jit
def _section(sensor: Sensor, shot: Shot, dem: Dem, ranges: jax.Array) -> tuple[jax.Array, ...]:
    origin, direction, _ = sensor.ray_ecef(shot, _middle(sensor.camera))
    down = -WGS84.normal_and_height(origin)[0]

    foot = origin + down * WGS84.normal_and_height(origin)[1]

    def sample(s: jax.Array) -> tuple[jax.Array, ...]:
        normal, height = WGS84.normal_and_height(origin + s * direction)
        on_ellipsoid = origin + s * direction - height * normal
        rowcol = dem.grid.rowcol(normal)
        ground = jnp.where(dem.contains(rowcol), dem.surface(rowcol, dem.cell_of(rowcol)), jnp.nan)
        off_nadir = safe_angle(on_ellipsoid + ground * normal - origin, down)
        return safe_norm(on_ellipsoid - foot), height, ground, off_nadir

    return jax.vmap(sample)(ranges)


def _middle(camera: AbstractCamera) -> np.ndarray:
    assert isinstance(camera, FrameCamera)
    return np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])


def _mesh(camera: FrameCamera, counts: tuple[int, int], margin: float) -> np.ndarray:
    """Pixels (columns, rows, 2) evenly over the image, from `margin` (a share of the image) inside its edges."""
    sides = [
        np.linspace(margin, 1.0 - margin, count) * size - 0.5
        for count, size in zip(counts, (camera.width, camera.height), strict=True)
    ]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)


def _edges(camera: FrameCamera) -> np.ndarray:
    """Pixels (n, 2) once around the image."""
    mesh = _mesh(camera, (EDGE, EDGE), 0.0)
    return np.concatenate([mesh[:-1, 0], mesh[-1, :-1], mesh[:0:-1, -1], mesh[0, :0:-1]])


def _part(fix: Fix, start: int, stop: int, shape: tuple[int, ...] = (-1,)) -> Fix:
    return jax.tree.map(lambda leaf: leaf[start:stop].reshape(*shape, *leaf.shape[1:]), fix)


# ------------------------------------------------------------------------------------------------------ the picture


def draw(demo: Demo, target: pathlib.Path | str | BinaryIO, picture_format: str | None = None) -> None:
    """Map, what the camera sees, and the section under its optical axis, in one picture. Needs matplotlib.

    `picture_format` is one of matplotlib's, such as "png"; left out, it is taken from the name of the file.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(
        {"font.size": 11, "axes.titlesize": 13, "axes.titleweight": "bold", "axes.titlelocation": "left"}
    ):
        figure = Figure(figsize=(15.0, 8.6), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=[1.05, 1.0], height_ratios=[1.0, 0.85])
        _draw_map(demo, figure.add_subplot(grid[:, 0]))
        _draw_view(demo, figure.add_subplot(grid[0, 1]))
        _draw_section(demo, figure.add_subplot(grid[1, 1]))
        figure.savefig(target, dpi=110, format=picture_format)


def _draw_map(demo: Demo, ax: Any) -> None:
    from jaxgeo import plot

    plot.map_axes(ax, demo.dem)
    plot.hillshade(demo.dem, ax)
    handles = [
        plot.camera(demo.centre, float(demo.shot.pose.heading), ax, label="camera, along its heading"),
        plot.footprint(demo.outline, ax, label="footprint of the image"),
        plot.sight_lines(demo.centre, demo.fix, ax),
        plot.fixes(demo.fix, ax, label="fixes"),
        plot.hidden_ground(demo.dem, demo.hidden, ax, label="in the image, but behind terrain"),
    ]
    plot.scale_bar(ax)
    plot.north_arrow(ax)
    ax.legend(handles=handles, loc="upper left", framealpha=0.92, fontsize=10.5)
    ax.set_title("Where each pixel lies")


def _draw_view(demo: Demo, ax: Any) -> None:
    """The ground as the camera sees it: far at the top, flight to the left."""
    from jaxgeo import plot

    camera = demo.sensor.camera
    assert isinstance(camera, FrameCamera)
    relief = plot.shaded_relief(demo.dem)[..., :3]
    rowcol = np.asarray(_rowcol(demo.dem, jax.tree.map(jnp.ravel, demo.view.position))).reshape(*VIEW, 2)
    found = np.asarray(np.all(np.isfinite(rowcol), axis=-1))
    image = np.where(found[..., None], _sampled(relief, np.where(found[..., None], rowcol, 0.0)), 1.0)
    distance = np.asarray(demo.view.slant_range)
    haze = np.clip((distance - np.nanmin(distance)) / (np.nanmax(distance) - np.nanmin(distance)), 0.0, 1.0)
    image = image + (np.array([0.86, 0.91, 0.97]) - image) * 0.45 * np.nan_to_num(haze)[..., None]
    ax.imshow(
        image, origin="lower", extent=(-0.5, camera.height - 0.5, -0.5, camera.width - 0.5), interpolation="bilinear"
    )
    ax.plot(demo.uv[:, 1], demo.uv[:, 0], "o", color=plot.FIX, markeredgecolor="white", markersize=5.5)
    ax.set_xlabel("row (against the flight), pixels")
    ax.set_ylabel("column (outwards), pixels")
    ax.set_title("What the camera sees, ray by ray")


def _sampled(image: np.ndarray, rowcol: np.ndarray) -> np.ndarray:
    """Colours between the posts, bilinear."""
    first = np.clip(np.floor(rowcol).astype(int), 0, np.array(image.shape[:2]) - 2)
    row, col = first[..., 0], first[..., 1]
    r, c = np.moveaxis(np.clip(rowcol - first, 0.0, 1.0)[..., None], 2, 0)
    near, far = (
        image[row, col] * (1 - c) + image[row, col + 1] * c,
        image[row + 1, col] * (1 - c) + image[row + 1, col + 1] * c,
    )
    return near * (1 - r) + far * r


def _draw_section(demo: Demo, ax: Any) -> None:
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
    ax.set_title(f"Under the optical axis: slant range {reach / 1000.0:.2f} km")


@jax.jit
def _rowcol(dem: Dem, positions: Geodetic) -> jax.Array:
    return jax.vmap(dem.rowcol_at)(positions)

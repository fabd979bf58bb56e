"""Speed and accuracy of rectifying a frame: against Orthority, and GDAL with rational polynomials.

Run: python benchmarks/rectification.py [--repeats 5] [--json out.json]
A real frame and its terrain are read from the folder JAXGEO_TEST_DATA; without it, a synthetic frame over the packaged
terrain is used. Same cells, bilinear, three bands of uint8, on two cores; medians of repeats in alternating order. In
memory: from the image array (Orthority reads it from an in-memory file) to the rectified array, terrain already loaded.
To files: from file to file, deflated, with a mask. Orthority and GDAL do not mask occluded ground.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import equinox as eqx
import jax
import jax.numpy as jnp
import measuring
import numpy as np
import pyproj
import rasterio
from measuring import Column, Table
from peers.gdal_rpc import Fit, fitted, warped
from peers.orthority_peer import Orthority
from rasterio.transform import Affine, array_bounds
from rasterio.warp import Resampling, calculate_default_transform, reproject

import jaxgeo
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.mapping import file_map
from jaxgeo.io.rectified import rectify_file
from jaxgeo.ortho.cells import height_on
from jaxgeo.ortho.rectification import rectify
from jaxgeo.terrain.grid import AbstractGrid

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
CORES, CHECKED, MARGIN = 2, 20_000, 2.0  # MARGIN in pixels from the edge, where interpolation distorts coordinates
PACKAGED = pathlib.Path(jaxgeo.__file__).parent / "data" / "jacksboro.tif"
UNDULATION = 28.3  # m


@dataclass(frozen=True)
class Scene:
    """Input of all contenders: a frame over a terrain as files, arrays, and an orientation in a map.

    `frame` has size (columns, rows), focal_px, xyz in the map with the height above the ellipsoid, opk in rad.
    """

    name: str
    crs: str
    terrain: str
    image: str
    values: np.ndarray
    frame: dict[str, Any]
    dem: jaxgeo.Dem
    sensor: jaxgeo.Sensor
    shot: jaxgeo.Shot


def scenes(folder: pathlib.Path) -> Iterator[tuple[Scene, tuple[float, ...]]]:
    """Frames and output cell sizes in m: one for the frame's own size, and one for nine times that."""
    real = DATA / "ngi_block"
    make = real_frame if real.is_dir() else made_up_frame
    for finer, cells in ((1, (5.0, 2.0)), (9, (1.0,))):
        crs, terrain, frame = make(real, folder)
        frame |= {"size": tuple(finer * n for n in frame["size"]), "focal_px": finer * frame["focal_px"]}
        yield _scene(folder, crs, terrain, frame), cells


def real_frame(real: pathlib.Path, folder: pathlib.Path) -> tuple[str, str, dict[str, Any]]:
    """The first frame, its terrain with ellipsoidal heights, in the terrain's map."""
    crs = pyproj.CRS(json.loads((real / "io" / "ngi_ext_param.geojson").read_text())["world_crs"])
    crs = crs.sub_crs_list[0] if crs.is_compound else crs
    with rasterio.open(real / "dem.tif") as file:
        heights, transform = file.read(1) + np.float32(UNDULATION), file.transform
    row = (real / "io" / "camera_pos_ori.txt").read_text().split("\n", 1)[0].split()
    x, y, z, *opk = (float(word) for word in row[1:])
    frame = {"size": (640, 1152), "focal_px": 0.120 / 144e-6, "xyz": (x, y, z + UNDULATION), "opk": np.radians(opk)}
    return crs.to_wkt(), _written(folder / "terrain.tif", heights[None], crs.to_wkt(), transform), frame


def made_up_frame(real: pathlib.Path, folder: pathlib.Path) -> tuple[str, str, dict[str, Any]]:
    """A synthetic frame of the same camera 5 km above the packaged terrain, in UTM."""
    crs = rasterio.CRS.from_epsg(32616)
    with rasterio.open(PACKAGED) as file:
        transform, width, height = calculate_default_transform(file.crs, crs, file.width, file.height, *file.bounds)
        heights = np.full((height, width), np.nan, np.float32)
        reproject(
            file.read(1).astype(np.float32), heights, src_crs=file.crs, src_transform=file.transform, dst_crs=crs,
            dst_transform=transform, resampling=Resampling.bilinear, dst_nodata=np.nan,
        )  # fmt: skip
    x, y = transform * (0.5 * width, 0.5 * height)
    level = float(np.nanmedian(heights)) + 5000.0
    frame = {"size": (640, 1152), "focal_px": 833.3, "xyz": (x, y, level), "opk": np.radians([1.0, -2.0, 30.0])}
    return crs.to_wkt(), _written(folder / "terrain.tif", heights[None], crs.to_wkt(), transform), frame


def _scene(folder: pathlib.Path, crs: str, terrain: str, frame: dict[str, Any]) -> Scene:
    cols, rows = frame["size"]
    x, y, z = frame["xyz"]
    lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)
    convergence = np.radians(pyproj.Proj(crs).get_factors(lon, lat).meridian_convergence)
    position = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=z)
    pose = jaxgeo.Pose.from_omega_phi_kappa(position, *frame["opk"], convergence=convergence)
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=frame["focal_px"], width=cols, height=rows)
    values = np.random.default_rng(0).integers(1, 255, (3, rows, cols), np.uint8)
    image = _written(folder / f"image_{cols}.tif", values)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    dem = jaxgeo.io.read_dem(terrain, vertical_datum="ellipsoid")
    name = f"{cols} x {rows} px"
    return Scene(name, crs, terrain, image, values, frame, dem, sensor, jaxgeo.Shot(pose))


def _written(path: pathlib.Path, values: np.ndarray, crs: str | None = None, transform: Affine | None = None) -> str:
    profile = {"count": len(values), "height": values.shape[1], "width": values.shape[2], "dtype": values.dtype}
    place = {} if crs is None else {"crs": crs, "transform": transform}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver="GTiff", **profile, **place) as sink:
            sink.write(values)
    return str(path)


def grid_of(scene: Scene, transform: Affine, shape: tuple[int, int]) -> AbstractGrid:
    """The package's grid for the cells of a raster."""
    a, b, c, d, e, f = transform[:6]
    middle = (a, b, c + a / 2.0, d, e, f + e / 2.0)
    return make_grid(scene.name, file_map(scene.name, pyproj.CRS(scene.crs), middle, shape))[0]


@eqx.filter_jit
def exact(scene: tuple[Any, Any, Any], grid: AbstractGrid, rowcol: Any) -> Any:
    """(columns and rows, whether they are on the image) of cells, by `project`, one by one."""
    sensor, shot, dem = scene

    def one(place: Any) -> Any:
        normal = grid.normal(place)
        height, _, status = height_on(dem, normal)
        lat, lon = jnp.arctan2(normal[2], jnp.hypot(normal[0], normal[1])), jnp.arctan2(normal[1], normal[0])
        found = jaxgeo.project(sensor, shot, jaxgeo.Geodetic(lat=lat, lon=lon, height=height))
        return found.uv, (found.status == 0) & (status == 0)

    return jax.vmap(one)(rowcol)


@eqx.filter_jit
def located(sensor: jaxgeo.Sensor, shot: jaxgeo.Shot, uv: Any, level: jaxgeo.ConstantHeight) -> jaxgeo.Fix:
    """Fixes of pixels on a level surface."""
    return jax.vmap(lambda pixel: jaxgeo.locate(sensor, shot, pixel, level))(uv)


def polynomials(scene: Scene) -> Fit:
    """Rational polynomials fitted to a lattice over the frame's footprint, at eight heights."""
    heights = np.asarray(scene.dem.posts)[~np.asarray(scene.dem.void)]
    cols, rows = scene.frame["size"]
    uv = np.stack(np.meshgrid(np.linspace(-0.5, cols - 0.5, 21), np.linspace(-0.5, rows - 0.5, 21)), -1).reshape(-1, 2)
    ground = []
    for level in np.linspace(heights.min() - 20.0, heights.max() + 20.0, 8):
        fix = located(scene.sensor, scene.shot, jnp.asarray(uv), jaxgeo.ConstantHeight(jnp.asarray(level)))
        lat, lon, height = (np.asarray(x) for x in fix.position.to_degrees())
        ground.append(np.stack([lon, lat, height], axis=1))
    return fitted(np.concatenate(ground), np.tile(uv, (8, 1)))


def speed(scene: Scene, cell: float, folder: pathlib.Path, repeats: int) -> Table:
    """Cells per second, compared."""
    peer = Orthority(scene.image, scene.terrain, scene.crs, scene.frame)
    transform, shape = peer.raster(cell)
    grid, fit = grid_of(scene, transform, shape), polynomials(scene)
    given = (scene.sensor, scene.shot, scene.values, scene.dem, grid, shape)
    raster = {"crs": scene.crs, "bounds": array_bounds(*shape, transform), "resolution": cell}
    runs: dict[str, Callable[[], Any]] = {
        "Orthority, in memory": lambda: peer.in_memory(cell),
        "GDAL, rational polynomials, in memory": lambda: warped(
            scene.values, fit.rpc, scene.terrain, scene.crs, transform, shape, CORES
        ),
        "jaxgeo, hidden ground left out, in memory": lambda: rectify(*given),
        "jaxgeo, hidden ground left in, in memory": lambda: rectify(*given, mask_hidden=False),
        "Orthority, to a file": lambda: peer.to_file(str(folder / "theirs.tif"), cell),
        "jaxgeo, hidden ground left out, to a file": lambda: rectify_file(
            folder / "ours.tif", scene.image, scene.sensor, scene.shot, scene.dem, **raster
        ),
        "jaxgeo, hidden ground left in, to a file": lambda: rectify_file(
            folder / "seen.tif", scene.image, scene.sensor, scene.shot, scene.dem, mask_hidden=False, **raster
        ),
    }
    first = {name: measuring.timed(run)[1] for name, run in runs.items()}
    watch, spent = measuring.Watch(), {name: [] for name in runs}
    timings = measuring.interleaved({n: measuring.counting(run, spent[n]) for n, run in runs.items()}, repeats)
    columns = [Column("contender"), Column("time", "s", "lower"), Column("spread", "%", "lower")]
    columns += [Column("rate", "M cells/s", "higher"), Column("rate over Orthority's", "times", "higher")]
    columns += [Column("processor time, least", "ns/cell", "lower"), Column("first call less that", "s", "lower")]
    table = Table(f"{scene.name} onto {shape[1]} x {shape[0]} cells of {cell:g} m", columns)
    count = shape[0] * shape[1]
    for name in runs:
        t, base = timings[name], timings["Orthority, " + name.rsplit(", ", 1)[1]].median
        row = [name, t.median, 100.0 * t.spread, 1e-6 * count / t.median, base / t.median]
        table.rows.append([*row, 1e9 * min(spent[name]) / count, max(first[name] - t.median, 0.0)])
    table.notes.append(f"medians of {repeats}; other processes used {watch.others():.2f} cores")
    return table


def accuracy(scene: Scene, cell: float, folder: pathlib.Path) -> Table:
    """Error of the cells' source coordinates, from rectifying an image of columns and rows, against exact
    projection."""
    cols, rows = scene.frame["size"]
    coordinates = np.stack(np.meshgrid(np.arange(float(cols)), np.arange(float(rows))))
    path = _written(folder / "coordinates.tif", coordinates)
    peer, fit = Orthority(path, scene.terrain, scene.crs, scene.frame), polynomials(scene)
    transform, shape = peer.raster(cell)
    grid = grid_of(scene, transform, shape)
    places = np.random.default_rng(1).integers(0, shape, (CHECKED, 2))
    uv, seen = (np.asarray(x) for x in exact((scene.sensor, scene.shot, scene.dem), grid, places.astype(float)))
    inside = seen & np.all((uv > MARGIN) & (uv < np.array([cols, rows]) - 1.0 - MARGIN), axis=1)
    found = {
        "Orthority": peer.in_memory(cell, "float64"),
        "GDAL, rational polynomials": warped(
            coordinates, fit.rpc, scene.terrain, scene.crs, transform, shape, CORES
        ),
        "jaxgeo": rectify(
            scene.sensor, scene.shot, coordinates, scene.dem, grid, shape, mask_hidden=False
        ).orthoimage.values,
    }  # fmt: skip
    columns = [Column("contender"), Column("RMS", "px", "lower"), Column("largest", "px", "lower"), Column("cells")]
    table = Table(f"{scene.name}, cells of {cell:g} m: off the exact projection", columns)
    for name, values in found.items():
        taken = values[:, places[:, 0], places[:, 1]].T
        known = inside & np.all(np.isfinite(taken), axis=1) & np.any(taken != 0.0, axis=1)
        off = np.hypot(*(taken - uv)[known].T)
        table.rows.append([name, float(np.sqrt(np.mean(off**2))), float(off.max()), int(known.sum())])
    table.notes.append(f"rational polynomials: RMS {fit.rms:.2g} px, at most {fit.largest:.2g} px off on their lattice")
    table.notes.append(f"of {int(inside.sum())} cells drawn that lie {MARGIN:g} px or more inside the image")
    return table


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    options = parser.parse_args()
    tables = []
    with measuring.pinned(CORES), tempfile.TemporaryDirectory() as name:
        _, idle = measuring.idle_check()
        print(idle, file=sys.stderr)
        folder = pathlib.Path(name)
        for scene, cells in scenes(folder):
            for table in (make() for make in _tables(scene, cells, folder, options.repeats)):
                tables.append(table)
                print(table.markdown(), flush=True)
    if options.json is not None:
        record = {"machine": measuring.machine(), "idle": idle, "tables": [table.record() for table in tables]}
        options.json.write_text(json.dumps(record, indent=1) + "\n")


def _tables(
    scene: Scene, cells: tuple[float, ...], folder: pathlib.Path, repeats: int
) -> Iterator[Callable[[], Table]]:
    for cell in cells:
        yield lambda cell=cell: speed(scene, cell, folder, repeats)
    yield lambda: accuracy(scene, cells[0], folder)


if __name__ == "__main__":
    main()

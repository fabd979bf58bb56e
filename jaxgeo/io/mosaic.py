"""Mosaic of rectified images: each cell from the image that shows it with the most pixels, written block by block."""

from __future__ import annotations

import contextlib
import os
import pathlib
import tempfile
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import rasterio
from jaxtyping import Array, Float
from rasterio.windows import Window

from jaxgeo._checks import require_x64
from jaxgeo._compile import batch_filter_jit
from jaxgeo._destination import check_no_input
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io.errors import NothingSeen
from jaxgeo.io.ground_of_image import image_raster
from jaxgeo.io.images import opened
from jaxgeo.io.map_raster import MapRaster, checked_target, is_too_large, map_of
from jaxgeo.io.ortho_writer import OrthoWriter
from jaxgeo.io.reach import Reach
from jaxgeo.io.rectified import rectify_file
from jaxgeo.observation import Exposure
from jaxgeo.ortho.cells import height_on
from jaxgeo.ortho.interpolation import AbstractInterpolation
from jaxgeo.ortho.rectification import BILINEAR
from jaxgeo.sensor import FrameCamera, Shot
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain

BLOCK = 512  # cells along a side of the blocks that are joined
NODES = 17  # along a side of a block, where the sampling by each image is computed
ALIGNED = 1e-6  # cells: largest offset between the cells of two images


class MosaicFile(NamedTuple):
    """Result of `write_mosaic`: the raster, the number of known cells, those by image, and the images that are not in
    it, with the reason."""

    path: str
    raster: MapRaster
    known: int
    used: dict[str, int]
    left_out: dict[str, str]


class _Frame(NamedTuple):
    """A rectified image: its file, and the (row, col) of its first cell in the mosaic."""

    name: str
    file: pathlib.Path
    exposure: Exposure
    raster: MapRaster
    row: int
    col: int


def write_mosaic(
    path: str | os.PathLike[str],
    images: Sequence[str | os.PathLike[str]],
    exposures: Sequence[Exposure],
    terrain: AbstractTerrain,
    *,
    crs: Any = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    interpolation: AbstractInterpolation = BILINEAR,
    callback: Callable[[str, int, int], Any] | None = None,
    allow_remote: bool = False,
    allow_outside: bool = False,
) -> MosaicFile:
    """Rectify images on a terrain, each with its exposure, and join them in a GeoTIFF in their dtype.

    Each cell is from that image which samples the ground there most densely (pixels per area of level ground: the
    square of the focal length times the cosine of the angle from the vertical, by the square of the distance), of those
    that show it; cells hidden by terrain are not shown. Values are not blended. Cells that no image shows are masked,
    for floats NaN.

    - `crs`: anything pyproj takes; by default the UTM zone of the first image that sees ground.
    - `resolution`: cell size, or (across, down), in its unit; by default the GSD at the centre of that image.
    - `callback` is called with "rectifying" or "joining", and how many of how many parts are done.

    The rectified images are written to a hidden folder beside the mosaic, compressed, and removed at the end; they are
    joined block by block, so that memory holds one image at a time. Images that see no ground are left out, and named.

    Raises `ValueError` for counts that differ, other cameras than frame cameras, images of different bands or dtypes,
    and a raster that is too large; `ImageError` for images that cannot be read or are not of the size of their cameras;
    `NothingSeen` if no image sees ground; `OSError` where files cannot be written.
    """
    target = checked_target(path, "a mosaic")
    files, (bands, dtype) = _checked(images, exposures, Reach(allow_remote, allow_outside))
    check_no_input("path", [target], files)
    rasters, left_out = _rasters(files, exposures, terrain, crs, resolution)
    whole = _joined(f"{target}", list(rasters.values()))
    tell = (lambda *_: None) if callback is None else callback
    with tempfile.TemporaryDirectory(prefix=f".{target.stem}-", dir=target.parent) as folder:
        frames = []
        for number, (index, raster) in enumerate(rasters.items()):
            tell("rectifying", number, len(rasters))
            exposure, part = exposures[index], pathlib.Path(folder) / f"{index}.tif"
            air = exposure.atmosphere
            how = {"atmosphere": air, "allow_remote": allow_remote, "allow_outside": allow_outside}
            try:
                rectify_file(
                    part, files[index], exposure.sensor, _shot(exposure), terrain, like=raster,
                    interpolation=interpolation, **how,
                )  # fmt: skip
            except NothingSeen as error:
                left_out[files[index]] = f"{error}".replace(f"{part}", files[index])
                continue
            row, col = (round(x) for x in whole.rowcol(raster.transform.c, raster.transform.f))
            frames.append(_Frame(files[index], part, exposure, raster, row, col))
        if not frames:
            raise NothingSeen(
                f"{target}: no image shows any of its cells; are these too large, with resolution={resolution!r}, or "
                f"the orientations wrong?"
            )
        tags = {"INTERPOLATION": type(interpolation).__name__, "IMAGES": len(frames)}
        with OrthoWriter(target, whole, bands=bands, dtype=dtype, tags=tags) as sink:
            known, used = _write(sink, whole, frames, terrain, tell)
    return MosaicFile(f"{target}", whole, known, used, left_out)


def check_mosaic(
    path: str | os.PathLike[str],
    images: Sequence[str | os.PathLike[str]],
    exposures: Sequence[Exposure],
    terrain: AbstractTerrain,
    *,
    crs: Any = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    allow_remote: bool = False,
    allow_outside: bool = False,
) -> None:
    """Raise what `write_mosaic` raises about images and cells, for exposures that may still change a little: not if no
    image sees ground. The folder of `path` need not be there yet."""
    files, _ = _checked(images, exposures, Reach(allow_remote, allow_outside))
    with contextlib.suppress(NothingSeen):
        _joined(f"{path}", list(_rasters(files, exposures, terrain, crs, resolution)[0].values()))


def _checked(
    images: Sequence[Any], exposures: Sequence[Exposure], reach: Reach
) -> tuple[list[str], tuple[int, np.dtype]]:
    """(the names of the images, their bands and dtype)."""
    require_x64()
    files = [os.fspath(one) for one in images]
    if len(files) != len(exposures) or not files:
        raise ValueError(f"give an exposure for each of one image or more; got {len(files)} and {len(exposures)}.")
    return files, _kind(files, reach)


def _kind(files: Sequence[str], reach: Reach) -> tuple[int, np.dtype]:
    """(bands without alpha, dtype) of all images. Raises `ValueError` if they differ."""
    kinds = []
    for file in files:
        with opened(file, reach) as data:
            alpha = sum(one.name == "alpha" for one in data.colorinterp)
            kinds.append((data.count - alpha, data.dtypes[0]))
    other = next((k for k, kind in enumerate(kinds) if kind != kinds[0]), None)
    if other is not None:
        first, second = (f"{count} of {dtype}" for count, dtype in (kinds[0], kinds[other]))
        raise ValueError(
            f"{files[0]} has bands {first}, {files[other]} {second}; images of one mosaic must have the same bands."
        )
    return kinds[0][0], np.dtype(kinds[0][1])


def _rasters(
    files: Sequence[str], exposures: Sequence[Exposure], terrain: AbstractTerrain, crs: Any, resolution: Any
) -> tuple[dict[int, MapRaster], dict[str, str]]:
    """(cells of each image that sees ground, by index; reasons of the others). All have those of the first."""
    rasters: dict[int, MapRaster] = {}
    left_out: dict[str, str] = {}
    for index, (file, exposure) in enumerate(zip(files, exposures, strict=True)):
        if not isinstance(exposure.sensor.camera, FrameCamera):
            raise ValueError(f"{file}: a mosaic is of frame cameras; got {type(exposure.sensor.camera).__name__}.")
        how = {"atmosphere": exposure.atmosphere}
        try:
            found, _ = image_raster(file, exposure.sensor, _shot(exposure), terrain, crs, resolution, how)
        except NothingSeen as error:
            left_out[file] = f"{error}"
            continue
        rasters[index] = found
        if crs is None or resolution is None:
            crs = found.crs if crs is None else crs
            resolution = (found.transform.a, -found.transform.e) if resolution is None else resolution
    if not rasters:
        raise NothingSeen(f"no image sees any ground; the first: {next(iter(left_out.values()))}")
    return rasters, left_out


def _shot(exposure: Exposure) -> Shot:
    if not isinstance(exposure.motion, Shot):
        raise ValueError(f"a mosaic is of images with a shot each; got a {type(exposure.motion).__name__}.")
    return exposure.motion


def _joined(name: str, rasters: list[MapRaster]) -> MapRaster:
    """The smallest raster of the same lattice that contains all. Raises `ValueError` for one that is too large."""
    first = rasters[0]
    corners = [first.rowcol(one.transform.c, one.transform.f) for one in rasters]
    off = max(abs(x - round(x)) for corner in corners for x in corner)
    if off > ALIGNED:
        raise ValueError(f"{name}: the cells of two images lie {off:.3g} cells apart; state the resolution.")
    top, left = (min(round(corner[k]) for corner in corners) for k in range(2))
    bottom, right = (
        max(round(corner[k]) + one.shape[k] for corner, one in zip(corners, rasters, strict=True)) for k in range(2)
    )
    shape = bottom - top, right - left
    if is_too_large(*shape):
        raise ValueError(
            f"{name}: the mosaic would have {shape[0]} x {shape[1]} cells, more than a file can have; name a coarser "
            f"resolution=."
        )
    return first.part(top, left, shape)


def _write(
    sink: OrthoWriter,
    whole: MapRaster,
    frames: list[_Frame],
    terrain: AbstractTerrain,
    tell: Callable[[str, int, int], Any],
) -> tuple[int, dict[str, int]]:
    """(number of known cells, those by image), once all blocks are written."""
    rows, cols = whole.shape
    blocks = [(row, col) for row in range(0, rows, BLOCK) for col in range(0, cols, BLOCK)]
    used, total = {one.name: 0 for one in frames}, 0
    centres = [np.asarray(one.exposure.sensor.sight(_shot(one.exposure)).centre) for one in frames]
    for number, (row, col) in enumerate(blocks):
        tell("joining", number, len(blocks))
        shape = min(BLOCK, rows - row), min(BLOCK, cols - col)
        near = [k for k, one in enumerate(frames) if _overlap(one, row, col, shape) is not None]
        if not near:
            continue
        places, up = _nodes(f"{sink.target}", whole, row, col, shape, terrain)
        values, best = np.zeros((sink.bands, *shape), sink.dtype), np.zeros(shape)
        source = np.full(shape, -1)
        for k in near:
            part, window = _overlap(frames[k], row, col, shape)  # pyright: ignore[reportGeneralTypeIssues]
            with rasterio.open(frames[k].file) as data:
                seen, known = data.read(window=window), data.read_masks(1, window=window) > 0
            score = _sampling(frames[k], centres[k], places, up, shape)[part]
            better = known & (score > best[part])
            values[(slice(None), *part)] = np.where(better, seen, values[(slice(None), *part)])
            best[part] = np.where(better, score, best[part])
            source[part] = np.where(better, k, source[part])
        for k in near:
            used[frames[k].name] += int(np.count_nonzero(source == k))
        total += int(np.count_nonzero(source >= 0))
        sink.write(row, col, values, source >= 0)
    return total, used


def _overlap(frame: _Frame, row: int, col: int, shape: tuple[int, int]) -> tuple[tuple[slice, slice], Window] | None:
    """(the part of a block that a frame covers, the window of the frame there); None if they do not overlap."""
    top, left = max(row, frame.row), max(col, frame.col)
    bottom = min(row + shape[0], frame.row + frame.raster.shape[0])
    right = min(col + shape[1], frame.col + frame.raster.shape[1])
    if top >= bottom or left >= right:
        return None
    part = slice(top - row, bottom - row), slice(left - col, right - col)
    window = Window(left - frame.col, top - frame.row, right - left, bottom - top)  # pyright: ignore[reportCallIssue]
    return part, window


def _nodes(
    name: str, whole: MapRaster, row: int, col: int, shape: tuple[int, int], terrain: AbstractTerrain
) -> tuple[np.ndarray, np.ndarray]:
    """Ground of a lattice over a block: positions (NODES, NODES, 3) in ECEF and directions up."""
    r, c = (np.linspace(first, first + n - 1.0, NODES) for first, n in zip((row, col), shape, strict=True))
    r, c = (x.ravel() for x in np.meshgrid(r, c, indexing="ij"))
    lon, lat = map_of(name, whole).lonlat(r, c)
    lat, lon = (jnp.asarray(np.deg2rad(x)) for x in (lat, lon))
    place, up, height = (np.asarray(x) for x in _ground(terrain, lat, lon))
    known = np.isfinite(height)
    level = float(np.mean(height[known])) if np.any(known) else 0.0
    place = place + np.where(known, height, level)[:, None] * up
    return place.reshape(NODES, NODES, 3), up.reshape(NODES, NODES, 3)


@batch_filter_jit
def _ground(
    terrain: AbstractTerrain, lat: Float[Array, " n"], lon: Float[Array, " n"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, " n"]]:
    """(points on the ellipsoid, directions up, heights of the terrain in m, NaN where unknown)."""

    def one(lat: Array, lon: Array) -> tuple[Array, Array, Array]:
        up = jnp.stack([jnp.cos(lat) * jnp.cos(lon), jnp.cos(lat) * jnp.sin(lon), jnp.sin(lat)])
        height, _, status = height_on(terrain, up)
        foot = WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=jnp.zeros(())))
        return foot, up, jnp.where(status == Status.hit.code, height, jnp.nan)

    return jax.vmap(one)(lat, lon)


def _sampling(
    frame: _Frame, centre: np.ndarray, places: np.ndarray, up: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Pixels per square metre of level ground (rows, cols) by an image, from those at the nodes."""
    camera = frame.exposure.sensor.camera
    assert isinstance(camera, FrameCamera)
    away = centre - places
    distance = np.linalg.norm(away, axis=-1)
    steep = np.maximum(np.sum(away * up, axis=-1) / distance, 1e-6)
    at_nodes = float(np.prod(np.asarray(camera.focal_px))) * steep / distance**2
    down, across = (_interpolation(n) for n in shape)
    return down @ at_nodes @ across.T


def _interpolation(count: int) -> np.ndarray:
    """Linear interpolation (count, NODES) of nodes that are evenly spread over the cells."""
    place = np.linspace(0.0, NODES - 1.0, count) if count > 1 else np.zeros(1)
    first = np.minimum(place.astype(int), NODES - 2)
    matrix = np.zeros((count, NODES))
    matrix[np.arange(count), first] = 1.0 - (place - first)
    matrix[np.arange(count), first + 1] = place - first
    return matrix

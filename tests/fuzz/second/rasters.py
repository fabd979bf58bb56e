"""Second readings of rasters: by rasterio and Pillow, and of text and GTX grids by words and bytes."""

from __future__ import annotations

import pathlib
import re
import struct
import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pyproj
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from tests.fuzz.second.compared import bilinear, same, same_turn
from tests.fuzz.sound_files import HILLS

UNITS = dict.fromkeys(("", "m", "metre", "meter", "metres", "meters"), 1.0) | dict.fromkeys(
    ("ft", "foot", "feet"), 0.3048
)

GRID_HEADER = re.compile(
    r"(?<!\S)(ncols|nrows|[xy]ll(?:corner|center)|cellsize|dx|dy|nodata_value)\s+(\S+)", re.IGNORECASE
)


def opened(path: pathlib.Path) -> Any:
    """An open raster."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        return rasterio.open(path)


def dem(path: pathlib.Path, found: Any) -> None:
    """Every known post is the file's value by scale, offset and unit; every value marked as unknown is void."""
    with opened(path) as data:
        stored, unit = data.read(1), UNITS[(data.units[0] or "").lower()]
        values = (stored.astype(np.float64) * data.scales[0] + data.offsets[0]) * unit
        void = data.read_masks(1) == 0
        transform, crs = data.transform, data.crs
    void |= ~np.isfinite(values)
    rows, cols = (int(n) for n in np.asarray(found.extent))
    assert (rows, cols) == stored.shape, f"{(rows, cols)} posts, by the second reading {stored.shape}"
    posts = np.asarray(found.posts)[:rows, :cols]
    known = ~_void_posts(found, rows, cols)
    assert not (known & void).any(), "a post is known whose value means that it is not"
    same("heights", posts[known], values[known], 1e-6, 2e-7)
    _same_map(found, transform, crs, stored.shape)


def _void_posts(found: Any, rows: int, cols: int) -> np.ndarray:
    return np.asarray(found.void)[:rows, :cols]


def _same_map(found: Any, transform: Any, crs: Any, shape: tuple[int, int]) -> None:
    """The first and the last post lie in the middle of their pixels: to 1 cm, by PROJ."""
    to_earth = pyproj.Transformer.from_crs(pyproj.CRS.from_wkt(crs.to_wkt()), "EPSG:4326", always_xy=True)
    for row, col in ((0, 0), (shape[0] - 1, shape[1] - 1)):
        lon, lat = to_earth.transform(*(transform @ (col + 0.5, row + 0.5)))
        x, y, z = np.asarray(found.grid.normal(jnp.asarray([row, col], jnp.float64)))
        same("latitude of a post", np.rad2deg(np.arctan2(z, np.hypot(x, y))), lat, 1e-7)
        same_turn("longitude of a post", np.rad2deg(np.arctan2(y, x)), lon, 1e-7)


def ascii_grid(path: pathlib.Path, found: Any) -> None:
    """ncols, nrows, a corner, cell size, perhaps NODATA_value; then numbers, row by row from the north."""
    lines = path.read_bytes().decode("latin-1").splitlines()
    start = next(k for k, line in enumerate(lines) if re.match(r"\s*[-+.0-9]", line))
    pairs = GRID_HEADER.findall(" ".join(lines[:start]))
    header = {name.lower(): float(value.replace(",", ".")) for name, value in reversed(pairs)}  # the first
    words = " ".join(lines[start:]).split()
    rows, cols = int(header["nrows"]), int(header["ncols"])
    values = np.array([float(word.replace(",", ".")) for word in words], np.float64).reshape(rows, cols)
    posts = np.asarray(found.posts)[:rows, :cols]
    known = ~_void_posts(found, rows, cols)
    marked = np.isclose(values, header.get("nodata_value", np.nan), rtol=1e-7)
    assert not (known & marked).any(), "a post is known whose value is NODATA_value"
    same("heights", posts[known], values[known], 1e-6 * max(1.0, float(np.abs(values[known]).max())))
    step = [header["cellsize" if "cellsize" in header else name] for name in ("dx", "dy")]
    inset = 0.0 if "xllcorner" in header and "yllcorner" in header else 0.5
    west, south = (header[f"{axis}ll{'center' if inset else 'corner'}"] for axis in "xy")
    corner = rasterio.Affine(step[0], 0.0, west - inset * step[0], 0.0, -step[1], south + (rows - inset) * step[1])
    _same_map(found, corner, rasterio.CRS.from_epsg(4326), (rows, cols))


def gtx(path: pathlib.Path, found: Any) -> None:
    """40 bytes, big-endian: first latitude and longitude, steps, rows, columns; then float32 from the south."""
    content = path.read_bytes()
    lat, lon, step_lat, step_lon = struct.unpack(">4d", content[:32])
    rows, cols = struct.unpack(">2i", content[32:40])
    values = np.frombuffer(content, ">f4", rows * cols, 40).reshape(rows, cols).astype(np.float64)[::-1]
    north = lat + (rows - 1) * step_lat
    corner = rasterio.Affine(step_lon, 0.0, lon - step_lon / 2.0, 0.0, -step_lat, north + step_lat / 2.0)
    _undulations(path, found, values, corner)


def geoid_tiff(path: pathlib.Path, found: Any) -> None:
    with opened(path) as data:
        _undulations(path, found, data.read(1).astype(np.float64) * data.scales[0] + data.offsets[0], data.transform)


def _undulations(path: pathlib.Path, found: Any, grid: np.ndarray, transform: Any) -> None:
    """What was added to each post of the hills is the grid between its posts."""
    with opened(path.parent / "ground.tif") as data:
        corner, shape = data.transform, data.shape
    row, col = np.indices(shape)
    lon, lat = corner.c + corner.a * (col + 0.5), corner.f + corner.e * (row + 0.5)
    grid = np.where(np.abs(grid) > 1000.0, np.nan, grid)  # PROJ takes these as unknown, and the posts around them
    expected = HILLS + bilinear(grid, transform, lat, lon)
    known = ~_void_posts(found, *shape) & np.isfinite(expected)
    same("heights", np.asarray(found.posts)[: shape[0], : shape[1]][known], expected[known], 1e-3)


def image(path: pathlib.Path, found: Any) -> None:
    """Values by rasterio; of PNG and uncompressed TIFF by Pillow too, where it reads the file."""
    values, _ = found
    with rasterio.Env(GDAL_PNG_WHOLE_IMAGE_OPTIM="NO"), opened(path) as data:
        same("pixels", values, data.read(list(range(1, len(values) + 1))))
    if path.read_bytes()[:4] in (b"\x89PNG", b"II*\x00"):
        _by_pillow(path, values)


def _by_pillow(path: pathlib.Path, values: np.ndarray) -> None:
    from PIL import Image

    try:
        with Image.open(path) as picture:
            pixels = np.asarray(picture)
    except Exception:  # it reads less than GDAL does
        return
    if pixels.ndim == 3 and pixels.shape[2] >= len(values) and pixels.dtype == values.dtype:
        same("pixels by Pillow", values, np.moveaxis(pixels, -1, 0)[: len(values)])


def orthoimage(path: pathlib.Path, found: Any) -> None:
    with opened(path) as data:
        same("pixels", found.values, data.read(list(range(1, len(found.values) + 1))))


def bounds(path: pathlib.Path, found: Any) -> None:
    """Bounds kept by an earlier run are those of the posts, or are not taken."""
    found.blocks.read()
    low, high = float(np.min(found.blocks.low)), float(np.max(found.blocks.high))
    assert low <= HILLS.min() + 1e-6 <= HILLS.max() <= high + 1e-6, f"bounds {low} to {high} do not hold the posts"
    assert high - low <= np.ptp(HILLS) + 1.0, f"bounds {low} to {high} are wider than the posts"

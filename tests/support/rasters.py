"""Small rasters written for the tests of the readers."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import Affine

DEGREE = 1.0 / 1200.0


def hills(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    """Smooth made-up heights between about 100 and 900 m."""
    rng = np.random.default_rng(seed)
    row, col = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    heights = np.full(shape, 500.0)
    for _ in range(6):
        a, b, phase = rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(0, 6.28)
        heights += 60.0 * np.sin(a * row + b * col + phase)
    return heights


def write(
    path: pathlib.Path,
    heights: np.ndarray,
    *,
    crs: Any = "EPSG:4326",
    affine: Affine | None = Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0),
    point: bool = False,
    unit: str | None = None,
    scale: float | None = None,
    offset: float | None = None,
    mask: np.ndarray | None = None,
    **profile: Any,
) -> pathlib.Path:
    """A GeoTIFF of (rows, cols) or (bands, rows, cols) heights; `affine` maps corners, as GDAL's do."""
    bands = heights if heights.ndim == 3 else heights[None]
    made = {
        "driver": "GTiff",
        "dtype": bands.dtype,
        "count": bands.shape[0],
        "height": bands.shape[1],
        "width": bands.shape[2],
        "crs": crs,
    }
    if affine is not None:
        made["transform"] = affine
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "w", **made | profile) as sink:
        if point:
            sink.update_tags(AREA_OR_POINT="Point")
        sink.write(bands)
        if unit is not None:
            sink.units = (unit,) * bands.shape[0]
        if scale is not None:
            sink.scales = (scale,) * bands.shape[0]
        if offset is not None:
            sink.offsets = (offset,) * bands.shape[0]
        if mask is not None:
            sink.write_mask(mask)
    return path

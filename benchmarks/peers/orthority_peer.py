"""Orthority: a frame rectified in a map treated as Cartesian; occluded ground is not masked."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import Affine


class Sink:
    """In-memory array target for Orthority's tiles, instead of a file."""

    def __init__(self, bands: int, shape: tuple[int, int], transform: Affine, dtype: str) -> None:
        self.values = np.zeros((bands, *shape), dtype)
        self.count, (self.height, self.width), self.shape = bands, shape, shape
        self.driver, self.block_shapes = "GTiff", [(512, 512)] * bands
        self.profile = {"dtype": dtype, "transform": transform, "count": bands, "height": shape[0], "width": shape[1]}

    def write(self, values: np.ndarray, indexes: Any, window: Any) -> None:
        row, col = window.row_off, window.col_off
        self.values[:, row : row + window.height, col : col + window.width] = values


class Orthority:
    """An `Ortho` of one image, terrain and orientation, all in one map."""

    def __init__(self, image: str, terrain: str, crs: str, frame: dict[str, Any]) -> None:
        import orthority  # pyright: ignore[reportMissingImports]
        from orthority.camera import PinholeCamera  # pyright: ignore[reportMissingImports]
        from orthority.ortho import Ortho  # pyright: ignore[reportMissingImports]

        warnings.simplefilter("ignore")
        self.version = getattr(orthority, "__version__", "")
        size = frame["size"]
        camera = PinholeCamera(size, frame["focal_px"], sensor_size=size, xyz=frame["xyz"], opk=frame["opk"])
        self.ortho = Ortho(image, terrain, camera, crs=rasterio.CRS.from_wkt(crs))

    def raster(self, resolution: float) -> tuple[Affine, tuple[int, int]]:
        """Transform and shape of its output at a resolution."""
        dem, transform = self._terrain(resolution)
        return transform, dem.shape

    def in_memory(self, resolution: float, dtype: str | None = None) -> np.ndarray:
        """The rectified image (bands, rows, cols), by Orthority's own steps except for the file; reads the source."""
        from orthority import common  # pyright: ignore[reportMissingImports]
        from orthority.enums import Interp  # pyright: ignore[reportMissingImports]
        from tqdm.auto import tqdm  # pyright: ignore[reportMissingModuleSource]

        dem, transform = self._terrain(resolution)
        with common.suppress_no_georef(), rasterio.open(self.ortho._src_file) as source, tqdm(disable=True) as bar:
            sink: Any = Sink(source.count, dem.shape, transform, dtype or source.dtypes[0])
            self.ortho._remap(source, sink, dem, Interp.bilinear, False, False, bar)
        return sink.values

    def to_file(self, path: str, resolution: float) -> None:
        """A deflated GeoTIFF in tiles, with a mask, as ours."""
        how = {"tiled": "YES", "blockxsize": 256, "blockysize": 256, "interleave": "pixel", "num_threads": "ALL_CPUS"}
        how |= {"compress": "DEFLATE", "predictor": 2, "zlevel": 1}
        self.ortho.process(
            path, (resolution, resolution), interp="bilinear", dem_interp="bilinear", write_mask=True,
            creation_options=how, build_ovw=False, overwrite=True,
        )  # fmt: skip

    def _terrain(self, resolution: float) -> tuple[np.ndarray, Affine]:
        from orthority.enums import Interp  # pyright: ignore[reportMissingImports]

        dem, transform = self.ortho._reproject_dem(Interp.bilinear, (resolution, resolution))
        return self.ortho._mask_dem(dem, transform, Interp.bilinear)

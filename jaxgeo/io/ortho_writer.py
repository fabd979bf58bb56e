"""Orthoimage writer: GeoTIFF and cloud-optimised GeoTIFF, whole or window by window."""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.dtypes import check_dtype
from rasterio.errors import RasterioError
from rasterio.windows import Window

from jaxgeo._checks import check_is
from jaxgeo._partial import partial_file
from jaxgeo.io._read_back import WrittenWindows
from jaxgeo.io.map_raster import MOST_WRITTEN, MapRaster, checked_target, is_too_large, map_of
from jaxgeo.io.mapping import measure
from jaxgeo.ortho.orthoimage import Orthoimage

BLOCK = 256  # cells on a side of the tiles of a file
QUICK = 1  # of nine deflate levels: the others take three times as long for a few percent
OFF_RASTER = 0.01  # cells: largest offset between an orthoimage and its raster


class OrthoWriter:
    """A GeoTIFF written window by window, in any order; it appears under its name when the context exits normally.

    Windows aligned to multiples of `BLOCK` cells and of that size are written fastest. Cells that are not written or
    not known hold `nodata`, by default NaN for floats; integers have a mask in the file instead, unless a value is
    given, so that all their values remain usable. `cog` makes a cloud-optimised GeoTIFF, with overviews. The
    constructor raises `ValueError`, `FileNotFoundError` or `PermissionError` for files that cannot be written; writing
    raises `OSError`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        raster: MapRaster,
        *,
        bands: int,
        dtype: Any,
        nodata: float | int | None = None,
        cog: bool = False,
        tags: Mapping[str, Any] | None = None,
        descriptions: Sequence[str] | None = None,
    ) -> None:
        self.target = checked_target(path, "an orthoimage")
        if is_too_large(*raster.shape):
            raise ValueError(
                f"{self.target}: a raster of {raster.shape[0]} x {raster.shape[1]} cells is larger than a file can be "
                f"({MOST_WRITTEN:.2g} cells); take larger cells, or a part of it."
            )
        self.raster, self.bands, self.dtype, self.cog = raster, bands, np.dtype(dtype), cog
        self.nodata = _checked_nodata(f"{self.target}", self.dtype, nodata)
        self._tags = {"SOFTWARE": "jaxgeo"} | {key: f"{value}" for key, value in (tags or {}).items()}
        self._descriptions = None if descriptions is None else tuple(descriptions)
        self._partial = self.target  # while open, the file that will replace it
        self._opened = contextlib.ExitStack()
        self._sink: Any = None
        self._written = WrittenWindows(raster.shape)

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            f"{self.target}: an OrthoWriter has its file open and cannot be copied or sent to another process. Return "
            f"the windows from the workers and write them here, or let each worker write a file of its own."
        )

    def __enter__(self) -> OrthoWriter:
        self._partial = self._opened.enter_context(partial_file(self.target))
        try:
            with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
                self._sink = rasterio.open(self._partial, "w", **self._profile())
            self._sink.update_tags(**self._tags)
            if self._descriptions is not None:
                self._sink.descriptions = self._descriptions
        except (OSError, RasterioError) as error:
            self._drop()
            raise self._failure(error) from error
        return self

    def write(self, row: int, col: int, values: np.ndarray, known: np.ndarray | None = None) -> None:
        """Write a window that starts at (row, col): values (bands, rows, cols), and the known mask (rows, cols).

        By default all finite values are known. Raises `ValueError` for another number of bands or
        dtype, a window beyond the raster, and a known value that equals the nodata value.
        """
        if self._sink is None:
            raise ValueError(f"{self.target}: the file is not open; write inside `with OrthoWriter(...) as sink:`.")
        values, known = self._checked(row, col, values, known)
        window = Window(col, row, *known.shape[::-1])  # pyright: ignore[reportCallIssue]
        if self.nodata is not None:
            self._check_no_collision(values, known, row, col)
            values = np.where(known, values, np.asarray(self.nodata, self.dtype))
        try:
            with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
                self._sink.write(values, window=window)
                if self.nodata is None:
                    self._sink.write_mask(known, window=window)
        except (OSError, RasterioError) as error:
            raise self._failure(error) from error
        self._written.add(row, col, values, known if self.nodata is None else None)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if self._sink is not None:
                self._sink.close()  # flushes GDAL's cache
            if kind is None:
                self._check_written(self._partial)
                self._finish()
        except (OSError, RasterioError) as error:
            raise self._failure(error) from error
        finally:
            self._drop()

    def _profile(self) -> dict[str, Any]:
        rows, cols = self.raster.shape
        is_picture = self.bands == 3 and self.dtype in (np.uint8, np.uint16)
        profile = {"driver": "GTiff", "dtype": self.dtype.name, "count": self.bands, "height": rows, "width": cols}
        profile |= {"crs": self.raster.crs.to_wkt(), "transform": self.raster.transform, "nodata": self.nodata}
        profile |= {"tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK, "BIGTIFF": "IF_SAFER"}
        profile |= {"compress": "deflate", "zlevel": QUICK, "num_threads": "ALL_CPUS"}
        profile |= {"predictor": 3 if self.dtype.kind == "f" else 2}
        # GDAL would take the fourth band of four for an alpha band.
        return profile | {"photometric": "RGB" if is_picture else "MINISBLACK", "ALPHA": "NO"}

    def _checked(self, row: int, col: int, values: Any, known: Any) -> tuple[np.ndarray, np.ndarray]:
        values = np.asarray(values)
        if values.ndim != 3 or values.shape[0] != self.bands or values.dtype != self.dtype:
            raise ValueError(
                f"{self.target}: values must be {self.dtype} of shape ({self.bands}, rows, cols); got {values.dtype} "
                f"of shape {values.shape}."
            )
        shape, (rows, cols) = values.shape[1:], self.raster.shape
        if min(row, col) < 0 or row + shape[0] > rows or col + shape[1] > cols:
            raise ValueError(
                f"{self.target}: a window of {shape} cells at row {row}, column {col} reaches beyond the raster of "
                f"{rows} x {cols}."
            )
        known = np.ones(shape, bool) if known is None else np.asarray(known, bool)
        if known.shape != shape:
            raise ValueError(f"{self.target}: known must have the shape {shape} of the values; got {known.shape}.")
        if self.dtype.kind == "f":
            known = known & np.isfinite(values).all(axis=0)
        return values, known

    def _check_no_collision(self, values: np.ndarray, known: np.ndarray, row: int, col: int) -> None:
        where = known & (values == np.asarray(self.nodata, self.dtype)).any(axis=0)
        if where.any():
            first = np.argwhere(where)[0]
            raise ValueError(
                f"{self.target}: the value at row {row + first[0]}, column {col + first[1]} is known and is the nodata "
                f"value {self.nodata:g}, which would lose it. Name a value that the image has not, or leave nodata= "
                f"out."
            )

    def _finish(self) -> None:
        if not self.cog:
            self._partial.replace(self.target)
            return
        copy = self._partial.with_name(f"{self._partial.name}.cog")
        predictor = "FLOATING_POINT" if self.dtype.kind == "f" else "STANDARD"
        options = {"COMPRESS": "DEFLATE", "PREDICTOR": predictor, "BLOCKSIZE": 2 * BLOCK, "BIGTIFF": "IF_SAFER"}
        rasterio.shutil.copy(self._partial, copy, driver="COG", OVERVIEW_RESAMPLING="AVERAGE", **options)
        self._check_written(copy)
        copy.replace(self.target)

    def _check_written(self, path: pathlib.Path) -> None:
        mistake = self._written.mistake(path)
        if mistake:
            raise OSError(mistake)

    def _drop(self) -> None:
        self._sink = None
        self._opened.close()

    def _failure(self, error: Exception) -> OSError:
        reason = f"{error}".replace(self._partial.name, self.target.name).rstrip(".")
        return OSError(f"{self.target}: the orthoimage cannot be written here: {reason}.")


def write_orthoimage(
    path: str | os.PathLike[str],
    image: Orthoimage | Any,
    raster: MapRaster,
    *,
    known: Any = None,
    nodata: float | int | None = None,
    cog: bool = False,
    tags: Mapping[str, Any] | None = None,
) -> None:
    """Write an orthoimage, or values (rows, cols) or (bands, rows, cols) with `known`, to a GeoTIFF in their own dtype.

    `raster` is the map: that of `read_orthoimage_and_report`, or of `rectify_file`. Other options and errors as for
    `OrthoWriter`; also `ValueError` if an orthoimage's own grid differs from the raster, or nothing is known.
    """
    target = checked_target(path, "an orthoimage")
    check_is(raster, MapRaster, "raster")
    if isinstance(image, Orthoimage):
        values, known = np.asarray(image.values), np.asarray(image.known)
    else:
        values = np.asarray(image)
        values = values[None] if values.ndim == 2 else values
        known = np.ones(values.shape[1:], bool) if known is None else np.asarray(known, bool)
    if values.shape[1:] != tuple(raster.shape):
        raise ValueError(
            f"{target}: values must be {raster.shape[0]} rows of {raster.shape[1]} cells, as the raster has; got shape "
            f"{values.shape}."
        )
    if isinstance(image, Orthoimage):
        _check_same_place(target, image, raster)
    if not known.any():
        raise ValueError(f"{target}: nothing is known of this orthoimage; there is nothing to write.")
    with OrthoWriter(
        target, raster, bands=values.shape[0], dtype=values.dtype, nodata=nodata, cog=cog, tags=tags
    ) as sink:
        sink.write(0, 0, values, known)


def _check_same_place(target: pathlib.Path, image: Orthoimage, raster: MapRaster) -> None:
    off = measure(image.grid, map_of(f"{target}", raster)).cells
    if not off <= OFF_RASTER:
        raise ValueError(
            f"{target}: the orthoimage lies up to {off:.3g} cells beside the raster; give the raster that it was read "
            f"from, or made for."
        )


def _checked_nodata(name: str, dtype: np.dtype, nodata: Any) -> float | int | None:
    """A nodata value in a dtype; for floats NaN by default, None if a mask is used instead."""
    if dtype.kind not in "uif" or not check_dtype(dtype.name):
        raise ValueError(f"{name}: a GeoTIFF holds no {dtype}; convert the values first, e.g. to float32.")
    if nodata is None:
        return float("nan") if dtype.kind == "f" else None
    try:
        number = dtype.type(nodata)
        fits = bool(number == nodata) or bool(dtype.kind == "f" and (np.isnan(nodata) or np.isfinite(number)))
    except (OverflowError, TypeError, ValueError):
        fits = False
    if not fits:
        raise ValueError(f"{name}: nodata={nodata!r} is no number that {dtype} can hold; leave it out for a mask.")
    return number.item()

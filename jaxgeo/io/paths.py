"""Expansion of path arguments: one file, several, a folder of tiles, or a pattern."""

from __future__ import annotations

import glob
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from jaxgeo.io._gdal import GDAL_ERRORS
from jaxgeo.io._rasters import open_raster
from jaxgeo.io.errors import DemError
from jaxgeo.io.reach import HERE, Reach, file_in, is_remote

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

RASTERS = (
    ".tif", ".tiff", ".hgt", ".hgt.zip", ".hgt.gz", ".dt0", ".dt1", ".dt2", ".asc", ".img", ".bil", ".flt", ".bt",
    ".dem", ".ter", ".nc", ".grd", ".gtx", ".jp2",
)  # fmt: skip


def expanded(paths: Paths) -> list[str]:
    """The files of a path argument, those of a folder and of a pattern sorted by name.

    A folder means every raster directly in it (by extension; a VRT only if there is nothing else), a
    pattern such as "tiles/**/*.tif" all its matches. Raises `FileNotFoundError` or `DemError`.
    """
    names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not names:
        raise DemError("no file was named: paths is empty.")
    files = [file for name in names for file in _expanded(os.fspath(name))]
    if len(set(files)) < len(files):
        twice = next(file for file in files if files.count(file) > 1)
        raise DemError(f"{twice}: the file is named twice.")
    return files


def with_full_names(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments with absolute names of files, folders and patterns, valid in any working folder.

    For arguments of `open_dem`: `path_or_paths`, `cache`, and a `vertical_datum` that is the path of a grid.
    """
    paths, datum, cache = asked["path_or_paths"], asked["vertical_datum"], asked["cache"]
    names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    is_grid = isinstance(datum, os.PathLike) or (isinstance(datum, str) and os.path.isfile(datum))
    return {
        **asked,
        "path_or_paths": [_with_full_name(os.fspath(name)) for name in names],
        "vertical_datum": pathlib.Path(datum).absolute() if is_grid else datum,
        "cache": None if cache is None else os.path.abspath(cache),
    }


def _with_full_name(name: str) -> str:
    if is_remote(name):
        return name
    file = None if os.path.exists(name) else file_in(name)
    return os.path.abspath(name) if file is None else name.replace(file, os.path.abspath(file), 1)


def files_behind(path: str | os.PathLike[str], reach: Reach = HERE) -> list[str]:
    """The file of a raster, and those that GDAL reads with it: sources of a VRT, world files, masks."""
    name = os.fspath(path)
    try:
        with open_raster(name, reach, DemError, "a raster") as data:
            return [name, *data.files]
    except (DemError, *GDAL_ERRORS, OSError):
        return [name]  # the reader raises the reason


def are_all_named(paths: Paths) -> bool:
    """Whether the caller named each file, instead of a folder or a pattern."""
    names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    return len(expanded(names)) == len(names)


def _expanded(name: str) -> list[str]:
    if is_remote(name) or (file_in(name) is not None and not os.path.exists(name)):
        return [name]
    if os.path.isdir(name):
        return [name] if os.path.exists(os.path.join(name, "hdr.adf")) else _in_folder(name)  # one ESRI grid
    if any(mark in name for mark in "*?[") and not os.path.exists(name):
        found = sorted(file for file in glob.glob(name, recursive=True) if os.path.isfile(file))
        if not found:
            raise FileNotFoundError(f"{name}: no file matches this pattern.")
        return found
    return [name]


def _in_folder(name: str) -> list[str]:
    files = sorted(path for path in pathlib.Path(name).iterdir() if path.is_file() and not path.name.startswith("."))
    rasters = [path for path in files if path.name.lower().endswith(RASTERS)]
    rasters = rasters or [path for path in files if path.suffix.lower() == ".vrt"]
    if not rasters:
        held = f"{len(files)} other files, the first {files[0].name}" if files else "no files"
        raise DemError(
            f"{name}: the folder holds no raster by its ending ({', '.join(RASTERS[:5])}, ...), but {held}. Name the "
            f'files themselves, or a pattern such as "{name}/**/*.tif" for tiles in folders below it.'
        )
    return [str(path) for path in rasters]

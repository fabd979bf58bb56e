"""Results of a parameter study in memory, and in a Zarr store that later runs complete."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray

STUDY, FINISHED = "sweep", "finished"  # attribute and variable of the store
Region = tuple[slice, ...]


class Results:
    """Arrays over the axes of a study, filled block by block; NaN (zero for integers) where not yet computed."""

    def __init__(
        self,
        names: tuple[str, ...],
        coordinates: Mapping[str, tuple[np.ndarray, str]],
        units: Mapping[str, str],
        dims: Mapping[str, tuple[str, ...]],
    ) -> None:
        self.names, self._coordinates, self._units, self._dims = names, coordinates, units, dims
        self.shape = tuple(len(coordinates[name][0]) for name in names)
        self.arrays: dict[str, np.ndarray] = {}

    def put(self, region: Region, found: Mapping[str, np.ndarray]) -> None:
        """Fill a block with results (cells, ...); raises `ValueError` for other names or shapes than before."""
        is_first = not self.arrays
        kinds = {name: values.shape[1:] for name, values in found.items()}
        before = {name: array.shape[len(self.shape) :] for name, array in self.arrays.items()}
        if self.arrays and kinds != before:
            raise ValueError(f"results must have the same names and shapes in all cells; got {before} and {kinds}.")
        block = tuple(place.stop - place.start for place in region)
        for name, values in found.items():
            if not (np.issubdtype(values.dtype, np.number) or values.dtype == bool):
                raise ValueError(f"results must be numbers or flags; {name} is {values.dtype}.")
            if name not in self.arrays:
                self.arrays[name] = _blank((*self.shape, *values.shape[1:]), values.dtype)
            if not np.can_cast(values.dtype, self.arrays[name].dtype):
                raise ValueError(
                    f"results must be of one type in all cells; {name} is {self.arrays[name].dtype} in some and "
                    f"{values.dtype} in others. Convert it with float(...)."
                )
            self.arrays[name][region] = values.reshape(*block, *values.shape[1:])
        if is_first:
            self.check()

    def dims_of(self, name: str) -> tuple[str, ...]:
        """Names of the dimensions of a result."""
        more = self.arrays[name].ndim - len(self.names)
        return (*self.names, *self._dims.get(name, tuple(f"{name}_{k}" for k in range(more))))

    def dataset(self) -> xarray.Dataset:
        """All results with their axes."""
        variables = {
            name: (self.dims_of(name), array, {"units": self._units[name]} if name in self._units else {})
            for name, array in self.arrays.items()
        }
        coordinates = {
            name: ((name,), values, {"units": unit} if unit else {})
            for name, (values, unit) in self._coordinates.items()
        }
        return xarray_library().Dataset(variables, coords=coordinates)

    def open(self, path: pathlib.Path) -> xarray.Dataset:
        """A dataset of an earlier run."""
        return xarray_library().open_zarr(path, decode_cf=False)

    def check(self) -> None:
        """Raise `ValueError` for results whose names or dimensions contradict the axes or each other."""
        sizes = dict(zip(self.names, self.shape, strict=True))
        for name, array in self.arrays.items():
            shape, dims = array.shape[len(self.names) :], self.dims_of(name)[len(self.names) :]
            if name in (*self.names, FINISHED) or "/" in name:
                raise ValueError(
                    f"the result {name} has the name of an axis or of a flag, or a slash; name it otherwise."
                )
            if len(dims) != len(shape):
                raise ValueError(
                    f"dims names {len(dims)} dimensions of {name} ({', '.join(dims)}), but its shape in a cell is "
                    f"{shape}."
                )
            for dim, size in zip(dims, shape, strict=True):
                if dim in self.names or dim in self.arrays or sizes.setdefault(dim, size) != size:
                    raise ValueError(
                        f"the dimension {dim} of {name}, of {size}, has the name of an axis, of a result, or of a "
                        f"dimension of another size; name it otherwise by dims=."
                    )


def _blank(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    return np.full(shape, np.nan, dtype) if np.issubdtype(dtype, np.inexact) else np.zeros(shape, dtype)


class Store:
    """A Zarr store with the results of a study: what they depend on as an attribute, and a flag of each finished cell.

    Blocks are written first and flagged then, so that a process may end at any time.
    """

    def __init__(self, folder: str | os.PathLike[str], identity: Mapping[str, str], block: Sequence[int]) -> None:
        self._path, self._identity, self._block = pathlib.Path(folder), dict(identity), tuple(block)
        _require_zarr()

    def read_into(self, results: Results, regions: Sequence[Region]) -> set[int]:
        """Numbers of the finished blocks, whose results are read; raises `ValueError` if the folder holds something
        else."""
        if not self._exists():
            return set()
        try:
            with results.open(self._path) as kept:
                identity = dict(json.loads(kept.attrs[STUDY]))
                arrays = {str(name): np.array(values.to_numpy()) for name, values in kept.data_vars.items()}
                finished = arrays.pop(FINISHED)
        except Exception:  # whatever another file causes
            raise ValueError(f"folder {self._path} holds something that is not a sweep; give another one.") from None
        others = [name for name in {**identity, **self._identity} if identity.get(name) != self._identity.get(name)]
        if others:
            raise ValueError(
                f"folder {self._path} holds another sweep, with other values of: {', '.join(others)}. Give another "
                f"folder, or remove this one."
            )
        results.arrays = arrays
        results.check()
        return {number for number, region in enumerate(regions) if finished[region].all()}

    def write(self, region: Region, results: Results) -> None:
        """Write a block, then note that it is finished."""
        dataset, place = results.dataset(), dict(zip(results.names, region, strict=True))
        if not self._exists() and self._create(region, results, dataset):
            return
        part = dataset.isel(place).drop_vars(list(dataset.coords))
        part.to_zarr(self._path, region=place, consolidated=False, safe_chunks=False)
        shape = tuple(part.sizes[name] for name in results.names)
        flags = part.drop_vars(list(part.data_vars)).assign({FINISHED: (results.names, np.ones(shape, bool))})
        flags.to_zarr(self._path, region=place, consolidated=False, safe_chunks=False)

    def _exists(self) -> bool:
        """Whether there is anything in the place of the store."""
        return self._path.exists() and not (self._path.is_dir() and not any(self._path.iterdir()))

    def _create(self, region: Region, results: Results, dataset: xarray.Dataset) -> bool:
        """The store with its first block, whole or not at all; false if another process was faster."""
        finished = np.zeros(results.shape, bool)
        finished[region] = True
        dataset = dataset.assign({FINISHED: (results.names, finished)})
        dataset.attrs[STUDY] = json.dumps(self._identity)
        own = len(self._block)
        encoding = {name: {"chunks": (*self._block, *x.shape[own:])} for name, x in dataset.data_vars.items()}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._path.parent, prefix=f".{self._path.name}-") as folder:
            dataset.to_zarr(pathlib.Path(folder) / "new", encoding=encoding, consolidated=True, zarr_format=2)
            try:
                os.rename(pathlib.Path(folder) / "new", self._path)  # also onto an empty folder
            except OSError:
                if not self._exists():
                    raise
                return False
        return True


def xarray_library() -> Any:
    try:
        import xarray
    except ImportError:
        raise ImportError("a sweep is an xarray dataset: pip install 'jaxgeo[xarray]'") from None
    return xarray


def _require_zarr() -> None:
    try:
        import zarr  # noqa: F401  # pyright: ignore
    except ImportError:
        raise ImportError("a sweep is written to a Zarr store by zarr: pip install 'jaxgeo[xarray]'") from None

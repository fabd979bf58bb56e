"""Parameter studies: a function over the product of named axes, as an xarray dataset; in parallel, and resumable."""

from __future__ import annotations

import concurrent.futures
import inspect
import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxgeo._digest import digest_of
from jaxgeo._parallel import Work
from jaxgeo._parallel import version as version_of_package
from jaxgeo._sweep_store import Results, Store, xarray_library

if TYPE_CHECKING:
    import xarray

BLOCK = 256  # cells of a task, and of the compiled program


class Axis(NamedTuple):
    """Axis of a `sweep`: values, their unit, and a label for each value that is not a number or a text."""

    values: Sequence[Any]
    unit: str = ""
    labels: Sequence[str] | None = None


class _Plan(NamedTuple):
    """Axes of numbers, vectorised, and of other values, one program for each combination; block shape of the former."""

    names: tuple[str, ...]
    numeric: dict[str, np.ndarray]
    others: dict[str, list[Any]]
    coordinates: dict[str, tuple[Any, str]]
    block: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(self.coordinates[name][0]) for name in self.names)

    @property
    def steps(self) -> tuple[int, ...]:
        """Length of a block along each axis."""
        steps = dict(zip(self.numeric, self.block, strict=True))
        return tuple(steps.get(name, 1) for name in self.names)

    def regions(self) -> Iterator[tuple[slice, ...]]:
        """Places of the blocks along all axes, in order."""
        places = [
            [slice(first, min(first + step, count)) for first in range(0, count, step)]
            for step, count in zip(self.steps, self.shape, strict=True)
        ]
        yield from itertools.product(*places)

    def cells(self, region: tuple[slice, ...]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """(numbers of each cell of a block, other values)."""
        place = dict(zip(self.names, region, strict=True))
        mesh = np.meshgrid(*(values[place[name]] for name, values in self.numeric.items()), indexing="ij")
        numbers = {name: values.ravel() for name, values in zip(self.numeric, mesh, strict=True)}
        return numbers, {name: values[place[name].start] for name, values in self.others.items()}


def sweep(
    function: Callable[..., Any],
    axes: Mapping[str, Any],
    *,
    units: Mapping[str, str] | None = None,
    dims: Mapping[str, Sequence[str]] | None = None,
    vectorize: bool = True,
    block: int = BLOCK,
    folder: str | os.PathLike[str] | None = None,
    version: str = "",
    executor: Any = None,
    progress: bool = False,
) -> xarray.Dataset:
    """`function(**cell)` for every combination of the values of `axes`, as an `xarray.Dataset` with these dimensions.

    `axes` maps each argument of `function` to its values: numbers, texts, other objects (terrains, searches, cameras),
    or an `Axis` of them with a unit or labels. The result of a cell is one number or array, or a mapping or named tuple
    of several; `units` and `dims` give their units, and the names of the dimensions of arrays.

    Axes of numbers are evaluated by `jax.jit(jax.vmap(function))`, in blocks of at most `block` cells of one shape: one
    program for each combination of the other values. With `vectorize=False` the function is called for each cell, with
    Python numbers: for functions that JAX cannot trace.

    `executor` evaluates blocks in parallel: any `concurrent.futures.Executor` (with processes started by `spawn`), or a
    `dask.distributed.Client`. The result does not depend on it. With a `folder` (a Zarr store) blocks are written as
    they are done, and a later call with the same function, axes, block size and `version` computes only what is
    missing. The function counts with its text, and the values and functions of its module that it uses; give another
    `version` if something else changes, such as a file that it reads. `progress` shows a progress bar.

    Raises `ValueError` for an axis without values, an argument without an axis, results of other names or shapes in
    some cells, and a folder that holds something else; `TypeError`, with a `folder`, for a function or an axis value
    that cannot be compared with that of another run; `RuntimeError` with the cell in its message if `function` raises
    (finished blocks are kept); `ImportError` without xarray, or for a `folder` without zarr.

    >>> import jax.numpy as jnp
    >>> def distance(height, off_nadir):
    ...     return {"range": height / jnp.cos(jnp.deg2rad(off_nadir))}
    >>> axes = {"height": jaxgeo.Axis([1000.0, 2000.0], "m"), "off_nadir": jaxgeo.Axis([0.0, 60.0], "deg")}
    >>> found = jaxgeo.sweep(distance, axes, units={"range": "m"})
    >>> print(f"{found['range'].sel(height=2000.0, off_nadir=60.0).item():.1f} m")
    4000.0 m
    """
    xarray_library()
    how: Any = {"units": units, "dims": dims, "vectorize": vectorize, "block": block, "folder": folder}
    return swept(function, axes, version=version, executor=executor, progress=progress, **how).dataset()


def swept(
    function: Callable[..., Any],
    axes: Mapping[str, Any],
    *,
    units: Mapping[str, str] | None = None,
    dims: Mapping[str, Sequence[str]] | None = None,
    vectorize: bool = True,
    block: int = BLOCK,
    folder: str | os.PathLike[str] | None = None,
    version: str = "",
    executor: Any = None,
    progress: bool = False,
) -> Results:
    """The arrays of a `sweep`, which need xarray only if they have a folder."""
    if not callable(function):
        raise TypeError(f"function must be callable with the axes as keywords; got {type(function).__name__}.")
    if isinstance(block, bool) or not isinstance(block, int | np.integer) or block < 1:
        raise ValueError(f"block must be an integer of at least 1, the number of cells of a task; got {block!r}.")
    plan = _plan(axes, int(block))
    _check_arguments(function, plan)
    regions = list(plan.regions())
    named_dims = {name: tuple(names) for name, names in (dims or {}).items()}
    results = Results(plan.names, plan.coordinates, dict(units or {}), named_dims)
    store = None if folder is None else Store(folder, _identity(function, plan, vectorize, version), plan.steps)
    done = set() if store is None else store.read_into(results, regions)
    work = Work(_block_task, function, plan, vectorize)
    missing = [number for number in range(len(regions)) if number not in done]
    computed = _computed(work, regions, missing, executor)
    if progress:
        from rich.progress import track  # optional, imported only if used

        computed = track(computed, total=len(missing), description="sweep")
    for number, found in computed:
        results.put(regions[number], found)
        if store is not None:
            store.write(regions[number], results)
    return results


def _plan(axes: Mapping[str, Any], most: int) -> _Plan:
    """The axes, and the largest blocks of at most `most` cells: the last axes whole, as far as they fit."""
    if not axes:
        raise ValueError("axes is empty: give the values of each argument of the function.")
    numeric, others, coordinates = {}, {}, {}
    for name, given in axes.items():
        axis = given if isinstance(given, Axis) else Axis(given)
        is_sequence = isinstance(axis.values, Sequence | np.ndarray | jax.Array) and np.ndim(axis.values) != 0
        if isinstance(axis.values, str | bytes) or not is_sequence or not len(axis.values):
            raise ValueError(f"axis {name}: give a sequence of one or more values; got {axis.values!r}.")
        values = list(axis.values)
        numbers = None if axis.labels is not None else _numbers(values)
        if numbers is None:
            others[name] = values
            coordinates[name] = (np.array(_labels(name, axis, values)), axis.unit)
        else:
            numeric[name] = numbers
            coordinates[name] = (numbers, axis.unit)
    block, left = [], most
    for values in reversed(numeric.values()):
        block.append(min(len(values), max(left, 1)))
        left //= len(values)
    return _Plan(tuple(axes), numeric, others, coordinates, tuple(reversed(block)))


def _numbers(values: list[Any]) -> np.ndarray | None:
    """The values as one array, if all are single numbers."""
    if not all(isinstance(value, int | float | np.number | np.bool_) or _is_scalar(value) for value in values):
        return None
    numbers = np.array([np.asarray(value)[()] for value in values])
    if numbers.dtype == object:
        raise ValueError("an axis has numbers beyond 64 bits; give them as texts.")
    return numbers


def _is_scalar(value: Any) -> bool:
    return isinstance(value, np.ndarray | jax.Array) and value.ndim == 0 and np.issubdtype(value.dtype, np.number)


def _labels(name: str, axis: Axis, values: list[Any]) -> list[str]:
    labels = axis.labels
    if labels is None:
        labels = [value if isinstance(value, str) else type(value).__name__ for value in values]
    labels = [str(label) for label in labels]
    if len(labels) != len(values) or len(set(labels)) != len(labels):
        raise ValueError(
            f"axis {name}: {len(values)} values need as many different labels; got {', '.join(labels)}. Give them as "
            f"Axis(values, labels=[...])."
        )
    return labels


def _check_arguments(function: Callable[..., Any], plan: _Plan) -> None:
    """Raise `ValueError` unless the function can be called with the axes as keywords."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # written in C
        return
    try:
        signature.bind(**dict.fromkeys(plan.names))
    except TypeError as error:
        names = ", ".join(plan.names)
        raise ValueError(f"axes must be the arguments of the function, {signature}; got {names}: {error}.") from None


def _identity(function: Callable[..., Any], plan: _Plan, vectorize: bool, version: str) -> dict[str, str]:
    """What results depend on, by name: text of the function, values of each axis, blocks, versions."""
    return {
        "function": digest_of(function),
        "order of the axes": ", ".join(plan.names),
        **{f"axis {name}": digest_of(plan.numeric.get(name, plan.others.get(name))) for name in plan.names},
        "block": str((plan.block, vectorize)),
        "version": version,
        "jaxgeo": version_of_package(),
        "jax": jax.__version__,
        "64-bit floats": str(jax.config.jax_enable_x64),  # pyright: ignore
    }


def _block_task(function: Callable[..., Any], plan: _Plan, vectorize: bool) -> Callable[..., Any]:
    """What evaluates a block, given its number and place."""
    program = _program(function) if vectorize else None
    return lambda numbered: _block(function, plan, program, numbered[1])


def _computed(
    work: Work, regions: list[tuple[slice, ...]], numbers: list[int], executor: Any
) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """(number, results) of blocks as they are done."""
    try:
        for (number, _), future in work.results([(number, regions[number]) for number in numbers], executor):
            yield number, future.result()
    except concurrent.futures.BrokenExecutor as error:
        raise RuntimeError(f"a worker ended ({error}); blocks in folder= are kept, call again.") from error


def _block(
    function: Callable[..., Any], plan: _Plan, program: Callable[..., Any] | None, region: tuple[slice, ...]
) -> dict[str, np.ndarray]:
    """Results (cells, ...) of a block."""
    numbers, others = plan.cells(region)
    count = len(next(iter(numbers.values()), [None]))
    if program is not None and numbers:
        rows = np.minimum(np.arange(math.prod(plan.block)), count - 1)  # padded with the last cell
        try:
            found = program({name: values[rows] for name, values in numbers.items()}, others)
            return {name: np.asarray(value)[:count] for name, value in found.items()}
        except Exception as error:
            where = ", ".join(f"{name}={_shown(value)}" for name, value in others.items())
            raise _told(error, f"a block of {count} cells{where and ' with ' + where}") from error
    each: list[dict[str, np.ndarray]] = []
    for k in range(count):
        cell = {name: values[k].item() for name, values in numbers.items()} | others
        try:
            found = _named(function, function(**cell))
            each.append({name: _array(value) for name, value in sorted(found.items())})
        except Exception as error:
            where = ", ".join(f"{name}={_shown(cell[name])}" for name in plan.names)
            raise _told(error, f"the cell {where}") from error
    shapes = {tuple((name, value.shape) for name, value in one.items()) for one in each}
    if len(shapes) > 1:
        raise ValueError(f"results must have the same names and shapes in all cells; got {sorted(shapes)}.")
    return {name: np.stack([one[name] for one in each]) for name in each[0]}


def _array(value: Any) -> np.ndarray:
    """A result as an array; of Python's numbers always the same type."""
    return np.asarray(value, np.float64 if type(value) in (int, float) else None)


def _told(error: Exception, where: str) -> RuntimeError:
    return RuntimeError(f"the function raised {type(error).__name__} in {where}: {error}")


def _shown(value: Any) -> str:
    return repr(value) if isinstance(value, int | float | str) else type(value).__name__


def _named(function: Callable[..., Any], found: Any) -> dict[str, Any]:
    """Results of a cell by name."""
    if hasattr(found, "_asdict"):
        found = found._asdict()
    if isinstance(found, Mapping):
        return dict(found)
    return {getattr(function, "__name__", "result"): found}


def _program(function: Callable[..., Any]) -> Callable[..., Any]:
    @eqx.filter_jit
    def of_block(numbers: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
        return jax.vmap(lambda cell: _named(function, function(**cell, **others)))(numbers)

    return of_block

"""The same work on many items: in this process, by an executor, or by the workers of a Dask cluster."""

from __future__ import annotations

import concurrent.futures
import ctypes
import functools
import importlib.metadata
import itertools
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import jax

AHEAD = 64  # items submitted before the first of them is done; for clusters more
AHEAD_OF_WORKER = 4

Item = TypeVar("Item")


@functools.cache
def version() -> str:
    """The version of jaxgeo that is installed."""
    return importlib.metadata.version("jaxgeo")


class Work:
    """Work on items by the function that `make(*values)` returns, once in each process.

    The values travel once to a process, or to a Dask cluster, not with each item. Other processes take the setting of
    64-bit floats from this one.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *values: Any) -> None:
        self._make, self._values = make, values

    def results(self, items: Iterable[Item], executor: Any) -> Iterator[tuple[Item, concurrent.futures.Future[Any]]]:
        """(item, its finished future) as items are done; `executor` is None, an `Executor`, or a Dask `Client`."""
        if executor is None:
            function = self._make(*self._values)
            for item in items:
                yield item, _of_call(function, item)
            return
        call, ahead = self._call(executor)
        waiting: dict[concurrent.futures.Future[Any], Item] = {}
        left = iter(items)
        try:
            while True:
                for item in itertools.islice(left, ahead - len(waiting)):
                    waiting[call(item)] = item
                if not waiting:
                    return
                done, _ = concurrent.futures.wait(waiting, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    yield waiting.pop(future), future
        finally:
            for future in waiting:
                future.cancel()

    def _call(self, executor: Any) -> tuple[Callable[[Any], concurrent.futures.Future[Any]], int]:
        """(what submits an item, number of items to submit ahead)."""
        if isinstance(executor, concurrent.futures.ThreadPoolExecutor):
            function = self._make(*self._values)
            return lambda item: executor.submit(function, item), AHEAD
        try:
            from cloudpickle import dumps  # functions of a notebook, too
        except ImportError:
            from pickle import dumps
        data: Any = dumps((self._make, self._values))
        is_x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore
        submit, ahead = executor.submit, AHEAD
        if hasattr(executor, "get_executor"):
            data = executor.submit(_same, data, pure=False)  # once to the cluster, from worker to worker
            submit = executor.get_executor(pure=False).submit
            ahead = max(AHEAD, AHEAD_OF_WORKER * sum(executor.nthreads().values()))
        # As bytes: a scheduler, which may hold items for workers, would make records of them, in 32 bits.
        return lambda item: submit(_elsewhere, data, is_x64, version(), dumps(item)), ahead


def _of_call(function: Callable[[Any], Any], item: Any) -> concurrent.futures.Future[Any]:
    """The finished future of a call in this process."""
    future: concurrent.futures.Future[Any] = concurrent.futures.Future()
    try:
        future.set_result(function(item))
    except Exception as error:
        future.set_exception(error)
    return future


def _same(data: bytes) -> bytes:
    return data


def _elsewhere(data: bytes, is_x64: bool, of_client: str, item: bytes) -> Any:
    """Work of another process on an item. Raises `RuntimeError` for another version."""
    if of_client != version():
        raise RuntimeError(
            f"a worker has jaxgeo {version()}, this process {of_client}: install the same version on all."
        )
    try:
        with jax.enable_x64(is_x64):
            return _made(data)(pickle.loads(item))
    finally:
        _give_back_memory()


def _give_back_memory() -> None:
    """Return to the system what compiling has freed, a gigabyte; the C library of Linux keeps it otherwise."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


@functools.lru_cache(maxsize=4)
def _made(data: bytes) -> Callable[[Any], Any]:
    """The function of some work: the same for all items, so that its programs are compiled once."""
    make, values = pickle.loads(data)
    return make(*values)

"""Limit LAPACK to one thread during block solves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock

import scipy  # submodules load lazily
import threadpoolctl

_lock, _before = Lock(), ExitStack()
_inside: list[int] = []  # active calls; the last to exit restores the previous limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS libraries, except JAX's own, to one thread; the last active context restores the previous number.

    A slab has some hundred unknowns. OpenBLAS (SciPy's, and so JAX's LAPACK) divides even these among all processors,
    and its threads busy-wait: whole adjustments take up to 1.7 times as long, and on a loaded machine each
    factorisation takes a fifth of a second. Matrix products, the main work, are JAX's and keep all processors.
    """
    _ = scipy.linalg.cython_lapack  # load it first, so that its BLAS is found
    with _lock:
        if not _inside:
            _before.enter_context(threadpoolctl.threadpool_limits(limits=1, user_api="blas"))
        _inside.append(1)
    try:
        yield
    finally:
        with _lock:
            _inside.pop()
            if not _inside:
                _before.close()

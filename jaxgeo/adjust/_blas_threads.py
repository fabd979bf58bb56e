"""LAPACK on one thread while blocks are solved."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock

import scipy  # loads its parts when they are asked for
import threadpoolctl

_lock, _before = Lock(), ExitStack()
_inside: list[int] = []  # the calls that are inside; the last to come out puts back what was before


@contextmanager
def one_thread() -> Iterator[None]:
    """BLAS libraries, JAX's own excepted, use one thread inside; as many as before when the last has come out.

    A slab has some hundred unknowns. OpenBLAS, SciPy's and so JAX's LAPACK, divides even these among all processors,
    and its threads wait spinning for more: whole adjustments take up to 1.7 times as long so, and on a busy machine
    each factor a fifth of a second. The products, where the work is, are JAX's and stay on all processors.
    """
    _ = scipy.linalg.cython_lapack  # loaded by now, so that it is found
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

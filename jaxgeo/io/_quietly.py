"""Thread-safe suppression and capture of other packages' warnings.

Python keeps one filter list for all threads: two threads that change it at the same time may corrupt it permanently,
and a filter that turns warnings into errors would do so for all threads.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator

_lock = threading.RLock()


@contextlib.contextmanager
def quietly(category: type[Warning] = Warning) -> Iterator[None]:
    """Suppress warnings of a category."""
    with _lock, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


@contextlib.contextmanager
def heard(package: str, category: type[Warning] = Warning) -> Iterator[list[str]]:
    """Capture a package's warning texts, complete when the block is left; these warnings are not shown."""
    texts: list[str] = []
    with _lock:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            yield texts
        for one in found:
            if issubclass(one.category, category) and f"/{package}/" in one.filename.replace("\\", "/"):
                texts.append(str(one.message))
            else:
                warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)

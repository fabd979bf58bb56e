"""Warnings of other packages, held back or looked at; safe to do in several threads at once.

Python keeps one list of filters for all threads: two that change it at the same time may leave it changed for good, and
a filter that makes errors of warnings would make those of any other thread errors too.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator

_lock = threading.RLock()


@contextlib.contextmanager
def quietly(category: type[Warning] = Warning) -> Iterator[None]:
    """Hold back warnings of a category."""
    with _lock, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


@contextlib.contextmanager
def heard(package: str, category: type[Warning] = Warning) -> Iterator[list[str]]:
    """The texts of what a package warns of, complete when the block is left; nobody else sees these warnings."""
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

"""The compiled ray-terrain search of jaxgeo, as a target that XLA calls on CPUs.

`jaxgeo` finds this package where it is installed; nothing here is called directly.
"""

from __future__ import annotations

import ctypes
import pathlib
from typing import Any

INTERFACE = 1  # of the arrays that the target takes; jaxgeo uses the interface that it knows only
FILE = next(pathlib.Path(__file__).parent.glob("jaxgeo_native.*"))  # .so, or .dylib

__all__ = ["FILE", "INTERFACE", "function"]


def function() -> Any:
    """The handler, a function of the C interface of XLA."""
    return ctypes.CDLL(str(FILE)).jaxgeo_first_events

"""The compiled ray-terrain search of jaxgeo, as targets that XLA calls on CPUs.

`jaxgeo` finds this package where it is installed; nothing here is called directly.
"""

from __future__ import annotations

import ctypes
import pathlib
from typing import Any

INTERFACE = 2  # of the arrays that the targets take; jaxgeo uses the interface that it knows only
FILE = next(pathlib.Path(__file__).parent.glob("jaxgeo_native.*"))  # .so, or .dylib

__all__ = ["FILE", "INTERFACE", "functions"]


def functions() -> dict[str, Any]:
    """The handlers by name, functions of the C interface of XLA."""
    library = ctypes.CDLL(str(FILE))
    return {name: getattr(library, f"jaxgeo_{name}") for name in ("first_events", "first_hits")}

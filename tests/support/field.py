"""Row type of the table of practitioners' files."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import NamedTuple


class FieldFile(NamedTuple):
    """One file of the folder `field`: its path, what it is a case of, and the check of the correct result.

    `check` takes the path of the file and raises `AssertionError` for a wrong result. `slow` marks a check that takes
    more than a few seconds.
    """

    file: str
    situation: str
    check: Callable[[pathlib.Path], None]
    slow: bool = False

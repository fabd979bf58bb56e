"""What a row of the table of files as practitioners have them holds."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import NamedTuple


class FieldFile(NamedTuple):
    """One file of the folder `field`: its path there, what it is a case of, and the check of its right answer.

    `check` takes the path of the file and raises `AssertionError` where the answer is another. `slow` marks a check
    that takes more than a few seconds.
    """

    file: str
    situation: str
    check: Callable[[pathlib.Path], None]
    slow: bool = False

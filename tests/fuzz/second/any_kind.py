"""The second reading of a file of unknown kind: that of the kind which the package says that it is."""

from __future__ import annotations

import pathlib
from typing import Any

from tests.fuzz.second import binary, drone_images, tables


def second(path: pathlib.Path, found: Any) -> None:
    if found.form == "SBET":
        binary.sbet(path, found)
    elif "orientations" in found.form:
        tables.on_earth_ellipsoidal(path, found.shots.pose)
    elif "ST 0601" in found.form:
        binary.klv(checked=True, undulation=0.0)(path, found)
    else:
        drone_images.exposure(path, found)

"""Heights above the point of take-off as heights above the ellipsoid, and their errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.datum_names import is_ellipsoid
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights


def heights_above_takeoff(
    path: Any, lon: np.ndarray, lat: np.ndarray, above: np.ndarray, takeoff: float, datum: str | float | None
) -> tuple[np.ndarray, str]:
    """(heights (n,) in m above the ellipsoid, words for the take-off) of heights `above` the point of take-off.

    `takeoff` is its height in m above the ellipsoid, or above `datum` if that is given, with the undulation at each
    position (`lon`, `lat` in deg). Raises `TableError`, and `VerticalDatumError`.
    """
    if not np.isfinite(takeoff):
        raise TableError(f"{path}: takeoff_height= must be finite, in m above the ellipsoid or height_datum=.")
    words = f"a take-off at {takeoff:g} m"
    if datum is None or is_ellipsoid(datum):
        return takeoff + above, words
    where = f"{datum}" if isinstance(datum, str) else f"a surface {datum:g} m above the ellipsoid"
    try:
        return ellipsoidal_heights(lon, lat, takeoff + above, datum), f"{words} above {where}"
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error


def with_takeoff_sigma(found: Acquisition, sigma: float | None, takeoff: float | None) -> Acquisition:
    """The exposures with the standard deviation `sigma` in m of the height of their take-off, if that is given.

    Raises `TableError` for one that is negative or infinite, or without a take-off.
    """
    if sigma is None:
        return found
    if not 0.0 <= sigma < np.inf:
        raise TableError(f"{found.path}: takeoff_sigma= must be 0 m or more, and finite; got {sigma:g}.")
    if takeoff is None:
        raise TableError(f"{found.path}: takeoff_sigma= is that of takeoff_height=; give both, or leave it out.")
    return dataclasses.replace(found, takeoff_sigma=float(sigma))

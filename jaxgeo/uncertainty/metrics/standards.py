"""Accuracy measures of standards (NSSDA, ASPRS) from RMSE, and the MISB encoding of CE90 and LE90."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_array, as_float64, check_finite, check_range, concrete
from jaxgeo._typing import Numbers

MISB_FARTHEST = 4095.0  # m
MISB_STEPS = 65535


def nssda_horizontal(rmse_x: Any, rmse_y: Any) -> Numbers:
    """Accuracy_r in m at 95 %, from two RMSE in m: 1.2239 times their sum, 1.7308 RMSE_r if equal.

    Raises `ValueError` if their ratio is below 0.6, which the standard does not cover; NaN if traced. FGDC (1998),
    "Geospatial Positioning Accuracy Standards, Part 3: National Standard for Spatial Data Accuracy".
    """
    x, y = _rmse(rmse_x, "rmse_x"), _rmse(rmse_y, "rmse_y")
    in_range = jnp.minimum(x, y) >= 0.6 * jnp.maximum(x, y)
    known = concrete(in_range)
    if known is not None and not np.all(known):
        raise ValueError(
            f"the NSSDA covers RMSE_min / RMSE_max from 0.6 to 1; got {x} m and {y} m. Use circular_error, which is "
            "exact for any ratio."
        )
    return jnp.where(in_range, jnp.where(x == y, 1.7308 * jnp.sqrt(2.0) * x, 2.4477 * 0.5 * (x + y)), jnp.nan)


def nssda_vertical(rmse_z: Any) -> Numbers:
    """Accuracy_z in m at 95 %: 1.9600 RMSE_z; standard as for `nssda_horizontal`."""
    return 1.9600 * _rmse(rmse_z, "rmse_z")


def asprs_horizontal(rmse_x: Any, rmse_y: Any, rmse_survey: Any = 0.0) -> Numbers:
    """RMSE_H in m, from both axes and the survey of the checkpoints.

    ASPRS (2023), "Positional Accuracy Standards for Digital Geospatial Data", edition 2: RMSE_H1 = sqrt(RMSE_x² +
    RMSE_y²) against the checkpoints, RMSE_H2 of the checkpoints, combined as the root of the sum of squares.
    """
    return _root_of_squares(_rmse(rmse_x, "rmse_x"), _rmse(rmse_y, "rmse_y"), _rmse(rmse_survey, "rmse_survey"))


def asprs_vertical(rmse_z: Any, rmse_survey: Any = 0.0) -> Numbers:
    """RMSE_V in m, including the survey of the checkpoints; standard as for `asprs_horizontal`."""
    return _root_of_squares(_rmse(rmse_z, "rmse_z"), _rmse(rmse_survey, "rmse_survey"))


def asprs_3d(rmse_h: Any, rmse_v: Any) -> Numbers:
    """RMSE_3D in m from a horizontal and a vertical RMSE; standard as for `asprs_horizontal`."""
    return _root_of_squares(_rmse(rmse_h, "rmse_h"), _rmse(rmse_v, "rmse_v"))


def asprs_class(rmse: float, unit: float = 0.01) -> float:
    """Accuracy class in m of an RMSE in m: the smallest multiple of `unit` (1 cm) that is not below it.

    In the standard (see `asprs_horizontal`) a class is any number that the RMSE does not exceed; it has no fixed bins.
    """
    check_range(rmse, "rmse", "m", 0.0, 1e12)
    if not (math.isfinite(unit) and unit > 0.0):
        raise ValueError(f"unit must be a positive number of m; got {unit!r}.")
    return unit * math.ceil(round(rmse / unit, 9))


def categorise(value: float, bins: Sequence[tuple[str, float]]) -> str | None:
    """Name of the first of `bins` whose upper limit `value` does not exceed; None above the last.

    `bins` are (name, limit), limits in the unit of `value` and increasing. Raises `ValueError` for NaN and for limits
    that do not increase.
    """
    limits = [limit for _, limit in bins]
    if any(not a < b for a, b in itertools.pairwise(limits)):
        raise ValueError(f"the limits of bins must rise; got {limits}.")
    if math.isnan(value):
        raise ValueError("value must be a number; got NaN, which falls into no bin.")
    return next((name for name, limit in bins if value <= limit), None)


def encode_misb_error(error: float) -> bytes:
    """CE90 or LE90 in m as two big-endian bytes: items 45 and 46 of MISB ST 0601, "UAS Datalink Local Set".

    0 to 4095 m in 65535 steps of 6.25 cm, rounded to nearest. Raises `ValueError` above 4095 m instead of clipping.
    """
    check_range(error, "error", "m", 0.0, MISB_FARTHEST)
    return round(float(error) / MISB_FARTHEST * MISB_STEPS).to_bytes(2, "big")


def decode_misb_error(sent: bytes) -> float:
    """CE90 or LE90 in m from two bytes; see `encode_misb_error`."""
    if len(sent) != 2:
        raise ValueError(f"a CE90 or LE90 is sent as 2 bytes; got {len(sent)}.")
    return int.from_bytes(sent, "big") * MISB_FARTHEST / MISB_STEPS


def _root_of_squares(*values: Numbers) -> Numbers:
    squared = jnp.asarray(0.0)
    for value in values:
        squared = squared + value**2
    return jnp.sqrt(squared)


def _rmse(value: Any, name: str) -> Numbers:
    value = as_float64(as_array(value, name), name)
    check_finite(value, name, "m")
    known = concrete(value)
    if known is not None and np.any(known < 0.0):
        raise ValueError(f"{name} must not be negative; got {known} m.")
    return value

"""Military Grid Reference System references, including the polar zones."""

from __future__ import annotations

import numpy as np

DIGITS = 5  # of an easting and a northing: squares of a metre


def mgrs_of(lat_deg: np.ndarray, lon_deg: np.ndarray) -> list[str | None]:
    """The MGRS reference to 1 m of each position, such as "32TPT5204907105"; None if a coordinate is NaN.

    Raises `ImportError` without the library mgrs.
    """
    try:
        import mgrs
    except ImportError as error:
        raise ImportError("squares of MGRS need the library mgrs: pip install 'jaxgeo[gis]'.") from error
    grid = mgrs.MGRS()
    known = np.isfinite(lat_deg) & np.isfinite(lon_deg)
    places = zip(lat_deg.tolist(), lon_deg.tolist(), known, strict=True)
    return [grid.toMGRS(lat, lon, MGRSPrecision=DIGITS) if here else None for lat, lon, here in places]

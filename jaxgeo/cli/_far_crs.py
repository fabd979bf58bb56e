"""Note on a `--crs` whose area of use is far from the images."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxgeo.cli._screen import print_note
from jaxgeo.earth import Geodetic
from jaxgeo.sensor import Shot

FAR = 6.0  # deg outside the area of use: the width of a UTM zone


def note_far_crs(crs: str | None, of: Any) -> None:
    """Print a note if a shot, or the first known of n positions, is far from the area of use of a CRS, with the UTM
    zone there. An image on a trajectory is left out.
    """
    from jaxgeo.io._map_crs import degrees_outside

    position = of.pose.position if isinstance(of, Shot) else of
    if crs is None or not isinstance(position, Geodetic):
        return
    places = np.rad2deg([np.ravel(np.asarray(angle, np.float64)) for angle in (position.lat, position.lon)])
    for lat, lon in places[:, np.isfinite(places).all(axis=0)].T[:1]:
        apart, zone = degrees_outside(crs, lat, lon), int((lon + 180.0) % 360.0 // 6.0) + 1
        if apart > FAR:
            print_note(
                f"check: The images are {apart:.0f} deg from the area of use of --crs {crs}; the UTM zone here is "
                f"EPSG:{(32600 if lat >= 0.0 else 32700) + zone}."
            )

"""Note on a `--crs` whose area of use is far from the images."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxgeo.cli._assumed import print_assumed
from jaxgeo.earth import Geodetic
from jaxgeo.sensor import Shot

FAR = 6.0  # deg outside the area of use: the width of a UTM zone


def note_far_crs(crs: str | None, of: Any) -> None:
    """Print a note if a shot, or the first known of n positions, is far from the area of use of a CRS, with the usual
    one there. An image on a trajectory is left out.
    """
    from jaxgeo.io._map_crs import code_of, degrees_outside
    from jaxgeo.io.acquisitions.sentences import DOUBT
    from jaxgeo.io.map_raster import usual_crs

    position = of.pose.position if isinstance(of, Shot) else of
    if crs is None or not isinstance(position, Geodetic):
        return
    places = np.rad2deg([np.ravel(np.asarray(angle, np.float64)) for angle in (position.lat, position.lon)])
    for lat, lon in places[:, np.isfinite(places).all(axis=0)].T[:1]:
        apart = degrees_outside(crs, lat, lon)
        if apart > FAR:
            usual = code_of(usual_crs(lon, lat))
            area = f"The images are {apart:.0f} deg from the area of use of --crs {crs}"
            print_assumed([f"{DOUBT}{area}; the usual CRS here is {usual}."])

"""Pictures: each function draws records on matplotlib axes, and returns what a legend or a colour bar needs.

Nothing here keeps a state. Maps are in degrees of longitude and latitude; `map_axes` prepares axes so that a kilometre
is as long north as east. Pictures of errors are in m east and north of the fix that they belong to.
"""

try:
    import matplotlib  # noqa: F401
except ImportError as error:
    raise ImportError("jaxgeo.plot draws with matplotlib: pip install 'jaxgeo[plot]'") from error

from jaxgeo.plot.accuracy import accuracy_map, budget_bars
from jaxgeo.plot.cloud import error_cloud
from jaxgeo.plot.coverage import footprints, overlap_along
from jaxgeo.plot.maps import (
    EDGE,
    FIX,
    HIDDEN,
    MOST_POSTS,
    RELIEF,
    SIGHT,
    camera,
    fixes,
    footprint,
    hidden_ground,
    hillshade,
    lonlat_deg,
    map_axes,
    north_arrow,
    post_positions,
    scale_bar,
    shaded_relief,
    sight_lines,
)
from jaxgeo.plot.registration import before_after, checkerboard, circles_on_map, shifts, ties_on_map
from jaxgeo.plot.registration_page import registration_figure

__all__ = [
    "EDGE",
    "FIX",
    "HIDDEN",
    "MOST_POSTS",
    "RELIEF",
    "SIGHT",
    "accuracy_map",
    "before_after",
    "budget_bars",
    "camera",
    "checkerboard",
    "circles_on_map",
    "error_cloud",
    "fixes",
    "footprint",
    "footprints",
    "hidden_ground",
    "hillshade",
    "lonlat_deg",
    "map_axes",
    "north_arrow",
    "overlap_along",
    "post_positions",
    "registration_figure",
    "scale_bar",
    "shaded_relief",
    "shifts",
    "sight_lines",
    "ties_on_map",
]

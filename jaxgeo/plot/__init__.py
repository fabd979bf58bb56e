"""Figures of results on matplotlib axes.

Every function has the same form: a noun as its name, the data first, then the axes `ax`, everything else by keyword. It
draws on these axes and returns them. Without `ax` it makes a new figure in the package's style:
`budget_bars(shares).figure.savefig("budget.pdf")`. No function keeps state, changes matplotlib's settings or opens a
window.

- Map layers, in degrees of longitude and latitude, can be drawn over each other: `map_axes`, `hillshade`,
  `hidden_ground`, `footprints`, `camera`, `sight_lines`, `fixes`, `ellipses_on_map`, `cloud_on_map`, `region_on_map`,
  `probability_on_map`, `accuracy_map`, `method_map`, `scale_bar`, `north_arrow`. Layers are labelled: `legend(ax)`
  lists the labels, and `colour_bar(ax, "CE90, m")` the colours.
- Charts stand alone and include a legend (`legend=False` omits it): `budget_bars`, `error_cloud`, `sight_section`,
  `residual_arrows`, `residual_histogram`, `shifts`, `ties_on_map`, `circles_on_map`. `overlap_along`, `checkerboard`
  and `convention` need no legend.
- `conventions_figure`, `registration_figure` and `validation_figure` are whole pages, and return the figure.

`style.style(width)` returns matplotlib settings for a figure in print; `style` also defines the colours and their
meanings.
"""

try:
    import matplotlib  # noqa: F401
except ImportError as error:
    raise ImportError("jaxgeo.plot draws with matplotlib: pip install 'jaxgeo[plot]'") from error

from jaxgeo.plot import style
from jaxgeo.plot.accuracy import accuracy_map, method_map
from jaxgeo.plot.adjustment import residual_arrows, residual_histogram
from jaxgeo.plot.budgets import budget_bars
from jaxgeo.plot.cloud import error_cloud, ground_about
from jaxgeo.plot.conventions import convention, conventions_figure
from jaxgeo.plot.coverage import footprints, overlap_along
from jaxgeo.plot.errors_on_map import cloud_on_map, ellipses_on_map
from jaxgeo.plot.legends import colour_bar, legend
from jaxgeo.plot.maps import (
    MOST_POSTS,
    RELIEF,
    camera,
    fixes,
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
from jaxgeo.plot.regions import probability_on_map, region_on_map
from jaxgeo.plot.registration import checkerboard, circles_on_map, shifts, ties_on_map
from jaxgeo.plot.registration_page import registration_figure
from jaxgeo.plot.sightline import Section, section_under, sight_section
from jaxgeo.plot.style import EDGE, FIX, HIDDEN, SIGHT
from jaxgeo.plot.validation import validation_figure

__all__ = [
    "EDGE",
    "FIX",
    "HIDDEN",
    "MOST_POSTS",
    "RELIEF",
    "SIGHT",
    "Section",
    "accuracy_map",
    "budget_bars",
    "camera",
    "checkerboard",
    "circles_on_map",
    "cloud_on_map",
    "colour_bar",
    "convention",
    "conventions_figure",
    "ellipses_on_map",
    "error_cloud",
    "fixes",
    "footprints",
    "ground_about",
    "hidden_ground",
    "hillshade",
    "legend",
    "lonlat_deg",
    "map_axes",
    "method_map",
    "north_arrow",
    "overlap_along",
    "post_positions",
    "probability_on_map",
    "region_on_map",
    "registration_figure",
    "residual_arrows",
    "residual_histogram",
    "scale_bar",
    "section_under",
    "shaded_relief",
    "shifts",
    "sight_lines",
    "sight_section",
    "style",
    "ties_on_map",
    "validation_figure",
]

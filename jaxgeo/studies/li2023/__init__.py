"""Reproduction of the error analysis of Li et al. (2023), "A target location method for aerial images through fast
iteration of elevation based on DEM": its tables and figures beside the results of this package for the same inputs."""

from jaxgeo.studies.li2023.causes import Cause, causes
from jaxgeo.studies.li2023.claims import claims_of
from jaxgeo.studies.li2023.claims_on_searches import plane_claims, search_claims
from jaxgeo.studies.li2023.inclination import Inclination, fig_5
from jaxgeo.studies.li2023.pointing import Pointing, pointing_errors
from jaxgeo.studies.li2023.positions import Accuracy, Judged, over_fractal_ground, over_level_ground, over_real_ground
from jaxgeo.studies.li2023.report import Report, run
from jaxgeo.studies.li2023.searches import Comparison, compare_searches
from jaxgeo.studies.li2023.targets import Target, table_2
from jaxgeo.studies.li2023.tilts import Tilt, implied_tilts
from jaxgeo.studies.study_report import sheets_of, write_pictures, write_tables

__all__ = [
    "Accuracy",
    "Cause",
    "Comparison",
    "Inclination",
    "Judged",
    "Pointing",
    "Report",
    "Target",
    "Tilt",
    "causes",
    "claims_of",
    "compare_searches",
    "fig_5",
    "implied_tilts",
    "over_fractal_ground",
    "over_level_ground",
    "over_real_ground",
    "plane_claims",
    "pointing_errors",
    "run",
    "search_claims",
    "sheets_of",
    "table_2",
    "write_pictures",
    "write_tables",
]

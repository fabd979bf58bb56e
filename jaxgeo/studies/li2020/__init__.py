"""Reproduction of the overlap analysis of Li et al. (2020), "Effect and compensation of overlap influenced by flight
parameter of oblique aerial camera": its tables beside the results of this package for the same inputs."""

from jaxgeo.studies.li2020.causes import Cause, causes
from jaxgeo.studies.li2020.claims import claims_of
from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.control import Control, controls
from jaxgeo.studies.li2020.flight import Sighting, StripPair, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.relief import Relief, reliefs
from jaxgeo.studies.li2020.report import Report, run
from jaxgeo.studies.li2020.strips import Strips, strips
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods
from jaxgeo.studies.study_report import sheets_of, write_pictures, write_tables

__all__ = [
    "Cause",
    "Compensation",
    "Control",
    "Influence",
    "Mountain",
    "Period",
    "Relief",
    "Report",
    "Sighting",
    "StripPair",
    "Strips",
    "causes",
    "claims_of",
    "compensations",
    "controls",
    "mountain",
    "pairs",
    "periods",
    "reliefs",
    "run",
    "sheets_of",
    "sightings",
    "strips",
    "tables_1_to_3",
    "write_pictures",
    "write_tables",
]

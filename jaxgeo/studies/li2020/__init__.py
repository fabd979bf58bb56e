"""The overlap analysis of Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of
oblique aerial camera", made again: its tables beside what the same inputs give here."""

from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.flight import Sighting, StripPair, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.report import Report, run, sheets_of, write_pictures, write_tables
from jaxgeo.studies.li2020.strips import Strips, strips
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods

__all__ = [
    "Compensation",
    "Influence",
    "Mountain",
    "Period",
    "Report",
    "Sighting",
    "StripPair",
    "Strips",
    "compensations",
    "mountain",
    "pairs",
    "periods",
    "run",
    "sheets_of",
    "sightings",
    "strips",
    "tables_1_to_3",
    "write_pictures",
    "write_tables",
]

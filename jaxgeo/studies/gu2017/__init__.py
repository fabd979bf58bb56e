"""Reproduction of the registration of Gu and Qiao (2017), "A method for high accuracy airborne optical image
geolocation": its error table, an end-to-end image, ties and blocks, the constrained search, frame sequences, and
several images without a map."""

from jaxgeo.studies.gu2017.accuracy import Accuracy, Radii, accuracy, over_slope, radii, within
from jaxgeo.studies.gu2017.claims import claims_of
from jaxgeo.studies.gu2017.fixes import Fixes, Spread, fixes_of, lattice, spread, truth
from jaxgeo.studies.gu2017.flow import Flow, Run, flow, one_run
from jaxgeo.studies.gu2017.frames import Frame, frames
from jaxgeo.studies.gu2017.given import read
from jaxgeo.studies.gu2017.mutual import Mutual, mutual
from jaxgeo.studies.gu2017.report import Report, run
from jaxgeo.studies.gu2017.scene import Imaged, made, navigation
from jaxgeo.studies.gu2017.searching import Searched, searches
from jaxgeo.studies.study_report import sheets_of, write_pictures, write_tables

__all__ = [
    "Accuracy",
    "Fixes",
    "Flow",
    "Frame",
    "Imaged",
    "Mutual",
    "Radii",
    "Report",
    "Run",
    "Searched",
    "Spread",
    "accuracy",
    "claims_of",
    "fixes_of",
    "flow",
    "frames",
    "lattice",
    "made",
    "mutual",
    "navigation",
    "one_run",
    "over_slope",
    "radii",
    "read",
    "run",
    "searches",
    "sheets_of",
    "spread",
    "truth",
    "within",
    "write_pictures",
    "write_tables",
]

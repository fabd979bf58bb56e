"""Reproduction of Xue et al. (2019), "High Precision Positioning of Unmanned Helicopter with Area Array Images", on
a simulated block: direct georeferencing, free network, self-calibration and boresight calibration against the paper."""

from jaxgeo.studies.study_report import sheets_of, write_pictures, write_tables
from jaxgeo.studies.xue2019.cases import Case, Cases, Recovered, cases_of
from jaxgeo.studies.xue2019.claims import claims_of
from jaxgeo.studies.xue2019.free_net import FreeNet, free_nets
from jaxgeo.studies.xue2019.limits import Limits
from jaxgeo.studies.xue2019.report import Report, run
from jaxgeo.studies.xue2019.simulation import Flown, Simulated, flown, measured, simulated
from jaxgeo.studies.xue2019.trials import Trials, trials

__all__ = [
    "Case",
    "Cases",
    "Flown",
    "FreeNet",
    "Limits",
    "Recovered",
    "Report",
    "Simulated",
    "Trials",
    "cases_of",
    "claims_of",
    "flown",
    "free_nets",
    "measured",
    "run",
    "sheets_of",
    "simulated",
    "trials",
    "write_pictures",
    "write_tables",
]

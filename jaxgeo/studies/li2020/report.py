"""The whole study: its records, tables and pictures."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

from jaxgeo.studies.li2020 import sheets
from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.flight import Sighting, StripPair, mean_depression, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.strips import Strips, strips
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods
from jaxgeo.studies.sheet import Sheet, write_sheets


@dataclass(frozen=True)
class Report:
    """All that the study finds; `strips` is empty where they were left out."""

    influences: list[Influence]
    compensations: list[Compensation]
    sightings: list[Sighting]
    pairs: list[StripPair]
    mountain: Mountain
    periods: list[Period]
    strips: list[Strips]


def run(*, flights: bool = True) -> Report:
    """The study; nothing in it is left to chance. Without `flights` the strips of Figs. 11 and 12, which take by far
    the most time, are left out."""
    seen, overlaps = sightings(), pairs()
    return Report(
        influences=tables_1_to_3(),
        compensations=compensations(),
        sightings=seen,
        pairs=overlaps,
        mountain=mountain(),
        periods=periods(overlaps, mean_depression(seen)),
        strips=strips() if flights else [],
    )


def sheets_of(report: Report) -> list[Sheet]:
    """The study's tables, in the order of the paper."""
    found = [
        sheets.influence_sheet(report.influences),
        sheets.compensation_sheet(report.compensations),
        sheets.sightings_sheet(report.sightings),
        sheets.overlaps_sheet(report.pairs),
        sheets.timing_sheet(report.periods, report.mountain),
    ]
    return [*found, sheets.strips_sheet(report.strips)] if report.strips else found


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Every table as CSV, and all of them as one Markdown text, into a folder that is there."""
    write_sheets("Li et al. (2020)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """The pictures, into a folder that is there; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.li2020 import figures  # only who wants pictures needs matplotlib

    figures.write(report, folder)

"""The whole study: its records and tables."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

from jaxgeo.studies.li2020 import sheets
from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.flight import Sighting, StripPair, mean_depression, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods
from jaxgeo.studies.sheet import Sheet


@dataclass(frozen=True)
class Report:
    """All that the study finds."""

    influences: list[Influence]
    compensations: list[Compensation]
    sightings: list[Sighting]
    pairs: list[StripPair]
    mountain: Mountain
    periods: list[Period]


def run() -> Report:
    """The study; nothing in it is left to chance."""
    seen, overlaps = sightings(), pairs()
    return Report(
        influences=tables_1_to_3(),
        compensations=compensations(),
        sightings=seen,
        pairs=overlaps,
        mountain=mountain(),
        periods=periods(overlaps, mean_depression(seen)),
    )


def sheets_of(report: Report) -> list[Sheet]:
    """The study's tables, in the order of the paper."""
    return [
        sheets.influence_sheet(report.influences),
        sheets.compensation_sheet(report.compensations),
        sheets.sightings_sheet(report.sightings),
        sheets.overlaps_sheet(report.pairs),
        sheets.timing_sheet(report.periods, report.mountain),
    ]


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Every table as CSV, and all of them as one Markdown text, into a folder that is there."""
    tables = sheets_of(report)
    for sheet in tables:
        with (folder / f"{sheet.name}.csv").open("w", newline="", encoding="utf-8") as stream:
            sheet.write_csv(stream)
    text = "# Li et al. (2020)\n\n" + "\n".join(sheet.to_markdown() for sheet in tables)
    (folder / "tables.md").write_text(text, encoding="utf-8")

"""The whole study: its records, tables and pictures."""

from __future__ import annotations

import functools
import pathlib
from dataclasses import dataclass, field, replace

from jaxgeo.studies.claims import Claim, claims_sheet
from jaxgeo.studies.li2020 import sheets
from jaxgeo.studies.li2020.attitude import Outlines, outlines
from jaxgeo.studies.li2020.causes import Cause, Products, causes, products
from jaxgeo.studies.li2020.claims import claims_of
from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.control import Control, controls
from jaxgeo.studies.li2020.flight import Sighting, StripPair, mean_depression, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.relief import Relief, reliefs
from jaxgeo.studies.li2020.strips import Strips, strips
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods
from jaxgeo.studies.sheet import Sheet, write_sheets


@dataclass(frozen=True)
class Report:
    """All that the study finds; where flights were left out, `outlines` is None and what follows it is empty."""

    influences: list[Influence]
    causes: list[Cause]
    products: Products
    compensations: list[Compensation]
    sightings: list[Sighting]
    pairs: list[StripPair]
    mountain: Mountain
    periods: list[Period]
    outlines: Outlines | None = None
    strips: list[Strips] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    reliefs: list[Relief] = field(default_factory=list)

    @functools.cached_property
    def claims(self) -> list[Claim]:
        """What the paper prints, beside what this report found; computed once, as tables and pages share it."""
        return claims_of(self)


def run(*, flights: bool = True, seed: int = 0) -> Report:
    """The study. Without `flights` the footprints of Figs. 7 and 8, the strips of Figs. 11 and 12, and those with
    errors of control and over relief, which take by far the most time, are left out. `seed` redraws all that is
    random: the errors of control and the fractal ground."""
    seen, overlaps, influences = sightings(), pairs(), tables_1_to_3()
    found = Report(
        influences=influences,
        causes=causes(influences),
        products=products(),
        compensations=compensations(),
        sightings=seen,
        pairs=overlaps,
        mountain=mountain(),
        periods=periods(overlaps, mean_depression(seen)),
    )
    if not flights:
        return found
    return replace(
        found, outlines=outlines(), strips=strips(), controls=controls(seed=seed), reliefs=reliefs(seed=seed)
    )


def sheets_of(report: Report) -> list[Sheet]:
    """The study's tables, in the order of the paper, and the verdicts."""
    found = [
        sheets.influence_sheet(report.influences),
        sheets.causes_sheet(report.causes, report.products),
        sheets.compensation_sheet(report.compensations),
        sheets.sightings_sheet(report.sightings),
        sheets.overlaps_sheet(report.pairs),
        sheets.timing_sheet(report.periods, report.mountain),
    ]
    if report.strips:
        found += [
            sheets.strips_sheet(report.strips),
            sheets.control_sheet(report.controls),
            sheets.relief_sheet(report.reliefs),
        ]
    return [*found, claims_sheet(report.claims)]


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Every table as CSV, and all of them as one Markdown text, into a folder that is there."""
    write_sheets("Li et al. (2020)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """The pictures, into a folder that is there; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.li2020 import figures  # only who wants pictures needs matplotlib

    figures.write(report, folder)

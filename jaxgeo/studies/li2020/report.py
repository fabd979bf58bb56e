"""The complete study: records, tables and pictures."""

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
    """All results of the study; without flights, `outlines` is None and the fields after it are empty."""

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
        """The paper's results beside those of this report; computed once, because tables and pages share them."""
        return claims_of(self)


def run(*, flights: bool = True, seed: int = 0) -> Report:
    """Run the study. Without `flights` it omits the slow parts: the footprints of Figs. 7 and 8, the strips of Figs.
    11 and 12, and those with control errors and over relief. `seed` sets the random control errors and the fractal
    ground."""
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
    """Tables of the study, in the paper's order, and the verdicts."""
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
    """Write every table as CSV, and all tables as one Markdown file, to an existing folder."""
    write_sheets("Li et al. (2020)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """Write the pictures to an existing folder; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.li2020 import figures  # only pictures need matplotlib

    figures.write(report, folder)

"""The complete study: records, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from jaxgeo.studies.li2020 import sheets
from jaxgeo.studies.li2020.attitude import Outlines, outlines
from jaxgeo.studies.li2020.causes import Cause, Products, causes, products
from jaxgeo.studies.li2020.compensation import Compensation, compensations
from jaxgeo.studies.li2020.control import Control, controls
from jaxgeo.studies.li2020.flight import Sighting, StripPair, mean_depression, pairs, sightings
from jaxgeo.studies.li2020.influence import Influence, tables_1_to_3
from jaxgeo.studies.li2020.relief import Relief, reliefs
from jaxgeo.studies.li2020.strips import Strips, strips
from jaxgeo.studies.li2020.timing import Mountain, Period, mountain, periods
from jaxgeo.studies.sheet import Sheet
from jaxgeo.studies.study_report import AbstractReport


@dataclass(frozen=True)
class Report(AbstractReport):
    """All results of the study; without flights, `outlines` is None and the fields after it are empty."""

    title = "Li et al. (2020), overlap of oblique strips"

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

    def sheets(self) -> list[Sheet]:
        found = [
            sheets.influence_sheet(self.influences),
            sheets.causes_sheet(self.causes, self.products),
            sheets.compensation_sheet(self.compensations),
            sheets.sightings_sheet(self.sightings),
            sheets.overlaps_sheet(self.pairs),
            sheets.timing_sheet(self.periods, self.mountain),
        ]
        if self.strips:
            found += [
                sheets.strips_sheet(self.strips),
                sheets.control_sheet(self.controls),
                sheets.relief_sheet(self.reliefs),
            ]
        return found


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

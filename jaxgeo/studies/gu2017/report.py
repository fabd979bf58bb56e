"""The complete study: records, tables and pictures."""

from __future__ import annotations

import functools
import pathlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from jaxgeo.studies.claims import Claim, claims_sheet
from jaxgeo.studies.gu2017 import sheets
from jaxgeo.studies.gu2017.accuracy import Accuracy, accuracy
from jaxgeo.studies.gu2017.density import Dense, by_size
from jaxgeo.studies.gu2017.flow import Flow, flow
from jaxgeo.studies.gu2017.frames import Frame, frames
from jaxgeo.studies.gu2017.scene import Imaged, in_fine_cells, made
from jaxgeo.studies.gu2017.searching import Searched, searches
from jaxgeo.studies.sheet import Sheet, write_sheets

TRIALS = 3  # blocks, with other noise, illumination, elevation model and pose


@dataclass(frozen=True)
class Report:
    """All results of the study; fields that need a scene with known truth are empty for a user-supplied image."""

    image: Imaged
    accuracy: Accuracy
    flow: Flow
    by_size: list[Dense]
    by_ties: list[Dense]
    searches: list[Searched]
    frames: list[Frame]

    @functools.cached_property
    def claims(self) -> list[Claim]:
        """The paper's results beside those of this report; computed once, because tables and pages share them."""
        from jaxgeo.studies.gu2017.claims import claims_of  # circular import: it imports this module

        return claims_of(self)


def run(seed: int = 0, image: Imaged | None = None) -> Report:
    """Run the study on an `image`, or on a simulated one with the noise of `seed`."""
    with ThreadPoolExecutor(2) as pool:  # XLA compiles the parts in parallel
        table = pool.submit(accuracy)
        im = made(seed) if image is None else image
        in_turn = pool.submit(frames, im, seed=seed)
        sought = pool.submit(searches, im, seed)
        done = flow(im, seed=seed)
        whole, fewer = ([], []) if im.sight is None else by_size(in_fine_cells(im, seed), range(seed, seed + TRIALS))
        return Report(im, table.result(), done, whole, fewer, sought.result(), in_turn.result())


def sheets_of(report: Report) -> list[Sheet]:
    """Tables of the study, in the paper's order, and the resulting verdicts."""
    found = [
        sheets.errors_sheet(report.accuracy),
        sheets.sensitivity_sheet(report.accuracy),
        sheets.slopes_sheet(report.accuracy),
        sheets.circles_sheet(report.accuracy),
        sheets.flow_sheet(report.flow),
    ]
    if report.searches:
        found += [sheets.searches_sheet(report.searches)]
    if report.by_size:
        found += [sheets.blocks_sheet(report.by_size), sheets.ties_sheet(report.by_ties)]
    if report.frames:
        found += [sheets.frames_sheet(report.frames), sheets.grounds_sheet(report.frames)]
    return [*found, claims_sheet(report.claims)]


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Write every table as CSV, and all tables as one Markdown file, to an existing folder."""
    write_sheets("Gu and Qiao (2017)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """Write the pictures to an existing folder; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.gu2017 import figures  # only pictures need matplotlib

    figures.write(report, folder)

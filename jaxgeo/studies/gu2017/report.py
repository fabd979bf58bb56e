"""The complete study: records, tables and pictures."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from jaxgeo.studies.gu2017 import sheets
from jaxgeo.studies.gu2017.accuracy import Accuracy, accuracy
from jaxgeo.studies.gu2017.density import Dense, by_size
from jaxgeo.studies.gu2017.flow import Flow, flow
from jaxgeo.studies.gu2017.frames import Frame, frames
from jaxgeo.studies.gu2017.mutual import Mutual, mutual
from jaxgeo.studies.gu2017.scene import Imaged, in_fine_cells, made
from jaxgeo.studies.gu2017.searching import Searched, searches
from jaxgeo.studies.sheet import Sheet
from jaxgeo.studies.study_report import AbstractReport

TRIALS = 3  # blocks, with other noise, illumination, elevation model and pose


@dataclass(frozen=True)
class Report(AbstractReport):
    """All results of the study; fields that need a scene with known truth are empty for a user-supplied image."""

    title = "Gu and Qiao (2017), registration to a reference image"

    image: Imaged
    accuracy: Accuracy
    flow: Flow
    by_size: list[Dense]
    by_ties: list[Dense]
    searches: list[Searched]
    frames: list[Frame]
    mutual: list[Mutual]

    def sheets(self) -> list[Sheet]:
        found = [
            sheets.errors_sheet(self.accuracy),
            sheets.sensitivity_sheet(self.accuracy),
            sheets.slopes_sheet(self.accuracy),
            sheets.circles_sheet(self.accuracy),
            sheets.flow_sheet(self.flow),
        ]
        if self.searches:
            found += [sheets.searches_sheet(self.searches)]
        if self.by_size:
            found += [sheets.blocks_sheet(self.by_size), sheets.ties_sheet(self.by_ties)]
        if self.frames:
            found += [sheets.frames_sheet(self.frames), sheets.grounds_sheet(self.frames)]
        if self.mutual:
            found += [sheets.mutual_sheet(self.mutual)]
        return found


def run(seed: int = 0, image: Imaged | None = None) -> Report:
    """Run the study on an `image`, or on a simulated one with the noise of `seed`."""
    with ThreadPoolExecutor(2) as pool:  # XLA compiles the parts in parallel
        table = pool.submit(accuracy)
        im = made(seed) if image is None else image
        in_turn = pool.submit(frames, im, seed=seed)
        sought = pool.submit(searches, im, seed)
        several = pool.submit(mutual, im, seed)
        done = flow(im, seed=seed)
        whole, fewer = ([], []) if im.sight is None else by_size(in_fine_cells(im, seed), range(seed, seed + TRIALS))
        others = sought.result(), in_turn.result(), several.result()
        return Report(im, table.result(), done, whole, fewer, *others)

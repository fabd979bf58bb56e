"""The whole study: its records, tables and pictures."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxgeo.studies.sheet import Sheet, write_sheets
from jaxgeo.studies.xue2019 import sheets
from jaxgeo.studies.xue2019.cases import MODELS, Cases, cases_of
from jaxgeo.studies.xue2019.simulation import Simulated, simulated
from jaxgeo.studies.xue2019.trials import Trials
from jaxgeo.studies.xue2019.trials import trials as run_trials


@dataclass(frozen=True)
class Report:
    """All that the study finds on one block; `trials` is None where there were none."""

    block: Simulated
    cases: Cases
    trials: Trials | None = None


def run(
    seed: int = 0,
    size: float = 1000.0,
    *,
    trials: int = 0,
    models: Sequence[str] = tuple(MODELS),
    told: Callable[[str], None] = lambda _: None,
) -> Report:
    """The study over `size` m squared, with the noise of a `seed`; and `trials` smaller blocks with other noise.

    `models` names those of self-calibration; `told` hears which case is next. Raises `ValueError` for an area without
    room for strips, and for fewer trials than none.
    """
    if trials < 0:
        raise ValueError(f"trials must be 0 or more; got {trials}.")
    block = simulated(size, seed)
    cases = cases_of(block, told, models)
    if not trials:
        return Report(block, cases)
    told("trials")
    return Report(block, cases, run_trials(trials, seed=seed))


def sheets_of(report: Report) -> list[Sheet]:
    """The study's tables, in the order of the paper."""
    found = [
        sheets.block_sheet(report.block),
        sheets.cases_sheet(report.cases),
        sheets.interior_sheet(report.cases),
        sheets.boresight_sheet(report.cases),
        sheets.improvement_sheet(report.cases),
        sheets.mapping_sheet(report.cases),
    ]
    return found if report.trials is None else [*found, sheets.trials_sheet(report.trials)]


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Every table as CSV, and all of them as one Markdown text, into a folder that is there."""
    write_sheets("Xue et al. (2019)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """The pictures, into a folder that is there; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.xue2019 import figures  # only who wants pictures needs matplotlib

    figures.write(report, folder)

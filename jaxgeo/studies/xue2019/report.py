"""The complete study: records, tables and pictures."""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxgeo.studies.claims import Claim, claims_sheet
from jaxgeo.studies.sheet import Sheet, write_sheets
from jaxgeo.studies.xue2019 import sheets
from jaxgeo.studies.xue2019.cases import MODELS, Case, Cases, cases_of, field_cases, pair_draws
from jaxgeo.studies.xue2019.claims import claims_of
from jaxgeo.studies.xue2019.free_net import FreeNet, free_nets
from jaxgeo.studies.xue2019.limits import HILLS_AT_1_500, Limits
from jaxgeo.studies.xue2019.simulation import Simulated, flown, measured
from jaxgeo.studies.xue2019.trials import Trials
from jaxgeo.studies.xue2019.trials import trials as run_trials


@dataclass(frozen=True)
class Report:
    """All results of the study on one block; `trials` is None if none were run.

    `field` are the cases with control and noisier measurements; `pairs` maps names to errors (draws, 3) of direct
    georeferencing from image pairs with other noise, m; `limits` are the accuracy limits for maps at 1:500.
    """

    block: Simulated
    cases: Cases
    field: list[Case]
    pairs: dict[str, np.ndarray]
    free_nets: list[FreeNet]
    limits: Limits = HILLS_AT_1_500
    trials: Trials | None = None

    @functools.cached_property
    def claims(self) -> list[Claim]:
        """The paper's results beside those of this report; computed once, because tables and pages share them."""
        return claims_of(self)


def run(
    seed: int = 0,
    size: float = 1000.0,
    *,
    trials: int = 0,
    draws: int = 4,
    models: Sequence[str] = tuple(MODELS),
    limits: Limits = HILLS_AT_1_500,
    told: Callable[[str], None] = lambda _: None,
) -> Report:
    """Run the study over `size` m squared, with the noise of `seed`, and `trials` smaller blocks with other noise.

    Image pairs are drawn `draws` more times. `models` names the self-calibration models; `limits` are those of a
    standard for maps at 1:500; `told` is a callback that receives the name of the next case. Raises `ValueError` for an
    area too small for strips, for a negative number of trials, and for fewer than 2 draws.
    """
    if trials < 0:
        raise ValueError(f"trials must be 0 or more; got {trials}.")
    if draws < 2:
        raise ValueError(f"draws must be 2 or more, for a spread; got {draws}.")
    flight = flown(size)
    block = measured(flight, seed)
    cases = cases_of(block, told, models)
    lens = MODELS[models[-1]]
    field = field_cases(flight, seed, told, models)
    told("pairs with other noise")
    pairs = pair_draws(flight, cases.calibrated, lens, range(seed + 1, seed + 1 + draws))
    nets = free_nets(block, lens, cases.of("compensated pair").rms, seed, told)
    found = Report(block, cases, field, pairs, nets, limits)
    if not trials:
        return found
    told("trials")
    return replace(found, trials=run_trials(trials, seed=seed))


def sheets_of(report: Report) -> list[Sheet]:
    """Tables of the study, in the paper's order."""
    found = [
        sheets.block_sheet(report.block),
        sheets.cases_sheet(report.cases),
        sheets.pairs_sheet(report.cases, report.pairs),
        sheets.free_net_sheet(report.free_nets),
        sheets.field_sheet(report.cases, report.field),
        sheets.interior_sheet(report.cases),
        sheets.boresight_sheet(report.cases),
        sheets.improvement_sheet(report.cases),
        sheets.mapping_sheet(report.cases, report.limits),
    ]
    if report.trials is not None:
        found.append(sheets.trials_sheet(report.trials))
    return [*found, claims_sheet(report.claims)]


def write_tables(report: Report, folder: pathlib.Path) -> None:
    """Write every table as CSV, and all tables as one Markdown file, to an existing folder."""
    write_sheets("Xue et al. (2019)", sheets_of(report), folder)


def write_pictures(report: Report, folder: pathlib.Path) -> None:
    """Write the pictures to an existing folder; raises `ImportError` without matplotlib."""
    from jaxgeo.studies.xue2019 import figures  # only pictures need matplotlib

    figures.write(report, folder)

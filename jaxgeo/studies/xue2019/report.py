"""The complete study: records, tables and pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxgeo.studies.sheet import Sheet
from jaxgeo.studies.study_report import AbstractReport
from jaxgeo.studies.xue2019 import sheets
from jaxgeo.studies.xue2019.cases import MODELS, Case, Cases, cases_of, field_cases, pair_draws
from jaxgeo.studies.xue2019.free_net import FreeNet, free_nets
from jaxgeo.studies.xue2019.limits import HILLS_AT_1_500, Limits
from jaxgeo.studies.xue2019.simulation import Simulated, flown, measured
from jaxgeo.studies.xue2019.trials import Trials
from jaxgeo.studies.xue2019.trials import trials as run_trials


@dataclass(frozen=True)
class Report(AbstractReport):
    """All results of the study on one block; `trials` is None if none were run.

    `field` are the cases with control and noisier measurements; `pairs` maps names to errors (draws, 3) of direct
    georeferencing from image pairs with other noise, m; `limits` are the accuracy limits for maps at 1:500.
    """

    title = "Xue et al. (2019), direct georeferencing and self-calibration"

    block: Simulated
    cases: Cases
    field: list[Case]
    pairs: dict[str, np.ndarray]
    free_nets: list[FreeNet]
    limits: Limits = HILLS_AT_1_500
    trials: Trials | None = None

    def sheets(self) -> list[Sheet]:
        found = [
            sheets.block_sheet(self.block),
            sheets.cases_sheet(self.cases),
            sheets.pairs_sheet(self.cases, self.pairs),
            sheets.free_net_sheet(self.free_nets),
            sheets.field_sheet(self.cases, self.field),
            sheets.interior_sheet(self.cases),
            sheets.boresight_sheet(self.cases),
            sheets.improvement_sheet(self.cases),
            sheets.mapping_sheet(self.cases, self.limits),
        ]
        if self.trials is not None:
            found.append(sheets.trials_sheet(self.trials))
        return found


def run(
    seed: int = 0,
    size: float = 1000.0,
    *,
    trials: int = 0,
    draws: int = 4,
    models: Sequence[str] = tuple(MODELS),
    limits: Limits = HILLS_AT_1_500,
    callback: Callable[[str], None] = lambda _: None,
) -> Report:
    """Run the study over `size` m squared, with the noise of `seed`, and `trials` smaller blocks with other noise.

    Image pairs are drawn `draws` more times. `models` names the self-calibration models; `limits` are those of a
    standard for maps at 1:500; `callback` receives the name of the next case. Raises `ValueError` for an area
    too small for strips, for a negative number of trials, and for fewer than 2 draws.
    """
    if trials < 0:
        raise ValueError(f"trials must be 0 or more; got {trials}.")
    if draws < 2:
        raise ValueError(f"draws must be 2 or more, for a spread; got {draws}.")
    flight = flown(size)
    block = measured(flight, seed)
    cases = cases_of(block, callback, models)
    lens = MODELS[models[-1]]
    field = field_cases(flight, seed, callback, models)
    callback("pairs with other noise")
    pairs = pair_draws(flight, cases.calibrated, lens, range(seed + 1, seed + 1 + draws))
    nets = free_nets(block, lens, cases.of("compensated pair").rms, seed, callback)
    found = Report(block, cases, field, pairs, nets, limits)
    if not trials:
        return found
    callback("trials")
    return replace(found, trials=run_trials(trials, seed=seed))

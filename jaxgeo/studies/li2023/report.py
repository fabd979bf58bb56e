"""The complete study: records, tables and pictures."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxgeo.studies.li2023 import printed, sheets
from jaxgeo.studies.li2023.causes import Cause, causes
from jaxgeo.studies.li2023.inclination import Inclination, fig_5
from jaxgeo.studies.li2023.pointing import Pointing, pointing_errors
from jaxgeo.studies.li2023.positions import (
    Accuracy,
    Judged,
    over_fractal_ground,
    over_level_ground,
    over_real_ground,
)
from jaxgeo.studies.li2023.search_sheets import search_sheets
from jaxgeo.studies.li2023.searches import RAYS, TERRAINS, Comparison, compare_searches
from jaxgeo.studies.li2023.targets import Target, table_2
from jaxgeo.studies.li2023.tilts import Tilt, implied_tilts
from jaxgeo.studies.sheet import Sheet
from jaxgeo.studies.study_report import AbstractReport

SAMPLES = 50_000
PLACES = 12
FRAMES = np.arange(60.0, 79.0).tolist()  # deg
SIGMAS = np.linspace(*printed.FIG_5_SIGMAS, 19).tolist()


@dataclass(frozen=True)
class Report(AbstractReport):
    """All results of the study."""

    title = "Li et al. (2023), target location by fast elevation iteration"

    pointing: list[Pointing]
    inclination: Inclination
    targets: list[Target]
    positions: list[Accuracy]
    judged: list[Judged]
    tilts: list[Tilt]
    causes: list[Cause]
    searches: Comparison

    def sheets(self) -> list[Sheet]:
        return [
            sheets.pointing_sheet(self.pointing),
            sheets.sight_sheet(),
            sheets.inclination_sheet(self.inclination),
            sheets.targets_sheet(self.targets),
            sheets.misprints_sheet(),
            sheets.positions_sheet(self.positions),
            sheets.circles_sheet(self.positions),
            sheets.judged_sheet(self.judged),
            sheets.causes_sheet(self.causes),
            sheets.tilts_sheet(self.tilts),
            *search_sheets(self.searches),
        ]

    def sheets_beside(self) -> list[Sheet]:
        return [sheets.places_sheet(self.positions)]


def run(
    *,
    samples: int = SAMPLES,
    places: int = PLACES,
    seed: int = 0,
    terrains: int = TERRAINS,
    rays: int = RAYS,
    executor: Any = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Report:
    """Run the study with `samples` samples for each row of a table; on synthetic and real terrain they are split among
    `places` places. The searches run over `terrains` terrains of each kind with `rays` rays each. `seed` sets all
    random numbers: samples, terrains, places and rays.

    The places are evaluated as by `jaxgeo.sweep`: in parallel by an `executor` or a Dask client, and into a `folder`,
    where a later run finds them. Neither changes the results.

    Raises `ValueError` for fewer than two samples or terrains, one place or eight rays.
    """
    for name, number, least in (
        ("samples", samples, 2),
        ("places", places, 1),
        ("terrains", terrains, 2),
        ("rays", rays, 8),
    ):
        if number < least:
            raise ValueError(f"{name} must be at least {least}; got {number}.")
    keys = jax.random.split(jax.random.key(seed), 5)
    plain = printed.TERRAINS["plain"]
    level = f"level flight, {plain.outer:.2f}°"
    each = -(-samples // places)
    how: Any = {"samples": each, "places": places, "seed": seed, "executor": executor, "progress": progress}
    kept = {name: None if folder is None else pathlib.Path(folder) / f"{name}.zarr" for name in ("synthetic", "real")}
    synthetic, judged = over_fractal_ground(key=keys[3], folder=kept["synthetic"], **how)
    real, real_judged = over_real_ground(key=keys[4], folder=kept["real"], **how)
    return Report(
        pointing=[
            pointing_errors("plain of Table 2", printed.shot_of(plain), samples=samples, key=keys[0]),
            pointing_errors(level, printed.level_shot(plain.outer), samples=samples, key=keys[1]),
        ],
        inclination=fig_5(FRAMES, SIGMAS),
        targets=table_2(),
        positions=[*over_level_ground(samples=samples, key=keys[2]), *synthetic, *real],
        judged=[*judged, *real_judged],
        tilts=implied_tilts(),
        causes=causes(),
        searches=compare_searches(terrains=terrains, rays=rays, seed=seed),
    )

"""The four studies, their verdicts together, and one page of all."""

from __future__ import annotations

import importlib
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from jaxgeo.studies.claims import Claim, Verdict, claims_sheet
from jaxgeo.studies.sheet import Sheet, write_sheets

SAMPLES = 20_000  # for each row of Li et al. (2023); fewer than in its own command, so that all studies take minutes
RUNS: dict[str, Callable[[Any, int], Any]] = {
    "li2023": lambda study, seed: study.run(samples=SAMPLES, seed=seed),
    "li2020": lambda study, seed: study.run(seed=seed),
    "xue2019": lambda study, seed: study.run(seed),
    "gu2017": lambda study, seed: study.run(seed),
}


@dataclass(frozen=True)
class Study:
    """Results of a study for display: `name` as in the command, title, claims, tables, and files of its pictures.

    `missing` gives the reason if there are no pictures.
    """

    name: str
    title: str
    claims: Sequence[Claim]
    sheets: Sequence[Sheet]
    pictures: Sequence[pathlib.Path] = ()
    missing: str = ""

    @property
    def counts(self) -> list[tuple[Verdict, int]]:
        """Number of claims with each verdict."""
        return [(kind, sum(one.verdict is kind for one in self.claims)) for kind in Verdict]


def run(name: str, seed: int = 0, folder: pathlib.Path | None = None) -> Study:
    """Run one study, by the name of its command, with all random numbers drawn from `seed`.

    With an existing `folder`, writes its tables and pictures to a subfolder of its name; without matplotlib there are
    no pictures.
    """
    package: Any = importlib.import_module(f"jaxgeo.studies.{name}")
    report = RUNS[name](package, seed)
    pictures, missing = [], ""
    if folder is not None:
        own = folder / name
        own.mkdir(exist_ok=True)
        package.write_tables(report, own)
        try:
            package.write_pictures(report, own)
            pictures = sorted(own.glob("*.png"))
        except ImportError as error:
            missing = str(error)
    return Study(name, report.title, report.claims, package.sheets_of(report), pictures, missing)


def write_verdicts(found: Sequence[Study], folder: pathlib.Path) -> None:
    """Write the verdicts of all studies as CSV and Markdown to an existing folder."""
    write_sheets("Verdicts", [claims_sheet([claim for one in found for claim in one.claims])], folder)

"""The four studies one after another, their verdicts together, and one page of all."""

from __future__ import annotations

import importlib
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from jaxgeo.studies.claims import Claim, claims_sheet
from jaxgeo.studies.sheet import write_sheets

TITLES = {
    "li2023": "Li et al. (2023), target location by fast elevation iteration",
    "li2020": "Li et al. (2020), overlap of oblique strips",
    "xue2019": "Xue et al. (2019), direct georeferencing and self-calibration",
    "gu2017": "Gu and Qiao (2017), registration to a reference image",
}
RUNS: dict[str, Callable[[Any, int], Any]] = {
    "li2023": lambda study, seed: study.run(seed=seed),
    "li2020": lambda study, seed: study.run(seed=seed),
    "xue2019": lambda study, seed: study.run(seed),
    "gu2017": lambda study, seed: study.run(seed),
}


@dataclass(frozen=True)
class Found:
    """A study's report and its claims; `name` as in the command."""

    name: str
    report: Any
    claims: list[Claim]

    @property
    def study(self) -> Any:
        """The study's package."""
        return _package(self.name)


def run(name: str, seed: int = 0) -> Found:
    """One of the studies, by the name of its command, with all that is random drawn from a seed."""
    study = _package(name)
    report = RUNS[name](study, seed)
    return Found(name, report, study.claims_of(report))


def write(found: Sequence[Found], folder: pathlib.Path) -> None:
    """Tables and pictures of each study into a folder of its own, verdicts, and a page `index.html` of all.

    The folder is there. Raises `ImportError` without matplotlib or jinja2, once all tables are written.
    """
    sheet = claims_sheet([claim for one in found for claim in one.claims])
    write_sheets("Verdicts", [sheet], folder)
    for one in found:
        (folder / one.name).mkdir(exist_ok=True)
        one.study.write_tables(one.report, folder / one.name)
    from jaxgeo.studies.page import Study, write_page  # only who wants a page needs jinja2

    studies = []
    for one in found:
        one.study.write_pictures(one.report, folder / one.name)
        pictures = sorted((folder / one.name).glob("*.png"))
        studies.append(Study(one.name, TITLES[one.name], one.claims, one.study.sheets_of(one.report), pictures))
    write_page(folder / "index.html", studies)


def _package(name: str) -> Any:
    return importlib.import_module(f"jaxgeo.studies.{name}")

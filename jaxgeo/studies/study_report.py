"""Results of one study: claims, tables and pictures, and their files."""

from __future__ import annotations

import functools
import importlib
import pathlib
from collections.abc import Sequence
from typing import Any, ClassVar

from jaxgeo.studies.claims import Claim, claims_sheet
from jaxgeo.studies.sheet import Sheet, write_sheets


class AbstractReport:
    """Base class of the reports of studies: a frozen dataclass of all results.

    A subclass is in a package with the functions `claims_of(report)` and, in its module `figures`, `write(report,
    folder)`. `title` has the authors and the year up to its first comma.
    """

    title: ClassVar[str]

    def sheets(self) -> list[Sheet]:
        """Tables of the study, in the paper's order, without the verdicts."""
        raise NotImplementedError

    def sheets_beside(self) -> Sequence[Sheet]:
        """Tables that are written as CSV only."""
        return ()

    @functools.cached_property
    def claims(self) -> list[Claim]:
        """The paper's results beside those of this report; computed once, because tables and pages share them."""
        return _package_of(self).claims_of(self)


def sheets_of(report: AbstractReport) -> list[Sheet]:
    """Tables of the study, in the paper's order, and the verdicts."""
    return [*report.sheets(), claims_sheet(report.claims)]


def write_tables(report: AbstractReport, folder: pathlib.Path) -> None:
    """Write every table as CSV, and all tables as one Markdown file, to an existing folder."""
    write_sheets(report.title.partition(",")[0], sheets_of(report), folder, beside=report.sheets_beside())


def write_pictures(report: AbstractReport, folder: pathlib.Path) -> None:
    """Write the pictures to an existing folder; raises `ImportError` without matplotlib."""
    importlib.import_module(f"{_package_of(report).__name__}.figures").write(report, folder)  # needs matplotlib


def _package_of(report: AbstractReport) -> Any:
    return importlib.import_module(type(report).__module__.rpartition(".")[0])

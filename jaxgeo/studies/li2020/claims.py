"""Claims of Li et al. (2020) with the results obtained here: equations, tables, figures and statements."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020.claims_of_figures import claims_of_figures
from jaxgeo.studies.li2020.claims_of_tables import claims_of_tables
from jaxgeo.studies.li2020.claims_of_text import claims_of_abstract, claims_of_text
from jaxgeo.studies.li2020.equations import equations

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report


def claims_of(report: Report) -> list[Claim]:
    """Claims for every numbered equation, table and figure, and the numbers and statements of text and abstract.

    In a report without flights, claims that need them are marked not reproducible, with that reason.
    """
    return [
        *claims_of_abstract(report),
        *equations(),
        *claims_of_tables(report),
        *claims_of_figures(report),
        *claims_of_text(report),
    ]

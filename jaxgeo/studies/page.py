"""HTML page of all studies: verdicts, tables, pictures, and the functions that computed them. Needs jinja2."""

from __future__ import annotations

import base64
import importlib
import importlib.metadata
import inspect
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass

import jinja2

from jaxgeo._destination import destination
from jaxgeo.studies.all_studies import Study
from jaxgeo.studies.claims import Verdict, resolve, shown

PACKAGE = "jaxgeo"


@dataclass(frozen=True)
class Function:
    """A function or class of the package, as shown on the page."""

    name: str
    signature: str
    doc: str
    place: str


def study_page(studies: Sequence[Study]) -> str:
    """The page as one HTML string with embedded pictures. Raises `ValueError` if a claim names no function."""
    names = sorted({one.function for study in studies for one in study.claims if one.function})
    loader = jinja2.PackageLoader("jaxgeo.studies", "templates")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(shown=shown, embedded=_embedded)
    totals = [(kind, sum(dict(study.counts)[kind] for study in studies)) for kind in Verdict]
    return environment.get_template("page.html").render(
        studies=studies,
        totals=totals,
        functions=[function_of(name) for name in names],
        version=importlib.metadata.version(PACKAGE),
    )


def write_page(path: pathlib.Path, studies: Sequence[Study]) -> None:
    """Write the page to a file, atomically. Raises `ValueError` if the file cannot be written."""
    with destination("path", path) as stream:
        stream.write(study_page(studies))


def function_of(name: str) -> Function:
    """Signature, docstring and source location of the named function. Raises `ValueError` if it does not exist."""
    found = resolve(name)
    target = inspect.unwrap(found) if callable(found) else found
    target = target.fget if isinstance(target, property) else target
    try:
        signature = str(inspect.signature(target)) if callable(target) else ""
        path = pathlib.Path(inspect.getsourcefile(target) or "")  # pyright: ignore[reportArgumentType]
        line = inspect.getsourcelines(target)[1]  # pyright: ignore[reportArgumentType]
        package = pathlib.Path(importlib.import_module(PACKAGE).__file__ or "").parent
        place = f"{path.relative_to(package.parent).as_posix()}:{line}" if path.is_relative_to(package.parent) else ""
    except (TypeError, ValueError, OSError):  # implemented in C, or source not available
        signature, place = "", ""
    return Function(name, signature, inspect.getdoc(target) or "", place)


def _embedded(path: pathlib.Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")

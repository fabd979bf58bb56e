"""The notebooks have one look, carry no outputs, and name nothing that a reader does not have."""

from __future__ import annotations

import ast
import json
import pathlib
import re
from typing import Any, NamedTuple

import pytest

FOLDER = pathlib.Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
LARGEST = 60_000  # bytes: text alone is smaller, a picture is not
PRIVATE = ("JAXGEO_TEST_DATA", "shared/data", "jaxgeo_test_data")
FOREIGN_PATH = re.compile(r"""["'(\s](/(?:home|root|tmp|work|usr|Users|mnt|data)/|[A-Za-z]:\\\\)""")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
LONGEST_OPENING = 1500  # characters


class Cell(NamedTuple):
    kind: str
    source: str
    raw: dict[str, Any]


@pytest.fixture(params=NOTEBOOKS)
def notebook(request) -> dict[str, Any]:
    return json.loads((FOLDER / request.param).read_text(encoding="utf-8"))


@pytest.fixture
def cells(notebook) -> list[Cell]:
    return [Cell(cell["cell_type"], "".join(cell["source"]), cell) for cell in notebook["cells"]]


@pytest.fixture
def code(cells) -> list[str]:
    return [cell.source for cell in cells if cell.kind == "code"]


def test_those_that_readers_start_with_are_there():
    assert {"quickstart.ipynb", "first_fix.ipynb", "new_sensor.ipynb"} <= set(NOTEBOOKS)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_small(name):
    assert (FOLDER / name).stat().st_size < LARGEST


def test_it_runs_anywhere(notebook, cells):
    assert (notebook["nbformat"], notebook["nbformat_minor"]) >= (4, 5)
    assert notebook["metadata"]["kernelspec"]["name"] == "python3"
    identifiers = [cell.raw["id"] for cell in cells]
    assert len(set(identifiers)) == len(identifiers)


def test_it_is_valid(notebook):
    nbformat = pytest.importorskip("nbformat", reason="needs the extra: pip install 'jaxgeo[notebooks]'")
    nbformat.validate(notebook)


def test_it_carries_no_outputs(cells):
    for cell in cells:
        if cell.kind == "code":
            assert cell.raw["outputs"] == []
            assert cell.raw["execution_count"] is None


def test_it_opens_with_a_title_a_question_and_what_is_needed(cells):
    first = cells[0]
    assert first.kind == "markdown"
    title, question, *rest = first.source.split("\n\n")
    assert re.fullmatch(r"# [^\n]+", title)
    assert re.fullmatch(r"\*[^*\n]+\?\*", question), "the second paragraph is the question in italics"
    assert rest
    assert re.search(r"[Aa]bout (\d+ seconds|a minute)", rest[-1]), "it is said how long it takes"
    assert "nothing is downloaded" in rest[-1]
    assert len(first.source) < LONGEST_OPENING
    assert [cell for cell in cells if cell.source.startswith("# ") and cell.kind == "markdown"] == [first]


def test_its_first_code_is_imports_64_bit_floats_and_the_style(code):
    first = ast.parse(code[0])
    text = code[0]
    order = [
        text.index(line)
        for line in ("import jaxgeo\n", "jaxgeo.enable_x64()", "plt.rcParams.update(plot.style.style())")
    ]
    assert order == sorted(order)
    assert isinstance(first.body[0], ast.Import | ast.ImportFrom)
    for later in code[1:]:
        assert not re.search(r"^(import|from) ", later, re.MULTILINE), "all imports stand in the first cell"
        assert "rcParams" not in later


def test_its_colours_are_those_of_the_house(code):
    strange = set(re.findall(r"#[0-9a-fA-F]{6}", "\n".join(code))) - {"#5b4a35"}  # the edge of ground in a section
    assert not strange, f"take jaxgeo.plot.style's colours in place of {sorted(strange)}"


def test_it_ends_with_where_to_go_next(cells):
    last = cells[-1]
    assert last.kind == "markdown"
    _, heading, links = last.source.rpartition("## Where to go next\n")
    assert heading
    assert len(LINK.findall(links)) >= 2
    assert all(line.startswith("- ") for line in links.strip().split("\n"))


def test_its_links_lead_somewhere(cells):
    for cell in cells:
        if cell.kind == "markdown":
            for target in LINK.findall(cell.source):
                assert (FOLDER / target).exists(), f"there is no {target}"


def test_it_names_no_place_and_no_data_that_others_do_not_have(cells):
    for cell in cells:
        assert not FOREIGN_PATH.search(cell.source), cell.source
        assert not any(word in cell.source for word in PRIVATE), cell.source

"""The documentation: its Python runs, its links lead somewhere, its tables are those of the code, its site is whole."""

from __future__ import annotations

import ast
import contextlib
import importlib
import importlib.util
import os
import pathlib
import re
import subprocess
import sys
import types
from html.parser import HTMLParser
from typing import Any, NamedTuple

import pytest
from support.command_files import FILES, prepare
from support.tile_server import mirrored

import jaxgeo
from jaxgeo.io.tables import FIX_COLUMNS
from jaxgeo.register import Outcome
from jaxgeo.status import Status

PROJECT = pathlib.Path(__file__).resolve().parents[1]
DOCS = PROJECT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
FENCE = re.compile(r"^( *)```python\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
ANY_FENCE = re.compile(r"^ *(`{3,})[^`\n]*\n.*?^ *\1 *$", re.MULTILINE | re.DOTALL)
MOVING = {"ortho.tif", "image.tif"}  # made for registration, together with their scene
ATTRIBUTES = {"src", "href", "data-src", "srcset", "poster"}
LOADED = {"script", "link", "img", "source", "iframe", "video", "audio", "embed", "object", "use"}


class Block(NamedTuple):
    """Python of a page, and the line of the page in which it begins."""

    code: str
    line: int


def blocks_of(page: pathlib.Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        indent = len(match[1])
        code = "".join(line[indent:] for line in match[2].splitlines(keepends=True))
        found.append(Block(code, text.count("\n", 0, match.start(2)) + 1))
    return found


def name_of(page: pathlib.Path) -> str:
    return page.relative_to(DOCS).as_posix()


WITH_PYTHON = [page for page in PAGES if blocks_of(page)]
ELSEWHERE = ("gallery.md", "howto/registration.md")  # run by docs/figures/make.py, and by the notebook
RUN = [page for page in WITH_PYTHON if name_of(page) not in ELSEWHERE]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=name_of)
def test_names_that_a_page_uses_are_there(page: pathlib.Path) -> None:
    """What is imported can be, and what is asked of jaxgeo's modules is in them."""
    tree = ast.parse("\n".join(block.code for block in blocks_of(page)))
    modules: dict[str, Any] = {"jaxgeo": jaxgeo}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxgeo"):
            module = importlib.import_module(node.module or "")
            for alias in node.names:
                found = getattr(module, alias.name, None) or importlib.import_module(f"{node.module}.{alias.name}")
                modules[alias.asname or alias.name] = found
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = modules.get(node.value.id)
            if isinstance(module, types.ModuleType):
                assert hasattr(module, node.attr), f"{name_of(page)}: {module.__name__} has no {node.attr}"


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_python_of_a_page_runs(
    page: pathlib.Path,
    tmp_path: pathlib.Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All of it in order, in one namespace, in a folder with the files that it names."""
    blocks = blocks_of(page)
    named = {name for name in {*FILES, *MOVING} if any(f'"{name}"' in block.code for block in blocks)}
    prepare(tmp_path, " ".join([*sorted(named - MOVING), *(["register"] if named & MOVING else [])]))
    monkeypatch.chdir(tmp_path)
    with contextlib.ExitStack() as until_run:
        if any("fetch_dem" in block.code for block in blocks):
            until_run.enter_context(mirrored(tmp_path_factory.mktemp("archive"), monkeypatch.setenv))
        _run(page, blocks, monkeypatch)


def _run(page: pathlib.Path, blocks: list[Block], monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", module)
    for block in blocks:
        code = "\n" * (block.line - 1) + block.code  # so that a failure names the line of the page
        exec(compile(code, str(page), "exec", dont_inherit=True), module.__dict__)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: pathlib.Path) -> None:
    """Pages, notebooks and pictures that are linked are there, in the checkout too."""
    text = ANY_FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in LINK.findall(text):
        if target.startswith(("http", "#", "mailto")):
            continue
        path = (page.parent / target.partition("#")[0]).resolve()
        assert path.exists(), (name_of(page), target)


def rows_of(page: pathlib.Path) -> dict[str, str]:
    """Rows of tables whose first cell is a name in code: the last cell by that name."""
    found = {}
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) > 1 and re.fullmatch(r"`\w+`", cells[0]):
            found[cells[0].strip("`")] = cells[-1]
    return found


def test_every_status_is_in_the_table() -> None:
    told = rows_of(DOCS / "statuses.md")
    for kind in (Status, Outcome):
        for member in kind:
            assert told.get(member.name) == member.message, member
    assert set(told) == {member.name for kind in (Status, Outcome) for member in kind}


def test_every_public_room_has_its_page() -> None:
    """Public names of the package are rooms, which have a page, or are on the page of one."""
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md")}
    shown = set(re.findall(r"^::: ([\w.]+)", "\n".join(pages.values()), re.MULTILINE))
    rooms = [importlib.import_module(name) for name in shown if is_module(name)]
    for name in jaxgeo.__all__:
        found = getattr(jaxgeo, name)
        if isinstance(found, types.ModuleType):
            assert found.__name__ in shown, name
        else:
            told = any(name in getattr(room, "__all__", ()) and getattr(room, name) is found for room in rooms)
            assert told or any(one.endswith(f".{name}") for one in shown), name


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def undocumented(reference: pathlib.Path) -> dict[str, set[str]]:
    """Public functions and classes of each room that have no entry on its page."""
    found = {}
    for page in (DOCS / "api").glob("*.md"):
        html = (reference / f"{page.stem}.html").read_text(encoding="utf-8")
        there = {name.rpartition(".")[2] for name in re.findall(r'id="(jaxgeo[\w.]+)"', html)}
        for room in re.findall(r"^::: ([\w.]+)", page.read_text(encoding="utf-8"), re.MULTILINE):
            if is_module(room):
                module = importlib.import_module(room)
                told = [name for name in getattr(module, "__all__", ()) if is_documented(getattr(module, name))]
                found[room] = set(told) - there
    return found


def is_documented(thing: Any) -> bool:
    """Whether a public name is one of the things that the reference tells of: no constant, and no alias of types."""
    return isinstance(thing, type | types.FunctionType)


class Loaded(HTMLParser):
    """What a page of the site loads: (tag, address) of scripts, styles, fonts, pictures and frames."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in LOADED or given.get("rel") in ("canonical", "next", "prev", "alternate"):
            return
        self.found += [(tag, value or "") for name, value in attrs if name in ATTRIBUTES]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="the extra docs is not installed")
def test_site_is_built_and_loads_nothing_from_elsewhere(tmp_path: pathlib.Path) -> None:
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}  # of the theme's makers, on another program
    built = subprocess.run(command, cwd=PROJECT, env=quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr  # strict: no warning passes
    pages = list(site.rglob("*.html"))
    assert len(pages) > len(PAGES)  # tutorials too
    for page in pages:
        parser = Loaded()
        text = page.read_text(encoding="utf-8")
        parser.feed(text)
        far = [one for one in parser.found if re.match(r"(https?:)?//", one[1])]
        assert not far, (page.relative_to(site), far)
        assert 'class="arithmatex"' not in text, page
    for room, missing in undocumented(site / "api").items():
        assert not missing, room
    for style in site.rglob("*.css"):
        assert not re.search(r"(@import|url\()\s*['\"]?(https?:)?//", style.read_text(encoding="utf-8")), style


def test_the_cheat_sheet_names_every_column_of_fixes() -> None:
    from jaxgeo.io._fix_columns import _figures_row, no_figures

    text = (DOCS / "howto" / "cheat-sheet.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z0-9_]+)`", text))
    assert {*FIX_COLUMNS, *_figures_row(no_figures(1, 0.9), 0), "status_text"} <= named

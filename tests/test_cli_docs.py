"""Every command that README, documentation and help show: it parses, and it does what it says."""

from __future__ import annotations

import pathlib
import re
import shlex
from collections.abc import Iterator
from typing import NamedTuple

import pytest
import typer
from support.command_files import prepare
from support.command_runner import CliRunner
from support.tile_server import mirrored

from jaxgeo.cli import app
from jaxgeo.cli._examples import EXAMPLES

PROJECT = pathlib.Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^ *```(?:console|shell|bash|sh)\b[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\|[^|]*\| `(jaxgeo \w+ [^`]+)`", re.MULTILINE)  # of a table of commands
NOT_RUN = "not run"
WRITING = ("-o", "--output", "--calibrate", "--mosaic", "--write-scene", "--write-dem")  # options of files


class Shown(NamedTuple):
    """A command line, with what stands behind it, and where it is shown."""

    line: str
    note: str
    where: str

    @property
    def words(self) -> list[str]:
        return shlex.split(self.line)[1:]


def commands_of(group, above: tuple[str, ...] = ()):
    """(words, command) of all commands of a group, and of those in it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, (*above, name))
        else:
            yield (*above, name), command


def shown_in(path: pathlib.Path) -> list[Shown]:
    """The commands of a page."""
    text, where = path.read_text(encoding="utf-8"), path.relative_to(PROJECT).as_posix()
    found = [Shown(line, "", where) for line in ROW.findall(text)]
    for block in FENCE.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            command, _, note = line.strip().removeprefix("$ ").partition("  #")
            if command.startswith("jaxgeo "):
                found.append(Shown(" ".join(command.split()), note.strip(), where))
    return found


def all_shown() -> list[Shown]:
    pages = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
    of_pages = [one for page in pages for one in shown_in(page)]
    known = {name[-1] for name, _ in commands_of(typer.main.get_command(app))}
    of_help = [Shown(line, "", "help") for name in EXAMPLES if name in known for line in EXAMPLES[name]]
    return list({one.line: one for one in [*of_pages, *of_help]}.values())


ALL = all_shown()
LONG = ("adjust", "demo", "study", "view")  # what they do is tested where they are


@pytest.fixture
def copernicus(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A mirror of the archive on the loopback, and an empty cache."""
    with mirrored(tmp_path_factory.mktemp("archive"), monkeypatch.setenv):
        for line in ("dem 36.31,-84.25 --radius 2000",):  # what a page shows before it goes offline
            assert run(line.split()).exit_code == 0
        yield


def run(words: list[str]):
    return CliRunner().invoke(app, words, prog_name="jaxgeo")


@pytest.mark.costly
@pytest.mark.parametrize("shown", ALL, ids=[one.line[7:60] for one in ALL])
def test_what_is_shown_is_understood(shown: Shown) -> None:
    """No flag that is not there, none that is missing, no value of another kind."""
    command, words = typer.main.get_command(app), shown.words
    while hasattr(command, "commands") and not words[0].startswith("-"):
        assert words[0] in command.commands, f"{shown.where}: {shown.line}"
        command = command.commands[words.pop(0)]
    if not hasattr(command, "commands") and "--help" not in words:
        command.make_context("jaxgeo", words)


@pytest.mark.slow
@pytest.mark.parametrize("shown", ALL, ids=[one.line[7:60] for one in ALL])
def test_what_is_shown_is_done(tmp_path: pathlib.Path, monkeypatch, request, shown: Shown) -> None:
    if shown.words[0] in LONG or NOT_RUN in shown.note:
        pytest.skip(f"not run here: {shown.line}")
    if "copernicus" in shown.line or shown.words[0] == "dem":
        request.getfixturevalue("copernicus")
    prepare(tmp_path, shown.line)
    before = {path.name for path in tmp_path.iterdir()}
    monkeypatch.chdir(tmp_path)
    expected = int(found[1]) if (found := re.search(r"exit code (\d+)", shown.note)) else 0
    result = run(shown.words)
    assert result.exit_code == expected, f"{shown.where}: {shown.line}\n{result.output}"
    assert "Traceback" not in result.output
    asked = [word for flag, word in zip(shown.words, shown.words[1:], strict=False) if flag in WRITING]
    for name in asked:
        written = pathlib.Path(name.rstrip("/"))
        assert written.exists(), f"{shown.where}: {shown.line} has written no {name}"
        assert written.name in before or written.is_dir() or written.stat().st_size > 0
        told = [line for line in result.stderr.splitlines() if line.startswith(f"jaxgeo: written: {written}")]
        assert told or "--quiet" in shown.words, f"{shown.where}: {shown.line} does not say that it has written {name}"


def test_every_command_has_examples_in_its_help() -> None:
    group = typer.main.get_command(app)
    for name, command in commands_of(group):
        text = " ".join(run([*name, "--help"]).stdout.split())
        assert "Examples" in text, name
        for line in EXAMPLES[name[-1]]:
            assert line.replace(" ", "") in text.replace(" ", ""), (name, line)
        assert command.help, name

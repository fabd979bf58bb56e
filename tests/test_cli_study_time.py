"""How long a study takes is said as it was measured, in help and docs too, and shown while it runs."""

from __future__ import annotations

import io
import pathlib
import re
import time

import pytest
from support.command_runner import CliRunner

from jaxgeo.cli import _screen, _study_time, app
from jaxgeo.cli._console import Console
from jaxgeo.cli._study_time import MACHINE, MEASURED, minutes_of, study_progress
from jaxgeo.studies.all_studies import RUNS

DOCS = pathlib.Path(__file__).resolve().parents[1] / "docs" / "howto" / "command-line.md"


def test_every_study_was_measured_and_the_docs_and_the_help_have_its_time() -> None:
    assert set(MEASURED) == set(RUNS)
    told = " ".join(CliRunner().invoke(app, ["study", "--help"]).stdout.replace("│", " ").split())
    lines = DOCS.read_text(encoding="utf-8")
    for name, seconds in MEASURED.items():
        assert 30.0 < seconds < 3600.0
        assert f"{name} {minutes_of(name)}" in told
        assert re.search(rf"jaxgeo study {name}\b.* # {re.escape(minutes_of(name))}", lines), name
    assert MACHINE in told
    assert MACHINE in lines


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    text = io.StringIO()
    monkeypatch.setattr(_screen, "stderr", lambda: Console(file=text, force_terminal=True, width=100))
    return text


def busy(seconds: float) -> None:
    until = time.process_time() + seconds
    while time.process_time() < until:
        sum(range(1000))


@pytest.mark.costly
def test_a_bar_shows_the_processor_time_of_all_and_what_remains(
    terminal: io.StringIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does not reach the end before the study does, on a slower machine too."""
    monkeypatch.setitem(MEASURED, "li2023", 3.0)
    monkeypatch.setattr(_study_time, "TICK", 0.05)
    with study_progress("li2023", is_usual=True):
        busy(3.5)
    shown = terminal.getvalue()
    assert "takes about 0.05 minutes of processor time" in shown
    assert "1/3" in shown
    assert re.search(r"0:00:0[12]", shown), "the time that remains"
    assert "3/3" not in shown


def test_with_other_options_the_bar_has_no_end_and_nothing_is_promised(terminal: io.StringIO) -> None:
    with study_progress("li2023", is_usual=False):
        pass
    assert "takes about" not in terminal.getvalue()
    assert "?" in terminal.getvalue() or "0/" not in terminal.getvalue()

"""All studies together: each in its own process, which ends with its parent; a failure raises with its message."""

from __future__ import annotations

import importlib
import pathlib
import pickle
import subprocess
import sys

import pytest

from jaxgeo.cli import _studies_apart
from jaxgeo.studies import all_studies
from jaxgeo.studies.claims import claims_sheet
from jaxgeo.studies.li2023.equations import equations


def test_every_study_has_a_title_and_is_run() -> None:
    assert set(all_studies.RUNS) == set(_studies_apart.LONGEST_FIRST)
    titles = {importlib.import_module(f"jaxgeo.studies.{name}").Report.title for name in all_studies.RUNS}
    assert len(titles) == len(all_studies.RUNS)


@pytest.mark.costly
def test_claims_and_tables_pass_between_processes() -> None:
    claims = equations()
    study = all_studies.Study("li2023", "A title", claims, [claims_sheet(claims)], [pathlib.Path("a.png")])
    again = pickle.loads(pickle.dumps(study))
    assert again == study
    assert again.counts == study.counts


@pytest.mark.costly
def test_a_study_that_fails_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_studies_apart, "LONGEST_FIRST", ("nothing",))
    with pytest.raises(RuntimeError, match=r"(?s)study nothing ended with 1:.*No module named"):
        _studies_apart.found_apart(0, None)


@pytest.mark.costly
def test_a_study_ends_with_its_parent(tmp_path: pathlib.Path) -> None:
    """Its standard input is closed then."""
    words = [sys.executable, "-m", _studies_apart.MODULE, "gu2017", "0", str(tmp_path / "found.pickle")]
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=60)
    assert ended.returncode == 1
    assert not (tmp_path / "found.pickle").exists()

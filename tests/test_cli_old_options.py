"""Old names of options do what the new ones do, and say so."""

from __future__ import annotations

import pytest
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.cli._old_options import with_new_names

LINES = {
    "locate a.jpg --height-datum ellipsoid": ["locate", "a.jpg", "--camera-datum", "ellipsoid"],
    "locate a.jpg --height-datum=ellipsoid": ["locate", "a.jpg", "--camera-datum=ellipsoid"],
    "plan --vertical-datum 3 --height-datum 4": ["plan", "--dem-datum", "3", "--camera-datum", "4"],
    "point s.toml --height-datum 4": ["point", "s.toml", "--target-datum", "4"],
    "locate -- --height-datum": ["locate", "--", "--height-datum"],
    "locate --height-datums 3": ["locate", "--height-datums", "3"],
}


@pytest.mark.parametrize("line", LINES)
def test_old_names_become_new_ones(line: str) -> None:
    known = {"--camera-datum", "--dem-datum", "--target-datum"}
    words, said = with_new_names(line.split(), known)
    assert words == LINES[line]
    renamed = {one for one in line.split() if one not in words}
    assert len(said) == len(renamed)


def test_an_old_name_is_left_where_the_new_one_is_no_option() -> None:
    line = ["study", "li2020", "--height-datum", "ellipsoid"]
    assert with_new_names(line, {"--seed"}) == (line, [])
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 2
    assert result.stderr.startswith("jaxgeo: --height-datum: no such option")


def test_an_old_name_is_understood_and_told_once(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "DJI_0042.JPG")
    old = CliRunner().invoke(app, ["inspect", "DJI_0042.JPG", "--height-datum", "ellipsoid"])
    new = CliRunner().invoke(app, ["inspect", "DJI_0042.JPG", "--camera-datum", "ellipsoid"])
    assert old.exit_code == new.exit_code == 0
    assert old.stdout == new.stdout
    told = "jaxgeo: --height-datum is now --camera-datum; the old name is understood until version 0.4.\n"
    assert old.stderr == told + new.stderr
    quiet = CliRunner().invoke(app, ["inspect", "DJI_0042.JPG", "--height-datum", "ellipsoid", "-q"])
    assert quiet.stderr == ""

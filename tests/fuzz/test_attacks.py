"""Crafted files: each is refused in one line that names it, or read; in seconds, within 2 GB, and nothing else."""

from __future__ import annotations

import pathlib
import sys

import pytest

from jaxgeo.io.errors import RefusedFile
from tests.fuzz.attacks import ATTACKS, Attack
from tests.fuzz.reading import LONGEST_LINE, limits

pytestmark = [
    pytest.mark.costly,
    pytest.mark.skipif(sys.platform != "linux", reason="bounds memory and time as Linux does"),
]
MARK = pathlib.Path("/tmp/jaxgeo-was-here")


@pytest.mark.parametrize("attack", [pytest.param(one, id=one.name) for one in ATTACKS])
def test_a_crafted_file_is_refused_in_a_line_or_read(attack: Attack, tmp_path: pathlib.Path) -> None:
    path = attack.build(tmp_path)
    if attack.words is None:
        with limits():
            attack.check(attack.read(path))
        return
    with pytest.raises((RefusedFile, FileNotFoundError)) as error, limits():
        attack.read(path)
    message = str(error.value)
    assert attack.words in message
    assert "\n" not in message.strip()
    assert len(message) <= LONGEST_LINE
    assert message.isprintable(), message
    assert not MARK.exists()

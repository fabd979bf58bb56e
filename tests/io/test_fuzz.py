"""Every reader on damaged, cut and strange files: a refusal in one line or an answer; no traceback, no hang, no 2 GB.

A few mutants of each reader are read always, 2000 with `--slow`; `pytest -s --slow tests/io/test_fuzz.py` prints for
each reader how many were refused and how many gave an answer.
"""

from __future__ import annotations

import pathlib
import sys

import pytest

from tests.support.fuzzed_readers import READERS
from tests.support.fuzzing import Reader, read_mutants

FEW, MANY = 25, 2000

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bounds memory and time as Linux does")
rows = pytest.mark.parametrize("reader", [pytest.param(reader, id=reader.name) for reader in READERS])


def check(reader: Reader, folder: pathlib.Path, numbers: range) -> None:
    found = read_mutants(reader, folder, numbers)
    print(f"{reader.name}: {found}")
    wrong = "\n".join(f"mutants {which[:5]} ({len(which)}): {what}" for what, which in found.wrong.items())
    assert not found.wrong, f"{reader.name}: {found}\n{wrong}"
    assert found.refused + found.answered == len(numbers)
    assert found.refused > 0


@rows
def test_a_few_mutants_are_refused_in_a_line_or_read(reader: Reader, tmp_path: pathlib.Path) -> None:
    check(reader, tmp_path, range(FEW))


@pytest.mark.slow
@rows
def test_many_mutants_are_refused_in_a_line_or_read(reader: Reader, tmp_path: pathlib.Path) -> None:
    check(reader, tmp_path, range(FEW, FEW + MANY))

"""Files as practitioners have them: a row each, with the right answer."""

from __future__ import annotations

import pathlib

import pytest

from tests.support import field_images, field_tables, field_telemetry
from tests.support.field import FieldFile

ROWS = (*field_images.ROWS, *field_telemetry.ROWS, *field_tables.ROWS)


@pytest.fixture(scope="module")
def field_folder(jaxgeo_test_data: pathlib.Path) -> pathlib.Path:
    folder = jaxgeo_test_data / "field"
    if not folder.is_dir():
        pytest.skip(f"no such data: {folder} does not exist")
    return folder


@pytest.mark.parametrize(
    "row",
    [pytest.param(row, id=row.file, marks=pytest.mark.slow if row.slow else ()) for row in ROWS],
)
def test_field_file_gives_the_right_answer(field_folder: pathlib.Path, row: FieldFile):
    row.check(field_folder / row.file)


def test_every_field_file_has_a_row(field_folder: pathlib.Path):
    files = {path.relative_to(field_folder).as_posix() for path in field_folder.rglob("*") if path.is_file()}
    assert files - {"README.md"} == {row.file for row in ROWS}

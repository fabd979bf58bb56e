"""Every reader on damaged, cut and strange files: a refusal in one line or what the bytes state; no traceback, no hang.

A few mutants of each reader are read always. With `--slow` 20,000 over all readers: most of a fixed seed, the others of
one that is a checksum of the sources of `jaxgeo/` and `tests/fuzz/`: other mutants after every change of them, the same
in every run over the same sources, so that a failure repeats. It stands in the head and the closing lines of pytest's
output. `JAXGEO_FUZZ_SEED=8101` reads those of another seed, `JAXGEO_FUZZ_SEED=random` of one drawn for the run.
JAXGEO_FUZZ_MUTANTS is how many are read of each reader in place of 550: `JAXGEO_FUZZ_MUTANTS=5000 pytest --slow
tests/fuzz`.
"""

from __future__ import annotations

import ast
import os
import pathlib
import sys
from collections.abc import Callable
from typing import Any

import pytest
from support.fuzz_seed import VARIABLE, fuzz_seed, seed_of_sources

from tests.fuzz.readers import READERS
from tests.fuzz.reading import Reader, read_mutants

FEW, MANY = 12, int(os.environ.get("JAXGEO_FUZZ_MUTANTS", "550"))
FIXED_SEED, FRESH = 1, 0.4  # share of the many that are of a new seed

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="bounds memory and time as Linux does"),
    # rasterio decodes GDAL's messages as UTF-8, which those over a damaged file are not; no reader can hinder it
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
rows = pytest.mark.parametrize("reader", [pytest.param(reader, id=reader.name) for reader in READERS])
Record = Callable[[str, object], None]


def check(reader: Reader, folder: pathlib.Path, seed: int, numbers: range, record: Record) -> None:
    found = read_mutants(reader, folder, seed, numbers)
    print(f"{reader.name}: {found}")
    record("mutants", [found.refused, found.answered, sum(map(len, found.wrong.values())), found.slowest, found.grown])
    wrong = "\n".join(f"mutants {which[:5]} ({len(which)}): {what}" for what, which in found.wrong.items())
    assert not found.wrong, f"{reader.name}, {VARIABLE}={seed}: {found}\n{wrong}"
    assert found.refused + found.answered == len(numbers)
    assert found.refused > 0


@rows
def test_a_few_mutants_are_refused_in_a_line_or_read(
    reader: Reader, tmp_path: pathlib.Path, record_property: Record
) -> None:
    check(reader, tmp_path, FIXED_SEED, range(FEW), record_property)


@pytest.mark.slow
@rows
def test_many_mutants_are_refused_in_a_line_or_read(
    reader: Reader, tmp_path: pathlib.Path, record_property: Record
) -> None:
    fresh = round(FRESH * MANY)
    check(reader, tmp_path, FIXED_SEED, range(FEW, FEW + MANY - fresh), record_property)
    check(reader, tmp_path, int(os.environ[VARIABLE]), range(fresh), record_property)


def test_the_seed_of_a_run_is_that_of_the_sources(tmp_path: pathlib.Path) -> None:
    for name in ("jaxgeo/io/one.py", "jaxgeo/two.py", "tests/fuzz/three.py", "tests/four.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x = 1\n")
    first = seed_of_sources(tmp_path)
    assert first not in (0, FIXED_SEED)
    assert fuzz_seed(tmp_path, None) == fuzz_seed(tmp_path, "") == str(first)
    (tmp_path / "tests" / "four.py").write_bytes(b"x = 2\n")  # decides nothing here
    assert seed_of_sources(tmp_path) == first
    (tmp_path / "jaxgeo" / "io" / "one.py").write_bytes(b"x = 2\n")
    second = seed_of_sources(tmp_path)
    (tmp_path / "tests" / "fuzz" / "three.py").rename(tmp_path / "tests" / "fuzz" / "five.py")
    assert len({first, second, seed_of_sources(tmp_path)}) == 3
    assert fuzz_seed(tmp_path, "8101") == "8101"
    assert len({fuzz_seed(tmp_path, "random") for _ in range(20)}) > 10


TESTS = pathlib.Path(__file__).parents[1] / "io"


@pytest.mark.parametrize("tests", sorted({reader.tests for reader in READERS}))
def test_each_format_was_held_against_what_others_wrote_or_published(tests: str) -> None:
    """Said in the first words of the file of its tests: no format is tested against our own writer alone."""
    words = ast.get_docstring(ast.parse((TESTS / f"test_{tests}.py").read_text(encoding="utf-8"))) or ""
    _, _, against = " ".join(words.split()).partition("Held against: ")
    assert len(against.split()) > 4, words


def test_no_reader_catches_everything() -> None:
    """What a decoder raises is caught by its name: `except Exception` would tell a mistake of our own as damage."""
    for path in (pathlib.Path(__file__).parents[2] / "jaxgeo" / "io").rglob("*.py"):
        # A fault in one file does not stop the others: it is kept, and called a fault. pymavlink raises `Exception`.
        if path.name in ("several.py", "ardupilot.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else "everything"
                assert caught not in ("everything", "Exception", "BaseException"), f"{path}:{node.lineno}"


class Bug(ValueError):
    """A mistake of our own, within a reader."""


# Functions of our own within readers: an error in them is none of the file, and is never told as one.
INNER = {
    "DEM, GeoTIFF": ("jaxgeo.io.tiles._centred", "jaxgeo.io.heights._ellipsoidal"),
    "DEM, VRT": ("jaxgeo.io.vrt._rect",),
    "geoid grid, GTX": ("jaxgeo.io.geoid_grid._is_within",),
    "image": ("jaxgeo.io.images._known", "jaxgeo.io.images._colours"),
    "orthoimage": ("jaxgeo.io.orthoimages._raster_of_file",),
    "drone image, JPEG": (
        "jaxgeo.io.acquisitions._image_tags._plain",
        "jaxgeo.io.acquisitions._image_tags._check_kind",
        "jaxgeo.io.acquisitions._image_tags._leaves",
    ),
    "KLV": (
        "jaxgeo.io.acquisitions.telemetry.decode",
        "jaxgeo.io.acquisitions.telemetry._heights",
        "jaxgeo.io.acquisitions.telemetry.sensor_of",
    ),
    "transport stream": ("jaxgeo.io.acquisitions.transport_stream._chosen",),
    "SBET": ("jaxgeo.io.acquisitions.sbet.wrapped", "jaxgeo.io.acquisitions._wander._displacement"),
    "smrmsg": ("jaxgeo.io.acquisitions._smrmsg.clock_of",),
    "orientations": ("jaxgeo.io.orientations._poses", "jaxgeo.io.orientations.ellipsoidal_heights"),
    "orientations in a map": ("jaxgeo.io.orientations.poses_of_opk",),
    "reconstruction of OpenSfM": ("jaxgeo.io.opensfm._camera", "jaxgeo.io.opensfm.ellipsoidal_heights"),
    "cameras of Metashape": ("jaxgeo.io.acquisitions.metashape._camera",),
    "subtitles of DJI": ("jaxgeo.io.acquisitions._flight_logs.ellipsoidal_heights",),
    "positions of images": ("jaxgeo.io.acquisitions._position_tables.form_of_positions",),
    "exposures of Orthority": ("jaxgeo.io.acquisitions.orthority._poses_in_map",),
    "navigation": ("jaxgeo.io.navigation.poses_of",),
    "ground control": ("jaxgeo.io.gcp.ellipsoidal_heights",),
    "image points": ("jaxgeo.io.image_points.refuse_doubles",),
    "BAL": ("jaxgeo.io.bal._indices",),
}
CASES = [(name, place) for name, places in INNER.items() for place in places]


@pytest.mark.parametrize("name, place", CASES)
def test_an_error_of_our_own_is_never_told_as_one_of_the_file(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, name: str, place: str
) -> None:
    reader = next(reader for reader in READERS if reader.name == name)
    path = tmp_path / f"sound{reader.ending}"
    path.write_bytes(reader.seeds(tmp_path)[0])
    reader.read(path)  # what it keeps beside, made while all is well
    path.touch()
    called = []

    def fails(*_: Any, **__: Any) -> Any:
        called.append(place)
        raise Bug("a mistake of our own")

    monkeypatch.setattr(place, fails)
    with pytest.raises(Bug, match="a mistake of our own"):
        reader.read(path)
    assert called

"""`jaxgeo locate --cluster`: the fixes of the same command without it, in a folder that a second run completes."""

from __future__ import annotations

import contextlib
import csv
import json
import pathlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from support.drone_image_files import packet, write_image
from test_cli_folders import DJI, GROUND, cut, image, run

import jaxgeo.cluster.frames
from jaxgeo.cli._cluster import ClusterOptions

parquet: Any = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("flight")
    for name in ("a.jpg", "b.jpg", "d.jpg"):
        image(folder, name)
    cut(write_image(folder / "c.jpg", packet(DJI), make="DJI"))
    return folder


@pytest.fixture
def by_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """The workers are threads of this process."""

    @contextlib.contextmanager
    def connected(_: Any):
        with ThreadPoolExecutor(2) as threads:
            yield threads

    monkeypatch.setattr(ClusterOptions, "connected", connected)


def rows(folder: pathlib.Path) -> list[dict[str, Any]]:
    names = [path for path in sorted(folder.iterdir()) if not path.name.startswith("_")]
    return parquet.ParquetDataset(names).read().sort_by("index").to_pylist()


def test_the_dataset_has_the_rows_of_one_file(tmp_path: pathlib.Path, flight: pathlib.Path, by_threads) -> None:
    many = run("locate", flight, *GROUND, "--no-accuracy", "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert many.exit_code == 0, many.output
    assert run("locate", flight, *GROUND, "--no-accuracy", "-o", tmp_path / "fixes.csv").exit_code == 0
    with (tmp_path / "fixes.csv").open(newline="") as file:
        alone = list(csv.DictReader(file))
    found = rows(tmp_path / "fixes")
    assert [row["name"] for row in found] == [row["name"] for row in alone] == ["a.jpg", "b.jpg", "c.jpg", "d.jpg"]
    for one, other in zip(found, alone, strict=True):
        assert (one["status"], one["status_text"]) == (other["status"], other["status_text"])
        for name in ("fix_lat_deg", "fix_lon_deg", "fix_height_m", "slant_range_m"):
            assert one[name] == (pytest.approx(float(other[name]), abs=1e-9) if other[name] else None)


def test_resume_computes_what_is_missing(tmp_path: pathlib.Path, flight: pathlib.Path, by_threads) -> None:
    line = ("locate", flight, *GROUND, "--no-accuracy", "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert run(*line).exit_code == 0
    before = rows(tmp_path / "fixes")
    again = run(*line)
    assert again.exit_code == 2
    assert f"--output {tmp_path / 'fixes'}: not empty; give --resume" in " ".join(again.stderr.split())
    (tmp_path / "fixes" / "part-00000.parquet").unlink()
    resumed = run(*line, "--resume", "--json")
    assert resumed.exit_code == 0, resumed.stderr
    told = json.loads(resumed.stdout)
    assert (told["computed"], len(told["parts"]), told["statuses"]) == (1, 2, {"hit": 3, "file_not_read": 1})
    assert "1 of 2 parts were missing" in resumed.stderr
    assert rows(tmp_path / "fixes") == before
    other = run(*line, "--resume", "--pixel", "10,20")
    assert other.exit_code == 2
    assert "results with other" in other.stderr


def test_failed_parts_are_told_and_the_others_kept(tmp_path, flight: pathlib.Path, by_threads, monkeypatch) -> None:
    def fail(*_: Any) -> Any:
        raise OSError("the disk is gone")

    monkeypatch.setattr(jaxgeo.cluster.frames, "locate_observations", fail)
    done = run("locate", flight, *GROUND, "--no-accuracy", "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert done.exit_code == 2
    said = " ".join(done.stderr.split())
    assert "part-00000.parquet: OSError: the disk is gone." in said
    assert "1 of 2 parts failed; the others are whole. Run again with --resume for the missing ones." in said
    assert [row["status"] for row in rows(tmp_path / "fixes")] == ["file_not_read"]


@pytest.mark.parametrize(
    "more, words",
    [
        (["--cluster", "local:2"], "--cluster needs --output FOLDER"),
        (
            ["--cluster", "lokal", "-o", "fixes"],
            "--cluster lokal: this is not local, local:N (N workers), an address such as tcp://host:8786, or an",
        ),
        (["--cluster", "local:2", "-o", "fixes", "--format", "csv"], "--format does not go with --cluster"),
        (["--cluster", "local:2", "-o", "a.jpg"], "this is a file; name a folder"),
        (["--resume"], "--resume completes a folder of parts"),
    ],
)
def test_options_that_contradict_each_other(tmp_path, flight: pathlib.Path, monkeypatch, more, words: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"")
    done = run("locate", flight, *GROUND, *more)
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())


@pytest.mark.slow
def test_workers_of_dask(tmp_path: pathlib.Path, flight: pathlib.Path) -> None:
    done = run("locate", flight, *GROUND, "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert done.exit_code == 0, done.output
    assert "dashboard: http://" in done.stderr
    assert [row["status"] for row in rows(tmp_path / "fixes")] == ["hit", "hit", "file_not_read", "hit"]

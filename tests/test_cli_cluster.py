"""`jaxgeo locate --cluster`: the fixes of the same command without it, in a folder that a second run completes."""

from __future__ import annotations

import contextlib
import csv
import json
import pathlib
import shutil
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import rasterio
from support.command_files import FILES
from support.drone_image_files import packet, write_image
from test_cli_folders import DJI, GROUND, READ, cut, image, run

import jaxgeo.cluster.frames
from jaxgeo.cli._cluster import ClusterOptions
from jaxgeo.cluster import Run

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


@pytest.mark.oldest
@pytest.mark.costly
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


@pytest.mark.costly
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


ORTHOS = (*READ, "--dem", "dem.tif", "--dem-datum", "ellipsoid", "--resolution", "2", "--no-hidden-mask")


@pytest.fixture
def survey(tmp_path: pathlib.Path, flight: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """The flight over a small level elevation model, in the current folder."""
    monkeypatch.chdir(tmp_path)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:4326", "width": 40, "height": 40}
    transform = rasterio.transform.from_bounds(-84.13, 36.29, -84.08, 36.34, 40, 40)
    with rasterio.open("dem.tif", "w", transform=transform, **profile) as file:
        file.write(np.full((1, 40, 40), 300.0, np.float32))
    return flight


@pytest.mark.slow
def test_orthophotos_of_a_folder(survey: pathlib.Path, by_threads) -> None:
    """A GeoTIFF for each image, the same on a cluster; a damaged one stops no other; --resume adds what is gone."""
    many = run("rectify", survey, *ORTHOS, "--cluster", "local:2", "-o", "many", "--json")
    assert many.exit_code == 0, many.output
    told = json.loads(many.stdout)
    assert (told["computed"], told["images_by_status"]) == (4, {"hit": 3, "file_not_read": 1})
    alone = run("rectify", survey, *ORTHOS, "-o", "alone")
    assert alone.exit_code == 0, alone.output
    assert "alone: 3 orthophotos of 4 images" in alone.stdout
    assert "not read: " in alone.stderr
    assert "mosaic.vrt" in alone.stdout
    files = sorted(path.name for path in pathlib.Path("alone").glob("*.tif"))
    assert files == ["a.tif", "b.tif", "d.tif"]
    for name in files:
        assert pathlib.Path("many", name).read_bytes() == pathlib.Path("alone", name).read_bytes()
    pathlib.Path("many", files[1]).unlink()
    resumed = run("rectify", survey, *ORTHOS, "--cluster", "local:2", "-o", "many", "--resume", "--json")
    assert (json.loads(resumed.stdout)["computed"], resumed.exit_code) == (1, 0)
    one = run("rectify", survey / "b.jpg", *ORTHOS, "-o", "one.tif", "--crs", "EPSG:32616", "--cog")
    assert one.exit_code == 0, one.output
    with rasterio.open("one.tif") as single, rasterio.open(f"many/{files[1]}") as part:
        assert single.transform == part.transform
        assert np.array_equal(single.read(), part.read())


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Arguments of `rectify_frames`, which makes no orthophoto here."""
    each: list[Any] = []

    def made(folder: pathlib.Path, files: Any, observed: Any, terrain: Any, **how: Any) -> Run:
        each.append((files, observed, how))
        return Run(folder, (), 0, {})

    monkeypatch.setattr(jaxgeo.cluster, "rectify_frames", made)
    return each


def test_images_of_a_folder_and_how_they_are_rectified(survey: pathlib.Path, asked: list[Any], by_threads) -> None:
    more = ("--crs", "EPSG:32616", "--band", "2", "--status", "--interpolation", "nearest", "--cluster", "local:2")
    done = run("rectify", survey, *ORTHOS, *more, "-o", "many")
    assert done.exit_code == 1  # no orthophoto
    ((files, observed, how),) = asked
    assert files == [survey / name for name in ("a.jpg", "b.jpg", "c.jpg", "d.jpg")]
    assert [row["name"] for row in observed.columns] == [path.name for path in files]
    assert isinstance(how.pop("client"), ThreadPoolExecutor)
    kind = type(how.pop("interpolation")).__name__
    assert kind == "Nearest"
    expected = {"crs": "EPSG:32616", "resolution": 2.0, "bands": [2], "status": True, "mask_hidden": False}
    assert how == expected | {"progress": False}


def test_images_of_a_file_of_poses(survey: pathlib.Path, asked: list[Any]) -> None:
    """They are found by the names in the file, with or without their ending."""
    poses = {name: {"rotation": [3.1, 0.0, 0.0], "translation": [0.0, 0.0, 400.0], "camera": "one"} for name in "ab"}
    camera = {"one": {"projection_type": "perspective", "width": 40, "height": 30, "focal": 0.9}}
    reference = {"latitude": 36.318, "longitude": -84.105, "altitude": 300.0}
    content = [{"cameras": camera, "shots": poses | {"c.jpg": poses["a"]}, "points": {}, "reference_lla": reference}]
    pathlib.Path("reconstruction.json").write_text(json.dumps(content))
    run("rectify", "reconstruction.json", "--images", survey, *ORTHOS, "-o", "orthos")
    ((files, _, how),) = asked
    assert files == [survey / name for name in ("a.jpg", "b.jpg", "c.jpg")]
    assert how["client"] is None
    shutil.copytree(survey, "others")
    pathlib.Path("others/c.jpg").rename("others/c.tif")  # another ending than in the file
    pathlib.Path("others/a.DNG").write_bytes(b"raw")  # no image that may be meant
    run("rectify", "reconstruction.json", "--images", "others", *ORTHOS, "-o", "orthos")
    assert [path.name for path in asked[-1][0]] == ["a.jpg", "b.jpg", "c.tif"]
    shutil.copy("others/a.jpg", "others/a.png")
    either = run("rectify", "reconstruction.json", "--images", "others", *ORTHOS, "-o", "orthos")
    assert either.exit_code == 2
    assert "--images others: a may be a.jpg, a.png; leave one of them in the folder." in " ".join(either.stderr.split())
    without = run("rectify", "reconstruction.json", *ORTHOS, "-o", "other.tif")
    assert without.exit_code == 2
    assert "exposure a is not among the given images; give the folder of the images with --images FOLDER." in (
        " ".join(without.stderr.split())
    )


@pytest.mark.costly
def test_an_image_without_an_orthophoto_is_told_with_its_reason(survey: pathlib.Path) -> None:
    """Here none has one: two see no ground, and one is damaged."""
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:4326", "width": 4, "height": 4}
    with rasterio.open("far.tif", "w", transform=rasterio.transform.from_bounds(0, 0, 1, 1, 4, 4), **profile) as file:
        file.write(np.zeros((1, 4, 4), np.float32))
    far = ("--dem", "far.tif", "--dem-datum", "ellipsoid", *READ)
    without = run("rectify", survey, *far, "--resolution", "2", "-o", "orthos")
    assert without.exit_code == 2
    assert "no frame sees any ground, which would determine --crs; state it" in " ".join(without.stderr.split())
    done = run("rectify", survey, *far, "--resolution", "2", "--crs", "EPSG:32616", "-o", "orthos")
    assert done.exit_code == 1
    said = " ".join(done.stderr.split())
    assert f"{survey / 'a.jpg'}: " in said
    assert "no line of sight of the image comes down on the terrain: the elevation model reaches from" in said
    assert "orthos: 0 orthophotos of 4 images (.tif, by the names of the images), collection.json" in done.stdout


@pytest.mark.costly
@pytest.mark.parametrize(
    "more, words",
    [
        (["a.jpg", "b.jpg", "--scene", "scene.toml"], "--scene scene.toml has the pose of one image; got a.jpg and 1"),
        (["a.jpg", "--scene", "scene.toml", "--camera-datum", "ellipsoid"], "--camera-datum is for images that state"),
        (["a.jpg", "--scene", "scene.toml", "--images", "."], "--images . is for a file with the poses of many"),
        (["a.jpg", "--scene", "scene.toml", "--cluster", "local:2"], "--cluster is for several images; --scene scene"),
        (["a.jpg", "--images", "nowhere"], "--images nowhere: there is no such folder"),
        (["a.jpg", "b.jpg", "--like", "a.tif"], "--like is for one image; of several, each has its own."),
        (["a.jpg", "b.jpg", "--crs", "EPSG:32616", "--bounds", "1,2,3,4"], "--bounds is for one image"),
        (["a.jpg", "--resume"], "--resume completes a folder of parts"),
        (["a.jpg", "b.jpg", "--band", "7", *READ], "--band 7: a.jpg has bands 1 to 3."),
        (["a.jpg", "--images", ".", *READ], "--images . is for a file of poses; a.jpg is of images"),
        (
            ["mission.sbet", "--images", ".", *READ],
            "mission.sbet (SBET) does not refer to image files. Give drone images",
        ),
        (["flight.klv", *READ], "flight.klv (MISB ST 0601 telemetry) does not refer to image files."),
        (["opk.csv", "--images", ".", *READ, "--source-crs", "EPSG:32616"], "no camera; give --camera focal=8.8mm"),
        (["a.jpg", "b.jpg", *READ, "--resolution", "0"], "--resolution must be positive"),
        (["a.jpg", "b.jpg", *READ, "-o", "all.tif"], "--output all.tif: the result has several files; name a folder"),
        (["a.jpg", "b.jpg", "--dem-bounds", "1,2,3,4", *READ], "--dem-bounds: of many images only the ground in sight"),
    ],
)
def test_options_of_orthophotos_that_contradict_each_other(survey: pathlib.Path, more, words: str) -> None:
    for name in ("a.jpg", "b.jpg"):
        shutil.copy(survey / name, name)
    for name in ("mission.sbet", "flight.klv", "opk.csv"):
        FILES[name](pathlib.Path(name))
    done = run("rectify", "--dem", "dem.tif", "--dem-datum", "ellipsoid", "-o", "orthos", *more)
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())
    assert not pathlib.Path("orthos").exists()


@pytest.mark.slow
def test_a_map_in_tiles_is_that_of_one_file(survey: pathlib.Path, by_threads, monkeypatch) -> None:
    line = ("accuracy-map", survey / "a.jpg", *READ, "--dem", "dem.tif", "--dem-datum", "ellipsoid")
    line = (*line, "--resolution", "25", "--samples", "0", "--crs", "EPSG:32616")
    one = run(*line, "-o", "one.tif", "--json")
    assert one.exit_code == 0, one.output
    many = run(*line, "--cluster", "local:2", "-o", "many", "--json")
    assert many.exit_code == 0, many.output
    told = json.loads(many.stdout)
    assert told["cells_by_status"] == json.loads(one.stdout)["cells_by_status"]
    assert told["cells_by_status"]["hit"] > 20
    assert told["cells_with_accuracy"] == json.loads(one.stdout)["cells_with_accuracy"]
    assert told["inputs"]["dem"] == ["dem.tif"]
    with rasterio.open("one.tif") as single, rasterio.open("many/mosaic.vrt") as mosaic:
        np.testing.assert_allclose(mosaic.read(1), single.read(1), rtol=1e-5)
        assert told["cells_with_accuracy"] == np.isfinite(single.read([1, 2])).all(axis=0).sum()


def test_a_map_is_of_one_exposure(survey: pathlib.Path) -> None:
    several = run("accuracy-map", survey, *GROUND, "-o", "all.tif")
    assert several.exit_code == 2
    assert "a map is of one exposure; got 4 (a.jpg, b.jpg, c.jpg, d.jpg). Choose one with --exposure NAME." in (
        " ".join(several.stderr.split())
    )


@pytest.mark.slow
def test_a_report_from_a_cluster_has_the_fixes_of_one_process(survey: pathlib.Path, by_threads) -> None:
    line = ("report", survey, *GROUND, "--details", "0", "--json")
    many = run(*line, "--cluster", "local:2", "-o", "many.html")
    assert many.exit_code == 0, many.output
    alone = run(*line, "-o", "alone.html")
    found, expected = (json.loads(done.stdout)["fixes"] for done in (many, alone))
    assert [row["status"] for row in found] == [row["status"] for row in expected]
    for one, other in zip(found, expected, strict=True):
        for name in ("fix_lat_deg", "fix_height_m", "ce90_m"):
            assert one[name] == (other[name] if other[name] is None else pytest.approx(other[name], abs=1e-9))
    assert "many.html" in {path.name for path in pathlib.Path().iterdir()}


@pytest.mark.slow
def test_workers_of_dask(tmp_path: pathlib.Path, flight: pathlib.Path) -> None:
    done = run("locate", flight, *GROUND, "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert done.exit_code == 0, done.output
    assert "dashboard: http://" in done.stderr
    assert [row["status"] for row in rows(tmp_path / "fixes")] == ["hit", "hit", "file_not_read", "hit"]


@pytest.mark.costly
@pytest.mark.parametrize("ground", ["--ground", "--dem"])
def test_the_shares_of_assumed_sigmas_are_those_of_one_machine(
    tmp_path: pathlib.Path, flight: pathlib.Path, by_threads, ground: str
) -> None:
    """Of the same fix, the one with the median CE90, located over its part of the elevation model."""
    FILES["dem.tif"](tmp_path / "dem.tif")
    given = GROUND if ground == "--ground" else ["--camera-datum", "ellipsoid", "--dem", tmp_path / "dem.tif"]
    line = ("locate", flight, *given, "--json")
    many = run(*line, "--cluster", "local:2", "-o", tmp_path / "fixes")
    assert many.exit_code == 0, many.output
    alone = run(*line)
    found, wanted = (json.loads(one.stdout)["assumed_variance_shares"] for one in (many, alone))
    assert list(found) == list(wanted)
    assert sum(wanted.values()) > 0.5
    for name, share in wanted.items():
        assert found[name] == pytest.approx(share, abs=2e-3)
    said = [one for one in many.stderr.splitlines() if "comes mostly from assumed standard deviations" in one]
    assert len(said) == 1
    assert said == [one for one in alone.stderr.splitlines() if "comes mostly from assumed" in one]
    stated = run(*line, "--no-accuracy", "--cluster", "local:2", "-o", tmp_path / "none")
    assert json.loads(stated.stdout)["assumed_variance_shares"] == {}

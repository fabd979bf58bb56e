"""Fixes of many frames in parts: the same as at once, by whichever workers, and after whatever interruption."""

from __future__ import annotations

import dataclasses
import functools
import json
import pathlib
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pyproj
import pytest
from support.survey import ridge_at, survey, write_tiles

import jaxgeo
import jaxgeo.cluster.frames
import jaxgeo.cluster.parts
from jaxgeo.cluster import PartsFailed, connect, locate_frames, statuses_of
from jaxgeo.cluster.parts import MANIFEST
from jaxgeo.io import ImageError, Observations, open_dem, read_dem
from jaxgeo.io.acquisitions.several import Unread
from jaxgeo.io.located_over_files import AccuracyOptions, locate_over_files, rays_of
from jaxgeo.status import Status

parquet: Any = pytest.importorskip("pyarrow.parquet")

SIDE = 60 * 30.0  # m, of a tile
GROUND = jaxgeo.ConstantHeight(600.0)


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> list[pathlib.Path]:
    return write_tiles(tmp_path_factory.mktemp("tiles"), down=2, across=3, posts=60)


@pytest.fixture(scope="module")
def frames() -> Observations:
    """Some of them look beyond the tiles."""
    return survey(60, (2 * SIDE, 3 * SIDE))


@pytest.fixture(scope="module")
def with_unread(frames: Observations) -> Observations:
    """The same, before the last two of which there are files that could not be read."""
    (batch,) = frames.batches
    rows = np.where(batch.rows < 58, batch.rows, batch.rows + 2)
    columns = [*frames.columns[:58], *({"name": name, "u": None, "v": None} for name in "ab"), *frames.columns[58:]]
    unread = {
        58: Unread("a.jpg", ImageError("a.jpg: no image"), 58),
        59: Unread("b.jpg", ImageError("b.jpg: empty"), 59),
    }
    return dataclasses.replace(frames, batches=(dataclasses.replace(batch, rows=rows),), columns=columns, unread=unread)


def content(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def table(folder: pathlib.Path, names: Sequence[str]) -> dict[str, list[Any]]:
    """Columns of a dataset in the order of its rows."""
    found = parquet.ParquetDataset([folder / name for name in names]).read().sort_by("index")
    return {name: found[name].to_pylist() for name in found.column_names}


@jax.jit
def heights_of(dem: jaxgeo.Dem, places: jaxgeo.Geodetic) -> jax.Array:
    return jax.vmap(dem.height_at)(places)


def above_ground(tiles: list[pathlib.Path], points: np.ndarray) -> np.ndarray:
    """Heights in m of points (..., 3) in ECEF above the whole mosaic, read at once; NaN beside it."""
    dem = read_dem(tiles, vertical_datum="ellipsoid")
    x, y, z = points.reshape(-1, 3).T
    lon, lat, height = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(x, y, z)
    ground = heights_of(dem, jaxgeo.Geodetic(lat=np.radians(lat), lon=np.radians(lon), height=height))
    return (height - np.asarray(ground)).reshape(points.shape[:-1])


@pytest.mark.costly
def test_parts_hold_the_first_hits_of_the_whole_mosaic(tmp_path: pathlib.Path, frames: Observations, tiles) -> None:
    """Points lie on the line of sight and on the ground, with no ground before them; where there is none, the line of
    sight comes down beside the mosaic."""
    run = locate_frames(tmp_path / "fixes", frames, open_dem(tiles, vertical_datum="ellipsoid"), rows=25)
    found = table(run.folder, run.parts)
    assert found["index"] == list(range(60))
    assert found["name"] == [f"frame {k}" for k in range(60)]
    assert len(run.parts) == 3
    assert run.computed == 3
    assert run.counts == statuses_of(run)
    assert {"hit", "leaves_terrain"} <= set(found["status"]) <= {"hit", "leaves_terrain", "ray_misses_terrain"}
    hits = np.array([one == "hit" for one in found["status"]])
    lat, lon, height = (np.array(found[f"fix_{name}"], float)[hits] for name in ("lat_deg", "lon_deg", "height_m"))
    places = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(lat, lon, height)
    ray, _ = rays_of(frames.batches[0])
    reach = np.full(60, 9000.0)  # m
    away = np.stack(places, axis=1) - ray.origin[hits]
    reach[hits] = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(away, reach[hits, None] * ray.direction[hits], rtol=0.0, atol=1e-4)  # m
    steps = np.linspace(0.0, 1.0, 250)[:, None, None]
    above = above_ground(tiles, ray.origin + steps * reach[:, None] * ray.direction)
    np.testing.assert_allclose(above[-1, hits], 0.0, rtol=0.0, atol=1e-4)  # m
    assert not np.any(above[:-1] <= 0.0)
    assert np.all(np.isnan(above[-1, ~hits]))


@pytest.mark.costly
def test_frames_of_a_part_are_near_each_other(tmp_path: pathlib.Path, frames: Observations, tiles) -> None:
    run = locate_frames(tmp_path / "fixes", frames, open_dem(tiles, vertical_datum="ellipsoid"), rows=10)
    spread = []
    for name in run.parts:
        own = table(run.folder, [name])
        known = [k for k, lat in enumerate(own["fix_lat_deg"]) if lat is not None]
        spread += [np.ptp([own[axis][k] for k in known]) for axis in ("fix_lat_deg", "fix_lon_deg")]
    every = table(run.folder, run.parts)
    whole = np.ptp([lat for lat in every["fix_lat_deg"] if lat is not None])
    assert np.mean(spread) < 0.7 * whole


@pytest.mark.costly
def test_what_was_read_before_changes_no_bit(tmp_path: pathlib.Path, frames: Observations, tiles) -> None:
    files = open_dem(tiles, vertical_datum="ellipsoid")
    locate_frames(tmp_path / "fresh", frames, files, rows=25)
    assert files.highest > files.lowest  # reads all heights
    locate_frames(tmp_path / "used", frames, files, rows=25)
    assert content(tmp_path / "fresh") == content(tmp_path / "used")


@pytest.mark.costly
def test_the_executor_changes_no_bit(tmp_path: pathlib.Path, with_unread: Observations) -> None:
    locate_frames(tmp_path / "own", with_unread, GROUND, rows=20)
    with ThreadPoolExecutor(2) as threads:
        locate_frames(tmp_path / "threads", with_unread, GROUND, client=threads, rows=20)
    assert content(tmp_path / "own") == content(tmp_path / "threads")


@pytest.mark.costly
def test_a_file_that_could_not_be_read_is_a_row_with_its_reason(tmp_path, with_unread: Observations) -> None:
    run = locate_frames(tmp_path / "fixes", with_unread, GROUND)
    found = table(run.folder, run.parts)
    assert found["name"] == [row["name"] for row in with_unread.columns]
    assert found["status"] == [*["hit"] * 58, *["file_not_read"] * 2, *["hit"] * 2]
    assert found["status_text"][58:60] == ["a.jpg: no image", "b.jpg: empty"]


@pytest.mark.costly
def test_parts_have_one_schema_and_a_summary(tmp_path: pathlib.Path, with_unread: Observations) -> None:
    """That of unread files has no values, which says nothing of their type."""
    run = locate_frames(tmp_path / "fixes", with_unread, GROUND, rows=30)
    schemas = [parquet.read_schema(run.folder / name) for name in run.parts]
    assert all(one.equals(schemas[0], check_metadata=True) for one in schemas)
    summary = parquet.read_metadata(run.folder / "_metadata")
    assert summary.num_rows == 62
    paths = {summary.row_group(k).column(0).file_path for k in range(summary.num_row_groups)}
    assert paths == set(run.parts)
    geopandas = pytest.importorskip("geopandas")
    assert len(geopandas.read_parquet(run.folder)) == 62  # of the files without an underscore


@pytest.mark.costly
def test_level_ground_of_its_own_for_each_frame(tmp_path: pathlib.Path, frames: Observations) -> None:
    heights = np.linspace(500.0, 700.0, 60)
    run = locate_frames(tmp_path / "fixes", frames, [jaxgeo.ConstantHeight(heights)], rows=11)
    np.testing.assert_allclose(table(run.folder, run.parts)["fix_height_m"], heights, rtol=0.0, atol=1e-3)


def test_only_what_is_missing_is_computed(tmp_path: pathlib.Path, frames: Observations) -> None:
    run = locate_frames(tmp_path / "fixes", frames, GROUND, rows=20)
    before = content(run.folder)
    (run.folder / run.parts[1]).unlink()
    again = locate_frames(tmp_path / "fixes", frames, GROUND, rows=20)
    assert (run.computed, again.computed, sum(again.counts.values())) == (3, 1, 20)
    assert content(run.folder) == before


@pytest.mark.parametrize(
    "change, named",
    [
        ({"terrain": jaxgeo.ConstantHeight(601.0)}, "terrain"),
        ({"rows": 21}, "rows of a part"),
        ({"crs": "EPSG:32632"}, "output"),
        ({"observed": survey(60, (2 * SIDE, 3 * SIDE), seed=1)}, "frames"),
    ],
)
def test_another_run_does_not_go_to_the_same_folder(tmp_path, frames: Observations, change, named: str) -> None:
    given = {"observed": frames, "terrain": GROUND, "rows": 20}
    locate_frames(tmp_path, **given)  # pyright: ignore
    before = content(tmp_path)
    with pytest.raises(ValueError, match=f"with other {named}"):
        locate_frames(tmp_path, **(given | change))
    assert content(tmp_path) == before


@pytest.mark.parametrize("name, text", [("notes.txt", "mine"), (MANIFEST, "{"), (MANIFEST, '{"kind": "maps"}')])
def test_a_folder_of_something_else_is_left_alone(tmp_path, frames: Observations, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match="another"):
        locate_frames(tmp_path, frames, GROUND)
    assert [path.read_text() for path in tmp_path.iterdir()] == [text]


@pytest.mark.parametrize("damage", [b"", b"PAR1 and then nothing"])
def test_a_damaged_part_is_computed_again(tmp_path: pathlib.Path, frames: Observations, damage: bytes) -> None:
    run = locate_frames(tmp_path / "fixes", frames, GROUND, rows=20)
    before = content(run.folder)
    (run.folder / run.parts[1]).write_bytes(damage)
    assert locate_frames(tmp_path / "fixes", frames, GROUND, rows=20).computed == 1
    assert content(run.folder) == before


@pytest.mark.costly
def test_a_frame_that_is_refused_is_a_row_with_its_reason(tmp_path, frames: Observations, monkeypatch) -> None:
    """One beyond the pole, and one that the computation refuses; the others of their part are as without them."""
    (batch,) = frames.batches
    lat = np.array(batch.shots.pose.position.lat)
    lat[3] = 4.0
    observation = eqx.tree_at(lambda one: one.exposure.motion.pose.position.lat, batch.observation, lat)
    wrong = dataclasses.replace(batch, observation=observation)
    usual = jaxgeo.cluster.frames.locate_observations

    def refuse(observed: Observations, *args: Any) -> Any:
        if any(row["name"] == "frame 7" for row in observed.columns):
            raise ValueError("frame 7 is refused")
        return usual(observed, *args)

    monkeypatch.setattr(jaxgeo.cluster.frames, "locate_observations", refuse)
    run = locate_frames(tmp_path / "fixes", dataclasses.replace(frames, batches=(wrong,)), GROUND)
    found = table(run.folder, run.parts)
    assert found["status"] == ["invalid_input" if k in (3, 7) else "hit" for k in range(60)]
    assert found["status_text"][7] == "frame 7 is refused"
    assert found["fix_lat_deg"][3] is None


def test_a_folder_that_only_a_killed_process_was_in_is_used(tmp_path: pathlib.Path, frames: Observations) -> None:
    (tmp_path / ".jaxgeo-0badcafe-1-00000000.partial").write_text("{")
    assert locate_frames(tmp_path, frames, GROUND).computed == 1


@pytest.mark.costly
def test_of_two_runs_at_once_one_is_refused(tmp_path: pathlib.Path, frames: Observations, monkeypatch) -> None:
    """The other made its list after this one had looked for it."""
    begin = jaxgeo.cluster.parts.Parts._begin

    def later(self: Any, path: pathlib.Path) -> None:
        monkeypatch.setattr(jaxgeo.cluster.parts.Parts, "_begin", begin)
        locate_frames(tmp_path / "fixes", frames, jaxgeo.ConstantHeight(601.0))
        begin(self, path)

    monkeypatch.setattr(jaxgeo.cluster.parts.Parts, "_begin", later)
    with pytest.raises(ValueError, match="with other terrain"):
        locate_frames(tmp_path / "fixes", frames, GROUND)


def test_attributes_may_be_numbers_of_numpy(tmp_path: pathlib.Path, frames: Observations) -> None:
    kinds = {"whole": np.int64, "number": np.float32, "flag": np.bool_}
    columns = [{name: kind(k % 2) for name, kind in kinds.items()} for k in range(60)]
    run = locate_frames(tmp_path / "fixes", dataclasses.replace(frames, columns=columns), GROUND)
    found = table(run.folder, run.parts)
    assert [found[name][:2] for name in kinds] == [[0, 1], [0.0, 1.0], [False, True]]


def test_what_does_not_change_the_results_does_not_count(tmp_path: pathlib.Path, frames: Observations) -> None:
    """Errors and their margin, without accuracy."""
    locate_frames(tmp_path, frames, GROUND)
    (batch,) = frames.batches
    other = dataclasses.replace(frames, batches=(dataclasses.replace(batch, sources=()),))
    assert locate_frames(tmp_path, other, GROUND, margin=5.0).computed == 0


def test_heights_of_another_number_of_frames_are_refused(tmp_path: pathlib.Path, frames: Observations) -> None:
    with pytest.raises(ValueError, match="60 frames, and its ground 4 heights"):
        locate_frames(tmp_path, frames, [jaxgeo.ConstantHeight(np.full(4, 600.0))])


@pytest.mark.costly
def test_a_missing_tile_stops_only_its_parts(tmp_path: pathlib.Path, frames: Observations) -> None:
    tiles = write_tiles(tmp_path, down=1, across=3, posts=300)
    frames = survey(40, (9000.0, 27000.0), seed=3)
    known = functools.partial(open_dem, tiles, vertical_datum="ellipsoid", height_range=(200.0, 1000.0))
    files = known()
    away = shutil.move(tiles[0], tmp_path / "away.tif")
    with pytest.raises(PartsFailed, match=r"of 8 parts failed.*tile_0_0\.tif") as told:
        locate_frames(tmp_path / "fixes", frames, files, rows=5)
    failed = set(told.value.failed)
    assert 0 < len(failed) < 8
    listed = json.loads((tmp_path / "fixes" / MANIFEST).read_text())["parts"]
    assert (
        {one["file"] for one in listed if not one["whole"]}
        == failed
        == {one["file"] for one in listed if "failed" in one}
    )
    shutil.move(away, tiles[0])
    again = locate_frames(tmp_path / "fixes", frames, known(), rows=5)
    assert again.computed == len(failed)
    locate_frames(tmp_path / "whole", frames, files, rows=5)
    assert content(tmp_path / "fixes") == content(tmp_path / "whole")


@pytest.mark.costly
def test_ground_that_is_too_large_is_a_row_with_its_reason(frames: Observations, tiles) -> None:
    some = frames.part(0, np.arange(20))
    files = open_dem(tiles, vertical_datum="ellipsoid")
    usual = locate_over_files(some, files)
    widths = locate_over_files(some, files, max_posts=60)
    too_large = np.array([one is not None for one in widths.reasons])
    assert 0 < too_large.sum() < 20
    assert "max_posts=60" in next(filter(None, widths.reasons))
    assert (widths.fixes.status[too_large] == Status.leaves_terrain).all()
    assert np.array_equal(widths.fixes.status[~too_large], usual.fixes.status[~too_large])


@pytest.mark.slow
def test_higher_ground_beside_the_rays_changes_nothing(tmp_path: pathlib.Path) -> None:
    """With its margin the window may hold the ridge, whose height oblique rays pass outside of the window."""
    tiles = write_tiles(tmp_path, down=1, across=1, posts=400, height_at=ridge_at)
    some = survey(80, (12000.0, 8000.0), off_nadir=68.0)
    files = open_dem(tiles, vertical_datum="ellipsoid")
    some = some.part(0, np.arange(10, 30))
    dem, alone = read_dem(tiles, vertical_datum="ellipsoid"), [some.part(0, np.array([k])) for k in range(20)]
    each = [int(locate_over_files(one, files, margin=1500.0).fixes.status[0]) for one in alone]
    whole = [int(jaxgeo.io.locate_observations(one, dem).status[0]) for one in alone]
    assert each == whole
    assert whole.count(Status.hit) > 5


def test_bent_rays_are_refused_over_a_dem_on_disk(tmp_path: pathlib.Path, frames: Observations, tiles) -> None:
    bent = frames.with_atmosphere(jaxgeo.Atmosphere())
    with pytest.raises(ValueError, match="atmosphere"):
        locate_frames(tmp_path, bent, open_dem(tiles, vertical_datum="ellipsoid"))


@pytest.mark.parametrize(
    "given",
    [{"rows": 0}, {"margin": -1.0}, {"margin": float("nan")}, {"count": 0}, {"probability": 2.0, "accuracy": True}],
)
def test_wrong_numbers_are_refused(tmp_path: pathlib.Path, frames: Observations, given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(given))} must"):
        locate_frames(tmp_path / "fixes", frames, GROUND, **given)
    assert not (tmp_path / "fixes").exists()


@pytest.mark.parametrize(
    "name, error, words",
    [("lokal", FileNotFoundError, "local:N"), ("tcp://127.0.0.1:9", ConnectionError, "dask scheduler")],
)
def test_a_cluster_that_is_not_there(name: str, error: type[Exception], words: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(error, match=f'cluster "{name}".*{words}'), connect(name, timeout=0.5):
        raise AssertionError("connected")


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.5, 40.0])
def test_accuracy_is_that_over_the_whole_mosaic(frames: Observations, tiles, sigma: float) -> None:
    """With little and with much error: then windows grow."""
    some = survey(20, (2 * SIDE, 3 * SIDE), sigma=sigma)
    files, dem = open_dem(tiles, vertical_datum="ellipsoid"), read_dem(tiles, vertical_datum="ellipsoid")
    found = locate_over_files(some, files, AccuracyOptions(0.9, 500), margin=20.0)
    fixes = jaxgeo.io.locate_observations(some, dem)
    whole = jaxgeo.io.accuracy_of_observations(some, dem, fixes, count=500)
    assert found.accuracy is not None
    assert whole is not None
    assert np.array_equal(found.accuracy.method, whole.method)
    assert len({*np.asarray(whole.method).tolist()} - {-1}) > 0
    for name in ("circular", "linear", "spherical", "failed"):
        np.testing.assert_allclose(getattr(found.accuracy, name), getattr(whole, name), rtol=1e-6, err_msg=name)

"""Orthophotos of many frames, and accuracy maps in tiles: the same as one by one, whoever computes them."""

from __future__ import annotations

import dataclasses
import json
import pathlib
import shutil
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.warp
from rasterio.transform import from_origin
from support.survey import CRS, EAST, NORTH, STEP, survey, write_tiles

from jaxgeo import Exposure, FrameCamera, Gimbal, Mount, Observation, Sampling, Sensor
from jaxgeo.cluster import PartsFailed, Run, accuracy_map, connect, rectify_frames
from jaxgeo.cluster.accuracy_tiles import tiles_of
from jaxgeo.cluster.orthophotos import part_names
from jaxgeo.io import DemFiles, Observations, open_dem, read_dem, rectify_file, write_accuracy_map
from jaxgeo.io.ground_of_image import image_raster
from jaxgeo.io.map_raster import MapRaster
from jaxgeo.io.vrt_writer import Bands, MosaicFile, write_vrt
from jaxgeo.terrain import ConstantHeight, Dem

pytestmark = pytest.mark.costly

pystac: Any = pytest.importorskip("pystac")

WIDTH, HEIGHT = 64, 48
MISSING, SKYWARD = 2, 3  # rows whose image is missing, and which sees no ground


def frames(count: int, down: int, across: int, off_nadir_deg: np.ndarray | float = 30.0) -> Observations:
    """`count` frames of a small camera over `down` x `across` posts."""
    observed = survey(count, (down * STEP, across * STEP))
    (batch,) = observed.batches
    pitch = np.radians(np.broadcast_to(off_nadir_deg, count))
    shots = dataclasses.replace(batch.shots, pose=dataclasses.replace(batch.shots.pose, pitch=pitch))
    camera = FrameCamera.from_pixels(focal_px=100.0, width=WIDTH, height=HEIGHT)
    exposure = Exposure(Sensor(camera, Gimbal.fixed(), Mount.nadir()), shots)
    observation = Observation(exposure, np.tile([31.5, 23.5], (count, 1)))
    columns = [{"name": f"image {k}.tif", "u": 31.5, "v": 23.5} for k in range(count)]
    return Observations((dataclasses.replace(batch, observation=observation),), columns)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def write_images(folder: pathlib.Path, count: int) -> pathlib.Path:
    folder.mkdir()
    for k in range(count):
        write_image(folder / f"image {k}.tif", k)
    return folder


def write_image(path: pathlib.Path, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, 255, (3, HEIGHT, WIDTH)).astype(np.uint8)
    profile = {"driver": "GTiff", "height": HEIGHT, "width": WIDTH, "count": 3, "dtype": "uint8"}
    placed = from_origin(0.0, 0.0, 2.0, 2.0)  # frames often have a rough one, which is ignored
    with rasterio.open(path, "w", transform=placed, **profile) as file:
        file.write(values)


@dataclasses.dataclass(frozen=True)
class Made:
    """Frames over a small mosaic, and the run that rectified them."""

    folder: pathlib.Path
    images: pathlib.Path
    observed: Observations
    files: DemFiles
    run: Run

    def again(self, folder: pathlib.Path, terrain: Dem | DemFiles | None = None, **how: Any) -> Run:
        ground = self.files if terrain is None else terrain
        told = json.loads((self.folder / "_manifest.json").read_text(encoding="utf-8"))["identity"]
        cells = {"crs": told["crs"], "resolution": float(told["resolution"].split()[0])}  # their defaults
        return rectify_frames(folder, self.images, self.observed, ground, status=True, **(cells | how))


def with_twin(observed: Observations) -> Observations:
    """The first frame's pose for the one whose image is missing: in a window of the same shape, when it appears."""
    (batch,) = observed.batches

    def copied(leaf: Any) -> Any:
        leaf = np.array(leaf)
        leaf[MISSING] = leaf[0]
        return leaf

    exposure = dataclasses.replace(batch.observation.exposure, motion=jax.tree.map(copied, batch.shots))
    observation = dataclasses.replace(batch.observation, exposure=exposure)
    return dataclasses.replace(observed, batches=(dataclasses.replace(batch, observation=observation),))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("frames")
    files = open_dem(write_tiles(folder, 2, 2, 90), vertical_datum="ellipsoid")
    observed = with_twin(frames(4, 180, 180, np.array([10.0, 25.0, 10.0, 130.0])))
    images = write_images(folder / "images", 4)
    (images / f"image {MISSING}.tif").unlink()
    run = rectify_frames(folder / "made", images, observed, files, status=True)
    return Made(folder / "made", images, observed, files, run)


def item(folder: pathlib.Path, row: int) -> dict[str, Any]:
    return json.loads((folder / f"image_{row}.json").read_text(encoding="utf-8"))


def rasters_of(folder: pathlib.Path) -> dict[str, bytes]:
    found = {path.name: path.read_bytes() for path in folder.glob("*.tif")}
    assert found
    return found


def test_a_frame_without_an_orthophoto_tells_why(made: Made) -> None:
    assert made.run.computed == 4
    assert made.run.counts == {"hit": 2, "file_not_read": 1, "ray_misses_terrain": 1}
    reasons = [item(made.folder, row)["properties"].get("jaxgeo:reason") for row in range(4)]
    assert reasons[:2] == [None, None]
    assert f"image {MISSING}.tif: " in reasons[MISSING]
    assert "no line of sight" in reasons[SKYWARD]
    assert sorted(path.name for path in made.folder.glob("image_[0-9].tif")) == ["image_0.tif", "image_1.tif"]


def test_files_are_named_by_images_and_all_are_different() -> None:
    images = ["a/DJI_0042.JPG", "b/dji_0042.tif", "über weg.png", "mosaic.tif", "DJI_0042_status.tif", "c/7.tif"]
    assert part_names(images) == (
        "DJI_0042-00000.json",
        "dji_0042-00001.json",
        "_ber_weg-00002.json",
        "mosaic-00003.json",
        "DJI_0042_status-00004.json",
        "7.json",
    )


def test_cells_of_frames_are_those_of_the_first(made: Made) -> None:
    told = json.loads((made.folder / "_manifest.json").read_text(encoding="utf-8"))["identity"]
    assert told["crs"] == CRS
    for row in (0, 1):
        with rasterio.open(made.folder / f"image_{row}.tif") as data:
            size, corner = data.res[0], np.array([data.transform.c, data.transform.f])
            assert told["resolution"] == f"{size!r} x {size!r}"
            assert float(f"{size:.3g}") == size
            np.testing.assert_allclose(corner / size, np.rint(corner / size), rtol=0, atol=1e-6)
            assert data.crs.to_string() == CRS


def painted(folder: pathlib.Path, names: list[str], whole: Any) -> tuple[np.ndarray, np.ndarray]:
    """Values and known cells of files in one raster, the later over the earlier."""
    values = np.zeros((whole.count, *whole.shape), whole.dtypes[0])
    known = np.zeros(whole.shape, bool)
    for name in names:
        with rasterio.open(folder / name) as data:
            col, row = (round(x) for x in ~whole.transform @ (data.transform.c, data.transform.f))
            here = np.s_[row : row + data.height, col : col + data.width]
            mask = data.read_masks(1) != 0
            values[:, *here][:, mask] = data.read()[:, mask]
            known[here] |= mask
    return values, known


def test_the_mosaic_shows_all_frames(made: Made) -> None:
    with rasterio.open(made.folder / "mosaic.vrt") as whole:
        values, known = painted(made.folder, ["image_0.tif", "image_1.tif"], whole)
        assert 0.05 < known.mean() < 1.0
        np.testing.assert_array_equal(whole.read(), values)
        for band in (1, 2, 3):
            np.testing.assert_array_equal(whole.read_masks(band) != 0, known)
        assert [one.name for one in whole.colorinterp] == ["red", "green", "blue"]


def test_the_catalogue_is_one_of_stac(made: Made) -> None:
    collection = pystac.Collection.from_file(str(made.folder / "collection.json"))
    items = list(collection.get_items())
    assert [one.id for one in items] == [f"image_{row}" for row in range(4)]
    listed = json.loads((made.folder / "items.json").read_text(encoding="utf-8"))["features"]
    assert listed == [item(made.folder, row) for row in range(4)]
    west, south, east, north = collection.extent.spatial.bboxes[0]
    for one in items[:2]:
        asset = one.get_assets()["orthophoto"]
        with rasterio.open(asset.get_absolute_href()) as data:
            bounds = rasterio.warp.transform_bounds(data.crs, "EPSG:4326", *data.bounds)
            assert list(one.properties["proj:shape"]) == list(data.shape)
            assert list(one.properties["proj:transform"])[:6] == list(data.transform)[:6]
        np.testing.assert_allclose(one.bbox, bounds, rtol=0, atol=1e-6)
        assert west <= one.bbox[0] < one.bbox[2] <= east
        assert south <= one.bbox[1] < one.bbox[3] <= north
        assert set(one.get_assets()) == {"orthophoto", "status"}
    for row in (MISSING, SKYWARD):
        assert items[row].geometry is None
        assert not items[row].get_assets()


def test_only_missing_frames_are_computed(made: Made, tmp_path: pathlib.Path) -> None:
    """A frame whose file is gone, and one whose image has appeared; the others stay as they are."""
    folder = tmp_path / "copy"
    shutil.copytree(made.folder, folder)
    before = rasters_of(folder)
    (folder / "image_1.tif").unlink()
    images = shutil.copytree(made.images, tmp_path / "images")
    identity = json.loads((folder / "_manifest.json").read_text(encoding="utf-8"))
    with pytest.raises(ValueError, match=r"other images, resolution"):
        rectify_frames(folder, images, made.observed, made.files, status=True, crs=CRS, resolution=40.0)
    write_image(made.images / f"image {MISSING}.tif", MISSING)
    try:
        run = made.again(folder)
    finally:
        (made.images / f"image {MISSING}.tif").unlink()
    assert run.computed == 2
    assert run.counts == {"hit": 2}
    after = rasters_of(folder)
    assert {name: after[name] for name in before} == before
    assert len(after) == len(before) + 2
    assert json.loads((folder / "_manifest.json").read_text(encoding="utf-8")) == identity
    assert made.again(made.folder).computed == 0


def test_a_folder_with_something_else_is_refused(made: Made, tmp_path: pathlib.Path) -> None:
    (tmp_path / "note.txt").write_text("not ours")
    with pytest.raises(ValueError, match="no folder of parts"):
        made.again(tmp_path)
    with pytest.raises(ValueError, match="other resolution"):
        made.again(made.folder, resolution=40.0)
    (batch,) = made.observed.batches
    motion = jax.tree.map(lambda leaf: leaf[0], batch.shots)
    with pytest.raises(ValueError, match="holds orthophotos, not accuracy map"):
        accuracy_map(
            made.folder, batch.sensor, motion, made.files, batch.sources, bounds=(0.0, 0.0, 90.0, 90.0), crs=CRS
        )


def test_wrong_images_are_refused(made: Made, tmp_path: pathlib.Path) -> None:
    some = [made.images / "image 0.tif"] * 4
    with pytest.raises(ValueError, match=r"of 4 rows.*got 3"):
        rectify_frames(tmp_path / "a", some[:3], made.observed, made.files)
    with pytest.raises(ValueError, match="one pixel per image"):
        rectify_frames(tmp_path / "a", some, made.observed, made.files)
    assert not (tmp_path / "a").exists()


@pytest.mark.slow
def test_orthophotos_do_not_depend_on_who_computes_them(made: Made, tmp_path: pathlib.Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        made.again(tmp_path / "threads", client=pool)
    with connect("local:2") as client:
        made.again(tmp_path / "cluster", client=client)
    for name in ("threads", "cluster"):
        assert rasters_of(tmp_path / name) == rasters_of(made.folder)


@pytest.mark.slow
def test_orthophotos_over_files_are_those_over_the_whole(tmp_path: pathlib.Path) -> None:
    """Also with hidden ground, and where images reach beyond the mosaic; windows are much smaller than it."""
    paths = write_tiles(tmp_path, 4, 5, 100)
    files, whole = open_dem(paths, vertical_datum="ellipsoid"), read_dem(paths, vertical_datum="ellipsoid")
    observed = frames(16, 400, 500, np.linspace(10.0, 75.0, 16))
    images = write_images(tmp_path / "images", 16)
    how: dict[str, Any] = {"crs": CRS, "resolution": 47.3, "status": True}
    run = rectify_frames(tmp_path / "files", images, observed, files, **how)
    assert run.counts["hit"] >= 10
    hidden = 0
    for row in range(16):
        if (tmp_path / "files" / f"image_{row}.tif").exists():
            exposure = observed.at(row)[0].exposure
            path = tmp_path / f"{row}.tif"
            rectify_file(path, images / f"image {row}.tif", exposure.sensor, exposure.motion, whole, cog=True, **how)
            for ending in ("", "_status"):
                with (
                    rasterio.open(tmp_path / "files" / f"image_{row}{ending}.tif") as ours,
                    rasterio.open(tmp_path / f"{row}{ending}.tif") as theirs,
                ):
                    assert ours.transform == theirs.transform
                    np.testing.assert_array_equal(ours.read_masks(1), theirs.read_masks(1))
                    np.testing.assert_allclose(ours.read(), theirs.read(), rtol=0, atol=0 if ending else 1)
                    hidden += np.count_nonzero(theirs.read(1) == 14) if ending else 0
    assert hidden > 100
    first = observed.at(0)[0].exposure
    _, window = image_raster("image", first.sensor, first.motion, files, CRS, 47.3)
    assert isinstance(window, Dem)
    assert np.prod(np.asarray(window.extent)) < 0.2 * np.prod(files.shape)


@pytest.mark.slow
def test_a_missing_tile_of_the_dem_stops_only_its_frames(tmp_path: pathlib.Path) -> None:
    paths = write_tiles(tmp_path, 1, 4, 150)  # bounds are read in blocks of 256 cells
    files = open_dem(paths, vertical_datum="ellipsoid", height_range=(200.0, 1000.0))
    observed = frames(6, 150, 600)
    images = write_images(tmp_path / "images", 6)
    kept = tmp_path / "elsewhere.tif"
    paths[-1].rename(kept)
    with pytest.raises(PartsFailed, match=paths[-1].name) as told:
        rectify_frames(tmp_path / "out", images, observed, files, crs=CRS, resolution=40.0)
    assert 0 < len(told.value.failed) < 6
    listed = json.loads((tmp_path / "out" / "items.json").read_text(encoding="utf-8"))["features"]
    assert {f"{one['id']}.json" for one in listed} | set(told.value.failed) == {f"image_{k}.json" for k in range(6)}
    kept.rename(paths[-1])
    run = rectify_frames(tmp_path / "out", images, observed, files, crs=CRS, resolution=40.0)
    assert run.computed == len(told.value.failed)


AREA: dict[str, Any] = {"crs": CRS, "resolution": 97.3}  # its cells are not those of the terrain


def looked_at(files: DemFiles, off_nadir_deg: float = 40.0) -> tuple[Sensor, Any, Any]:
    """A sensor, a shot over the middle of a mosaic, and error sources."""
    (batch,) = frames(1, *files.shape, off_nadir_deg).batches
    return batch.sensor, jax.tree.map(lambda leaf: leaf[0], batch.shots), batch.sources


def compared(tiles: pathlib.Path, whole: pathlib.Path, least: int) -> None:
    """Check that a mosaic is a map, and that at least so many cells have figures."""
    with rasterio.open(tiles / "mosaic.vrt") as ours, rasterio.open(whole) as theirs:
        assert ours.transform == theirs.transform
        assert ours.shape == theirs.shape
        assert ours.descriptions == theirs.descriptions
        assert np.isnan(ours.nodata)
        found, expected = ours.read(), theirs.read()
        np.testing.assert_array_equal(found[2:], expected[2:])  # methods and statuses
        np.testing.assert_allclose(found[:2], expected[:2], rtol=2e-6)  # of single precision
        np.testing.assert_array_equal(ours.read_masks(1) != 0, ~np.isnan(expected[0]))
        assert np.isfinite(expected[0]).sum() >= least


@pytest.mark.slow
def test_the_tiles_of_a_map_are_the_map(made: Made, tmp_path: pathlib.Path) -> None:
    """Those that are missing are computed again, and only those."""
    sensor, shot, errors = looked_at(made.files, 0.0)
    east, north = (float(x) for x in pyproj.Transformer.from_crs("EPSG:4326", CRS).transform(*nadir_of(shot)))
    how: dict[str, Any] = {
        "crs": CRS,
        "bounds": (east - 640.0, north - 320.0, east + 640.0, north + 320.0),
        "sampling": None,
    }
    given = sensor, shot, ConstantHeight(500.0), errors
    run = accuracy_map(tmp_path / "tiles", *given, tile=10, resolution=64.0, **how)
    whole = write_accuracy_map(tmp_path / "whole.tif", *given, resolution=64.0, **how)
    assert run.parts == ("tile-00000-00000.tif", "tile-00000-00001.tif")
    assert sum(run.counts.values()) == np.size(whole.method)
    compared(tmp_path / "tiles", tmp_path / "whole.tif", 100)
    before = rasters_of(tmp_path / "tiles")
    (tmp_path / "tiles" / run.parts[1]).unlink()
    assert accuracy_map(tmp_path / "tiles", *given, tile=10, resolution=64.0, **how).computed == 1
    assert rasters_of(tmp_path / "tiles") == before
    with pytest.raises(ValueError, match="other cells"):
        accuracy_map(tmp_path / "tiles", *given, tile=10, resolution=32.0, **how)


def nadir_of(shot: Any) -> tuple[float, float]:
    """Latitude and longitude in deg below a camera."""
    position = shot.pose.position
    return float(np.degrees(position.lat)), float(np.degrees(position.lon))


@pytest.mark.slow
@pytest.mark.parametrize("off_nadir_deg", [40.0, 65.0])
def test_maps_over_files_are_those_over_the_whole(tmp_path: pathlib.Path, off_nadir_deg: float) -> None:
    """With samples, whose errors may reach beyond a window; the cells are not those of the terrain."""
    paths = write_tiles(tmp_path, 4, 5, 100)
    files, whole = open_dem(paths, vertical_datum="ellipsoid"), read_dem(paths, vertical_datum="ellipsoid")
    view = looked_at(files, off_nadir_deg)
    how: dict[str, Any] = {"resolution": 97.3, "sampling": Sampling(count=200)}
    accuracy_map(tmp_path / "tiles", *view[:2], files, view[2], tile=16, margin=300.0, **how)
    write_accuracy_map(tmp_path / "whole.tif", *view[:2], whole, view[2], **how)
    compared(tmp_path / "tiles", tmp_path / "whole.tif", 100)


@pytest.mark.slow
def test_maps_do_not_depend_on_who_computes_them(made: Made, tmp_path: pathlib.Path) -> None:
    view = looked_at(made.files)
    how: dict[str, Any] = {"tile": 11, "sampling": Sampling(count=200), **AREA}
    accuracy_map(tmp_path / "here", *view[:2], made.files, view[2], **how)
    with ThreadPoolExecutor(2) as pool:
        accuracy_map(tmp_path / "threads", *view[:2], made.files, view[2], client=pool, **how)
    with connect("local:2") as client:
        accuracy_map(tmp_path / "cluster", *view[:2], made.files, view[2], client=client, **how)
    for name in ("threads", "cluster"):
        assert rasters_of(tmp_path / name) == rasters_of(tmp_path / "here")


def test_tiles_of_a_raster_hold_each_cell_once() -> None:
    raster = MapRaster(pyproj.CRS(CRS), from_origin(EAST, NORTH, 10.0, 20.0), (25, 31))
    count = np.zeros(raster.shape, int)
    for tile in tiles_of(raster, 10).values():
        row, col = (round(x) for x in raster.rowcol(tile.transform.c, tile.transform.f))
        count[row : row + tile.shape[0], col : col + tile.shape[1]] += 1
        assert max(tile.shape) <= 10
    assert (count == 1).all()


def test_a_mosaic_takes_the_later_known_value(tmp_path: pathlib.Path) -> None:
    """Of floats with NaN for the unknown, in which nothing is known where no file is."""
    crs = pyproj.CRS(CRS)
    files = []
    for k, (row, col) in enumerate([(0, 0), (3, 4)]):
        raster = MapRaster(crs, from_origin(EAST + 10.0 * col, NORTH - 10.0 * row, 10.0, 10.0), (6, 7))
        values = np.full((1, 6, 7), float(k + 1), np.float32)
        values[0, 1 + k, 2] = np.nan
        profile = {"driver": "GTiff", "height": 6, "width": 7, "count": 1, "dtype": "float32", "nodata": np.nan}
        with rasterio.open(tmp_path / f"{k}.tif", "w", crs=CRS, transform=raster.transform, **profile) as data:
            data.write(values)
        files.append(MosaicFile(f"{k}.tif", raster))
    write_vrt(tmp_path / "all.vrt", files, Bands(1, "float32", float("nan"), ("CE90, m",), ("m",)), {"SAMPLES": "7"})
    with rasterio.open(tmp_path / "all.vrt") as whole:
        values, known = painted(tmp_path, ["0.tif", "1.tif"], whole)
        assert (whole.shape, whole.units, whole.tags()["SAMPLES"]) == ((9, 11), ("m",), "7")
        np.testing.assert_array_equal(whole.read(1), np.where(known, values[0], np.nan))
        assert 0 < known.sum() < known.size
    beside = files[1].raster._replace(transform=from_origin(EAST + 44.0, NORTH, 10.0, 10.0))
    with pytest.raises(ValueError, match=r"1\.tif are not aligned"):
        write_vrt(tmp_path / "all.vrt", [files[0], MosaicFile("1.tif", beside)], Bands(1, "float32"))

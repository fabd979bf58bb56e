"""Rasters of standard deviations of terrain heights: read as they are, on their own grid, and never as heights.

Held against: rasterio, PROJ and bilinear interpolation by hand, on files in the layout of the height error mask of the
Copernicus DEM (one float32 per pixel, in m, on a geographic grid, with a nodata value).
"""

from __future__ import annotations

import json
import pathlib

import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
import rasterio
from rasterio.transform import from_origin
from scipy.special import ndtri
from support.command_runner import CliRunner

import jaxgeo
from jaxgeo import Geodetic
from jaxgeo.cli import app
from jaxgeo.demo import scene_file
from jaxgeo.io import DemError, read_height_sigmas
from jaxgeo.io.scene import SceneError, read_scene
from jaxgeo.uncertainty import PerMeasurement, sources
from jaxgeo.uncertainty.distributions import Uniform
from jaxgeo.uncertainty.sources.height_raster import sigma_at

SECOND = 1.0 / 3600.0
WEST, NORTH, SIZE = -84.30, 36.30, (160, 130)  # about the fix of the demonstration's scene, and half of its image
FIX = 36.2690267, -84.2679812


def write(path: pathlib.Path, values: np.ndarray, *, crs: str = "EPSG:4326", **options) -> pathlib.Path:
    """A raster of one band, whose first pixel is at `WEST`, `NORTH`."""
    profile = {"transform": from_origin(WEST - SECOND / 2, NORTH + SECOND / 2, SECOND, SECOND), "dtype": values.dtype}
    rows, cols = values.shape
    with rasterio.open(path, "w", "GTiff", width=cols, height=rows, count=1, crs=crs, **profile | options) as data:
        data.write(values, 1)
    return path


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    return np.random.default_rng(4).uniform(0.3, 4.0, SIZE).astype(np.float32)


@pytest.fixture(scope="module")
def hem(values: np.ndarray, tmp_path_factory) -> pathlib.Path:
    """A height error mask with a void of one pixel, far from the fix."""
    stored = values.copy()
    stored[3, 5] = -32767.0
    return write(tmp_path_factory.mktemp("hem") / "Copernicus_DSM_10_N36_00_W085_00_HEM.tif", stored, nodata=-32767.0)


def at(source: sources.TerrainHeightRaster, lat_deg: float, lon_deg: float) -> float:
    p_ecef = jaxgeo.WGS84.to_ecef(Geodetic.from_degrees(lat=lat_deg, lon=lon_deg, height=500.0))
    return float(source.sigma[0] * sigma_at(jnp.asarray(source.posts), source.grid, p_ecef))


def by_hand(values: np.ndarray, lat_deg: float, lon_deg: float) -> float:
    row, col = (NORTH - lat_deg) / SECOND, (lon_deg - WEST) / SECOND
    r, c = int(row), int(col)
    a, b = row - r, col - c
    four = values[r : r + 2, c : c + 2].astype(float)
    return float((np.array([1.0 - a, a]) @ four) @ np.array([1.0 - b, b]))


def test_values_are_those_of_the_file_at_a_position(hem: pathlib.Path, values: np.ndarray) -> None:
    source = read_height_sigmas(hem)
    np.testing.assert_array_equal(np.isnan(source.posts), [[(r, c) == (3, 5) for c in range(130)] for r in range(160)])
    for lat, lon in (FIX, (NORTH - 20.25 * SECOND, WEST + 100.75 * SECOND)):
        assert at(source, lat, lon) == pytest.approx(by_hand(values, lat, lon), rel=1e-9)
    assert np.isnan(at(source, NORTH - 3.5 * SECOND, WEST + 4.5 * SECOND)), "beside the void"
    assert np.isnan(at(source, FIX[0], WEST - SECOND)), "off the raster"


def test_scale_and_probability_of_the_values(hem: pathlib.Path, values: np.ndarray) -> None:
    assert at(read_height_sigmas(hem, scale=2.0), *FIX) == pytest.approx(2.0 * by_hand(values, *FIX), rel=1e-9)
    le90 = read_height_sigmas(hem, probability=0.9, sharing=PerMeasurement(), distribution=Uniform())
    assert at(le90, *FIX) == pytest.approx(by_hand(values, *FIX) / ndtri(0.95), rel=1e-9)
    assert isinstance(le90.sharing, PerMeasurement)
    assert le90.shapes == (Uniform(),)


def test_a_raster_of_another_map_is_looked_up_by_position(tmp_path: pathlib.Path) -> None:
    """In UTM zone 16, of the elevation model's zone or not, in centimetres as integers."""
    to_map = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32616", always_xy=True)
    east, north = to_map.transform(FIX[1], FIX[0])
    east0, north0 = east - 333.0, north + 444.0  # of the first pixel's centre
    stored = np.add.outer(7 * np.arange(60), 11 * np.arange(50)).astype(np.int16)
    transform = from_origin(east0 - 10.0, north0 + 10.0, 20.0, 20.0)
    path = write(tmp_path / "sigma.tif", stored, crs="EPSG:32616", transform=transform)
    found = at(read_height_sigmas(path, height_unit="cm"), *FIX)
    assert found == pytest.approx(0.01 * (7 * 444.0 / 20.0 + 11 * 333.0 / 20.0), abs=1e-4)


def test_a_vertical_datum_of_the_file_moves_nothing(values: np.ndarray, tmp_path: pathlib.Path) -> None:
    """That of the elevation model: geoid heights must not be added to standard deviations."""
    path = write(tmp_path / "compound.tif", values, crs="EPSG:4326+3855")
    assert at(read_height_sigmas(path), *FIX) == pytest.approx(by_hand(values, *FIX), rel=1e-9)


def test_a_part_of_a_raster(hem: pathlib.Path, values: np.ndarray) -> None:
    bounds = (FIX[1] - 0.003, FIX[0] - 0.003, FIX[1] + 0.003, FIX[0] + 0.003)
    source = read_height_sigmas(hem, bounds=bounds)
    assert np.prod(np.shape(source.posts)) < 0.1 * values.size
    assert at(source, *FIX) == pytest.approx(by_hand(values, *FIX), rel=1e-9)


@pytest.mark.parametrize(
    "change, options, words",
    [
        ({"value": -32767.0}, {}, "Pass nodata=-32767"),
        ({"value": -0.5}, {}, "row 0, column 0 (and 0 more) the standard deviation is -0.5 m; it must be 0 or more"),
        ({}, {"nodata": -1.0}, "nodata=-1 marks no post"),
        ({}, {"scale": 0.0}, "scale must be a positive factor"),
        ({}, {"scale": np.inf}, "scale must be a positive factor"),
        ({}, {"probability": 90}, "probability must lie between 0 and 1"),
        ({}, {"bounds": (10.0, 46.0, 10.1, 46.1)}, "bounds"),
        ({"value": np.nan, "all": True}, {}, "all 20800 values are void"),
    ],
)
def test_what_is_no_raster_of_standard_deviations(
    values: np.ndarray, tmp_path: pathlib.Path, change: dict, options: dict, words: str
) -> None:
    stored = values.copy()
    if "value" in change:
        stored[slice(None) if "all" in change else (0, 0)] = change["value"]
    with pytest.raises((DemError, ValueError)) as error:
        read_height_sigmas(write(tmp_path / "wrong.tif", stored), **options)
    assert words in str(error.value)


# In scene files.


def scene(folder: pathlib.Path, terrain: str) -> pathlib.Path:
    """The demonstration's scene with other errors of the terrain."""
    lines = scene_file().read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("terrain_m", "terrain_correlation_m"))]
    path = folder / "scene.toml"
    path.write_text("\n".join(kept).replace("[errors]", f"[errors]\nterrain_m = {terrain}"))
    return path


def test_a_scene_names_a_raster_beside_it(hem: pathlib.Path, values: np.ndarray, tmp_path: pathlib.Path) -> None:
    (tmp_path / "layers").mkdir()
    (tmp_path / "layers" / "hem.tif").write_bytes(hem.read_bytes())
    stated = '{raster = "layers/hem.tif", scale = 1.5, probability = 0.9, distribution = "laplace"}'
    model = read_scene(scene(tmp_path, stated)).errors
    assert model is not None
    (source,) = [one for one in model.sources if isinstance(one, sources.TerrainHeightRaster)]
    assert at(source, *FIX) == pytest.approx(1.5 * by_hand(values, *FIX) / ndtri(0.95), rel=1e-9)
    assert source.shapes[0].words == "Laplace"


@pytest.mark.parametrize(
    "terrain, words",
    [
        ('{raster = "nowhere.tif"}', "[errors] terrain_m: raster = 'nowhere.tif': there is no such file"),
        ('{raster = "scene.toml"}', "[errors] terrain_m: "),
        ('{raster = "https://example.org/hem.tif"}', "[errors] terrain_m: "),
        ('{raster = "x.tif", sigma = 3.0}', "leave out sigma"),
        ('{raster = "x.tif", sigmas = 2}', "sigmas goes with plus_minus"),
        ('{raster = "x.tif"}\nterrain_correlation_m = 100.0', "a raster has no terrain_correlation_m"),
        ('{raster = "x.tif", scale = -1.0}', "scale = -1.0: must be greater than 0"),
    ],
)
def test_mistakes_about_rasters_are_named(tmp_path: pathlib.Path, terrain: str, words: str) -> None:
    with pytest.raises(SceneError) as error:
        read_scene(scene(tmp_path, terrain))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_the_command_line_takes_the_raster_of_a_scene(
    hem: pathlib.Path, values: np.ndarray, tmp_path: pathlib.Path
) -> None:
    """The same figures as with the one number of the place; off the raster one line says so."""
    sigma = by_hand(values, *FIX)
    dem = ["--dem", scene_file().with_name("jacksboro.tif"), "--json"]
    told = []
    for terrain in (f'{{raster = "{hem.as_posix()}"}}', f"{sigma!r}"):
        path = scene(tmp_path, terrain)
        result = CliRunner().invoke(app, ["locate", "--scene", f"{path}", "--pixel", "1200,2400", *map(str, dem)])
        assert result.exit_code == 0, result.output
        told.append(json.loads(result.stdout)["fixes"][0])
    ours, theirs = told
    assert ours["accuracy_method"] == theirs["accuracy_method"]
    for name in ("ce90_m", "le90_m"):
        assert ours[name] == pytest.approx(theirs[name], rel=1e-3)

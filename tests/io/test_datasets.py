"""Datasets of xarray: the figures of the records, with coordinates and units that other programs understand."""

from __future__ import annotations

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
from rasterio.transform import Affine

from jaxgeo import Geodetic, Status
from jaxgeo.io.datasets import accuracy_map_dataset, samples_dataset
from jaxgeo.io.map_raster import MapRaster
from jaxgeo.uncertainty import AccuracyMap, Method, accuracy, sample
from tests.support import looks

pytestmark = pytest.mark.costly

xarray = pytest.importorskip("xarray")

SENSOR, SHOT, UV, GROUND, MODEL = (
    looks.level_sensor(),
    looks.level_shot(),
    looks.LEVEL_UV,
    looks.LEVEL,
    looks.level_errors(),
)
UTM = MapRaster(pyproj.CRS("EPSG:32632"), Affine(10.0, 0.0, 650_000.0, 0.0, -20.0, 5_207_000.0), (2, 3))
DEGREES = MapRaster(pyproj.CRS("EPSG:4326"), Affine(0.1, 0.0, 11.0, 0.0, -0.2, 47.0), (2, 3))


@pytest.fixture(scope="module")
def found() -> AccuracyMap:
    """Of two rows of three pixels, the last of which lies beside the image."""
    u, v = np.meshgrid([100.0, 1200.0, 2800.0], [200.0, 400.0])
    uv = np.stack([u, v], axis=-1)
    each = accuracy(SENSOR, SHOT, uv, GROUND, MODEL, probability=0.8, block=4)
    return AccuracyMap(each, each.fix.position, uv)


@pytest.mark.slow
def test_a_dataset_holds_what_the_map_holds(found: AccuracyMap) -> None:
    told = accuracy_map_dataset(found)
    assert dict(told.sizes) == {"row": 2, "col": 3}
    for name, field in (("circular", "circular_error"), ("linear", "linear_error"), ("spherical", "spherical_error")):
        np.testing.assert_array_equal(told[field], getattr(found, name))
        assert told[field].attrs["units"] == "m"
    np.testing.assert_array_equal(told["status"], found.status)
    np.testing.assert_array_equal(told["trust"], found.method)
    np.testing.assert_array_equal(np.stack([told["u"], told["v"]], axis=-1), found.uv)
    np.testing.assert_allclose(np.deg2rad(told["latitude"]), found.position.lat, rtol=0.0, atol=1e-15)
    assert told["circular_error"].isnull().to_numpy().tolist() == [[False, False, True]] * 2
    assert told.attrs["probability"] == 0.8


def test_codes_say_what_they_mean(found: AccuracyMap) -> None:
    told = accuracy_map_dataset(found)
    for name, expected in (("status", {int(s): s.name for s in Status}), ("trust", {int(t): t.name for t in Method})):
        attributes = told[name].attrs
        words = attributes["flag_meanings"].split()
        meanings = dict(zip(attributes["flag_values"].tolist(), words, strict=True))
        assert attributes["flag_values"].dtype == told[name].dtype
        assert expected.items() <= meanings.items()


@pytest.mark.parametrize("raster, names", [(UTM, ("y", "x")), (DEGREES, ("lat", "lon"))])
def test_on_a_map_it_names_its_crs_by_cf(tmp_path: pathlib.Path, found: AccuracyMap, raster, names) -> None:
    """Through a NetCDF and back."""
    pytest.importorskip("scipy")
    path = tmp_path / "map.nc"
    accuracy_map_dataset(found, raster).to_netcdf(path, engine="scipy")
    with xarray.open_dataset(path, engine="scipy", decode_coords="all") as told:
        assert told["circular_error"].dims == names
        assert pyproj.CRS.from_cf(told["crs"].attrs).equals(raster.crs)
        assert told["circular_error"].encoding["grid_mapping"] == "crs"
        col, row = np.meshgrid(np.arange(3) + 0.5, np.arange(2) + 0.5)
        across, _, west, _, down, north = raster.transform[:6]
        x, y = west + across * col, north + down * row
        np.testing.assert_allclose(np.broadcast_to(told[names[1]], (2, 3)), x, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(np.broadcast_to(told[names[0]].to_numpy()[:, None], (2, 3)), y, rtol=0.0, atol=1e-9)
        units = ("m", "m") if raster is UTM else ("degrees_north", "degrees_east")
        assert tuple(told[name].attrs["units"] for name in names) == units
        np.testing.assert_array_equal(told["circular_error"], found.circular)
        assert told["status"].attrs["flag_meanings"].split()[0] == "hit"


def test_rasters_that_do_not_fit_are_refused(found: AccuracyMap) -> None:
    with pytest.raises(ValueError, match=r"the raster has \(3, 2\) cells"):
        accuracy_map_dataset(found, UTM._replace(shape=(3, 2)))
    with pytest.raises(ValueError, match="turned against its CRS"):
        accuracy_map_dataset(found, UTM._replace(transform=Affine.rotation(10.0)))


def test_places_along_a_line_have_one_dimension(found: AccuracyMap) -> None:
    line = jax.tree.map(lambda x: x[0] if jnp.ndim(x) > 1 else x, found)
    told = accuracy_map_dataset(line)
    assert dict(told.sizes) == {"place": 3}


@pytest.mark.slow
def test_samples_come_with_their_moments() -> None:
    drawn = sample(SENSOR, SHOT, UV, GROUND, MODEL, key=jax.random.key(1), count=64, keep=True)
    told = samples_dataset(drawn)
    assert told["error"].dims == ("sample", "axis")
    assert told["axis"].to_numpy().tolist() == ["east", "north", "up"]
    np.testing.assert_array_equal(told["error"], drawn.errors_enu)
    np.testing.assert_allclose(told["error"].mean("sample"), told["mean"], rtol=0.0, atol=1e-9)  # m
    np.testing.assert_allclose(np.cov(told["error"].T), told["covariance"], rtol=1e-9, atol=1e-9)  # m²
    place = drawn.fix.position
    assert isinstance(place, Geodetic)
    assert float(told["latitude"]) == pytest.approx(float(np.rad2deg(place.lat)), abs=1e-12)
    assert set(told["status"].to_numpy()) == {Status.hit}
    not_kept = sample(SENSOR, SHOT, UV, GROUND, MODEL, key=jax.random.key(1), count=64)
    with pytest.raises(ValueError, match="were not kept"):
        samples_dataset(not_kept)

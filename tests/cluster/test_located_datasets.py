"""Observations in an xarray dataset: the fixes of one call, lazily by chunks."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pytest
from support.survey import survey, write_tiles

import jaxgeo
from jaxgeo.cluster import locate_dataset
from jaxgeo.io import open_dem
from jaxgeo.status import Status

xarray: Any = pytest.importorskip("xarray")
pytest.importorskip("dask")

GROUND = jaxgeo.ConstantHeight(600.0)
SIDE = 1800.0  # m


@pytest.fixture(scope="module")
def frames() -> Any:
    """Poses along `frame`, pixels along `pixel`: one of them outside of the image."""
    (batch,) = survey(12, (SIDE, SIDE)).batches
    pose = batch.shots.pose
    columns = {
        "lat_deg": np.degrees(pose.position.lat),
        "lon_deg": np.degrees(pose.position.lon),
        "height_m": pose.position.height,
        "heading_deg": np.degrees(pose.heading),
        "pitch_deg": np.degrees(pose.pitch),
        "roll_deg": np.degrees(pose.roll),
    }
    variables: dict[str, Any] = {name: ("frame", values) for name, values in columns.items()}
    variables |= {"u": ("pixel", [1999.5, 100.0, 5000.0]), "v": ("pixel", [1499.5, 2000.0, 0.0])}
    return xarray.Dataset(variables, {"frame": [f"f{k}" for k in range(12)]})


@pytest.fixture(scope="module")
def sensor() -> jaxgeo.Sensor:
    return survey(1, (SIDE, SIDE)).batches[0].sensor


@pytest.mark.oldest
@pytest.mark.costly
def test_it_is_located_by_chunks_when_it_is_computed(frames: Any, sensor: jaxgeo.Sensor) -> None:
    at_once = locate_dataset(frames, sensor, GROUND)
    lazily = locate_dataset(frames.chunk(frame=5), sensor, GROUND)
    assert at_once.sizes == lazily.sizes == {"frame": 12, "pixel": 3}
    assert all(values.chunks == ((5, 5, 2), (3,)) for values in lazily.data_vars.values())
    xarray.testing.assert_identical(lazily.compute(), at_once)


@pytest.mark.costly
def test_the_fixes_are_those_of_observations(frames: Any, sensor: jaxgeo.Sensor) -> None:
    found = locate_dataset(frames, sensor, GROUND)
    fixes = jaxgeo.io.locate_observations(survey(12, (SIDE, SIDE)), GROUND)
    np.testing.assert_allclose(found["fix_lat_deg"][:, 0], np.degrees(fixes.position.lat), rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found["slant_range_m"][:, 0], fixes.slant_range, rtol=0.0, atol=1e-5)
    assert found["fix_height_m"].attrs["units"] == "m"
    codes = dict(zip(found["status"].attrs["flag_meanings"].split(), found["status"].attrs["flag_values"], strict=True))
    assert codes == {one.name: int(one) for one in Status}
    assert (found["status"][:, 2] == codes["outside_image"]).all()
    assert np.isnan(found["fix_lon_deg"][:, 2]).all()


@pytest.mark.costly
@pytest.mark.parametrize("chunked", [["u", "v"], ["height_m"], ["lat_deg"]])
def test_some_variables_may_be_those_of_dask(frames: Any, sensor: jaxgeo.Sensor, chunked: list[str]) -> None:
    mixed = frames.assign({name: frames[name].chunk() for name in chunked})
    found = locate_dataset(mixed, sensor, GROUND)
    assert found["status"].chunks is not None
    xarray.testing.assert_identical(found.compute(), locate_dataset(frames, sensor, GROUND))


@pytest.mark.costly
def test_what_is_given_may_be_coordinates(frames: Any, sensor: jaxgeo.Sensor) -> None:
    """Of a dimension too: a picture's columns."""
    found = locate_dataset(frames.set_coords(["lat_deg", "lon_deg"]).isel(pixel=[0, 1]), sensor, GROUND)
    alone = locate_dataset(frames, sensor, GROUND)
    np.testing.assert_array_equal(found["fix_lat_deg"], alone["fix_lat_deg"][:, :2])
    columns = frames.drop_vars("u").isel(pixel=0).assign(u=("u", [1999.5, 100.0])).chunk(frame=6)
    assert locate_dataset(columns, sensor, GROUND).compute().sizes == {"frame": 12, "u": 2}


def test_a_latitude_beyond_the_pole_has_no_fix(frames: Any, sensor: jaxgeo.Sensor) -> None:
    found = locate_dataset(frames.assign(lat_deg=frames["lat_deg"] + 95.0), sensor, GROUND)
    assert (found["status"][:, 0] == int(Status.invalid_input)).all()
    assert np.isnan(found["fix_lat_deg"]).all()


def test_ground_of_several_heights_is_refused(frames: Any, sensor: jaxgeo.Sensor) -> None:
    with pytest.raises(ValueError, match="one for all"):
        locate_dataset(frames, sensor, jaxgeo.ConstantHeight(np.full(12, 600.0)))


@pytest.mark.slow
def test_over_a_dem_on_disk(tmp_path: pathlib.Path, frames: Any, sensor: jaxgeo.Sensor) -> None:
    files = open_dem(write_tiles(tmp_path, down=1, across=1, posts=60), vertical_datum="ellipsoid")
    lazily = locate_dataset(frames.chunk(frame=6), sensor, files).compute()
    xarray.testing.assert_identical(lazily["status"], locate_dataset(frames, sensor, files)["status"])
    assert {"hit"} < {Status(int(code)).name for code in np.unique(lazily["status"])}


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda data: data.drop_vars("u"), "has no u"),
        (lambda data: data.assign(lat_deg=data["lat_deg"].assign_attrs(units="rad")), "lat_deg is in 'rad'"),
        (lambda data: data.assign(height_m=data["height_m"].assign_attrs(units="ft")), "height_m is in 'ft'"),
    ],
)
def test_other_variables_and_units_are_refused(frames: Any, sensor: jaxgeo.Sensor, change: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        locate_dataset(change(frames), sensor, GROUND)

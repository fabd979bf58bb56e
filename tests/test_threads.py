"""Several threads at once get what one gets, to the bit, also where the first calls race to compile."""

from __future__ import annotations

import pathlib
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
import pytest
from rasterio.transform import Affine
from support.rasters import hills, write

import jaxgeo
from jaxgeo import ConstantHeight, ErrorModel, FrameCamera, Gimbal, Mount, Pose, Ray, Sensor, Shot, Status
from jaxgeo.io import example_dem, open_dem, read_dem, undulation
from jaxgeo.io._quietly import heard, quietly
from jaxgeo.io.locate_on_disk import intersect_files
from jaxgeo.uncertainty.sources import Position

THREADS = 4


def at_once(one: Callable[[int], Any], count: int = THREADS) -> list[Any]:
    """What `one` of 0, 1, ... gives in as many threads, started together."""
    barrier = threading.Barrier(count)

    def started(number: int) -> Any:
        barrier.wait()
        return one(number)

    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(started, range(count)))


def assert_equal(found: list[Any], expected: Any) -> None:
    for one in found:
        for own, leaf in zip(jax.tree.leaves(one), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(np.asarray(own), np.asarray(leaf))


def scene(width: int) -> tuple[Sensor, Shot]:
    """Of a size that no other test has, so that its programs are not compiled yet."""
    camera = FrameCamera.from_pixels(focal_px=3700.0, width=width, height=3000)
    sensor = Sensor(camera, Gimbal.three_axis(), Mount.forward())
    readings = sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-60.0, roll=0.0)
    return sensor, Shot(Pose.from_degrees(lat=36.3, lon=-84.1, height=2000.0), readings)


def located_and_sampled(terrain: Any, width: int, count: int) -> Callable[[int], Any]:
    sensor, shot = scene(width)
    errors = ErrorModel((Position.from_ned(north=3.0, east=3.0, down=5.0),))

    def one(_: int) -> Any:
        fix = jaxgeo.locate(sensor, shot, (1999.5, 1499.5), terrain)
        drawn = jaxgeo.sample(sensor, shot, (1999.5, 1499.5), terrain, errors, key=jax.random.key(5), count=count)
        return fix, drawn.mean_enu, drawn.cov_enu

    return one


@pytest.mark.costly
def test_locate_and_sample_over_level_ground() -> None:
    one = located_and_sampled(ConstantHeight(600.0), 4001, 2000)
    found = at_once(one)
    assert int(found[0][0].status) == Status.hit
    assert_equal(found, one(0))


@pytest.mark.slow
def test_locate_and_sample_over_terrain() -> None:
    one = located_and_sampled(example_dem(), 4003, 4000)
    found = at_once(one)
    assert int(found[0][0].status) == Status.hit
    assert_equal(found, one(0))


@pytest.mark.costly
def test_elevation_models_and_geoids(tmp_path: pathlib.Path) -> None:
    """Operations of PROJ, which are kept, files, which are opened, and Python's filters of warnings."""
    paths = [
        write(tmp_path / f"{k}.tif", hills((40, 50), seed=k), affine=Affine(1e-3, 0, 5.0 + k, 0, -1e-3, 45.0))
        for k in range(3)
    ]
    lat, lon = np.linspace(-80.0, 80.0, 500), np.linspace(-180.0, 360.0, 500)

    def one(number: int) -> Any:
        del number
        posts = [np.asarray(read_dem(path, vertical_datum=5773).posts) for path in paths]
        return posts, undulation(lat, lon)

    expected = one(0)  # what checks types, from the first call on, changes the filters then
    before = list(warnings.filters)
    assert_equal(at_once(one, 8), expected)
    assert warnings.filters == before


@pytest.mark.slow
def test_one_opened_terrain_serves_all(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((700, 900)), affine=Affine(1e-4, 0, 5.0, 0, -1e-4, 45.0))
    rng = np.random.default_rng(3)
    lat, lon = rng.uniform(44.94, 44.99, 64), rng.uniform(5.01, 5.08, 64)
    above = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=np.full(64, 3000.0))
    origin = np.asarray(jax.vmap(jaxgeo.WGS84.to_ecef)(above))
    down = -np.asarray(jax.vmap(lambda p: jaxgeo.WGS84.normal_and_height(p)[0])(origin))
    files = open_dem(path, vertical_datum="ellipsoid", cache=tmp_path / "bounds.npz")
    found = at_once(lambda _: intersect_files(Ray(origin, down), files))
    assert np.all(np.asarray(found[0].status) == Status.hit)
    alone = open_dem(path, vertical_datum="ellipsoid")
    assert_equal(found, intersect_files(Ray(origin, down), alone))
    assert [file.name for file in tmp_path.glob("bounds*")] == ["bounds.npz"]


def test_warnings_that_are_held_back_or_heard_disturb_no_other_thread() -> None:
    raised: list[Exception] = []
    is_done = threading.Event()

    def warn_all_the_time() -> None:
        while not is_done.is_set():
            try:
                warnings.warn("of another thread", stacklevel=1)
            except Exception as error:  # a filter that makes errors of warnings
                raised.append(error)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = list(warnings.filters)
        other = threading.Thread(target=warn_all_the_time)
        other.start()

        def one(number: int) -> list[str]:
            texts: list[str] = []
            for _ in range(50):
                with heard("tests") as found:
                    warnings.warn(f"of thread {number}", stacklevel=1)
                texts += [text for text in found if text.startswith("of thread")]
                with quietly():
                    pass
            return texts

        found = at_once(one)
        is_done.set()
        other.join()
        assert warnings.filters == before
    assert found == [[f"of thread {number}"] * 50 for number in range(THREADS)]
    assert raised == []

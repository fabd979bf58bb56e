"""What is no record travels between processes too, or says why it cannot: files that stay on disk, results, errors.

Held against itself: what another process finds must be equal, to the bit. Records have `test_records.py`.
"""

from __future__ import annotations

import copy
import dataclasses
import enum
import importlib
import inspect
import pathlib
import pickle
import pkgutil
import shutil
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo._record import Record
from jaxgeo.demo import Making, Picture, scene_file
from jaxgeo.io import (
    DemCache,
    DemError,
    DemFiles,
    MapRaster,
    OrthoWriter,
    open_dem,
    read_acquisition,
    read_acquisitions,
)
from jaxgeo.ortho import Rectifier
from jaxgeo.ties import AbstractFeatures, ImageKeypoints, KeptMatches, Pictures, RecursiveCorrection
from jaxgeo.view import ViewServer
from tests.support import looks
from tests.support.drone_image_files import packet, write_image
from tests.support.records import leaves_of
from tests.test_cli_folders import DJI
from tests.test_records import without_jax

DEM = pathlib.Path(scene_file()).with_name("jacksboro.tif")


def package_classes() -> dict[str, type]:
    """All classes of the package, by their full names."""
    found: dict[str, type] = {}
    for module in pkgutil.walk_packages(jaxgeo.__path__, "jaxgeo."):
        if module.name.endswith("__main__"):
            continue
        for value in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(value) and value.__module__.startswith("jaxgeo."):
                found[f"{value.__module__}.{value.__qualname__}"] = value
    return found


def public_classes() -> dict[str, type]:
    """Those that programs are to use, but for records, enumerations and errors."""
    found: dict[str, type] = {}
    for module in ["jaxgeo", *(module.name for module in pkgutil.walk_packages(jaxgeo.__path__, "jaxgeo."))]:
        if module.endswith("__main__"):
            continue
        room = importlib.import_module(module)
        for name in getattr(room, "__all__", ()):
            value = getattr(room, name)
            if inspect.isclass(value) and not issubclass(value, Record | enum.Enum | BaseException):
                found[f"{value.__module__}.{value.__qualname__}"] = value
    return found


def annotations_of(cls: type) -> dict[str, str]:
    if dataclasses.is_dataclass(cls):
        return {field.name: str(field.type) for field in dataclasses.fields(cls)}
    return {name: str(getattr(cls, "__annotations__", {}).get(name, "Any")) for name in getattr(cls, "_fields", ())}


def filled(cls: type) -> Any:
    """An object with numbers of many digits in every field: arrays of NumPy where it says so, else of JAX in records,
    and bare ones where the fields are of JAX."""
    number = np.asarray([np.pi, np.nextafter(6378137.0, 7e6), -0.0, 5e-324])
    angle = np.asarray([np.nextafter(0.5 * np.pi, 0.0), 1.0 / 3.0, -0.0, 5e-324])
    place = jaxgeo.Geodetic(lat=jnp.asarray(angle), lon=jnp.asarray(-angle), height=jnp.asarray(2.0 * number))
    values: dict[str, Any] = {}
    for name, kind in annotations_of(cls).items():
        if "ndarray" in kind:
            values[name] = number
        elif any(word in kind for word in ("Scalar", "Vector3", "Matrix3", "StatusField", "Array")):
            values[name] = jnp.asarray(number)
        else:
            values[name] = "text" if kind == "str" else {"of": (place, [number])}
    if issubclass(cls, tuple):
        return tuple.__new__(cls, tuple(values.values()))
    made = object.__new__(cls)
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made


SPECIAL = {DemCache, DemFiles, OrthoWriter, Rectifier, RecursiveCorrection}  # which have tests of their own
OF_A_PROCESS = {
    AbstractFeatures,
    ImageKeypoints,
    KeptMatches,
    Making,
    Picture,
    Pictures,
    ViewServer,
}  # hold functions, threads, a figure, a reader, a socket, or anything (a class of the user's)


def test_what_public_functions_give_loses_no_digit() -> None:
    classes = public_classes()
    assert set(classes.values()) >= SPECIAL
    assert len(classes) > 60
    for name, cls in classes.items():
        if cls in SPECIAL | OF_A_PROCESS:
            continue
        assert dataclasses.is_dataclass(cls) or hasattr(cls, "_fields"), f"{name} has a state that is not known here"
        made = filled(cls)
        again = pickle.loads(without_jax(made))
        assert type(again) is cls
        assert leaves_of(again) == leaves_of(made), name


def test_a_cache_of_elevation_models_travels(tmp_path: pathlib.Path) -> None:
    cache = DemCache(tmp_path, largest=1_000_000)
    cache.set_entry("key", {"a": 1})
    again = pickle.loads(without_jax(cache))
    assert (again.folder, again.largest, again.entry("key")) == (cache.folder, cache.largest, {"key": "key", "a": 1})


def test_files_that_were_read_travel(tmp_path: pathlib.Path) -> None:
    for k in range(2):
        write_image(tmp_path / f"DJI_{k}.jpg", packet(DJI), make="DJI")
    one = read_acquisition(tmp_path / "DJI_0.jpg", height_datum="ellipsoid")
    several = read_acquisitions(tmp_path, height_datum="ellipsoid")
    for made in (one, several):
        assert leaves_of(pickle.loads(without_jax(made))) == leaves_of(made)


@pytest.fixture
def dem_files(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> DemFiles:
    shutil.copy(DEM, tmp_path / "dem.tif")
    monkeypatch.chdir(tmp_path)
    return open_dem("dem.tif", void_ceiling=3000.0, cache="bounds.npz")


def test_terrain_on_disk_is_opened_again(
    dem_files: DemFiles, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert dem_files.highest > dem_files.lowest  # read once, here
    expected = dem_files.load(dem_files.source.window, whole_ceiling=True)
    sent = without_jax(dem_files)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    for again in (pickle.loads(sent), copy.deepcopy(dem_files)):
        assert (again.lowest, again.highest, again.void_ceiling) == (dem_files.lowest, dem_files.highest, 3000.0)
        assert again.blocks.posts_read == 0, "the bounds came along"
        assert leaves_of(again.load(again.source.window, whole_ceiling=True)) == leaves_of(expected)


def test_bounds_of_files_that_changed_stay_behind(dem_files: DemFiles, tmp_path: pathlib.Path) -> None:
    dem_files.blocks.low[...], dem_files.blocks.is_read[...] = -5.0, True
    sent = pickle.dumps(dem_files)
    assert pickle.loads(sent).lowest == -5.0
    (tmp_path / "dem.tif").write_bytes(DEM.read_bytes() + b" ")
    again = pickle.loads(sent)
    assert not again.blocks.is_read.any()
    assert again.lowest > 0.0


def test_terrain_on_disk_that_is_not_there_is_told(dem_files: DemFiles, tmp_path: pathlib.Path) -> None:
    sent = pickle.dumps(dem_files)
    (tmp_path / "dem.tif").unlink()
    with pytest.raises(FileNotFoundError, match=str(tmp_path / "dem.tif")):
        pickle.loads(sent)


def test_terrain_on_disk_is_refused_in_32_bits(dem_files: DemFiles) -> None:
    sent = pickle.dumps(dem_files)
    with jax.enable_x64(False), pytest.raises(RuntimeError, match=r"jaxgeo\.enable_x64\(\)"):
        pickle.loads(sent)


def test_a_rectifier_is_made_again() -> None:
    image = np.arange(12.0).reshape(3, 4)
    sensor = jaxgeo.Sensor(
        jaxgeo.FrameCamera.from_pixels(focal_px=5.0, width=4, height=3), jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir()
    )
    pose = jaxgeo.Pose.from_degrees(lat=36.3, lon=-84.1, height=5469.0, heading=160.0)
    shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees())
    dem = looks.dem()
    made = Rectifier(sensor, shot, image, jnp.ones((3, 4), bool), dem, dem.grid, hidden_tolerance=2.5)
    again = pickle.loads(without_jax(made))
    assert leaves_of(again.view) == leaves_of(made.view)
    assert [leaves_of(one) for one in again._image] == [leaves_of(one) for one in made._image]
    assert float(again._tolerance) == 2.5


def test_a_file_that_is_being_written_stays(tmp_path: pathlib.Path) -> None:
    raster = MapRaster("EPSG:32616", None, (4, 4))  # pyright: ignore[reportArgumentType]
    sink = OrthoWriter(tmp_path / "ortho.tif", raster, bands=1, dtype=np.uint8)
    for way in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match=r"ortho\.tif: an OrthoWriter .* worker"):
            way(sink)


def test_errors_of_workers_come_back() -> None:
    errors = [cls for cls in package_classes().values() if issubclass(cls, BaseException)]
    assert DemError in errors
    for cls in errors:
        error = cls.__new__(cls, "dem.tif: why")
        vars(error).update(rows=np.arange(3), outcome="lost")
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is cls
        assert str(again) == "dem.tif: why"
        assert vars(again).keys() == vars(error).keys(), cls

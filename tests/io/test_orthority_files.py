"""Parameter files of Orthority: its own cameras see what ours see, the Earth's curvature apart; refusals by key.

Held against: the cameras of the Python package orthority itself, where it is installed, and the parameter files of a
block of NGI, South Africa, as Orthority's documentation describes them.
"""

from __future__ import annotations

import copy
import json
import pathlib
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import WGS84, Sensor, Shot
from jaxgeo.earth import Geodetic, R_ecef_from_ned
from jaxgeo.io import TableError, VerticalDatumError, undulation
from jaxgeo.io.acquisitions.orthority import read_orthority, read_orthority_cameras
from jaxgeo.io.acquisitions.record import Acquisition, UnstatedDatum
from jaxgeo.sensor import BrownConrady
from jaxgeo.sensor.platform import R_ned_from_map

yaml = pytest.importorskip("yaml")

CRS = "EPSG:32734"
X, Y = 299_000.0, 6_271_500.0
PINHOLE = {"type": "pinhole", "im_size": [640, 1152], "focal_len": 120.0, "sensor_size": [92.16, 165.888]}
OPENCV = {
    "type": "opencv", "im_size": [640, 1152], "focal_len": [118.0, 121.0], "sensor_size": [92.16, 165.888],
    "cx": -0.0015, "cy": 0.00475, "k1": -0.054, "k2": 0.012, "p1": 0.0007, "p2": 0.0003, "k3": -0.006, "k4": 0.01,
    "k5": -0.002, "k6": 0.001,
}  # fmt: skip
BROWN = {
    "type": "brown", "im_size": [1368, 912], "focal_len": 0.666, "cx": 0.002, "cy": -0.001, "k1": -0.064, "k2": 0.022,
    "p1": 0.0007, "p2": 0.0003, "k3": -0.006,
}  # fmt: skip
CAMERAS = {"dmc": PINHOLE, "other lens": OPENCV}
IMAGES = {
    "a": ("dmc", [X, Y, 5200.0], [-0.006, 0.005, -3.12]),
    "b": ("other lens", [X + 2600.0, Y - 500.0, 5100.0], [0.30, -0.25, 0.7]),
    "c": ("dmc", [X - 2600.0, Y + 900.0, 5150.0], [-0.5, 0.3, 1.9]),
}


def geojson(**change: Any) -> dict[str, Any]:
    features = [
        {
            "type": "Feature",
            "properties": {"filename": name, "camera": camera, "xyz": list(xyz), "opk": list(opk)},
            "geometry": {"type": "Point", "coordinates": [24.4, -33.7, 5200.0]},
        }
        for name, (camera, xyz, opk) in IMAGES.items()
    ]
    content = {"type": "FeatureCollection", "world_crs": CRS, "features": features} | change
    return {key: value for key, value in content.items() if value is not None}


@pytest.fixture
def files(tmp_path: pathlib.Path):
    """Writes both files and returns their paths."""

    def write(cameras: Any = CAMERAS, images: Any = None, ending: str = ".geojson") -> list[pathlib.Path]:
        interior, exterior = tmp_path / "block_int_param.yaml", tmp_path / f"block_ext_param{ending}"
        interior.write_text(cameras if isinstance(cameras, str) else yaml.safe_dump(cameras), encoding="utf-8")
        images = geojson() if images is None else images
        exterior.write_text(images if isinstance(images, str) else json.dumps(images), encoding="utf-8")
        return [interior, exterior]

    return write


def seen(found: Acquisition, name: str, p_ecef: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of points in ECEF."""
    sensor, shot, _ = found.exposure(found.index_of(name))
    assert sensor is not None
    return np.asarray(_seen(sensor, shot, p_ecef))


@jax.jit
def _seen(sensor: Sensor, shot: Shot, p_ecef: Any) -> Any:
    return jax.vmap(lambda p: sensor.project_ecef(shot, p)[0])(p_ecef)


def on_plane(found: Acquisition, name: str, crs: str, offsets: np.ndarray) -> np.ndarray:
    """Points in ECEF, given in m east, north and up of the camera along the axes of a map at the camera, (n, 3)."""
    _, shot, _ = found.exposure(found.index_of(name))
    p: Geodetic = shot.pose.position
    lat, lon, _ = p.to_degrees()
    convergence = np.deg2rad(pyproj.Proj(crs).get_factors(float(lon), float(lat)).meridian_convergence)
    R = np.asarray(R_ecef_from_ned(p)) @ np.asarray(R_ned_from_map(jnp.asarray(convergence)))
    return np.asarray(WGS84.to_ecef(p)) + offsets @ R.T


def theirs(paths: list[pathlib.Path], name: str) -> Any:
    """Orthority's camera of an image."""
    factory = pytest.importorskip("orthority.factory")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return factory.FrameCameras(*map(str, paths)).get(name)


def offsets_seen(camera: Any, xyz: np.ndarray, ground: float) -> np.ndarray:
    """Where some pixels of an image meet a height of the map, in m from the camera, (n, 3)."""
    width, height = camera.im_size
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 5), np.linspace(0, height - 1, 5))
    return camera.pixel_to_world_z(np.stack([columns.ravel(), rows.ravel()]), ground).T - xyz


@pytest.mark.parametrize("name", IMAGES)
def test_cameras_and_angles_are_those_of_orthority(files, name: str) -> None:
    paths = files()
    camera = theirs(paths, name)
    xyz = np.array(IMAGES[name][1])
    offsets = offsets_seen(camera, xyz, 300.0)
    found = read_orthority(*paths, height_datum="ellipsoid")
    ours = seen(found, name, on_plane(found, name, CRS, offsets))
    np.testing.assert_allclose(ours, camera.world_to_pixel((offsets + xyz).T).T, atol=1e-5)  # px; ECEF's rounding


def test_without_a_sensor_size_pixels_are_square(files) -> None:
    paths = files({"phone": BROWN}, geojson(features=[feature("a", camera="phone")]))
    camera = theirs(paths, "a")
    xyz = np.array(IMAGES["a"][1])
    offsets = offsets_seen(camera, xyz, 300.0)
    found = read_orthority(*paths, height_datum="ellipsoid")
    ours = seen(found, "a", on_plane(found, "a", CRS, offsets))
    np.testing.assert_allclose(ours, camera.world_to_pixel((offsets + xyz).T).T, atol=1e-5)  # px


def test_the_ground_of_a_real_block_is_orthoritys_but_for_the_bent_earth(jaxgeo_test_data: pathlib.Path) -> None:
    """Points of the map as Orthority has them on a plane: taken down by r^2 / 2R and in true size, they agree."""
    folder = jaxgeo_test_data / "ngi_block" / "io"
    interior, exterior = folder / "ngi_int_param.yaml", folder / "ngi_ext_param.geojson"
    content = json.loads(exterior.read_text())
    found = read_orthority(interior, exterior, height_datum="ellipsoid")
    assert len(found) == 4
    to_lonlat = pyproj.Transformer.from_crs(content["world_crs"], 4326, always_xy=True)
    for k, one in enumerate(content["features"]):
        name, xyz = one["properties"]["filename"], np.array(one["properties"]["xyz"])
        assert found.names[k] == name
        camera = theirs([interior, exterior], name)
        x, y, z = (offsets_seen(camera, xyz, 300.0) + xyz).T
        lon, lat = to_lonlat.transform(x, y)
        expected = camera.world_to_pixel(np.stack([x, y, z])).T
        ecef = np.stack(pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(lon, lat, z), axis=-1)
        ours = seen(found, name, ecef)
        assert 0.1 < np.abs(ours - expected).max() < 1.5, "px: what a plane costs at 5 km"
        _, shot, _ = found.exposure(k)
        sin2 = np.sin(np.asarray(shot.pose.position.lat)) ** 2
        radius = WGS84.a * np.sqrt(1.0 - WGS84.e2) / (1.0 - WGS84.e2 * sin2)  # of Gauss
        flat = np.stack([x, y, z], axis=-1) - xyz
        scale = pyproj.Proj(content["world_crs"]).get_factors(lon[12], lat[12]).meridional_scale
        flat[:, :2] *= (1.0 + 300.0 / radius) / scale  # the map is of the ellipsoid, the ground 300 m above it
        flat[:, 2] -= np.sum(flat[:, :2] ** 2, axis=1) / (2.0 * radius)
        bent = camera.world_to_pixel((flat + xyz).T).T
        np.testing.assert_allclose(ours, bent, atol=3e-3)  # px; the scale is that in the middle


def test_csv_and_geojson_of_one_block_agree(jaxgeo_test_data: pathlib.Path) -> None:
    folder = jaxgeo_test_data / "ngi_block" / "io"
    interior = folder / "ngi_int_param.yaml"
    first = read_orthority(interior, folder / "ngi_ext_param.geojson", height_datum="EPSG:5773")
    second = read_orthority(interior, folder / "ngi_xyz_opk.csv", height_datum="EPSG:5773")
    assert first.names.tolist() == second.names.tolist()
    assert first.form == second.form
    np.testing.assert_allclose(first.shots.pose.heading, second.shots.pose.heading, atol=1e-5)  # written to 0.001 deg
    np.testing.assert_allclose(first.shots.pose.position.height, second.shots.pose.position.height, atol=1e-3)  # m
    _, shot, sources = second.exposure(0)
    assert sources == ()
    lat, lon, height = (float(x) for x in shot.pose.position.to_degrees())
    assert height - 5258.308 == pytest.approx(float(undulation(lat, lon)), abs=1e-3)


def test_tables_on_the_earth_and_in_a_map_agree(jaxgeo_test_data: pathlib.Path, files) -> None:
    """Of a drone, with the camera 60 deg below level; both tables are written to 0.1 deg, of other lines of sight."""
    folder = jaxgeo_test_data / "odm_miaoli"
    interior, _ = files({"dji fc6310r 5472 3648 brown 0.6666": BROWN})
    in_map = read_orthority(interior, folder / "odm_xyz_opk.csv", height_datum="ellipsoid", crs="EPSG:32651")
    on_earth = read_orthority(interior, folder / "odm_lla_rpy.csv", height_datum="ellipsoid")
    place = {pathlib.PurePath(name).stem: k for k, name in enumerate(on_earth.names)}
    rows = [place[pathlib.PurePath(name).stem] for name in in_map.names]
    np.testing.assert_allclose(in_map.shots.pose.pitch, on_earth.shots.pose.pitch[rows], atol=np.deg2rad(3.0))
    turns = in_map.shots.pose.heading - on_earth.shots.pose.heading[rows]
    np.testing.assert_allclose(np.exp(1j * turns), 1.0, atol=np.deg2rad(4.0))
    with pytest.raises(TableError, match=r"nor in odm_xyz_opk.prj beside it; pass crs="):
        read_orthority(interior, folder / "odm_xyz_opk.csv", height_datum="ellipsoid")


def feature(name: str, **change: Any) -> dict[str, Any]:
    one = copy.deepcopy(geojson()["features"][list(IMAGES).index(name)])
    one["properties"] |= change
    one["properties"] = {key: value for key, value in one["properties"].items() if value is not ...}
    return one


def test_what_one_image_is(files) -> None:
    found = read_orthority(*files(), height_datum=31.0)
    sensor, shot, sources = found.exposure(found.index_of("b"))
    assert sensor is not None
    assert isinstance(sensor.camera.distortion, BrownConrady)  # type: ignore[attr-defined]
    assert float(sensor.camera.distortion.k4) == OPENCV["k4"]  # type: ignore[attr-defined]
    assert float(shot.pose.position.height) == 5131.0
    assert float(shot.time) == 0.0
    assert sources == ()
    assert found.tags[1]["opk"] == IMAGES["b"][2]
    assert any("31 m above the ellipsoid, as given" in sentence for sentence in found.assumed)
    alone = read_orthority(*files(), height_datum=31.0, camera="dmc")
    assert alone.names.tolist() == ["a", "c"]
    assert alone.sensor is not None


def test_the_map_may_say_what_heights_are_above(files) -> None:
    paths = files(images=geojson(world_crs="EPSG:32734+5773"))
    found = read_orthority(*paths)
    lat, lon, height = (np.asarray(x) for x in found.shots.pose.position.to_degrees())
    np.testing.assert_allclose(height - [5200.0, 5100.0, 5150.0], undulation(lat, lon), atol=1e-3)  # m
    assert any("above what the file's map says" in sentence for sentence in found.assumed)
    with pytest.raises(VerticalDatumError, match=r"block_ext_param.geojson: .*height_datum"):
        read_orthority(*paths, height_datum="ellipsoid")
    with pytest.raises(UnstatedDatum, match=r"no vertical part, .* Pass height_datum="):
        read_orthority(*files())


def test_angles_are_those_of_photogrammetry(files) -> None:
    """R_map_from_image = Rx(omega) Ry(phi) Rz(kappa), and the grid's north is not the Earth's."""
    found = read_orthority(*files(), height_datum="ellipsoid")
    for name, (_, _, opk) in IMAGES.items():
        sensor, shot, _ = found.exposure(found.index_of(name))
        assert sensor is not None
        centre, R = jax.jit(lambda sensor, shot: tuple(sensor.sight(shot)))(sensor, shot)
        R_map_from_image = Rotation.from_euler("XYZ", opk).as_matrix()
        right, ahead = on_plane(found, name, CRS, (R_map_from_image @ [[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]).T)
        np.testing.assert_allclose(right - centre, R[:, 0], atol=1e-7)
        np.testing.assert_allclose(ahead - centre, R[:, 2], atol=1e-7)


def test_one_camera_needs_no_name(files) -> None:
    flat = {"name": "dmc"} | PINHOLE
    images = geojson(features=[feature("a", camera=None), feature("c", camera=None)])
    for cameras in (flat, {"any": PINHOLE}):
        assert len(read_orthority(*files(cameras, images), height_datum="ellipsoid")) == 2
    with pytest.raises(TableError, match="image a has no camera, and there are dmc, other lens; name one"):
        read_orthority(*files(CAMERAS, images), height_datum="ellipsoid")


def camera(**change: Any) -> dict[str, Any]:
    one = {key: value for key, value in (OPENCV | change).items() if value is not ...}
    return {"dmc": PINHOLE, "other lens": one}


WRONG_CAMERAS: dict[str, tuple[Any, str]] = {
    "fisheye": (camera(type="fisheye"), "other lens: type 'fisheye' is not read; only pinhole, brown, opencv are"),
    "rpc": ({"a.tif": {"type": "rpc", "rpc": {}}}, "a.tif: type 'rpc' is not read"),
    "no type": (camera(type=...), "other lens: type is missing"),
    "tilt": (camera(tx=0.1), "other lens: tx is not zero; a lens with thin prism or tilt is not read"),
    "prism": (camera(s3=0.1), "other lens: s3 is not zero"),
    "strange": (camera(k9=0.1), "other lens: k9 is not a parameter of type opencv"),
    "of another type": (camera(type="brown"), "other lens: k4 is not a parameter of type brown"),
    "size": (camera(im_size=[640.5, 1152]), "other lens: im_size must be whole numbers of pixels"),
    "one side": (camera(im_size=640), "other lens: im_size must be two numbers; got 640"),
    "focal": (camera(focal_len=0), "other lens: focal_len must be above zero; got 0"),
    "text": (camera(k1="1e-3"), "other lens: k1 must be a finite number; got '1e-3'"),
    "upright": (camera(sensor_size=...), "of an upright image, write sensor_size too"),
    "several sizes": (camera(im_size=[1152, 640]), "'dmc' 640 x 1152, 'other lens' 1152 x 640; choose one"),
    "unknown": ({"dmc": PINHOLE}, "images are of camera 'other lens', but known are dmc"),
    "not yaml": ("dmc: [", "not a YAML file"),
    "a list": ("- 1", r"expected cameras by name; got \[1\]"),
    "empty": ("", "expected cameras by name; got None"),
    "twice": ("dmc: {type: pinhole, type: brown}", "'type' stands twice in one table"),
    "a key of no text": ("dmc: {~: brown, 1: 2}", "dmc: type is missing; found None, 1"),
    "bomb": ("a: &a [1, 1]\nb: [*a, *a]", "line 2: references"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_CAMERAS)
def test_wrong_cameras(files, case: str) -> None:
    cameras, words = WRONG_CAMERAS[case]
    with pytest.raises(TableError, match=f"block_.*{words}"):
        read_orthority(*files(cameras), height_datum="ellipsoid")


WRONG_IMAGES: dict[str, tuple[Any, str]] = {
    "no map": (geojson(world_crs=None), "world_crs is missing; found type, features"),
    "unknown map": (geojson(world_crs="EPSG:0"), "'EPSG:0' is unknown to PROJ"),
    "degrees as a map": (geojson(world_crs="EPSG:4326"), "is no map; expected a projected CRS"),
    "feet": (geojson(world_crs="EPSG:2277"), "is in US survey foot"),
    "none": (geojson(features=[]), r"features must be a list of images; got \[\]"),
    "twice": (geojson(features=[feature("a"), feature("a")]), "image a is there twice"),
    "no name": (geojson(features=[feature("a", filename=...)]), r"features\[0\]: filename is missing"),
    "degrees": (geojson(features=[feature("a", opk=[0.5, 0.1, -179.0])]), "beyond a turn; GeoJSON of Orthority is in"),
    "two": (geojson(features=[feature("a", xyz=[1.0, 2.0])]), "a: xyz must be three numbers"),
    "nan": (geojson(features=[feature("a", xyz=[1.0, 2.0, float("nan")])]), "a: xyz must be a finite number; got nan"),
    "height": (geojson(features=[feature("a", xyz=[X, Y, 3e6])]), "a: xyz .* has no place in .*, or no height"),
    "not json": ("{", "not a JSON file, or cut off"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_IMAGES)
def test_wrong_images(files, case: str) -> None:
    images, words = WRONG_IMAGES[case]
    with pytest.raises(TableError, match=f"block_ext_param.geojson.*{words}"):
        read_orthority(*files(images=images), height_datum="ellipsoid")


def test_what_the_caller_gives_wrong(files, tmp_path: pathlib.Path) -> None:
    with pytest.raises(TableError, match=r"world_crs is 'EPSG:32734', but crs='EPSG:32735'; leave crs= out"):
        read_orthority(*files(), height_datum="ellipsoid", crs="EPSG:32735")
    with pytest.raises(TableError, match=r"no image is of camera='ccd'; they are of dmc, other lens"):
        read_orthority(*files(), height_datum="ellipsoid", camera="ccd")
    with pytest.raises(FileNotFoundError, match="no such interior parameter file"):
        read_orthority_cameras(tmp_path / "nowhere.yaml")
    interior, exterior = files({"dmc": PINHOLE}, "filename,x,y,z,omega,phi,kappa\na,1,2,3,0,0,0\n", ending=".csv")
    exterior.with_suffix(".prj").write_bytes(b"\xff\xfe not a map")
    with pytest.raises(TableError, match="not a map' is unknown to PROJ"):
        read_orthority(interior, exterior, height_datum="ellipsoid")
    interior, exterior = files(images="filename,x,y,z,roll,pitch,yaw\na,1,2,3,0,0,0\n", ending=".csv")
    with pytest.raises(TableError, match="x with roll, or latitude with omega, are not read"):
        read_orthority(interior, exterior, height_datum="ellipsoid")

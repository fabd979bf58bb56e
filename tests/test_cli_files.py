"""Files of exposures in the commands about whole images: the same answers as for a scene of the same exposure."""

from __future__ import annotations

import csv
import json
import pathlib

import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import shapely
from pyarrow import parquet
from pyogrio import raw
from support.command_files import DJI, LAT, LON, SMALL_POSE, prepare
from support.command_runner import CliRunner
from support.drone_image_files import FULL, packet, write_image

import jaxgeo
from jaxgeo import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.cli import app
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.rotations import heading_pitch_roll_from_R

ELLIPSOID = ["--camera-datum", "ellipsoid"]
GROUND = ["--dem", "dem.tif"]
LEVEL = ["--ground", "300"]


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def done(*arguments: str | pathlib.Path) -> dict:
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2
    for word in words:
        assert word in result.stderr.replace("\n", " ")
    assert "Traceback" not in result.output


def image(path: pathlib.Path, lat: float, **more: str) -> None:
    tags = DJI | {"drone-dji:GpsLatitude": f"{lat:+.7f}"} | {f"drone-dji:{key}": text for key, text in more.items()}
    write_image(path, packet(tags), make="DJI", size=FULL)


@pytest.fixture
def here(tmp_path: pathlib.Path, monkeypatch) -> pathlib.Path:
    """A drone image, a scene of it, three images of a strip of which one is cut, telemetry, and a DEM."""
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "DJI_0042.JPG dem.tif flight.klv")
    (tmp_path / "strip").mkdir()
    image(tmp_path / "strip" / "a.jpg", LAT)
    image(tmp_path / "strip" / "b.jpg", LAT - 0.0001)
    image(tmp_path / "strip" / "c.jpg", LAT - 0.0002, CalibratedFocalLength="3500")
    broken = tmp_path / "strip" / "d.jpg"
    broken.write_bytes((tmp_path / "strip" / "a.jpg").read_bytes()[:900])
    return tmp_path


@pytest.fixture(scope="module")
def text_of_scene(tmp_path_factory: pytest.TempPathFactory) -> str:
    """That of DJI_0042.JPG."""
    folder = tmp_path_factory.mktemp("scene")
    prepare(folder, "DJI_0042.JPG")
    result = run("scene", folder / "DJI_0042.JPG", *ELLIPSOID, "-o", folder / "scene.toml")
    assert result.exit_code == 0, result.output
    return (folder / "scene.toml").read_text()


def scene_of(name: str, *more: str) -> pathlib.Path:
    result = run("scene", name, *ELLIPSOID, *more, "-o", "scene.toml")
    assert result.exit_code == 0, result.output
    return pathlib.Path("scene.toml")


@pytest.mark.costly
@pytest.mark.parametrize(
    "name, more, accuracy",
    [
        ("DJI_0042.JPG", (), "--accuracy"),
        ("flight.klv", ("--exposure", "1"), "--no-accuracy"),
        pytest.param("flight.klv", ("--exposure", "1"), "--accuracy", marks=pytest.mark.slow),
    ],
)
def test_a_scene_of_a_file_is_located_as_the_file(
    here: pathlib.Path, name: str, more: tuple[str, ...], accuracy: str
) -> None:
    scene = scene_of(name, *more)
    flat = ("--ground", "300", "--pixel", "100,200", accuracy)
    by_file = done("locate", name, *ELLIPSOID, *more, *flat)["fixes"][0]
    by_scene = done("locate", scene, *flat)["fixes"][0]
    for key in ("fix_lat_deg", "fix_lon_deg", "fix_height_m", "slant_range_m"):
        assert by_scene[key] == pytest.approx(by_file[key], abs=1e-9, rel=1e-9), key
    for key in ("ce90_m", "le90_m") if accuracy == "--accuracy" else ():
        assert by_scene[key] == pytest.approx(by_file[key], rel=1e-4), key


def test_a_scene_says_what_it_assumes(here: pathlib.Path) -> None:
    told = done("scene", "DJI_0042.JPG", *ELLIPSOID, "-o", "scene.toml")
    assert told["exposure"] == "DJI_0042.JPG"
    lines = pathlib.Path("scene.toml").read_text().splitlines()
    assert lines[0] == "# DJI_0042.JPG"
    assert told["assumed"]
    for one in told["assumed"]:
        assert f"# assumed: {one}" in lines
    assert read_scene("scene.toml").sensor.gimbal.reference == "level"


@pytest.mark.costly
def test_a_footprint_of_an_image_is_that_of_its_scene(here: pathlib.Path) -> None:
    scene = scene_of("DJI_0042.JPG")
    (of_file,) = done("footprint", "DJI_0042.JPG", *ELLIPSOID, *LEVEL)["footprints"]
    (of_scene,) = done("footprint", scene, *LEVEL)["footprints"]
    assert of_file.pop("name") == "DJI_0042.JPG"
    assert of_file["area_km2"] == pytest.approx(of_scene["area_km2"], rel=1e-6)
    for one, other in zip(of_file["outline"], of_scene["outline"], strict=True):
        assert one["lat_deg"] == pytest.approx(other["lat_deg"], abs=1e-9)


@pytest.mark.costly
def test_a_folder_has_a_footprint_for_each_image_and_tells_what_it_cannot_read(here: pathlib.Path) -> None:
    told = done("footprint", "strip", *ELLIPSOID, *LEVEL, "-o", "out.geojson")
    assert [one["name"] for one in told["footprints"]] == ["a.jpg", "b.jpg", "c.jpg"]
    assert list(told["unread"]) == ["strip/d.jpg"]
    features = json.loads(pathlib.Path("out.geojson").read_text())["features"]
    assert [one["properties"]["name"] for one in features] == ["a.jpg", "b.jpg", "c.jpg"]
    shown = run("footprint", "strip", *ELLIPSOID, *LEVEL)
    assert "not read: strip/d.jpg" in shown.stderr
    assert "b.jpg" in shown.stdout


@pytest.mark.slow
def test_overlaps_of_a_folder_are_of_consecutive_images_also_of_two_cameras(here: pathlib.Path) -> None:
    pairs = done("overlap", "strip", *ELLIPSOID, *GROUND)["pairs"]
    assert [(one["before"], one["after"]) for one in pairs] == [("a.jpg", "b.jpg"), ("b.jpg", "c.jpg")]
    # 0.0001 degrees of latitude are 11.1 m; the second pair has a wider camera, whose far edge reaches further
    assert pairs[0]["status"] == pairs[1]["status"] == "hit"
    assert pairs[0]["step_m"] == pytest.approx(11.1, rel=0.2)
    pathlib.Path("strip/c.jpg").unlink()
    image(pathlib.Path("strip/c.jpg"), LAT - 0.0002)
    same = done("overlap", "strip", *ELLIPSOID, *GROUND)["pairs"]
    assert same[0]["least"] == pytest.approx(pairs[0]["least"], abs=1e-9)
    assert pairs[1]["far"] > same[1]["far"]


@pytest.mark.costly
def test_pointing_from_an_image_is_that_from_its_scene(here: pathlib.Path) -> None:
    target = ("--target", f"{LAT - 0.002},{LON},300")
    target += ("--target-datum", "ellipsoid")
    of_file = done("point", "DJI_0042.JPG", *target, *ELLIPSOID)["readings_deg"]
    of_scene = done("point", scene_of("DJI_0042.JPG"), *target)["readings_deg"]
    np.testing.assert_allclose(list(of_file.values()), list(of_scene.values()), atol=1e-9)
    assert list(of_file) == ["yaw", "pitch", "roll"]


MISTAKES = [
    (["footprint", *GROUND], ["give a FILE", "--scene SCENE.toml"]),
    (["footprint", "DJI_0042.JPG", "--shots", "x.csv", *GROUND], ["--shots x.csv: use it with --scene, not with DJI"]),
    (["footprint", "scene.toml", "--exposure", "a", *GROUND], ["--exposure a needs a FILE of exposures"]),
    (["footprint", "scene.toml", "--scene", "scene.toml", *GROUND], ["is itself a scene file; leave out --scene"]),
    (["footprint", "scene.toml", "--takeoff-height", "8", *GROUND], ["--takeoff-height is for a FILE of exposures"]),
    (["footprint", "scene.toml", *ELLIPSOID, *GROUND], ["--camera-datum ellipsoid applies to the heights of a FILE"]),
    (["overlap", *GROUND], ["give FILEs of exposures, or --scene with --navigation"]),
    (["overlap", "DJI_0042.JPG", *ELLIPSOID, *GROUND], ["DJI_0042.JPG: overlap needs at least two exposures"]),
    (["overlap", "strip", "--navigation", "n.csv", "--times", "1,2", *GROUND], ["give FILEs of exposures, or --scene"]),
    (
        ["point", "strip", *ELLIPSOID, "--target", "1,2,3", "--target-datum", "0"],
        ["strip has 3 exposures; name one with --exposure a.jpg"],
    ),
    (
        ["point", "DJI_0042.JPG", "--target", "1,2,3"],
        ["--target 1,2,3: say what its height is above, with --target-datum"],
    ),
    (["scene", "flight.klv", *ELLIPSOID, "-o", "o.toml"], ["has 2 exposures: 0, 1. Name one with --exposure 0"]),
    (["scene", "DJI_0042.JPG", *ELLIPSOID, "-o", "o.txt"], ["--output o.txt", "use .toml"]),
    (["scene", "DJI_0042.JPG", "-o", "o.toml"], ["--camera-datum"]),
    (
        ["register", "DJI_0042.JPG", "--reference", "dem.tif", *GROUND, "--scene", "scene.toml", *ELLIPSOID, "-o", "o"],
        ["--camera-datum is for an IMAGE that states its own pose; leave it out with --scene"],
    ),
    (
        ["register", "DJI_0042.JPG", "--reference", "dem.tif", *GROUND, "--scene", "bare.toml", "-o", "o"],
        ["--position-sigma is missing, and bare.toml states none"],
    ),
]


@pytest.mark.costly
@pytest.mark.parametrize("arguments, words", MISTAKES)
def test_mistakes(here: pathlib.Path, text_of_scene: str, arguments: list[str], words: list[str]) -> None:
    pathlib.Path("scene.toml").write_text(text_of_scene)
    pathlib.Path("bare.toml").write_text(text_of_scene.split("[errors]")[0])
    before = {path.name for path in here.iterdir()}
    assert_refused(run(*arguments), *words)
    assert {path.name for path in here.iterdir()} == before


@pytest.mark.slow
def test_an_image_is_registered_from_its_own_tags(here: pathlib.Path) -> None:
    """A drone image rendered from a map with one pose, whose tags state another: registered without a scene."""
    prepare(here, "register image.tif --reference ortho.tif")
    truth = Pose.from_degrees(**SMALL_POSE)
    down = truth.R_ned_from_body @ jnp.asarray(Mount.nadir().R_head_from_camera)
    angles = heading_pitch_roll_from_R(down @ jnp.asarray(Mount.forward().R_head_from_camera).T)
    yaw, pitch, roll = (float(np.rad2deg(angle)) for angle in angles)
    tags = {
        "AbsoluteAltitude": f"{SMALL_POSE['height'] + 8.0:+.3f}",
        "GpsLatitude": f"{SMALL_POSE['lat'] + 15.0 / 111_000.0:+.8f}",
        "GpsLongitude": f"{SMALL_POSE['lon']:+.8f}",
        "GimbalYawDegree": f"{yaw + 0.2:+.6f}",
        "GimbalPitchDegree": f"{pitch - 0.1:+.6f}",
        "GimbalRollDegree": f"{roll:+.6f}",
        "CalibratedFocalLength": "4687.5",  # of the full image, which is 4000 pixels wide
    }
    with rasterio.open("image.tif") as data:
        grey = data.read(1)
    xmp = packet(DJI | {f"drone-dji:{name}": text for name, text in tags.items()})
    write_image(here / "drone.jpg", xmp, make="DJI", grey=grey)
    told = done("register", "drone.jpg", "--reference", "ortho.tif", *GROUND, *ELLIPSOID, "--gimbal-sigma", "0.3",
                "--position-sigma", "20", "--reference-sigma", "1", "-o", "out")  # fmt: skip
    before, after = (told["pixels"][0][name] for name in ("before", "after"))
    camera = FrameCamera.from_pixels(focal_px=300.0, width=256, height=192)
    fix = jaxgeo.locate(Sensor(camera, Gimbal.fixed(), Mount.nadir()), Shot(truth), (127.5, 95.5), example_dem())
    lat, lon, _ = (float(one) for one in fix.position.to_degrees())

    def miss(found: dict) -> float:
        east = (found["lon_deg"] - lon) * 111_320.0 * np.cos(np.deg2rad(lat))
        return float(np.hypot((found["lat_deg"] - lat) * 110_940.0, east))

    assert miss(before) > 10.0
    assert miss(after) < 3.0
    assert after["ce90_m"] < before["ce90_m"]
    assert read_scene("out/scene.toml").sensor.gimbal.names == ("yaw", "pitch", "roll")


DETECTED = (
    "image,label,u_min,v_min,u_max,v_max\na.jpg,car,1900,1400,1960,1450\nx.jpg,car,1,1,2,2\nb.jpg,hut,5,5,90,80\n"
)


@pytest.mark.costly
def test_detections_are_points_and_polygons_on_the_ground(here: pathlib.Path) -> None:
    pathlib.Path("found.csv").write_text(DETECTED)
    told = done("locate", "strip", *ELLIPSOID, "--ground", "300", "--detections", "found.csv", "--no-accuracy", "-o",
                "out.geojson")  # fmt: skip
    assert [(one["name"], one["label"], one["status"]) for one in told["fixes"]] == [
        ("a.jpg", "car", "hit"), ("x.jpg", "car", "file_not_read"), ("b.jpg", "hut", "hit")]  # fmt: skip
    assert [one["outline_status"] for one in told["fixes"]] == ["hit", None, "hit"]
    alone = done("locate", "strip/a.jpg", *ELLIPSOID, "--ground", "300", "--pixel", "1930,1425", "--no-accuracy")
    for key in ("fix_lat_deg", "fix_lon_deg"):
        assert told["fixes"][0][key] == pytest.approx(alone["fixes"][0][key], abs=1e-10)
    features = json.loads(pathlib.Path("out.geojson").read_text())["features"]
    shapes = [one for one in features if one["properties"]["kind"] == "detection"]
    assert [one["properties"]["index"] for one in shapes] == [0, 2]
    for one in shapes:
        point = features[one["properties"]["index"]]["geometry"]["coordinates"]
        outline = shapely.geometry.shape(one["geometry"])
        assert outline.contains(shapely.Point(point[:2]))
        assert outline.is_valid


@pytest.mark.costly
def test_classes_of_yolo_have_their_names(here: pathlib.Path) -> None:
    """Those of the data set, for labels that a detector wrote elsewhere."""
    labels = pathlib.Path("runs/predict/labels")
    labels.mkdir(parents=True)
    (labels / "a.txt").write_text("2 0.5 0.5 0.02 0.02 0.81\n0 0.4 0.5 0.02 0.02 0.77\n")
    pathlib.Path("data.yaml").write_text("path: .\ntrain: images\nval: images\nnames:\n  0: hut\n  2: car\n")
    line = ["locate", "strip", *ELLIPSOID, "--ground", "300", "--detections", labels, "--no-accuracy"]
    plain, named = done(*line), done(*line, "--class-names", "data.yaml")
    assert [one["label"] for one in plain["fixes"]] == ["2", "0"]
    assert [one["label"] for one in named["fixes"]] == ["car", "hut"]
    assert not any("no name in" in one for one in named["assumed"])
    pathlib.Path("data.yaml").write_text("names: [hut, car]\n")
    short = done(*line, "--class-names", "data.yaml")
    assert [one["label"] for one in short["fixes"]] == ["2", "hut"]
    assert sum("Class 2 has no name in data.yaml" in one for one in short["assumed"]) == 1


@pytest.mark.costly
@pytest.mark.parametrize("ending", [".csv", ".gpkg", ".kml", ".parquet"])
def test_outlines_of_detections_are_in_every_format(here: pathlib.Path, ending: str) -> None:
    pathlib.Path("found.csv").write_text(DETECTED)
    written = ["--detections", "found.csv", "--anchor", "bottom", "--pixel-origin", "corner", "-o", f"out{ending}"]
    told = done("locate", "strip", *ELLIPSOID, "--ground", "300", *written)
    assert told["fixes"][0]["ce90_m"] > 0.0
    path = f"out{ending}"
    if ending == ".csv":
        with open(path, newline="", encoding="utf-8") as stream:
            shapes = [shapely.from_wkt(row["detection"]) for row in csv.DictReader(stream) if row["detection"]]
    elif ending == ".gpkg":
        shapes = list(shapely.from_wkb(raw.read(path, layer="detections")[2]))
    elif ending == ".kml":
        text = pathlib.Path(path).read_text(encoding="utf-8")
        assert "<name>Detections</name>" in text
        assert "car in a.jpg" in text
        return
    else:
        found = parquet.read_table(path).column("detection").to_pylist()
        shapes = [shapely.from_wkb(one) for one in found if one is not None]
    assert len(shapes) == 2
    for shape, one in zip(shapes, (told["fixes"][0], told["fixes"][2]), strict=True):
        ring = np.array(one["outline"])[:, :2]
        assert shapely.Polygon(ring).symmetric_difference(shape).area < 1e-3 * shape.area


@pytest.mark.costly
@pytest.mark.parametrize(
    "arguments, words",
    [
        (["DJI_0042.JPG", "--anchor", "bottom"], ["--anchor bottom goes with --detections FILE"]),
        (["DJI_0042.JPG", "--detections", "f.csv", "--pixel", "1,2"], ["either --pixel", "or --detections FILE"]),
        (["DJI_0042.JPG", "--detections", "f.csv", "--anchor", "top"], ["--anchor top: expected centre or bottom"]),
        (["DJI_0042.JPG", "--detections", "f.csv", "--pixel-origin", "x"], ["--pixel-origin x: expected centre"]),
        (["DJI_0042.JPG", "--detections", "f.csv", "--shard", "1/2"], ["--shard and --detections do not go together"]),
        (["DJI_0042.JPG", "--class-names", "data.yaml"], ["--class-names data.yaml goes with --detections FILE"]),
        (
            ["DJI_0042.JPG", "--detections", "f.csv", "--class-names", "data.yaml"],
            ["--class-names data.yaml goes with a folder of YOLO files, but --detections f.csv is a file"],
        ),
        (["--scene", "scene.toml", "--detections", "f.csv"], ["--detections f.csv needs FILEs of images"]),
        (["DJI_0042.JPG", "--detections", "f.csv"], ["they name x.jpg; the images are DJI_0042.JPG"]),
        (["DJI_0042.JPG", "--detections", "none.csv"], ["none.csv"]),
        (["DJI_0042.JPG", "--detections", "f.csv", "--cluster", "local:1"], ["f.csv and --cluster do not go together"]),
    ],
)
def test_mistakes_of_detections(here: pathlib.Path, text_of_scene: str, arguments: list[str], words: list[str]) -> None:
    pathlib.Path("f.csv").write_text("image,u,v\nx.jpg,1,2\n")
    pathlib.Path("scene.toml").write_text(text_of_scene)
    of_file = [] if "--scene" in arguments else ELLIPSOID
    assert_refused(run("locate", *arguments, *of_file, "--ground", "300"), *words)

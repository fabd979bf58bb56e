"""`jaxgeo adjust` on a folder of rendered images: written orientations against the poses that rendered them."""

from __future__ import annotations

import json
import pathlib
import re
import shlex
import shutil
import sys

import jax
import numpy as np
import pyproj
import pytest
import rasterio
from PIL import Image
from scipy.spatial.transform import Rotation
from support.command_runner import CliRunner
from support.image_folder import ImageFolder, write_folder

from jaxgeo import FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.adjust import LocalFrame
from jaxgeo.cli import app
from jaxgeo.io import Orientations, read_dem, read_observations, read_opensfm, read_orientations, rectify_file
from jaxgeo.sensor import NoDistortion

pytestmark = pytest.mark.costly

DATUM = ("--dem-datum", "ellipsoid")
OPTIONS = (*DATUM, "--dem-sigma", "3", "--points", "60")


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, ["adjust", *map(str, arguments)])


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("jaxgeo: ")
    for word in words:
        assert word in last


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> ImageFolder:
    return write_folder(tmp_path_factory.mktemp("adjust"), count=5)


@pytest.fixture(scope="module")
def done(here: ImageFolder, tmp_path_factory):
    """(folder of results, content of --json)."""
    out = tmp_path_factory.mktemp("adjusted") / "new"
    result = run(*here.arguments, *OPTIONS, "-o", out, "--json")
    assert result.exit_code == 0, result.output
    return out, json.loads(result.stdout)


def away_of(here: ImageFolder, found: Orientations) -> np.ndarray:
    """Errors (n, 6) of orientations: centres east, north, up in m, and rotations about the camera's axes in rad."""
    away = []
    for k, name in enumerate(found.names):
        exposure = here.true[here.names.index(str(name))]
        assert isinstance(exposure.motion, Shot)
        pose = jax.tree.map(lambda x, k=k: x[k], found.pose)
        true = exposure.sensor.sight(exposure.motion)
        sight = Sensor(exposure.sensor.camera, Gimbal.fixed(), Mount.nadir()).sight(Shot(pose, np.zeros(0)))
        R = np.asarray(LocalFrame(exposure.motion.pose.position).R_ecef_from_local)
        turn = np.asarray(true.R_ecef_from_camera).T @ np.asarray(sight.R_ecef_from_camera)
        moved = R.T @ (np.asarray(sight.centre) - np.asarray(true.centre))
        away.append(np.concatenate([moved, Rotation.from_matrix(turn).as_rotvec()]))
    return np.array(away)


def test_written_orientations_are_near_the_truth(here: ImageFolder, done) -> None:
    """Within their standard deviations, and relative to each other far better than the tags."""
    out, content = done
    found = read_orientations(out / "orientations.csv", height_datum="ellipsoid")
    assert found.names.tolist() == here.names[:4]
    assert found.sigma is not None
    away = away_of(here, found)
    sigma = found.sigma[:, [1, 0, 2]]
    assert np.all(np.abs(away[:, :3]) < 3.5 * sigma)
    assert np.all(np.abs(away[:, 3:]) < 3.5 * np.max(found.sigma[:, 3:], axis=1, keepdims=True))
    moved = np.array([[row[f"{axis}_m"] for axis in ("east", "north", "up")] for row in content["adjusted"]])
    tags = away[:, :3] - moved
    assert np.std(tags[:, 2]) > 2.0  # the errors in the tags, m
    assert np.std(away[:, 2]) < 0.5 * np.std(tags[:, 2])


@pytest.mark.slow
def test_a_mosaic_shows_what_the_images_show(tmp_path, here, done) -> None:
    """Grey values of its cells against the image rectified with its true pose: the adjusted images lie where they
    should, to a fraction of the texture's width."""
    out = tmp_path / "out"
    shutil.copytree(done[0], out)
    result = run(*here.arguments, *OPTIONS, "-o", out, "--mosaic", out / "m.tif", "--resolution", "0.8", "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)["mosaic"]
    assert set(told["cells_by_image"]) == set(here.names[:4])
    assert sum(told["cells_by_image"].values()) == told["known"] > 10_000
    true = here.true[1]
    terrain = read_dem(here.dem, vertical_datum="ellipsoid")
    alone = rectify_file(
        tmp_path / "1.tif", here.images / here.names[1], true.sensor, true.motion, terrain, crs=told["crs"],
        resolution=0.8,
    )  # fmt: skip
    with rasterio.open(alone.path) as one, rasterio.open(out / "m.tif") as mosaic:
        first = [round(x) for x in mosaic.index(one.transform.c + 0.4, one.transform.f - 0.4)]
        of_one, of_mosaic = (tuple(slice(max(sign * x, 0), None) for x in first) for sign in (-1, 1))
        seen, known = mosaic.read(1)[of_mosaic].astype(float), mosaic.read_masks(1)[of_mosaic] > 0
        expected, both = one.read(1)[of_one].astype(float), one.read_masks(1)[of_one] > 0
        assert mosaic.nodata is None
    rows, cols = (min(x, y) for x, y in zip(seen.shape, expected.shape, strict=True))
    seen, known, expected, both = (x[:rows, :cols] for x in (seen, known, expected, both))
    both &= known
    assert both.mean() > 0.4
    assert np.corrcoef(seen[both], expected[both])[0, 1] > 0.5


HEADER = "image,point,u,v,lat_deg,lon_deg,height_m,role"


@pytest.fixture(scope="module")
def surveyed(here: ImageFolder) -> list[list[str]]:
    """Rows of surveyed points on a lattice in the images that show them, with errors of 0.3 px and 2 cm."""
    rng = np.random.default_rng(4)
    lat, lon = 47.0 + np.linspace(-1.0, 0.6, 6) * 8e-4, 11.0 + np.array([0.3, -0.5, 0.6]) * 8e-4
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978").transform
    cameras = []
    for exposure in here.true[:4]:
        assert isinstance(exposure.motion, Shot)
        camera, sight = exposure.sensor.camera, exposure.sensor.sight(exposure.motion)
        assert isinstance(camera, FrameCamera)
        assert isinstance(camera.distortion, NoDistortion)
        cameras.append(
            [np.asarray(x) for x in (sight.centre, sight.R_ecef_from_camera, camera.focal_px, camera.principal_px)]
        )
    rows = []
    for number, (north, east) in enumerate((x, y) for x in lat for y in lon):
        height = 515.0 + rng.uniform(-10.0, 10.0)
        survey = [north + 2e-7 * rng.normal(), east + 2.6e-7 * rng.normal(), height + 0.02 * rng.normal()]
        place = np.array(to_ecef(north, east, height))
        for name, (centre, R_ecef_from_camera, focal, principal) in zip(here.names, cameras, strict=False):
            away = R_ecef_from_camera.T @ (place - centre)
            u, v = principal + focal * away[:2] / away[2]
            if 3.0 < u < 252.0 and 3.0 < v < 188.0 and away[2] > 0.0:
                pixel = [f"{x + 0.3 * rng.normal():.3f}" for x in (u, v)]
                rows.append([name, f"point {number}", *pixel, *(f"{x:.10f}" for x in survey), "control"])
    return rows


def write_points(path: pathlib.Path, rows: list[list[str]]) -> pathlib.Path:
    path.write_text("\n".join([HEADER, *(",".join(row) for row in rows), ""]))
    return path


GCP = ("--gcp-datum", "ellipsoid", "--gcp-sigma", "0.02", "--pixel-sigma", "0.3")


@pytest.mark.parametrize(
    "change, options, words",
    [
        ("", ("--gcp-datum", ""), "state the vertical datum of its heights with --gcp-datum"),
        ("", ("--gcp-sigma", "0"), "--gcp-sigma 0: must be above 0"),
        ("", ("--pixel-origin", "middle"), "expected centre or corner"),
        ("", ("--gcp-datum", "EPSG:0"), "points.csv: --gcp-datum 'EPSG:0' is unknown"),
        ("tie", (), "point tie 3 has the name of a tie point"),
        ("", ("--check", "point 99"), "--check point 99 is not among the points"),
        ("empty", (), "the file of check points is empty"),
        ("image", (), "image other.jpg of point point 0 is not among the images"),
        ("pixel", (), "pixel 300, 20 lies outside of image"),
        ("datum", (), "points lie far from the rays of their pixels: moved by"),
        ("name", (), "lies far from the rays of its pixels"),
    ],
)
def test_control_that_does_not_belong_to_the_images_is_refused(
    tmp_path, here, surveyed, change, options, words
) -> None:
    """Before any image is matched."""
    rows = [list(row) for row in surveyed]
    if change == "image":
        rows[0][0] = "other.jpg"
    if change == "tie":
        rows = [[row[0], "tie 3", *row[2:]] if row[1] == rows[0][1] else row for row in rows]
    if change == "pixel":
        rows[0][2:4] = ["300", "20"]
    if change == "datum":
        rows = [[*row[:6], f"{float(row[6]) + 700.0}", row[7]] for row in rows]
    if change == "name":
        names = list(dict.fromkeys(row[1] for row in rows))
        other = {names[0]: names[-1], names[-1]: names[0]}
        rows = [[row[0], other.get(row[1], row[1]), *row[2:]] for row in rows]
        places = {row[1]: row[4:7] for row in surveyed}
        rows = [[*row[:4], *places[row[1]], row[7]] for row in rows]
    table = write_points(tmp_path / "points.csv", rows)
    if change == "empty":
        table.write_text("")
    given = dict(zip(GCP[::2], GCP[1::2], strict=True)) | dict([options] if options else [])
    typed = [word for option, value in given.items() if value for word in (option, value)]
    result = run(*here.arguments, *OPTIONS, "-o", tmp_path / "out", "--gcp", table, *typed)
    assert_refused(result, words)
    assert not (tmp_path / "out" / "matches").exists()


def test_options_of_control_need_it(tmp_path, here) -> None:
    result = run(*here.arguments, *OPTIONS, "-o", tmp_path / "out", "--check", "p")
    assert_refused(result, "--check is for control points; give --gcp FILE too")


def test_summary_has_what_was_found(here: ImageFolder, done) -> None:
    out, content = done
    assert content["unconnected"] == [here.names[4]]
    assert content["residuals_rms_px"]["after"] < 0.2 < content["residuals_rms_px"]["before"]
    ties = (out / "ties.csv").read_text().splitlines()
    assert len(ties) - 1 == content["measurements"]["used"]


@pytest.mark.slow
def test_images_on_a_map_carry_it_to_the_others(here: ImageFolder, done, tmp_path: pathlib.Path) -> None:
    """Two images are asked for, of which one shows noise: all that are tied gain from the other."""
    chosen = ("--register", here.names[0], "--register", here.names[4])
    result = run(
        *here.arguments,
        *OPTIONS,
        "--reference",
        here.map,
        "--reference-sigma",
        "0.3",
        *chosen,
        "-o",
        tmp_path,
        "--json",
    )
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["registered"] == [here.names[0]]
    assert content["registrations"][here.names[0]] == "registered"
    assert content["registrations"][here.names[4]] != "registered"
    assert f"not registered: {here.names[4]}" in result.stderr
    plain, found = (
        read_orientations(out / "orientations.csv", height_datum="ellipsoid") for out in (done[0], tmp_path)
    )
    assert plain.sigma is not None
    assert found.sigma is not None
    assert found.names.tolist() == plain.names.tolist()
    assert np.all(found.sigma[:, 1] < 0.5 * plain.sigma[:, 1])  # east, across the strip
    assert np.all(found.sigma < plain.sigma)
    assert np.all(np.diff(found.sigma[:, 0]) > 0.0)  # north, along it: the further from the registered image, the less
    assert np.all(found.sigma[:, :2] > 0.3)  # the map's own
    away = away_of(here, found)
    assert np.all(np.abs(away[:, :3]) < 3.5 * found.sigma[:, [1, 0, 2]])
    assert "Registered to the map: image_0.jpg" in " ".join(content["words"])


@pytest.mark.parametrize(
    "options, words",
    [
        (("--reference-sigma", "1"), "--reference-sigma is for images that are registered; give --reference FILE too"),
        (("--register", "a.jpg"), "--register is for images that are registered; give --reference FILE too"),
        (("--reference", "map.tif", "--reference-sigma", "-1"), "--reference-sigma"),
    ],
)
def test_options_of_the_map_are_checked_first(here: ImageFolder, tmp_path: pathlib.Path, options, words) -> None:
    assert_refused(run(*here.arguments, *OPTIONS, *options, "-o", tmp_path / "out"), words)


def test_an_image_that_is_not_there_is_not_registered(here: ImageFolder, tmp_path: pathlib.Path) -> None:
    result = run(*here.arguments, *OPTIONS, "--reference", here.map, "--register", "x.jpg", "-o", tmp_path / "out")
    assert_refused(result, "--register x.jpg: there is no such image; there are image_0.jpg")


def sights_of(observed) -> tuple[np.ndarray, np.ndarray]:
    """(perspective centres (n, 3), rotations (n, 3, 3) of the cameras) in ECEF."""
    each = [observed.at(row)[0].exposure for row in range(len(observed))]
    sights = [one.sensor.sight(one.motion) for one in each]
    return np.array([x.centre for x in sights]), np.array([x.R_ecef_from_camera for x in sights])


def test_the_models_have_the_orientations_of_the_table(done) -> None:
    """By the readers of this package."""
    out, _ = done
    centre, R = sights_of(
        read_observations([out / "orientations.csv"], height_datum="ellipsoid", camera="focal=240px,size=256x192")
    )
    shots = read_opensfm(out / "opensfm" / "reconstruction.json", height_datum="ellipsoid")
    assert shots.reference is not None
    frame = LocalFrame(shots.reference)
    assert np.allclose(np.asarray(frame.to_ecef(shots.centres)), centre, atol=3e-4)
    assert np.allclose(np.asarray(frame.R_ecef_from_local) @ shots.R_enu_from_camera, R, atol=1e-8)
    (origin,) = (
        line.split(":", 2)[2] for line in (out / "colmap/images.txt").read_text().splitlines() if "frame: enu" in line
    )
    there = read_observations([out / "colmap"], height_datum="ellipsoid", crs=f"enu:{origin}")
    centre_there, R_there = sights_of(there)
    assert np.allclose(centre_there, centre, atol=3e-4)
    assert np.allclose(R_there, R, atol=1e-8)
    centre_there, R_there = sights_of(read_observations([out / "metashape" / "cameras.xml"]))
    assert np.allclose(centre_there, centre, atol=3e-4)
    assert np.allclose(R_there, R, atol=1e-8)


def test_pixels_are_located_with_the_accuracies_of_the_adjustment(here: ImageFolder, done) -> None:
    """By the command as it is printed: radii are what the standard deviations in the table make of lines of sight."""
    out, content = done
    command = shlex.split(content["locate"])
    assert command[:2] == ["jaxgeo", "locate"]
    result = CliRunner().invoke(app, [*command[1:], "--dem", f"{here.dem}", *DATUM, "--dem-sigma", "0.1", "--json"])
    assert result.exit_code == 0, result.output
    rows, sigma = json.loads(result.stdout)["fixes"], read_orientations(out / "orientations.csv").sigma
    assert sigma is not None
    for row, of_place, of_angles in zip(rows, sigma[:, :3], sigma[:, 3:], strict=True):
        across = row["slant_range_m"] * np.sqrt(3.0) * of_angles.max()
        most = np.hypot(of_place.max(), across) / np.cos(np.deg2rad(row["incidence_surface_deg"]))
        assert 1.645 * of_place[:2].min() < row["ce90_m"] < 2.146 * most


def test_colmap_reads_its_model_and_finds_the_same_residuals(done) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="needs pycolmap")
    out, content = done
    model = pycolmap.Reconstruction(out / "colmap")
    assert model.num_images() == 4
    squared = []
    for image in model.images.values():
        for point in image.points2D:
            place = model.points3D[point.point3D_id].xyz
            squared.append(np.sum((image.project_point(place) - point.xy) ** 2))
    assert len(squared) == content["measurements"]["used"]
    assert np.sqrt(0.5 * np.mean(squared)) == pytest.approx(content["residuals_rms_px"]["after"], rel=0.02)
    track = next(iter(model.points3D.values())).track.elements
    assert len({one.image_id for one in track}) == len(track) >= 2


@pytest.mark.parametrize(
    "options, words",
    [
        (("--dem-sigma", "-1"), "--dem-sigma must be positive; got -1.0"),
        (("--least-correlation", "1.5"), "--least-correlation must lie in (0, 1]; got 1.5"),
        (("--points", "2"), "--points must be 4 or more in each image; got 2"),
    ],
)
def test_wrong_values_are_refused_before_files_are_read(tmp_path, here, options, words) -> None:
    missing = tmp_path / "images"
    missing.mkdir()
    result = run(missing, *here.arguments[1:], *DATUM, *options, "-o", tmp_path / "out")
    assert_refused(result, words)


def test_cells_too_small_for_a_file_are_refused_before_images_are_matched(tmp_path, here) -> None:
    out = tmp_path / "out"
    result = run(*here.arguments, *DATUM, "-o", out, "--mosaic", tmp_path / "m.tif", "--resolution", "0.0001")
    assert_refused(result, "cells, more than a file can have", "name a coarser --resolution.")
    assert not out.exists()


def test_one_image_is_refused(tmp_path, here) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    shutil.copy(here.images / here.names[0], folder)
    result = run(folder, *here.arguments[1:], *DATUM, "-o", tmp_path / "out")
    assert_refused(result, "adjust needs two images or more with positions; got 1")


def test_images_without_navigation_are_refused_with_what_is_needed(tmp_path, here) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for name in here.names[:2]:
        Image.fromarray(np.asarray(Image.open(here.images / name))).save(folder / name)
    result = run(folder, *here.arguments[1:], *DATUM, "-o", tmp_path / "out")
    assert_refused(result, "none of 2 files can be read")
    assert "--gimbal" in result.stderr


def write_table(path: pathlib.Path, names: list[str], lat: tuple[float, float]) -> pathlib.Path:
    rows = [f"{name},{one},11.0,680,0,0,0" for name, one in zip(names, lat, strict=True)]
    path.write_text("\n".join(["image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg", *rows, ""]))
    return path


def test_images_far_apart_are_refused(tmp_path, here) -> None:
    table = write_table(tmp_path / "poses.csv", here.names[:2], (46.9975, 47.0025))
    result = run(table, *table_options(here.images, here), "-o", tmp_path / "out")
    assert_refused(result, "no two of 2 images overlap")


def table_options(images: pathlib.Path, here: ImageFolder) -> list[str]:
    return ["--images", f"{images}", *here.arguments[1:], *DATUM, "--camera", "focal=240px,size=256x192"]


@pytest.mark.parametrize("size, word", [((320, 240), "1.25 times its size"), ((300, 192), "cut")])
def test_an_image_of_another_camera_is_refused(tmp_path, here, size, word) -> None:
    """By its header, before any image is matched."""
    folder = tmp_path / "images"
    shutil.copytree(here.images, folder)
    Image.open(folder / here.names[1]).resize(size).save(folder / here.names[1])
    table = write_table(tmp_path / "poses.csv", here.names[:2], (47.0, 47.0002))
    result = run(table, *table_options(folder, here), "-o", tmp_path / "out")
    assert_refused(result, here.names[1], word)


def test_a_second_run_reads_the_matches_of_the_first(here, done) -> None:
    out, content = done
    before = (out / "orientations.csv").read_bytes()
    kept = sorted((out / "matches").glob("pair-*.npz"))
    assert len(kept) == len(content["pairs"])
    kept[0].write_bytes(b"damaged")
    kept[1].unlink()
    result = run(*here.arguments, *OPTIONS, "-o", out)
    assert result.exit_code == 0, result.output
    assert f"{len(kept) - 2} of {len(kept)} pairs were read from" in result.stderr
    bare = [pair for pair in content["pairs"] if "tied" not in pair["points"]]
    assert bare  # those of the image that shows noise
    for pair in bare:
        assert f"without ties: {pair['first']} and {pair['second']} (" in result.stdout
    assert content["locate"] in result.stdout
    assert (out / "orientations.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("options", [["--measure", "orientation"], ["--features", "sift"]], ids=lambda one: one[1])
def test_other_measures_and_keypoints_join_the_same_images(tmp_path, here, options: list[str]) -> None:
    """Poses err within their standard deviations."""
    if "sift" in options:
        pytest.importorskip("cv2", reason="needs the extra: pip install 'jaxgeo[features]'")
    out = tmp_path / "out"
    result = run(*here.arguments, *OPTIONS, *options, "-o", out, "--json")
    assert result.exit_code == 0, result.output
    found = read_orientations(out / "orientations.csv", height_datum="ellipsoid")
    assert found.names.tolist() == here.names[:4]
    assert found.sigma is not None
    away = away_of(here, found)
    assert np.all(np.abs(away[:, :3]) < 3.5 * found.sigma[:, [1, 0, 2]])
    assert np.all(np.abs(away[:, 3:]) < 3.5 * np.max(found.sigma[:, 3:], axis=1, keepdims=True))


def test_keypoints_without_opencv_name_the_extra(tmp_path, here, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    result = run(*here.arguments, *OPTIONS, "--features", "orb", "-o", tmp_path / "out")
    assert_refused(result, "--features orb", "pip install 'jaxgeo[features]'")


def test_a_copy_of_an_image_changes_nothing(tmp_path, here, done) -> None:
    """It is named, and neither stops the others nor counts the navigation twice."""
    out, copy = tmp_path / "out é", here.images / f"zz {here.names[1]}"
    shutil.copytree(done[0] / "matches", out / "matches")  # of the others: those of the copy would have to be made
    shutil.copy(here.images / here.names[1], copy)
    try:
        result = run(*here.arguments, *OPTIONS, "-o", out, "--json")
    finally:
        copy.unlink()
    assert result.exit_code == 0, result.output
    assert f"zz {here.names[1]} is a copy of" in " ".join(result.stderr.split())
    content = json.loads(result.stdout)
    assert f"{len(done[1]['pairs'])} of {len(done[1]['pairs'])} pairs were read from" in result.stderr
    assert content["images"] == len(here.names)
    assert content["assumed"]
    assert (out / "orientations.csv").read_bytes() == (done[0] / "orientations.csv").read_bytes()


@pytest.mark.parametrize("crs, words", [("EPSG:9999999", "unknown to PROJ"), ("EPSG:4326", "is no map")])
def test_a_wrong_map_is_refused_before_files_are_read(tmp_path, here, crs, words) -> None:
    missing = tmp_path / "images"
    missing.mkdir()
    result = run(missing, *here.arguments[1:], *DATUM, "--crs", crs, "-o", tmp_path / "out")
    assert_refused(result, f"--crs '{crs}'", words)


def test_a_missing_folder_is_named(tmp_path, here) -> None:
    result = run(tmp_path / "none", *here.arguments[1:], *DATUM, "-o", tmp_path / "out")
    assert_refused(result, "there is no such file or folder")


def test_the_folder_of_the_images_is_no_output(here) -> None:
    refused = run(*here.arguments, *OPTIONS, "-o", here.images)
    assert refused.exit_code == 2
    assert "the images are there; give another folder" in refused.stderr
    assert not (here.images / "orientations.csv").exists()


def test_the_camera_is_unknown_by_the_sigma_assumed_for_it(done) -> None:
    """What the images show of the focal length can only make its sigma smaller."""
    _, content = done
    (assumed,) = re.findall(r"Focal length sigma: .*?([\d.]+) pixels", " ".join(content["assumed"]))
    (sigma,) = [one["sigma"] for one in content["parameters"] if one["name"] == "focal"]
    assert 0.0 < sigma < 1.001 * float(assumed)
    assert not any("held as given" in one for one in content["words"])


# Last: another block, whose programs are many.


def test_control_holds_the_block_and_check_points_show_it(tmp_path, here, surveyed, done) -> None:
    """Poses are nearer to the truth than by ties alone, and check points, of the file and of an option, off by no more
    than is predicted."""
    out = tmp_path / "out"
    shutil.copytree(done[0], out)
    names = list(dict.fromkeys(row[1] for row in surveyed))
    assert len(names) > 8
    rows = [[*row[:-1], "check" if row[1] in names[::4] else "control"] for row in surveyed]
    table = write_points(tmp_path / "points.csv", rows)
    result = run(*here.arguments, *OPTIONS, "-o", out, "--gcp", table, *GCP, "--check", names[1], "--json", "--report")
    assert result.exit_code == 0, result.output
    points = json.loads(result.stdout)["control"]["points"]
    checks = [one for one in points if one["role"] == "check"]
    assert {one["point"] for one in checks} == {*names[::4], names[1]}
    assert not any(one["role"] == "left out" for one in points)
    several = [one for one in checks if one["images"] > 1]
    off = [one[f"{axis}_m"] / one[f"sigma_{axis}_m"] for one in several for axis in ("east", "north", "up")]
    assert np.max(np.abs(off)) < 4.5
    assert np.sqrt(np.mean(np.square(off))) < 1.6
    before, after = (
        np.abs(away_of(here, read_orientations(folder / "orientations.csv", height_datum="ellipsoid"))[:, :3])
        for folder in (done[0], out)
    )
    assert np.mean(after) < 0.5 * np.mean(before)
    lines = (out / "control.csv").read_text().splitlines()
    assert len(lines) - 1 == len(names)
    page = (out / "report.html").read_text()
    assert page.count('class="footprint"') == 4
    assert names[1] in page

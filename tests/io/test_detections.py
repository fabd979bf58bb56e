"""Detections: each form by its published layout, names of images, anchors, outlines, and what is refused."""

from __future__ import annotations

import json
import pathlib
import shutil
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from support.command_files import DJI
from support.drone_image_files import FULL, packet, write_image

import jaxgeo
from jaxgeo.io import locate_observations, read_observations
from jaxgeo.io.detected import observations_of_detections, outline_observations, outlines_on_ground
from jaxgeo.io.detections import Detection, nameless_classes, read_detections
from jaxgeo.io.errors import TableError
from jaxgeo.status import Status

BOX = np.array([[10.0, 20.0], [40.0, 20.0], [40.0, 80.0], [10.0, 80.0]])  # centres of pixels at integers
TRIANGLE = np.array([[10.0, 20.0], [60.0, 25.0], [30.0, 70.0]])


def coco(shape: dict) -> dict:
    """By the layout of cocodataset.org: coordinates from the upper left corner of the image, in pixels."""
    return {
        "images": [{"id": 7, "file_name": "a.jpg", "width": 4000, "height": 3000}],
        "annotations": [{"id": 1, "image_id": 7, "category_id": 3, "score": 0.5, **shape}],
        "categories": [{"id": 3, "name": "car"}],
    }


def feature(geometry: dict, **own: object) -> dict:
    return {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "geometry": geometry, "properties": {"image": "a.jpg", "label": "car", **own}}
        ],
    }


def closed(corners: np.ndarray) -> list[list[float]]:
    return [*corners.tolist(), corners[0].tolist()]


FORMS = {
    "point.csv": ("image,u,v,label\na.jpg,10,20,car\n", "point", BOX[:1]),
    "point.geojson": (feature({"type": "Point", "coordinates": [10, 20]}), "point", BOX[:1]),
    "box.csv": ("image;label;u_min;v_min;u_max;v_max\na.jpg;car;10;20;40;80\n", "box", BOX),
    "polygon.geojson": (feature({"type": "Polygon", "coordinates": [closed(TRIANGLE)]}), "polygon", TRIANGLE),
    "box.json": (coco({"bbox": [10.5, 20.5, 30, 60], "segmentation": []}), "box", BOX),
    "polygon.json": (coco({"segmentation": [(TRIANGLE + 0.5).ravel().tolist()]}), "polygon", TRIANGLE),
}


def write(folder: pathlib.Path, name: str, content: object) -> pathlib.Path:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_read(name: str, tmp_path: pathlib.Path) -> None:
    content, kind, vertices = FORMS[name]
    (found,) = read_detections(write(tmp_path, name, content))
    assert (found.image, found.kind, found.attributes["label"]) == ("a.jpg", kind, "car")
    np.testing.assert_allclose(found.of_size(4000, 3000), vertices, atol=1e-12)


@pytest.mark.parametrize("name", ["point.csv", "box.csv", "point.geojson", "polygon.geojson"])
def test_the_origin_may_be_the_corner(name: str, tmp_path: pathlib.Path) -> None:
    content, _, vertices = FORMS[name]
    (found,) = read_detections(write(tmp_path, name, content), pixel_origin="corner")
    np.testing.assert_allclose(found.vertices, vertices - 0.5, atol=1e-12)


def test_yolo_is_in_shares_of_the_image(tmp_path: pathlib.Path) -> None:
    """By the layout of the Ultralytics documentation: class, then centre, width and height over those of the image."""
    (left, top), (right, bottom) = (BOX[0] + 0.5) / [4000, 3000], (BOX[2] + 0.5) / [4000, 3000]
    box = f"1 {(left + right) / 2} {(top + bottom) / 2} {right - left} {bottom - top} 0.75"
    four = np.vstack([TRIANGLE, [15.0, 50.0]])
    polygon = " ".join(["0", *(f"{x}" for x in ((four + 0.5) / [4000, 3000]).ravel())])
    write(tmp_path, "a.txt", f"{box}\n{polygon}\n")
    write(tmp_path, "classes.txt", "tree\ncar\n")
    of_box, of_polygon = read_detections(tmp_path)
    assert (of_box.image, of_box.attributes) == ("a", {"label": "car", "score": 0.75})
    assert (of_polygon.kind, of_polygon.attributes) == ("polygon", {"label": "tree", "score": None})
    np.testing.assert_allclose(of_box.of_size(4000, 3000), BOX, atol=1e-9)
    np.testing.assert_allclose(of_polygon.of_size(4000, 3000), four, atol=1e-9)


SEVERAL = "0 0.5 0.5 0.1 0.1\n2 0.5 0.5 0.1 0.1\n"
# As Ultralytics' "Object Detection Datasets Overview" shows it, as Roboflow writes it, and with numbers that are apart.
DATA_SETS = {
    "mapping": "path: coco8 # dataset root dir\ntrain: images/train\nval: images/val\ntest: # optional\n\n"
    "names:\n  0: person\n  1: bicycle\n  2: car\n",
    "list": "train: ../train/images\nval: ../valid/images\n\nnc: 3\nnames: ['person', 'bicycle', 'car']\n",
    "numbers apart": "names: {2: car, 0: person}\n",
    "numbers in quotes": "names: {'0': person, '2': car}\n",
}


@pytest.mark.parametrize("layout", DATA_SETS)
@pytest.mark.parametrize("place", ["labels", ".", "..", "given"])
def test_data_yaml_names_the_classes_of_yolo(tmp_path: pathlib.Path, layout: str, place: str) -> None:
    folder = tmp_path / "data" / "labels" / "train" if place == ".." else tmp_path / "data" / "labels"
    folder.mkdir(parents=True)
    write(folder, "a.txt", SEVERAL)
    at = {"labels": folder, ".": folder.parent, "..": folder.parents[1], "given": tmp_path}[place]
    path = write(at, "coco8.yaml" if place == "given" else "data.yaml", DATA_SETS[layout])
    found = read_detections(folder, class_names=path if place == "given" else None)
    assert [one.attributes["label"] for one in found] == ["person", "car"]


def test_names_that_are_given_replace_those_beside(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "labels"
    folder.mkdir()
    write(folder, "a.txt", SEVERAL)
    write(tmp_path, "data.yaml", "names: [a, b, c]\n")
    write(folder, "classes.txt", "hut\ntent\ntree\n")
    given = write(tmp_path, "names.txt", "roof\nroad\n")
    for more, labels in (({}, ["hut", "tree"]), ({"class_names": given}, ["roof", "2"])):
        assert [one.attributes["label"] for one in read_detections(folder, **more)] == labels
    (folder / "classes.txt").unlink()
    write(folder, "data.yaml", "train: images\n")  # of something else: classes keep their numbers
    assert [one.attributes["label"] for one in read_detections(folder)] == ["0", "2"]


def test_classes_without_a_name_are_said(tmp_path: pathlib.Path) -> None:
    """Classes 0 and 2 are there; without any names nothing is amiss."""
    folder = tmp_path / "labels"
    folder.mkdir()
    write(folder, "a.txt", SEVERAL)
    found = read_detections(folder)
    assert nameless_classes(found, folder) == []
    given = write(tmp_path, "names.yaml", "names: [roof, road]\n")
    (said,) = nameless_classes(read_detections(folder, class_names=given), folder, given)
    assert said.startswith(f"Check: Class 2 has no name in {given}, which names 2: 1 of 2 detections keep the number")
    write(folder, "classes.txt", "\n\n\ntree\n")
    (said,) = nameless_classes(read_detections(folder), folder)
    assert said.startswith("Check: Classes 0, 2 have no name in the file of names beside the detections, which names 1")
    write(folder, "classes.txt", "hut\ntent\ntree\n")
    assert nameless_classes(read_detections(folder), folder) == []


@pytest.mark.parametrize(
    "content, words",
    [
        ("train: images\n", "there is no key names, a list or a mapping"),
        ("names: person\n", "names must be a list, or a mapping of numbers to names; got 'person'"),
        ("names: {}\n", "names must be a list, or a mapping of numbers to names; got {}"),
        ("names: {car: 2}\n", "names has the key 'car'; expected the number of a class, from 0"),
        ("names: {-1: car}\n", "names has the key -1; expected the number of a class"),
        ("names: [car, [tree]]\n", r"class 1 is called \['tree'\]; expected a name"),
        ("names: [car, no]\n", r"class 1 is called False; expected a name \(in quotes, if need be\)"),
        ("nc: 3\nnames: [car, tree]\n", "nc is 3, but there are 2 names; give the file of these detections"),
        ("nc: three\nnames: [car, tree]\n", "nc is 'three'; expected the number of classes, 2, or no nc"),
        ("nc: 2.5\nnames: [car, tree]\n", "nc is 2.5; expected the number of classes"),
        ("nc: yes\nnames: [car]\n", "nc is True; expected the number of classes, 1"),
        ("names: [car\n", "not a YAML file"),
        ("names: [car]\nnames: [tree]\n", "'names' stands twice in one table"),
    ],
)
def test_files_of_names_that_are_damaged_are_refused_in_a_line(
    tmp_path: pathlib.Path, content: str, words: str
) -> None:
    folder = tmp_path / "labels"
    folder.mkdir()
    write(folder, "a.txt", SEVERAL)
    path = write(tmp_path, "given.yaml", content)
    with pytest.raises(TableError, match=words) as told:
        read_detections(folder, class_names=path)
    assert "\n" not in str(told.value)
    assert "given.yaml" in str(told.value)
    with pytest.raises(FileNotFoundError, match=r"gone\.yaml: there is no such file of class names"):
        read_detections(folder, class_names=tmp_path / "gone.yaml")
    with pytest.raises(TableError, match="class_names= goes with a folder of YOLO files"):
        read_detections(write(tmp_path, "a.csv", "image,u,v\na.jpg,1,2\n"), class_names=path)


def test_track_numbers_of_yolo_are_no_scores_and_no_triangles(tmp_path: pathlib.Path) -> None:
    """As Ultralytics writes them when tracking: behind the box, and behind its confidence."""
    write(tmp_path, "a.txt", "0 0.5 0.5 0.1 0.1 7\n0 0.5 0.5 0.1 0.1 0.9\n")
    tracked, scored = read_detections(tmp_path)
    assert tracked.attributes == {"label": "0", "score": None, "track": 7}
    assert scored.attributes == {"label": "0", "score": 0.9}
    for number in ("1", "7"):
        write(tmp_path, "a.txt", f"0 0.5 0.5 0.1 0.1 0.9 {number}\n")
        with pytest.raises(TableError, match="7 numbers, which may be a box with confidence and track number"):
            read_detections(tmp_path)


def test_an_image_of_another_size_is_scaled_or_refused() -> None:
    """In COCO, whose pixels count from the corner: half the size is half of each coordinate."""
    whole = Detection("a.jpg", "box", BOX, {}, size=(8000, 6000))
    np.testing.assert_allclose(whole.of_size(4000, 3000), (BOX + 0.5) / 2.0 - 0.5, atol=1e-12)
    with pytest.raises(TableError, match="8000 x 6000 pixels in the file of detections, and 3000 x 3000 here"):
        whole.of_size(3000, 3000)


def test_what_lies_outside_of_the_image_is_cut_off() -> None:
    wide = Detection("a.jpg", "box", np.array([[-5.0, 2.0], [50.0, 2.0], [50.0, 40.0], [-5.0, 40.0]]), {})
    np.testing.assert_allclose(wide.of_size(40, 30), [[-0.5, 2.0], [39.5, 2.0], [39.5, 29.5], [-0.5, 29.5]])
    lozenge = np.array([[20.0, -10.5], [60.0, 14.5], [20.0, 39.5], [-20.0, 14.5]])
    cut = Detection("a.jpg", "polygon", lozenge, {}).of_size(40, 30)
    assert cut.min() == -0.5
    np.testing.assert_allclose(cut.max(axis=0), [39.5, 29.5])
    beside = Detection("a.jpg", "polygon", TRIANGLE + 1000.0, {})
    np.testing.assert_allclose(beside.of_size(40, 30), TRIANGLE + 1000.0)


def test_a_pixel_beside_a_box_is_the_one_that_is_located(tmp_path: pathlib.Path) -> None:
    content = "image,u,v,u_min,v_min,u_max,v_max\na.jpg,12,77,10,20,40,80\n"
    (found,) = read_detections(write(tmp_path, "a.csv", content), pixel_origin="corner")
    for anchor in ("centre", "bottom"):
        np.testing.assert_allclose(found.pixel_of(found.of_size(4000, 3000), anchor), [11.5, 76.5])


def test_anchors(tmp_path: pathlib.Path) -> None:
    box, triangle = Detection("a", "box", BOX, {}), Detection("a", "polygon", TRIANGLE, {})
    np.testing.assert_allclose(box.pixel_of(BOX, "centre"), [25.0, 50.0])
    np.testing.assert_allclose(box.pixel_of(BOX, "bottom"), [25.0, 80.0])
    np.testing.assert_allclose(triangle.pixel_of(TRIANGLE, "centre"), TRIANGLE.mean(axis=0))
    np.testing.assert_allclose(triangle.pixel_of(TRIANGLE, "bottom"), [35.0, 70.0])
    point = Detection("a", "point", BOX[:1], {})
    for anchor in ("centre", "bottom"):
        np.testing.assert_allclose(point.pixel_of(BOX[:1], anchor), BOX[0])


MISTAKES = {
    "a.csv": [
        ("image,label\na.jpg,car\n", "no columns u, v, nor u_min"),
        ("image,u,v\n", "no rows"),
        ("image,u,v\n,1,2\n", "row 2, column image: empty"),
        ("image,u,v\na.jpg,x,2\n", "row 2, column u: 'x' is not a number"),
        ("image,u_min,v_min,u_max,v_max\na.jpg,5,5,1,9\n", "row 2, column u_max: the box has no area"),
        (
            "image,u,v\na.jpg,0.5,1\na.jpg,0.25,0\n",
            "a.csv: its columns and rows are from 0 to 1, which look",
        ),
    ],
    "a.json": [
        ([], "a list of COCO results names images by number only"),
        ({"images": []}, "neither GeoJSON"),
        (coco({"bbox": [1, 2, 3]}), "annotation 1: expected bbox"),
        (coco({"bbox": [1, 2, 0, 3]}), "annotation 1: the box has no area"),
        (coco({"bbox": [1, 2, 3, 4], "image_id": 8}), "annotation 1: its image_id"),
        (coco({"bbox": [0.1, 0.2, 0.3, 0.4]}), "from 0.1 to 0.6, which look like shares of the image; pixels are exp"),
        (coco({"bbox": [1, 2, None, 4]}), "annotation 1: expected bbox"),
        ({"images": [], "annotations": []}, "there are no detections"),
    ],
    "a.geojson": [
        (feature({"type": "LineString", "coordinates": [[0, 1], [2, 3]]}), "feature 1: its geometry is 'LineString'"),
        (feature({"type": "Point", "coordinates": ["x", 1]}), "feature 1: its coordinates are no pairs"),
        (feature({"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [2, 0], [0, 0]]]}), "the polygon has no area"),
        (feature({"type": "Point", "coordinates": [0, 1]}, image=" "), "feature 1: no property image"),
        (feature({"type": "Point", "coordinates": [0.5, 0.25]}), "look like shares of the image"),
        ({"type": "FeatureCollection", "features": 3}, "its features are no list"),
    ],
    "a.txt": [("0 0.5 0.5 0.1 0.1\n", "give the folder")],
    "yolo/a.txt": [
        ("0 0.5 0.5 0.1\n", "a.txt, line 1: 4 numbers"),
        ("\n0 500 500 10 10\n", "a.txt, line 2: coordinates are shares"),
        ("0 0.5 0.5 0.1 x\n", "a.txt, line 1: expected class x y width height"),
        ("", "there are no detections"),
    ],
}


@pytest.mark.parametrize(
    "name, content, words", [(name, *each) for name, some in MISTAKES.items() for each in some]
)  # fmt: skip
def test_mistakes(name: str, content: object, words: str, tmp_path: pathlib.Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    write(path.parent, path.name, content)
    with pytest.raises(TableError) as caught:
        read_detections(path.parent if name.startswith("yolo") else path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_mistakes(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match="pixel_origin must be"):
        read_detections(tmp_path, pixel_origin="middle")
    with pytest.raises(TableError, match=r"no file NAME\.txt"):
        read_detections(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_detections(tmp_path / "none.csv")


@pytest.fixture(scope="module")
def observed(tmp_path_factory):
    """Three images, two of one lens; one lies in another folder, and one is cut."""
    folder = tmp_path_factory.mktemp("images")
    for name, more in {"a.jpg": {}, "b.jpg": {"CalibratedFocalLength": "3500"}, "c.jpg": {}}.items():
        tags = DJI | {f"drone-dji:{key}": text for key, text in more.items()}
        write_image(folder / name, packet(tags), make="DJI", size=FULL)
    (folder / "c.jpg").write_bytes((folder / "a.jpg").read_bytes()[:900])
    read = read_observations(folder, height_datum="ellipsoid")
    return SimpleNamespace(rows=read, files=sorted(folder.iterdir()), folder=folder)


def test_each_detection_is_a_pixel_of_its_image(observed) -> None:
    given = [
        Detection("b.jpg", "point", np.array([[100.0, 200.0]]), {"label": "car"}),
        Detection("other/a.jpg", "point", np.array([[1.0, 2.0]]), {}),
        Detection(f"{observed.folder.name}\\a.jpg", "box", BOX, {"score": 0.5, "name": "x", "ce90_m": 3}),
        Detection("c", "point", np.array([[1.0, 2.0]]), {}),
        Detection("a.tif", "polygon", TRIANGLE, {"label": "hut"}),  # as a reconstruction may name it
    ]
    found, vertices = observations_of_detections(observed.rows, given, anchor="bottom", files=observed.files)
    assert [row["detected_name"] for row in found.columns] == [None, None, "x", None, None]
    assert [row["detected_ce90_m"] for row in found.columns] == [None, None, 3, None, None]
    assert [row["detected_as"] for row in found.columns] == ["point", "point", "box", "point", "polygon"]
    assert [row["name"] for row in found.columns] == ["b.jpg", "other/a.jpg", "a.jpg", "c", "a.jpg"]
    assert [row["label"] for row in found.columns] == ["car", None, None, None, "hut"]
    assert [row["score"] for row in found.columns] == [None, None, 0.5, None, None]
    assert list(found.unread) == [1, 3]
    assert "no exposure has this name; known: a.jpg, b.jpg, c.jpg" in found.unread[1].reason
    assert "c.jpg" in found.unread[3].reason  # the reason why the image was not read
    assert [len(one) for one in vertices] == [1, 0, 4, 0, 3]
    fixes = locate_observations(found, jaxgeo.ConstantHeight(300.0))
    for row, (name, uv) in {0: ("b.jpg", (100, 200)), 2: ("a.jpg", (25, 80)), 4: ("a.jpg", (35, 70))}.items():
        number = [column["name"] for column in observed.rows.columns].index(name)
        look = observed.rows.at(number)[0].exposure
        sensor, shot = jax.tree.map(jax.numpy.asarray, (look.sensor, look.motion))
        alone = jaxgeo.locate(sensor, shot, uv, jaxgeo.ConstantHeight(300.0))
        np.testing.assert_allclose(fixes.ecef[row], alone.ecef, atol=1e-6)
    assert [int(fixes.status[row]) for row in (1, 3)] == [Status.file_not_read.code] * 2


@pytest.mark.costly
def test_outlines_are_what_their_edges_see(observed) -> None:
    given = [
        Detection("a.jpg", "point", np.array([[100.0, 200.0]]), {}),
        Detection("b.jpg", "box", BOX, {}),
        Detection("a.jpg", "polygon", TRIANGLE + 9000.0, {}),
        Detection("a.jpg", "polygon", TRIANGLE, {}),
    ]
    found, vertices = observations_of_detections(observed.rows, given)
    ground = jaxgeo.ConstantHeight(300.0)
    outlines, grounds, rows = outline_observations(found, vertices, ground)
    shapes = outlines_on_ground(locate_observations(outlines, grounds), rows)
    assert shapes.statuses[0] is None
    assert shapes.statuses[1] == shapes.statuses[3] == "hit"
    assert shapes.statuses[2] not in (None, "hit")  # beside the image
    assert shapes.rings[0] is None
    assert shapes.rings[2] is None
    for row, corners, name in ((1, BOX, "b.jpg"), (3, TRIANGLE, "a.jpg")):
        number = [column["name"] for column in observed.rows.columns].index(name)
        look = observed.rows.at(number)[0].exposure
        sensor, shot = jax.tree.map(jax.numpy.asarray, (look.sensor, look.motion))
        ring = shapes.rings[row]
        assert len(ring) >= 32
        for corner in corners:
            lat, lon, _ = jaxgeo.locate(sensor, shot, corner, ground).position.to_degrees()
            apart = np.hypot((ring[:, 0] - float(lon)) * 90_000.0, (ring[:, 1] - float(lat)) * 111_000.0)
            assert apart.min() < 1e-3


@pytest.mark.costly
def test_outlines_lie_on_the_ground_of_their_detection(observed) -> None:
    """Level ground with a height for each detection, as telemetry reports it."""
    given = [
        Detection("a.jpg", "point", np.array([[100.0, 200.0]]), {}),
        Detection("a.jpg", "box", BOX, {}),
        Detection("a.jpg", "box", BOX, {}),
    ]
    found, vertices = observations_of_detections(observed.rows, given)
    (batch,) = found.batches
    heights = np.array([200.0, 250.0, 350.0])
    ground = jaxgeo.ConstantHeight(heights[batch.rows])
    outlines, grounds, rows = outline_observations(found, vertices, [ground])
    shapes = outlines_on_ground(locate_observations(outlines, grounds), rows)
    for number in (1, 2):
        np.testing.assert_allclose(shapes.rings[number][:, 2], heights[number], atol=1e-6)


def test_images_of_one_name_are_told_apart_by_their_folders(observed, tmp_path: pathlib.Path) -> None:
    files = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        files.append(shutil.copy(observed.folder / "a.jpg", tmp_path / name / "a.jpg"))
    read = read_observations(files, height_datum="ellipsoid")
    names = ("two/a.jpg", "a.jpg", "three/a.jpg", f"{tmp_path}/one/a.jpg")
    given = [Detection(name, "point", np.array([[1.0, 2.0]]), {}) for name in names]
    found, _ = observations_of_detections(read, given, files=files)
    assert list(found.unread) == [1, 2]
    assert "2 exposures have this name; name the folder too" in found.unread[1].reason
    assert [pathlib.Path(found.columns[row]["name"]).parent.name for row in (0, 3)] == ["two", "one"]
    alone = read_observations(files[0], height_datum="ellipsoid")  # not located in the image of another folder
    with pytest.raises(TableError, match="no detection is in an image that was read"):
        observations_of_detections(alone, given[:1], files=files[:1])


def test_without_any_known_image_nothing_is_invented(observed) -> None:
    with pytest.raises(TableError, match=r"that was read: they name x\.jpg; the images are a\.jpg"):
        observations_of_detections(observed.rows, [Detection("x.jpg", "point", BOX[:1], {})])
    with pytest.raises(ValueError, match="anchor must be"):
        observations_of_detections(observed.rows, [Detection("a.jpg", "point", BOX[:1], {})], anchor="top")

"""Detections in images: points, boxes and polygons in pixels, as tables and as annotation and detection tools write
them.

- CSV: a row per detection with `image`, and `u`, `v`, or `u_min`, `v_min`, `u_max`, `v_max`; other columns are kept.
- GeoJSON: points and polygons in pixels (column, row), with the property `image`; other properties are kept.
- COCO (Lin et al. 2014, "Microsoft COCO: common objects in context"): `images`, `annotations` with `bbox` (left, top,
  width, height) or polygons as `segmentation`, `categories`.
- YOLO: a folder with a file NAME.txt for each image, rows of `class x y width height [confidence] [track]` or
  `class x1 y1 x2 y2 x3 y3 x4 y4 ...`, as shares of width and height of the image; names of classes in classes.txt, or
  in the data.yaml of the data set in this folder or up to two above. A row of seven numbers may be a box or a triangle,
  and is refused if the last is a whole number. Not key points.

Pixel (0, 0) is the centre of the first pixel in CSV and GeoJSON, unless its corner is asked for. In COCO and YOLO it is
always the outer corner.
"""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo._text_numbers import numbers_or_texts
from jaxgeo.io._class_names import LIST
from jaxgeo.io._class_names import class_names as named
from jaxgeo.io._csv import Limits, check_not_shares, read_csv
from jaxgeo.io._json import read_json
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions.sentences import DOUBT
from jaxgeo.io.errors import TableError

ORIGINS = {"centre": 0.0, "corner": 0.5}  # pixels from the first pixel's centre back to the origin
PIXELS: Limits = (-1e6, 1e6, "pixels")
BOX = ("u_min", "v_min", "u_max", "v_max")
SAME_SHAPE = 0.01  # relative difference of the ratios of sides, from rounding when an image is resized
HINTS = {"image": "Each row names its image, and has u, v or u_min, v_min, u_max, v_max, in pixels."}
IMAGE = ("image", "file_name", "filename")  # properties that name the image


@dataclasses.dataclass(frozen=True)
class Detection:
    """A point, box or polygon in an image.

    - `image`: name of the image's file, with or without extension or folder.
    - `kind`: "point", "box" or "polygon"; `vertices` (n, 2) are column and row, centres of pixels at integers, or
      shares of the image's width and height from its corner if `is_share`.
    - `attributes`: what else the file says, such as `label` and `score`.
    - `size`: width and height of the image as the file states them, or None.
    - `pixel`: the pixel (2,) that the file states beside a box, or None.
    """

    image: str
    kind: str
    vertices: np.ndarray
    attributes: dict[str, Any]
    is_share: bool = False
    size: tuple[int, int] | None = None
    pixel: np.ndarray | None = None

    def of_size(self, width: int, height: int) -> np.ndarray:
        """Vertices (n, 2) in pixels of an image of a size in pixels; what lies outside of it is cut off.

        Where the file states another size of the same shape, coordinates are scaled. Raises `TableError` for one of
        another shape.
        """
        vertices = self.vertices
        if self.is_share:
            vertices = vertices * [width, height] - 0.5
        elif self.size is not None and self.size != (width, height):
            across, down = width / self.size[0], height / self.size[1]
            if abs(across / down - 1.0) > SAME_SHAPE:
                raise TableError(
                    f"{self.image}: {self.size[0]} x {self.size[1]} pixels in the file of detections, and {width} x "
                    f"{height} here: another image, or a part of it."
                )
            vertices = (vertices + 0.5) * [across, down] - 0.5
        return vertices if self.kind == "point" else _cut(vertices, self.kind, width, height)

    def pixel_of(self, vertices: np.ndarray, anchor: str) -> np.ndarray:
        """The pixel (2,) that stands for the detection: the one stated, its centre (of area), or the middle of its
        lower edge."""
        if self.pixel is not None:
            return self.pixel
        if anchor == "bottom" and self.kind != "point":
            (left, _), (right, bottom) = vertices.min(axis=0), vertices.max(axis=0)
            return np.array([0.5 * (left + right), bottom])
        if self.kind == "polygon":
            import shapely

            middle = shapely.Polygon(vertices).centroid
            if not middle.is_empty:
                return np.array([middle.x, middle.y])
        return vertices.mean(axis=0)


def read_detections(
    path: str | os.PathLike[str],
    *,
    pixel_origin: str = "centre",
    class_names: str | os.PathLike[str] | None = None,
) -> list[Detection]:
    """Read detections from a CSV, GeoJSON or COCO file, or a folder of YOLO files; see the formats above.

    - `pixel_origin` is where (0, 0) of CSV and GeoJSON lies: at the "centre" of the first pixel or its outer "corner".
    - `class_names` is a file with the names of YOLO's classes, in place of those beside the detections: `data.yaml` as
      Ultralytics writes it (key `names`; needs PyYAML), or a text with a name a line. Classes without a name keep
      their number.

    Raises `TableError` (row or number of the detection named) for a file in another form, without detections, and for
    values that are missing, not finite or no polygons, or in CSV, GeoJSON and COCO shares of the image;
    `ValueError` for another origin; `FileNotFoundError`; `ImportError` for YAML without PyYAML.
    """
    if pixel_origin not in ORIGINS:
        raise ValueError(f"pixel_origin must be 'centre' or 'corner'; got {pixel_origin!r}.")
    source, back = pathlib.Path(path), ORIGINS[pixel_origin]
    if source.is_dir():
        found = _yolo(source, named(source, class_names))
    elif class_names is not None:
        raise TableError(f"{source}: class_names= goes with a folder of YOLO files; leave it out.")
    elif source.suffix.lower() in (".json", ".geojson"):
        content = read_json(source, "set of detections")
        is_collection = isinstance(content, dict) and content.get("type") == "FeatureCollection"
        found = _geojson(source, content, back) if is_collection else _coco(source, content)
    elif source.suffix.lower() == ".txt":
        raise TableError(f"{source}: YOLO has a file for each image; give the folder that holds them.")
    else:
        found = _table(source, back)
    if not found:
        raise TableError(f"{source}: there are no detections in it.")
    return found


def nameless_classes(
    detections: Sequence[Detection], path: str | os.PathLike[str], class_names: str | os.PathLike[str] | None = None
) -> list[str]:
    """[a sentence on classes of YOLO detections that have no name], or []: where others of the data set have names.

    Arguments as of `read_detections`, which read the detections. Raises as that.
    """
    folder = pathlib.Path(path)
    names = set(named(folder, class_names).values()) - {""} if folder.is_dir() else set()
    labels = {str(one.attributes["label"]) for one in detections} - names if names else set()
    if not labels:
        return []
    kept = sorted(labels, key=lambda label: (len(label), label))
    of = f"{class_names}" if class_names is not None else "the file of names beside the detections"
    are = "Class {} has" if len(kept) == 1 else "Classes {} have"
    count = sum(str(one.attributes["label"]) in labels for one in detections)
    return [
        f"{DOUBT}{are.format(', '.join(kept))} no name in {of}, which names {len(names)}: {count} of "
        f"{len(detections)} detections keep the number as label. Give the names of the data set of these detections."
    ]


def _box(corners: Sequence[float]) -> np.ndarray:
    """Vertices (4, 2) of a box, clockwise in the image from its upper left corner."""
    left, top, right, bottom = corners
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float64)


def _table(path: pathlib.Path, back: float) -> list[Detection]:
    table = read_csv(path, "table of detections", ("image",), known=("u", "v", *BOX), hints=HINTS)
    has_box, has_point = (all(name in table.header for name in names) for names in (BOX, ("u", "v")))
    if not has_box and not has_point:
        raise TableError(
            f"{path}: no columns u, v, nor {', '.join(BOX)}; give the pixel of each detection, or its box."
        )
    names = BOX if has_box else ("u", "v")
    numbers = np.stack([table.numbers(name, PIXELS) for name in names], axis=-1)
    check_not_shares(path, numbers.reshape(-1, 2))
    numbers -= back
    middles = None
    if has_box and has_point:
        middles = np.stack([table.numbers(name, PIXELS) for name in ("u", "v")], axis=-1) - back
    rows = table.rows
    own = ("image", "u", "v", *names)
    others = {name: numbers_or_texts([row[name] for row in rows]) for name in rows[0] if name not in own}
    found = []
    for index, (row, values) in enumerate(zip(rows, numbers, strict=True)):
        if not row["image"].strip():
            raise table.wrong(index, "image", "empty; expected the name of an image.")
        if has_box and not (values[0] < values[2] and values[1] < values[3]):
            raise table.wrong(index, "u_max", "the box has no area; expected u_min < u_max and v_min < v_max.")
        rest = {name: cells[index] for name, cells in others.items()}
        vertices = _box(values.tolist()) if has_box else values[None, :]
        pixel = None if middles is None else middles[index]
        found.append(Detection(row["image"].strip(), "box" if has_box else "point", vertices, rest, pixel=pixel))
    return found


def _geojson(path: pathlib.Path, content: Mapping[str, Any], back: float) -> list[Detection]:
    found = []
    for number, feature in enumerate(_list(path, content, "features"), 1):
        where = f"{path}, feature {number}"
        own = feature.get("properties") if isinstance(feature, dict) else None
        own = own if isinstance(own, dict) else {}
        image = next((own[name] for name in IMAGE if isinstance(own.get(name), str) and own[name].strip()), None)
        if image is None:
            raise TableError(f"{where}: no property image; expected the name of the image's file.")
        geometry = feature.get("geometry") or {}
        rest = {name: value for name, value in own.items() if name not in IMAGE and not isinstance(value, dict | list)}
        if geometry.get("type") == "Point":
            vertices = _pairs(where, [geometry.get("coordinates")])
        elif geometry.get("type") == "Polygon":
            rings = geometry.get("coordinates")
            vertices = _pairs(where, rings[0] if isinstance(rings, list) and rings else None)
        else:
            raise TableError(
                f"{where}: its geometry is {geometry.get('type')!r}; expected a Point or Polygon, in pixels."
            )
        kind = "point" if geometry["type"] == "Point" else "polygon"
        found.append(_checked(where, image.strip(), kind, vertices - back, rest))
    if found:
        check_not_shares(path, np.concatenate([one.vertices for one in found]) + back)
    return found


def _coco(path: pathlib.Path, content: Any) -> list[Detection]:
    if isinstance(content, list):
        raise TableError(
            f"{path}: a list of COCO results names images by number only; give a file with images and annotations."
        )
    if not isinstance(content, dict) or "annotations" not in content or "images" not in content:
        raise TableError(f"{path}: neither GeoJSON (features) nor COCO (images and annotations).")
    stated = [one for one in _list(path, content, "images") if isinstance(one, dict)]
    images = {one.get("id"): one.get("file_name") for one in stated}
    sizes = {one.get("id"): _size_of(one) for one in stated}
    labels = {one.get("id"): one.get("name") for one in content.get("categories") or [] if isinstance(one, dict)}
    found = []
    for number, one in enumerate(_list(path, content, "annotations"), 1):
        where = f"{path}, annotation {number}"
        image = images.get(one.get("image_id")) if isinstance(one, dict) else None
        if not isinstance(image, str):
            raise TableError(f"{where}: its image_id is that of no image with a file_name.")
        rest = {"label": labels.get(one.get("category_id"), one.get("category_id")), "score": one.get("score")}
        rest |= {"id": one.get("id")}
        shape = one.get("segmentation")
        parts, size = shape if isinstance(shape, list) else [], sizes[one.get("image_id")]
        if len(parts) == 1 and isinstance(parts[0], list) and len(parts[0]) >= 6 and len(parts[0]) % 2 == 0:
            vertices = _pairs(where, list(zip(parts[0][::2], parts[0][1::2], strict=True)))
            polygon = _checked(where, image, "polygon", vertices - 0.5, rest)
            found.append(dataclasses.replace(polygon, size=size))
            continue
        bounds = one.get("bbox")
        left, top, width, height = _numbers(where, bounds, 4, "bbox (left, top, width, height)")
        vertices = _box((left, top, left + width, top + height)) - 0.5
        found.append(dataclasses.replace(_checked(where, image, "box", vertices, rest), size=size))
    if found:
        check_not_shares(path, np.concatenate([one.vertices for one in found]) + 0.5)
    return found


def _size_of(image: Mapping[str, Any]) -> tuple[int, int] | None:
    width, height = image.get("width"), image.get("height")
    if isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0:
        return width, height
    return None


def _cut(vertices: np.ndarray, kind: str, width: int, height: int) -> np.ndarray:
    """A box or polygon without what lies outside an image; as it is if all of it does."""
    low, high = np.array([-0.5, -0.5]), np.array([width, height]) - 0.5
    if np.all((vertices >= low) & (vertices <= high)):
        return vertices
    if kind == "box":
        cut = np.clip(vertices, low, high)
        return cut if np.all(np.ptp(cut, axis=0) > 0.0) else vertices
    import shapely

    inside = shapely.clip_by_rect(shapely.Polygon(vertices), *low, *high)
    parts = [one for one in shapely.get_parts(inside) if one.geom_type == "Polygon" and one.area > 0.0]
    return np.asarray(max(parts, key=shapely.area).exterior.coords)[:-1, :2] if parts else vertices


def _yolo(folder: pathlib.Path, labels: Mapping[int, str]) -> list[Detection]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".txt" and path.name != LIST)
    if not files:
        raise TableError(f"{folder}: no file NAME.txt of YOLO detections in it.")
    found = []
    for path in files:
        if not path.stat().st_size:  # an image without detections
            continue
        for number, line in enumerate(read_text(path, "file of detections").splitlines(), 1):
            if not line.strip():
                continue
            where = f"{path}, line {number}"
            values = _numbers(where, line.split(), None, "class x y width height, or class x1 y1 x2 y2 x3 y3 ...")
            kind, values = values[0], values[1:]
            label = labels.get(int(kind), "") if kind == int(kind) else ""
            rest: dict[str, Any] = {"label": label or f"{kind:g}", "score": None}
            if len(values) == 6 and values[5] == int(values[5]):
                raise TableError(
                    f"{where}: 7 numbers, which may be a box with confidence and track number, or a triangle; leave "
                    f"the track number out, or write the triangle as a polygon of four points."
                )
            if len(values) in (4, 5):
                x, y, width, height = values[:4]
                more = values[4] if len(values) == 5 else None
                is_track = more is not None and more > 1.0 and more == int(more)
                rest["score"] = None if is_track else more
                rest |= {"track": int(more)} if is_track and more is not None else {}
                vertices, form = _box((x - width / 2, y - height / 2, x + width / 2, y + height / 2)), "box"
            elif len(values) >= 6 and len(values) % 2 == 0:
                vertices, form = np.array(values).reshape(-1, 2), "polygon"
            else:
                raise TableError(
                    f"{where}: {len(values) + 1} numbers; expected class x y width height [confidence], or class and "
                    f"the points of a polygon, x and y of each."
                )
            if np.max(np.abs(vertices)) > 2.0:
                raise TableError(f"{where}: coordinates are shares of the image, from 0 to 1; these are larger.")
            found.append(dataclasses.replace(_checked(where, path.stem, form, vertices, rest), is_share=True))
    return found


def _checked(where: str, image: str, kind: str, vertices: np.ndarray, rest: dict[str, Any]) -> Detection:
    if kind == "polygon" and len(vertices) > 1 and np.array_equal(vertices[0], vertices[-1]):
        vertices = vertices[:-1]
    if kind != "point" and (len(vertices) < 3 or not np.all(np.ptp(vertices, axis=0) > 0.0)):
        raise TableError(f"{where}: the {kind} has no area.")
    return Detection(image, kind, vertices, rest)


def _list(path: pathlib.Path, content: Mapping[str, Any], name: str) -> list[Any]:
    found = content.get(name)
    if not isinstance(found, list):
        raise TableError(f"{path}: its {name} are no list.")
    return found


def _pairs(where: str, values: Any) -> np.ndarray:
    try:
        found = np.array([[float(one) for one in pair[:2]] for pair in values], np.float64)
    except (TypeError, ValueError):
        found = np.zeros((0, 2))
    if found.ndim != 2 or found.shape[1:] != (2,) or not len(found) or not np.isfinite(found).all():
        raise TableError(f"{where}: its coordinates are no pairs of numbers, column and row in pixels.")
    return found


def _numbers(where: str, values: Any, count: int | None, form: str) -> list[float]:
    try:
        found = [float(one) for one in values]
    except (TypeError, ValueError):
        found = []
    if not found or (count is not None and len(found) != count) or not all(map(math.isfinite, found)):
        raise TableError(f"{where}: expected {form}.")
    return found

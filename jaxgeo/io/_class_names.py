"""Names of the classes of YOLO detections: `data.yaml` of a data set, or a list, one name a line.

Layout of `data.yaml`: Ultralytics, "Object Detection Datasets Overview": `names`, a list or a mapping of numbers from 0
to names; `nc`, their number, in older files; `path`, `train`, `val` and `test`, which are not read.
"""

from __future__ import annotations

import os
import pathlib
from typing import Any

from jaxgeo._text_numbers import whole_in
from jaxgeo.io._json import shown
from jaxgeo.io._text import read_text
from jaxgeo.io._yaml import read_yaml
from jaxgeo.io.errors import TableError

LIST = "classes.txt"
OF_DATA_SET = ("data.yaml", "data.yml")
YAML = (".yaml", ".yml")
PARENTS = 2  # folders above the labels: DATA/train/labels and DATA/labels/train, with DATA/data.yaml


def class_names(folder: pathlib.Path, given: str | os.PathLike[str] | None) -> dict[int, str]:
    """The names of classes by number: of the `given` file, else of `classes.txt` in a folder of detections, else of the
    nearest `data.yaml` in it or up to two folders above; {} without one.

    Raises `TableError` for a file without names, `FileNotFoundError`, and `ImportError` for YAML without PyYAML.
    """
    if given is not None:
        path = pathlib.Path(given)
        if path.suffix.lower() not in YAML:
            return _listed(path)
        content = read_yaml(path, "file of class names", extra="yolo")
        if not isinstance(content, dict) or "names" not in content:
            raise TableError(f"{path}: there is no key names, a list or a mapping of numbers to names of classes.")
        return _named(path, content)
    if (folder / LIST).is_file():
        return _listed(folder / LIST)
    for place in (folder, *folder.absolute().parents[:PARENTS]):
        for path in (place / name for name in OF_DATA_SET):
            if path.is_file():
                content = read_yaml(path, "file of class names", extra="yolo")
                return _named(path, content) if isinstance(content, dict) and "names" in content else {}
    return {}


def _listed(path: pathlib.Path) -> dict[int, str]:
    return {number: line.strip() for number, line in enumerate(read_text(path, "list of classes").split("\n"))}


def _named(path: pathlib.Path, content: dict[Any, Any]) -> dict[int, str]:
    names, count = content["names"], content.get("nc")
    pairs = list(enumerate(names)) if isinstance(names, list) else [*names.items()] if isinstance(names, dict) else []
    if not pairs:
        raise TableError(f"{path}: names must be a list, or a mapping of numbers to names; got {shown(names)}.")
    found: dict[int, str] = {}
    for key, name in pairs:
        number = key if isinstance(key, int) and not isinstance(key, bool) else whole_in(str(key))
        if number is None or number < 0:
            raise TableError(f"{path}: names has the key {shown(key)}; expected the number of a class, from 0.")
        if not isinstance(name, str | int | float) or isinstance(name, bool) or not str(name).strip():
            raise TableError(
                f"{path}: class {number} is called {shown(name)}; expected a name (in quotes, if need be)."
            )
        found[number] = str(name).strip()
    if count is not None and (not isinstance(count, int) or isinstance(count, bool) or count < 1):
        raise TableError(f"{path}: nc is {shown(count)}; expected the number of classes, {len(found)}, or no nc.")
    if count is not None and count != len(found):
        raise TableError(f"{path}: nc is {count}, but there are {len(found)} names; give the file of these detections.")
    return found

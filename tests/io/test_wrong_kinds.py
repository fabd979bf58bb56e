"""JSON, YAML and TOML with a value of another kind at any place: refused in a line that names the file, or read.

Held against: the three languages, each of which allows a table, a list, a text, a number or nothing at every place.
"""

from __future__ import annotations

import copy
import json
import pathlib
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
import yaml

from jaxgeo.demo import scene_file
from tests.fuzz.readers import READERS
from tests.fuzz.sound_exports import POSITIONS
from tests.fuzz.sound_files import CAMERA, EXTERIOR, INTERIOR, RECONSTRUCTION

KINDS = (None, True, 0, -1, 1e308, 10**30, "", "x" * 3000, "\u0661", "-", [], [[]], [None], {}, {"a": {}}, [1, 2, 3, 4])
READS = {reader.name: reader for reader in READERS}


def changed(content: Any) -> Iterator[Any]:
    """Copies of some content, each with another value at one place."""
    for place in _places(content):
        for value in KINDS:
            if not place:
                yield value
                continue
            other = copy.deepcopy(content)
            inner = other
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = value
            yield other


def _places(content: Any) -> Iterator[tuple[Any, ...]]:
    yield ()
    parts = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, part in parts:
        for inner in _places(part):
            yield (key, *inner)


JSON = {
    "points of OpenSfM": [RECONSTRUCTION],
    "reconstruction of OpenSfM": [RECONSTRUCTION],
    "cameras of OpenSfM": {"one": CAMERA},
    "exposures of Orthority": EXTERIOR,
    "positions of images": json.loads(POSITIONS[2]),
}


def check(name: str, path: pathlib.Path, texts: Iterable[str], fewest: int = 20) -> None:
    reader, told = READS[name], list[str]()
    for text in texts:
        path.write_text(text, encoding="utf-8")
        try:
            reader.check(reader.read(path))
        except reader.refusals as error:
            told.append(str(error))
    assert len(told) > fewest
    for message in told:
        assert path.name in message
        assert len(message) < 1500 or reader.several_lines


SLOW = ("reconstruction of OpenSfM", "exposures of Orthority")


@pytest.mark.costly
@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in JSON])
def test_json(tmp_path: pathlib.Path, name: str) -> None:
    check(name, tmp_path / f"a{READS[name].ending}", (json.dumps(one) for one in changed(JSON[name])))


def test_yaml(tmp_path: pathlib.Path) -> None:
    texts = (yaml.safe_dump(one, allow_unicode=True) for one in changed(yaml.safe_load(INTERIOR)))
    check("cameras of Orthority", tmp_path / "a.yaml", (text.replace("&id001", "") for text in texts))


TOML = ("true", "0", "-1", "1e308", "nan", "inf", "1" * 30, "9" * 6000, '""', "[]", "[[]]", "{}", "{a = {}}",
        "[1, 2, 3]", "1979-05-27", "07:32:00", '"' + "x" * 3000 + '"')  # fmt: skip


@pytest.mark.parametrize("share", [pytest.param(1, marks=pytest.mark.slow), 3], ids=["all", "every third"])
def test_toml(tmp_path: pathlib.Path, share: int) -> None:
    lines = scene_file().read_text(encoding="utf-8").splitlines()
    keys = {k: line.partition("=")[0] for k, line in enumerate(lines) if "=" in line and not line.startswith("#")}
    places = [(k, key, value) for k, key in keys.items() for value in TOML]
    texts = ("\n".join([*lines[:k], f"{key}= {value}", *lines[k + 1 :]]) for k, key, value in places[::share])
    check("scene", tmp_path / "a.toml", texts, fewest=100 // share)

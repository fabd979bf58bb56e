"""JSON files with validated values: every error names the file, the key and the reason."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxgeo.io._bounded import check_nesting_of_json, read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError

HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")  # half of a UTF-16 surrogate pair
LARGEST = 1e15  # limit of any number in such a file; NaN fails the comparison


def read_json(path: str | os.PathLike[str], what: str) -> Any:
    """The content of a JSON file; `what` describes it in messages.

    Raises `TableError` for a file that is invalid, truncated, too large or deep, or has a repeated key in one table;
    `FileNotFoundError`.
    """
    check_regular(path, TableError)
    try:
        content = read_bytes(path)
        check_nesting_of_json(path, content)
        text = content.decode("utf-8-sig")
        found = json.loads(text, object_pairs_hook=lambda pairs: _single(path, pairs), parse_int=_integer)
        if HALF_CHARACTER.search(text):
            _check_characters(path, found)
        return found
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file of a {what}.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: the {what} cannot be read: {error}.") from error
    except json.JSONDecodeError as error:
        raise TableError(f"{path}: not a JSON file, or cut off: {error}.") from error


def _check_characters(path: object, found: Any) -> None:
    """Raises `TableError` for a text with an unpaired UTF-16 surrogate, which cannot be written or displayed."""
    try:
        json.dumps(found, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        half = error.object[error.start]
        raise TableError(f"{path}: a text in it has {half!r}, half a character of UTF-16; write it anew.") from error


def value_of(where: str, content: Any, key: str) -> Any:
    """The value of a key; `where` names the table, whose keys may be null or numbers in YAML.

    Raises `TableError`, as all functions below.
    """
    if not isinstance(content, dict) or key not in content:
        found = ", ".join(map(str, list(content)[:8])) if isinstance(content, dict) else shown(content)
        raise TableError(f"{where}: {key} is missing; found {found or 'nothing'}.")
    return content[key]


def table_of(where: str, content: Any, key: str) -> dict[str, Any]:
    """A table under a key."""
    value = value_of(where, content, key)
    if not isinstance(value, dict):
        raise TableError(f"{where}, {key}: expected a table by name; got {shown(value)}.")
    return value


def number_of(where: str, content: Any, key: str, default: float | None = None) -> float:
    """A finite number under a key; `default` if the key is missing."""
    if default is not None and isinstance(content, dict) and key not in content:
        return default
    value = value_of(where, content, key)
    if not _is_number(value):
        raise TableError(f"{where}: {key} must be a finite number; got {shown(value)}.")
    return float(value)


def size_of(where: str, content: Any, key: str) -> int:
    """A number of pixels under a key."""
    value = number_of(where, content, key)
    if value < 1 or value != int(value):
        raise TableError(f"{where}: {key} must be a whole number of pixels above zero; got {value:g}.")
    return int(value)


def vectors_of(where: str, table: Mapping[str, Any], key: str, largest: float) -> np.ndarray:
    """Three numbers of magnitude up to `largest` under a key of each entry of a table, (n, 3)."""
    vectors = [_vector(where, name, entry, key, largest) for name, entry in table.items()]
    return np.array(vectors, np.float64).reshape(-1, 3)


def shown(value: Any) -> str:
    """A value in a message."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _vector(where: str, name: str, entry: Any, key: str, largest: float) -> list[float]:
    value = value_of(f"{where}, {name}", entry, key)
    if not isinstance(value, list) or len(value) != 3 or not all(map(_is_number, value)):
        raise TableError(f"{where}, {name}: {key} must be three finite numbers; got {shown(value)}.")
    if max(map(abs, value)) > largest:
        raise TableError(f"{where}, {name}: {key} is {shown(value)}, beyond {largest:g}; the file is damaged.")
    return [float(number) for number in value]


def _integer(digits: str) -> int | float:
    """An integer; with more digits than Python accepts it is infinite, which every check refuses."""
    return int(digits) if len(digits) < 400 else float(digits)


def _single(path: str | os.PathLike[str], pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        twice = next(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
        raise TableError(f"{path}: {twice!r} stands twice in one table.")
    return table


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST

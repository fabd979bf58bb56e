"""YAML files without references and repeated keys."""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

from jaxgeo.io._bounded import read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError
from jaxgeo.io.limits import NESTING, PARAMETER_BYTES


def read_yaml(path: str | os.PathLike[str], what: str, *, extra: str) -> Any:
    """The content of a YAML file; duplicate keys and references within the file are refused.

    `what` describes it in messages, `extra` is the extra of the package that brings PyYAML. Raises `TableError`,
    `FileNotFoundError`, and `ImportError` without PyYAML.
    """
    try:
        import yaml
    except ImportError as error:
        raise ImportError(f"Reading YAML needs PyYAML: pip install 'jaxgeo[{extra}]'.") from error
    check_regular(path, TableError)
    try:
        text = read_bytes(path, PARAMETER_BYTES).decode("utf-8-sig")
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            NESTING.check(path, depth)
            if isinstance(event, yaml.AliasEvent):
                raise TableError(
                    f"{path}, line {event.start_mark.line + 1}: references (*) are not read; write it out."
                )
        written, content = yaml.compose(text, Loader=yaml.SafeLoader), yaml.safe_load(text)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such {what}.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: the {what} cannot be read: {error}.") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, TableError):
            raise
        raise TableError(f"{path}: not a YAML file: {' '.join(str(error).split())}.") from error
    _refuse_doubles(path, written)
    return content


def _refuse_doubles(path: Any, node: Any) -> None:
    """Raises `TableError` for a duplicate key in one table of a YAML file."""
    pairs = node.value if node is not None and node.id == "mapping" else []
    seen = Counter(key.value for key, _ in pairs if isinstance(key.value, str))
    twice = [name for name, count in seen.items() if count > 1]
    if twice:
        raise TableError(f"{path}: {twice[0]!r} stands twice in one table.")
    for _, value in pairs:
        _refuse_doubles(path, value)

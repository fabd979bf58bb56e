"""Machine-readable results: one JSON object on stdout, of the same shape for every command."""

from __future__ import annotations

import enum
import importlib.metadata
import json
import math
import os
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from jaxgeo.cli._archive_dem import told
from jaxgeo.cli._assumed import with_said
from jaxgeo.cli._console import as_json
from jaxgeo.cli._options import OptionGroup

AsJson = Annotated[bool, typer.Option("--json", help="Print the whole result as one JSON object only.")]
NOT_ASKED = {"as_json", "debug"}  # output options, not inputs


def print_json(command: str, content: Mapping[str, Any]) -> None:
    """Print the result of a command.

    It is one object: `command`, `jaxgeo` (the version), `inputs` (options), `assumed` (sentences, those printed in the
    run too), then the command's
    own keys, `elevation_model` if that of an archive was used, and `versions` of the software. Angles are in degrees
    where names end in `_deg`, lengths in m; numbers have full precision; unknown values are null; a status is its name,
    with its sentence in `status_text`.
    """
    from jaxgeo.io.registration_report import versions

    whole = {"command": command, "jaxgeo": version(), "inputs": {}, "assumed": []}
    whole |= {**content, **told(), "versions": content.get("versions", versions())}
    whole["assumed"] = with_said(whole["assumed"])
    typer.echo(as_json(json.dumps(plain(whole), indent=1, ensure_ascii=False, allow_nan=False)))


def version() -> str:
    """Installed version of the package."""
    try:
        return importlib.metadata.version("jaxgeo")
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def given_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Given options by name, from the `locals()` at the start of a command; groups of options as their fields, without
    flags that are not set."""
    found: dict[str, Any] = {}
    for name, value in options.items():
        of_group = isinstance(value, OptionGroup)
        found |= {key: one for key, one in vars(value).items() if one is not False} if of_group else {name: value}
    return {name: plain(value) for name, value in found.items() if name not in NOT_ASKED and value is not None}


def plain(value: Any) -> Any:
    """A JSON value: NaN and infinities become null, arrays lists, enum members and paths strings."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, enum.Enum):
        return value.value if isinstance(value, str) else value.name
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    return plain(value.tolist()) if hasattr(value, "tolist") else str(value)


def status_words(status: Any, instead: str | None = None) -> dict[str, str]:
    """`status` and `status_text` of a result; `instead` replaces the sentence of `hit`."""
    from jaxgeo.status import Status

    found = Status(int(status))
    text = instead if instead is not None and found == Status.hit else found.message
    return {"status": found.name, "status_text": text}

"""Results for machines: one JSON object on stdout, of the same shape for every command."""

from __future__ import annotations

import enum
import importlib.metadata
import json
import math
import os
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from jaxgeo.cli._console import as_json

AsJson = Annotated[bool, typer.Option("--json", help="Print the whole result as one JSON object, and nothing else.")]
NOT_ASKED = {"as_json", "debug"}  # how it is said, not what is asked


def print_json(command: str, content: Mapping[str, Any]) -> None:
    """Print the result of a command.

    It is one object: `command`, `jaxgeo` (the version), `inputs` (what was asked), `assumed` (sentences: what nobody
    said), then the command's own, and `versions` of what computed it. Angles are in degrees where names say `_deg`,
    lengths in m; numbers have all their digits; what is unknown is null; a status is its name, and `status_text` says
    it in a sentence.
    """
    from jaxgeo.io.registration_report import versions

    whole = {"command": command, "jaxgeo": version(), "inputs": {}, "assumed": []}
    whole |= {**content, "versions": content.get("versions", versions())}
    typer.echo(as_json(json.dumps(plain(whole), indent=1, ensure_ascii=False, allow_nan=False)))


def version() -> str:
    """That of the package, as it was installed."""
    try:
        return importlib.metadata.version("jaxgeo")
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def asked(options: Mapping[str, Any]) -> dict[str, Any]:
    """What was asked for, of the `locals()` with which a command begins: options by name, but for those left out."""
    return {name: plain(value) for name, value in options.items() if name not in NOT_ASKED and value is not None}


def plain(value: Any) -> Any:
    """What JSON can hold: NaN and infinities are null, arrays lists, members of enums and paths texts."""
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
    """`status` and `status_text` of a result; `instead` is what `hit` means here."""
    from jaxgeo.status import Status

    found = Status(int(status))
    text = instead if instead is not None and found == Status.hit else found.message
    return {"status": found.name, "status_text": text}

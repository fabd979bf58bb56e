"""Serialisation of records within functions that `jax.export` exports: their class and static fields, as JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Sequence
from typing import Any, cast

from jax import export

_CLASSES: dict[str, type] = {}  # records by the name in serialised functions


def register_for_export(cls: type) -> None:
    """Let exported functions of arguments or results of a class of records be serialised, under its full name.

    Of classes with the same name, defined one after the other, only the first is registered.
    """
    name = name_of(cls)
    if name in _CLASSES:
        return
    with contextlib.suppress(ValueError):  # registered by another library under this name
        export.register_pytree_node_serialization(
            cls,
            serialized_name=name,
            serialize_auxdata=_to_json,
            deserialize_auxdata=_from_json,
            from_children=lambda aux_data, children: _filled(cls, cast("list[Any]", aux_data), children),
        )
        _CLASSES[name] = cls


def name_of(cls: type) -> str:
    """Full name of a class."""
    return f"{cls.__module__}.{cls.__qualname__}"


def _filled(cls: type, static: Sequence[Any], children: Sequence[Any]) -> Any:
    """A record from its static fields and its others, both in order."""
    fields: dict[bool, list[str]] = {True: [], False: []}
    for field in dataclasses.fields(cls):  # pyright: ignore[reportArgumentType]
        fields[bool(field.metadata.get("static", False))].append(field.name)
    values = zip((*fields[True], *fields[False]), (*static, *children), strict=True)
    record = object.__new__(cls)
    for name, value in values:
        object.__setattr__(record, name, value)
    return record


def _to_json(auxiliary: Any) -> bytes:
    """The static fields as equinox holds them: its mark of a record that wraps no function, and their values."""
    mark, *static = auxiliary
    if isinstance(mark, tuple):
        raise TypeError("a record that wraps a function cannot be serialised.")
    return json.dumps([_encoded(value) for value in static]).encode()


def _from_json(text: bytes | bytearray) -> list[Any]:
    return [_decoded(value) for value in json.loads(bytes(text))]


def _encoded(value: Any) -> Any:
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, tuple):
        return {"tuple": [_encoded(item) for item in value]}
    if _CLASSES.get(name_of(type(value))) is type(value):
        return {"class": name_of(type(value)), "fields": {name: _encoded(item) for name, item in vars(value).items()}}
    raise TypeError(f"a static field of a record cannot be serialised: it is a {type(value).__name__}, {value!r}.")


def _decoded(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_decoded(item) for item in value["tuple"])
    cls = _CLASSES[value["class"]]
    record = object.__new__(cls)
    for name, item in value["fields"].items():
        object.__setattr__(record, name, _decoded(item))
    return record

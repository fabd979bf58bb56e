"""Messages for invalid scene files: the key, its value, and the expected key, unit or range."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from jaxgeo.io._schema import SceneTable, Unit

_BRANCH = re.compile(r"(constrained-)?(str|float)|(list|union)\[.*\]|StatedTable")  # pydantic's name of a union branch

UNITS = re.compile(r"_(deg|rad|mrad|m|mm|um|cm|km|ft|feet|px|pixels|s|ms)$")
IN_DOUBT = 0.05  # difference of likeness of two spellings to a third that leaves open which was meant


def explain(error: ValidationError, content: Mapping[str, Any]) -> list[str]:
    """One sentence for each mistake: the key, the value, and the expected key, unit or range."""
    mistakes = list(_without_branches(error))
    unknown = [e["loc"] for e in mistakes if e["type"] == "extra_forbidden"]
    suggested = {(*loc[:-1], name) for loc in unknown for name in _meant(loc)}
    lines = []
    for mistake in mistakes:
        if mistake["type"] == "missing" and mistake["loc"] in suggested:
            continue  # already reported with the misspelt key
        lines.append(_sentence(mistake, content))
    return lines


def _without_branches(error: ValidationError) -> Iterator[dict[str, Any]]:
    """Errors with the names of union branches removed from their location, each location once."""
    found = {}
    for entry in error.errors():
        loc = tuple(part for part in entry["loc"] if isinstance(part, int) or not _BRANCH.fullmatch(part))
        found.setdefault(loc, {**entry, "loc": loc})
    for loc, entry in found.items():
        is_a_list = any(len(other) > len(loc) and other[: len(loc)] == loc for other in found)
        if not (entry["type"] == "float_type" and is_a_list):  # the mistake inside the list is reported
            yield entry


def _sentence(mistake: Mapping[str, Any], content: Mapping[str, Any]) -> str:
    loc, kind = mistake["loc"], mistake["type"]
    where = _address(loc)
    if kind == "missing":
        return f"{where} is missing{_expected(loc, '; expected ')}."
    if kind == "value_error":
        return f"{where}: {mistake['ctx']['error']}."
    value = _value_at(content, loc)
    if kind == "extra_forbidden":
        shown = f"[{where}]" if isinstance(value, dict) else f"{where} = {value!r}"
        return f"{shown}: unknown {'table' if isinstance(value, dict) else 'key'}; {_advice(loc)}."
    if kind in _BOUNDS:
        word, bound = _BOUNDS[kind]
        unit = _unit_of(loc) or ""
        limit = f"{mistake['ctx'][bound]:g}{'; expected ' if unit.startswith(('a ', 'one ')) else ' '}{unit}"
        return f"{where} = {value!r}: must be {word} {limit}."
    reason = mistake["msg"].replace("Input should be", "must be").replace("List should have", "must have")
    return f"{where} = {value!r}: {reason.replace(' after validation', '')}{_expected(loc, ', expected ')}."


_BOUNDS = {
    "greater_than_equal": ("at least", "ge"),
    "less_than_equal": ("at most", "le"),
    "greater_than": ("greater than", "gt"),
}


def _address(loc: tuple[Any, ...]) -> str:
    tables = [part for part in loc[:-1] if isinstance(part, str)]
    last = loc[-1]
    if isinstance(last, int):
        return f"{_address(loc[:-1])}[{last}]"
    return f"[{'.'.join(tables)}] {last}" if tables else (f"[{last}]" if _table_at(loc) else str(last))


def _value_at(content: Any, loc: tuple[Any, ...]) -> Any:
    for part in loc:
        content = content[part]
    return content


def _table_at(loc: tuple[Any, ...]) -> type[BaseModel] | None:
    """The model of the table at a location, or None."""
    table: type[BaseModel] | None = SceneTable
    for part in loc:
        field = table.model_fields.get(part) if table and isinstance(part, str) else None
        table = _table_of(field) if field else None
    return table


def _table_of(field: FieldInfo) -> type[BaseModel] | None:
    return _table_in(field.annotation)


def _table_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((table for part in getattr(annotation, "__args__", ()) if (table := _table_in(part))), None)


def _unit_of(loc: tuple[Any, ...]) -> str | None:
    names = tuple(part for part in loc if isinstance(part, str))
    parent = _table_at(names[:-1])
    field = parent.model_fields.get(names[-1]) if parent else None
    return _find_unit(field) if field else None


def _find_unit(field: Any) -> str | None:
    metadata = [*getattr(field, "metadata", ()), *getattr(field, "__metadata__", ())]
    units = [str(item) for item in metadata if isinstance(item, Unit)]
    nested = getattr(getattr(field, "annotation", field), "__args__", ())
    return next(iter(units), None) or next((unit for part in nested if (unit := _find_unit(part))), None)


def _expected(loc: tuple[Any, ...], lead: str) -> str:
    unit = _unit_of(loc)
    if unit is None or unit == "1":
        return ""
    return f"{lead}{unit if ' ' in unit else 'in ' + unit}"


def _stem(key: str) -> str:
    return UNITS.sub("", key)


def _meant(loc: tuple[Any, ...]) -> list[str]:
    """The known keys that an unknown one may mean: a longer or shorter name in the same unit, or in any if it has none,
    else the same word in another unit, else those of the nearest spelling."""
    key, table = str(loc[-1]), _table_at(loc[:-1])
    known, unit = list(table.model_fields) if table else [], UNITS.search(key)
    same_unit = [name for name in known if name.endswith(unit[0] if unit else "") and _extends(name, key)]
    same_word = [name for name in known if _stem(name) == _stem(key)]
    near = difflib.get_close_matches(key, known, n=3, cutoff=0.6)
    nearest = [name for name in near if _likeness(name, key) > _likeness(near[0], key) - IN_DOUBT]
    return same_unit or same_word or nearest


def _extends(one: str, other: str) -> bool:
    """Whether the words of one key begin with those of the other."""
    short, long = sorted((_stem(one).split("_"), _stem(other).split("_")), key=len)
    return long[: len(short)] == short


def _likeness(one: str, other: str) -> float:
    return difflib.SequenceMatcher(None, one, other).ratio()


def _advice(loc: tuple[Any, ...]) -> str:
    meant, table = _meant(loc), _table_at(loc[:-1])
    if meant:
        return "write " + "; or ".join(f"{name}{_expected((*loc[:-1], name), ', ')}" for name in meant)
    return f"known here: {', '.join(table.model_fields)}" if table else "no table is expected here"

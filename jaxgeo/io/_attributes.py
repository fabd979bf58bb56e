"""Attributes of rows of a file: a mapping for each row, or one mapping of columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def attribute_rows(name: str, attributes: Any, count: int, noun: str) -> Any:
    """Attributes by row, from one mapping of names to `count` values each, or to one value for a single row.

    Attributes that are no mapping are returned as they are. `noun` is what rows are, in the plural. Raises `ValueError`
    for columns of another length.
    """
    if not isinstance(attributes, Mapping):
        return attributes
    columns: dict[str, list[Any]] = {}
    for key, values in attributes.items():
        is_single = isinstance(values, str | bytes) or np.ndim(_sizes(values)) == 0
        if is_single and count > 1:
            raise ValueError(
                f"{name}: attributes must be a list with a mapping for each of {count} {noun}, or one mapping of names "
                f"to {count} values each; {key!r} has one value, {values!r}."
            )
        columns[str(key)] = [values] if is_single else list(values)
        if len(columns[str(key)]) != count:
            raise ValueError(
                f"{name}: the attribute {key!r} has {len(columns[str(key)])} values; expected one for each of {count} "
                f"{noun}."
            )
    return [{key: values[row] for key, values in columns.items()} for row in range(count)]


def _sizes(values: Any) -> Any:
    """Something with the number of dimensions of values: lists may hold texts and None."""
    return values if hasattr(values, "shape") else np.zeros(len(values)) if hasattr(values, "__len__") else 0.0

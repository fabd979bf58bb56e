"""Identity of a sampling: digests of all that was sampled, so that only parts of one sampling are merged."""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import pickle
import types
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


class Origin:
    """What was sampled, by name: equal if all values and their structure are.

    Compared by digests, which are computed when first needed; until then the values are kept. They are the same in
    every process. A function counts as equal to one of the same name, code and enclosed values.
    """

    def __init__(self, **values: Any) -> None:
        self._values: dict[str, Any] = values
        self._digests: dict[str, str] = {}

    @property
    def digests(self) -> dict[str, str]:
        """A digest of each value. Raises `TypeError` for values that neither records, arrays nor pickle hold."""
        if self._values:
            self._digests = {name: digest_of(value) for name, value in self._values.items()}
            self._values = {}
        return self._digests

    def differences(self, other: Origin) -> list[str]:
        """Names of the values that differ."""
        theirs = other.digests
        return [name for name, digest in self.digests.items() if theirs.get(name) != digest]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin) and self.digests == other.digests

    def __hash__(self) -> int:
        return hash(tuple(self.digests.items()))

    def __repr__(self) -> str:
        return f"Origin({', '.join([*self._values, *self._digests])})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _loaded, (self.digests,)


def _loaded(digests: dict[str, str]) -> Origin:
    origin = Origin()
    origin._digests = digests
    return origin


def digest_of(value: Any) -> str:
    """Digest of a value: records, containers, arrays, keys, functions, or anything that can be pickled."""
    total = hashlib.blake2b(digest_size=16)
    _add(total, value, ())
    return total.hexdigest()


def _add(total: Any, value: Any, within: tuple[int, ...]) -> None:
    """Add a value to a digest; `within` are the identities of the values that enclose it."""
    if id(value) in within:
        total.update(f"<{len(within) - within.index(id(value))} up>".encode())
        return
    within = (*within, id(value))
    kind, content, items = _taken_apart(value)
    total.update(f"<{kind}:{len(items)}>".encode())
    total.update(content)
    for item in items:
        _add(total, item, within)


def _taken_apart(value: Any) -> tuple[str, Any, list[Any]]:
    """(kind, bytes, enclosed values) of a value."""
    name = f"{type(value).__module__}.{type(value).__qualname__}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | enum.Enum):
        return name, repr(value).encode(), []
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return f"key {jax.random.key_impl(value)}", b"", [np.asarray(jax.random.key_data(value))]
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        return f"array {array.dtype.str} {np.shape(value)}", array.data if array.size else b"", []
    if isinstance(value, dict):
        return name, b"", [part for item in value.items() for part in item]
    if isinstance(value, tuple | list):
        return name, b"", list(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return name, b"", [part for item in vars(value).items() for part in item]
    if isinstance(value, types.FunctionType):
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return f"{value.__module__}.{value.__qualname__}", b"", [value.__code__, value.__defaults__, *cells]
    if isinstance(value, types.CodeType):
        return "code", value.co_code, [value.co_names, value.co_consts]
    if isinstance(value, type):
        return f"class {value.__module__}.{value.__qualname__}", b"", []
    try:
        return name, pickle.dumps(value), []
    except Exception as error:
        raise TypeError(
            f"samples cannot be merged or pickled here, since a {name} within what was sampled cannot be compared with "
            f"that of other parts: {error}"
        ) from error

"""Records with full-precision numbers, and checks of their transfer to another process."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgeo
from jaxgeo._record import Record


class Pair(NamedTuple):
    """A container as used in results."""

    first: Any
    second: Any


def with_awkward_numbers(cls: type[Record]) -> Record:
    """A record whose fields hold numbers that need all 53 bits, in an array or in a container."""
    record = object.__new__(cls)
    for i, field in enumerate(dataclasses.fields(cls)):
        number = jnp.asarray([np.pi * 10.0**i, np.nextafter(6378137.0, 7e6), -0.0, 5e-324])
        held = [number, (number, {"of": number}), [number], Pair(number, jnp.asarray(2**40 + 1)), np.asarray(number)]
        object.__setattr__(record, field.name, "static" if field.metadata.get("static") else held[i % len(held)])
    return record


def leaves_of(value: Any) -> list[tuple[str, str, str]]:
    """(kind, dtype, bytes) of each array in a record, collected without pytrees."""
    if isinstance(value, jax.Array | np.ndarray):
        kind = "jax" if isinstance(value, jax.Array) else "numpy"
        return [(kind, str(value.dtype), np.asarray(value).tobytes().hex())]
    if isinstance(value, dict):
        return [leaf for item in value.values() for leaf in leaves_of(item)]
    if isinstance(value, tuple | list):
        return [leaf for item in value for leaf in leaves_of(item)]
    return leaves_of(vars(value)) if dataclasses.is_dataclass(value) and not isinstance(value, type) else []


def digits(place: jaxgeo.Geodetic) -> list[str]:
    """Hexadecimal digits of a record as read in a worker process."""
    return [float(value).hex() for value in (place.lat, place.lon, place.height)]


def send_digits(place: jaxgeo.Geodetic, connection: Any) -> None:
    """The same for a process without a pool."""
    connection.send(digits(place))


def compute_in_32_bits() -> None:
    """Compute in 32 bits, as a worker process may have done before."""
    assert jnp.zeros(3).dtype == jnp.float32

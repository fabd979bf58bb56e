"""A tree of arrays on several devices, in few arrays: each takes some 20 us to send, however small it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgeo._accelerator import on_accelerator
from jaxgeo._record import Record

SMALL = 10_000  # bytes of an array that is sent from the host, with others of its kind
T = TypeVar("T")


def mesh_of(devices: Sequence[Any]) -> Mesh:
    """The devices as a mesh with the axis "samples"."""
    return Mesh(np.array(devices), ("samples",))


class Replicated(Record):
    """A tree whose arrays are on all devices of a sampling: small ones joined by their kind, large ones each once.

    `places` has, for each leaf of the tree, (number of its array, first item, shape), or the leaf if it is no array.
    """

    arrays: tuple[Any, ...]
    places: tuple[Any, ...] = eqx.field(static=True)
    form: Any = eqx.field(static=True)

    @classmethod
    def of(cls, tree: Any, devices: Sequence[Any]) -> Replicated:
        """The tree on these devices; large arrays that are there already stay."""
        leaves, form = jax.tree.flatten(tree)
        are_joined = not on_accelerator(devices)
        sent: list[Any] = []
        of_kind: dict[Any, tuple[int, list[np.ndarray]]] = {}
        places: list[Any] = []
        for leaf in leaves:
            if not eqx.is_array(leaf):
                places.append(leaf)
            elif not are_joined or leaf.nbytes >= SMALL or jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
                places.append((len(sent), 0, None))
                sent.append(leaf)
            else:
                number, parts = of_kind.setdefault(leaf.dtype, (len(sent), []))
                if not parts:
                    sent.append(None)
                places.append((number, sum(part.size for part in parts), leaf.shape))
                parts.append(np.asarray(leaf).ravel())
        for number, parts in of_kind.values():
            sent[number] = np.concatenate(parts)
        return cls(tuple(on_all(sent, devices)), tuple(places), form)

    def tree(self) -> Any:
        """The tree; in a program, where taking the arrays apart costs nothing."""

        def leaf(place: Any) -> Any:
            if not isinstance(place, tuple):
                return place
            number, first, shape = place
            array = self.arrays[number]
            if shape is None:
                return array
            return array[first : first + int(np.prod(shape))].reshape(shape)

        return jax.tree.unflatten(self.form, [leaf(place) for place in self.places])


def on_all(tree: T, devices: Sequence[Any]) -> T:
    """The tree with its arrays on all devices, each of them sent once."""
    leaves, form = jax.tree.flatten(tree)
    arrays = {id(leaf): leaf for leaf in leaves}
    sent = jax.device_put(list(arrays.values()), NamedSharding(mesh_of(devices), PartitionSpec()))
    there = dict(zip(arrays, sent, strict=True))
    return jax.tree.unflatten(form, [there[id(leaf)] for leaf in leaves])


def large_on_all(tree: T, devices: Sequence[Any]) -> T:
    """The tree with its large arrays on all devices."""
    large, rest = eqx.partition(tree, lambda leaf: eqx.is_array(leaf) and leaf.nbytes >= SMALL)
    return eqx.combine(on_all(large, devices), rest)


def whole(tree: Any) -> Any:
    """The tree of a `Replicated`; any other tree as it is."""
    return tree.tree() if isinstance(tree, Replicated) else tree

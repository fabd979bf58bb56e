"""Trees of arrays sent to several devices."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.uncertainty.replicated import SMALL, Replicated, large_on_all, whole

LARGE = np.arange(SMALL, dtype=np.float64)
TREE = {
    "numbers": [np.float64(3.0) * np.ones(()), jnp.asarray([1.0, 2.0]), np.eye(3)],
    "none": np.zeros((0, 3)),
    "flags": (jnp.asarray(True), np.array([False, True])),
    "cells": np.arange(6, dtype=np.int32).reshape(2, 3),
    "words": np.array([7, 2**32 - 1], np.uint32),
    "key": jax.random.key(5),
    "large": (LARGE, LARGE),
    "others": ("facet", None, 3, -1.5),
}


def equal(found: object, expected: object) -> None:
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for here, there in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        if isinstance(there, jax.Array | np.ndarray):
            assert here.dtype == there.dtype
            assert here.shape == there.shape
            is_key = jnp.issubdtype(there.dtype, jax.dtypes.prng_key)
            read = jax.random.key_data if is_key else np.asarray
            np.testing.assert_array_equal(read(here), read(there))
        else:
            assert here == there


def test_a_tree_comes_back_as_it_was_in_few_arrays() -> None:
    sent = Replicated.of(TREE, jax.devices()[:1])
    equal(whole(sent), TREE)
    equal(jax.jit(lambda sent: [leaf for leaf in jax.tree.leaves(sent.tree()) if hasattr(leaf, "dtype")])(sent),
          [leaf for leaf in jax.tree.leaves(TREE) if hasattr(leaf, "dtype")])  # fmt: skip
    assert len(sent.arrays) == 7  # four kinds of small ones, the key, and the large one twice
    large = [array for array in sent.arrays if array.size == LARGE.size]
    assert len(large) == 2
    assert large[0] is large[1]


def test_another_tree_is_itself() -> None:
    assert whole(TREE) is TREE
    equal(large_on_all(TREE, jax.devices()[:1]), TREE)

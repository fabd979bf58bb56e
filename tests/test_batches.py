"""A function over many items, a batch at a time: the same answers, one program, and memory for the result alone."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import _accelerator

CALLS: list[tuple[int, ...]] = []


@pytest.fixture(autouse=True)
def given_back(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """How often memory was given back, which takes a second in a large process and is not done here."""
    calls: list[bool] = []
    monkeypatch.setattr("jaxgeo.batches._give_back", lambda *_: calls.append(True))
    return calls


def moved(p: Any, by: Any) -> tuple[Any, Any]:
    """Told each time that it is traced."""
    CALLS.append(p.shape)
    return p + by, jnp.sum(p * p) > 1.0


@pytest.mark.parametrize("is_accelerator", [False, True], ids=["CPU", "accelerator"])
@pytest.mark.parametrize("count, size", [(1, 1), (7, 3), (6, 3), (5, 100), (10, 4)])
def test_answers_are_those_of_all_at_once(
    count: int, size: int, is_accelerator: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: is_accelerator)
    p, by = np.random.default_rng(count).normal(size=(count, 2)), jnp.array([1.0, -2.0])
    found = jaxgeo.in_batches(moved, p, by, size=size)
    right = jax.vmap(moved, in_axes=(0, None))(jnp.asarray(p), by)
    for own, whole in zip(found, right, strict=True):
        assert isinstance(own, np.ndarray)
        np.testing.assert_array_equal(own, whole)


def test_what_is_left_over_is_no_second_program(given_back: list[bool]) -> None:
    p = np.zeros((11, 2))
    jaxgeo.in_batches(moved, p, jnp.zeros(2), size=4)
    assert given_back == [True], "once, after the first batch"
    CALLS.clear()
    jaxgeo.in_batches(moved, p[:10], jnp.ones(2), size=4)
    assert CALLS == []


def test_records_keep_their_form() -> None:
    positions = jaxgeo.Geodetic(lat=np.full(5, 0.8), lon=np.linspace(0.0, 0.1, 5), height=np.zeros(5))
    ecef = jaxgeo.in_batches(jaxgeo.WGS84.to_ecef, positions, size=2)
    assert ecef.shape == (5, 3)
    back = jaxgeo.in_batches(jaxgeo.WGS84.to_geodetic, ecef, size=2)
    assert isinstance(back, jaxgeo.Geodetic)
    np.testing.assert_allclose(back.lon, positions.lon, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    "many, size, message",
    [
        (np.zeros((0, 2)), 4, r"at least one item; got shapes \(0, 2\)"),
        ((np.zeros((3, 2)), np.zeros(4)), 4, r"one leading axis of at least one item; got shapes \(3, 2\), \(4,\)"),
        (np.zeros(()), 4, r"got shapes \(\)"),
        (np.zeros((3, 2)), 0, "size must be an integer of at least 1, .*; got 0"),
    ],
)
def test_mistakes_are_refused(many: Any, size: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        jaxgeo.in_batches(moved, many, jnp.zeros(2), size=size)


MEASURED = """
import pathlib, re, sys
import numpy as np, jax, jax.numpy as jnp, jaxgeo
jaxgeo.enable_x64()
how, count = sys.argv[1], int(sys.argv[2])
M = np.random.default_rng(0).normal(size=(100, 100)) / 10.0
def wide(x):  # 0.8 kB for each item on the way to 8 bytes
    return jnp.sum(jnp.asarray(M) @ jnp.tanh(jnp.asarray(M) @ (x + jnp.arange(100.0))))
x = np.linspace(0.0, 1.0, count)
# Not of getrusage, which begins with what the process that started this one had.
resident = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1])
jaxgeo.in_batches(wide, x[:16384])
before = resident()
if how == "in_batches":
    jaxgeo.in_batches(wide, x)
else:
    jax.block_until_ready(jax.jit(jax.vmap(wide))(x))
print(resident() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory as Linux tells it, in kB")
def test_memory_is_that_of_the_result_and_one_batch() -> None:
    def more(how: str, count: int) -> float:
        run = [sys.executable, "-c", textwrap.dedent(MEASURED), how, str(count)]
        return 1024.0 * float(subprocess.run(run, capture_output=True, check=True, text=True).stdout)

    at_once, parts = more("vmap", 300_000), more("in_batches", 300_000)
    assert parts < 0.3 * at_once
    assert at_once > 200e6  # bytes: of the items in between, 240 MB at least

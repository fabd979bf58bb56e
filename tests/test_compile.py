"""Programs of single calls, and the folder in which programs are kept."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo._compile import quick_filter_jit, quick_jit
from jaxgeo._program_cache import forget_oldest

KEEPS = """
import json, sys, warnings
import jax
import jax.numpy as jnp
import jaxgeo
read = []
jax.monitoring.register_event_listener(lambda name, **_: read.append(name) if name.endswith("/cache_hits") else None)
folder = jaxgeo.keep_programs()
x = float(jax.jit(lambda x: jnp.sin(x) * 3.0 + x)(jnp.asarray(2.0)))
print(json.dumps([str(folder), x, len(read), jax.config.jax_compilation_cache_dir]))
"""


@pytest.mark.parametrize("jit", [quick_jit, quick_filter_jit])
def test_a_quick_program_is_the_function_alone_and_within_transformations(jit: Any) -> None:
    def function(x: jax.Array, *, power: Any = 2.0) -> jax.Array:
        return jnp.sum(jnp.sin(x) ** power)

    quick, x = jit(function), jnp.linspace(0.1, 1.0, 7)
    assert quick.__name__ == "function"
    np.testing.assert_allclose(quick(x), function(x), rtol=1e-14)
    np.testing.assert_allclose(quick(x, power=3.0), function(x, power=3.0), rtol=1e-14)
    np.testing.assert_allclose(jax.jit(quick)(x), function(x), rtol=1e-14)
    np.testing.assert_allclose(jax.grad(quick)(x), jax.grad(function)(x), rtol=1e-14)
    np.testing.assert_allclose(jax.vmap(quick)(x[:, None]), jnp.sin(x) ** 2, rtol=1e-14)


def test_arguments_that_are_no_arrays_are_parts_of_a_filtered_program() -> None:
    quick = quick_filter_jit(lambda x, name: x * len(name))
    assert float(quick(jnp.asarray(2.0), "abc")) == 6.0
    assert float(quick(jnp.asarray(2.0), "ab")) == 4.0


def _in_a_process(**environment: str) -> list[Any]:
    left = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_COMPILATION", "JAXGEO_C"))}
    environment = {**left, "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    done = subprocess.run([sys.executable, "-c", KEEPS], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_second_process_reads_the_programs_of_the_first(tmp_path: pathlib.Path) -> None:
    folder, value, read, used = _in_a_process(JAXGEO_CACHE_DIR=str(tmp_path))
    assert pathlib.Path(folder).parent == tmp_path
    assert used == folder
    assert read == 0
    assert any(pathlib.Path(folder).iterdir())
    again = _in_a_process(JAXGEO_CACHE_DIR=str(tmp_path))
    assert again[:2] == [folder, value]
    assert again[2] > 0, "programs were compiled again"


def test_no_programs_are_kept_if_the_variable_is_empty(tmp_path: pathlib.Path) -> None:
    assert _in_a_process(JAXGEO_CACHE_DIR="", HOME=str(tmp_path), XDG_CACHE_HOME=str(tmp_path))[0] == "None"
    assert not any(tmp_path.rglob("*jaxlib*"))


def test_a_folder_set_in_jax_is_left_as_it_is(tmp_path: pathlib.Path) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir()
    folder, _, _, used = _in_a_process(JAXGEO_CACHE_DIR=str(other), JAX_COMPILATION_CACHE_DIR=str(own))
    assert folder == used == str(own)
    assert not other.exists()


def test_programs_beyond_the_limit_go_those_unused_for_longest_first(tmp_path: pathlib.Path) -> None:
    for age in range(10):
        one = tmp_path / f"program-{age}"
        one.write_bytes(bytes(100))
        os.utime(one, (1e9 - age, 1e9 - age))
    forget_oldest(tmp_path, 1000)
    assert len(list(tmp_path.iterdir())) == 10
    forget_oldest(tmp_path, 900)
    assert sorted(one.name for one in tmp_path.iterdir()) == [f"program-{age}" for age in range(4)]


def test_a_limit_that_holds_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="largest must be a number of bytes, 1 or more; got 0"):
        jaxgeo.keep_programs(largest=0)

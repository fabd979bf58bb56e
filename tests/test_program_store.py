"""Programs found again on disk by what they are called with."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import _program_store
from jaxgeo._program_store import Programs

TRACED: list[str] = []


def function(x: Any, y: Any, *, word: str = "sum") -> Any:
    """Of arrays and a word; notes when it is traced."""
    TRACED.append(word)
    total = jnp.sum(x) if word == "sum" else jnp.prod(x)
    return {"total": total + y, "word": word, "none": None}


@pytest.fixture
def traced() -> list[str]:
    TRACED.clear()
    return TRACED


def in_a_new_process(of: Any = function) -> Programs:
    """Programs as a process has them that has compiled nothing yet."""
    return Programs(of, dict, eqx.is_array)


def called(programs: Programs, folder: pathlib.Path, *args: Any, **options: Any) -> Any:
    call = programs.call(folder, args, options)
    assert call is not None
    return call()


def test_a_later_process_does_not_trace(traced: list[str], tmp_path: pathlib.Path) -> None:
    x = jnp.arange(1.0, 5.0)
    found = [called(in_a_new_process(), tmp_path, x, jnp.asarray(0.5)) for _ in range(3)]
    assert len(traced) == 1
    for one in found:
        assert float(one["total"]) == 10.5
        assert (one["word"], one["none"]) == ("sum", None)
    assert len(list(tmp_path.iterdir())) == 1


def test_other_numbers_are_of_the_same_program(traced: list[str], tmp_path: pathlib.Path) -> None:
    programs = in_a_new_process()
    assert float(called(programs, tmp_path, jnp.ones(4), jnp.asarray(0.5, float))["total"]) == 4.5
    assert float(called(programs, tmp_path, 2.0 * jnp.ones(4), jnp.asarray(1.0, float))["total"]) == 9.0
    assert float(called(programs, tmp_path, np.full(4, 3.0), np.asarray(1.0))["total"]) == 13.0
    assert len(traced) == 1


OTHERS: dict[str, Callable[[], tuple[tuple[Any, ...], dict[str, Any]]]] = {
    "shape": lambda: ((jnp.ones(5), jnp.asarray(0.5)), {}),
    "dtype": lambda: ((jnp.ones(4, jnp.float32), jnp.asarray(0.5)), {}),
    "weak type": lambda: ((jnp.ones(4, jnp.float32), jnp.asarray(0.5, jnp.float64)), {}),
    "word": lambda: ((jnp.ones(4), jnp.asarray(0.5)), {"word": "product"}),
    "number of Python": lambda: ((jnp.ones(4), 0.5), {}),
    "another number of Python": lambda: ((jnp.ones(4), 0.25), {}),
    "an int for a float": lambda: ((jnp.ones(4), 1), {}),
    "a float for an int": lambda: ((jnp.ones(4), 1.0), {}),
    "True for 1": lambda: ((jnp.ones(4), True), {}),
}


def test_every_other_kind_is_another_program(traced: list[str], tmp_path: pathlib.Path) -> None:
    for number, args in enumerate(OTHERS.values()):
        for _ in range(2):
            given, options = args()
            found = called(in_a_new_process(), tmp_path, *given, **options)
            plain = function(*given, **options)
            traced.pop()
            assert found["total"] == plain["total"]
            assert found["total"].dtype == plain["total"].dtype
        assert len(traced) == number + 1


def test_settings_and_flags_are_part_of_the_name(
    traced: list[str], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    args = jnp.ones(4), jnp.asarray(0.5)
    call = lambda: called(in_a_new_process(), tmp_path, *args)  # noqa: E731
    call()
    with jax.numpy_dtype_promotion("strict"):
        call()
    assert len(traced) == 2
    monkeypatch.setenv("XLA_FLAGS", os.environ.get("XLA_FLAGS", "") + " ")
    call()
    assert len(traced) == 3
    monkeypatch.setattr(_program_store, "_versions", lambda: ["another version"])
    call()
    assert len(traced) == 4


class OfAUser(eqx.Module):
    factor: Any


def test_what_another_process_cannot_know_is_not_kept(traced: list[str], tmp_path: pathlib.Path) -> None:
    programs = in_a_new_process()
    assert programs.call(tmp_path, (OfAUser(jnp.ones(4)), 0.5), {}) is None
    assert programs.call(tmp_path, (jnp.ones(4), lambda x: x), {}) is None
    assert programs.call(tmp_path, (jnp.ones(4), test_what_another_process_cannot_know_is_not_kept), {}) is None
    assert programs.call(tmp_path, (jnp.ones(4), {1, 2}), {}) is None  # not hashable
    assert not list(tmp_path.iterdir())


def test_functions_of_one_name_are_told_apart(tmp_path: pathlib.Path) -> None:
    """As a function and its derivatives, which have its name."""
    square = lambda x: x * x  # noqa: E731
    both, third = jax.value_and_grad(square), jax.grad(lambda x, y: x * y, argnums=1)
    fourth, x = jax.grad(lambda x, y: x * y), jnp.asarray(3.0)
    for _ in range(2):
        assert float(called(in_a_new_process(square), tmp_path, x)) == 9.0
        value, slope = called(in_a_new_process(both), tmp_path, x)
        assert (float(value), float(slope)) == (9.0, 6.0)
        assert float(called(in_a_new_process(third), tmp_path, x, 2.0 * x)) == 3.0
        assert float(called(in_a_new_process(fourth), tmp_path, x, 2.0 * x)) == 6.0
    assert len(list(tmp_path.iterdir())) == 4


def test_no_program_is_kept_while_looking_for_nan(traced: list[str], tmp_path: pathlib.Path) -> None:
    with jax.debug_nans(True):
        assert in_a_new_process().call(tmp_path, (jnp.ones(4), 0.5), {}) is None
    with jax.disable_jit():
        assert in_a_new_process().call(tmp_path, (jnp.ones(4), 0.5), {}) is None
    assert not list(tmp_path.iterdir())


def test_a_program_that_cannot_be_written_leaves_nothing(
    traced: list[str], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_program_store.zlib, "compress", full)
    assert float(called(in_a_new_process(), tmp_path, jnp.ones(4), jnp.asarray(0.5))["total"]) == 4.5
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", [lambda b: b[:100], lambda b: b[:-50] + bytes(50), lambda _: b"", lambda _: b"text"])
def test_a_damaged_file_is_replaced(traced: list[str], tmp_path: pathlib.Path, damage: Any) -> None:
    args = jnp.ones(4), jnp.asarray(0.5)
    called(in_a_new_process(), tmp_path, *args)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    for _ in range(2):
        assert float(called(in_a_new_process(), tmp_path, *args)["total"]) == 4.5
        assert len(traced) == 2
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_is_gone_does_not_matter(traced: list[str], tmp_path: pathlib.Path) -> None:
    found = called(in_a_new_process(), tmp_path / "gone", jnp.ones(4), jnp.asarray(0.5))
    assert float(found["total"]) == 4.5


def test_an_error_of_the_function_is_the_callers(traced: list[str], tmp_path: pathlib.Path) -> None:
    with pytest.raises(TypeError, match="unsupported operand"):
        called(in_a_new_process(), tmp_path, jnp.ones(4), None)
    assert not list(tmp_path.iterdir())


FIX = """
import json, jax, jaxgeo
jaxgeo.enable_x64()
jaxgeo.keep_programs()
traced = []
on = lambda name, _, **about: traced.append(about.get("fun_name")) if name.endswith("jaxpr_trace_duration") else None
jax.monitoring.register_event_duration_secs_listener(on)
camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
ground = jaxgeo.ConstantHeight(600.0)
fix = jaxgeo.locate(sensor, shot, (1999.5, 1499.5), ground)


def factor(matrix):
    return jax.numpy.linalg.cholesky(matrix)  # of LAPACK


factor.__module__ = "jaxgeo"
lower = jaxgeo._compile.quick_filter_jit(factor)(jax.numpy.array([[4.0, 2.0], [2.0, 5.0]]))
numbers = [*fix.ecef, *lower.ravel()]
print(json.dumps([[float(x).hex() for x in numbers], [str(name) for name in traced]]))
"""
NAMES = ("_line_of_sight", "met_by", "factor")


def fix_of_a_process(folder: pathlib.Path) -> tuple[list[str], list[str]]:
    left = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_COMPILATION", "JAXGEO_C"))}
    environment = {**left, "PYTHONPATH": os.pathsep.join(sys.path), "JAXGEO_CACHE_DIR": str(folder)}
    done = subprocess.run([sys.executable, "-c", FIX], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    numbers, traced = json.loads(done.stdout)
    return numbers, [one for one in NAMES if any(name.startswith(one) for name in traced)]


@pytest.mark.oldest
@pytest.mark.costly
def test_a_second_process_traces_none_of_the_programs_and_finds_the_same_to_the_bit(tmp_path: pathlib.Path) -> None:
    first, traced = fix_of_a_process(tmp_path)
    assert set(traced) == set(NAMES)
    again, traced = fix_of_a_process(tmp_path)
    assert traced == []
    assert again == first


@pytest.mark.slow
def test_programs_that_the_cache_of_jax_still_has_are_compiled_anew(tmp_path: pathlib.Path) -> None:
    """As after an update of jaxgeo: programs read from that cache cannot be written again."""
    first, _ = fix_of_a_process(tmp_path)
    (folder,) = tmp_path.iterdir()
    for program in folder.glob("program-*"):
        program.unlink()
    assert [fix_of_a_process(tmp_path)[0] for _ in range(2)] == [first, first]


INPUTS = """
import json, jax, jaxgeo
from jaxgeo.demo import scene_file
from jaxgeo.io.scene import read_scene
from jaxgeo.uncertainty.metrics import error_ellipse
jaxgeo.enable_x64()
compiled = []
on = lambda name, _, **about: compiled.append(about.get("fun_name")) if name.endswith("jaxpr_trace_duration") else None
jax.monitoring.register_event_duration_secs_listener(on)
scene, ground = read_scene(scene_file()), jaxgeo.io.example_dem()
jaxgeo.Geodetic.from_degrees(lat=[47.0, 48.0], lon=[11.0, 12.0], height=[0.0, 1.0])
error_ellipse([[4.0, 1.0], [1.0, 9.0]], 0.9)
print(json.dumps([str(name) for name in compiled]))
"""


@pytest.mark.costly
def test_what_is_made_of_known_numbers_compiles_no_single_operations() -> None:
    """As 70 of them would take half a second of every command."""
    done = subprocess.run([sys.executable, "-c", INPUTS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    alone = {"true_divide", "deg2rad", "stage", "unstack", "log1p", "remainder", "add"}
    compiled = json.loads(done.stdout)
    assert "_ellipse" in compiled
    assert not alone & set(compiled)

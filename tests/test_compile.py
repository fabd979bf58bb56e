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
from jax.core import Tracer
from support.scenes import local_ray, small_dem

import jaxgeo
from jaxgeo import _compile
from jaxgeo import uncertainty as un
from jaxgeo._compile import batch_options, long_run_options, one_program, quick_filter_jit, quick_jit, quick_options
from jaxgeo._program_cache import forget_oldest
from jaxgeo.rotations import rotation_vector_from_R
from jaxgeo.terrain import Bisection
from jaxgeo.uncertainty import sources

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


COMPILED: list[str] = []  # of all of this process


def _note(name: str, _: float, **__: Any) -> None:
    if name.endswith("backend_compile_duration"):
        COMPILED.append(name)


jax.monitoring.register_event_duration_secs_listener(_note)


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


@pytest.mark.parametrize("jit", [quick_jit, quick_filter_jit, one_program])
def test_a_call_by_numbers_alone_within_a_program_is_part_of_it(jit: Any) -> None:
    """Also of numbers that are known there, which call for no program of their own."""
    double = jit(lambda x: 2.0 * x)
    assert jax.jit(lambda x: x + double(jnp.asarray(3.0)))(1.0) == 7.0


def test_one_program_serves_a_direct_call_and_a_derivative_is_of_each_operation() -> None:
    traced = []

    @one_program
    def cube(x: Any) -> Any:
        traced.append(isinstance(x, Tracer))
        return x * x * x

    x = jnp.asarray(2.0)
    assert [float(cube(x)) for _ in range(3)] == [8.0] * 3
    assert traced == [True], "traced once for three calls"
    assert float(jax.grad(cube)(x)) == 12.0
    assert float(jax.jit(cube)(x)) == 8.0


def _heights(kind: str) -> tuple[Any, Any]:
    place = jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.002, height=0.0)
    if kind == "constant":
        return jaxgeo.ConstantHeight(jnp.asarray(512.5)), place
    grid = jaxgeo.terrain.TangentGrid.centred(place, spacing=(30.0, 30.0), shape=(11, 13))
    return jaxgeo.Dem.from_array(np.random.default_rng(2).uniform(400.0, 500.0, (11, 13)), grid), place


DIRECT = {
    "height of a DEM": lambda: (lambda dem, place: dem.height_at(place), *_heights("dem")),
    "normal of a DEM": lambda: (lambda dem, place: dem.normal_at(place), *_heights("dem")),
    "slope of a DEM": lambda: (lambda dem, place: dem.slope_at(place), *_heights("dem")),
    "a constant height": lambda: (lambda ground, place: ground.height_at(place), *_heights("constant")),
    "positions, mapped": lambda: (jax.vmap(jaxgeo.WGS84.to_geodetic), 4e6 + 1e5 * np.arange(57.0).reshape(19, 3)),
    "rotations, mapped": lambda: (jax.vmap(rotation_vector_from_R), np.broadcast_to(np.eye(3), (23, 3, 3))),
}


@pytest.mark.parametrize("name", DIRECT)
def test_small_functions_are_at_most_one_program_each_where_they_are_called_directly(name: str) -> None:
    """Where each operation is a program, these are dozens: seconds of a first answer."""
    function, *args = DIRECT[name]()
    before = len(COMPILED)
    found = function(*args)
    assert len(COMPILED) - before <= 1, "an operation is a program of its own"
    whole = jax.jit(function)(*args)
    assert len(COMPILED) > before, "compiled programs are not seen"
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(whole), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


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


@pytest.mark.slow
def test_a_second_process_reads_the_programs_of_the_first(tmp_path: pathlib.Path) -> None:
    folder, value, read, used = _in_a_process(JAXGEO_CACHE_DIR=str(tmp_path))
    assert pathlib.Path(folder).parent == tmp_path
    assert used == folder
    assert read == 0
    assert any(pathlib.Path(folder).iterdir())
    again = _in_a_process(JAXGEO_CACHE_DIR=str(tmp_path))
    assert again[:2] == [folder, value]
    assert again[2] > 0, "programs were compiled again"


@pytest.mark.costly
def test_no_programs_are_kept_if_the_variable_is_empty(tmp_path: pathlib.Path) -> None:
    assert _in_a_process(JAXGEO_CACHE_DIR="", HOME=str(tmp_path), XDG_CACHE_HOME=str(tmp_path))[0] == "None"
    assert not any(tmp_path.rglob("*jaxlib*"))


@pytest.mark.costly
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


def _scene() -> tuple[Any, ...]:
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=700.0, width=800, height=600)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    return sensor, jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))


PIXELS = np.random.default_rng(3).uniform([0.0, 0.0], [799.0, 599.0], (2500, 2))
GROUND = jaxgeo.ConstantHeight(600.0)
BY_PIXEL = (None, None, 0, None)


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Programs compiled ahead of their call, as those of a `vmap` called directly are."""
    programs: list[Any] = []
    compile_ = jax.stages.Lowered.compile

    def spy(self: Any, *args: Any, **options: Any) -> Any:
        programs.append(self)
        return compile_(self, *args, **options)

    monkeypatch.setattr(jax.stages.Lowered, "compile", spy)
    return programs


@pytest.fixture(scope="module")
def whole() -> Any:
    """All pixels by one program."""
    return jax.jit(jax.vmap(jaxgeo.locate, in_axes=BY_PIXEL))(*_scene(), PIXELS, GROUND)


@pytest.mark.costly
@pytest.mark.parametrize("count", [1, 7, 1024, 2500])
def test_a_vmap_called_directly_is_one_program_for_all_counts(count: int, compiled: list[Any], whole: Any) -> None:
    ground = jaxgeo.ConstantHeight(jnp.asarray(600.0))
    of_pixels = lambda count: jax.vmap(jaxgeo.locate, in_axes=BY_PIXEL)(*_scene(), PIXELS[:count], ground)  # noqa: E731
    of_pixels(5)
    before = len(compiled)
    found = of_pixels(count)
    assert len(compiled) == before, "compiled again"
    alone = jax.tree.map(lambda leaf: leaf[:count], whole)
    assert found.slant_range.shape == (count,)
    assert found.status.dtype == alone.status.dtype
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-7)


def test_another_mapped_argument_is_another_program(compiled: list[Any]) -> None:
    """Of a function that no other test has compiled; without it, the test above might see no program at all."""
    total = quick_jit(lambda one, other: one + jnp.cos(other))
    numbers = np.arange(3.0)
    for in_axes in [(0, None), (None, 0), (0, 0)]:
        before, given = len(compiled), [numbers if axis == 0 else numbers[1] for axis in in_axes]
        np.testing.assert_allclose(jax.vmap(total, in_axes=in_axes)(*given), given[0] + np.cos(given[1]), rtol=1e-14)
        assert len(compiled) > before


def test_a_vmap_of_a_vmap_and_derivatives_within_one_are_of_the_usual_program() -> None:
    """Of a small function, for what decides is which transformations there are."""
    slant = quick_jit(lambda uv: jnp.sqrt(1.0 + jnp.sum(uv**2)))
    grid = np.arange(12.0).reshape(2, 3, 2)
    expected = np.sqrt(1.0 + np.sum(grid**2, axis=-1))
    np.testing.assert_allclose(jax.vmap(slant)(grid[0]), expected[0], rtol=1e-14)
    np.testing.assert_allclose(jax.vmap(jax.vmap(slant))(grid), expected, rtol=1e-14)
    slopes = jax.vmap(jax.grad(slant))(grid[0])
    np.testing.assert_allclose(slopes, grid[0] / expected[0][:, None], rtol=1e-14)
    total = jax.grad(lambda uv: jnp.sum(jax.vmap(slant)(uv)))(jnp.asarray(grid[0]))
    np.testing.assert_allclose(total, slopes, rtol=1e-14)


@pytest.mark.slow
def test_a_vmap_of_a_vmap_and_derivatives_of_locate_within_one_are_of_the_usual_program() -> None:
    grid = PIXELS[:6].reshape(2, 3, 2)
    flat = jax.vmap(jaxgeo.locate, in_axes=BY_PIXEL)(*_scene(), PIXELS[:6], GROUND)
    twice = jax.vmap(jax.vmap(jaxgeo.locate, in_axes=BY_PIXEL), in_axes=BY_PIXEL)(*_scene(), grid, GROUND)
    np.testing.assert_allclose(twice.ecef.reshape(6, 3), flat.ecef, atol=1e-7)
    slant = lambda uv: jaxgeo.locate(*_scene(), uv, GROUND).slant_range  # noqa: E731
    slopes = jax.vmap(jax.grad(slant))(PIXELS[:2])
    np.testing.assert_allclose(slopes[1], jax.grad(slant)(jnp.asarray(PIXELS[1])), rtol=1e-9)
    total = jax.grad(lambda uv: jnp.sum(jax.vmap(slant)(uv)))(jnp.asarray(PIXELS[:2]))
    np.testing.assert_allclose(total, slopes, rtol=1e-9)


@pytest.mark.costly
def test_rows_of_any_argument_are_mapped_and_a_missing_fix_is_told() -> None:
    sensor, shot = _scene()
    heights = jnp.linspace(500.0, 900.0, 5)
    found = jax.vmap(lambda height: jaxgeo.locate(sensor, shot, (400.0, 300.0), jaxgeo.ConstantHeight(height)))(heights)
    alone = [jaxgeo.locate(sensor, shot, (400.0, 300.0), jaxgeo.ConstantHeight(float(height))) for height in heights]
    np.testing.assert_array_equal(found.status, [one.status for one in alone])
    np.testing.assert_allclose(found.slant_range, [one.slant_range for one in alone], rtol=1e-9)
    across = jax.vmap(jaxgeo.locate, in_axes=(None, None, 1, None))(sensor, shot, PIXELS[:4].T, GROUND)
    along = jax.vmap(jaxgeo.locate, in_axes=BY_PIXEL)(sensor, shot, PIXELS[:4], GROUND)
    np.testing.assert_array_equal(across.ecef, along.ecef)


@pytest.mark.costly
def test_one_search_is_compiled_for_all_cameras_shots_and_questions() -> None:
    """Of a kind of terrain: for single pixels, and under a `vmap` for rows of them."""
    traced = []

    class Counted(Bisection):
        def bracket(self, ray: Any, dem: Any) -> Any:
            traced.append(ray)
            return super().bracket(ray, dem)

    search, dem = Counted(), small_dem(np.full((5, 5), 600.0))
    three_axes, shot = _scene()
    fixed = jaxgeo.Sensor(three_axes.camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    level = jaxgeo.Shot(shot.pose)
    middle, rows = np.array([399.5, 299.5]), PIXELS[:3]
    errors = un.ErrorModel((sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1),))
    fix = jaxgeo.locate(three_axes, shot, middle, dem, search=search)
    jaxgeo.locate(fixed, level, middle, dem, search=search)
    look = un.propagate(three_axes, shot, middle, dem, errors, search=search)
    np.testing.assert_array_equal(look.fix.ecef, fix.ecef)
    assert len(traced) == 1
    for sensor, seen_from in ((three_axes, shot), (fixed, level)):
        jax.vmap(lambda uv, *of: jaxgeo.locate(*of, uv, dem, search=search), (0, None, None))(rows, sensor, seen_from)
    assert len(traced) == 2


def test_options_are_those_of_the_device_that_programs_run_on(monkeypatch: pytest.MonkeyPatch) -> None:
    on_cpu = [options() for options in (quick_options, batch_options, long_run_options)]
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")
    assert [options() for options in (quick_options, batch_options, long_run_options)] == [{}, {}, {}]
    with jax.default_device(jax.devices("cpu")[0]):
        assert [options() for options in (quick_options, batch_options, long_run_options)] == on_cpu


@pytest.mark.parametrize(
    "cores, threads, flags, parts",
    [
        (1, None, "", 1),
        (2, None, "", None),
        (8, "1", "", 1),
        (1, None, "--xla_cpu_parallel_codegen_split_count=4", None),
    ],
)
def test_where_one_thread_compiles_programs_are_not_split(
    monkeypatch: pytest.MonkeyPatch, cores: int, threads: str | None, flags: str, parts: int | None
) -> None:
    monkeypatch.setattr(_compile, "core_count", lambda: cores)
    monkeypatch.setenv("XLA_FLAGS", flags)
    monkeypatch.delenv("NPROC", raising=False)
    if threads is not None:
        monkeypatch.setenv("NPROC", threads)
    for options in (_compile._quick_options, _compile._batch_options, _compile._long_run_options):
        found = options.__wrapped__("cpu")
        assert found.get("xla_cpu_parallel_codegen_split_count") == parts
        assert "xla_disable_hlo_passes" in found
        assert options.__wrapped__("tpu") == {}


@pytest.mark.parametrize("runs", ["short", "long"])
def test_options_for_a_jit_of_ones_own_change_no_more_than_rounding(runs: str) -> None:
    ray, ground = local_ray(0.0, 0.0, 2000.0, azimuth=30.0, elevation=-40.0), jaxgeo.ConstantHeight(100.0)
    usual, chosen = (jax.jit(jaxgeo.intersect, compiler_options=how) for how in (None, jaxgeo.compiler_options(runs)))
    found, expected = chosen(ray, ground), usual(ray, ground)
    assert int(found.status) == int(expected.status) == jaxgeo.Status.hit
    np.testing.assert_allclose(found.ecef, expected.ecef, rtol=0.0, atol=1e-6)


def test_options_for_a_jit_of_ones_own_are_short_or_long() -> None:
    assert jaxgeo.compiler_options() == quick_options()
    assert jaxgeo.compiler_options("long") == long_run_options()
    jaxgeo.compiler_options()["xla_backend_optimization_level"] = 3  # a copy: of the caller's own
    assert jaxgeo.compiler_options() == quick_options() != {"xla_backend_optimization_level": 3}
    with pytest.raises(ValueError, match="runs must be one of short, long; got 'quick'"):
        jaxgeo.compiler_options("quick")

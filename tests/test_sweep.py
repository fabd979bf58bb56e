"""Parameter studies: the same numbers by every executor, after every interruption, and in the file."""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Axis, sweep

xarray: Any = pytest.importorskip("xarray")
pytest.importorskip("zarr")

HEIGHTS, ANGLES = np.array([1000.0, 2000.0, 3000.0]), np.linspace(0.0, 60.0, 7)
GROUNDS = Axis([jaxgeo.ConstantHeight(0.0), jaxgeo.ConstantHeight(100.0)], labels=["sea", "plain"])
AXES = {"height": Axis(HEIGHTS, "m"), "ground": GROUNDS, "off_nadir": Axis(ANGLES, "deg")}
UNITS = {"range": "m", "offset": "m"}


def looked(height: Any, off_nadir: Any, ground: Any) -> dict[str, Any]:
    """Range, and offset right and down, of a ray over level ground."""
    down, angle = height - ground.height, jnp.deg2rad(off_nadir)
    return {"range": down / jnp.cos(angle), "offset": jnp.stack([down * jnp.tan(angle), down])}


def expected() -> tuple[np.ndarray, np.ndarray]:
    down = HEIGHTS[:, None, None] - np.array([0.0, 100.0])[None, :, None] + 0.0 * ANGLES
    angle = np.deg2rad(ANGLES)
    return down / np.cos(angle), np.stack([down * np.tan(angle), down], axis=-1)


@pytest.mark.parametrize("block", [1, 3, 7, 8, 14, 1000])
def test_every_combination_with_names_and_units(block: int) -> None:
    found = sweep(looked, AXES, units=UNITS, dims={"offset": ["axis"]}, block=block)
    slant, offset = expected()
    assert found["range"].dims == ("height", "ground", "off_nadir")
    assert found["offset"].dims == ("height", "ground", "off_nadir", "axis")
    np.testing.assert_allclose(found["range"], slant, rtol=1e-13)
    np.testing.assert_allclose(found["offset"], offset, rtol=1e-13)
    assert list(found["ground"].to_numpy()) == ["sea", "plain"]
    assert (found["range"].attrs["units"], found["height"].attrs["units"]) == ("m", "m")
    assert found["range"].sel(height=2000.0, ground="plain", off_nadir=60.0).item() == pytest.approx(3800.0)


def test_one_program_for_all_blocks_of_a_combination() -> None:
    traced = []

    def function(height: Any, ground: Any) -> Any:
        traced.append(ground)
        return height - (0.0 if ground == "sea" else 1.0)

    axes = {"height": np.arange(10.0), "ground": ["sea", "land"]}
    found = sweep(function, axes, block=4)
    assert traced == ["sea", "land"] or sorted(map(str, traced)) == ["land", "sea"]
    np.testing.assert_array_equal(found["function"], np.arange(10.0)[:, None] - np.array([0.0, 1.0]))


def test_a_function_that_cannot_be_traced_gets_the_numbers_of_python() -> None:
    def word(a: Any, b: Any) -> dict[str, Any]:
        assert type(a) is int
        assert type(b) is float
        return {"sum": a + b, "even": a % 2 == 0}

    found = sweep(word, {"a": [1, 2, 3], "b": [0.5, 1.5]}, vectorize=False)
    np.testing.assert_array_equal(found["sum"], np.array([1, 2, 3])[:, None] + np.array([0.5, 1.5]))
    np.testing.assert_array_equal(found["even"].to_numpy()[:, 0], [False, True, False])


def threads() -> Any:
    return concurrent.futures.ThreadPoolExecutor(2)


def processes() -> Any:
    return concurrent.futures.ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


class _Dask:
    """Two workers that were started without a word about 64-bit floats."""

    def __enter__(self) -> Any:
        distributed: Any = pytest.importorskip("distributed")
        self._cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        self._client = distributed.Client(self._cluster)
        return self._client

    def __exit__(self, *_: object) -> None:
        self._client.close()
        self._cluster.close()


@pytest.mark.parametrize(
    "executor", [threads, pytest.param(processes, marks=pytest.mark.slow), pytest.param(_Dask, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("vectorize", [True, False])
def test_the_executor_changes_no_bit(
    executor: Any, vectorize: bool, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    alone = sweep(looked, AXES, units=UNITS, block=3, vectorize=vectorize)
    with executor() as workers:
        found = sweep(
            looked, AXES, units=UNITS, block=3, vectorize=vectorize, executor=workers, folder=tmp_path / "study"
        )
    assert found.identical(alone)
    assert found["range"].dtype == np.float64
    assert sweep(looked, AXES, units=UNITS, block=3, vectorize=vectorize, folder=tmp_path / "study").identical(alone)


def test_the_file_opens_in_xarray(tmp_path: pathlib.Path) -> None:
    found = sweep(looked, AXES, units=UNITS, block=3, folder=tmp_path / "study")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with xarray.open_zarr(tmp_path / "study") as kept:
            assert kept["finished"].all()
            assert kept.drop_vars("finished").drop_attrs(deep=False).load().identical(found)
    assert os.listdir(tmp_path) == ["study"]


def recorded(number: Any, folder: Any) -> float:
    """Of a cell, which leaves a mark; stops where a file `stop` says so."""
    stop = pathlib.Path(folder) / "stop"
    if stop.exists() and stop.read_text() == str(number):
        raise OSError("disk on fire")
    with (pathlib.Path(folder) / "calls").open("a") as file:
        file.write(f"{number}\n")
    return float(np.sin(number))


def test_a_stopped_study_goes_on_where_it_stopped(tmp_path: pathlib.Path) -> None:
    axes = {"number": list(range(20)), "folder": [str(tmp_path)]}
    (tmp_path / "stop").write_text("13")
    with pytest.raises(RuntimeError, match=r"raised OSError in the cell number=13, folder=.*disk on fire"):
        sweep(recorded, axes, vectorize=False, block=4, folder=tmp_path / "study")
    with xarray.open_zarr(tmp_path / "study") as kept:
        assert kept["finished"].to_numpy()[:, 0].tolist() == [True] * 12 + [False] * 8
        assert np.isnan(kept["recorded"].to_numpy()[12:]).all()
    (tmp_path / "stop").unlink()
    (tmp_path / "calls").unlink()
    found = sweep(recorded, axes, vectorize=False, block=4, folder=tmp_path / "study", executor=None)
    assert (tmp_path / "calls").read_text().split() == [str(k) for k in range(12, 20)]
    np.testing.assert_array_equal(found["recorded"][:, 0], [float(np.sin(k)) for k in range(20)])


STUDY = """
import sys, time
import jaxgeo
from tests.test_sweep import drawn

if __name__ == "__main__":
    jaxgeo.enable_x64()
    from tests.test_sweep import DRAWN, processes
    with processes() as workers:
        jaxgeo.sweep(drawn, DRAWN, block=5, folder=sys.argv[1], executor=workers)
"""
DRAWN = {"seed": list(range(50)), "sigma": [0.5, 1.0, 2.0, 4.0]}


def drawn(seed: Any, sigma: Any) -> dict[str, Any]:
    errors = sigma * jax.random.normal(jax.random.key(seed), (1000, 2))
    jax.debug.callback(lambda: time.sleep(0.02))
    return {"ce90": jnp.quantile(jnp.linalg.norm(errors, axis=1), 0.9), "mean": jnp.mean(errors, axis=0)}


@pytest.mark.slow
def test_a_killed_study_of_200_cells_is_completed_to_the_bit(tmp_path: pathlib.Path) -> None:
    """Killed on two workers, completed on one thread, on three, and never interrupted."""
    script, study = tmp_path / "study.py", tmp_path / "study"
    script.write_text(STUDY)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    running = subprocess.Popen([sys.executable, str(script), str(study)], env=environment, start_new_session=True)
    finished = 0
    deadline = time.monotonic() + 120.0
    while finished < 40 and time.monotonic() < deadline:
        time.sleep(0.2)
        if study.exists():
            with xarray.open_zarr(study) as kept:
                finished = int(kept["finished"].sum())
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    with xarray.open_zarr(study) as kept:
        finished = int(kept["finished"].sum())
    assert 40 <= finished < 200
    alone = sweep(drawn, DRAWN, block=5)
    with concurrent.futures.ThreadPoolExecutor(3) as workers:
        assert sweep(drawn, DRAWN, block=5, folder=study, executor=workers).identical(alone)
    with xarray.open_zarr(study) as kept:
        assert kept["finished"].all()
        assert kept.drop_vars("finished").drop_attrs(deep=False).load().identical(alone)
    assert alone["ce90"].sel(sigma=1.0).mean().item() == pytest.approx(np.sqrt(-2.0 * np.log(0.1)), rel=0.01)


def other(height: Any, off_nadir: Any, ground: Any) -> Any:
    return {"range": height + off_nadir + ground.height}


@pytest.mark.costly
@pytest.mark.parametrize(
    "change, words",
    [
        ({"axes": AXES | {"height": Axis([1000.0, 2000.0, 3000.5], "m")}}, "axis height"),
        ({"axes": AXES | {"ground": GROUNDS._replace(values=[jaxgeo.ConstantHeight(0.0)] * 2)}}, "axis ground"),
        ({"version": "2"}, "version"),
        ({"block": 4}, "block"),
        ({"axes": dict(reversed(AXES.items()))}, "order of the axes"),
        ({"function": other}, "function"),
    ],
)
def test_another_study_does_not_go_to_the_same_folder(change: Any, words: str, tmp_path: pathlib.Path) -> None:
    given: dict[str, Any] = {"function": looked, "axes": AXES, "block": 2, "folder": tmp_path / "study"}
    sweep(**given)
    with pytest.raises(ValueError, match=f"holds another sweep, with other values of: {words}"):
        sweep(**given | change)


FACTOR = 2.0


def helped(x: Any) -> Any:
    return FACTOR * x


def by_global(x: Any) -> dict[str, Any]:
    return {"y": helped(x)}


def by_closure(factor: Any) -> Any:
    def of_x(x: Any, more: float = 1.0) -> dict[str, Any]:
        return {"y": factor * x + more}

    return of_x


def by_wrapper(factor: Any) -> Any:
    def scaled(function: Any) -> Any:
        @functools.wraps(function)
        def call(**cell: Any) -> Any:
            return {"y": factor * function(**cell)["y"]}

        return call

    return scaled(by_closure(1.0))


class Scaled:
    def __init__(self, factor: float) -> None:
        self.factor, self.names = factor, [lambda: factor]

    def __call__(self, x: Any) -> dict[str, Any]:
        return {"y": self.factor * x}

    def of(self, x: Any) -> dict[str, Any]:
        return self(x)


def of_two_lambdas(factor: float) -> Any:
    return {2.0: lambda x: {"y": 2 * x}, 3.0: lambda x: {"y": 3 * x}}[factor]


def by_inner(factor: float) -> Any:
    def of_x(x: Any) -> dict[str, Any]:
        return {"y": (lambda x: factor * x)(x)}

    return of_x


def by_partial(factor: Any) -> Any:
    return functools.partial(lambda x, factor: {"y": factor * x}, factor=factor)


def by_default(factor: float) -> Any:
    function = by_closure(1.0)
    function.__defaults__ = (factor,)
    return function


@pytest.mark.parametrize(
    "make",
    [
        *(by_closure, by_partial, by_default, by_wrapper, Scaled, of_two_lambdas, by_inner),
        lambda x: jax.jit(by_closure(np.full(3, x))),
        lambda x: Scaled(x).of,
    ],
)
def test_values_that_a_function_uses_are_part_of_the_study(make: Any, tmp_path: pathlib.Path) -> None:
    axes = {"x": [1.0, 2.0]}
    found = sweep(make(2.0), axes, folder=tmp_path / "study")
    assert sweep(make(2.0), axes, folder=tmp_path / "study").identical(found)
    with pytest.raises(ValueError, match="holds another sweep, with other values of: function"):
        sweep(make(3.0), axes, folder=tmp_path / "study")


def test_globals_are_part_of_the_study_and_of_the_functions_beside_it(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep(by_global, {"x": [1.0, 2.0]}, folder=tmp_path / "study")
    sweep(by_global, {"x": [1.0, 2.0]}, folder=tmp_path / "study")
    monkeypatch.setattr(sys.modules[__name__], "FACTOR", 3.0)
    assert sweep(by_global, {"x": [1.0, 2.0]})["y"].to_numpy().tolist() == [3.0, 6.0]
    with pytest.raises(ValueError, match="holds another sweep, with other values of: function"):
        sweep(by_global, {"x": [1.0, 2.0]}, folder=tmp_path / "study")


def test_a_study_run_as_a_script_goes_on_when_imported(tmp_path: pathlib.Path) -> None:
    text = "FACTOR = 2.0\nclass C:\n    k = 1\nC0 = C()\ndef f(x):\n    return {'y': FACTOR * x + C0.k}\n"
    found = []
    for module in ("__main__", "study"):
        scope: dict[str, Any] = {"__name__": module}
        exec(text, scope)
        found.append(sweep(scope["f"], {"x": [1.0, 2.0]}, folder=tmp_path / "study"))
    assert found[0].identical(found[1])
    with pytest.raises(TypeError, match=r"a _thread\.lock cannot be compared with that of another run"):
        sweep(lambda x, lock: {"y": x}, {"x": [1.0], "lock": [threading.Lock()]}, folder=tmp_path / "other")


def test_an_empty_folder_is_used_and_times_are_numbers(tmp_path: pathlib.Path) -> None:
    axes, units = {"x": Axis([1.0, 2.0, 3.0], "days since 2000-01-01")}, {"y": "days since 2000-01-01"}
    found = [sweep(by_closure(2.0), axes, units=units, block=2, folder=tmp_path) for _ in range(2)]
    assert found[1].identical(found[0])
    assert found[1]["y"].to_numpy().tolist() == [3.0, 5.0, 7.0]


def test_a_folder_of_something_else_is_left_alone(tmp_path: pathlib.Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"photo")
    with pytest.raises(ValueError, match="holds something that is not a sweep"):
        sweep(looked, AXES, folder=tmp_path)
    assert os.listdir(tmp_path) == ["photo.jpg"]


@pytest.mark.parametrize(
    "function, axes, options, words",
    [
        (looked, {}, {}, "axes is empty"),
        (looked, AXES | {"height": []}, {}, "axis height: give a sequence of one or more values"),
        (looked, AXES | {"height": 5.0}, {}, "axis height: give a sequence of one or more values"),
        (looked, AXES | {"height": "high"}, {}, "axis height: give a sequence"),
        (looked, {"height": [1.0]}, {}, r"axes must be the arguments of the function, \(height.*missing"),
        (looked, AXES | {"width": [1.0]}, {}, "got an unexpected keyword argument 'width'"),
        (
            looked,
            AXES | {"ground": [jaxgeo.ConstantHeight(0.0)] * 2},
            {},
            r"axis ground: 2 values.*Axis\(values, labels",
        ),
        (looked, AXES | {"ground": GROUNDS._replace(labels=["sea"])}, {}, "as many different labels"),
        (looked, AXES, {"block": 0}, "block must be an integer of at least 1"),
        (looked, AXES, {"dims": {"offset": ["axis", "other"]}}, "dims names 2 dimensions of offset"),
        (lambda a: {"a": a}, {"a": [1.0]}, {}, "result a has the name of an axis"),
        (lambda a: {"b": "text"}, {"a": [1.0]}, {"vectorize": False}, "must be numbers or flags; b is"),
        (lambda a: {"b": np.ones(a)}, {"a": [1, 2]}, {"vectorize": False}, "same names and shapes in all cells"),
        (lambda a: {"b": np.ones(a)}, {"a": [1, 2]}, {"vectorize": False, "block": 1}, "same names and shapes"),
        (
            lambda a: {"b": np.int64(a) if a == 1 else np.float64(0.5)},
            {"a": [1, 2]},
            {"vectorize": False, "block": 1},
            "of one type",
        ),
        (lambda a: {"b/c": a}, {"a": [1.0]}, {}, "or a slash"),
        (lambda b_0: {"b": b_0 * jnp.ones(2)}, {"b_0": [1.0, 2.0]}, {}, "the dimension b_0 of b, of 2, has the name"),
        (
            lambda a: {"b": jnp.ones(2), "c": jnp.ones(3)},
            {"a": [1.0]},
            {"dims": {"b": ["k"], "c": ["k"]}},
            "dimension of another size",
        ),
        (looked, AXES | {"height": {1.0, 2.0}}, {}, "axis height: give a sequence"),
        (lambda a: a, {"a": [2**70, 1]}, {}, "beyond 64 bits"),
    ],
)
def test_mistakes_are_told(function: Any, axes: Any, options: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        sweep(function, axes, **options)


def test_an_error_of_the_function_says_in_which_block() -> None:
    with pytest.raises(RuntimeError, match=r"raised TypeError in a block of 2 cells with ground='sea'"):
        sweep(lambda height, ground: height + ground, {"height": [1.0, 2.0], "ground": ["sea"]})


@pytest.mark.parametrize("module, folder", [("zarr", "study"), ("xarray", None)])
def test_a_missing_library_is_told(
    module: str, folder: str | None, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgeo\[xarray\]'"):
        sweep(looked, AXES, folder=None if folder is None else tmp_path / folder)

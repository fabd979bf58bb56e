"""Records travel between processes with all their digits, or are refused in words; never in 32-bit floats."""

from __future__ import annotations

import concurrent.futures
import copy
import importlib
import inspect
import io
import json
import multiprocessing
import os
import pathlib
import pickle
import pkgutil
import subprocess
import sys
import textwrap
import traceback
from typing import Any

import cloudpickle
import equinox as eqx
import jax
import jax.numpy as jnp
import joblib
import pytest
from joblib.externals.loky import ProcessPoolExecutor as LokyExecutor

import jaxgeo
from jaxgeo._record import Record
from tests.support import looks
from tests.support.records import compute_in_32_bits, digits, leaves_of, send_digits, with_awkward_numbers

TURN_ON = ("jaxgeo.enable_x64()", "JAX_ENABLE_X64=1")


def every_record() -> list[type[Record]]:
    """All concrete record classes of the package, public or not."""
    found: dict[str, type[Record]] = {}
    for module in pkgutil.walk_packages(jaxgeo.__path__, "jaxgeo."):
        if module.name.endswith("__main__"):
            continue
        for value in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(value) and issubclass(value, eqx.Module) and value.__module__.startswith("jaxgeo."):
                assert issubclass(value, Record), f"{value} is a module of equinox, which loses its digits in a pickle"
                if not inspect.isabstract(value):
                    found[f"{value.__module__}.{value.__qualname__}"] = value
    return [found[name] for name in sorted(found)]


class WithoutJax(pickle.Pickler):
    """Refuses arrays of JAX, which another process may round."""

    def reducer_override(self, obj: Any) -> Any:
        assert not isinstance(obj, jax.Array), "an array of JAX is in the pickle"
        return NotImplemented


def test_bound_methods_are_those_of_equinox() -> None:
    dem = looks.dem()
    found, expected = dem.height_at, eqx.Module.__getattribute__(dem, "height_at")
    assert vars(found).keys() == vars(expected).keys()
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    assert found.__name__ == "height_at"
    place = jaxgeo.locate(looks.sensor(), looks.shot(), looks.UV, dem).position
    height = float(expected(place))
    assert 0.0 < height < 9000.0
    assert eqx.filter_jit(found)(place) == height
    assert eqx.filter_jit(lambda method: method(place))(found) == height


def without_jax(record: Any) -> bytes:
    stream = io.BytesIO()
    WithoutJax(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(record)
    return stream.getvalue()


def in_32_bits() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}


LOADER = """
    import json, pathlib, pickle, sys
    sys.path.insert(0, {project!r})
    import jaxgeo
    from tests.support.records import leaves_of
    pickles = pickle.loads(pathlib.Path({file!r}).read_bytes())
    refused = {{}}
    for name, data in pickles.items():
        try:
            pickle.loads(data)
            refused[name] = ""
        except RuntimeError as error:
            refused[name] = str(error)
    jaxgeo.enable_x64()
    loaded = {{name: leaves_of(pickle.loads(data)) for name, data in pickles.items()}}
    print(json.dumps([refused, loaded]))
"""


@pytest.mark.costly
def test_every_record_is_refused_in_32_bits_and_whole_in_64(tmp_path: pathlib.Path, project_root: pathlib.Path) -> None:
    records = {f"{cls.__module__}.{cls.__qualname__}": with_awkward_numbers(cls) for cls in every_record()}
    assert len(records) > 180
    file = tmp_path / "records"
    file.write_bytes(pickle.dumps({name: without_jax(record) for name, record in records.items()}))
    code = textwrap.dedent(LOADER.format(project=str(project_root), file=str(file)))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=in_32_bits())
    assert done.returncode == 0, done.stderr
    refused, loaded = json.loads(done.stdout)
    for name, record in records.items():
        assert all(word in refused[name] for word in TURN_ON), (name, refused[name])
        assert [tuple(leaf) for leaf in loaded[name]] == leaves_of(record), name


def results() -> dict[str, Any]:
    """What public functions give, and what they take."""
    at = (looks.sensor(), looks.shot(), looks.UV, looks.LEVEL)
    return {
        "fix": jaxgeo.locate(*at),
        "projection": jaxgeo.project(looks.sensor(), looks.shot(), jaxgeo.locate(*at).position),
        "dem": looks.dem(),
        "trajectory": looks.trajectory(),
        "errors": looks.all_sources(),
        "propagation": jaxgeo.propagate(*at, looks.few_sources()),
        "method of a camera": looks.sensor().camera.ray,
    }


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return results()


@pytest.mark.slow
@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_give_the_same_bits(made: dict[str, Any], protocol: int) -> None:
    for name, record in made.items():
        again = pickle.loads(pickle.dumps(record, protocol))
        assert leaves_of(again) == leaves_of(record), name
        assert jax.tree.structure(again) == jax.tree.structure(record), name


@pytest.mark.costly
@pytest.mark.parametrize(
    "way",
    [copy.copy, copy.deepcopy, without_jax, lambda record: pickle.loads(cloudpickle.dumps(record))],
    ids=["copy", "deepcopy", "no array of JAX", "cloudpickle"],
)
def test_other_ways_give_the_same_bits(made: dict[str, Any], way: Any) -> None:
    for name, record in made.items():
        again = way(record)
        again = pickle.loads(again) if isinstance(again, bytes) else again
        assert leaves_of(again) == leaves_of(record), name


@pytest.mark.slow
def test_no_array_of_jax_is_in_the_pickle_of_a_result() -> None:
    at = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())
    key = jax.random.key(3)
    found = [
        jaxgeo.accuracy(*at),
        jaxgeo.sample(*at, key=key, count=2000),
        jaxgeo.compare(*at, sampling=jaxgeo.Sampling(count=2000, key=key)),
        jaxgeo.uncertainty.budget(jaxgeo.propagate(*at)),
        jaxgeo.uncertainty.sigma_points(*at),
    ]
    for record in found:
        assert leaves_of(pickle.loads(without_jax(record))) == leaves_of(record), type(record)


def test_copies_may_be_made_while_tracing() -> None:
    moved = jax.jit(lambda place: copy.deepcopy(copy.copy(place)).lat + 1.0)(looks.pose().position)
    assert float(moved) == float(looks.pose().position.lat) + 1.0


def in_worker(make: Any, place: jaxgeo.Geodetic) -> list[str]:
    with make() as pool:
        return pool.submit(digits, place).result(timeout=120)


def spawned(**how: Any) -> concurrent.futures.Executor:
    context = multiprocessing.get_context("spawn")
    return concurrent.futures.ProcessPoolExecutor(1, mp_context=context, **how)


def loky(**how: Any) -> concurrent.futures.Executor:
    return LokyExecutor(1, **how)


@pytest.mark.costly
@pytest.mark.parametrize(
    "pool, way",
    [
        (spawned, "environment"),
        pytest.param(loky, "initializer", marks=pytest.mark.slow),  # as joblib does below
        pytest.param(spawned, "initializer", marks=pytest.mark.slow),
        pytest.param(loky, "environment", marks=pytest.mark.slow),
    ],
)
def test_worker_processes_get_all_digits(pool: Any, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    if way == "environment":
        jaxgeo.enable_x64()
        assert os.environ["JAX_ENABLE_X64"] == "1"
    how = {"initializer": jaxgeo.enable_x64} if way == "initializer" else {}
    place = looks.pose().position
    assert in_worker(lambda: pool(**how), place) == digits(place)


def forkserver(**how: Any) -> concurrent.futures.Executor:
    context = multiprocessing.get_context("forkserver")
    return concurrent.futures.ProcessPoolExecutor(1, mp_context=context, **how)


@pytest.fixture
def nobody_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """64-bit floats are on here, but nothing tells processes that start from here."""
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))


@pytest.mark.costly
@pytest.mark.parametrize("pool", [spawned, forkserver, loky])
def test_new_workers_run_from_the_first_task(pool: Any, nobody_says: None) -> None:
    place = looks.pose().position
    assert in_worker(pool, place) == digits(place)


@pytest.mark.slow
def test_a_process_of_its_own_and_a_pool_run_from_the_first_task(nobody_says: None) -> None:
    place, context = looks.pose().position, multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        assert pool.apply_async(digits, (place,)).get(timeout=120) == digits(place)
    ours, theirs = context.Pipe()
    process = context.Process(target=send_digits, args=(place, theirs))
    process.start()
    assert ours.poll(120)
    assert ours.recv() == digits(place)
    process.join()


COMPUTED, STATED = "it has computed in them", "the environment says so"


@pytest.mark.costly
@pytest.mark.parametrize(
    "pool, why",
    [
        (spawned, COMPUTED),
        (loky, STATED),
        pytest.param(spawned, STATED, marks=pytest.mark.slow),
        pytest.param(loky, COMPUTED, marks=pytest.mark.slow),
    ],
)
def test_workers_that_are_meant_to_have_32_bits_say_so(
    pool: Any, why: str, nobody_says: None, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    how: dict[str, Any] = {"initializer": compute_in_32_bits}
    if why == STATED:
        monkeypatch.setenv("JAX_ENABLE_X64", "0")
        how = {}
    with pytest.raises(Exception, match=r"terminated|un-serialize") as failure:
        in_worker(lambda: pool(**how), looks.pose().position)
    told = "".join(traceback.format_exception(failure.value)) + capfd.readouterr().err
    assert all(word in told for word in (*TURN_ON, "initializer=jaxgeo.enable_x64"))


@pytest.mark.slow
def test_joblib_runs_in_parallel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    jaxgeo.enable_x64()
    place = looks.pose().position
    found = joblib.Parallel(n_jobs=2, backend="loky")(joblib.delayed(digits)(place) for _ in range(4))
    assert found == [digits(place)] * 4


FOR_JOBLIB = "joblib.Parallel(n_jobs=2, initializer=jaxgeo.enable_x64)"


@pytest.mark.costly
def test_joblib_runs_as_its_page_says(nobody_says: None, project_root: pathlib.Path) -> None:
    assert FOR_JOBLIB in (project_root / "docs" / "howto" / "batches.md").read_text(encoding="utf-8")
    parallel = eval(FOR_JOBLIB, {"joblib": joblib, "jaxgeo": jaxgeo})
    place = looks.pose().position
    assert parallel([joblib.delayed(digits)(place)] * 2) == [digits(place)] * 2


FORKS = """
    import os, warnings
    warnings.simplefilter("ignore")
    import jax, jaxgeo
    jax.config.update("jax_enable_x64", True)

    def answer(shots=[]):
        camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=100, height=100)
        sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
        pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=900.0, heading=10.0)
        shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(outer=20.0, inner=0.0))
        fix = jaxgeo.locate(sensor, shot, (3.0, 90.0), jaxgeo.ConstantHeight(100.0))
        return " ".join(float(x).hex() for x in fix.ecef)

    def in_child():
        read, write = os.pipe()
        if not os.fork():
            try:
                text = answer()
            except RuntimeError as error:
                text = str(error)
            os.write(write, text.encode())
            os._exit(0)
        os.close(write)
        return os.fdopen(read).read()

    before = in_child()
    print(before == answer())
    print(in_child())
"""


@pytest.mark.costly
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_forked_processes_answer_alike_or_say_why_not() -> None:
    code = textwrap.dedent(FORKS)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    alike, refusal = done.stdout.strip().splitlines()
    assert alike == "True"
    assert "forked" in refusal
    assert "spawn" in refusal


FORKED_POOLS = """
    import concurrent.futures, multiprocessing, sys, warnings
    warnings.simplefilter("ignore")
    sys.path.insert(0, {project!r})
    import jax, jaxgeo, joblib
    jaxgeo.enable_x64()
    fork = multiprocessing.get_context("fork")
    place = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=3.0)
    float(place.lat + 1.0)

    def concurrent_futures():
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=fork) as pool:
            return pool.submit(jaxgeo.Geodetic.to_degrees, place).result(timeout=60)

    def pool():
        with fork.Pool(1) as pool:
            return pool.apply_async(jaxgeo.Geodetic.to_degrees, (place,)).get(timeout=60)

    def parallel():
        return joblib.Parallel(2, backend="multiprocessing")([joblib.delayed(jaxgeo.Geodetic.to_degrees)(place)])

    for way in (concurrent_futures, pool, parallel):
        try:
            print(way())
        except RuntimeError as error:
            print(str(error).replace(chr(10), " "))
"""


@pytest.mark.costly
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_forked_pools_say_why_not(project_root: pathlib.Path) -> None:
    code = textwrap.dedent(FORKED_POOLS.format(project=str(project_root)))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stderr
    refusals = done.stdout.strip().splitlines()
    assert len(refusals) == 3
    assert all("forked" in told and "'spawn'" in told for told in refusals), refusals


IN_32_BITS = """
    import io, jax, jax.numpy as jnp, numpy as np, equinox as eqx, jaxgeo, pathlib
    saved = pathlib.Path({file!r})
    for make in (jnp.asarray, np.float64, float, lambda x: jax.ShapeDtypeStruct((), np.float64)):
        try:
            like = jaxgeo.Geodetic(lat=make(0.0), lon=make(0.0), height=make(0.0))
            loaded = eqx.tree_deserialise_leaves(saved, like)
            print(float(loaded.lat).hex(), end=" ")
            print(loaded.to_degrees())
        except RuntimeError as error:
            print(str(error).replace(chr(10), " "))
"""


@pytest.mark.costly
def test_deserialised_leaves_are_whole_or_refused(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "place.eqx"
    eqx.tree_serialise_leaves(file, jax.tree.map(jnp.asarray, looks.pose().position))
    code = textwrap.dedent(IN_32_BITS.format(file=str(file)))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=in_32_bits())
    assert done.returncode == 0, done.stderr
    of_jax, of_numpy, of_floats, of_structs = done.stdout.strip().splitlines()
    assert all(word in of_jax for word in TURN_ON)
    for told in (of_numpy, of_floats):  # whole, and nothing is computed with it
        assert told.startswith(float(looks.pose().position.lat).hex())
        assert all(word in told for word in TURN_ON)
    assert "dtype" in of_structs  # refused by equinox

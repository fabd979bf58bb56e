"""A survey on the workers of Dask: no bit differs from one process, whoever is killed on the way."""

from __future__ import annotations

import os
import pathlib
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from support.survey import survey, write_tiles

import jaxgeo
from jaxgeo.cluster import connect, locate_frames
from jaxgeo.cluster.client import prepare
from jaxgeo.io import Observations, open_dem

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")
pytestmark = pytest.mark.slow

COUNT, ROWS, DOWN, ACROSS, POSTS = 2000, 25, 5, 8, 100
SIZE = (DOWN * POSTS * 30.0, ACROSS * POSTS * 30.0)  # m
RUN = f"""
import pathlib, sys
import jaxgeo
jaxgeo.enable_x64()
from support.survey import survey
from jaxgeo.cluster import connect, locate_frames
from jaxgeo.io import open_dem
if __name__ == "__main__":
    folder, tiles, workers = sys.argv[1:]
    files = open_dem(sorted(pathlib.Path(tiles).glob("*.tif")), vertical_datum="ellipsoid")
    with connect(f"local:{{workers}}") as client:
        run = locate_frames(folder, survey({COUNT}, {SIZE}), files, client=client, rows={ROWS})
    print(run.computed)
"""


@pytest.fixture(autouse=True)
def workers_find_the_tests(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> list[pathlib.Path]:
    return write_tiles(tmp_path_factory.mktemp("tiles"), down=DOWN, across=ACROSS, posts=POSTS)


@pytest.fixture(scope="module")
def frames() -> Observations:
    return survey(COUNT, SIZE)


@pytest.fixture(scope="module")
def whole(
    tmp_path_factory: pytest.TempPathFactory, frames: Observations, tiles: list[pathlib.Path]
) -> dict[str, bytes]:
    """The files of one process that was not interrupted."""
    folder = tmp_path_factory.mktemp("one") / "fixes"
    locate_frames(folder, frames, open_dem(tiles, vertical_datum="ellipsoid"), rows=ROWS)
    return content(folder)


@pytest.fixture
def client() -> Iterator[Any]:
    with connect("local:2") as client:
        yield client


def content(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")}


def wait_for(folder: pathlib.Path, count: int) -> None:
    """Until there are some parts."""
    end = time.monotonic() + 300.0
    while len(list(folder.glob("part-*"))) < count:
        assert time.monotonic() < end, "no parts appear"
        time.sleep(0.01)


def test_two_workers_find_the_same_to_the_bit(tmp_path, client: Any, frames: Observations, tiles, whole) -> None:
    run = locate_frames(
        tmp_path / "fixes", frames, open_dem(tiles, vertical_datum="ellipsoid"), client=client, rows=ROWS
    )
    assert run.computed == COUNT // ROWS
    assert content(run.folder) == whole


def test_a_killed_worker_loses_nothing(tmp_path: pathlib.Path, client: Any, frames: Observations, tiles, whole) -> None:
    first, *_ = client.run(os.getpid).values()
    folder = tmp_path / "fixes"

    def kill() -> None:
        wait_for(folder, 5)
        os.kill(first, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    locate_frames(folder, frames, open_dem(tiles, vertical_datum="ellipsoid"), client=client, rows=ROWS)
    killer.join()
    assert first not in client.run(os.getpid).values()
    assert content(folder) == whole


def test_a_killed_client_goes_on_with_other_workers(tmp_path, frames: Observations, tiles, whole) -> None:
    script, folder = tmp_path / "run.py", tmp_path / "fixes"
    script.write_text(RUN)
    command = [sys.executable, str(script), str(folder), str(tiles[0].parent)]
    killed = subprocess.Popen([*command, "2"], start_new_session=True)
    wait_for(folder, 5)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    there = len(list(folder.glob("part-*")))
    assert 5 <= there < COUNT // ROWS
    done = subprocess.run([*command, "1"], capture_output=True, text=True, check=True)
    assert int(done.stdout) == COUNT // ROWS - there
    assert content(folder) == whole


def test_a_machine_compiles_once(tmp_path, frames: Observations, tiles, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs in the cache are those of one process, not of two."""

    def programs(workers: int) -> set[str]:
        cache = tmp_path / f"cache{workers}"
        monkeypatch.setenv("JAXGEO_CACHE_DIR", str(cache))
        with connect(f"local:{workers}") as client:
            client.run(_count_compilations)
            files = open_dem(tiles, vertical_datum="ellipsoid")
            locate_frames(tmp_path / f"fixes{workers}", frames, files, client=client, rows=ROWS)
            compiled: Any = client.run(_compiled_here)
        names = {path.name for path in cache.rglob("program-*")}
        assert 0 < sum(compiled.values()) <= len(names), compiled  # the client keeps some, too
        return names

    assert programs(1) == programs(2)


def _count_compilations() -> None:
    """From now on, count the programs that this process compiles to keep them."""
    from jaxgeo._program_store import Programs

    compiled, Programs.count = Programs._compiled, 0  # pyright: ignore

    def counted(self: Any, *args: Any) -> Any:
        Programs.count += 1  # pyright: ignore
        return compiled(self, *args)

    Programs._compiled = counted  # pyright: ignore


def _compiled_here() -> int:
    from jaxgeo._program_store import Programs

    return Programs.count  # pyright: ignore


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """The address of a scheduler in a process of its own, without a word about 64-bit floats, and with one worker."""
    address = "tcp://127.0.0.1:18786"
    environment = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
    python = [sys.executable, "-c"]
    main = "import sys; from distributed.cli.{0} import main; sys.argv = ['dask-{1}', *sys.argv[1:]]; main()"
    started = subprocess.Popen(
        [*python, main.format("dask_scheduler", "scheduler"), "--port", "18786", "--no-dashboard"], env=environment
    )
    worker = subprocess.Popen(
        [*python, main.format("dask_worker", "worker"), address, "--nthreads", "1", "--no-nanny", "--no-dashboard"],
        env=environment,
    )
    yield address, started
    for process in (worker, started):
        process.kill()
        process.wait()


def test_a_scheduler_of_its_own_and_its_end(tmp_path: pathlib.Path, scheduler, frames: Observations) -> None:
    address, process = scheduler
    few = frames.part(0, np.arange(40))
    with connect(address) as client:
        run = locate_frames(tmp_path / "fixes", few, jaxgeo.ConstantHeight(600.0), client=client, rows=10)
        assert run.counts == {"hit": 40}
        folder = tmp_path / "ended"

        def kill() -> None:
            wait_for(folder, 3)
            process.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        with pytest.raises(ConnectionError, match=r"the cluster has ended; \d+ of 2000 parts are whole"):
            locate_frames(folder, frames, jaxgeo.ConstantHeight(600.0), client=client, rows=1)
        killer.join()


def test_workers_of_another_version_are_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxgeo.cluster.client.version", lambda: "0.0.1")
    with pytest.raises(RuntimeError, match=re.escape("2 of 2 workers have another version")) as told:
        prepare(client)
    assert "this process 0.0.1" in str(told.value)


def test_a_folder_that_workers_do_not_see_is_told(tmp_path: pathlib.Path, client: Any, monkeypatch) -> None:
    client.run(_hide_manifests)
    with pytest.raises(jaxgeo.cluster.PartsFailed, match="a file system that all workers share"):
        locate_frames(tmp_path / "fixes", survey(4, SIZE), jaxgeo.ConstantHeight(600.0), client=client)


def _hide_manifests() -> None:
    import jaxgeo.cluster.frames

    jaxgeo.cluster.frames.MANIFEST = "nothing"

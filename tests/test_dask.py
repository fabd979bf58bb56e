"""Work sent to the processes of a Dask cluster runs from the first task, and loses no digit.

Held against the same work done here. Needs `distributed`, which the other tests do not.
"""

from __future__ import annotations

import os
import pathlib
import sys
from collections.abc import Iterator
from typing import Any

import pytest

import jaxgeo
from jaxgeo.demo import scene_file
from tests.support import looks
from tests.support.records import digits

distributed: Any = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))
FOR_DASK = "client.register_worker_callbacks(jaxgeo.enable_x64)"  # as the page and the refusal print it


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """That of two processes which were started without a word about 64-bit floats."""
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def highest_of(files: Any) -> str:
    return float(files.highest).hex()


def compute_in_32_bits() -> str:
    import jax.numpy as jnp

    return str(jnp.zeros(3).dtype)


def refusal_of(data: bytes) -> str:
    import pickle

    try:
        pickle.loads(data)
    except RuntimeError as error:
        return str(error)
    return ""


def test_the_first_task_runs(client: Any) -> None:
    place, files = looks.pose().position, jaxgeo.io.open_dem(DEM)
    expected = highest_of(files)
    found = [client.submit(highest_of, files, pure=False), client.submit(digits, place, pure=False)]
    assert client.gather(found) == [expected, digits(place)]


def test_workers_that_have_computed_in_32_bits_are_told_what_to_do(client: Any, project_root: pathlib.Path) -> None:
    import pickle

    assert set(client.run(compute_in_32_bits).values()) == {"float32"}
    place = looks.pose().position
    told = set(client.run(refusal_of, pickle.dumps(place)).values())
    assert len(told) == 1
    assert FOR_DASK in told.pop()
    page = (project_root / "docs" / "howto" / "batches.md").read_text(encoding="utf-8")
    assert FOR_DASK in page
    eval(FOR_DASK, {"client": client, "jaxgeo": jaxgeo})
    assert client.submit(digits, place, pure=False).result(timeout=120) == digits(place)

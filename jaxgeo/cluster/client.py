"""Clients of Dask: a local cluster, or one that runs already, with workers set up for jaxgeo."""

from __future__ import annotations

import contextlib
import os
import pathlib
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import jax

from jaxgeo._accelerator import core_count
from jaxgeo._parallel import version

if TYPE_CHECKING:
    from distributed import Client

TIMEOUT = 30.0  # s
LOCAL = re.compile(r"local(?::([1-9][0-9]*))?")
SETUP = "jaxgeo"  # name of the plugin
# One thread per worker: more workers use the cores better than the threads of one program.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NPROC": "1"}


@contextlib.contextmanager
def connect(cluster: str | os.PathLike[str] = "local", *, timeout: float = TIMEOUT) -> Iterator[Client]:
    """A Dask client whose workers are set up for jaxgeo, for a `with` block.

    - `cluster`: "local" or "local:N" starts N worker processes of one thread each on this machine (default: one per
      core); "tcp://host:port" or "tls://..." connects to a scheduler, another text is the name of a scheduler file.
    - `timeout`: longest time in s until the scheduler answers.

    The workers have 64-bit floats as this process, and keep compiled programs as `keep_programs` does, so that a
    machine compiles once (see `prepare`, for a client of your own). Raises `ConnectionError` if no scheduler answers,
    `FileNotFoundError` for a missing scheduler file, `RuntimeError` for workers with another version of jaxgeo, and
    `ImportError` without the extra.
    """
    name = os.fspath(cluster)
    check_name(name)
    distributed = _distributed()
    with contextlib.ExitStack() as stack:
        if found := LOCAL.fullmatch(name):
            import dask.config

            environment = {"distributed.nanny.pre-spawn-environ": ONE_THREAD}
            with dask.config.set(environment):
                workers = distributed.LocalCluster(
                    n_workers=int(found[1]) if found[1] else core_count(),
                    threads_per_worker=1,
                    dashboard_address=":0",
                )
            stack.enter_context(workers)
            client = distributed.Client(workers)
        else:
            given = {"address" if "://" in name else "scheduler_file": name}
            try:
                client = distributed.Client(**given, timeout=timeout)
            except (OSError, ValueError) as error:  # a time-out is an OSError
                raise ConnectionError(
                    f'cluster "{name}": no scheduler answers within {timeout:g} s ({error}). Start one with: dask '
                    f"scheduler, and workers with: dask worker ADDRESS."
                ) from error
        stack.enter_context(client)
        prepare(client, timeout=timeout)
        yield client


def check_name(name: str) -> None:
    """Raise `FileNotFoundError` for a name that is none of those of `connect`, `ImportError` without the extra."""
    _distributed()
    if LOCAL.fullmatch(name) is None and "://" not in name and not pathlib.Path(name).is_file():
        raise FileNotFoundError(
            f'cluster "{name}": this is not local, local:N (N workers), an address such as tcp://host:8786, or an '
            f"existing scheduler file (dask scheduler --scheduler-file FILE writes one)."
        )


def prepare(client: Client, *, timeout: float = TIMEOUT) -> None:
    """Set up the workers of a client, those that join later too: 64-bit floats as in this process, kept programs.

    Raises `ConnectionError` if there is no worker within `timeout` s; `RuntimeError` for workers with another version
    of jaxgeo, or without it.
    """
    _distributed()
    from jaxgeo.cluster.worker_setup import WorkerSetup

    is_x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore
    try:
        client.wait_for_workers(1, timeout)
    except TimeoutError as error:
        raise ConnectionError(
            f"no worker joins the scheduler within {timeout:g} s ({client}). Start some with: dask worker ADDRESS."
        ) from error
    found: Any = client.run(_version_there)
    others = {address: one for address, one in found.items() if one != version()}
    if others:
        address, one = next(iter(others.items()))
        has = f"jaxgeo {one}" if one else "no jaxgeo"
        raise RuntimeError(
            f"{len(others)} of {len(found)} workers have another version: {address} has {has}, this process "
            f"{version()}. Install the same on all, and start them again."
        )
    client.register_plugin(WorkerSetup(is_x64), name=SETUP)


def _version_there() -> str:
    """The version of jaxgeo on a worker; empty without it."""
    import importlib.metadata

    try:
        return importlib.metadata.version("jaxgeo")
    except importlib.metadata.PackageNotFoundError:
        return ""


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ImportError("running on a cluster needs Dask: pip install 'jaxgeo[cluster]'") from None
    return distributed

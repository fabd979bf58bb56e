"""Samples divided among processes of `jax.distributed`: those of one process, and an error where one fails."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest

from jaxgeo.uncertainty import Sampled, Sampling, sample
from jaxgeo.uncertainty import processes as shared
from jaxgeo.uncertainty.batched_rays import BLOCK
from jaxgeo.uncertainty.sampling import resolve_sampling
from tests.uncertainty.test_sampled import KEY, SCENE

PROJECT = pathlib.Path(__file__).resolve().parents[2]
TIMEOUT = 25.0  # s, of the processes below
PATIENCE = 300.0  # s for processes to start, compile, and end
PROGRAM = """
import json, os, signal, sys, time
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", CACHE)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
if PROCESSES > 1:
    jax.distributed.initialize(ADDRESS, PROCESSES, RANK)
import jaxgeo
from jaxgeo.uncertainty import processes, sample
from tests.support import looks
from tests.uncertainty.test_sampled import KEY, SCENE

TERRAIN = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())


def tell(found):
    quantiles = [found.quantile(figure, p) for figure in found.figures for p in (0.5, 0.9)]
    statuses = {code.name: number for code, number in found.statuses.items()}
    moments = [found.mean_enu.tolist(), found.cov_enu.tolist()]
    print(json.dumps([found.count, found.ranges, statuses, quantiles, moments]), flush=True)


"""


@contextlib.contextmanager
def started(processes: int, program: str) -> Iterator[list[subprocess.Popen[str]]]:
    """The processes of a program, in which RANK is the number of the process; they are killed at the end."""
    with socket.socket() as taken:
        taken.bind(("localhost", 0))
        address = f"localhost:{taken.getsockname()[1]}"
    cache = jax.config.values["jax_compilation_cache_dir"] or ""
    known = f"PROCESSES, ADDRESS, CACHE = {processes}, {address!r}, {cache!r}\n"
    env, every = {**os.environ, "PYTHONPATH": str(PROJECT)}, []
    try:
        for rank in range(processes):
            command = [sys.executable, "-c", f"{known}RANK = {rank}\n{PROGRAM}{program}"]
            pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            every.append(subprocess.Popen(command, text=True, cwd=PROJECT, env=env, **pipes))
        yield every
    finally:
        for one in every:
            with contextlib.suppress(ProcessLookupError):
                one.kill()
            one.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """(return code, output, errors) of a process, which must end in time."""
    output, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, output, errors


def told(processes: int, program: str) -> list[list[Any]]:
    """What the processes tell, one line for each result, the same from all of them."""
    with started(processes, program) as every:
        results = [ended(one) for one in every]
    for code, _, errors in results:
        assert code == 0, errors
    lines = [[json.loads(line) for line in output.splitlines() if re.match(r"\[\d", line)] for _, output, _ in results]
    assert all(each == lines[0] for each in lines)
    return lines[0]


def assert_told_the_same(found: list[list[Any]], expected: list[list[Any]]) -> None:
    """To the bit, but for moments, whose sums are rounded in another order."""
    assert [one[:4] for one in found] == [one[:4] for one in expected]
    for ours, theirs in zip(found, expected, strict=True):
        for moment, other in zip(ours[4], theirs[4], strict=True):
            np.testing.assert_allclose(moment, other, rtol=0, atol=1e-10 * np.abs(other).max() + 1e-11)


SEVERAL = """
tell(sample(*TERRAIN, key=KEY, count=200_000))
tell(sample(*TERRAIN, key=KEY, count=10_001, first=77, summary=True))
tell(sample(*TERRAIN, key=KEY, count=3, about_mean=True))
tell(sample(*TERRAIN, key=KEY, count=3000, devices=jax.local_devices()))
assert jaxgeo.accuracy(*TERRAIN, sampling=jaxgeo.Sampling(count=100)).circular > 0.0
"""


@pytest.mark.slow
def test_one_two_and_four_processes_draw_the_same() -> None:
    one = told(1, SEVERAL)
    for processes in (2, 4):
        assert_told_the_same(told(processes, SEVERAL), one)


@pytest.mark.slow
def test_two_processes_draw_the_same_as_this_one() -> None:
    """Also until the figure is known to a half width: then as many samples as its rounds ask for."""
    program = "tell(sample(*SCENE, key=KEY, count=9000, chunk=1))\n"
    program += "tell(sample(*SCENE, key=KEY, count=100_000, chunk=1, half_width=0.03))\n"
    found, sharp = told(2, program)
    ours = sample(*SCENE, key=KEY, count=9000)
    quantiles = [list(ours.quantile(figure, p)) for figure in ours.figures for p in (0.5, 0.9)]
    assert found[:2] == [9000, [[0, 9000]]]
    assert found[3] == quantiles
    assert sharp[0] == 2 * BLOCK
    same = sample(*SCENE, key=KEY, count=2 * BLOCK)
    assert sharp[3][1] == list(same.circular_error(0.9))


FAILURES = {
    "killed while it draws": "os.kill(os.getpid(), signal.SIGKILL)",
    "killed after its samples": "time.sleep(0.3); os.kill(os.getpid(), signal.SIGKILL)",
    "runs out of memory": "raise MemoryError('no room')",
    "never comes": "time.sleep(1000)",
}


@pytest.mark.slow
@pytest.mark.parametrize("failing", [0, 1])
@pytest.mark.parametrize("failure", FAILURES)
def test_a_process_that_fails_is_an_error_in_the_others(failing: int, failure: str) -> None:
    """Within the timeout, whoever fails: process 0 serves the others' coordination too."""
    program = f"""
sample(*SCENE, key=KEY, count=9000, devices=jax.local_devices())  # compiled
draw, begin = processes.drawn_together, time.monotonic()
def failing(own, *rest):
    def broken(first, count):
        {FAILURES[failure]}
    return draw(broken if RANK == {failing} else own, *rest)
import jaxgeo.uncertainty.sampled as module
module.drawn_together = failing
try:
    sample(*SCENE, key=KEY, count=9000, timeout={TIMEOUT})
except RuntimeError as error:
    print("error", round(time.monotonic() - begin), error, flush=True)
    os._exit(3)
except MemoryError:
    os._exit(4)
"""
    with started(2, program) as every:
        code, output, errors = ended(every[1 - failing])
    assert code != 0, output + errors
    if failure == "runs out of memory":
        assert f"process {failing} of jax.distributed failed with MemoryError: no room" in output
    elif failure == "never comes":
        assert f"within {TIMEOUT:g} s" in output
    assert "jax.distributed" in output or "coordination service" in errors.lower()
    if output.startswith("error"):
        assert int(output.split()[1]) < TIMEOUT + 5.0


@pytest.mark.slow
def test_processes_with_other_arguments_are_an_error() -> None:
    other_key = f"sample(*SCENE, key=jax.random.key(RANK), count=9000, timeout={TIMEOUT})"
    other_count = f"sample(*SCENE, key=KEY, count=9000 + RANK, timeout={TIMEOUT})"
    for program, message in (
        (other_key, "must call sample with the same arguments, but part 1 is no part"),
        (other_count, "All processes must call sample with the same arguments."),
    ):
        with started(2, program) as every:
            results = [ended(one) for one in every]
        for code, _, errors in results:
            assert code != 0
            assert message in errors


# ---- how samples are divided


@pytest.mark.parametrize("processes", [1, 2, 3, 8])
@pytest.mark.parametrize("first, count", [(0, 1), (0, 5), (0, 10_000), (34, 200_000), (0, 1_000_001)])
def test_every_sample_is_given_to_one_process(first: int, count: int, processes: int) -> None:
    shares = shared.divided(first, count, processes)
    assert len(shares) == processes
    place = first
    for start, number in shares:
        assert start == place
        assert number >= 0
        assert start in (first, first + count) or start % BLOCK == 0
        place += number
    assert place == first + count
    assert max(number for _, number in shares) <= -(-count // processes) + BLOCK


@pytest.mark.costly
def test_rounds_until_the_figure_is_sharp() -> None:
    """As one process draws: what the rounds draw is merged, and they stop at the count."""
    drawn: list[tuple[int, int]] = []

    def draw(first: int, count: int) -> Sampled:
        drawn.append((first, count))
        return sample(*SCENE, key=KEY, first=first, count=count)

    for half_width, count in ((0.02, 100_000), (1e-9, 9001)):
        drawn.clear()
        options = resolve_sampling(Sampling(count=count, half_width=half_width), 1)
        found = shared.until_sharp(draw, 5, options, 4000)
        quantile = found.circular_error(0.9)
        sharp = 0.5 * (quantile.high - quantile.low) <= half_width * quantile.value
        assert sharp == (half_width == 0.02)
        assert found.ranges == ((5, 5 + sum(number for _, number in drawn)),)
        assert found.count == count if not sharp else found.count < count
        assert drawn[0] == (5, 4000)


@pytest.mark.parametrize("size", [0, 1, 5, 8, 9, 1000, 12_345, 2**30 + 1])
def test_messages_have_room_of_few_sizes(size: int) -> None:
    room = shared._room(size)
    assert size <= room <= max(1.126 * size, size + 1)

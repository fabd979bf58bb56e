"""Processes stopped by a signal at a given time: their output, exit code and remaining files."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

LONGEST = 2.0  # s from the signal to the end, with a free processor
TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100

AS_FROM_A_TERMINAL = """
import os, signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a process ended: all None if it finished before the signal."""

    code: int
    told: list[str]
    seconds: float
    was_done: bool
    left: list[int]
    """Processes of its group that are still running."""


def allowed() -> float:
    """Time limit in s for the end; scaled up if more threads want to run than there are processors."""
    return LONGEST * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def stopped(
    line: Sequence[str], moment: float, number: int = signal.SIGINT, *, whole_group: bool = False, **how: object
) -> Ended:
    """Start a command, and send it a signal once it handles signals and has used `moment` s of processor time."""
    process = started(line, **how)
    assert process.stderr is not None
    while is_running(process) and not (handles_signals(process.pid) and processor_time(process.pid) >= moment):
        time.sleep(0.002)
    was_done = not is_running(process)
    began = time.monotonic()
    if not was_done:
        (os.killpg if whole_group else os.kill)(process.pid, number)
    _, told = process.communicate(timeout=120)
    seconds = time.monotonic() - began
    return Ended(process.returncode, told.splitlines(), seconds, was_done, group(process.pid))


def started(line: Sequence[str], **how: object) -> subprocess.Popen[str]:
    """A process in its own group, which does not ignore Ctrl-C even if the tests run in the background."""
    how = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, **how}
    whole = [sys.executable, "-S", "-c", AS_FROM_A_TERMINAL, *line]
    return subprocess.Popen(whole, text=True, start_new_session=True, **how)  # pyright: ignore


def is_running(process: subprocess.Popen[str]) -> bool:
    return process.poll() is None


def handles_signals(number: int) -> bool:
    """Whether a process handles SIGTERM, which Python by default does not; Linux only."""
    return _status(number, "SigCgt") >> (signal.SIGTERM - 1) & 1 == 1


def _status(number: int, name: str) -> int:
    try:
        lines = pathlib.Path(f"/proc/{number}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1], 16) for line in lines if line.startswith(name)), 0)


def processor_time(number: int) -> float:
    """Processor time in s used by a process."""
    fields = _fields(number)
    return (int(fields[11]) + int(fields[12])) / TICKS if fields else 0.0


def _fields(number: int) -> list[str]:
    try:
        return pathlib.Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def group(number: int) -> list[int]:
    """Running processes of a group; waits briefly for those that are ending."""
    found: list[int] = []
    for _ in range(100):
        ids = [int(path.name) for path in pathlib.Path("/proc").iterdir() if path.name.isdigit()]
        states = {one: _fields(one) for one in ids}
        found = [one for one, fields in states.items() if fields and fields[2] == str(number) and fields[0] != "Z"]
        if not found:
            break
        time.sleep(0.02)
    return found


def wait_until(holds: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait until a condition holds; raises `AssertionError` after a timeout."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)

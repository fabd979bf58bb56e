"""Timing, idle check, memory, and tables with a unit and a direction for every number."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.metadata
import json
import math
import os
import pathlib
import platform
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

HERE = pathlib.Path(__file__).resolve().parent
ARROWS = {"higher": "↑", "lower": "↓", "": ""}
BUSY = 0.05  # of one core: above it the machine counts as busy
PACKAGES = "jaxgeo jax jaxlib numpy scipy shareloc embreex open3d numba".split()


@dataclass(frozen=True)
class Column:
    """A column of a table: its name, its unit ('' for none) and which direction is better ('higher', 'lower', '')."""

    name: str
    unit: str = ""
    better: str = ""

    @property
    def heading(self) -> str:
        unit = f", {self.unit}" if self.unit else ""
        return f"{self.name}{unit} {ARROWS[self.better]}".rstrip()


@dataclass
class Table:
    """Rows of numbers and text under columns, with notes below."""

    title: str
    columns: list[Column]
    rows: list[list[Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, record: dict[str, Any]) -> Table:
        """The table of a `record`."""
        columns = [Column(**column) for column in record["columns"]]
        return cls(record["title"], columns, record["rows"], record["notes"])

    def markdown(self) -> str:
        lines = [f"### {self.title}", ""]
        lines.append("| " + " | ".join(c.heading for c in self.columns) + " |")
        lines.append("|" + "---|" * len(self.columns))
        lines += ["| " + " | ".join(_cell(x) for x in row) + " |" for row in self.rows]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes)]) + "\n"

    def record(self) -> dict[str, Any]:
        columns = [{"name": c.name, "unit": c.unit, "better": c.better} for c in self.columns]
        return {
            "title": self.title,
            "columns": columns,
            "rows": [[_plain(x) for x in row] for row in self.rows],
            "notes": self.notes,
        }


def _plain(x: Any) -> Any:
    """A value in JSON form: no NaN, no NumPy."""
    x = x.item() if hasattr(x, "item") else x
    return None if isinstance(x, float) and not math.isfinite(x) else x


def _cell(x: Any) -> str:
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.3g}" if abs(x) < 100 else f"{x:.0f}"
    return str(x)


@dataclass
class Timing:
    """Seconds of every repeat of one contender."""

    seconds: list[float]

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)

    @property
    def spread(self) -> float:
        """(slowest - fastest) / median."""
        return (max(self.seconds) - min(self.seconds)) / self.median


def interleaved(runs: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Time every contender once per repeat, in rotating order, so that slow phases of the machine affect all."""
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    names = list(runs)
    for repeat in range(repeats):
        for name in names if repeat % 2 == 0 else reversed(names):
            begin = time.perf_counter()
            runs[name]()
            seconds[name].append(time.perf_counter() - begin)
    return {name: Timing(values) for name, values in seconds.items()}


def timed(run: Callable[[], Any]) -> tuple[Any, float]:
    """Return value of `run` and its time in s."""
    begin = time.perf_counter()
    result = run()
    return result, time.perf_counter() - begin


def counting(run: Callable[[], Any], spent: list[float]) -> Callable[[], Any]:
    """A run that also records the processor time of all its threads, which other processes affect less."""

    def counted() -> Any:
        begin = time.process_time()
        answer = run()
        spent.append(time.process_time() - begin)
        return answer

    return counted


@contextlib.contextmanager
def pinned(cpus: int) -> Iterator[bool]:
    """Pin all threads of the process to `cpus` processors; yields whether the system supports it."""
    if not hasattr(os, "sched_setaffinity"):
        yield False
        return
    allowed = sorted(os.sched_getaffinity(0))
    _pin(set(allowed[:cpus]))
    try:
        yield True
    finally:
        _pin(set(allowed))


def _pin(cpus: set[int]) -> None:
    for task in pathlib.Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(int(task.name), cpus)


class Watch:
    """Number of cores kept busy by other processes since its creation (Linux; else NaN)."""

    def __init__(self) -> None:
        self.begin, self.busy, self.own = time.monotonic(), _busy_seconds(), _own_seconds()

    def others(self) -> float:
        elapsed = time.monotonic() - self.begin
        return max(0.0, (_busy_seconds() - self.busy) - (_own_seconds() - self.own)) / elapsed


def _busy_seconds() -> float:
    try:
        words = pathlib.Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    except OSError:
        return float("nan")
    user, nice, system, _, _, irq, softirq, steal = (int(word) for word in words[:8])
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


def _own_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def idle_check(seconds: float = 1.0) -> tuple[bool, str]:
    """Whether the machine is idle, and the figures: load, cores used by others, core share of a spinning thread."""
    watch, load = Watch(), os.getloadavg()[0]
    time.sleep(seconds)
    others = watch.others()
    begin, cpu = time.perf_counter(), time.thread_time()
    while time.perf_counter() - begin < 0.3:
        pass
    got = (time.thread_time() - cpu) / (time.perf_counter() - begin)
    is_idle = not others > BUSY and got > 1.0 - BUSY
    figures = f"load average {load:.2f}, others use {others:.2f} cores, a spinning thread gets {got:.1%} of a core"
    return is_idle, ("idle: " if is_idle else "WARNING, the machine is not idle: ") + figures


# Memory.


def resident() -> int:
    """Resident bytes of this process, after releasing free memory."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    return _status("VmRSS")


def reset_peak() -> None:
    """Reset the `peak` counter (Linux; elsewhere it counts from the start of the process)."""
    with contextlib.suppress(OSError):
        pathlib.Path("/proc/self/clear_refs").write_text("5")


def peak() -> int:
    """Peak resident bytes of this process since `reset_peak`."""
    return _status("VmHWM")


def _status(name: str) -> int:
    try:
        lines = pathlib.Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith(name)).split()[1]) * 1024
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def fresh_process(code: str) -> list[float]:
    """Numbers that Python code prints in a fresh process with this process's path and no compilation cache."""
    environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def in_subprocess(task: str, arguments: dict[str, Any], timeout: float) -> dict[str, Any]:
    """Result of a task of `workers.py` in a fresh process; {'reason': ...} if it fails or exceeds the timeout."""
    command = [sys.executable, str(HERE / "workers.py"), task, json.dumps(arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return {"reason": f"no answer within {timeout:.0f} s"}
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return {"reason": last[:200]}
    return json.loads(done.stdout.strip().splitlines()[-1])


# The machine.


def machine() -> dict[str, Any]:
    """Processor, cores, memory, system and the versions of all involved packages."""
    versions = {"jaxgeo": "this tree"}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_GiB": round(memory, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
    }


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()

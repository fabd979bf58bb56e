"""Cost of distributing frames over Dask workers, and a model of more workers from it.

Run: python benchmarks/cluster.py [--frames 4000] [--rows 256] [--only plan|scheduler|workers]; the machine should have
two idle cores. Compiling is not counted: programs are kept from a first run.

- plan: time and memory of the client for the parts of 100,000 frames, which are not run.
- scheduler: ms of an empty task, per task.
- workers: frames a second, with accuracy, of one and of two workers of one core, in turn; time of a part, of reading a
  program, memory of a worker.
- model: time of N parts on W workers, start + N max(part / W, task of the scheduler), and where it stops scaling.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import resource
import shutil
import statistics
import sys
import tempfile
import time
import tracemalloc
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
os.environ["PYTHONPATH"] = os.pathsep.join([sys.path[0], os.environ.get("PYTHONPATH", "")])

from support.survey import survey, write_tiles

import jaxgeo
from jaxgeo.cluster import connect, locate_frames
from jaxgeo.cluster.frames import Files, Setting, identity, parts_of
from jaxgeo.io import open_dem
from jaxgeo.io.fix_parts import FixParts

DOWN, ACROSS, POSTS = 5, 8, 200
SIZE = (DOWN * POSTS * 30.0, ACROSS * POSTS * 30.0)  # m
MANY = 100_000
READING, REPEATS = 2, 3  # runs by which each worker has met all programs, whoever gets which part; runs that count


def plan(files: Any, rows: int) -> dict[str, float]:
    """What `locate_frames` does before the first part is computed; memory is that of Python and NumPy."""
    observed = survey(MANY, SIZE)
    _planned(survey(10, SIZE), files, rows)  # compiles
    start = time.perf_counter()
    parts = _planned(observed, files, rows)
    took = time.perf_counter() - start
    tracemalloc.start()
    _planned(observed, files, rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return {"frames": MANY, "parts": len(parts), "s": took, "peak_MB": 1e-6 * peak}


def _planned(observed: Any, files: Any, rows: int) -> list[Any]:
    output = FixParts.of(observed.position, observed.columns, probability=0.9)
    parts = parts_of(observed, files, rows)
    identity(observed, files, Files(pathlib.Path(), output, Setting(files, None, 0.0)), rows)
    return parts


def scheduler(tasks: int = 2000) -> dict[str, float]:
    with connect("local:2") as client:
        client.gather(client.map(_nothing, range(100), pure=False))
        start = time.perf_counter()
        client.gather(client.map(_nothing, range(tasks), pure=False))
        return {"tasks": tasks, "ms_per_task": 1e3 * (time.perf_counter() - start) / tasks}


def _nothing(number: int) -> int:
    return number


def workers(files: Any, frames: int, rows: int, repeats: int, folder: pathlib.Path) -> dict[str, Any]:
    observed = survey(frames, SIZE)
    seconds: dict[int, list[float]] = {1: [], 2: []}
    memory: dict[int, int] = {}
    starting = []
    for count in (1, 2):  # programs are compiled, and kept
        with connect(f"local:{count}") as client:
            locate_frames(folder / f"first{count}", observed, files, accuracy=True, client=client, rows=rows)
    for repeat in range(repeats):
        for count in (1, 2):
            start = time.perf_counter()
            with connect(f"local:{count}") as client:
                starting.append(time.perf_counter() - start)
                took = []
                for k in range(READING + REPEATS):
                    name = folder / f"run{repeat}{count}{k}"
                    start = time.perf_counter()
                    run = locate_frames(name, observed, files, accuracy=True, client=client, rows=rows)
                    took.append(time.perf_counter() - start)
                    shutil.rmtree(name)
                seconds[count].append(statistics.median(took[READING:]))
                peaks: Any = client.run(_peak)
                memory[count] = max(peaks.values())
    median = {count: statistics.median(each) for count, each in seconds.items()}
    return {
        "frames": frames,
        "parts": len(run.parts),
        "frames_per_s": {count: frames / one for count, one in median.items()},
        "ratio": median[1] / median[2],
        "ratios": [one / two for one, two in zip(seconds[1], seconds[2], strict=True)],
        "part_s": median[1] / len(run.parts),
        "start_s": statistics.median(starting),
        "peak_MB": memory,
    }


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000


def model(part_s: float, task_s: float, start_s: float, parts: int) -> list[dict[str, float]]:
    """Time of many parts on more and more workers, and the share of the workers' time that is used."""
    rows = []
    for count in (1, 10, 100, 1000):
        took = start_s + parts * max(part_s / count, task_s) + part_s
        rows.append({"workers": count, "s": took, "use": parts * part_s / (took * count)})
    return rows


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=int, default=4000)
    options.add_argument("--rows", type=int, default=256)
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--only", choices=("plan", "scheduler", "workers"))
    given = options.parse_args()
    jaxgeo.enable_x64()
    jaxgeo.keep_programs()
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        files = open_dem(write_tiles(folder, DOWN, ACROSS, POSTS), vertical_datum="ellipsoid")
        if given.only in (None, "plan"):
            found["plan"] = plan(files, given.rows)
        if given.only in (None, "scheduler"):
            found["scheduler"] = scheduler()
        if given.only in (None, "workers"):
            found["workers"] = workers(files, given.frames, given.rows, given.repeats, folder)
    if given.only is None:
        cost = found["workers"]
        task_s = 1e-3 * found["scheduler"]["ms_per_task"]
        found["model"] = {"rows": model(cost["part_s"], task_s, cost["start_s"], int(found["plan"]["parts"]))}
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()

"""Processor time of the studies as measured, and progress by it."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

from jaxgeo.cli._screen import print_note, progress_bar

MACHINE = "a server with AMD EPYC processors"
# s of processor time (user and system) of `jaxgeo study NAME` with default options on two cores of MACHINE.
MEASURED = {"li2020": 118.0, "li2023": 131.0, "xue2019": 124.0, "gu2017": 319.0}
TICK = 0.5  # s between updates of the bar
LATE = 0.98  # of the expected time, at which the bar waits for a slower machine


def minutes_of(name: str) -> str:
    """The processor time of a study with default options: "2.2 minutes"."""
    return f"{MEASURED[name] / 60.0:.2g} minutes"


@contextlib.contextmanager
def study_progress(name: str, *, is_usual: bool) -> Iterator[None]:
    """Say how long a study takes, and show a bar of the processor time of this process with the time that remains.

    Other than default options make it longer or shorter, by much: then the bar has no end.
    """
    expected = MEASURED[name]
    if is_usual:
        print_note(f"takes about {minutes_of(name)} of processor time on {MACHINE}, most of it compilation.")
    done = threading.Event()
    with progress_bar() as bar:
        words = "compiling and computing, s of processor time"
        task = bar.add_task(words, total=round(expected) if is_usual else None)
        began = time.process_time()

        def tick() -> None:
            while not done.wait(TICK):
                used = time.process_time() - began
                bar.update(task, completed=min(used, LATE * expected) if is_usual else used)

        ticker = threading.Thread(target=tick, daemon=True)
        ticker.start()
        try:
            yield
        finally:
            done.set()
            ticker.join()

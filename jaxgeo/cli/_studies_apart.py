"""The four studies in subprocesses, as many at a time as there are cores, up to two.

Most of a study is compilation, which uses one core. A subprocess ends when its standard input closes, so it does not
outlive an interrupted command.
"""

from __future__ import annotations

import os
import pathlib
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time

from jaxgeo.cli._screen import progress_bar
from jaxgeo.studies.all_studies import RUNS, Study

AT_A_TIME = 2
LONGEST_FIRST = ("gu2017", "li2023", "xue2019", "li2020")
WAIT = 0.1  # s between polls of the processes
MODULE = "jaxgeo.cli._studies_apart"


def found_apart(seed: int, folder: pathlib.Path | None) -> list[Study]:
    """Results of all studies, in the order of `RUNS`; tables and figures go into an existing folder.

    Progress is shown on stderr. Raises `RuntimeError` with the stderr of a study that fails.
    """
    waiting, going, done = list(LONGEST_FIRST), {}, {}
    with tempfile.TemporaryDirectory() as place, progress_bar() as progress:
        task = progress.add_task(_words(waiting), total=len(waiting))
        try:
            while waiting or going:
                while waiting and len(going) < min(AT_A_TIME, os.cpu_count() or 1):
                    name = waiting.pop(0)
                    going[name] = _started(name, seed, folder, pathlib.Path(place))
                    progress.update(task, description=_words(going))
                for name in [name for name, process in going.items() if process.poll() is not None]:
                    process = going.pop(name)
                    _close(process)
                    written = pathlib.Path(place) / f"{name}.pickle"
                    if process.returncode != 0 or not written.exists():
                        text = (pathlib.Path(place) / f"{name}.txt").read_text(encoding="utf-8", errors="replace")
                        raise RuntimeError(f"study {name} ended with {process.returncode}: {text[-2000:]}")
                    done[name] = pickle.loads(written.read_bytes())  # written by our own subprocess
                    progress.update(task, completed=len(done), description=_words(going))
                time.sleep(WAIT)
        finally:
            for process in going.values():
                process.kill()
                _close(process)
    return [done[name] for name in RUNS]


def _words(names: object) -> str:
    return f"study {', '.join(names)}" if names else "studies"  # type: ignore[arg-type]


def _started(name: str, seed: int, folder: pathlib.Path | None, place: pathlib.Path) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", MODULE, name, str(seed), str(place / f"{name}.pickle")]
    if folder is not None:
        words.append(str(folder.absolute()))
    with (place / f"{name}.txt").open("wb") as stream:
        return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=stream, stderr=stream)


def _close(process: subprocess.Popen[bytes]) -> None:
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _end_with_parent() -> None:
    os.read(0, 1)  # not sys.stdin: its lock would be held at exit
    os._exit(1)


def main(words: list[str]) -> None:
    """Run one study; `words` are its name, seed, result file and, optionally, a folder for tables and figures."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from jaxgeo._checks import enable_x64
    from jaxgeo.cli._compiler import compile_quickly
    from jaxgeo.studies.all_studies import run

    name, seed, written, *folder = words
    compile_quickly()
    enable_x64()
    found = run(name, int(seed), pathlib.Path(folder[0]) if folder else None)
    pathlib.Path(written).write_bytes(pickle.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])

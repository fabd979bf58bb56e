"""Reading mutants of files: each is refused in one line, or gives what its bytes state, in little time and memory."""

from __future__ import annotations

import contextlib
import dataclasses
import faulthandler
import pathlib
import resource
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from tests.fuzz.mutation import mutant

LONGEST, LONGEST_WAIT = 10.0, 60.0  # s of the processor for a file, and by the clock
MOST_MEMORY = 2_000_000_000  # bytes beyond those of the process before
LONGEST_LINE = 1100  # characters of a refusal
STUCK = 120.0  # s after which a process that does not come back from a library is ended, with its stack


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader and the files whose mutants it reads.

    - `seeds` makes, in an empty folder, the contents of sound files; `beside` are files that stay as they are, by name.
    - `read` takes the path of a mutant; `refusals` are the errors that it may raise.
    - `check` of an answer raises `AssertionError` where it cannot be right (not finite, out of range).
    - `second` takes the path and the answer, and raises `AssertionError` where another reading of the bytes differs.
    - `tests`: the file of its tests, whose first words say what the format was held against.
    - `text`: whether words, lines and nesting are changed too. `ending` of the name of the file.
    """

    name: str
    ending: str
    seeds: Callable[[pathlib.Path], Sequence[bytes]]
    read: Callable[[pathlib.Path], Any]
    refusals: tuple[type[Exception], ...]
    tests: str = dataclasses.field(kw_only=True)
    check: Callable[[Any], None] = lambda answer: None
    second: Callable[[pathlib.Path, Any], None] | None = dataclasses.field(kw_only=True)
    text: bool = False
    several_lines: bool = False


@dataclasses.dataclass
class Found:
    """How many mutants were refused and how many gave an answer; what went wrong with others, and in which."""

    refused: int = 0
    answered: int = 0
    wrong: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    slowest: float = 0.0
    grown: int = 0
    """Bytes of memory at most beyond those of the process before."""

    def __str__(self) -> str:
        told = f"{self.refused + self.answered} mutants: {self.refused} refused, {self.answered} answers"
        return f"{told}, slowest {self.slowest:.2f} s, memory + {self.grown / 1e6:.0f} MB"


class TooSlow(BaseException):
    """Not an `Exception`, so that no reader takes it for one of its own."""


def read_mutants(reader: Reader, folder: pathlib.Path, seed: int, numbers: Sequence[int]) -> Found:
    """Read the mutants of a seed and some numbers, one after another, in a folder."""
    seeds, found = reader.seeds(folder), Found()
    for content in seeds:
        path = folder / f"sound{reader.ending}"
        path.write_bytes(content)
        answer = reader.read(path)
        reader.check(answer)
        if reader.second is not None:
            reader.second(path, answer)
    before = _fresh_peak()
    for number in numbers:
        path = folder / f"m{number}{reader.ending}"
        path.write_bytes(mutant(seeds, seed, number, text=reader.text))
        start = time.perf_counter()
        wrong = _outcome(reader, path, found)
        found.slowest = max(found.slowest, time.perf_counter() - start)
        if wrong:
            found.wrong.setdefault(wrong, []).append(number)
        path.unlink(missing_ok=True)
    found.grown = max(_told("VmHWM") - before, 0)
    if found.grown > MOST_MEMORY:
        found.wrong[f"memory grew by {found.grown / 1e9:.1f} GB"] = list(numbers)
    return found


def _outcome(reader: Reader, path: pathlib.Path, found: Found) -> str:
    """What is wrong with the outcome; empty if nothing is."""
    try:
        with limits(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            answer = reader.read(path)
    except reader.refusals as error:
        found.refused += 1
        message = str(error)
        if path.name not in message:
            return f"no name of the file: {type(error).__name__}: {message[:300]!r}"
        if "\n" in message.strip() and not reader.several_lines:
            return f"several lines: {type(error).__name__}: {message[:300]!r}"
        if not message.strip() or max(map(len, message.split("\n"))) > LONGEST_LINE:
            return f"{len(message)} characters: {type(error).__name__}: {message[:200]!r}"
        return ""
    except TooSlow:
        return f"longer than {LONGEST:g} s"
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        frame = traceback.extract_tb(error.__traceback__)[-1]
        ours = [one for one in traceback.extract_tb(error.__traceback__) if "/jaxgeo/" in one.filename]
        where = f"{pathlib.Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
        return f"{type(error).__name__} in {pathlib.Path(frame.filename).name}, {where}: {str(error)[:200]}"
    found.answered += 1
    try:
        reader.check(answer)
        if reader.second is not None:
            reader.second(path, answer)
    except AssertionError as error:
        return f"a wrong answer: {str(error)[:300]}"
    except Exception as error:
        return f"an answer, but the second reading refuses: {type(error).__name__}: {str(error)[:200]}"
    return ""


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """An alarm, and a bound on memory by which a larger allocation fails."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (_told("VmData") + MOST_MEMORY, before[1]))
    timers = ((signal.SIGALRM, signal.ITIMER_REAL, LONGEST_WAIT), (signal.SIGPROF, signal.ITIMER_PROF, LONGEST))
    old = [signal.signal(name, _raise) for name, _, _ in timers]
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    faulthandler.dump_traceback_later(STUCK, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        for (name, timer, _), handler in zip(timers, old, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(name, handler)
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _raise(*_: object) -> None:
    raise TooSlow


def _told(name: str) -> int:
    """Bytes of this process by the kernel: VmData are private, VmRSS in memory, VmHWM the most that ever were."""
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    told: Mapping[str, str] = dict(line.split(":", 1) for line in lines if ":" in line)
    return 1024 * int(told[name].split()[0])


def _fresh_peak() -> int:
    """Bytes in memory now, from which the kernel counts its peak anew."""
    with contextlib.suppress(OSError):
        pathlib.Path("/proc/self/clear_refs").write_text("5")
    return _told("VmRSS")

"""Reading mutants of files: each must be refused in one line or give an answer, in little time and memory."""

from __future__ import annotations

import contextlib
import dataclasses
import pathlib
import resource
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from tests.support.mutation import mutant

LONGEST = 10.0  # s for a file
MOST_MEMORY = 2_000_000_000  # bytes beyond those of the process before
LONGEST_LINE = 1100  # characters of a refusal


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader and the files whose mutants it reads.

    - `seeds` makes, in an empty folder, the contents of sound files; `beside` are files that stay as they are, by name.
    - `read` takes the path of a mutant; `refusals` are the errors that it may raise.
    - `check` of an answer raises `AssertionError` where it cannot be right (not finite, out of range).
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
    text: bool = False
    several_lines: bool = False


@dataclasses.dataclass
class Found:
    """How many mutants were refused and how many gave an answer; what went wrong with others, and in which."""

    refused: int = 0
    answered: int = 0
    wrong: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    slowest: float = 0.0
    kinds: Counter[str] = dataclasses.field(default_factory=Counter)

    def __str__(self) -> str:
        told = f"{self.refused + self.answered} mutants: {self.refused} refused, {self.answered} answers"
        return f"{told}, slowest {self.slowest:.2f} s"


class TooSlow(BaseException):
    """Not an `Exception`, so that no reader takes it for one of its own."""


def read_mutants(reader: Reader, folder: pathlib.Path, numbers: Sequence[int]) -> Found:
    """Read the mutants of some numbers, one after another, in a folder."""
    seeds, found = reader.seeds(folder), Found()
    for content in seeds:
        path = folder / f"sound{reader.ending}"
        path.write_bytes(content)
        reader.check(reader.read(path))
    for number in numbers:
        path = folder / f"m{number}{reader.ending}"
        path.write_bytes(mutant(seeds, number, text=reader.text))
        start = time.perf_counter()
        wrong = _outcome(reader, path, found)
        found.slowest = max(found.slowest, time.perf_counter() - start)
        if wrong:
            found.wrong.setdefault(wrong, []).append(number)
        path.unlink(missing_ok=True)
    return found


def _outcome(reader: Reader, path: pathlib.Path, found: Found) -> str:
    """What is wrong with the outcome; empty if nothing is."""
    try:
        with _limits(), warnings.catch_warnings():
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
    except AssertionError as error:
        return f"a wrong answer: {str(error)[:300]}"
    return ""


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """An alarm, and a bound on memory by which a larger allocation fails."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (_data() + MOST_MEMORY, before[1]))
    old = signal.signal(signal.SIGALRM, _raise)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _raise(*_: object) -> None:
    raise TooSlow


def _data() -> int:
    """Bytes of private memory of this process."""
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    told: Mapping[str, str] = dict(line.split(":", 1) for line in lines if ":" in line)
    return 1024 * int(told["VmData"].split()[0])

"""Results in parts: a folder of files, each written whole by some process, and a list of all that belong to it."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from typing import Any, NamedTuple

from jaxgeo._parallel import Work, version
from jaxgeo._partial import partial_file

MANIFEST = "_manifest.json"  # readers of datasets leave out names with an underscore
FORMAT = 1


class Run(NamedTuple):
    """Result of a run: the folder, its parts, how many of these were computed now, and the count of each status by
    name of the rows or cells computed now."""

    folder: pathlib.Path
    parts: tuple[str, ...]
    computed: int
    counts: dict[str, int]


class PartsFailed(RuntimeError):
    """Parts that could not be computed: `failed` maps their files to the reason. The others are in the folder."""

    def __init__(self, folder: pathlib.Path, failed: Mapping[str, str], total: int) -> None:
        name, reason = next(iter(failed.items()))
        super().__init__(
            f"{folder}: {len(failed)} of {total} parts failed; the first, {name}: {reason} The others are whole; the "
            f"same call computes the missing ones."
        )
        self.folder, self.failed, self.total = folder, dict(failed), total


class Parts(NamedTuple):
    """A folder of parts: the kind of its content, what its results depend on by name, and the name of each file."""

    folder: pathlib.Path
    kind: str
    identity: Mapping[str, str]
    names: tuple[str, ...]

    def open(self, is_whole: Callable[[pathlib.Path], bool] = pathlib.Path.exists) -> list[str]:
        """Make the folder, or check that it holds parts of the same results; returns the names of missing parts.

        `is_whole` tells whether the file of a part is whole.

        Raises `ValueError` for a folder with something else; `OSError` if it cannot be written.
        """
        path = self.folder / MANIFEST
        if path.exists():
            self._check(path)
        elif self.folder.exists() and (not self.folder.is_dir() or any(map(_is_foreign, self.folder.iterdir()))):
            raise ValueError(f"{self.folder}: it exists, and is no folder of parts; give another one.")
        else:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._begin(path)
        return [name for name in self.names if not is_whole(self.folder / name)]

    def _begin(self, path: pathlib.Path) -> None:
        """Write the first list, unless another run was faster, which must be of the same results."""
        with partial_file(path) as partial:
            partial.write_text(self._content({}), encoding="utf-8")
            try:
                os.link(partial, path)
            except FileExistsError:
                self._check(path)
            except OSError:  # a file system without links
                os.replace(partial, path)

    def _check(self, path: pathlib.Path) -> None:
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            kind, identity, names = found["kind"], dict(found["identity"]), [one["file"] for one in found["parts"]]
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: this is no list of parts ({error!r}); give another folder.") from error
        if kind != self.kind:
            raise ValueError(f"{self.folder}: it holds {kind}, not {self.kind}; give another folder.")
        own = self._identity()
        others = [name for name in {**identity, **own} if identity.get(name) != own.get(name)]
        if others or names != list(self.names):
            raise ValueError(
                f"{self.folder}: it holds results with other {', '.join(others) or 'parts'}. Give another folder, or "
                f"remove this one."
            )

    def _identity(self) -> dict[str, str]:
        return {**self.identity, "version of jaxgeo": version()}

    def _write(self, failed: Mapping[str, str]) -> None:
        path = self.folder / MANIFEST
        with partial_file(path) as partial:
            partial.write_text(self._content(failed), encoding="utf-8")
            os.replace(partial, path)

    def _content(self, failed: Mapping[str, str]) -> str:
        """The list: for each part whether it is whole, and why not."""
        parts = [
            {
                "file": name,
                "whole": (self.folder / name).exists(),
                **({"failed": failed[name]} if name in failed else {}),
            }
            for name in self.names
        ]
        content = {"format": FORMAT, "kind": self.kind, "identity": self._identity(), "parts": parts}
        return json.dumps(content, indent=1, ensure_ascii=False)

    def _error_of(self, future: Future[Any]) -> BaseException | None:
        try:
            return future.exception()
        except CancelledError:
            whole = sum((self.folder / name).exists() for name in self.names)
            raise ConnectionError(
                f"{self.folder}: the cluster has ended; {whole} of {len(self.names)} parts are whole. The same call "
                f"computes the missing ones."
            ) from None

    def compute(
        self,
        missing: Mapping[str, Any],
        work: Work,
        executor: Any,
        progress: bool,
        finish: Callable[[Sequence[str]], object],
        count_of: Callable[[Any], int] = lambda _: 1,
    ) -> Run:
        """Compute missing parts: `missing` has the input of each by its name, and `work` returns its counts.

        `finish` is called with the names of all parts when all are whole. Raises `PartsFailed` after all others are
        computed, `ConnectionError` if the cluster ends.
        """
        counts: Counter[str] = Counter()
        failed: dict[str, str] = {}
        total = sum(map(count_of, missing.values()))
        with progress_bar(progress, total) as advance:
            try:
                for (name, given), future in work.results(missing.items(), executor):
                    error = self._error_of(future)
                    if error is None:
                        counts.update(future.result())
                    else:
                        failed[name] = reason_of(error)
                    advance(count_of(given), len(failed))
            finally:
                with contextlib.suppress(OSError):  # a full disk; a part is whole if its file is there
                    self._write(failed)
        if failed:
            raise PartsFailed(self.folder, failed, len(self.names))
        finish(self.names)
        return Run(self.folder, self.names, len(missing), dict(counts))


def _is_foreign(path: pathlib.Path) -> bool:
    """Whether a file is not one that a killed process left behind."""
    return not path.name.startswith(".jaxgeo-")


def reason_of(error: BaseException) -> str:
    """Kind and message of an exception, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".") + "."


class progress_bar:
    """A progress bar with rate, failures and the time left, if asked for; `advance(count, failed)`."""

    def __init__(self, is_shown: bool, total: int) -> None:
        self._progress: Any = None
        if is_shown:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            more = TextColumn("{task.fields[rate]}{task.fields[failed]}")
            self._progress = Progress(*columns, more, console=Console(stderr=True))
            self._task = self._progress.add_task("computing", total=total, rate="", failed="")

    def __enter__(self) -> Callable[[int, int], None]:
        if self._progress is not None:
            self._progress.start()
        return self._advance

    def _advance(self, count: int, failed: int) -> None:
        if self._progress is None:
            return
        speed = self._progress.tasks[0].speed
        rate = "" if speed is None else f"{speed:.0f}/s"
        told = f", {failed} parts failed" if failed else ""
        self._progress.update(self._task, advance=count, rate=rate, failed=told)

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()


def named(prefix: str, count: int, suffix: str) -> tuple[str, ...]:
    """File names of parts, in order."""
    digits = max(5, len(str(count)))
    return tuple(f"{prefix}{number:0{digits}d}{suffix}" for number in range(count))

"""How the command `jaxgeo` ends when a signal stops it: at once or in order, in one line, with nothing partial left.

The package imports this module before JAX, and it imports little itself, so that signals are handled from the start.
A program that imports jaxgeo keeps its own handlers: only the command installs these.

A Python handler runs only between two steps of the main thread, which may compile or read for minutes. A second thread
therefore waits for the signal, and ends the process if the main thread has not done so.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

GRACE = 1.0  # s that the main thread has for an orderly end
WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
EXIT_CODE = 128  # and the number of the signal, as shells count: 130 after Ctrl-C
CLEARED = b"\r\x1b[2K\x1b[?25h"  # a terminal without the spinner, and with its cursor


class _State:
    """What has happened so far. One signal is reported, and unwinds the main thread, once."""

    def __init__(self) -> None:
        self.is_heeding = False
        self.is_orderly = False
        self.is_raised = False
        self.number: int | None = None  # of the signal
        self.untold = [True]  # taken out by the thread that tells: popping is atomic
        self.is_told = False
        self.undo: dict[object, Callable[[], None]] = {}


_state = _State()


def heed() -> None:
    """Handle SIGINT, SIGTERM and SIGHUP from now on, but for those that the caller has the process ignore (nohup)."""
    if _state.is_heeding or threading.current_thread() is not threading.main_thread():
        return
    _state.is_heeding = True
    known = [getattr(signal, name) for name in WORDS if hasattr(signal, name)]
    wanted = [number for number in known if signal.getsignal(number) is not signal.SIG_IGN]
    read, write = os.pipe()
    if hasattr(os, "set_blocking"):
        os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(read, set(wanted)), daemon=True).start()
    for number in wanted:
        signal.signal(number, _handle)


def run(command: Callable[[], Any]) -> NoReturn:
    """Run the command in the main thread, and end the process with its exit code.

    While it runs, a signal raises `KeyboardInterrupt` once, so that files are removed and put back in order. Before and
    after, the process just ends.
    """
    heed()
    code: Any = 0
    try:
        try:
            _state.is_orderly = True
            command()
        finally:
            _state.is_orderly = False
    except SystemExit as end:
        code = end.code
    except BaseException:  # of which the signal may be the cause by way of a callback
        if _state.number is None:
            raise
    _leave(code if _state.number is None else EXIT_CODE + _state.number)


@contextlib.contextmanager
def undone_if_stopped(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` if the process is ended from within this block while the main thread cannot do so.

    It runs in another thread, or in a signal handler, and may be called when there is nothing to undo any more.
    """
    key = object()
    _state.undo[key] = undo
    try:
        yield
    finally:
        _state.undo.pop(key, None)


def _handle(number: int, _: Any) -> None:
    """The handler proper, in the main thread."""
    _tell(number)
    if _state.is_orderly and not _state.is_raised:  # a second signal ends the process at once
        _state.is_raised = True
        raise KeyboardInterrupt
    _end()


def _watch(read: int, wanted: set[int]) -> None:
    number = next(number for (number,) in iter(lambda: os.read(read, 1), b"") if number in wanted)
    _tell(number)
    if _state.is_orderly:
        time.sleep(GRACE)
    _end()


def _tell(number: int) -> None:
    """Say once, in one line, what happened; whatever else goes to stderr afterwards is dropped.

    Callbacks of the compiler print the traceback of a `KeyboardInterrupt` that is raised in them, for example.
    """
    _state.number = _state.number or number
    try:
        _state.untold.pop()
    except IndexError:
        deadline = time.monotonic() + 0.5  # s, for the other thread to write the line
        while not _state.is_told and time.monotonic() < deadline:
            time.sleep(0.001)
        return
    with contextlib.suppress(OSError, ValueError):
        stream = os.dup(2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        line = f"jaxgeo: {WORDS[signal.Signals(number).name]}\n".encode()
        if _takes_a_line(stream):
            os.write(stream, CLEARED + line if os.isatty(stream) else line)
    _state.is_told = True


def _takes_a_line(stream: int) -> bool:
    """Whether writing to it does not wait for a reader."""
    if not hasattr(select, "poll"):
        return True
    poll = select.poll()
    poll.register(stream, select.POLLOUT)
    return bool(poll.poll(100))  # ms


def _end() -> NoReturn:
    """End the process without unwinding."""
    for undo in reversed(list(_state.undo.values())):
        with contextlib.suppress(Exception):
            undo()
    os._exit(EXIT_CODE + (_state.number or signal.SIGINT))


def _leave(code: Any) -> NoReturn:
    """End the process without taking the interpreter apart.

    That takes up to a second with JAX loaded, in which Python handles no signals; and threads of XLA that are still
    compiling after a signal would crash.
    """
    if not isinstance(code, int | None):
        sys.exit(code)
    if _state.number is None:
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code or 0)

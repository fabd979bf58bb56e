"""Signal handling of the command `jaxgeo`: exit on SIGINT, SIGTERM or SIGHUP with one line and no partial files.

The package imports this module before JAX, and it imports little itself, so that signals are handled from the start.
Only the command installs these handlers; a program that imports jaxgeo keeps its own.

Python runs a handler only between two bytecode steps of the main thread, which may compile or read for minutes. A
second thread therefore waits for the signal and ends the process if the main thread does not.
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

GRACE = 1.0  # s allowed to the main thread for an orderly exit
WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
EXIT_CODE = 128  # plus the signal number, the shell convention: 130 after Ctrl-C
CLEARED = b"\r\x1b[2K\x1b[?25h"  # erase the spinner, show the cursor


class _State:
    """State of signal handling. One signal is reported and unwinds the main thread, once."""

    def __init__(self) -> None:
        self.is_heeding = False
        self.is_orderly = False
        self.is_raised = False
        self.number: int | None = None  # signal number
        self.untold = [True]  # popped by the thread that reports: pop is atomic
        self.is_told = False
        self.undo: dict[object, Callable[[], None]] = {}


_state = _State()


def heed() -> None:
    """Install handlers for SIGINT, SIGTERM and SIGHUP, except those that the parent process ignores (nohup)."""
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

    While it runs, a signal raises `KeyboardInterrupt` once, so that files are removed or restored. Before and after, a
    signal ends the process at once.
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
    except BaseException:  # possibly caused by the signal, through a callback
        if _state.number is None:
            raise
    _leave(code if _state.number is None else EXIT_CODE + _state.number)


@contextlib.contextmanager
def undone_if_stopped(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` if the process is ended within this block while the main thread cannot unwind.

    `undo` runs in another thread or in a signal handler, and may be called when there is nothing left to undo.
    """
    key = object()
    _state.undo[key] = undo
    try:
        yield
    finally:
        _state.undo.pop(key, None)


def _handle(number: int, _: Any) -> None:
    """Signal handler of the main thread."""
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
    """Report the signal once, in one line; later output to stderr is dropped.

    Compiler callbacks, for example, print the traceback of a `KeyboardInterrupt` raised in them.
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
    """Whether a write to the stream does not block."""
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
    """End the process without interpreter shutdown.

    Shutdown takes up to a second with JAX loaded, during which Python handles no signals; XLA threads that are still
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

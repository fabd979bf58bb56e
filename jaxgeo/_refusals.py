"""Distinction of input errors raised by this package from internal errors."""

from __future__ import annotations

import opcode
import types

RAISE = opcode.opmap["RAISE_VARARGS"]  # the statement `raise`


def is_refusal(error: BaseException) -> bool:
    """Whether an exception reports an input error with a message for the caller.

    True for a `ValueError` or `ImportError` from a `raise` statement of this package, and for any `OSError` (a file
    cannot be read or written). A `ValueError` of NumPy or JAX, of `int("x")` or of unpacking is an internal error.
    """
    if isinstance(error, OSError):
        return True
    return isinstance(error, ValueError | ImportError) and _is_raised_here(error.__traceback__)


def _is_raised_here(traceback: types.TracebackType | None) -> bool:
    """Whether a traceback ends at a `raise` statement of this package."""
    if traceback is None:
        return False
    while traceback.tb_next is not None:
        traceback = traceback.tb_next
    module = str(traceback.tb_frame.f_globals.get("__name__", ""))
    is_ours = module.partition(".")[0] == __name__.partition(".")[0]
    return is_ours and traceback.tb_frame.f_code.co_code[traceback.tb_lasti] == RAISE

"""Which exceptions are refusals of a caller's mistake, and which are faults of the program."""

from __future__ import annotations

import opcode
import types

RAISE = opcode.opmap["RAISE_VARARGS"]  # the statement `raise`


def is_refusal(error: BaseException) -> bool:
    """Whether an exception reports a mistake of the caller's in words meant for them.

    That is a `ValueError` or `ImportError` that a `raise` statement of this package raised, and any `OSError`, by which
    the system says that a file cannot be read or written. A `ValueError` of NumPy's or JAX's, of `int("x")` or of an
    unpacking is a fault, wherever it comes from.
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

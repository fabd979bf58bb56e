"""The commands as a whole: wrong flags, Ctrl-C and closed pipes, each reported in one line or not at all."""

from __future__ import annotations

import difflib
import functools
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

import typer
from typer.core import TyperGroup

from jaxgeo._text_numbers import number_in, whole_in
from jaxgeo.cli._common import DONE, INTERRUPTED, MISTAKE, NO_ANSWER, reason_of_system
from jaxgeo.cli._screen import tell

MistakeOfUse: Any = typer.BadParameter.__mro__[1]  # UsageError, wherever typer has it from
WORDS = {"nodata": ("nan",)}  # that stand for numbers, by the option
KINDS = {"integer": "a whole number", "float": "a number", "number": "a number"}  # as typer says, and as we do


class Commands(TyperGroup):
    """Commands whose mistakes of use are reported as all others are, in one line and with exit code 2."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """As that of Typer, numbers of the command being read as those of files are."""
        command = super().get_command(ctx, cmd_name)
        for param in getattr(command, "params", ()):
            if "process_value" not in vars(param):
                param.process_value = functools.partial(_strict, param, param.process_value)
        return command

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """As that of Typer."""
        given: Any = {"args": args, "prog_name": prog_name, "complete_var": complete_var}
        given |= {"windows_expand_args": windows_expand_args, "standalone_mode": False}
        if not standalone_mode:
            return super().main(**given, **extra)
        try:
            code = super().main(**given, **extra)
            _flush_stdout(is_told=code == MISTAKE)
        except MistakeOfUse as error:
            if type(error).__name__ != "NoArgsIsHelpError":  # what it has to say is on the screen
                tell(in_a_line(error))
            code = MISTAKE
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except BrokenPipeError:
            _close_stdout()
            code = NO_ANSWER
        except OSError as error:  # of help, and of what was left to be written
            reason = reason_of_system(error)
            if not reason:
                raise
            _close_stdout()
            tell(reason)
            code = MISTAKE
        if code == INTERRUPTED:
            tell("interrupted")
        sys.exit(code if isinstance(code, int) else DONE)


def _flush_stdout(is_told: bool) -> None:
    """Write what is left; if that cannot be done, say so, unless it `is_told` already."""
    try:
        print(end="", flush=True)  # of no effect where stdout was closed
    except OSError:
        if not is_told:
            raise
        _close_stdout()


def _close_stdout() -> None:
    """What is left to be written goes nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _strict(param: Any, convert: Callable[[Any, Any], Any], ctx: Any, value: Any) -> Any:
    """A value of the command line as Typer converts it; numbers must be written as those in files (`number_in`)."""
    found = convert(ctx, value)
    typed, numbers = (one if isinstance(one, list | tuple) else [one] for one in (value, found))
    for text, number in zip(typed, numbers, strict=False):
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
        if is_number and isinstance(text, str) and not _is_written_so(param, text, number):
            kind = "float" if isinstance(number, float) else "integer"
            is_long = kind == "integer" and abs(number) >= 2**63
            wrong = f"{text[:60]} is beyond 64 bits." if is_long else f"{text!r} is not a valid {kind}."
            raise typer.BadParameter(wrong, ctx=ctx, param=param)
    return found


def _is_written_so(param: Any, text: str, number: float | int) -> bool:
    if text.strip().lower() in WORDS.get(param.name, ()):
        return True
    return (number_in(text) if isinstance(number, float) else whole_in(text)) == number


def in_a_line(error: Any) -> str:
    """What is wrong with the flags, a suggestion, and where to read more."""
    where = "jaxgeo" if error.ctx is None else error.ctx.command_path
    return f"{_wrong(error)} See {where} --help."


def _wrong(error: Any) -> str:
    kind, param = type(error).__name__, getattr(error, "param", None)
    name = None if param is None else _name(param)
    if kind == "NoSuchOption":
        return f"{error.option_name}: there is no such option{_nearest(error.option_name, _options(error.ctx))}"
    if kind == "MissingParameter" and name is not None:
        return f"{name} is missing: {_meaning(param)}"
    message = " ".join(error.format_message().split())
    if name is not None:
        wrong, choices = _value_and_choices(message)
        if choices:
            return f"{name} {wrong!r}: expected {' or '.join(choices)}{_nearest(wrong, choices)}"
        kind = next((meant for word, meant in KINDS.items() if word in message), None)
        typed = re.search(r"'([^']*)' is not", message)
        if kind is not None:
            return f"{name}{'' if typed is None else f' {typed[1]!r}'}: expected {kind}."
        return f"{name}: {re.sub(r'^Invalid value for [^:]*: ', '', message).rstrip('.')}."
    command = re.match(r"No such command '([^']*)'", message)
    if command is not None:
        names = error.ctx.command.list_commands(error.ctx)
        return f"{command[1]}: there is no such command{_nearest(command[1], names)}"
    surplus = re.match(r"Got unexpected extra argument(?:\(s\)|s)? \((.*)\)", message)
    if surplus is not None:
        return f"{surplus[1]}: nobody asked for this; does an option stand before it that takes one value only?"
    option = re.match(r"Option '?([^' ]*)'? requires an argument", message)
    return f"{option[1]}: its value is missing." if option is not None else f"{message.rstrip('.')}."


def _name(param: Any) -> str:
    """An option as it is typed, an argument as the help calls it."""
    longest = max((one for one in param.opts if one.startswith("-")), key=len, default=None)
    return longest or (param.metavar or param.name or "").upper()


def _meaning(param: Any) -> str:
    text = (getattr(param, "help", None) or "it has to be given").strip()
    return text if text.endswith(".") else f"{text}."


def _options(context: Any) -> list[str]:
    return [] if context is None else [one for param in context.command.params for one in param.opts]


def _value_and_choices(message: str) -> tuple[str, list[str]]:
    """What was typed, and what might have been, of a message about a choice."""
    quoted = re.search(r"'([^']*)' is not one of (.*)\.$", message)
    return ("", []) if quoted is None else (quoted[1], re.findall(r"'([^']*)'", quoted[2]))


def _nearest(typed: str, known: Sequence[str]) -> str:
    """The end of a sentence: what was meant perhaps."""
    by_word = {one.lstrip("-"): one for one in known if len(one) > 2}
    found = [by_word[one] for one in difflib.get_close_matches(typed.lstrip("-"), by_word, n=1)]
    return f"; did you mean {found[0]}?" if found else "."

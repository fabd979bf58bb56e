"""The commands as a whole: wrong flags, Ctrl-C and closed pipes, each told in a line or not at all."""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperGroup

from jaxgeo.cli._common import DONE, INTERRUPTED, MISTAKE, NO_ANSWER
from jaxgeo.cli._screen import tell

MistakeOfUse: Any = typer.BadParameter.__mro__[1]  # UsageError, wherever typer has it from
KINDS = {"integer": "a whole number", "float": "a number", "number": "a number"}  # as typer says, and as we do


class Commands(TyperGroup):
    """Commands whose mistakes of use are told as all others are, in one line and with exit code 2."""

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
            print(end="", flush=True)  # of no effect where stdout was closed
        except MistakeOfUse as error:
            if type(error).__name__ != "NoArgsIsHelpError":  # what it has to say is on the screen
                tell(in_a_line(error))
            code = MISTAKE
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere
            code = NO_ANSWER
        if code == INTERRUPTED:
            tell("interrupted")
        sys.exit(code if isinstance(code, int) else DONE)


def in_a_line(error: Any) -> str:
    """What is wrong with the flags, what was meant perhaps, and where that is told."""
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

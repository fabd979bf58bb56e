"""Command group: one-line reports of usage errors, handling of Ctrl-C and closed pipes."""

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
from jaxgeo.cli._archive_dem import forget
from jaxgeo.cli._assumed import forget_assumed
from jaxgeo.cli._common import DONE, INTERRUPTED, MISTAKE, NO_ANSWER, reason_of_system
from jaxgeo.cli._old_options import with_new_names
from jaxgeo.cli._screen import print_message
from jaxgeo.cli.dem import as_place

MistakeOfUse: Any = typer.BadParameter.__mro__[1]  # UsageError, from typer's own or the installed click
WORDS = {"--nodata": ("nan",)}  # accepted as numbers, by option
KINDS = {"integer": "a whole number", "float": "a number", "number": "a number"}  # typer's word: ours


class Commands(TyperGroup):
    """Command group that reports usage errors like all others: one line, exit code 2."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """As in Typer, but numbers are parsed like those in files."""
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
        """As in Typer."""
        given: Any = {"args": args, "prog_name": prog_name, "complete_var": complete_var}
        given |= {"windows_expand_args": windows_expand_args, "standalone_mode": False}
        if not standalone_mode:
            return super().main(**given, **extra)
        forget()
        forget_assumed()
        words = sys.argv[1:] if args is None else args
        words, renamed = with_new_names(words, _options_of(self, words))
        if not {"--quiet", "-q"} & set(words):
            for one in renamed:
                print_message(one)
        given["args"] = [as_place(word) for word in words] if words[:1] == ["dem"] else words
        try:
            code = super().main(**given, **extra)
            _flush_stdout(is_reported=code == MISTAKE)
        except MistakeOfUse as error:
            if type(error).__name__ != "NoArgsIsHelpError":  # help is already printed
                print_message(in_a_line(error))
            code = MISTAKE
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except BrokenPipeError:
            _close_stdout()
            code = NO_ANSWER
        except OSError as error:  # while writing help or flushing output
            reason = reason_of_system(error)
            if not reason:
                raise
            _close_stdout()
            print_message(reason)
            code = MISTAKE
        if code == INTERRUPTED:
            print_message("interrupted")
        sys.exit(code if isinstance(code, int) else DONE)


def _flush_stdout(is_reported: bool) -> None:
    """Flush stdout; raises `OSError` if that fails, unless an error `is_reported` (reported) already."""
    try:
        print(end="", flush=True)  # no effect if stdout is closed
    except OSError:
        if not is_reported:
            raise
        _close_stdout()


def _close_stdout() -> None:
    """Redirect stdout to the null device, dropping unwritten output."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _strict(param: Any, convert: Callable[[Any, Any], Any], ctx: Any, value: Any) -> Any:
    """A command-line value as converted by Typer; numbers must have the syntax of those in files (`number_in`)."""
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
    if text.strip().lower() in WORDS.get(_name(param), ()):
        return True
    return (number_in(text) if isinstance(number, float) else whole_in(text)) == number


def in_a_line(error: Any) -> str:
    """One-line usage error: the cause, a suggestion, and the help command."""
    where = "jaxgeo" if error.ctx is None else error.ctx.command_path
    return f"{_wrong(error)} See {where} --help."


def _wrong(error: Any) -> str:
    kind, param = type(error).__name__, getattr(error, "param", None)
    name = None if param is None else _name(param)
    if kind == "NoSuchOption":
        return f"{error.option_name}: no such option{_nearest(error.option_name, _options(error.ctx))}"
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
        return f"{command[1]}: no such command{_nearest(command[1], names)}"
    surplus = re.match(r"Got unexpected extra argument(?:\(s\)|s)? \((.*)\)", message)
    if surplus is not None:
        return f"{surplus[1]}: unexpected argument; does the option before it take only one value?"
    option = re.match(r"Option '?([^' ]*)'? requires an argument", message)
    return f"{option[1]}: its value is missing." if option is not None else f"{message.rstrip('.')}."


def _name(param: Any) -> str:
    """An option as typed, an argument by its metavar."""
    first = next((one for one in param.opts if one.startswith("--")), None)
    return first or (param.metavar or param.name or "").upper()


def _meaning(param: Any) -> str:
    text = (getattr(param, "help", None) or "it is required").strip()
    return text if text.endswith(".") else f"{text}."


def _options_of(group: Any, words: Sequence[str]) -> set[str]:
    """The options of the command that a command line names."""
    for word in words:
        command = getattr(group, "commands", {}).get(word)
        if command is None:
            break
        group = command
    return {one for param in getattr(group, "params", ()) for one in param.opts}


def _options(context: Any) -> list[str]:
    return [] if context is None else [one for param in context.command.params for one in param.opts]


def _value_and_choices(message: str) -> tuple[str, list[str]]:
    """(typed value, allowed choices) from an invalid-choice message."""
    quoted = re.search(r"'([^']*)' is not one of (.*)\.$", message)
    return ("", []) if quoted is None else (quoted[1], re.findall(r"'([^']*)'", quoted[2]))


def _nearest(typed: str, known: Sequence[str]) -> str:
    """End of a sentence: the closest known name, or a full stop."""
    by_word = {one.lstrip("-"): one for one in known if len(one) > 2}
    found = [by_word[one] for one in difflib.get_close_matches(typed.lstrip("-"), by_word, n=1)]
    return f"; did you mean {found[0]}?" if found else "."

"""Old names of options, which one more release understands."""

from __future__ import annotations

from collections.abc import Sequence

RENAMED = {"--height-datum": "--camera-datum", "--vertical-datum": "--dem-datum"}
OF_COMMAND = {"point": {"--height-datum": "--target-datum"}}


def with_new_names(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """(the command line with the new names of its options, a sentence for each old one)."""
    names = RENAMED | OF_COMMAND.get(next((word for word in words if not word.startswith("-")), ""), {})
    found, said = [], {}
    end = list(words).index("--") if "--" in words else len(words)
    for number, word in enumerate(words):
        option, equals, value = word.partition("=")
        if number < end and option in names:
            said[option] = f"{option} is now {names[option]}; the old name is understood until version 0.4."
            word = f"{names[option]}{equals}{value}"
        found.append(word)
    return found, list(said.values())

"""Old names of options, which one more release understands."""

from __future__ import annotations

from collections.abc import Collection, Sequence

RENAMED = {"--height-datum": "--camera-datum", "--vertical-datum": "--dem-datum"}
OF_COMMAND = {"point": {"--height-datum": "--target-datum"}}


def with_new_names(words: Sequence[str], known: Collection[str]) -> tuple[list[str], list[str]]:
    """(the command line with the new names of its options, a sentence for each old one).

    `known` are the options of the command; where the new one is not among them, the old one is left as it is.
    """
    names = RENAMED | OF_COMMAND.get(next((word for word in words if not word.startswith("-")), ""), {})
    found, said = [], {}
    end = list(words).index("--") if "--" in words else len(words)
    for number, word in enumerate(words):
        option, equals, value = word.partition("=")
        if number < end and names.get(option) in known:
            said[option] = f"{option} is now {names[option]}; the old name is understood until version 0.4."
            word = f"{names[option]}{equals}{value}"
        found.append(word)
    return found, list(said.values())

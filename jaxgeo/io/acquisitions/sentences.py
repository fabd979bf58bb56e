"""Sentences that many files have in common, each once with the number of files that it holds for."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"\d+(\.\d+)?")


def told_once(each: Sequence[Sequence[str]], noun: str) -> tuple[str, ...]:
    """The sentences of each of several files, without repetition, in the order in which they come first.

    One that does not hold for all files has the number of those for which it does. Of sentences that differ in their
    numbers alone, the first stands for all of them.

    >>> from jaxgeo.io.acquisitions.sentences import told_once
    >>> print(*told_once([["Scaled by 0.5.", "Level."], ["Scaled by 0.25."], []], "file"), sep="\\n")
    Scaled by 0.5. (2 of 3 files, other numbers in some)
    Level. (1 of 3 files)
    """
    groups: dict[str, list[str]] = {}
    for sentences in each:
        for one in dict.fromkeys(sentences):
            groups.setdefault(_NUMBER.sub("0", one), []).append(one)
    told, total = [], len(each)
    for group in groups.values():
        differs = len(set(group)) > 1
        holds = f"{min(len(group), total)} of {total} {noun}s" if differs or len(group) < total else ""
        note = f" ({holds}{', other numbers in some' if differs else ''})" if holds else ""
        told.append(f"{group[0]}{note}")
    return tuple(told)

"""Sentences of readers: what calls for a check, and merging of many files, with the number that each applies to."""

from __future__ import annotations

import re
from collections.abc import Sequence

DOUBT = "Check: "  # begins a sentence on input that contradicts itself; the command line shows it in a line of its own
_NUMBER = re.compile(r"\d+(\.\d+)?")


def heights_are(datum: str | float | None, stated: str = "as given") -> str:
    """Sentence: the datum of the heights, and where it is stated."""
    if datum is None:
        return "Heights are above what the file's map says."
    surface = f"{datum}" if isinstance(datum, str) else f"a surface {datum:g} m above the ellipsoid"
    return f"Heights are above {'the WGS 84 ellipsoid' if datum == 'ellipsoid' else surface}, {stated}."


def merged_sentences(each: Sequence[Sequence[str]], noun: str) -> tuple[str, ...]:
    """The sentences of several files without repetition, in order of first occurrence.

    A sentence that does not apply to all files has the number of those it applies to. Of sentences that differ only in
    their numbers, the first represents all.

    >>> from jaxgeo.io.acquisitions.sentences import merged_sentences
    >>> print(*merged_sentences([["Scaled by 0.5.", "Level."], ["Scaled by 0.25."], []], "file"), sep="\\n")
    Scaled by 0.5. (2 of 3 files, other numbers in some)
    Level. (1 of 3 files)
    """
    groups: dict[str, list[str]] = {}
    for sentences in each:
        for one in dict.fromkeys(sentences):
            groups.setdefault(_NUMBER.sub("0", one), []).append(one)
    merged, total = [], len(each)
    for group in groups.values():
        differs = len(set(group)) > 1
        holds = f"{min(len(group), total)} of {total} {noun}s" if differs or len(group) < total else ""
        note = f" ({holds}{', other numbers in some' if differs else ''})" if holds else ""
        merged.append(f"{group[0]}{note}")
    return tuple(merged)

"""Columns of tables that are not read: a sentence that names them, with the column that a misspelt one may mean."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable

MOST_NAMED = 6
ALIKE = 0.7  # least similarity of a misspelt name


def unread_columns(header: Iterable[str], known: Collection[str], *, read: Collection[str] | None = None) -> list[str]:
    """[a sentence on the columns that are not read], or []; `known` are all names that are, `read` those found (by
    default the known ones)."""
    header, read = list(header), known if read is None else read
    unread = [name for name in header if name.strip() and name not in read]
    if not unread:
        return []
    missing = sorted(set(known) - set(header))
    shown = [f"{name}{_meant(name, missing)}" for name in unread[:MOST_NAMED]]
    more = f" and {len(unread) - MOST_NAMED} more" if len(unread) > MOST_NAMED else ""
    return [f"Columns that are not read: {', '.join(shown)}{more}."]


def _meant(name: str, known: Collection[str]) -> str:
    """The known name that a misspelt one is nearest to, in brackets."""
    close = difflib.get_close_matches(name.lower().strip(), known, n=1, cutoff=ALIKE)
    stem = next((one for one in known if one.rpartition("_")[0] == name.lower().strip()), None)
    meant = stem or (close[0] if close else None)
    return f" (meant as {meant}?)" if meant is not None else ""

"""Assumptions as printed on the terminal, and how much of CE90 comes from assumed standard deviations."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo.cli._screen import print_note

if TYPE_CHECKING:
    from jaxgeo.cli._locate_inputs import LocateInputs
    from jaxgeo.fix import Fix
    from jaxgeo.io import Observations
    from jaxgeo.uncertainty import Accuracy

OF_SIGMA = re.compile(r"\((--[a-z]+-sigma)\)")  # at the end of a sentence: the option that replaces the default
_said: list[str] = []  # sentences of this run, for its JSON object
MOST = 0.5  # share of the horizontal variance from which the assumed standard deviations are said to dominate
LEAST = 0.1  # share from which one of them is named
NAMED = {
    "--position-sigma": "position",
    "--attitude-sigma": "attitude",
    "--gimbal-sigma": "gimbal angles",
    "--focal-sigma": "focal length",
    "--principal-sigma": "principal point",
    "--dem-sigma": "ground height",
}
OF_SOURCE = {
    "Position": "--position-sigma",
    "Attitude": "--attitude-sigma",
    "GimbalAngles": "--gimbal-sigma",
    "TerrainHeight": "--dem-sigma",
}


def forget_assumed() -> None:
    """Begin a new run."""
    _said.clear()


def with_said(assumed: Sequence[str]) -> list[str]:
    """The sentences, and those of this run that are not among them."""
    return [*assumed, *dict.fromkeys(one for one in _said if one not in assumed)]


def print_assumed(sentences: Sequence[str]) -> None:
    """Print assumptions as notes: one for the default standard deviations, with their options, one for each input that
    contradicts itself, one for all others. The JSON object of the run has them too."""
    from jaxgeo.io.acquisitions.sentences import DOUBT

    _said.extend(sentences)
    doubts = [one for one in sentences if one.startswith(DOUBT)]
    sentences = [one for one in sentences if one not in doubts]
    sigmas = [one for one in sentences if OF_SIGMA.search(one) or " sigma: " in one]
    others = [one for one in sentences if one not in sigmas]
    if others:
        print_note(f"assumed: {' '.join(map(_as_sentence, others))}")
    if sigmas:
        print_note(f"assumed: Standard deviations: {'; '.join(map(_as_item, sigmas))}.")
    for one in doubts:
        print_note(one[:1].lower() + one[1:])


def _as_sentence(text: str) -> str:
    return text if text.endswith((".", ")")) else f"{text}."


def _as_item(text: str) -> str:
    """A sentence on a standard deviation as an item of a list: `position 3, 3, 5 m (--position-sigma)`."""
    text = text.replace(". (", " (").replace(" sigma: ", " ", 1).removesuffix(".")
    return text[:1].lower() + text[1:] if not text[:2].isupper() else text


def assumed_shares(inputs: LocateInputs, found: Accuracy | None) -> dict[str, float]:
    """Shares of assumed standard deviations in the horizontal variance of the fix with the median CE, by option,
    largest first; empty if all are stated, or without accuracy."""
    options = _options_assumed(inputs)
    row = _median_row(np.asarray(found.circular)) if options and found is not None else None
    if found is None or row is None:
        return {}
    return _shares(options, inputs.observed, inputs.grounds, found.fix, row)


def assumed_shares_of_files(
    inputs: LocateInputs, files: Sequence[pathlib.Path], probability: float
) -> dict[str, float]:
    """`assumed_shares` of fixes in the GeoParquet files of a run on a cluster, of which that one is located again."""
    from pyarrow import parquet

    from jaxgeo.io.located import locate_observations, terrain_at
    from jaxgeo.io.located_over_files import window_over_files

    options, observed = _options_assumed(inputs), inputs.observed
    if not (options and inputs.has_errors):
        return {}
    column = f"ce{100.0 * probability:.10g}_m".replace(".", "_")
    tables = [parquet.read_table(file, columns=["index", column]) for file in files]
    index, circular = (np.concatenate([np.asarray(one[name], float) for one in tables]) for name in ("index", column))
    order = np.argsort(index, kind="stable")  # rows that are equal are chosen as on one machine
    at = _median_row(circular[order])
    if at is None:
        return {}
    number, place = observed.place(int(index[order[at]]))
    some = observed.part(number, np.array([place]))
    if isinstance(inputs.grounds, Sequence):
        ground = terrain_at(inputs.grounds[number], np.array([place]))
    else:
        ground = window_over_files(some, inputs.grounds)
    fixes = locate_observations(some, [ground])
    return _shares(options, some, [ground], fixes, 0)


def _options_assumed(inputs: LocateInputs) -> set[str]:
    return {option for one in inputs.assumed for option in OF_SIGMA.findall(one)}


def _shares(options: set[str], observed: Observations, grounds: Any, fixes: Fix, row: int) -> dict[str, float]:
    """Shares of options in the horizontal variance of the fix of a row, largest first."""
    from jaxgeo.io.located import horizontal_variances

    sources, variances = horizontal_variances(observed, grounds, fixes, row)
    total = float(variances.sum())
    if not (np.isfinite(total) and total > 0.0):
        return {}
    shares: dict[str, float] = {}
    for option, variance in zip([one for source in sources for one in _options_of(source)], variances, strict=True):
        if option in options:
            shares[option] = shares.get(option, 0.0) + float(variance) / total
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _median_row(circular: np.ndarray) -> int | None:
    """The row of the median of the circular errors (n,); None without one."""
    rows = np.flatnonzero(np.isfinite(circular))
    return int(rows[np.argsort(circular[rows], kind="stable")[len(rows) // 2]]) if rows.size else None


def told_shares(shares: dict[str, float], probability: float, *, count: int = 1) -> str | None:
    """The assumed standard deviations that make most of CE90, as a sentence; None if they make less than half.

    With a `count` of fixes above one, the sentence says which of them the shares are of.
    """
    total = sum(shares.values())
    if total < MOST:
        return None
    named = [(option, share) for option, share in shares.items() if share >= LEAST] or list(shares.items())[:1]
    texts = [f"{NAMED[option]} {100.0 * share:.0f} % ({option})" for option, share in named]
    name = f"CE{100.0 * probability:.10g}"
    where = f", of the fix with the median {name}" if count > 1 else ""
    return (
        f"{name} comes mostly from assumed standard deviations: {100.0 * total:.0f} % of the horizontal "
        f"variance{where}: {', '.join(texts)}. Give your own with these options."
    )


def _options_of(source: Any) -> list[str]:
    """The option of each axis of a source, empty if there is none."""
    kind = type(source).__name__
    if kind == "InteriorOrientation":
        return ["--focal-sigma" if axis.startswith("focal") else "--principal-sigma" for axis in source.axes]
    return [OF_SOURCE.get(kind, "")] * len(source.axes)

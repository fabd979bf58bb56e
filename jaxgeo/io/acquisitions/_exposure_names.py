"""Unique exposure names across files: records that have only a number get the name of their file."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from jaxgeo.io.acquisitions.record import Acquisition


def with_file_names(found: Sequence[Acquisition], elsewhere: Collection[str] = ()) -> list[Acquisition]:
    """Acquisitions of several files with exposure names that identify the file.

    Records that have only a number, such as telemetry packets, are named FILE/NUMBER by the name of their file,
    regardless of the other files. Others, such as images, keep their names. Files that share a name
    are named by their path instead; `elsewhere` are names of files that are not here.
    """
    named = [dataclasses.replace(one, names=_with_file(one, os.path.basename(one.path))) for one in found]
    files_with = Counter(name for one in named for name in set(one.names.tolist()))
    return [
        dataclasses.replace(new, names=_by_path(old))
        if any(files_with[name] > 1 for name in new.names.tolist()) or os.path.basename(old.path) in elsewhere
        else new
        for old, new in zip(found, named, strict=True)
    ]


def number_in_file(name: str, file: str | os.PathLike[str]) -> str | None:
    """The number in a FILE/NUMBER name, by the name or the path of its file; None for other names."""
    folder, _, number = name.rpartition("/")
    return number if number.isdecimal() and folder in (os.fspath(file), os.path.basename(file)) else None


def _with_file(one: Acquisition, file: str) -> np.ndarray:
    names = one.names.tolist()
    return np.array([f"{file}/{name}" for name in names]) if all(map(str.isdecimal, names)) else one.names


def _by_path(one: Acquisition) -> np.ndarray:
    """Names of a file's exposures by its path; an exposure named like the file gets the path itself."""
    path = pathlib.Path(one.path)
    if one.names.tolist() in ([path.name], [path.stem]):
        return np.array([one.path])
    return np.array([f"{one.path}/{name}" for name in one.names])

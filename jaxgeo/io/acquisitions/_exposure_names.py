"""Names of the exposures of several files: distinct, and with the file of records that have a number alone."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections import Counter
from collections.abc import Sequence

import numpy as np

from jaxgeo.io.acquisitions.record import Acquisition


def with_file_names(found: Sequence[Acquisition]) -> list[Acquisition]:
    """Acquisitions of several files whose exposures are named so that the file of each is known.

    Records that have a number alone, such as packets of telemetry, are called FILE/NUMBER by the name of their file,
    whatever the other files are. The others keep their names, as those of images. Files that have a name in common
    with another one are named by their path instead.
    """
    named = [dataclasses.replace(one, names=_with_file(one, os.path.basename(one.path))) for one in found]
    files_with = Counter(name for one in named for name in set(one.names.tolist()))
    return [
        dataclasses.replace(new, names=_by_path(old))
        if any(files_with[name] > 1 for name in new.names.tolist())
        else new
        for old, new in zip(found, named, strict=True)
    ]


def number_in_file(name: str, file: str | os.PathLike[str]) -> str | None:
    """The number of a record that is called FILE/NUMBER, by the name or the path of its file; None for other names."""
    folder, _, number = name.rpartition("/")
    return number if number.isdecimal() and folder in (os.fspath(file), os.path.basename(file)) else None


def _with_file(one: Acquisition, file: str) -> np.ndarray:
    names = one.names.tolist()
    return np.array([f"{file}/{name}" for name in names]) if all(map(str.isdecimal, names)) else one.names


def _by_path(one: Acquisition) -> np.ndarray:
    """Names of a file's exposures by its path; an exposure that is called as the file is the path itself."""
    path = pathlib.Path(one.path)
    if one.names.tolist() in ([path.name], [path.stem]):
        return np.array([one.path])
    return np.array([f"{one.path}/{name}" for name in one.names])

"""Results of matching kept in a folder, so that a stopped run goes on where it was."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib
import zipfile
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo._partial import partial_file
from jaxgeo.ties.ground import Planes
from jaxgeo.ties.matching import Matching, PairMatches
from jaxgeo.ties.views import Views

VERSION = 2  # of what matching does with equal inputs; raise it with every change of its results
UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


class KeptMatches:
    """Interest points of images and matches of pairs in a folder, by a digest of all they depend on.

    `stamp(row)` is a text that changes with the pixels of an image, such as its path, size and time of change. Files
    are written whole; a damaged one counts as missing. `reused` is the number of pairs that were read.
    """

    def __init__(self, folder: str | os.PathLike[str], stamp: Callable[[int], str]) -> None:
        self.folder, self.reused = pathlib.Path(folder), 0
        self._stamp = stamp

    def points(
        self,
        views: Views,
        row: int,
        count: int,
        find: Callable[[], tuple[np.ndarray, np.ndarray]],
        features: str = "",
    ) -> tuple[np.ndarray, np.ndarray]:
        """(pixels (n, 2), cells (n,)) of the interest points of an image: kept ones, or as `find` has them. `features`
        is a text that changes with what finds them."""
        camera = views.camera_of(row)
        path = self._path("points", [self._stamp(row), camera.width, camera.height, count, features])
        held = _read(path)
        if held is None:
            uv, cells = find()
            self._write(path, {"uv": uv, "cells": cells})
            return uv, cells
        return held["uv"], held["cells"]

    def matches(
        self,
        views: Views,
        both: tuple[int, int],
        uv: np.ndarray,
        planes: Planes,
        how: Matching,
        find: Callable[[], PairMatches],
        features: str = "",
    ) -> PairMatches:
        """Matches of a pair: kept ones, or as `find` has them. `features` is a text that changes with how."""
        parts: list[Any] = [repr(how), features, uv, *planes, views.covariance_of_pair(*both)]
        for row in both:
            parts += [self._stamp(row), views.centre[row], views.R_frame_from_camera[row]]
            parts += [repr(jax.tree.structure(views.camera_of(row))), *jax.tree.leaves(views.camera_of(row))]
        path = self._path("pair", parts)
        held = _read(path)
        if held is not None and set(PairMatches._fields[2:]) <= set(held):
            self.reused += 1
            values: dict[str, Any] = {name: held[name] for name in PairMatches._fields[2:]}
            values["false_alarms"] = float(values["false_alarms"])
            return PairMatches(*both, **values)
        found = find()
        self._write(path, {name: np.asarray(getattr(found, name)) for name in PairMatches._fields[2:]})
        return found

    def _path(self, kind: str, parts: Sequence[Any]) -> pathlib.Path:
        digest = hashlib.sha256(f"{VERSION} {kind}".encode())
        for part in parts:
            if not isinstance(part, str):
                value = np.ascontiguousarray(part)
                digest.update(f"{value.dtype} {value.shape}".encode())
                part = value.tobytes()
            digest.update(part.encode() if isinstance(part, str) else part)
        return self.folder / f"{kind}-{digest.hexdigest()[:32]}.npz"

    def _write(self, path: pathlib.Path, arrays: dict[str, np.ndarray]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        with partial_file(path) as beside:
            with beside.open("wb") as stream:
                np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]
            beside.replace(path)


def _read(path: pathlib.Path) -> dict[str, np.ndarray] | None:
    """The arrays of a file; None if it is missing or damaged."""
    with contextlib.suppress(*UNREADABLE), path.open("rb") as stream, np.load(stream) as held:
        return {name: held[name] for name in held.files}
    return None

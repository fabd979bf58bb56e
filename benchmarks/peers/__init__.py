"""Other ray/terrain intersectors behind one interface, each in its own file and its own best frame."""

from __future__ import annotations

import abc
import importlib
import importlib.metadata
from dataclasses import dataclass

import numpy as np
from support.fractal import Sight, TangentTerrain

FILES = {
    "jaxgeo": ("ours", "Jaxgeo"),
    "shareloc": ("shareloc", "SharelocCurved"),
    "shareloc-chord": ("shareloc", "SharelocChord"),
    "embreex": ("embree", "Embreex"),
    "open3d": ("open3d", "Open3D"),
    "numba": ("numba_walk", "NumbaWalk"),
    "numba-ecef": ("numba_walk", "NumbaWalkFromEcef"),
}


@dataclass(frozen=True)
class Facts:
    """Facts needed to compare a peer.

    `package` is the distribution whose version is printed, `input` the argument of the timed call, `frame` its working
    frame, `precision` of its arithmetic, `surface` the intersected surface (`bilinear`, `chords` or `triangles`) and
    `threads` the number it can use in one call.
    """

    package: str
    input: str
    frame: str
    precision: str
    surface: str
    threads: str
    notes: str = ""


class Peer(abc.ABC):
    """One intersector: prepare a terrain, load rays in its own form, and time only `run`."""

    facts: Facts

    @abc.abstractmethod
    def prepare(self, terrain: TangentTerrain) -> None:
        """One-time setup for a terrain."""

    @abc.abstractmethod
    def load(self, sight: Sight) -> None:
        """Convert rays to the input of `run`; not timed."""

    @abc.abstractmethod
    def run(self) -> object:
        """Intersect the loaded rays; complete on return."""

    @abc.abstractmethod
    def ranges(self, answer: object) -> np.ndarray:
        """Ranges in m along the rays from an answer of `run`, NaN for misses; not timed."""

    def own_surface(self) -> np.ndarray | None:
        """Exact ranges of the loaded rays to the peer's own surface if it is not the bilinear one."""
        return None

    def version(self) -> str:
        """Version of the underlying package."""
        try:
            return importlib.metadata.version(self.facts.package)
        except importlib.metadata.PackageNotFoundError:
            return "this tree"


def make(name: str) -> Peer:
    """The peer of that name. Raises `ImportError` or `OSError` if its requirements are missing."""
    module, kind = FILES[name]
    return getattr(importlib.import_module(f"peers.{module}"), kind)()


def cell_tops(posts: np.ndarray) -> np.ndarray:
    """Highest post of every cell in float32, rounded up."""
    tops = np.maximum(posts[:-1], posts[1:])
    tops = np.maximum(tops[:, :-1], tops[:, 1:])
    return np.nextafter(tops.astype(np.float32), np.float32(np.inf))


def along(sight: Sight, p_ecef: np.ndarray) -> np.ndarray:
    """Ranges in m of the points on the rays nearest to ECEF points (n, 3)."""
    return np.sum((p_ecef - sight.origin) * sight.direction, axis=-1)


def mesh_of(terrain: TangentTerrain) -> tuple[np.ndarray, np.ndarray]:
    """Posts in east, north, up of the terrain's centre, (rows, cols, 3) float32, and two triangles per cell (n, 3)."""
    rows, cols = terrain.posts.shape
    rowcol = np.stack(np.meshgrid(np.arange(rows, dtype=float), np.arange(cols, dtype=float), indexing="ij"), axis=-1)
    vertices = to_enu(terrain, terrain.position(rowcol, terrain.posts)).astype(np.float32)
    first = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)[None, :]).ravel()
    lower = np.stack([first, first + cols, first + cols + 1], axis=-1)
    upper = np.stack([first, first + cols + 1, first + 1], axis=-1)
    return vertices, np.concatenate([lower, upper]).astype(np.int32)


def to_enu(terrain: TangentTerrain, p_ecef: np.ndarray) -> np.ndarray:
    """East, north, up in m from the ellipsoid point below the terrain's centre."""
    return (p_ecef - terrain.position(terrain.middle, np.array(0.0))) @ terrain.axes.T

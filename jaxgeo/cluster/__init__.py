"""Many frames and large maps on the workers of a Dask cluster, or of any executor; results in parts, and resumable."""

from __future__ import annotations

from jaxgeo.cluster.accuracy_tiles import accuracy_map
from jaxgeo.cluster.catalogue import statuses_of
from jaxgeo.cluster.client import connect, prepare
from jaxgeo.cluster.datasets import locate_dataset
from jaxgeo.cluster.frames import fixes_of_frames, locate_frames
from jaxgeo.cluster.orthophotos import rectify_frames
from jaxgeo.cluster.parts import PartsFailed, Run

__all__ = [
    "PartsFailed",
    "Run",
    "accuracy_map",
    "connect",
    "fixes_of_frames",
    "locate_dataset",
    "locate_frames",
    "prepare",
    "rectify_frames",
    "statuses_of",
]

"""Setting up of Dask workers; imported where `distributed` is known to be installed."""

from __future__ import annotations

from typing import Any

import jax
from distributed import WorkerPlugin

from jaxgeo._program_cache import keep_programs


class WorkerSetup(WorkerPlugin):
    """64-bit floats as in the client's process, and kept programs."""

    def __init__(self, is_x64: bool) -> None:
        self.is_x64 = is_x64

    def setup(self, worker: Any) -> None:
        """Called in each worker, those that join later too."""
        jax.config.update("jax_enable_x64", self.is_x64)
        keep_programs()

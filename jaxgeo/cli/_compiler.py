"""Fast-compile XLA flags and the persistent compilation cache."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import os
import pathlib
import subprocess
import sys

from jaxgeo._program_cache import cache_folder, keep_programs
from jaxgeo.cli._screen import working

LITTLE = "--xla_backend_optimization_level=1"  # not 0, which with the older emitter may be wrong: see `quick_options`
OLDER_EMITTER = "--xla_cpu_use_fusion_emitters=false"
TRIED = frozenset({"0.10.0", "0.10.1", "0.10.2"})  # versions of jaxlib that have both flags


def compile_quickly(samples_of_field: bool = False) -> None:
    """Compile in less time at the cost of run time, and cache the programs for later commands.

    Call it before the first computation. Sampling a correlated height field with XLA's older, faster emitter takes more
    memory than a machine has, so it uses the default one. A version of XLA without these flags would abort, so a
    subprocess tries them first, once per version that is not among `TRIED`. JAX compile settings in the environment are
    left unchanged.
    """
    folder = cache_folder()
    flags = LITTLE if samples_of_field else f"{LITTLE} {OLDER_EMITTER}"
    if "XLA_FLAGS" not in os.environ and _knows(flags, folder):
        os.environ["XLA_FLAGS"] = flags
    if folder is not None and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        keep_programs()


def _knows(flags: str, folder: pathlib.Path | None) -> bool:
    """Whether XLA accepts the flags; tried once and noted in the cache folder, if there is one."""
    if importlib.metadata.version("jaxlib") in TRIED:
        return True
    note = None if folder is None else folder / f"knows-{hashlib.sha256(flags.encode()).hexdigest()[:8]}"
    if note is not None and note.exists():
        return True
    environment = {**os.environ, "XLA_FLAGS": flags}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    with working("starting"):
        trial = subprocess.run(probe, env=environment, capture_output=True, check=False)
    if trial.returncode != 0:
        return False
    if note is not None:
        with contextlib.suppress(OSError):
            note.touch()
    return True

"""Fast-compile XLA flags and the persistent compilation cache."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import os
import pathlib
import platform
import subprocess
import sys
import warnings

from jaxgeo.cli._screen import working

UNOPTIMISED = "--xla_backend_optimization_level=0"
OLDER_EMITTER = "--xla_cpu_use_fusion_emitters=false"
QUICK_TO_COMPILE = f"{UNOPTIMISED} {OLDER_EMITTER}"
QUICK_TO_RUN = f"--xla_backend_optimization_level=1 {OLDER_EMITTER}"
FOLDER = "JAXGEO_CACHE_DIR"  # of the environment; empty: nothing is kept
LARGEST = 500_000_000  # bytes of programs that are kept; the oldest go first
EVEN_SHORT_ONES = 0.0  # s of compiling from which on a program is kept


def compile_quickly(samples_of_field: bool = False, *, runs_long: bool = False) -> None:
    """Have XLA compile in half the time what is computed only a few times, and keep it for the next command.

    Before anything is computed. Samples of a field of heights take XLA's older, quicker emitter more memory than a
    machine has: they are compiled by the usual one. A command that `runs_long`, for minutes, gains by programs that
    are optimised a little. A version of XLA that does not know the flags would end the process, so another process
    tries them first, once for each version. An environment that says how JAX is to compile is left as it is.
    """
    folder, flags = cache_folder(), UNOPTIMISED if samples_of_field else QUICK_TO_COMPILE
    flags = QUICK_TO_RUN if runs_long else flags
    if "XLA_FLAGS" not in os.environ and _knows(flags, folder):
        os.environ["XLA_FLAGS"] = flags
    if folder is not None and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        _keep_programs(folder)


def cache_folder() -> pathlib.Path | None:
    """Where programs of this machine and these versions are kept; None if they are not to be, or cannot be."""
    asked = os.environ.get(FOLDER)
    if asked == "":
        return None
    import platformdirs

    root = pathlib.Path(asked) if asked else pathlib.Path(platformdirs.user_cache_dir("jaxgeo", appauthor=False))
    folder = root / f"jaxlib-{importlib.metadata.version('jaxlib')}-{_processor()}"
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder if os.access(folder, os.W_OK) else None


def _processor() -> str:
    """What a program compiled here needs of a processor, in a short word: homes may be shared by several machines."""
    told = platform.machine() + platform.processor()
    with contextlib.suppress(OSError):
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        told += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return hashlib.sha256(told.encode()).hexdigest()[:12]


def _knows(flags: str, folder: pathlib.Path | None) -> bool:
    """Whether XLA knows the flags; tried once, where that can be noted."""
    note = None if folder is None else folder / f"knows-{hashlib.sha256(flags.encode()).hexdigest()[:8]}"
    if note is not None and note.exists():
        return True
    environment = {**os.environ, "XLA_FLAGS": flags}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    with working("starting"):
        if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode != 0:
            return False
    if note is not None:
        with contextlib.suppress(OSError):
            note.touch()
    return True


def _keep_programs(folder: pathlib.Path) -> None:
    import jax

    if jax.config.values["jax_compilation_cache_dir"] is not None:  # whoever calls the command has chosen
        return
    with contextlib.suppress(OSError):
        _forget_oldest(folder)
    # What cannot be read or kept is compiled.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", EVEN_SHORT_ONES)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def _forget_oldest(folder: pathlib.Path) -> None:
    """Remove what was used least lately, until half of what may be kept is left."""
    files = [(one.stat(), one) for one in folder.iterdir() if one.is_file()]
    total = sum(told.st_size for told, _ in files)
    if total <= LARGEST:
        return
    for told, one in sorted(files, key=lambda pair: max(pair[0].st_mtime, pair[0].st_atime)):
        one.unlink(missing_ok=True)
        total -= told.st_size
        if total <= LARGEST // 2:
            return

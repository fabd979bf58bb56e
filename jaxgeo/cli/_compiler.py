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
FOLDER = "JAXGEO_CACHE_DIR"  # environment variable; empty: no cache
LARGEST = 500_000_000  # bytes in the cache; the oldest programs are removed first
EVEN_SHORT_ONES = 0.0  # s, least compile time of a cached program


def compile_quickly(samples_of_field: bool = False, *, runs_long: bool = False) -> None:
    """Halve compile time at the cost of run time, and cache the programs for later commands.

    Call it before the first computation. Sampling a correlated height field with XLA's older, faster emitter takes more
    memory than a machine has, so it uses the default one. A command that `runs_long` (minutes) gains from lightly
    optimised programs. A version of XLA without these flags would abort, so a subprocess tries them first, once per
    version. JAX compile settings in the environment are left unchanged.
    """
    folder, flags = cache_folder(), UNOPTIMISED if samples_of_field else QUICK_TO_COMPILE
    flags = QUICK_TO_RUN if runs_long else flags
    if "XLA_FLAGS" not in os.environ and _knows(flags, folder):
        os.environ["XLA_FLAGS"] = flags
    if folder is not None and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        _keep_programs(folder)


def cache_folder() -> pathlib.Path | None:
    """Cache folder for this machine and these versions; None if disabled or not writable."""
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
    """Short hash of the processor features: several machines may share a home directory."""
    features = platform.machine() + platform.processor()
    with contextlib.suppress(OSError):
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return hashlib.sha256(features.encode()).hexdigest()[:12]


def _knows(flags: str, folder: pathlib.Path | None) -> bool:
    """Whether XLA accepts the flags; tried once and noted in the cache folder, if there is one."""
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

    if jax.config.values["jax_compilation_cache_dir"] is not None:  # set by the caller
        return
    with contextlib.suppress(OSError):
        _forget_oldest(folder)
    # A program that cannot be read from or written to the cache is compiled.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", EVEN_SHORT_ONES)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def _forget_oldest(folder: pathlib.Path) -> None:
    """Remove the least recently used programs until the cache is at half its limit."""
    files = [(one.stat(), one) for one in folder.iterdir() if one.is_file()]
    total = sum(stat.st_size for stat, _ in files)
    if total <= LARGEST:
        return
    for stat, one in sorted(files, key=lambda pair: max(pair[0].st_mtime, pair[0].st_atime)):
        one.unlink(missing_ok=True)
        total -= stat.st_size
        if total <= LARGEST // 2:
            return

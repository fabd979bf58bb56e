"""The persistent cache of compiled programs: one folder per machine and version, bounded in size."""

from __future__ import annotations

import contextlib
import os
import pathlib
import warnings

FOLDER = "JAXGEO_CACHE_DIR"  # environment variable; empty: no cache
LARGEST = 500_000_000  # bytes in the cache; the oldest programs are removed first
EVEN_SHORT_ONES = 0.0  # s, least compile time of a cached program

_in_use: list[pathlib.Path] = []


def keep_programs(folder: str | os.PathLike[str] | None = None, *, largest: int = LARGEST) -> pathlib.Path | None:
    """Keep compiled programs on disk, so that later processes need not compile them again; returns the folder.

    Call it once, before the first computation. Programs are those of every JAX function of this process; those of
    jaxgeo's own functions are not even traced again, if their arguments are of jaxgeo's classes. `folder` is by default
    that of the environment variable `JAXGEO_CACHE_DIR`, or the user's cache folder, in which each version of jaxlib and
    kind of processor has a folder of its own. Programs beyond `largest` bytes are removed, those unused for longest
    first. Several processes may share a folder: programs are written whole or not at all. A process runs what it reads:
    share a folder only with users whom you trust. A folder set before in JAX (`jax_compilation_cache_dir`) is left as
    it is, and returned. None, and no cache, if the variable is empty or the folder is not writable. Raises `ValueError`
    for a `largest` below 1.

    >>> import os, tempfile
    >>> folder = jaxgeo.keep_programs(tempfile.mkdtemp())  # of your own: jaxgeo.keep_programs()
    >>> folder is None or folder.is_dir()
    True
    """
    if not largest >= 1:
        raise ValueError(f"largest must be a number of bytes, 1 or more; got {largest!r}.")
    import jax

    given = jax.config.values["jax_compilation_cache_dir"]
    if given is not None:  # set by the caller
        return pathlib.Path(given)
    path = cache_folder(folder)
    if path is None:
        return None
    with contextlib.suppress(OSError):
        forget_oldest(path, largest)
    # A program that cannot be read from or written to the cache is compiled.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", EVEN_SHORT_ONES)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    _in_use.append(path)
    return path


def folder_in_use() -> pathlib.Path | None:
    """The folder in which this process keeps programs, if it does."""
    return _in_use[-1] if _in_use else None


def cache_folder(folder: str | os.PathLike[str] | None = None) -> pathlib.Path | None:
    """Cache folder for this machine and these versions; None if disabled or not writable."""
    asked = os.environ.get(FOLDER) if folder is None else folder
    if asked == "":
        return None
    import importlib.metadata

    import platformdirs

    root = pathlib.Path(asked) if asked else pathlib.Path(platformdirs.user_cache_dir("jaxgeo", appauthor=False))
    path = root / f"jaxlib-{importlib.metadata.version('jaxlib')}-{_processor()}"
    with contextlib.suppress(OSError):
        path.mkdir(parents=True, exist_ok=True)
    return path if os.access(path, os.W_OK) else None


def _processor() -> str:
    """Short hash of the processor features: several machines may share a home directory."""
    import hashlib
    import platform

    features = platform.machine() + platform.processor()
    with contextlib.suppress(OSError):
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return hashlib.sha256(features.encode()).hexdigest()[:12]


def forget_oldest(folder: pathlib.Path, largest: int) -> None:
    """Remove the least recently used programs until the cache is at half its limit."""
    files = [(one.stat(), one) for one in folder.iterdir() if one.is_file()]
    total = sum(stat.st_size for stat, _ in files)
    if total <= largest:
        return
    for stat, one in sorted(files, key=lambda pair: max(pair[0].st_mtime, pair[0].st_atime)):
        one.unlink(missing_ok=True)
        total -= stat.st_size
        if total <= largest // 2:
            return

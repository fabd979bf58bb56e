"""Seed of the extra file mutants that a run reads besides those of the fixed seed."""

from __future__ import annotations

import pathlib
import secrets
import zlib

VARIABLE = "JAXGEO_FUZZ_SEED"
SOURCES = ("jaxgeo", "tests/fuzz")
RANDOM = "random"
MOST = 1_000_000


def fuzz_seed(project: pathlib.Path, given: str | None) -> str:
    """The seed in the variable: a number, "random" to draw one; if unset or empty, `seed_of_sources`."""
    if given == RANDOM:
        return str(2 + secrets.randbelow(MOST))
    return given or str(seed_of_sources(project))


def seed_of_sources(project: pathlib.Path) -> int:
    """A checksum (CRC-32) of the Python sources that determine how a mutant is made and read, by name and content.

    It changes with every change of them, and is the same in every run, on every machine, for the same sources.
    """
    found = 0
    files = sorted(
        path.relative_to(project).as_posix() for folder in SOURCES for path in (project / folder).rglob("*.py")
    )
    for name in files:
        found = zlib.crc32((project / name).read_bytes().replace(b"\r\n", b"\n"), zlib.crc32(name.encode(), found))
    return 2 + found % MOST

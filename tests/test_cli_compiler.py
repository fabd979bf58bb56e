"""Options of the compiler that commands take: only those that the installed XLA has."""

from __future__ import annotations

import importlib.metadata
import os
import pathlib
import subprocess
import sys

import pytest

from jaxgeo.cli import _compiler
from jaxgeo.cli._compiler import LITTLE, OLDER_EMITTER, TRIED, compile_quickly

installed = importlib.metadata.version("jaxlib")
STARTS = [sys.executable, "-c", "import jax; jax.devices()"]


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path) -> pytest.MonkeyPatch:
    monkeypatch.setenv("XLA_FLAGS", "")  # what a command sets goes again
    monkeypatch.delenv("XLA_FLAGS")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(_compiler, "cache_folder", lambda: tmp_path)
    return monkeypatch


@pytest.mark.costly
@pytest.mark.skipif(installed not in TRIED, reason=f"jaxlib {installed} is asked before its flags are set")
def test_a_version_that_is_not_asked_has_the_flags() -> None:
    known = {**os.environ, "XLA_FLAGS": f"{LITTLE} {OLDER_EMITTER}"}
    assert subprocess.run(STARTS, env=known, capture_output=True, check=False).returncode == 0
    unknown = {**os.environ, "XLA_FLAGS": "--xla_of_no_version=1"}
    assert subprocess.run(STARTS, env=unknown, capture_output=True, check=False).returncode != 0


@pytest.mark.parametrize("has_them", [True, False])
def test_another_version_is_asked_once(
    environment: pytest.MonkeyPatch, tmp_path: pathlib.Path, *, has_them: bool
) -> None:
    asked: list[str] = []

    def run(command: list[str], env: dict[str, str], **_: object) -> subprocess.CompletedProcess[str]:
        asked.append(env["XLA_FLAGS"])
        return subprocess.CompletedProcess(command, 0 if has_them else 1)

    environment.setattr(_compiler, "TRIED", frozenset())
    environment.setattr(subprocess, "run", run)
    for _ in range(2):
        os.environ.pop("XLA_FLAGS", None)
        compile_quickly()
        assert os.environ.get("XLA_FLAGS") == (f"{LITTLE} {OLDER_EMITTER}" if has_them else None)
    assert asked == [f"{LITTLE} {OLDER_EMITTER}"] * (1 if has_them else 2)


def test_flags_of_the_user_are_kept(environment: pytest.MonkeyPatch) -> None:
    environment.setenv("XLA_FLAGS", "--xla_dump_to=/tmp/nowhere")
    compile_quickly()
    assert os.environ["XLA_FLAGS"] == "--xla_dump_to=/tmp/nowhere"

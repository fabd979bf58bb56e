"""Settings that every test runs under, the folder of real data, and the switch for slow tests."""

from __future__ import annotations

import ctypes
import functools
import gc
import os
import pathlib
import re
import subprocess
import sys
import zlib
from collections.abc import Iterator
from typing import Any

import jax
import pytest
import support.checked_types  # noqa: F401  # named in pyproject.toml, loaded here
from jax._src import compilation_cache
from jax._src.interpreters import mlir
from support.fuzz_seed import VARIABLE, fuzz_seed
from support.quick_to_compile import QUICK_TO_COMPILE

PROJECT = pathlib.Path(__file__).resolve().parents[1]
gc.set_threshold(100_000, 20, 20)  # tracing makes and keeps so many small things that looking for cycles takes its time

# The package itself changes no JAX setting; jaxgeo may not be imported here, before pytest switches its checks on.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
# Compiling is most of the suite's time: what was compiled once, in any process, is not compiled again.
jax.config.update("jax_compilation_cache_dir", str(PROJECT / ".cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
# Places in the source, kept for each operation, are a tenth of compiling.
jax.config.update("jax_include_full_tracebacks_in_locations", False)
jax.config.update("jax_traceback_in_locations_limit", 0)
compilation_cache.compress_executable = functools.partial(zlib.compress, level=1)  # a third of the time
compilation_cache.decompress_executable = zlib.decompress
# Commands in processes of their own load bytecode in place of compiling the package each time.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("JAXGEO_CACHE_DIR", str(PROJECT / ".cache" / "jaxgeo"))  # of commands in processes of their own


# Bytes of a process, of which there may be many.
# From the first on programs are dropped after a file of tests; from the second on after any test, if there are many.
MUCH_RESIDENT, MORE_RESIDENT, MOST_RESIDENT = 1_550_000_000, 1_700_000_000, 1_850_000_000
MANY_PROGRAMS = 500_000_000  # bytes
MARK_OF_FILE = re.compile(r"^pytestmark = (\[\s*)?pytest\.mark\.(?P<mark>costly|slow)\b", re.MULTILINE)
BUDGETS = {"slow": float("inf"), "costly": 5.0}  # s of processor time of one test, with what it compiles, by its mark
BUDGET = 1.5  # of one without such a mark
BEGUN, SPENT = pytest.StashKey[float](), "processor seconds"

make_ir_context = mlir.make_ir_context
one_ir_context = functools.cache(make_ir_context)


def shared_ir_context() -> Any:
    """One MLIR context for all programs but those that are made within another.

    JAX makes one for each program and keeps it: 1.2 MB and 4 ms, most of a small program.
    """
    return one_ir_context() if mlir.ir.Context.current is None else make_ir_context()


mlir.make_ir_context = shared_ir_context


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--costly", action="store_true", help="run the tests marked costly too, as .ci/run does")
    parser.addoption("--slow", action="store_true", help="run all tests, also those marked costly or slow")


def pytest_configure(config: pytest.Config) -> None:
    os.environ[VARIABLE] = fuzz_seed(PROJECT, os.environ.get(VARIABLE))  # workers take it from here
    if "XLA_FLAGS" in os.environ:
        return
    os.environ["XLA_FLAGS"] = QUICK_TO_COMPILE
    probe = subprocess.run([sys.executable, "-c", "import jax; jax.devices()"], capture_output=True, check=False)
    if probe.returncode != 0:  # a version of XLA that does not know them would end the whole process
        del os.environ["XLA_FLAGS"]


def left_out(config: pytest.Config) -> list[str]:
    """Marks of the tests that are not asked for."""
    if config.getoption("--slow"):
        return []
    return ["slow"] if config.getoption("--costly") else ["slow", "costly"]


def pytest_ignore_collect(collection_path: pathlib.Path, config: pytest.Config) -> bool | None:
    """A file all of whose tests are left out is not even imported: that takes seconds in all."""
    if collection_path.suffix != ".py" or not collection_path.name.startswith("test_"):
        return None
    of_file = MARK_OF_FILE.search(collection_path.read_text(encoding="utf-8"))
    return True if of_file and of_file["mark"] in left_out(config) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    marks = left_out(config)
    apart = [item for item in items if any(mark in item.keywords for mark in marks)]
    if apart:  # each test that is skipped has three reports: seconds in all
        config.hook.pytest_deselected(items=apart)
        items[:] = [item for item in items if not any(mark in item.keywords for mark in marks)]


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # modules and tests stay to the end: cycles are not looked for among them again


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    item.stash[BEGUN] = _processor_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    if call.when == "teardown":
        item.user_properties.append((SPENT, _processor_seconds() - item.stash[BEGUN]))
    return (yield)


def _processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def pytest_report_header(config: pytest.Config) -> list[str]:
    without = [f"without tests marked {mark}: they run with --{mark}" for mark in left_out(config)]
    return [*without, f"mutants of files: {VARIABLE}={os.environ[VARIABLE]}"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The tests over their budget of time; how many mutants of files were read in all, and how it went."""
    every = [one for kind in terminalreporter.stats.values() for one in kind if getattr(one, "when", "") == "teardown"]
    spent = [(dict(one.user_properties).get(SPENT, 0.0), one) for one in every]
    over = sorted(((seconds, one.nodeid) for seconds, one in spent if seconds > _budget(one)), reverse=True)
    if over:
        terminalreporter.write_line(
            f"processor time: {sum(seconds for seconds, _ in spent):.0f} s; of it {sum(x for x, _ in over):.0f} s by "
            f"{len(over)} tests of more than {BUDGET} s, or {BUDGETS['costly']} s if costly, with what others use too:"
        )
        for seconds, name in over[:10]:
            terminalreporter.write_line(f"{seconds:6.1f} s {name}")
    reports = [one for kind in ("passed", "failed") for one in terminalreporter.stats.get(kind, [])]
    told = [found for one in reports for name, found in getattr(one, "user_properties", ()) if name == "mutants"]
    if told:
        refused, answered, wrong = (sum(column) for column in list(zip(*told, strict=True))[:3])
        slowest, grown = (max(column) for column in list(zip(*told, strict=True))[3:])
        terminalreporter.write_line(
            f"{refused + answered} mutants of files: {refused} refused, {answered} answers, {wrong} wrong; slowest "
            f"{slowest:.2f} s, memory + {grown / 1e6:.0f} MB; {VARIABLE}={os.environ[VARIABLE]}"
        )


def _budget(report: pytest.TestReport) -> float:
    return next((seconds for mark, seconds in BUDGETS.items() if mark in report.keywords), BUDGET)


@pytest.fixture(scope="session")
def left_resident() -> list[int]:
    """Bytes of the process when programs were dropped last."""
    return [0]


@pytest.fixture(scope="module", autouse=True)
def memory_within_bounds(left_resident: list[int]) -> Iterator[None]:
    """Compiled programs are dropped after a file of tests that leaves the process large; few are called again."""
    yield
    if _stays_above(max(MUCH_RESIDENT, min(left_resident[0] + MANY_PROGRAMS // 2, MORE_RESIDENT))):
        left_resident[0] = _drop_programs()


@pytest.fixture(autouse=True)
def memory_within_limits(left_resident: list[int]) -> Iterator[None]:
    """Compiled programs are dropped after any test that leaves the process very large."""
    yield
    if _stays_above(max(MORE_RESIDENT, min(left_resident[0] + MANY_PROGRAMS, MOST_RESIDENT))):
        left_resident[0] = _drop_programs()


def _stays_above(limit: int) -> bool:
    """Whether this process has more bytes in memory, also after what is free has been returned."""
    if _resident() > limit:
        _return_free_memory()
    return _resident() > limit


def _drop_programs() -> int:
    """Bytes of the process without compiled programs."""
    jax.clear_caches()
    one_ir_context.cache_clear()
    if "jaxgeo._compile" in sys.modules:
        for batches in sys.modules["jaxgeo._compile"].Batches.known:
            batches.clear()
    gc.collect()
    _return_free_memory()
    return _resident()


def _return_free_memory() -> None:
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc keeps what is freed; other libraries do not
        if trim is not None:
            trim(0)


def _resident() -> int:
    """Bytes of this process in memory, where that is told."""
    told = pathlib.Path("/proc/self/statm")
    return int(told.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if told.exists() else 0


@pytest.fixture(scope="session")
def jaxgeo_test_data() -> pathlib.Path:
    """Folder of real data that the project may use but not publish; skips where it is missing."""
    folder = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", PROJECT / ".." / "shared" / "data")).resolve()
    if not folder.is_dir():
        pytest.skip(f"no real data: {folder} does not exist; name another folder in JAXGEO_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def project_root() -> pathlib.Path:
    """Root of the working copy."""
    return PROJECT

"""A command that is stopped ends within 2 s, with its exit code and one line, and leaves nothing partial behind.

Held against what a shell expects of a program: 128 and the number of the signal, no output file that is not whole.
JAXGEO_INTERRUPTIONS=50 in the environment makes as many tries at random moments.
"""

from __future__ import annotations

import os
import pathlib
import random
import signal
import subprocess
import sys
import textwrap

import pytest
from support.drone_image_files import packet, write_image
from support.interrupted import allowed, group, handles_signals, is_running, started, stopped, wait_until
from test_cli_folders import DJI, GROUND

from jaxgeo import _command, _interruption
from jaxgeo._destination import destination
from jaxgeo._partial import hidden_name
from jaxgeo.demo import scene_file

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks up processes as Linux shows them")

TRIES = int(os.environ.get("JAXGEO_INTERRUPTIONS", "10"))
SEED = 20
CODES = {"SIGINT": (130, "interrupted"), "SIGTERM": (143, "terminated"), "SIGHUP": (129, "hung up")}

# The package without JAX, which takes a second to import.
LIGHT = """
    import hashlib, os, pathlib, subprocess, sys, threading, time, types
    package = types.ModuleType("jaxgeo")
    package.__path__ = [{package!r}]
    sys.modules["jaxgeo"] = package
    from jaxgeo._destination import destination
    from jaxgeo._interruption import run, undone_if_stopped

    def busy():
        print("busy", flush=True)

    def in_c():
        busy()
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2_000_000_000)  # ten minutes in which no handler in Python runs
"""


def light(command: str) -> list[str]:
    """A process in which `run` runs a function `command`."""
    package = pathlib.Path(_interruption.__file__).parent
    code = textwrap.dedent(LIGHT.format(package=str(package))) + textwrap.dedent(command) + "\nrun(command)\n"
    return [sys.executable, "-c", code]


def stopped_while_busy(command: str, number: int = signal.SIGINT, times: int = 1) -> tuple[int, list[str]]:
    """Exit code and lines on stderr of one that said that it is busy."""
    process = started(light(command), stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    for _ in range(times):
        process.send_signal(number)
    _, told = process.communicate(timeout=allowed())
    assert group(process.pid) == []
    return process.returncode, told.splitlines()


WAYS = {
    "Python": "def command():\n busy()\n time.sleep(60)",
    "C": "def command():\n in_c()",
    "a callback that loses it": """
        class Loses:
            def __del__(self):
                busy()
                time.sleep(60)

        def command():
            Loses()
            in_c()
    """,
    "a handler of all errors": """
        def command():
            busy()
            while True:
                try:
                    time.sleep(60)
                except BaseException:
                    print("Traceback", file=sys.stderr)
    """,
    "a fault that it causes": """
        def command():
            try:
                busy()
                time.sleep(60)
            except BaseException as error:
                raise RuntimeError("INTERNAL: a callback failed") from error
    """,
    "a thread that goes on": """
        def command():
            threading.Thread(target=in_c).start()
            time.sleep(60)
    """,
    "a pool of threads": """
        from concurrent.futures import ThreadPoolExecutor

        def command():
            with ThreadPoolExecutor() as pool:
                pool.submit(in_c)
    """,
    "a process": """
        def command():
            code = "import time; print('busy', flush=True); time.sleep(60)"
            subprocess.run([sys.executable, "-c", code])
    """,
    "a reader that does not read": """
        def command():
            busy()
            while True:
                sys.stdout.write("x" * 65536)
    """,
    "after the work": "import atexit\natexit.register(in_c)\ndef command():\n pass",
}


@pytest.mark.costly
@pytest.mark.parametrize("way", WAYS)
def test_a_process_ends_wherever_the_signal_finds_it(way: str) -> None:
    assert stopped_while_busy(WAYS[way]) == (130, ["jaxgeo: interrupted"])


@pytest.mark.costly
@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("way", ["Python", "C"])
def test_exit_codes_are_those_of_a_shell(name: str, way: str) -> None:
    code, word = CODES[name]
    assert stopped_while_busy(WAYS[way], getattr(signal, name)) == (code, [f"jaxgeo: {word}"])


def test_a_second_signal_is_not_told_again() -> None:
    assert stopped_while_busy(WAYS["a handler of all errors"], times=3) == (130, ["jaxgeo: interrupted"])


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_signals_that_the_caller_ignores_stay_ignored(name: str) -> None:
    """As `nohup` asks for, and a shell for what it runs in the background."""
    ignoring = f"import signal\nsignal.signal(signal.{name}, signal.SIG_IGN)\n"
    command = f"{ignoring}def command():\n os.kill(os.getpid(), signal.{name})\n sys.exit(3)"
    done = subprocess.run(light(command), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, "")


@pytest.mark.parametrize("code", [0, 1, 2, 70, None])
def test_a_command_that_is_not_stopped_ends_with_its_own_code(code: int | None) -> None:
    command = f"import atexit\natexit.register(print, 'left')\ndef command():\n print('done')\n sys.exit({code})"
    done = subprocess.run(light(command), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code or 0, "done\nleft\n", "")


WRITES = """
    import pathlib

    def command():
        with destination("--output", pathlib.Path({target!r})) as stream:
            stream.write("new")
            stream.flush()
            {work}
"""


@pytest.mark.parametrize("work", ["in_c()", "busy(); time.sleep(60)"], ids=["C", "Python"])
def test_output_is_as_it_was(tmp_path: pathlib.Path, work: str) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    assert stopped_while_busy(WRITES.format(target=str(target), work=work))[0] == 130
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_what_a_killed_process_left_goes_away_with_the_next_output(tmp_path: pathlib.Path) -> None:
    target = tmp_path / "out.csv"
    line = light(WRITES.format(target=str(target), work="in_c()"))
    for process in (killed := started(line, stdout=subprocess.PIPE), living := started(line, stdout=subprocess.PIPE)):
        assert process.stdout is not None
        assert process.stdout.readline() == "busy\n"
    killed.kill()
    killed.communicate()
    elsewhere = tmp_path / ".jaxgeo-00000000-1-0123abcd.partial"  # of another machine that shares the folder
    beside = hidden_name(target, ".partial").with_suffix(".aux")  # no name of ours
    for path in (elsewhere, beside):
        path.write_text("")
    assert len(list(tmp_path.iterdir())) == 4
    try:
        with destination("--output", tmp_path / "other.csv") as stream:
            stream.write("whole")
        left = {path.name for path in tmp_path.iterdir()}
    finally:
        living.kill()
        living.communicate()
    (of_living,) = left - {elsewhere.name, beside.name, "other.csv"}
    assert f"-{living.pid}-" in of_living


def test_results_that_were_put_aside_come_back(tmp_path: pathlib.Path) -> None:
    """Those of an earlier registration, also after a process that was killed."""
    from jaxgeo.cli._register_inputs import new_results

    (tmp_path / "report.json").write_text("old")
    aside = tmp_path / f"{hidden_name(tmp_path / 'report.json', '.old').name}".replace(f"-{os.getpid()}-", "-4194999-")
    aside.mkdir()  # no process has a number beyond 2^22
    (tmp_path / "report.json").rename(aside / "report.json")
    (tmp_path / "ortho.tif").write_text("of the killed one, not whole")
    with pytest.raises(ZeroDivisionError), new_results(tmp_path):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert (tmp_path / "report.json").read_text() == "old"
    with new_results(tmp_path):
        (tmp_path / "report.json").write_text("new")
        (undo,) = _interruption._state.undo.values()
        for _ in range(2):  # the second time it is of no harm
            undo()
            assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
            assert (tmp_path / "report.json").read_text() == "old"


@pytest.mark.parametrize(
    "argv, started_as, is_command",
    [
        (["-m", "locate"], ["python", "-m", "jaxgeo", "locate"], True),
        (["-m"], ["python", "-X", "utf8", "-mjaxgeo"], True),
        (["-m", "-m", "jaxgeo"], ["python", "-m", "pytest", "-m", "jaxgeo"], False),
        (["/usr/bin/jaxgeo", "locate"], ["python", "/usr/bin/jaxgeo", "locate"], True),
        ([r"jaxgeo.EXE"], ["python", "jaxgeo.EXE"], True),
        (["/home/me/jaxgeo.py"], ["python", "/home/me/jaxgeo.py"], False),
        (["/home/me/jaxgeo/run.py", "jaxgeo"], ["python", "/home/me/jaxgeo/run.py", "jaxgeo"], False),
        (["-c"], ["python", "-c", "import jaxgeo"], False),
        ([""], ["python"], False),
        ([], ["python"], False),
    ],
)
def test_only_the_command_is_taken_for_it(
    monkeypatch: pytest.MonkeyPatch, argv: list[str], started_as: list[str], is_command: bool
) -> None:
    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(sys, "orig_argv", started_as)
    assert _command.is_command() is is_command


@pytest.mark.costly
def test_a_program_that_imports_jaxgeo_keeps_its_signals() -> None:
    code = """
        import signal, threading
        before = [signal.getsignal(number) for number in signal.valid_signals()]
        import jaxgeo, jaxgeo.cli
        print(before == [signal.getsignal(number) for number in signal.valid_signals()])
        print(signal.set_wakeup_fd(-1), threading.active_count())
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["True", "-1 1"]


def test_a_terminal_gets_its_cursor_back() -> None:
    import pty

    ours, theirs = pty.openpty()
    process = started(light(WAYS["Python"]), stdout=subprocess.PIPE, stderr=theirs)
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert os.read(ours, 1000) == b"\r\x1b[2K\x1b[?25hjaxgeo: interrupted\r\n"


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[list[str], float]]:
    """Command lines that write `out`, and until when to stop them, in s of processor time."""
    flight = tmp_path_factory.mktemp("flight")
    for k in range(20):
        tags = DJI | {"drone-dji:GpsLatitude": f"{36.30 + 1e-4 * k:+.4f}"}
        write_image(flight / f"DJI_{k:04d}.jpg", packet(tags), make="DJI")
    scene = str(scene_file())
    ground = ["--scene", scene, "--dem", str(pathlib.Path(scene).with_name("jacksboro.tif")), "--pixel", "1200,2400"]
    return {
        "version": (["--version"], 0.8),
        "locate": (["locate", *ground, "-o", "out.csv"], 6.0),
        "accuracy": (["locate", *ground, "--position-sigma", "20", "--attitude-sigma", "0.3", "-o", "out.csv"], 8.0),
        "demo": (["demo", "-o", "out.png"], 12.0),
        "folder": (["locate", str(flight), *GROUND, "-o", "out.csv"], 8.0),
    }


def moments(seed: int, count: int) -> list[tuple[int, int]]:
    return [(seed, number) for number in range(count)]


@pytest.mark.slow
def test_a_command_ends_at_random_moments(
    commands: dict[str, tuple[list[str], float]], tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fresh = random.SystemRandom().randrange(10**6)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "JAXGEO_CACHE_DIR": ""}  # all is compiled
    environment.pop("XLA_FLAGS", None)
    found = []
    for seed, number in [*moments(SEED, TRIES - TRIES // 2), *moments(fresh, TRIES // 2)]:
        chance = random.Random(f"{seed} {number}")
        name = list(commands)[number % len(commands)]
        line, latest = commands[name]
        moment, whole_group = chance.uniform(0.0, latest), chance.random() < 0.5
        folder = tmp_path / f"{seed}-{number}"
        folder.mkdir()
        outputs = [folder / word for word in line if word.startswith("out.")]
        for output in outputs:
            output.write_text("old")
        whole = [sys.executable, "-m", "jaxgeo", *line]
        ended = stopped(whole, moment, whole_group=whole_group, cwd=folder, env=environment)
        found.append((name, seed, number, moment, ended.seconds, ended.code, ended.was_done))
        with capsys.disabled():
            print(f"\n{name:8} seed {seed:6} moment {moment:5.2f} s: {ended.code} after {ended.seconds:.2f} s", end=" ")
        if ended.was_done:
            continue
        assert ended.code == 130, (found[-1], ended.told)
        assert ended.seconds <= allowed(), found[-1]
        notes = [one for one in ended.told if not one.startswith(("jaxgeo: assumed: ", "jaxgeo: CE90 "))]
        assert notes == ["jaxgeo: interrupted"], (found[-1], ended.told)
        assert ended.told[-1] == "jaxgeo: interrupted", found[-1]
        assert ended.left == [], found[-1]
        assert sorted(folder.iterdir()) == outputs, found[-1]
        assert all(output.read_text() == "old" for output in outputs), found[-1]
    assert sum(not was_done for *_, was_done in found) >= 0.8 * TRIES, "too many were done before their moment came"


@pytest.mark.slow
def test_the_handler_is_there_before_jax() -> None:
    """Before it is, Python's own start is interrupted, which ends with a traceback or by the signal."""
    process = started([sys.executable, "-m", "jaxgeo", "--version"])
    wait_until(lambda: handles_signals(process.pid) or not is_running(process))
    maps = pathlib.Path(f"/proc/{process.pid}/maps").read_text()
    process.kill()
    process.communicate()
    assert "numpy" not in maps
    assert "jaxlib" not in maps

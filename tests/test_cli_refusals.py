"""Refusals are the caller's mistakes alone, and every piece of advice in them works as it is printed."""

from __future__ import annotations

import pathlib
import re
import shlex
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
import typer
from support import command_files
from support.command_runner import CliRunner

from jaxgeo._refusals import is_refusal
from jaxgeo.cli import app
from jaxgeo.cli._old_options import RENAMED
from jaxgeo.io.tables import read_shots

OLD = "_old_options.py"  # the only file with old names of options
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*[a-z0-9]")
PROGRAM = typer.main.get_command(app)


def run(line: str):
    return CliRunner().invoke(app, shlex.split(line)[1:])


def options_of(command: str) -> set[str]:
    found = PROGRAM.commands[command].params  # pyright: ignore[reportAttributeAccessIssue]
    return {name for param in found for name in (*param.opts, *param.secondary_opts)} | {"--help"}


class Advice(NamedTuple):
    """A wrong call, words of the refusal that say what to do, and the call that follows them."""

    wrong: str
    printed: str
    right: str


# Rows for advice of readers go here.
IMAGE = "--camera-datum ellipsoid --ground 300 --no-accuracy"
ADVICE = (
    Advice(
        "jaxgeo locate DJI_0042.JPG --ground 300 --no-accuracy",
        'Give --camera-datum: "ellipsoid"',
        f"jaxgeo locate DJI_0042.JPG {IMAGE}",
    ),
    Advice(
        "jaxgeo locate DJI_0042.JPG --ground 300 --no-accuracy",
        "or --takeoff-height, the height of the point of take-off in m",
        "jaxgeo locate DJI_0042.JPG --takeoff-height 500 --ground 300 --no-accuracy",
    ),
    Advice(
        "jaxgeo locate DJI_0042.JPG --camera-datum ellipsoid --no-accuracy",
        "--ground HEIGHT",
        f"jaxgeo locate DJI_0042.JPG {IMAGE}",
    ),
    Advice(
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --exposure a.jpg",
        "known: DJI_0042.JPG",
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --exposure DJI_0042.JPG",
    ),
    Advice(
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --pixel 10",
        "--pixel 100,200",
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --pixel 100,200",
    ),
    Advice(
        f"jaxgeo locate mission.sbet {IMAGE}",
        "give --scene SCENE.toml",
        f"jaxgeo locate mission.sbet --scene scene.toml {IMAGE}",
    ),
    Advice(
        f"jaxgeo locate DJI_0042.JPG scene.toml {IMAGE}",
        "give it alone",
        "jaxgeo locate scene.toml --ground 300 --no-accuracy",
    ),
    Advice(
        "jaxgeo inspect DJI_0042.JPG --image-size 10,20",
        "it takes --camera-datum",
        "jaxgeo inspect DJI_0042.JPG --camera-datum ellipsoid",
    ),
    Advice("jaxgeo inspect DJI_0042.JPG --tags", "--tags needs --json", "jaxgeo inspect DJI_0042.JPG --tags --json"),
    Advice(
        "jaxgeo inspect flight.klv -o shots.txt",
        "use .csv",
        "jaxgeo inspect flight.klv -o shots.csv",
    ),
    Advice(
        f"jaxgeo locate DJI_0042.JPG {IMAGE} -o fixes.txt",
        "or give --format table, csv or geojson",
        f"jaxgeo locate DJI_0042.JPG {IMAGE} -o fixes.txt --format csv",
    ),
    Advice(
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --mgrs",
        "--mgrs need --output FILE",
        f"jaxgeo locate DJI_0042.JPG {IMAGE} --mgrs --output fixes.csv",
    ),
    Advice("jaxgeo inspect DJI_0042.JPG --jsn", "did you mean --json?", "jaxgeo inspect DJI_0042.JPG --json"),
    Advice("jaxgeo inspct DJI_0042.JPG", "did you mean inspect?", "jaxgeo inspect DJI_0042.JPG"),
)


@pytest.mark.costly
@pytest.mark.parametrize("advice", ADVICE, ids=[one.printed[:40] for one in ADVICE])
def test_advice_works_as_it_is_printed(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, advice: Advice) -> None:
    monkeypatch.chdir(tmp_path)
    for line in (advice.wrong, advice.right):
        command_files.prepare(tmp_path, line)
    refused = run(advice.wrong)
    assert refused.exit_code == 2, refused.output
    told = " ".join(refused.stderr.split())
    assert advice.printed in told
    command = shlex.split(advice.right)[1]
    assert set(OPTION.findall(told.replace("--jsn", ""))) <= options_of(command)
    right = run(advice.right)
    assert right.exit_code == 0, right.output


@pytest.mark.parametrize(
    "path", sorted(pathlib.Path(command_files.__file__).parents[2].glob("jaxgeo/cli/*.py")), ids=str
)
def test_options_in_messages_of_the_command_line_exist(path: pathlib.Path) -> None:
    everywhere = set().union(*(options_of(name) for name in PROGRAM.commands))  # pyright: ignore
    everywhere |= {name for param in PROGRAM.params for name in param.opts}
    everywhere |= {
        name
        for study in PROGRAM.commands["study"].commands.values()  # pyright: ignore
        for param in study.params
        for name in param.opts
    }
    named = set(OPTION.findall(path.read_text(encoding="utf-8"))) - (set(RENAMED) if path.name == OLD else set())
    assert {one for one in named if not one.startswith("--xla")} <= everywhere


def _unpacked() -> None:
    _one, _two = [1, 2, 3]


def _from_key() -> None:
    {}["key"]


FAULTS: dict[str, Callable[[], object]] = {
    "int": lambda: int("x"),
    "unpacking": _unpacked,
    "KeyError": _from_key,
    "NumPy": lambda: np.zeros(3) + np.zeros(4),
    "JAX": lambda: jnp.zeros(3) + jnp.zeros(4),
    "decoding": b"\xff".decode,
    "import": lambda: __import__("no_such_module"),
}


def caught(work: Callable[[], object]) -> Exception:
    try:
        work()
    except Exception as error:
        return error
    raise AssertionError("nothing was raised")


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_no_refusal(name: str) -> None:
    assert not is_refusal(caught(FAULTS[name]))


def test_what_this_package_raises_for_a_caller_is_a_refusal(tmp_path: pathlib.Path) -> None:
    (tmp_path / "shots.csv").write_text("a,b\n1,2\n")
    assert is_refusal(caught(lambda: read_shots(tmp_path / "shots.csv", ())))
    assert is_refusal(caught(lambda: read_shots(tmp_path / "nowhere.csv", ())))


@pytest.mark.parametrize("fault", [KeyError("lens"), ValueError("too many values to unpack"), TypeError("x")], ids=repr)
def test_a_fault_within_is_told_as_one(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    """Whatever its class: not as damage of the file, not as advice, and with the way to report it."""

    def broken(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.chdir(tmp_path)
    command_files.prepare(tmp_path, "jaxgeo inspect DJI_0042.JPG")
    monkeypatch.setattr("jaxgeo.io.acquisitions.drone_images.maker_of", broken)
    result = run("jaxgeo inspect DJI_0042.JPG")
    assert result.exit_code == 70
    assert f"unexpected {type(fault).__name__}" in result.stderr
    assert "--debug" in result.stderr
    assert "damaged" not in result.stderr
    assert result.stderr.count("\n") == 1

"""Run calls that must fail, and report how each was refused and which programs JAX compiled before.

A separate process in which nothing has been compiled: `python refused_early.py` reads command lines and Python
statements, one per line, from standard input, and prints a JSON object for each. Readers are run once before, so that
their compilation is not counted; neither are single functions of `jax.numpy`.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import pathlib
import shlex
import sys
import tempfile
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax, monitoring

import jaxgeo
from jaxgeo.cli import app
from jaxgeo.io.acquisitions import read_acquisition
from jaxgeo.io.extent import extent_deg
from jaxgeo.io.scene import read_scene
from jaxgeo.io.tables import read_shots
from jaxgeo.uncertainty.sources import Position
from support import command_files
from support.command_runner import CliRunner

LOWERED = "/jax/core/compile/jaxpr_to_mlir_module_duration"  # event of every program, before it is compiled
SINGLE = {*dir(jnp), *dir(lax), *dir(jax.random), "stage", "threefry_seed"}
COLUMNS = ("kind", "ce90_m", "geometry", "index", "area_m2")  # written by outputs themselves


class Compiled(Exception):
    """A program was about to be compiled."""


def main() -> None:
    jaxgeo.enable_x64()
    lines = [line.strip() for line in sys.stdin if line.strip()]
    folders = {is_small: pathlib.Path(tempfile.mkdtemp()) for is_small in (False, True)}
    for is_small, folder in folders.items():
        _write_files(folder, is_small)
    for folder in folders.values():
        os.chdir(folder)
        namespace = _namespace()
    programs: list[str] = []
    monitoring.register_event_duration_secs_listener(functools.partial(_heed, programs))
    real = os.access
    os.access = lambda path, mode, **how: not ("locked" in f"{path}" and mode == os.W_OK) and real(path, mode, **how)
    for line in lines:
        programs.clear()
        os.chdir(folders[_is_small(line)])
        module, _, call = (
            line.removeprefix("without ").partition(": ") if line.startswith("without ") else ("", "", line)
        )
        with _without(module):
            code, told = _command(call) if call.startswith("jaxgeo ") else _statement(call, namespace)
        print(json.dumps({"line": line, "code": code, "told": told, "programs": programs}), flush=True)


def _heed(programs: list[str], event: str, duration_secs: float, **more: Any) -> None:
    del duration_secs
    name = str(more.get("fun_name", "")).removeprefix("jit(").removesuffix(")")
    if event == LOWERED and name.lstrip("_") not in SINGLE:
        programs.append(name)
        raise Compiled(name)


@contextlib.contextmanager
def _without(module: str) -> Iterator[None]:
    """Make a module appear as not installed."""
    before = sys.modules.get(module)
    if module:
        sys.modules[module] = None  # pyright: ignore[reportArgumentType]
        for name in [one for one in sys.modules if one.startswith("jaxgeo.report")]:
            del sys.modules[name]  # whose import loads all its requirements at once
    try:
        yield
    finally:
        if before is not None:
            sys.modules[module] = before
        else:
            sys.modules.pop(module, None)


def _is_small(line: str) -> bool:
    """Whether a line uses the small image and the scene that goes with it."""
    return any(word in line for word in ("rectify", "register", "image.tif", "ortho.tif"))


def _command(line: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, shlex.split(line)[1:])
    return result.exit_code, " ".join(result.stderr.split())


def _statement(line: str, namespace: dict[str, Any]) -> tuple[int, str]:
    """Run a statement; returns an exit code (0 done, 2 for refusals, 70 for other exceptions) and a message."""
    try:
        eval(line, namespace)
    except (ValueError, TypeError, OSError) as error:
        return 2, " ".join(str(error).split())
    except Exception as error:
        return 70, f"{type(error).__name__}: {error}"
    return 0, ""


def _write_files(folder: pathlib.Path, is_small: bool) -> None:
    names = "scene.toml dem.tif shots.csv flight.csv DJI_0042.JPG flight.klv" + " rectify" * is_small
    command_files.prepare(folder, names)
    rows = (folder / "shots.csv").read_text().splitlines()
    for column in COLUMNS:
        text = "\n".join([f"{rows[0]},{column}", *(f"{row},1" for row in rows[1:])])
        (folder / f"with-{column}.csv").write_text(text + "\n")
    (folder / "one.csv").write_text("\n".join(rows[:2]) + "\n")
    (folder / "locked").mkdir()


def _namespace() -> dict[str, Any]:
    """Names available to statements; files of all kinds are read."""
    scene = read_scene("scene.toml")
    dem = jaxgeo.io.read_dem("dem.tif")
    if os.path.exists("ortho.tif"):
        jaxgeo.io.read_orthoimage("ortho.tif")
    jaxgeo.io.read_navigation("flight.csv", ("outer", "inner"), height_datum="ellipsoid")
    read_shots("shots.csv", ("outer", "inner"))
    read_acquisition("DJI_0042.JPG", height_datum="ellipsoid")
    extent_deg(dem)
    errors = jaxgeo.ErrorModel((Position.from_ned(north=1.0, east=1.0, down=1.0),))
    level = jaxgeo.ConstantHeight(300.0)
    return {"jaxgeo": jaxgeo, "scene": scene, "dem": dem, "level": level, "errors": errors}


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        main()

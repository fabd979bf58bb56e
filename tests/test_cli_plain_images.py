"""An image without camera metadata is named as such, and what is advised instead works as it is printed."""

from __future__ import annotations

import pathlib
import re
import shlex

import pytest
from support.command_runner import CliRunner

from jaxgeo.cli import app

HEADS = {
    "PNG": b"\x89PNG\r\n\x1a\n" + bytes(40),
    "GIF": b"GIF89a" + bytes(40),
    "WebP": b"RIFF\x24\0\0\0WEBPVP8 " + bytes(40),
    "HEIF": b"\0\0\0\x18ftypheic" + bytes(40),
}


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize("kind", HEADS)
@pytest.mark.parametrize("command", ["locate FILE --pixel 1,1 --ground 0", "inspect FILE", "scene FILE -o scene.toml"])
def test_a_plain_image_is_named(kind: str, command: str, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "a.img"
    path.write_bytes(HEADS[kind])
    result = run(*shlex.split(command.replace("FILE", str(path))))
    assert result.exit_code == 2, result.output
    assert f"no camera metadata are read from a {kind} image" in result.stderr


@pytest.mark.costly
def test_what_is_advised_works_as_printed(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pathlib.Path("a.png").write_bytes(HEADS["PNG"])
    lines = re.findall(r"`jaxgeo ([^`]*)`", run("inspect", "a.png").stderr)
    assert [line.split()[0] for line in lines] == ["demo", "locate"]
    assert run("demo", "--write-dem", "dem.tif").exit_code == 0  # the elevation model of the user
    for line in lines:
        result = run(*shlex.split(line))
        assert result.exit_code == 0, result.output
    assert "hit" in result.stdout

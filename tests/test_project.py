"""The project's own papers: the README's example and commands do what they say."""

from __future__ import annotations

import contextlib
import io
import pathlib
import re
import tomllib

import numpy as np
import pytest


def code_blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


@pytest.mark.slow
def test_the_example_of_the_readme_runs(project_root: pathlib.Path) -> None:
    (example,) = code_blocks((project_root / "README.md").read_text(), "python")
    assert len([line for line in example.splitlines() if line.strip()]) <= 15
    names: dict = {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(example, names)
    for expected in ("'status': 'hit'", "CE90", "by linear propagation"):
        assert expected in printed.getvalue()
    fix = names["fix"]
    # Turning the heading swings the fix about the aircraft: by its horizontal distance, along a circle on flat ground.
    swing = float(np.linalg.norm(names["slopes"].pose.heading))
    assert swing > 0.99 * float(fix.slant_range) * np.sin(np.deg2rad(72.0))


def test_the_readme_gives_two_commands(project_root: pathlib.Path) -> None:
    commands = [
        line for line in (project_root / "README.md").read_text().splitlines() if line.startswith("python3 -m venv")
    ]
    assert len(commands) == 2
    assert commands[0].endswith("jaxgeo demo")
    assert commands[1].endswith("-m pytest -n auto --dist loadfile")


def test_the_figure_and_links_exist(project_root: pathlib.Path) -> None:
    for name in ("README.md", "CONTRIBUTING.md"):
        for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", (project_root / name).read_text()):
            assert (project_root / target).exists(), f"{name} names {target}"


def test_extras_and_licence(project_root: pathlib.Path) -> None:
    project = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]
    assert {"plot", "notebooks", "test", "dev", "cuda"} <= set(project["optional-dependencies"])
    assert project["license"] == "Apache-2.0"
    assert "Apache License" in (project_root / "LICENSE").read_text()

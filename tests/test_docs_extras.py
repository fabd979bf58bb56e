"""Examples of README and documentation that need an extra stand on a page that says how to install it."""

from __future__ import annotations

import pathlib
import re

import pytest

PROJECT = pathlib.Path(__file__).resolve().parents[1]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^ *```(\w+)[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"\[([a-z]+(?:,[a-z]+)*)\]'")  # of pip install 'jaxgeo[plot,gis]'
WITH = {"report": {"plot"}, "cluster": {"gis"}}  # extras that bring others
# What needs an extra, in commands and in Python.
NEEDS = {
    "report": r"jaxgeo report |jaxgeo adjust .*--report|jaxgeo study all .*-o |\bjaxgeo\.report\b|\bwrite_report\(",
    "plot": r"jaxgeo demo(?!.*--write)|jaxgeo validate .*\.(png|pdf|svg)|jaxgeo register |jaxgeo study (?!all).*-o "
    r"|\bjaxgeo\.plot\b|\bfrom jaxgeo import .*\bplot\b|\bmatplotlib\b|\.plot\(",
    "gis": r"\.gpkg\b|\.parquet\b|--mgrs\b|\bmgrs=True|\bgeopandas\b",
    "cluster": r"--cluster\b|\bjaxgeo\.cluster\b|\bfrom jaxgeo import .*\bcluster\b|\bdask\b|\bdistributed\b",
    "xarray": r"\bxarray\b|\bzarr\b",
    "stac": r"\bstac:https",
    "logs": r"\.(ulg|bin|BIN|tlog)\b",
    "video": r"\bDJI_\d+\.(MP4|MOV)\b",
    "features": r"--features\b|\bSiftFeatures\b|\bOrbFeatures\b",
    "orthority": r"\bgeometry\.yaml\b|\bint_param.*\.yaml\b",
}


def needed_in(text: str) -> dict[str, str]:
    """Extras that the commands and programs of a page need, with the first line that does."""
    lines = [
        line.partition("#")[0]
        for kind, block in FENCE.findall(text)
        if kind in ("console", "shell", "bash", "sh", "python")
        for line in block.replace("\\\n", " ").splitlines()
        if not line.strip().startswith(("pip ", "$ pip "))
    ]
    found = {}
    for extra, pattern in NEEDS.items():
        line = next((line for line in lines if re.search(pattern, line)), None)
        if line is not None:
            found[extra] = line.strip()
    return found


def named_in(text: str) -> set[str]:
    """Extras that a page says how to install, and those that they bring."""
    named = {name for group in NAMED.findall(text) for name in group.split(",")}
    return named | {one for name in named for one in WITH.get(name, ())}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_a_page_names_the_extras_of_its_examples(page: pathlib.Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = {extra: line for extra, line in needed_in(text).items() if extra not in named_in(text)}
    assert not missing, f"say beside it: pip install 'jaxgeo[{','.join(missing)}]'"


def test_the_patterns_find_what_they_are_for() -> None:
    text = "```console\njaxgeo report a.jpg -o a.html\njaxgeo locate a.jpg -o a.gpkg\n```\n`pip install 'jaxgeo[gis]'`"
    assert set(needed_in(text)) == {"report", "gis"}
    assert named_in(text) == {"gis"}
    assert named_in("'jaxgeo[report,logs]'") == {"report", "plot", "logs"}

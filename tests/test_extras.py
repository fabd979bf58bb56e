"""What lacks an extra says so in one line with the command that installs it; what needs none works without any."""

from __future__ import annotations

import importlib.util
import pathlib
import sys
import tomllib

import pytest
from support.extras import EXTRAS

import jaxgeo

OURS = ("dev", "test", "docs", "notebooks", "bench")  # for work on jaxgeo itself
OTHERS = ("cuda",)  # brings no module that jaxgeo imports
USES = [pytest.param(name, use, id=f"{name}-{use.__name__}") for name, extra in EXTRAS.items() for use in extra.uses]


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch):
    """Take modules away, and what of jaxgeo is imported only with them."""

    def take(*modules: str) -> None:
        for name in list(sys.modules):
            if name.split(".")[0] in modules or name.startswith(("jaxgeo.plot", "jaxgeo.report")):
                monkeypatch.delitem(sys.modules, name)
        for room in ("plot", "report"):
            if room in vars(jaxgeo):  # to ask the package itself would import it
                monkeypatch.delattr(jaxgeo, room)
        for name in modules:
            monkeypatch.setitem(sys.modules, name, None)

    return take


@pytest.mark.parametrize("name, use", USES)
def test_what_lacks_an_extra_says_which(tmp_path: pathlib.Path, without, name: str, use) -> None:
    without(*EXTRAS[name].modules)
    with pytest.raises(ImportError, match=rf"pip install 'jaxgeo\[{name}\]'") as told:
        use(tmp_path)
    assert "\n" not in str(told.value)


def test_every_extra_is_used(project_root: pathlib.Path) -> None:
    extras = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(extras) == {*EXTRAS, *OURS, *OTHERS}


@pytest.mark.parametrize("name", [name for name in EXTRAS if name != "report"])
def test_one_extra_does_not_ask_for_another(tmp_path: pathlib.Path, without, name: str) -> None:
    lacking = [module for module in EXTRAS[name].modules if importlib.util.find_spec(module) is None]
    if lacking:
        pytest.skip(f"needs the extra: pip install 'jaxgeo[{name}]', without {', '.join(lacking)}")
    others = {module for extra in EXTRAS.values() for module in extra.modules} - {*EXTRAS[name].modules, "matplotlib"}
    without(*others, *(() if name == "plot" else ("matplotlib",)))
    for use in EXTRAS[name].uses:
        use(tmp_path)

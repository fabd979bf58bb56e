"""Faults written into the engine turn verdicts of the studies: what is reproduced would not be if it were wrong.

A fault goes into a copy of the package, which computes its claims in a process of its own: no program that was compiled
before can hide it.
"""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys
from typing import NamedTuple

import pytest

import jaxgeo

pytestmark = pytest.mark.slow


class Fault(NamedTuple):
    """A text of a module and what stands in its place, and the claims (of CLAIMS) that are to see it."""

    module: str
    right: str
    wrong: str
    claims: str


FAULTS = {
    "a sign in the gimbal chain: the second axis turns the other way": Fault(
        "sensor/gimbal.py",
        "return gimbal.sign * gimbal.gain * (readings - gimbal.offset)",
        "return gimbal.sign * gimbal.gain * (readings - gimbal.offset) * (-1.0) ** jnp.arange(len(self.axes))",
        "li2020",
    ),
    "a factor in the covariance of a fix": Fault(
        "uncertainty/linear.py",
        "cov_enu = jacobian @ cov_error @ jacobian.T + extra",
        "cov_enu = 1.1 * jacobian @ cov_error @ jacobian.T + extra",
        "covariance",
    ),
    "a step too late in the fast iteration: the ground under the point before": Fault(
        "terrain/search/literature/fast_iteration.py",
        "low = jnp.where(is_above, sample.ground, sample.height)",
        "low = jnp.where(is_above, state.sample.ground, sample.height)",
        "search",
    ),
}

# Each gives a list of claims. The verdicts of those that hold something against a print go out as JSON.
CLAIMS = {
    "li2020": """
from jaxgeo.studies import li2020

claims = li2020.claims_of(li2020.run(flights=False))
""",
    "covariance": """
import jax
from jaxgeo.studies import li2023
from jaxgeo.studies.li2023.claims import table_3

level = li2023.over_level_ground(samples=10, key=jax.random.key(0))
claims = list(table_3(level, li2023.implied_tilts()))
""",
    "search": """
from jaxgeo.studies import li2023

claims = li2023.plane_claims()
""",
}
BEGIN = "import jaxgeo\njaxgeo.enable_x64()\n"
END = """
import json
verdicts = {f"{one.item}, {one.statement}": one.verdict.value for one in claims if one.printed is not None}
print(json.dumps({"package": jaxgeo.__file__, "verdicts": verdicts}))
"""


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_turns_verdicts(name: str, tmp_path: pathlib.Path) -> None:
    fault = FAULTS[name]
    package = pathlib.Path(jaxgeo.__file__).parent
    sound = verdicts(package, fault.claims)
    copy = tmp_path / "jaxgeo"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    module = copy / fault.module
    text = module.read_text(encoding="utf-8")
    assert text.count(fault.right) == 1, f"{fault.module} has {text.count(fault.right)} times: {fault.right}"
    module.write_text(text.replace(fault.right, fault.wrong), encoding="utf-8")
    faulty = verdicts(copy, fault.claims)
    assert sound.keys() == faulty.keys()
    turned = {what: (sound[what], faulty[what]) for what in sound if sound[what] != faulty[what]}
    assert turned, f"no verdict of {len(sound)} sees {name}"
    lost = [what for what, (before, after) in turned.items() if before == "reproduced" and after.startswith("differs")]
    assert lost, turned


def verdicts(package: pathlib.Path, claims: str) -> dict[str, str]:
    """Verdicts by item and statement, computed in a process of its own by a package, which is checked to be that."""
    found = subprocess.run(
        [sys.executable, "-c", BEGIN + CLAIMS[claims] + END],
        env={**os.environ, "PYTHONPATH": str(package.parent)},
        cwd=package.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    answer = json.loads(found.stdout.splitlines()[-1])
    assert pathlib.Path(answer["package"]).parent == package
    return answer["verdicts"]

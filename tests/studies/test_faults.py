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
        "terrain/search/fast_iteration.py",
        "low = jnp.where(is_above, look.ground, look.height)",
        "low = jnp.where(is_above, state.look.ground, look.height)",
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
import jax.numpy as jnp
from jaxgeo import propagate
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty import presets

row = printed.TERRAINS["plain"]
model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
ground = printed.level_ground(row.target[2])
found = propagate(printed.sensor(), printed.shot_of(row), printed.UV, ground, model)
rms = float(jnp.sqrt(jnp.trace(found.cov_enu)))
claims = [Claim("Li 2023", "Table 3, plain", "RMS in space", 137.7469, rms, 0.01 * 137.7469, "m")]
""",
    "search": """
import math
import jax
import jax.numpy as jnp
import numpy as np
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.scenes import profile_dem, profile_ray
from jaxgeo.studies.terrain_searches import approaches, run_from
from jaxgeo.terrain import FastIteration, HeightsBetween

SLOPES = (-0.9, -0.5, 0.0, 0.5, 0.9)
AHEAD = 30.0 * (np.arange(65) - 32.0)


def as_printed(k, highest=200.0, eps=0.2):
    # Fig. 11 over a plane: under the point at height Z the ground is at -k Z.
    high, low, count = highest, -k * highest, 1
    while True:
        middle, count = 0.5 * (high + low), count + 1
        clearance = middle + k * middle
        if clearance > eps:
            high, low = middle, -k * middle
        elif clearance < 0.0:
            low = middle
        else:
            return count


def ours(k):
    dem = profile_dem(k * AHEAD, 30.0)
    ray = profile_ray(dem, 0.0, 0.0, depression=math.pi / 4.0, altitude=5000.0)
    rays = jax.tree.map(lambda x: jnp.asarray(x)[None], ray)
    return int(run_from(approaches(rays, dem), dem, FastIteration(window=HeightsBetween(0.0, 200.0))).evaluations[0])


claims = [
    Claim("Li 2023", "Fig. 11", f"evaluations over a plane, k = {k}", float(as_printed(k)), float(ours(k)))
    for k in SLOPES
]
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
    assert {after for _, after in turned.values()} == {"differs, unexplained"}


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

"""Right answers for the telemetry of the folder `field`."""

from __future__ import annotations

import pathlib

import numpy as np

from jaxgeo.io.acquisitions import read_sbet
from tests.support.field import FieldFile


def check_sbet(path: pathlib.Path) -> None:
    """Applanix's axes; 2-points has a mean velocity of (-2.341, 0.282, 0.031) m/s, within 0.03 of the positions."""
    found = read_sbet(path)
    assert found.velocity_ned is not None
    assert "y west and z up" in found.facts["velocities"]
    assert float(found.facts["velocities"].split("; ")[1].split()[0]) < 0.03  # m/s, from the change of the positions
    if path.name == "2-points.sbet":
        np.testing.assert_allclose(found.velocity_ned, [[-2.341, 0.282, 0.031]] * 2, atol=2.5e-3)
    else:
        np.testing.assert_allclose(found.velocity_ned, [[51.9615, 30.0, -1.0]] * 400, atol=1e-3)


ROWS: tuple[FieldFile, ...] = (
    FieldFile("tab/2-points.sbet", "SBET velocities as Applanix writes them: y west, z up", check_sbet),
    FieldFile("tab/sbet_manual.out", "SBET by the manual of POSPac", check_sbet),
)

"""Mutual correction of four real oblique drone images, held against the orientations of OpenSfM.

Run: python benchmarks/ties.py [--points 300] [--json out.json]
The images look at one village from four sides, 60 deg below horizontal (folder JAXGEO_TEST_DATA). Their navigation is
that of the tags: RTK positions, gimbal angles assumed good to 1 and 0.5 deg. Reports tie points, residuals in px with
the orientations of the navigation and the adjusted ones, and the differences of positions (m) and attitudes (deg) from
those of OpenSfM, before and after: with the camera of the camera table, with self-calibration, and with the camera of
OpenSfM. A turn common to all cameras about their own axes acts as a shift of the principal point; attitudes are also
compared without it. Times are of the processor, with compilation.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

import jaxgeo
from jaxgeo.adjust import LocalFrame, Prior, Unknowns
from jaxgeo.io import read_dem, read_observations, read_opensfm
from jaxgeo.io.images import read_image
from jaxgeo.ties import Matching, Pictures, TieOutcome, Views, correct, find_ties

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
UNDULATION = 19.6  # m: cameras and surface have the same heights
GRID = "EPSG:32651"
HEIGHT_SIGMA = 2.0  # m, of the surface model as the ground of a block of pixels


def differences(views: Views, reference: Any, centre: np.ndarray, R: np.ndarray) -> dict[str, float]:
    """RMS differences of orientations from those of the reconstruction."""
    names = [str(name) for name in reference.names]
    rows = [names.index(str(name).removesuffix(".tif")) for name in views.name]
    frame = LocalFrame(reference.reference)
    turn = np.asarray(views.frame.R_ecef_from_local).T @ np.asarray(frame.R_ecef_from_local)
    true = np.asarray(views.frame.from_ecef(np.asarray(frame.to_ecef(reference.centres[rows]))))
    true_R = turn @ reference.R_enu_from_camera[rows]
    angles = np.rad2deg(Rotation.from_matrix(np.swapaxes(true_R, 1, 2) @ R).as_rotvec())
    return {
        "position_rms_m": _rms(centre - true),
        "attitude_rms_deg": _rms(angles),
        "attitude_less_common_rms_deg": _rms(angles - angles.mean(axis=0)),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def main() -> None:
    """Match, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=300, help="points of each image")
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    folder = DATA / "odm_miaoli"
    observed = read_observations([folder / "images"], height_datum=UNDULATION)
    names = [str(row["name"]) for row in observed.columns]
    each = [observed.at(row) for row in range(len(observed))]
    terrain = read_dem(folder / "dsm.tif", vertical_datum=UNDULATION)
    reference = read_opensfm(folder / "opensfm" / "reconstruction.json", height_datum=UNDULATION, crs=GRID)
    (camera,) = {str(name): reference.cameras[str(name)] for name in reference.camera}.values()
    exposures = [one.exposure for one, _ in each]
    with_camera = [eqx.tree_at(lambda e: e.sensor.camera, one, camera) for one in exposures]
    interior = Unknowns(focal=Prior(3.0), principal=Prior(1.5))
    found: dict[str, Any] = {}
    for label, shots, unknowns in (
        ("camera table", exposures, None),
        ("self-calibration", exposures, interior),
        ("camera of OpenSfM", with_camera, None),
    ):
        views = Views.of(names, shots, [errors for _, errors in each])
        pictures = Pictures(lambda row: read_image(folder / "images" / names[row]))
        began = time.process_time()
        ties = find_ties(views, terrain, pictures, Matching(sigma_height=HEIGHT_SIGMA), points=given.points)
        matched = time.process_time()
        result = correct(views, ties, unknowns)
        images = result.adjustment.images
        counts = {one.name: sum(pair.counts.get(one, 0) for pair in ties.pairs) for one in TieOutcome}
        found[label] = {
            "tie_points": len(np.unique(result.adjustment.block.observations.point)),
            "measurements": len(result.adjustment.block.observations),
            "left_out": result.left_out,
            "points_by_outcome": counts,
            "unconnected": result.unconnected,
            "residual_before_px": result.rms_before,
            "residual_after_px": result.rms_after,
            "before": differences(views, reference, views.centre, views.R_frame_from_camera),
            "after": differences(views, reference, images.centre, images.R_frame_from_camera),
            "matching_s": matched - began,
            "adjustment_s": time.process_time() - matched,
        }
        print(label)
        print(json.dumps(found[label], indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps({"device": os.uname().machine, **found}, indent=1))


if __name__ == "__main__":
    main()

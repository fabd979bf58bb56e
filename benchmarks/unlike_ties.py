"""Ties between bands: images of a real block by another band each, matched by grey values, orientations and keypoints.

Run: python benchmarks/unlike_ties.py [--points 300] [--blocks drone large] [--json out.json]

Every second image shows its third band (blue), the others their first (red). `alike` are the same images with the mean
of their bands. `inverted` is the same pair of bands, the blue one with its grey values reversed: an image of another
sensor in its contrast, though not in its detail. The drone block is self-calibrated, the navigation of the large one is
the poor one (10 m, 0.3 deg; see ties.py). Reported are the measured points by outcome, residuals of the adjustment in
px, and differences of the adjusted attitudes from the published reconstruction, deg.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
from collections.abc import Callable
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.ties import Real, adjusted_poses, differences, drone, large
from jaxgeo.ties import Matching, OrbFeatures, Pictures, SiftFeatures, TieOutcome, correct, find_ties

HOW: dict[str, dict[str, Any]] = {
    "grey": {},
    "orientation": {"measure": "orientation"},
    "sift": {"features": SiftFeatures()},
    "orb": {"features": OrbFeatures()},
}


def alike(values: np.ndarray, row: int) -> np.ndarray:
    del row
    return values


def bands(values: np.ndarray, row: int) -> np.ndarray:
    """The first band, or of every second image the third."""
    return values[2 * (row % 2)]


def inverted(values: np.ndarray, row: int) -> np.ndarray:
    """The same, the third one reversed."""
    return 255.0 - values[2] if row % 2 else values[0].astype(float)


def measured(block: Real, shown: Callable[[np.ndarray, int], np.ndarray], how: str, points: int) -> dict[str, Any]:
    """Figures of one case."""
    views, unknowns = list(block.cases.values())[1 if len(block.cases) > 1 else 0]

    def read(row: int) -> tuple[Any, Any]:
        values, known = block.read(row)
        return shown(np.asarray(values), row), known

    options = dict(HOW[how])
    matching = Matching(sigma_height=block.height_sigma, measure=options.pop("measure", "grey"))
    ties = find_ties(views, block.terrain, Pictures(read), matching, points=points, **options)
    found: dict[str, Any] = {
        "points_by_outcome": {one.name: sum(pair.counts.get(one, 0) for pair in ties.pairs) for one in TieOutcome},
        "joined": len(ties.parts[0]),
    }
    if ties.observations is None or len(ties.parts[0]) < 2:
        return found
    try:
        result = correct(views, ties, unknowns)
    except ValueError as error:
        return found | {"refused": f"{error}"}
    return found | {
        "residual_before_px": result.rms_before,
        "residual_after_px": result.rms_after,
        "sigma_px": float(np.median(ties.observations.sigma)),
        "excess_px": result.excess,
        "left_out": result.left_out,
        "after": differences(adjusted_poses(result), block.reference) if len(result.names) == len(views) else None,
    }


def main() -> None:
    """Match, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=300, help="points of each image")
    parser.add_argument("--blocks", nargs="+", choices=("drone", "large"), default=("drone", "large"))
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for name in given.blocks:
        block = drone() if name == "drone" else large(1)
        for shown in (alike, bands, inverted):
            for how in HOW:
                figures = measured(block, shown, how, given.points)
                found[f"{name}, {shown.__name__}, {how}"] = figures
                print(f"{name}, {shown.__name__}, {how}: {json.dumps(figures)}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()

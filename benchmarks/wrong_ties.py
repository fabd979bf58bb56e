"""Mutual correction of simulated strips with wrong measurements: how often poses lie within their stated covariance.

Run: python benchmarks/wrong_ties.py [--seeds 30] [--shares 0.1 0.3 0.4] [--kinds area anywhere ...] [--json out.json]
Strips of drone images 150 m above rough ground with about 40 points each, measured to 0.1 px, errors of the navigation
of 1 m and 0.4 deg (`tests/support/simulated_ties.py`). A share of the measurements lies at random places of the search
area ("area") or of the image ("anywhere"); or a share of the points moves by one shift from image to image ("moving"),
or is joined of two points ("joined").

Reported for each strip, kind and share: seeds whose joint squared error exceeds its 99.9 % chi-square bound, images
that exceed theirs, images that were named as not adjusted, refused seeds, joint squared error over its degrees of
freedom, and wrong measurements that were kept.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
import scipy

import jaxgeo
from jaxgeo.ties import correct

jaxgeo.enable_x64()

from support.simulated_ties import KINDS, simulated, squared_errors  # noqa: E402

STRIPS = ((4, 0.6), (4, 0.7), (8, 0.7), (30, 0.8))  # images, overlap
CERTAIN = 0.999


def outcome(count: int, overlap: float, kind: str, share: float, seed: int) -> dict[str, Any]:
    """Figures of one seed."""
    here = simulated(count, overlap, kind, share, seed)
    try:
        found = correct(here.given, here.observations)
    except ValueError as refused:
        return {"seed": seed, "refused": str(refused)}
    each, joint = squared_errors(here, found)
    kept = found.adjustment.block.observations
    rows = set(zip(kept.image.tolist(), kept.point.tolist(), strict=True))
    given = zip(here.observations.image.tolist(), here.observations.point.tolist(), strict=True)
    return {
        "seed": seed,
        "images": len(each),
        "images_beyond": int(np.sum(np.array(each) > scipy.stats.chi2.ppf(CERTAIN, 6))),
        "joint": joint,
        "beyond": bool(joint > scipy.stats.chi2.ppf(CERTAIN, 6 * len(each))),
        "unconnected": len(found.unconnected),
        "wrong": int(np.sum(here.wrong)),
        "wrong_kept": int(np.sum(np.array([one in rows for one in given]) & here.wrong)),
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the seeds of a case."""
    done = [row for row in rows if "refused" not in row]
    sums = {
        key: sum(row[key] for row in done) for key in ("images", "images_beyond", "unconnected", "wrong_kept", "wrong")
    }
    return {
        "seeds": len(rows),
        "seeds_beyond": [row["seed"] for row in done if row["beyond"]],
        "refused": len(rows) - len(done),
        **sums,
        "joint_over_freedom": sum(row["joint"] for row in done) / max(6 * sums["images"], 1),
    }


def main() -> None:
    """Simulate, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--shares", type=float, nargs="+", default=[0.1, 0.3, 0.4])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["area", "anywhere"])
    parser.add_argument("--images", type=int, nargs="+", default=[one[0] for one in STRIPS])
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    found = {}
    for count, overlap in (one for one in STRIPS if one[0] in given.images):
        for kind in given.kinds:
            for share in given.shares:
                rows = [outcome(count, overlap, kind, share, seed) for seed in range(given.seeds)]
                name = f"{count} images, {overlap:g} overlap, {kind}, {share:g}"
                found[name] = {**summary(rows), "of_seeds": rows}
                print(name, json.dumps(summary(rows)), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()

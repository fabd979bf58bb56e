"""Mutual correction of scenes that mislead matching: how often the poses lie within the bounds of their covariance.

Run: python benchmarks/tie_scenes.py [--seeds 10] [--scenes shadows water ...] [--share 0.3] [--json out.json]
Four rendered images of a strip 150 m above ground (256 x 192 px of 0.6 m, with 5 % noise) and a fifth of other ground
3 km away; errors of the navigation of 1 m and 0.4 deg and of the height of the ground of 1 m. The scenes:

- periodic: a lattice that repeats every 8 m, turned by the seed;
- rows_of_trees: the same over a weak random texture;
- water: half of the ground has another texture in each image;
- shadows: a fifth of the ground is dark, and the dark patches move by 2 m north to south and west to east from image to
  image;
- wrong: random texture, and 30 % (`--share`) of the measurements moved after matching to random places within 12 px,
  which is what the search covers along rows and columns;
- anywhere: the same, moved to random pixels of the whole image;
- plain: random texture alone.

Texture, noise and navigation are drawn anew for each seed. Reported: seeds in which anything is corrected; of these,
the share of images within the 99.9 % bound of their own covariance, seeds in which all images are, and in which the
joint squared error is within its own bound; the joint squared error over its degrees of freedom, with 95 % bounds of
the mean of all seeds; measurements, wrong ones that were kept, added standard deviation in px, and whether the fifth
image was named as unconnected. The joint bound is of a normal distribution: where few images are left, errors of the
navigation of several standard deviations bend it beyond measurements of 0.01 px, also without wrong ones.
"""

from __future__ import annotations

import argparse
import functools
import json
import pathlib
import sys
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
import scipy

import jaxgeo
from jaxgeo.adjust import ImagePoints
from jaxgeo.ties import Matching, Ties, correct, find_ties

jaxgeo.enable_x64()  # before the scenes, which have errors of the navigation

from support import misleading_scenes  # noqa: E402
from support.drone_strip import Strip, ground, strip  # noqa: E402

SCENES = ("plain", "wrong", "anywhere", "periodic", "rows_of_trees", "water", "shadows")
CERTAIN = 0.999
SEARCHED = 12.0  # px
WRONG = ("wrong", "anywhere")


def here_of(scene: str, seed: int) -> Strip:
    """The strip with its images of a scene."""
    return misleading_scenes.shown(strip(seed=seed), getattr(misleading_scenes, scene), seed)


@functools.cache
def tied(scene: str, seed: int) -> tuple[Strip, Ties]:
    """The strip and its tie points."""
    here = here_of(scene, seed)
    return here, find_ties(here.views, ground(1.0), here.pictures, Matching(sigma_height=2.0), points=48)


def with_wrong(observed: ImagePoints, scene: str, share: float, rng: np.random.Generator) -> ImagePoints:
    """A share of the measurements at random places of the search area, or anywhere in the image."""
    wrong, shape = rng.random(len(observed)) < share, (len(observed), 2)
    if scene == "anywhere":
        other = rng.uniform([0.0, 0.0], [255.0, 191.0], shape)
    else:
        other = observed.uv + rng.uniform(-SEARCHED, SEARCHED, shape)
    return ImagePoints(observed.image, observed.point, np.where(wrong[:, None], other, observed.uv), observed.sigma)


def outcome(scene: str, seed: int, share: float) -> dict[str, Any]:
    """Figures of one seed."""
    here, ties = tied("plain" if scene in WRONG else scene, seed)
    if ties.observations is None:
        return {"tied": False}
    observed = given = ties.observations
    if scene in WRONG:
        observed = with_wrong(observed, scene, share, np.random.default_rng(seed))
    try:
        found = correct(here.views, observed)
    except ValueError as refused:
        return {"tied": False, "refused": str(refused)}
    each, joint = misleading_scenes.squared_errors(here, found)
    count = 6 * len(found.names)
    kept = found.adjustment.block.observations
    rows = set(zip(kept.image.tolist(), kept.point.tolist(), strict=True))
    wrong = np.any(observed.uv != given.uv, axis=1)
    both = zip(observed.image[wrong].tolist(), observed.point[wrong].tolist(), strict=True)
    return {
        "tied": True,
        "images": len(found.names),
        "within": int(np.sum(np.array(each) < scipy.stats.chi2.ppf(CERTAIN, 6))),
        "largest": max(each),
        "joint": joint,
        "freedom": count,
        "joint_within": bool(joint < scipy.stats.chi2.ppf(CERTAIN, count)),
        "measurements": len(found.adjustment.block.observations),
        "left_out": found.left_out,
        "wrong_kept": sum(one in rows for one in both),
        "excess_px": found.excess,
        "names_the_last": here.names[-1] in found.unconnected,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the seeds of a scene."""
    tied = [row for row in rows if row["tied"]]
    found: dict[str, Any] = {"seeds": len(rows), "tied": len(tied)}
    if not tied:
        return found
    freedom = sum(row["freedom"] for row in tied)
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], freedom) / freedom
    return found | {
        "images": sum(row["images"] for row in tied),
        "images_within": sum(row["within"] for row in tied),
        "seeds_with_all_images_within": sum(row["within"] == row["images"] for row in tied),
        "seeds_with_joint_error_within": sum(row["joint_within"] for row in tied),
        "joint_over_freedom": sum(row["joint"] for row in tied) / freedom,
        "chi_square_95": [float(low), float(high)],
        "measurements": float(np.mean([row["measurements"] for row in tied])),
        "left_out": float(np.mean([row["left_out"] for row in tied])),
        "wrong_kept": sum(row["wrong_kept"] for row in tied),
        "excess_px": float(np.mean([row["excess_px"] for row in tied])),
        "last_image_named": sum(row["names_the_last"] for row in tied),
    }


def main() -> None:
    """Render, match, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--share", type=float, default=0.3, help="of wrong measurements in the scenes wrong, anywhere")
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    found = {}
    for scene in given.scenes:
        rows = []
        for seed in range(given.seeds):
            rows.append(outcome(scene, seed, given.share))
            print(scene, seed, json.dumps(rows[-1]), flush=True)
        found[scene] = {**summary(rows), "of_seeds": rows}
        print(scene, json.dumps(summary(rows), indent=1), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()

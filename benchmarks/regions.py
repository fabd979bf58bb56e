"""Validation of highest-density regions: content in fresh samples, area against the circle, shares of the pieces.

Observations as in `verdict.py`: every azimuth, 8 to 60 degrees down, 6 to 50 km away, errors 0.15 to 3 times those of a
good sensor. The region of each is made from 20,000 samples, and 50,000 fresh ones count what it holds; the first of
them is the truth of a single measurement. `--pieces` compares the shares of pieces with a million fresh samples.

Run: python benchmarks/regions.py [--targets 80] [--pieces 8] [--fresh 0]
"""

from __future__ import annotations

import argparse
import itertools
import math
import pathlib
import sys
import time
from typing import Any, NamedTuple

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import jax
import numpy as np
from looks import PIXEL, SENSOR, Cases, cases, errors, item, terrains
from measuring import Column, Table

import jaxgeo
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import Region, Sampled, sample

SAMPLES, FRESH, MANY = 20_000, 50_000, 1_000_000
PROBABILITY = 0.9
WITHIN = 0.02  # of the probability: goal for the content of each region
LEVEL = ("smooth", "hilly", "Rome")  # classes of terrain that are no mountains
STEEP = (8.0, 15.0, 25.0, 40.0, 60.0)  # deg of depression at the ground


class Look(NamedTuple):
    """One case: share of fresh samples in the region, whether the first of them is, area over that of the CE circle,
    number of pieces with 1 % or more, seconds of processor time, depression at the fix in degrees."""

    content: float
    truth: bool
    ratio: float
    pieces: int
    seconds: float
    depression: float


def drawn(
    dem: Dem, looks: Cases, i: int, seed: int, first: int, count: int, confidence: float | None = None
) -> Sampled:
    """Samples number `first` to `first + count - 1` of one case; later ones of another key, as more points of the same
    scrambles would fill the gaps of the first ones."""
    shot, model = jaxgeo.Shot(item(looks.pose, i)), errors(looks.scale[i])
    how: dict[str, Any] = {
        "key": jax.random.key(seed if first == 0 else seed + 10**6),
        "figures": ("CE",),
        "keep": True,
        "confidence": confidence,
    }
    return sample(SENSOR, shot, PIXEL, dem, model, first=first, count=count, **how)


def seen(dem: Dem, looks: Cases) -> np.ndarray:
    """Indices of the cases with a fix."""
    fix = jax.vmap(lambda pose: jaxgeo.locate(SENSOR, jaxgeo.Shot(pose), PIXEL, dem))(looks.pose)
    return np.flatnonzero(np.asarray(counts_as_fix(fix.status)))


def judged(dem: Dem, looks: Cases, i: int, seed: int) -> tuple[Look, Region] | None:
    """One case; None if too many of its samples have no ground."""
    own = drawn(dem, looks, i, seed, 0, SAMPLES)
    if own.failed >= 1.0 - PROBABILITY:
        return None
    start = time.process_time()
    region = own.region(PROBABILITY)
    seconds = time.process_time() - start
    fresh = drawn(dem, looks, i, seed, SAMPLES, FRESH)
    first = drawn(dem, looks, i, seed, SAMPLES, 1)
    circle = math.pi * own.circular_error(PROBABILITY).value ** 2
    pieces = sum(mode.share.value >= 0.01 for mode in region.modes)
    down = 90.0 - math.degrees(float(own.fix.incidence_ellipsoid))
    content, truth = fresh.probability_within(region.polygon).value, first.probability_within(region.polygon).value
    return Look(content, truth > 0.5, region.area / circle, pieces, seconds, down), region


LOOKS = [
    Column("terrain"),
    Column("looks"),
    Column("content, mean", "%"),
    Column("least", "%"),
    Column("most", "%"),
    Column("within 88 to 92 %", "% of looks", "higher"),
    Column("truth inside", "%"),
    Column("area over circle, median", "", "lower"),
    Column("largest", "", "lower"),
    Column("in pieces", "% of looks"),
    Column("processor time, median", "ms", "lower"),
    Column("most", "ms", "lower"),
]
DOWN = [
    Column("terrain"),
    Column("depression", "deg"),
    Column("looks"),
    Column("area over circle, median", "", "lower"),
]
PIECES = [
    Column("terrain"),
    Column("looks"),
    Column("pieces"),
    Column("within their interval", "%"),
    Column("off, most", "points"),
]


def row(name: str, looks: list[Look]) -> list[Any]:
    content, truth, ratio, pieces, seconds, _ = (np.array(x) for x in zip(*looks, strict=True))
    near = np.abs(content - PROBABILITY) <= WITHIN
    shares = [100.0 * float(x) for x in (content.mean(), content.min(), content.max(), near.mean(), truth.mean())]
    times = [1e3 * float(np.median(seconds)), 1e3 * float(seconds.max())]
    return [
        name,
        len(looks),
        *shares,
        float(np.median(ratio)),
        float(ratio.max()),
        100.0 * float((pieces > 1).mean()),
        *times,
    ]


def study(targets: int, pieces: int, fresh: int) -> list[Table]:
    """The tables, by class of terrain."""
    found: dict[str, list[Look]] = {}
    checked: dict[str, list[tuple[bool, float]]] = {}
    many: dict[str, int] = {}
    lost = 0
    classes = {name: dems for name, dems in terrains(fresh).items() if "set on" not in name}
    for number, (name, dems) in enumerate(classes.items()):
        for k, dem in enumerate(dems):
            seed = fresh + 1000 * number + 100 * k
            looks = cases(dem, targets, seed)
            for i in seen(dem, looks):
                one = judged(dem, looks, i, seed + i)
                if one is None:
                    lost += 1
                    continue
                found.setdefault(name, []).append(one[0])
                if one[0].pieces > 1 and many.get(name, 0) < pieces:
                    many[name] = many.get(name, 0) + 1
                    checked.setdefault(name, []).extend(shares(dem, looks, i, seed + i, one[1]))
        print(name, found and row(name, found[name]), file=sys.stderr, flush=True)
    table = Table(f"Regions of {100 * PROBABILITY:g} % from {SAMPLES} samples, {FRESH} fresh ones", LOOKS)
    every = [look for looks in found.values() for look in looks]
    table.rows = [row("all", every), *(row(name, looks) for name, looks in found.items())]
    table.notes.append(f"{lost} looks left out: {100 * (1 - PROBABILITY):g} % or more of their samples have no ground")
    down = Table("Area of the region over that of the circle, by depression", DOWN)
    steep = [look for name, looks in found.items() if name not in LEVEL for look in looks]
    for name, looks in (("all", every), ("mountains", steep)):
        for low, high in itertools.pairwise(STEEP):
            ratio = [look.ratio for look in looks if low <= look.depression < high]
            down.rows.append([name, f"{low:g} to {high:g}", len(ratio), float(np.median(ratio)) if ratio else None])
    parts = Table(f"Shares of pieces against {MANY} samples, intervals at 95 %", PIECES)
    for name, each in {"all": [x for some in checked.values() for x in some], **checked}.items():
        inside, off = (np.array(x) for x in zip(*each, strict=True)) if each else (np.zeros(0), np.zeros(0))
        total = sum(many.values()) if name == "all" else many[name]
        parts.rows.append(
            [
                name,
                total,
                len(each),
                100.0 * float(inside.mean()) if each else None,
                100.0 * float(off.max()) if each else None,
            ]
        )
    return [table, down, parts]


def shares(dem: Dem, looks: Cases, i: int, seed: int, region: Region) -> list[tuple[bool, float]]:
    """For each piece with 1 % or more: whether its share of a million samples lies in its interval, and its error."""
    fresh = drawn(dem, looks, i, seed, SAMPLES, MANY)
    result = []
    for mode in region.modes:
        if mode.share.value >= 0.01:
            share = fresh.probability_within(mode.polygon).value
            result.append((mode.share.low <= share <= mode.share.high, abs(share - mode.share.value)))
    return result


def main() -> None:
    """Run the study and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=80, help="looks at each terrain")
    parser.add_argument("--pieces", type=int, default=8, help="looks of each class whose pieces are checked")
    parser.add_argument("--fresh", type=int, default=0, help="a number: other synthetic terrain and looks than before")
    options = parser.parse_args()
    for table in study(options.targets, options.pieces, options.fresh):
        print(table.markdown())


if __name__ == "__main__":
    main()

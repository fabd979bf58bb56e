"""Validation of highest-density regions: content in fresh samples, area against the circle, shares of the pieces.

Observations from every azimuth, 6 to 50 km away, errors 0.15 to 3 times those of a good sensor. Smooth and hilly
terrain is seen 8 to 60 degrees down. Mountains are seen by oblique stand-off imaging, 5 to 25 degrees down at the fix:
a camera 3 to 10 km above the ground and 20 to 50 km away. Steeper looks at mountains, to 60 degrees, are a class apart.

The region of each is made from 20,000 samples, and 50,000 fresh ones count what it holds; the first of them is the
truth of a single measurement. No region is smaller than the smallest area that holds 90 % of the errors. For some looks
of each terrain it is found from 400,000 samples, by NumPy alone: cells of a histogram, in the order of the counts of
half of the samples, until they hold 90 % of the other half. `--pieces` compares the shares of pieces with a million.

Run: python benchmarks/regions.py [--targets 78] [--least 4] [--pieces 8] [--fresh 0]
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
FOR_LEAST = 400_000  # samples of the smallest area: of a normal error it is 1 % too large
PROBABILITY = 0.9
WITHIN = 0.02  # of the probability: goal for the content of each region
LEVEL = ("smooth", "hilly", "Rome")  # classes of terrain that are no mountains
DEPRESSIONS, OBLIQUE, STEEPER = (8.0, 60.0), (5.0, 25.0), (25.0, 60.0)  # deg: of looks at other terrain; at mountains
CELLS = (1000, 2000)  # of a histogram that hold 90 % of a normal error; the smallest area counts
STEEP = (5.0, 15.0, 25.0, 40.0, 60.0)  # deg of depression at the ground


class Look(NamedTuple):
    """One case: share of fresh samples in the region, whether the first of them is, area over that of the CE circle,
    number of pieces with 1 % or more, seconds of processor time, depression at the fix in degrees, and the smallest
    area over that of the circle if it was found."""

    content: float
    truth: bool
    ratio: float
    pieces: int
    seconds: float
    depression: float
    least: float | None


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


def least_area(samples: Sampled) -> float:
    """Area in m2 of the smallest set of cells found that holds 90 % of the samples, on the level plane of the fix.

    Cells are along the axes of the covariance of the nearer half of the samples. Those chosen by one half of all are
    counted in the other half, so that cells which hold many by chance do not make the area too small.
    """
    assert samples.errors_enu is not None
    errors = np.asarray(samples.errors_enu)
    needed = PROBABILITY * len(errors[1::2])
    halves = [one[np.isfinite(one).all(axis=1)][:, :2] for one in (errors[::2], errors[1::2])]
    middle = np.median(halves[0], axis=0)
    near = halves[0]
    for _ in range(4):  # the nearer half in units of its own covariance
        cov = np.cov(near.T)
        far = np.einsum("ni,ij,nj->n", halves[0] - middle, np.linalg.inv(cov), halves[0] - middle)
        near = halves[0][far <= np.median(far)]
    values, vectors = np.linalg.eigh(cov)
    found = []
    for cells in CELLS:
        side = np.sqrt(values) * math.sqrt(4.6 * math.pi / 0.307 / cells)  # 0.307: their variance over that of all
        row, col = np.floor((np.concatenate(halves) - middle) @ vectors / side).astype(int).T
        places, which = np.unique(row * (np.ptp(col) + 1) + col - col.min(), return_inverse=True)
        chosen, held = (np.bincount(x, minlength=len(places)) for x in np.split(which, [len(halves[0])]))
        order = np.argsort(-chosen, kind="stable")
        number = int(np.searchsorted(np.cumsum(held[order]), needed))
        if chosen[order[min(number, len(order) - 1)]] > 0:
            found.append((number + 1) * float(np.prod(side)))
    return min(found)


def judged(dem: Dem, looks: Cases, i: int, seed: int, find_least: bool) -> tuple[Look, Region] | None:
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
    least = least_area(drawn(dem, looks, i, seed, SAMPLES, FOR_LEAST)) / circle if find_least else None
    return Look(content, truth > 0.5, region.area / circle, pieces, seconds, down, least), region


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
LEAST = [
    Column("terrain"),
    Column("looks"),
    Column("smallest area over circle, median"),
    Column("region's area over circle, of the same looks", "", "lower"),
    Column("region's over smallest, median", "", "lower"),
    Column("largest", "", "lower"),
    Column("smallest area below half of the circle", "% of looks"),
    Column("region's", "% of looks", "higher"),
]
PIECES = [
    Column("terrain"),
    Column("looks"),
    Column("pieces"),
    Column("within their interval", "%"),
    Column("off, most", "points"),
]


def row(name: str, looks: list[Look]) -> list[Any]:
    content, truth, ratio, pieces, seconds, *_ = (np.array(x) for x in zip(*looks, strict=True))
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


def looks_of(name: str, dem: Dem, targets: int, seed: int) -> list[Cases]:
    """Looks at a terrain; at mountains two thirds are oblique."""
    if name in LEVEL:
        return [cases(dem, targets, seed, DEPRESSIONS)]
    steep = targets // 3
    return [cases(dem, targets - steep, seed, OBLIQUE), cases(dem, steep, seed + 50, STEEPER)]


def study(targets: int, some: int, pieces: int, fresh: int) -> list[Table]:
    """The tables, by class of terrain; smallest areas for some looks of each."""
    found: dict[str, list[Look]] = {}
    checked: dict[str, list[tuple[bool, float]]] = {}
    many: dict[str, int] = {}
    lost = 0
    classes = {name: dems for name, dems in terrains(fresh).items() if "set on" not in name}
    for number, (terrain, dems) in enumerate(classes.items()):
        for k, dem in enumerate(dems):
            seed = fresh + 1000 * number + 100 * k
            for part, looks in enumerate(looks_of(terrain, dem, targets, seed)):
                for order, i in enumerate(seen(dem, looks)):
                    one = judged(dem, looks, i, seed + 50 * part + i, order < some)
                    if one is None:
                        lost += 1
                        continue
                    is_steep = terrain not in LEVEL and one[0].depression >= OBLIQUE[1]
                    name = f"{terrain}, steep" if is_steep else terrain
                    found.setdefault(name, []).append(one[0])
                    if one[0].pieces > 1 and many.get(name, 0) < pieces:
                        many[name] = many.get(name, 0) + 1
                        checked.setdefault(name, []).extend(shares(dem, looks, i, seed + 50 * part + i, one[1]))
        print(terrain, row(terrain, found[terrain]), file=sys.stderr, flush=True)
    oblique = [look for name, looks in found.items() if name not in LEVEL and "steep" not in name for look in looks]
    steep = [look for name, looks in found.items() if "steep" in name for look in looks]
    every = [look for looks in found.values() for look in looks]
    groups = {"all": every, "all mountains, oblique": oblique, "all mountains, steep": steep, **found}
    table = Table(f"Regions of {100 * PROBABILITY:g} % from {SAMPLES} samples, {FRESH} fresh ones", LOOKS)
    table.rows = [row(name, looks) for name, looks in groups.items() if looks]
    table.notes.append(f"{lost} looks left out: {100 * (1 - PROBABILITY):g} % or more of their samples have no ground")
    down = Table("Area of the region over that of the circle, by depression", DOWN)
    for name, looks in (("all", every), ("mountains", oblique + steep)):
        for low, high in itertools.pairwise(STEEP):
            ratio = [look.ratio for look in looks if low <= look.depression < high]
            down.rows.append([name, f"{low:g} to {high:g}", len(ratio), float(np.median(ratio)) if ratio else None])
    areas = Table(f"Smallest areas that hold {100 * PROBABILITY:g} % of {FOR_LEAST} samples", LEAST)
    areas.rows = [least_row(name, looks) for name, looks in groups.items() if any(look.least for look in looks)]
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
    return [table, areas, down, parts]


def least_row(name: str, looks: list[Look]) -> list[Any]:
    """Smallest areas and those of the regions, of the looks for which they were found."""
    pairs = np.array([(look.least, look.ratio) for look in looks if look.least is not None])
    (least, own), over = np.median(pairs, axis=0), pairs[:, 1] / pairs[:, 0]
    below = 100.0 * np.mean(pairs < 0.5, axis=0)
    figures = [least, own, np.median(over), over.max(), *below]
    return [name, len(pairs), *(float(x) for x in figures)]


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
    parser.add_argument("--targets", type=int, default=78, help="looks at each terrain")
    parser.add_argument("--least", type=int, default=4, help="looks of each kind at each terrain with a smallest area")
    parser.add_argument("--pieces", type=int, default=8, help="looks of each class whose pieces are checked")
    parser.add_argument("--fresh", type=int, default=0, help="a number: other synthetic terrain and looks than before")
    options = parser.parse_args()
    for table in study(options.targets, options.least, options.pieces, options.fresh):
        print(table.markdown())


if __name__ == "__main__":
    main()

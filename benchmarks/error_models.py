"""Study of `validate` and `calibrate_errors` on simulated flights, through the exact forward model.

Each set has flights over hills (default 3 flights of 8 images, 3 check points in each image), whose attitude, position
and boresight err by drawn errors. Under the true model p-values must be uniform and coverage nominal, under sigmas half
or twice the true ones a test must refuse; calibrated intervals must contain the true sigmas in 95 %.

Run: python benchmarks/error_models.py [--sets 200] [--seed 0] [--flights 3] [--images 8] [--pixels 3]
"""

from __future__ import annotations

import argparse
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
import scipy.stats
from measuring import Column, Table

import jaxgeo
from jaxgeo.uncertainty import Calibration, Validation, calibrate_errors, validate
from tests.support.check_points import block, hills, simulated, true_errors

STATED = 0.5  # times the true sigmas, in calibrations


def main() -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name, usual in (("sets", 200), ("seed", 0), ("flights", 3), ("images", 8), ("pixels", 3)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    given = parser.parse_args()
    jaxgeo.enable_x64()
    terrain, made = hills(), block(given.flights, given.images, given.pixels)
    true, refused, calibrations = [], {0.5: [], 2.0: []}, []
    spent = {"validate": 0.0, "calibrate": 0.0}
    for number in range(given.sets):
        points = simulated(true_errors(), given.seed + number, terrain, made)
        began = time.process_time()
        true.append(validate(points, terrain, true_errors()))
        spent["validate"] += time.process_time() - began
        for factor, found in refused.items():
            found.append(not validate(points, terrain, true_errors(factor)).is_consistent)
        began = time.process_time()
        calibrations.append(calibrate_errors(points, terrain, true_errors(STATED)))
        spent["calibrate"] += time.process_time() - began
    print(of_validation(true, refused).markdown())
    print(of_calibration(calibrations).markdown())
    print(", ".join(f"{name} {1e3 * one / given.sets:.0f} ms of processor time a set" for name, one in spent.items()))


def of_validation(true: list[Validation], refused: dict[float, list[bool]]) -> Table:
    """Uniformity of p-values, mean coverage, and power."""
    table = Table("validate", [Column("statistic"), Column("value"), Column("wanted")])
    p_values: dict[str, list[float]] = {}
    for one in true:
        for name, p in one.tests.items():
            p_values.setdefault(f"p of {name}", []).append(p)
    for name, values in p_values.items():
        test = scipy.stats.kstest(values, "uniform")
        below = np.mean(np.array(values) < 0.05)
        table.rows.append([name, f"uniform: p = {test.pvalue:.2f}; {100 * below:.1f} % below 5 %", "5 %"])
    for number, one in enumerate(true[0].coverage):
        shares = np.array([each.coverage[number].share for each in true])
        held = np.mean([c.low <= c.level <= c.high for c in (each.coverage[number] for each in true)])
        error = shares.std(ddof=1) / np.sqrt(len(shares))
        told = f"{100 * shares.mean():.1f} ± {100 * error:.1f} % inside; interval holds in {100 * held:.1f} %"
        table.rows.append([one.name, told, f"{100 * one.level:g} %; 95 % or more"])
    consistent = np.mean([one.is_consistent for one in true])
    table.rows.append(["true model accepted", f"{100 * consistent:.1f} %", "95 % or more"])
    for factor, found in refused.items():
        table.rows.append([f"{factor:g} times the true sigmas refused", f"{100 * np.mean(found):.1f} %", "100 %"])
    return table


def of_calibration(found: list[Calibration]) -> Table:
    """Coverage of the intervals and the median of the calibrated sigmas."""
    table = Table(
        "calibrate_errors",
        [Column("source"), Column("interval holds"), Column("normal interval holds"), Column("median"), Column("true")],
    )
    for number, one in enumerate(found[0].components):
        each = [calibration.components[number] for calibration in found]
        true = 1.0 / STATED
        held = np.mean([c.least <= true <= c.most for c in each])
        normal = np.mean([c.scale > 0.0 and abs(np.log(c.scale / true)) <= 1.96 * c.standard_error for c in each])
        zeros = np.mean([c.scale == 0.0 for c in each])
        table.rows.append(
            [
                one.label,
                f"{100 * held:.1f} %",
                f"{100 * normal:.1f} %",
                f"{np.median([c.scale for c in each]):.3f}; {100 * zeros:.0f} % zero",
                f"{true:g}",
            ]
        )
    return table


if __name__ == "__main__":
    main()

"""Blunder detection in simulated blocks: detected share of detectable blunders, and false alarms.

Run: python -m benchmarks.blunders [--blocks 200] [--clean 100] [--json [out.json]]

Each block has one to three blunders of 5 to 10,000 px: in an image measurement, a control coordinate, two exchanged
image measurements or control points, a control point in the wrong zone. `without_blunders` tests at a level such that
any correct measurement of a block is flagged with at most 5 % probability. Detectability is defined in
`tests/support/blunder_study.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")  # many shapes, small blocks
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np

import jaxgeo
from jaxgeo.adjust import ControlElsewhere, adjust, blunders, without_blunders
from tests.support import blunder_study as study

jaxgeo.enable_x64()


def spoiled(count: int) -> tuple[list[study.Outcome], list[str]]:
    """Outcomes of blocks with blunders, and the failed runs."""
    outcomes, failed = [], []
    for number, (layout, seed, kinds) in enumerate(study.drawn(count)):
        case = study.spoiled(layout, seed, kinds)
        begin = time.perf_counter()
        try:
            found = without_blunders(case.block, alpha=study.familywise(case.block))[1]
        except Exception as error:
            failed.append(f"{layout.name}, seed {seed}, {kinds}: {type(error).__name__}: {error}")
            found = []
        outcomes.append(study.outcome(case, found))
        lost = [one for one, named in outcomes[-1].named if one.can_be_told and not named]
        seconds = time.perf_counter() - begin
        note = f"; not named: {lost}" if lost else ""
        note += f"; named but right: {[str(b) for b in outcomes[-1].false]}" if outcomes[-1].false else ""
        print(f"{number:3d} {layout.name}: {', '.join(kinds)}; {seconds:.1f} s{note}", flush=True)
    return outcomes, failed


def table(outcomes: list[study.Outcome]) -> list[dict[str, Any]]:
    """By kind: number of blunders, detectable ones, detected share of these; detected of all others."""
    every = [pair for outcome in outcomes for pair in outcome.named]
    rows = []
    for kind in (*study.KINDS, "all"):
        mine = [(one, named) for one, named in every if kind in (one.kind, "all")]
        told = [named for one, named in mine if one.can_be_told]
        rest = [named for one, named in mine if not one.can_be_told]
        rows.append({"kind": kind, "made": len(mine), "can_be_told": len(told), "named": sum(told)})
        rows[-1] |= {"share": sum(told) / len(told) if told else None}
        rows[-1] |= {"not_detectable": sum(not one.detectable for one, _ in mine)}
        rows[-1] |= {"not_separable": sum(one.detectable and not one.separable for one, _ in mine)}
        rows[-1] |= {"named_of_these": sum(rest)}
    return rows


def clean(count: int) -> dict[str, Any]:
    """Blocks without blunders: number with a false alarm, and number of measurements that fail tests at 0.001 each."""
    with_names, tests, fails, screened = 0, 0, 0, 0
    for number in range(count):
        layout = study.LAYOUTS[number % len(study.LAYOUTS)]
        block = study.clean(layout, 5000 + number).block
        found = without_blunders(block, alpha=study.familywise(block))[1]
        with_names += bool(found)
        adjustment = adjust(block)
        screened += len(adjustment.screened)
        tests += len(block.observations) + (0 if block.control is None else len(block.control))
        fails += len(blunders(adjustment, alpha=0.001))
    return {
        "blocks": count,
        "with_names": with_names,
        "stated_share": 0.05,
        "tests_at_0.001": tests,
        "fails_at_0.001": fails,
        "screened": screened,
    }


def whole_control(count: int) -> dict[str, int]:
    """Blocks whose control is all in a wrong zone: refused, with the reported shift correct to 1 %."""
    refused = 0
    for number in range(count):
        layout = study.LAYOUTS[number % len(study.LAYOUTS)]
        case, off = study.all_in_wrong_zone(layout, 9000 + number, neighbour=number % 2 == 0)
        error = study.refusal(adjust, case)
        if isinstance(error, ControlElsewhere):
            refused += bool(np.linalg.norm(error.shift - off) < 0.01 * np.linalg.norm(off))
    return {"blocks": count, "refused": refused}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--blocks", type=int, default=200)
    parser.add_argument("--clean", type=int, default=100)
    parser.add_argument("--json", nargs="?", const="blunders.json")
    args = parser.parse_args()
    outcomes, failed = spoiled(args.blocks)
    rows = table(outcomes)
    told = {
        "kinds": rows,
        "false_names": sum(len(outcome.false) for outcome in outcomes),
        "blocks_with_false_names": sum(bool(outcome.false) for outcome in outcomes),
        "failed": failed,
        "clean": clean(args.clean),
        "whole_control": whole_control(20),
    }
    for row in rows:
        share = "-" if row["share"] is None else f"{100.0 * row['share']:.1f} %"
        print(
            f"{row['kind']:<32} made {row['made']:4d}, can be told {row['can_be_told']:4d}, named {row['named']:4d} "
            f"({share}); not detectable {row['not_detectable']:3d}, not separable {row['not_separable']:3d}, "
            f"named of these {row['named_of_these']:3d}"
        )
    print(json.dumps({name: value for name, value in told.items() if name != "kinds"}, indent=1))
    if args.json:
        pathlib.Path(args.json).write_text(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()

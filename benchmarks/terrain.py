"""Ray/terrain intersection benchmarks: jaxgeo against its peers, scaling, and cost breakdown. Tables have units.

Run: python benchmarks/terrain.py [--only a,b] [--rays 100000] [--repeats 5] [--json out.json] [--markdown out.md]
The peers come with `pip install -e '.[bench]'`; a missing one is skipped, and the table gives the reason.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
from collections.abc import Callable

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # idle threads of one contender must not spin while another runs

import comparison
import growing
import jobs
import measuring
import orders
import parts
import peers

PARTS = {
    "a": "jaxgeo and its peers: speed, memory, wrong answers",
    "b": "cost and memory against the DEM's side and the batch",
    "c": "one straggler; a bundle of Monte Carlo rays",
    "d": "the papers' searches",
    "e": "on an accelerator",
    "f": "where a ray's time goes",
    "g": "more than one core",
    "h": "rays bent by the air",
    "i": "pixels of a sweep: from one shot, from a trajectory",
}


def _options() -> argparse.Namespace:
    letters = "; ".join(f"{letter}: {what}" for letter, what in PARTS.items())
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help=letters)
    parser.add_argument("--rays", type=int, default=jobs.MOST, help=f"rays of a, b, c, f to i; a: at most {jobs.MOST}")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peers", default=",".join(peers.FILES), help="which contenders of part a")
    parser.add_argument("--side", default="501,1001,2001,4001,8001", help="sides of part b, posts")
    parser.add_argument("--largest", type=int, default=1_000_000, help="largest batch of parts b and e, up to 1e8")
    parser.add_argument("--budget", type=float, default=120.0, help="seconds for one process of parts b and e")
    parser.add_argument("--device", choices=["cpu", "gpu", "tpu"], help="run part e there")
    parser.add_argument("--cache", type=pathlib.Path, default=jobs.CACHE, help="where rays and references are kept")
    parser.add_argument("--json", type=pathlib.Path, help="write the tables there as JSON")
    parser.add_argument("--markdown", type=pathlib.Path, help="write the tables there as Markdown")
    options = parser.parse_args()
    unknown = [name for name in options.peers.split(",") if name not in peers.FILES]
    unknown += [letter for letter in options.only.split(",") if letter not in PARTS]
    if unknown:
        parser.error(f"there is no {', '.join(unknown)}; parts: {', '.join(PARTS)}; peers: {', '.join(peers.FILES)}")
    if not 1 <= options.rays <= jobs.MOST or options.repeats < 1:
        parser.error(f"--rays must be 1 to {jobs.MOST} and --repeats at least 1")
    return options


def main() -> None:
    """Run the selected measurements, print and save them."""
    o = _options()
    sides = [int(side) for side in o.side.split(",")]
    tasks: dict[str, Callable[[], list[measuring.Table]]] = {
        "a": lambda: [
            *comparison.compare(o.peers.split(","), o.rays, o.repeats, o.cache),
            *orders.compare(o.rays, o.repeats, o.cache),
        ],
        "b": lambda: growing.growth(sides, o.rays, o.largest, o.repeats, o.budget, o.cache),
        "c": lambda: parts.batches(o.rays, o.repeats, o.cache),
        "d": lambda: parts.searches(min(o.rays, 2000), o.repeats),
        "e": lambda: parts.device(o.device, o.largest, o.repeats, o.budget, o.cache),
        "f": lambda: parts.stages(o.rays, o.repeats, o.cache),
        "g": lambda: parts.cores(o.rays, o.repeats, o.cache),
        "h": lambda: parts.air(o.rays, o.repeats, o.cache),
        "i": lambda: parts.motion(o.rays, o.repeats),
    }
    machine = measuring.machine()
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    head = f"{machine['processor']}, {machine['cores']} cores, {machine['memory_GiB']} GiB, {machine['system']}"
    print(f"{head}\nPython {machine['python']}, {versions}\n")
    record: dict = {"machine": machine, "idle": [], "tables": []}
    texts = [f"{head}; Python {machine['python']}, {versions}\n"]
    for letter in o.only.split(","):
        is_idle, figures = measuring.idle_check()
        print(f"[{letter}] {PARTS[letter]} ({figures})\n", flush=True)
        record["idle"].append({"part": letter, "idle": is_idle, "figures": figures})
        for table in tasks[letter]():
            table.notes.insert(0, f"before: {figures}")
            texts.append(table.markdown())
            print(texts[-1], flush=True)
            record["tables"].append({"part": letter, **table.record()})
            _write(o, record, texts)


def _write(options: argparse.Namespace, record: dict, texts: list[str]) -> None:
    if options.json:
        options.json.write_text(json.dumps(record, indent=1))
    if options.markdown:
        options.markdown.write_text("\n".join(texts))


if __name__ == "__main__":
    main()

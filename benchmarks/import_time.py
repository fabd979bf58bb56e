"""Import time of jaxgeo relative to `import jax`.

Each import runs in a fresh interpreter, alternating, after one warm-up round for the disk cache; medians are compared.

    python benchmarks/import_time.py [--rounds 11]

Metric: ratio of medians, no unit, lower is better, at most 1.5.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

CODE = "import time; start = time.perf_counter(); import {module}; print(time.perf_counter() - start)"
LIMIT = 1.5


def seconds_to_import(module: str) -> float:
    command = [sys.executable, "-c", CODE.format(module=module)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description="Ratio of import times, jaxgeo to jax.")
    parser.add_argument("--rounds", type=int, default=11)
    rounds = parser.parse_args().rounds
    times: dict[str, list[float]] = {"jax": [], "jaxgeo": []}
    for round_number in range(rounds + 1):
        for module, seconds in times.items():
            elapsed = seconds_to_import(module)
            if round_number > 0:
                seconds.append(elapsed)
    medians = {module: statistics.median(seconds) for module, seconds in times.items()}
    ratio = medians["jaxgeo"] / medians["jax"]
    print(json.dumps({"import_jax_s": medians["jax"], "import_jaxgeo_s": medians["jaxgeo"], "ratio": ratio}, indent=2))
    print(f"ratio {ratio:.2f}, at most {LIMIT}: {'ok' if ratio <= LIMIT else 'too slow'}")


if __name__ == "__main__":
    main()

"""The oldest versions that pyproject.toml allows, as constraints for pip: `>=` becomes `==`.

python .ci/oldest.py pyproject.toml > oldest.txt
"""

from __future__ import annotations

import pathlib
import re
import sys
import tomllib

BOUND = re.compile(r"(?P<name>[\w.-]+)(\[[\w,]+\])?>=(?P<version>[\w.]+)")
LATER = ("bench", "cuda", "docs")  # nothing in the tests needs them


def oldest(pyproject: pathlib.Path) -> list[str]:
    """Constraints for all that the package, its extras and its tests need."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    needed = project["dependencies"] + [one for name in extras if name not in LATER for one in extras[name]]
    found = [match for one in needed if (match := BOUND.match(one)) and match["name"] != project["name"]]
    return sorted({f"{match['name']}=={match['version']}" for match in found})


if __name__ == "__main__":
    print("\n".join(oldest(pathlib.Path(sys.argv[1]))))

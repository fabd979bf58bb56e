"""What sdist and wheel hold, against the files of the project.

python .ci/contents.py SOURCE DIST
"""

from __future__ import annotations

import pathlib
import sys
import tarfile
import zipfile

PACKAGE = "jaxgeo"
# Folders of the sdist.
WHOLE = (
    ".ci",
    ".github",
    "benchmarks",
    "docs",
    "native",
    "notebooks",
    "tests",
    "tools",
    PACKAGE,
)
META = ("CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "LICENSE", "README.md")
FILES = (*META, ".pre-commit-config.yaml", "Containerfile", "mkdocs.yml", "pyproject.toml")


def files_of(source: pathlib.Path, *folders: str) -> set[str]:
    """Names of the files in folders, from the project's root; caches apart."""
    found = [one for folder in folders for one in (source / folder).rglob("*") if one.is_file()]
    return {one.relative_to(source).as_posix() for one in found if "__pycache__" not in one.parts}


def compare(what: pathlib.Path, held: set[str], expected: set[str]) -> None:
    """End with a message where they are not the same."""
    missing, beyond = sorted(expected - held), sorted(held - expected)
    if missing or beyond:
        sys.exit(f"{what}: lacks {missing or 'nothing'}; holds {beyond or 'nothing'} that it should not")
    print(f"{what.name}: {len(held)} files")


def main(source: pathlib.Path, dist: pathlib.Path) -> None:
    """Both archives in `dist` against the project in `source`."""
    (wheel,), (sdist,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    package = files_of(source, PACKAGE)
    for needed in ("py.typed", "data/jacksboro.tif", "data/us_nga_egm96_15.tif", "data/demo_scene.toml"):
        assert f"{PACKAGE}/{needed}" in package, needed
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    told = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    compare(wheel, names - told, package)
    licences = {name.partition("/licenses/")[2] for name in told if "/licenses/" in name}
    expected = {"LICENSE", *(name for name in package if name.startswith(f"{PACKAGE}/data/LICENSE"))}
    compare(wheel.with_suffix(".licences"), licences, expected)
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    compare(sdist, held - {"PKG-INFO", ".gitignore"}, files_of(source, *WHOLE) | set(FILES))


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))

"""The floors of the house: a room imports only rooms on floors below it, or its own package."""

from __future__ import annotations

import ast
import pathlib

import pytest

# In order from the ground up. Rooms on one floor do not import each other.
FLOORS = [
    (
        "_typing _checks _elementary _numerics _record status least_squares _destination _partial _interruption "
        "_text_numbers _command _renamed batches"
    ).split(),
    ["earth", "rotations"],
    ["sensor", "terrain"],
    ["fix"],
    ["fix"],
    ["observation"],
    ["_arguments"],
    ["locate"],
    ["uncertainty"],
    ["adjust"],
    ["coverage", "register"],
    ["io", "plot", "scale"],
    ["studies", "demo"],
    ["report"],
    ["cli"],
    ["__main__"],
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
# Floor 0 is one package in all but name, and the earth may turn itself.
MAY_TALK = {frozenset(pair) for pair in [("_typing", room) for room in FLOORS[0]]} | {
    frozenset({"_checks", "_numerics"}),
    frozenset({"status", "_checks"}),
    frozenset({"_record", "_checks"}),
    frozenset({"_destination", "_partial"}),
    frozenset({"_partial", "_interruption"}),
    frozenset({"earth", "rotations"}),
}

HEAVY = {"rasterio", "pyproj", "pyogrio", "shapely"}  # only io/
LENT = {"coverage/polygons.py": {"shapely"}}  # when it is called
NUMPY_ROOMS = {"io", "plot", "demo", "studies", "cli", "report"}
# Files of the mathematical rooms that may use numpy, each for a reason.
NUMPY_FILES = {
    "_checks.py": "looks at dtypes and concrete values before anything is converted",
    "batches.py": "gathers finished batches, outside any trace",
    "_record.py": "carries records through pickles as they are",
    "_arguments.py": "looks at concrete values before they are traced",
    "adjust/adjustment.py": "hands out what an adjustment found, by name, outside any trace",
    "adjust/banded.py": "orders the images of a block, once and outside any trace",
    "adjust/block.py": "names and checks of records, outside any trace",
    "adjust/boresight.py": "picks images by name, outside any trace",
    "adjust/bundle.py": "the same as adjustment.py",
    "adjust/control_consensus.py": "starts from few points, outside any trace",
    "adjust/diagnosis.py": "names what finished iterations left",
    "adjust/hypotheses.py": "tests of finished residuals",
    "adjust/kept.py": "masks arrays of a block, outside any trace",
    "adjust/ray_consensus.py": "looks at rays before an adjustment, outside any trace",
    "adjust/screening.py": "the same, by name",
    "adjust/snooping.py": "tests of finished residuals, by name",
    "adjust/tie_start.py": "moves finished values as a whole",
    "adjust/calibration.py": "the same as adjustment.py",
    "adjust/reliability.py": "tests of finished residuals, by name",
    "adjust/omega_phi_kappa.py": "the same as adjustment.py",
    "adjust/summary.py": "the same as adjustment.py",
    "adjust/ground_points.py": "the same",
    "adjust/layout.py": "index arrays of a block, made once, outside any trace",
    "adjust/navigation.py": "the same as block.py",
    "adjust/problem.py": "puts a block into the order of its layout, outside any trace",
    "adjust/records.py": "the same as block.py",
    "adjust/resection.py": "starts from few points, outside any trace",
    "adjust/initial_points.py": "the same",
    "adjust/unknowns.py": "choices by name, outside any trace",
    "adjust/rank_defects.py": "puts directions into words",
    "coverage/_too_short.py": "looks at a flight before a plan of it is compiled, outside any trace",
    "coverage/clock.py": "nodes of a quadrature, and checks of concrete records",
    "coverage/flight.py": "flags of records, outside any trace",
    "coverage/footprint.py": "puts places into an outline until it is dense enough, outside any trace",
    "coverage/overlap.py": "the middle of an image, where the axis along the flight is found",
    "coverage/gaps.py": "counts and intervals of finished flights, roots over them, constants of the program",
    "coverage/polygons.py": "hands outlines to a library of polygons, outside any trace",
    "coverage/timing.py": "gathers the times of a plan, outside any trace",
    "fix.py": "puts fixes into plain numbers and words",
    "register/affine.py": "chooses among finished candidates, outside any trace",
    "register/blocks.py": "places of blocks and records, outside any trace",
    "register/comparison.py": "gathers finished ties, outside any trace",
    "register/residual_correlation.py": "judges finished residuals",
    "register/interpolation.py": "cuts images on the host, outside any trace",
    "register/images.py": "the images of a registration, outside any trace",
    "register/in_image.py": "gathers finished chunks",
    "register/on_map.py": "gathers finished tiles",
    "register/places.py": "gathers finished chunks",
    "register/render.py": "gathers finished chunks",
    "register/chance.py": "probabilities of finished choices",
    "register/choice.py": "the same as affine.py",
    "register/clusters.py": "the same",
    "register/consensus.py": "the same",
    "register/flattening.py": "checks of concrete images",
    "register/matching.py": "cuts windows and gathers finished batches, outside any trace",
    "register/orthoimage.py": "cuts windows out of images, outside any trace",
    "register/passes.py": "gathers tiles and ties of a pass, outside any trace",
    "register/peaks.py": "sizes and ellipses of searches, outside any trace",
    "register/plan.py": "plans a pass, outside any trace",
    "register/prediction.py": "puts places into arrays of one size",
    "register/rectify.py": "gathers finished tiles",
    "register/registration.py": "judges finished passes",
    "register/visibility_bounds.py": "slopes of a terrain, once and outside any trace",
    "register/chart.py": "nodes of polynomials, constants of the program",
    "register/ties.py": "checks and pads concrete tie points",
    "sensor/_interpolation.py": "which knots are neighbours, a constant of the program",
    "sensor/camera.py": "constants and checks of records, outside any trace",
    "sensor/gimbal.py": "the same",
    "sensor/platform.py": "the same",
    "sensor/pointing.py": "which knot is named in an error, outside any trace",
    "sensor/scanning.py": "the same as camera.py",
    "sensor/trajectory.py": "checks of knots, outside any trace",
    "status.py": "counts concrete statuses for reports",
    "uncertainty/accuracy_of_each.py": "judges finished looks, and puts samples into arrays, outside any trace",
    "uncertainty/chunks.py": "sizes of chunks and meshes of devices, outside any trace",
    "uncertainty/compare.py": "reads kept samples, after all computing",
    "uncertainty/metrics/_ball.py": "nodes of quadratures, constants of the program",
    "uncertainty/metrics/_radius.py": "the same",
    "uncertainty/metrics/exact.py": "checks of concrete covariances, outside any trace",
    "uncertainty/metrics/standards.py": "codes and categories of concrete figures",
    "uncertainty/sampled.py": "gathers the samples of finished chunks",
    "uncertainty/sources/base.py": "checks of concrete covariances, outside any trace",
    "terrain/_memory.py": "hands arrays over to JAX",
    "terrain/local_map.py": "fixed places and weights of a fit",
    "terrain/dem.py": "builds the record from a file's posts, outside any trace",
    "terrain/pyramid.py": "builds the bounds once, outside any trace",
    "uncertainty/intervals.py": "order statistics of concrete samples",
    "uncertainty/_optimum.py": "hands sigmas to and from SciPy's optimiser, outside any trace",
    "uncertainty/design.py": "checks bounds and costs, and keeps a finished design",
    "uncertainty/sensitivity.py": "sums and resamples finished samples",
    "uncertainty/sobol.py": "reads the table of direction numbers, a constant of the program",
}


def package() -> pathlib.Path:
    return pathlib.Path(__file__).resolve().parents[1] / "jaxgeo"


SOURCES = sorted(path.relative_to(package()).as_posix() for path in package().rglob("*.py"))


def imported_modules(source: str, path: str) -> set[str]:
    """Full names of all modules a file imports, those for type checking included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute in this project"
            module = node.module or ""
            names |= {f"jaxgeo.{alias.name}" for alias in node.names} if module == "jaxgeo" else {module}
    return names


def room_of(path: str) -> str:
    return pathlib.PurePosixPath(path).parts[0].removesuffix(".py")


def broken_rules(source: str, path: str) -> list[str]:
    """What in the file at `path` (relative to the package) goes against the floors, as sentences."""
    room = room_of(path)
    if room not in FLOOR:
        return [f"{path}: room '{room}' has no floor; give it one in FLOORS"]
    rules = []
    for name in sorted(imported_modules(source, path)):
        top, *rest = name.split(".")
        if top in HEAVY - LENT.get(path, set()) and room != "io":
            rules.append(f"{path} imports {name}: only io/ may")
        if top == "numpy" and room not in NUMPY_ROOMS and path not in NUMPY_FILES:
            rules.append(f"{path} imports numpy: the maths is jax.numpy")
        other = rest[0] if top == "jaxgeo" and rest else None
        if other is None or other == room or frozenset({room, other}) in MAY_TALK:
            continue
        if other not in FLOOR:
            rules.append(f"{path} imports {name} from the package's front; import it from its own room")
        elif FLOOR[other] >= FLOOR[room]:
            rules.append(f"{path} (floor {FLOOR[room]}) imports {name} (floor {FLOOR[other]})")
    return rules


@pytest.mark.parametrize("path", [path for path in SOURCES if path != "__init__.py"])
def test_imports_go_down(path: str) -> None:
    assert broken_rules((package() / path).read_text(), path) == []


@pytest.mark.parametrize(
    "path, line, rule",
    [
        ("sensor/camera.py", "from jaxgeo.terrain.dem import Dem", "floor 2"),
        ("earth/frames.py", "from jaxgeo.sensor import Pose", "floor 1"),
        ("earth/frames.py", "import rasterio.warp", "only io/"),
        ("locate.py", "from pyproj import CRS", "only io/"),
        ("rotations.py", "import numpy as np", "jax.numpy"),
        ("locate.py", "from jaxgeo import Geodetic", "front"),
        ("attic.py", "import jax", "no floor"),
        ("io/dem.py", "def f():\n    import jaxgeo.cli", "floor"),
    ],
)
def test_the_rules_bite(path: str, line: str, rule: str) -> None:
    assert any(rule in sentence for sentence in broken_rules(line, path))


def test_numpy_exceptions_are_used() -> None:
    for path in NUMPY_FILES:
        assert "numpy" in imported_modules((package() / path).read_text(), path), f"{path} needs no exception"

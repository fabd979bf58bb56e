"""Import rules of the package: layers, heavy libraries, and no NumPy calls in jitted code."""

from __future__ import annotations

import ast
import pathlib

import pytest
from support.numpy_in_jit import numpy_in_jitted_code

# From the lowest layer up: packages (or single modules) of `jaxgeo`. A package imports only packages of lower layers.
LAYERS = [
    (
        "_typing _checks _compile _digest _elementary _export _keywords _numerics _record status least_squares "
        "_destination _partial _interruption _program_cache _program_store _text_numbers _command _renamed _refusals "
        "_parallel _sweep _sweep_store batches _accelerator _blas_threads _native"
    ).split(),
    ["earth", "rotations"],
    ["sensor", "terrain"],
    ["fix"],
    ["observation"],
    ["_arguments"],
    ["_intersection"],
    ["_locate"],
    ["uncertainty"],
    ["adjust"],
    ["coverage", "ortho"],
    ["register"],
    ["ties"],
    ["io", "plot", "scale"],
    ["cluster", "studies", "demo"],
    ["report", "view"],
    ["cli"],
    ["__main__"],
]
LAYER = {package: number for number, packages in enumerate(LAYERS) for package in packages}
# Imports allowed within a layer.
WITHIN_LAYER = {frozenset(pair) for pair in [("_typing", package) for package in LAYERS[0]]} | {
    frozenset({"_checks", "_numerics"}),
    frozenset({"_elementary", "_numerics"}),
    frozenset({"status", "_checks"}),
    frozenset({"_compile", "_accelerator"}),
    frozenset({"_compile", "_checks"}),
    frozenset({"_compile", "_program_cache"}),
    frozenset({"_compile", "_program_store"}),
    frozenset({"_program_store", "_native"}),
    frozenset({"batches", "_compile"}),
    frozenset({"batches", "_accelerator"}),
    frozenset({"_sweep", "_sweep_store"}),
    frozenset({"_sweep", "_digest"}),
    frozenset({"_sweep", "_parallel"}),
    frozenset({"_record", "_checks"}),
    frozenset({"_record", "_export"}),
    frozenset({"_record", "_keywords"}),
    frozenset({"_destination", "_partial"}),
    frozenset({"_partial", "_interruption"}),
    frozenset({"earth", "rotations"}),
}

HEAVY = {"rasterio", "pyproj", "pyogrio", "shapely"}  # imported by io/ only
HEAVY_ELSEWHERE = {  # imported on call
    "coverage/polygons.py": {"shapely"},
    "uncertainty/_level_sets.py": {"shapely"},
    "uncertainty/_region_polygon.py": {"shapely"},
    "uncertainty/regions.py": {"shapely"},
}

# Functions whose NumPy calls in jitted code see no traced values, though the search cannot tell.
STATIC_NUMPY = {
    ("jaxgeo/_checks.py", "concrete"): "returns None for traced values before it calls NumPy",
    ("jaxgeo/_checks.py", "by_numpy_if_known"): "leaves traced values to JAX",
    ("jaxgeo/_checks.py", "_leaf_as_float64"): "takes the dtype of a Python number",
    ("jaxgeo/_arguments.py", "check_on_image"): "uses the image size, static fields of the camera",
    ("jaxgeo/_arguments.py", "thrown"): "is called with throw=True only, which check_throw refuses for traced values",
    (
        "jaxgeo/_arguments.py",
        "heights_of_camera_and_ground",
    ): "is called for a fix that is thrown, and on the host",
    ("jaxgeo/_compile.py", "Batches._found"): "runs a program on the values of a vmap that is called directly",
    ("jaxgeo/demo/scene.py", "_middle"): "uses the image size, static fields of the camera",
    ("jaxgeo/rotations.py", "_product_of_turns"): "uses NumPy where `by_numpy_if_known` passes it",
    ("jaxgeo/sensor/camera.py", "_array"): "converts the caller's lists and tuples; arrays pass unchanged",
    ("jaxgeo/sensor/pointing.py", "out_of_range"): "writes an error message, after `concrete` gave the status",
    ("jaxgeo/sensor/pointing.py", "_named"): "the same",
    ("jaxgeo/uncertainty/replicated.py", "mesh_of"): "makes an array of devices",
    ("jaxgeo/uncertainty/linear.py", "Derivatives.propagation"): "is called with known arguments only",
    ("jaxgeo/uncertainty/radii.py", "_at_hand"): "leaves traced values as they are",
    **{
        ("jaxgeo/uncertainty/metrics/_host.py", name): "is for known values; None is returned for traced ones"
        for name in ("host_radii", "_unit_radii", "_in_ball")
    },
}


def folder() -> pathlib.Path:
    return pathlib.Path(__file__).resolve().parents[1] / "jaxgeo"


SOURCES = sorted(path.relative_to(folder()).as_posix() for path in folder().rglob("*.py"))


def imported_modules(source: str, path: str) -> set[str]:
    """Full names of all modules imported by a file, those for type checking included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute in this project"
            module = node.module or ""
            names |= {f"jaxgeo.{alias.name}" for alias in node.names} if module == "jaxgeo" else {module}
    return names


def package_of(path: str) -> str:
    return pathlib.PurePosixPath(path).parts[0].removesuffix(".py")


def broken_rules(source: str, path: str) -> list[str]:
    """Violations of the import rules in the file at `path` (relative to the package), as sentences."""
    package = package_of(path)
    if package not in LAYER:
        return [f"{path}: package '{package}' has no layer; add it to LAYERS"]
    rules = []
    for name in sorted(imported_modules(source, path)):
        top, *rest = name.split(".")
        if top in HEAVY - HEAVY_ELSEWHERE.get(path, set()) and package != "io":
            rules.append(f"{path} imports {name}: only io/ may")
        other = rest[0] if top == "jaxgeo" and rest else None
        if other is None or other == package or frozenset({package, other}) in WITHIN_LAYER:
            continue
        if other not in LAYER:
            rules.append(f"{path} imports {name} from jaxgeo itself; import it from its own package")
        elif LAYER[other] >= LAYER[package]:
            rules.append(f"{path} (layer {LAYER[package]}) imports {name} (layer {LAYER[other]})")
    return rules


@pytest.mark.parametrize("path", [path for path in SOURCES if path != "__init__.py"])
def test_imports_go_down(path: str) -> None:
    assert broken_rules((folder() / path).read_text(), path) == []


@pytest.mark.parametrize(
    "path, line, rule",
    [
        ("sensor/camera.py", "from jaxgeo.terrain.dem import Dem", "layer 2"),
        ("earth/frames.py", "from jaxgeo.sensor import Pose", "layer 1"),
        ("earth/frames.py", "import rasterio.warp", "only io/"),
        ("_locate.py", "from pyproj import CRS", "only io/"),
        ("_locate.py", "from jaxgeo import Geodetic", "jaxgeo itself"),
        ("new.py", "import jax", "no layer"),
        ("io/dem.py", "def f():\n    import jaxgeo.cli", "layer"),
    ],
)
def test_violations_are_found(path: str, line: str, rule: str) -> None:
    assert any(rule in sentence for sentence in broken_rules(line, path))


@pytest.mark.costly
def test_no_numpy_on_traced_values() -> None:
    uses = numpy_in_jitted_code({f"jaxgeo/{path}": (folder() / path).read_text() for path in SOURCES})
    assert [str(use) for use in uses if (use.path, use.function) not in STATIC_NUMPY] == []
    assert set(STATIC_NUMPY) <= {(use.path, use.function) for use in uses}, "an exception is not needed any more"


HELPER = "import numpy as np\n\ndef helper(x):\n    return np.sum(x)\n"
IMPORTS = "import functools\nimport equinox as eqx\nimport jax\nimport jax.numpy as jnp\nimport numpy as np\n"
USES_HELPER = "from jaxgeo.b import helper\n\n@jax.jit\ndef f(x):\n    return helper(x)\n"


@pytest.mark.parametrize(
    "source, function",
    [
        ("@jax.jit\ndef f(x):\n    return np.sum(x)\n", "f"),
        ("@functools.partial(jax.jit, static_argnums=1)\ndef f(x, n):\n    return np.linalg.norm(x)\n", "f"),
        ("@eqx.filter_jit\ndef f(x):\n    return jax.tree.map(np.asarray, x)\n", "f"),
        ("@jax.custom_jvp\ndef f(x):\n    y = 2 * x\n    return np.sin(y)\n", "f"),
        ("@jax.custom_batching.custom_vmap\ndef f(x):\n    return np.sin(x)\n", "f"),
        ("@g.defjvp\ndef f(primals, tangents):\n    return np.sin(primals[0]), tangents[0]\n", "f"),
        ("@g.def_vmap\ndef f(size, batched, x):\n    return np.sin(x), True\n", "f"),
        ("def f(x):\n    return np.sum(x)\n\ng = jax.jit(f)\n", "f"),
        ("def f(x):\n    return np.sum(x)\n\ng, = map(jax.jit, (f,))\n", "f"),
        ("def f():\n    def g(x):\n        return np.sum(x)\n    return jax.jit(jax.vmap(g))\n", "f.g"),
        ("def g(x):\n    return np.sum(x)\n\n@jax.jit\ndef f(x):\n    return jax.vmap(g)(x)\n", "g"),
        ("def g(x):\n    return np.sum(x)\n\ndef h(x):\n    return g(x)\n\nf = jax.jit(lambda x: h(x))\n", "g"),
        ("def g(x):\n    return np.sum(x)\n\nTABLE = {'g': g}\n\n@jax.jit\ndef f(x):\n    return TABLE['g'](x)\n", "g"),
        (
            "class A:\n    def g(self, x):\n        return np.sum(x)\n\n    @jax.jit\n    def f(self, x):\n"
            "        return self.g(x)\n",
            "A.g",
        ),
        (
            "class A:\n    def g(self, x):\n        return x\n\nclass B(A):\n    def g(self, x):\n"
            "        return np.sum(x)\n\nclass C:\n    a: A\n\n@jax.jit\ndef f(c: C, x):\n    return c.a.g(x)\n",
            "B.g",
        ),
        (USES_HELPER, "helper"),
        ("from jaxgeo import b\n\n@jax.jit\ndef f(x):\n    return b.helper(x)\n", "helper"),
        ("import jaxgeo.b as b\n\n@jax.jit\ndef f(x):\n    return b.helper(x)\n", "helper"),
        ("from jaxgeo import helper as g\n\n@jax.jit\ndef f(x):\n    return g(x)\n", "helper"),
    ],
)
def test_numpy_in_jitted_code_is_found(source: str, function: str) -> None:
    sources = {
        "jaxgeo/__init__.py": "from jaxgeo.b import helper\n",
        "jaxgeo/a.py": IMPORTS + source,
        "jaxgeo/b.py": HELPER,
    }
    assert [use.function for use in numpy_in_jitted_code(sources)] == [function]


@pytest.mark.parametrize(
    "source",
    [
        "def f(x):\n    return np.sum(x)\n",
        "@jax.jit\ndef f(x: np.ndarray):\n    return x * np.pi + np.float64(1.0) + jnp.sum(x)\n",
        "@jax.jit\ndef f(x):\n    nodes, weights = np.polynomial.legendre.leggauss(8)\n    return nodes @ x\n",
        "@jax.jit\ndef f(x):\n    return x[np.arange(x.shape[0]) - 1]\n",
        "@jax.jit\ndef f(x):\n    known = concrete(x)\n    assert known is None or np.all(known > 0)\n    return x\n",
        "def g(n: int):\n    return np.arange(n)\n\n@jax.jit\ndef f(x):\n    return x + g(3)\n",
        "def f(x):\n    return np.asarray(jax.jit(jnp.sum)(x))\n",
        "def nodes():\n    return np.arange(3)\n\nNODES = nodes()\n\n@jax.jit\ndef f(x):\n    return x + NODES\n",
    ],
)
def test_numpy_elsewhere_is_allowed(source: str) -> None:
    assert numpy_in_jitted_code({"jaxgeo/a.py": IMPORTS + source}) == []

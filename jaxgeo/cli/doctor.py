"""`jaxgeo doctor`: what this installation has, what it lacks, and whether it computes right."""

from __future__ import annotations

import functools
import importlib.metadata
import platform
import re
import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import Any, NamedTuple

import typer
from rich.table import Table

from jaxgeo.cli._common import NO_ANSWER, Debug, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console, as_text
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import working

PACKAGES = (
    "jaxgeo",
    "jax",
    "jaxlib",
    "equinox",
    "optimistix",
    "numpy",
    "scipy",
    "rasterio",
    "pyproj",
    "shapely",
)
EXTRAS = ("plot", "report", "gis", "features", "video", "logs", "orthority", "cluster", "stac", "xarray")
DRIVERS = {"GTiff": "elevation models, orthoimages", "COG": "--cog", "VRT": "mosaics of tiles", "PNG": "images",
           "JPEG": "images", "JP2OpenJPEG": "JPEG 2000 images"}  # fmt: skip
VECTORS = {"GPKG": "-o x.gpkg"}
GEOIDS = {"EPSG:5773": "EGM96", "EPSG:3855": "EGM2008"}
CLOSE = 1e-3  # m: by how far a fix may miss


class State(StrEnum):
    """Whether a thing works, is absent but not needed by most, or fails."""

    ok = "ok"
    absent = "absent"
    failed = "failed"


class Finding(NamedTuple):
    """What was found of one thing, and what to do about it."""

    what: str
    state: State
    found: str
    remedy: str = ""


def doctor_command(as_json: AsJson = False, debug: Debug = False) -> None:
    """Check the installation: versions, 64-bit floats, caches, geoid grids, drivers, extras, and a first fix.

    The exit code is 1 if something that most commands need fails.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        with working("checking the installation"):
            found = [one for check in CHECKS for one in _guarded(check)]
        if as_json:
            rows = [{**one._asdict(), "state": one.state.value} for one in found]
            print_json("doctor", {"inputs": inputs, "findings": rows})
        else:
            _show(found)
        if any(one.state is State.failed for one in found):
            raise typer.Exit(NO_ANSWER)


def _guarded(check: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """The findings of a check; one that breaks off is a finding too."""
    try:
        yield from check()
    except Exception as error:
        what = check.__name__.strip("_").replace("_", " ")
        yield Finding(what, State.failed, f"{type(error).__name__}: {' '.join(str(error).split())}"[:300])


def _versions() -> Iterator[Finding]:
    yield Finding("Python", State.ok, f"{platform.python_version()}, {platform.platform()}")
    for name in PACKAGES:
        try:
            yield Finding(name, State.ok, importlib.metadata.version(name))
        except importlib.metadata.PackageNotFoundError:
            yield Finding(name, State.failed, "not installed", f"pip install {name}")


def _libraries() -> Iterator[Finding]:
    from jaxgeo.io.gdal_and_proj import versions

    yield from (Finding(name, State.ok, version) for name, version in versions().items())


def _floats_and_devices() -> Iterator[Finding]:
    import jax
    import jax.numpy as jnp

    from jaxgeo._checks import enable_x64

    enable_x64()
    one = jnp.asarray(6_378_137.0) + 1e-6  # a micrometre on the Earth
    is_exact = one.dtype == jnp.float64 and abs(float(one) - 6_378_137.000001) < 1e-9
    yield Finding("64-bit floats", State.ok if is_exact else State.failed, f"{one.dtype}")
    devices = ", ".join(f"{device.device_kind} ({device.platform})" for device in jax.devices())
    yield Finding("devices", State.ok, devices)


def _caches() -> Iterator[Finding]:
    from jaxgeo._program_cache import FOLDER, cache_folder
    from jaxgeo.io.archives import DemCache

    folder = cache_folder()
    if folder is None:
        yield Finding("compiled programs", State.absent, "not kept", f"name a writable folder in {FOLDER}; without one "
                      "every command compiles anew")  # fmt: skip
    else:
        size = sum(one.stat().st_size for one in folder.iterdir() if one.is_file())
        yield Finding("compiled programs", State.ok, f"{folder}, {size / 1e6:.3g} MB")
    cache = DemCache()
    size, most = cache.size() / 1e6, cache.largest / 1e6
    yield Finding("elevation models", State.ok, f"{cache.folder}, {size:.3g} of at most {most:.4g} MB")


def _geoids() -> Iterator[Finding]:
    from jaxgeo.io import undulation
    from jaxgeo.io.errors import VerticalDatumError

    for datum, name in GEOIDS.items():
        try:
            height = float(undulation(36.3, -84.2, datum))
            yield Finding(f"geoid {name}", State.ok, f"{datum}: {height:.2f} m at 36.3 N, 84.2 W")
        except VerticalDatumError:
            yield Finding(
                f"geoid {name}", State.absent, f"{datum}: its grid is not installed", f"jaxgeo dem --geoid {datum}"
            )


def _drivers() -> Iterator[Finding]:
    from jaxgeo.io.gdal_and_proj import drivers

    rasters, vectors = drivers()
    for name, use in DRIVERS.items():
        yield _driver(name, use, name in rasters, "use the wheel of rasterio from PyPI")
    for name, use in VECTORS.items():
        yield _driver(name, use, name in vectors, "pip install 'jaxgeo[gis]'")


def _driver(name: str, use: str, is_known: bool, remedy: str) -> Finding:
    what = f"GDAL {name}"
    return Finding(what, State.ok, use) if is_known else Finding(what, State.absent, f"missing: {use}", remedy)


def _extras() -> Iterator[Finding]:
    for extra in EXTRAS:
        lacking = [name for name in _needed_by(extra) if not _is_installed(name)]
        if lacking:
            yield Finding(
                f"extra {extra}", State.absent, f"without {', '.join(lacking)}", f"pip install 'jaxgeo[{extra}]'"
            )
        else:
            yield Finding(f"extra {extra}", State.ok, "installed")


@functools.cache
def _needed_by(extra: str) -> tuple[str, ...]:
    """Names of the distributions of an extra, those of the extras in it too."""
    found: dict[str, None] = {}
    for line in importlib.metadata.requires("jaxgeo") or ():
        wanted, _, condition = line.partition(";")
        if re.search(rf"extra\s*==\s*['\"]{extra}['\"]", condition) is None:
            continue
        name, others = re.match(r"([A-Za-z0-9_.-]+)(?:\[([^\]]*)\])?", wanted.strip()).groups()  # pyright: ignore
        parts = [one for other in (others or "").split(",") if name == "jaxgeo" and other for one in _needed_by(other)]
        found |= dict.fromkeys(parts if name == "jaxgeo" else [name])
    return tuple(found)


def _is_installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _first_fix() -> Iterator[Finding]:
    """The fix of the packaged scene lies on the packaged elevation model, and projects back to its pixel."""
    import numpy as np

    import jaxgeo
    from jaxgeo.demo import scene_file
    from jaxgeo.io.scene import read_scene

    compile_quickly()
    scene, terrain = read_scene(scene_file()), jaxgeo.io.example_dem()
    assert scene.shot is not None
    camera: Any = scene.sensor.camera
    pixel = (0.5 * camera.width, 0.5 * camera.height)
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        fix = jaxgeo.locate(scene.sensor, scene.shot, pixel, terrain)
        _ = float(fix.slant_range)
        seconds.append(time.perf_counter() - began)
    off = abs(float(terrain.height_at(fix.position)) - float(fix.position.height))
    back = jaxgeo.project(scene.sensor, scene.shot, fix.position).uv
    turned = float(np.hypot(*(np.asarray(back) - pixel))) / float(np.asarray(camera.focal_px)[0])
    miss = max(off, turned * float(fix.slant_range))
    lat, lon, height = (float(one) for one in fix.position.to_degrees())
    place = f"{lat:.6f}, {lon:.6f}, {height:.2f} m"
    is_right = bool(miss < CLOSE)
    said = f"{place}; {seconds[0]:.2f} s the first time, {1e3 * seconds[1]:.1f} ms the second"
    remedy = "" if is_right else f"off by {miss:.3g} m: please report this"
    yield Finding("first fix", State.ok if is_right else State.failed, said, remedy)


CHECKS = (_versions, _libraries, _floats_and_devices, _caches, _geoids, _drivers, _extras, _first_fix)


def _show(found: list[Finding]) -> None:
    console = Console()
    if console.is_terminal:
        _print_table(console, found)
    else:
        _print_lines(found)
    counts = {state: sum(one.state is state for one in found) for state in State}
    console.print(
        f"{counts[State.ok]} ok, {counts[State.absent]} absent, {counts[State.failed]} failed", highlight=False
    )


def _print_lines(found: list[Finding]) -> None:
    """One line for each finding, without blanks at its end; remedies below."""
    states, names = (
        max(map(len, words)) for words in zip(*((one.state.value, one.what) for one in found), strict=True)
    )
    for one in found:
        typer.echo(as_text(f"{one.state.value:{states}}  {one.what:{names}}  {one.found}").rstrip())
        if one.remedy:
            typer.echo(as_text(f"{'':{states + names + 4}}-> {one.remedy}"))


def _print_table(console: Console, found: list[Finding]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    for overflow in ("ellipsis", "ellipsis", "fold"):
        table.add_column(overflow=overflow)
    styles = {State.ok: "green", State.absent: "yellow", State.failed: "bold red"}
    for one in found:
        said = one.found + (f"\n-> {one.remedy}" if one.remedy else "")
        table.add_row(f"[{styles[one.state]}]{one.state.value}[/]", one.what, said.replace("[", r"\["))
    console.print(table)

"""The native search against that of JAX: the same statuses, and the same points to what rounding leaves open."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.all_rays import all_rays
from support.fractal import fractal_posts

from jaxgeo import Atmosphere, Dem, FirstHit, Geodetic, Ray, Status, _native, intersect
from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.status import count_statuses
from jaxgeo.terrain import (
    AbstractField,
    ConstantField,
    GeographicGrid,
    LineField,
    SumField,
    TangentGrid,
    TransverseMercatorGrid,
)
from jaxgeo.terrain.search import native
from jaxgeo.terrain.search.reach import reach_of, way_of

pytestmark = pytest.mark.costly

SIDE, COUNT = 129, 2400
SAME = 1e-7  # m of clearance: what rounding leaves open, most at the walls of voids and at tangent rays
TIE = 1e-6  # m: a ray with another result over ground that is higher or lower by this is a tie
POSTS = 200.0 + fractal_posts(SIDE, spacing=30.0, relief=500.0, exponent=3.0, seed=4)

is_missing = _native.identity() is None
needs_native = pytest.mark.skipif(is_missing, reason="the package jaxgeo_native is not installed: pip install ./native")


def with_voids() -> np.ndarray:
    posts = POSTS.copy()
    posts[40:60, 70:95] = np.nan
    posts[100, 20:30] = np.nan
    return posts


def tangent() -> TangentGrid:
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    return TangentGrid.centred(centre, spacing=(30.0, 30.0), shape=POSTS.shape, heading=0.3)


def geographic() -> GeographicGrid:
    return GeographicGrid.from_affine((1 / 3600, 0.0, 179.99, 0.0, -1 / 3600, 47.0), POSTS.shape)


def utm() -> TransverseMercatorGrid:
    return TransverseMercatorGrid.from_affine(
        TransverseMercator.utm(31), (30.0, 0, 657596.0, 0, -30.0, 4987377.0), POSTS.shape
    )


def padded() -> Dem:
    posts = np.full((SIDE + 20, SIDE + 7), 9000.0)
    posts[:SIDE, :SIDE] = with_voids()
    return Dem.from_array(posts, tangent(), extent=POSTS.shape, void_ceiling=650.0)


TERRAINS: dict[str, Callable[[], Dem]] = {
    "float64, tangent": lambda: Dem.from_array(POSTS, tangent()),
    "float32, voids, geographic": lambda: Dem.from_array(with_voids().astype(np.float32), geographic()),
    "int16, UTM": lambda: Dem.from_array(POSTS.astype(np.int16), utm()),
    "padded, voids with a ceiling": padded,
    "one cell": lambda: Dem.from_array(np.array([[100.0, 120.0], [90.0, 150.0]]), geographic()),
}


@jax.jit
def _by_native(rays: Ray, dem: Dem, air: Any, field: Any) -> Any:
    return _intersected(rays, dem, air, field, FirstHit())


@jax.jit
def _by_jax(rays: Ray, dem: Dem, air: Any, field: Any) -> Any:
    return _intersected(rays, dem, air, field, FirstHit(native=False))


def _intersected(rays: Ray, dem: Dem, air: Any, field: Any, search: FirstHit) -> Any:
    def one(ray: Ray, field: Any) -> Any:
        ground = dem if field is None else dem.with_field(field)
        return intersect(ray, ground, search=search, atmosphere=air)

    return jax.vmap(one)(rays, field)


def assert_same(rays: Ray, dem: Dem, *, air: Any = None, field: Any = None, **limits: float) -> None:
    """The native search's results and those of JAX."""
    found = _by_native(rays, dem, air, field)
    assert_as_in_jax(found.status, found.slant_range, rays, dem, air, field, **limits)


def assert_as_in_jax(
    status: Any,
    slant_range: Any,
    rays: Ray,
    dem: Dem,
    air: Any = None,
    field: Any = None,
    *,
    same: float = SAME,
    most_ties: float = 1e-5,
) -> None:
    """Of every ray: the status, and the point but for rounding times the slowness of approach.

    Ties are left out: rays that have another result in JAX too, over ground that is a little higher or lower.
    """
    expected = _by_jax(rays, dem, air, field)
    status, slant_range = np.asarray(status), np.asarray(slant_range)
    apart = np.abs(slant_range - np.asarray(expected.slant_range))
    steepness = np.abs(np.cos(np.asarray(expected.incidence_surface)))
    differs = (status != np.asarray(expected.status)) | (apart * steepness > same)
    differs |= np.isnan(slant_range) != np.isnan(np.asarray(expected.slant_range))
    ties = differs & _is_tie(rays, dem, air, field, expected) if differs.any() else differs
    print(f"{differs.sum()} differ, {ties.sum()} of them ties; {count_statuses(expected.status)}")
    assert np.flatnonzero(differs & ~ties).tolist() == []
    assert ties.sum() <= most_ties * ties.size + 1


def _is_tie(rays: Ray, dem: Dem, air: Any, field: Any, expected: Any) -> np.ndarray:
    is_tie = np.zeros(rays.origin.shape[0], bool)
    for change in (TIE, -TIE):
        moved = _by_jax(rays, dem.with_posts(np.asarray(dem.posts, np.float64) + change), air, field)
        away = np.abs(np.asarray(moved.slant_range) - np.asarray(expected.slant_range))
        is_tie |= (np.asarray(moved.status) != np.asarray(expected.status)) | (away > 1.0)
    return is_tie


@needs_native
@pytest.mark.parametrize("name", TERRAINS)
def test_rays_of_all_kinds(name: str) -> None:
    dem = TERRAINS[name]()
    rays = all_rays(dem, COUNT, seed=1)
    assert_same(rays, dem)


@needs_native
def test_the_rays_have_nearly_every_status() -> None:
    dem = TERRAINS["padded, voids with a ceiling"]()
    statuses = set(count_statuses(_by_native(all_rays(dem, COUNT, seed=1), dem, None, None).status))
    reached = (
        "hit enters_from_side hits_void rises_away leaves_terrain ray_misses_terrain enters_below_terrain "
        "camera_below_terrain invalid_input"
    )
    assert {Status[name] for name in reached.split()} <= statuses


@needs_native
@pytest.mark.parametrize("count", [1, 7, 1000])
def test_batches_of_any_size(count: int) -> None:
    dem = TERRAINS["float64, tangent"]()
    rays = all_rays(dem, COUNT, seed=2)
    some = jax.tree.map(lambda x: x[:count], rays)
    found, expected = _by_native(some, dem, None, None), _by_native(rays, dem, None, None)
    np.testing.assert_array_equal(found.status, expected.status[:count])
    np.testing.assert_allclose(found.ecef, expected.ecef[:count], rtol=0, atol=1e-6)


LARGE = {
    "tangent": lambda: TangentGrid.centred(
        Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0), spacing=(900.0, 900.0), shape=POSTS.shape
    ),
    "geographic": lambda: GeographicGrid.from_affine((0.011, 0.0, 10.0, 0.0, -0.008, 47.5), POSTS.shape),
    "sheared": lambda: GeographicGrid.from_affine((0.011, 0.003, 10.0, 0.002, 0.008, 46.5), POSTS.shape),
    "to the pole": lambda: GeographicGrid.from_affine((0.5, 0.0, 0.0, 0.0, -0.008, 90.0), POSTS.shape),
    "around the Earth": lambda: GeographicGrid.from_affine((360 / (SIDE - 1), 0.0, 0.0, 0.0, -1.0, 64.0), POSTS.shape),
}


@needs_native
@pytest.mark.parametrize("grid", LARGE)
def test_blocks_and_rays_with_several_tracks(grid: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Grazing rays from far away over a large grid need more tracks than one."""
    monkeypatch.setattr("jaxgeo.terrain.search.first_hit.BLOCK", 700)
    dem = Dem.from_array(POSTS, LARGE[grid]())
    assert_same(all_rays(dem, COUNT + 1, seed=3), dem)  # so many are traced here only


@needs_native
def test_refracted_rays() -> None:
    dem = TERRAINS["float32, voids, geographic"]()
    assert_same(all_rays(dem, COUNT, seed=4), dem, air=Atmosphere())


def line(rng: np.random.Generator, count: int | None) -> LineField:
    shape = () if count is None else (count,)
    step = rng.uniform(-3.0, 3.0, (*shape, 2))
    return LineField(rng.uniform(-10.0, 10.0, (*shape, 65)), 64.0 - 32.0 * step, step)


def level(rng: np.random.Generator, count: int | None) -> ConstantField:
    return ConstantField(rng.uniform(-20.0, 20.0, () if count is None else (count,)))


@needs_native
def test_a_field_of_its_own_for_each_ray() -> None:
    dem, rng = TERRAINS["float32, voids, geographic"](), np.random.default_rng(1)
    field = SumField(SumField(level(rng, COUNT), line(rng, COUNT)), line(rng, COUNT))
    assert_same(all_rays(dem, COUNT, seed=5), dem, field=field)


@needs_native
def test_a_field_for_all_rays_and_one_for_each() -> None:
    dem, rng = TERRAINS["float32, voids, geographic"](), np.random.default_rng(2)
    assert_same(all_rays(dem, COUNT, seed=5), dem.with_field(line(rng, None)), field=level(rng, COUNT))


class Waves(AbstractField):
    """A field that the native search does not know."""

    size: Any

    def at(self, row: Any, col: Any) -> Any:
        return self.size * jnp.sin(row + 2.0 * col)

    def bounds(self) -> Any:
        return -jnp.abs(self.size), jnp.abs(self.size)


@needs_native
def test_terrains_that_it_does_not_know_are_searched_in_jax() -> None:
    dem = TERRAINS["float64, tangent"]()
    half = Dem.from_array(POSTS.astype(np.float16), tangent())
    of = lambda dem: native.serves(native.Ground.common(dem))  # noqa: E731
    assert of(dem)
    assert not of(half)
    waves = Waves(jnp.asarray(5.0))
    assert not of(dem.with_field(waves))
    rays = all_rays(dem, 64, seed=6)
    for other in (half, dem.with_field(waves)):
        text = _by_native.lower(rays, other, None, None).as_text()
        assert all(target not in text for target in _native.TARGETS.values())


@needs_native
def test_derivatives() -> None:
    dem = TERRAINS["float64, tangent"]()
    rays = all_rays(dem, 200, seed=7)

    def point(origin: Any, direction: Any, search: FirstHit) -> Any:
        return intersect(Ray(origin, direction), dem, search=search).ecef

    def slopes(search: FirstHit, derivative: Any) -> Any:
        of_one = derivative(lambda o, d: point(o, d, search), argnums=(0, 1))
        return jax.jit(jax.vmap(of_one))(rays.origin, rays.direction)

    expected = slopes(FirstHit(native=False), jax.jacfwd)
    for found in (slopes(FirstHit(), jax.jacfwd), slopes(FirstHit(), jax.jacrev)):
        for mine, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-6)


@needs_native
def test_exported_functions_need_no_native_search() -> None:
    pytest.importorskip("flatbuffers")
    dem = TERRAINS["float64, tangent"]()
    rays = all_rays(dem, 64, seed=8)
    function = jax.jit(jax.vmap(intersect, in_axes=(0, None)))
    assert _native.TARGETS["first_events"] in function.lower(rays, dem).as_text()
    exported = jax.export.export(function)(rays, dem)
    assert all(target not in exported.mlir_module() for target in _native.TARGETS.values())
    np.testing.assert_array_equal(exported.call(rays, dem).status, function(rays, dem).status)


@needs_native
def test_it_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    dem = TERRAINS["float64, tangent"]()
    rays = all_rays(dem, 63, seed=8)
    monkeypatch.setenv(_native.SWITCH, "0")
    assert not _native.is_native()
    apart = jax.jit(jax.vmap(lambda ray: intersect(ray, dem)))  # not traced before
    text = apart.lower(rays).as_text()
    assert all(target not in text for target in _native.TARGETS.values())


OF_TWO_DEVICES = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from tests.terrain.test_native import COUNT, TERRAINS, all_rays, _by_native
from jaxgeo import intersect
assert len(jax.devices()) == 2
dem = TERRAINS["float32, voids, geographic"]()
rays = all_rays(dem, COUNT, seed=9)
expected = _by_native(rays, dem, None, None)
mesh, spec = Mesh(np.array(jax.devices()), ("rays",)), PartitionSpec("rays")
each = jax.vmap(intersect, in_axes=(0, None))
sharded = jax.jit(jax.shard_map(each, mesh=mesh, in_specs=(spec, PartitionSpec()), out_specs=spec))
found = sharded(jax.device_put(rays, NamedSharding(mesh, spec)), dem)
np.testing.assert_array_equal(found.status, expected.status)
np.testing.assert_allclose(found.ecef, expected.ecef, rtol=0, atol=1e-6)
"""


@needs_native
def test_several_devices() -> None:
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    path = os.pathsep.join(sys.path)
    environment = {**os.environ, "XLA_FLAGS": flags, "PYTHONPATH": path}
    subprocess.run([sys.executable, "-c", OF_TWO_DEVICES], check=True, env=environment)


OF_OTHER_VECTORS = """
import sys, jax, numpy as np
jax.config.update("jax_enable_x64", True)
from tests.terrain.test_native import COUNT, TERRAINS, all_rays, _by_native
for number, name in enumerate(sys.argv[2:]):
    dem = TERRAINS[name]()
    found = _by_native(all_rays(dem, COUNT, seed=11), dem, None, None)
    np.savez(f"{sys.argv[1]}/{number}.npz", status=found.status, slant_range=found.slant_range)
"""


@needs_native
@pytest.mark.parametrize("vectors", ["avx2", "plain"])
def test_other_vectors(vectors: str, tmp_path: pathlib.Path) -> None:
    """Of those that the processor has; in a process of its own, which chooses once."""
    names = ["float64, tangent", "float32, voids, geographic"]
    environment = {**os.environ, _native.SWITCH: vectors, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", OF_OTHER_VECTORS, str(tmp_path), *names], check=True, env=environment)
    for number, name in enumerate(names):
        dem = TERRAINS[name]()
        with np.load(tmp_path / f"{number}.npz") as found:
            assert_as_in_jax(found["status"], found["slant_range"], all_rays(dem, COUNT, seed=11), dem)


@pytest.mark.parametrize("interface", [0, 999])
def test_another_interface_is_refused(interface: int, monkeypatch: pytest.MonkeyPatch) -> None:
    other = type(sys)("jaxgeo_native")
    other.INTERFACE = interface  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "jaxgeo_native", other)
    with pytest.warns(RuntimeWarning, match=f"interface {interface}"):
        assert _native._registered.__wrapped__() is None


def test_importing_jaxgeo_does_not_load_it() -> None:
    code = "import sys, jaxgeo; assert 'jaxgeo_native' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@needs_native
@pytest.mark.slow
@pytest.mark.parametrize("name", ["float64, tangent", "padded, voids with a ceiling", "float32, voids, geographic"])
def test_a_million_rays(name: str) -> None:
    """Ties are rays that start on the ceiling of a void, to within what coordinates in ECEF resolve: some hundred have
    another status in JAX too if it is compiled with other options."""
    dem = TERRAINS[name]()
    assert_same(all_rays(dem, 1_000_000, seed=10), dem, same=1e-6, most_ties=1e-3)


def few_rays(count: int = 4) -> tuple[Ray, Dem]:
    dem = TERRAINS["float64, tangent"]()
    return jax.tree.map(lambda x: x[:count], all_rays(dem, 400, seed=5)), dem


@needs_native
@pytest.mark.parametrize("name", _native.TARGETS)
@pytest.mark.parametrize("change", ["fewer arrays", "fewer rays", "another type"])
def test_other_arrays_than_it_takes_are_refused(name: str, change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They would be read beyond their ends."""
    rays, dem = few_rays(5)
    ground = dem if name == "first_events" else TERRAINS["float32, voids, geographic"]()
    called: list[Any] = []
    usual = jax.ffi.ffi_call

    def noted(target: str, results: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            called.append((target, results, args, options))
            return usual(target, results)(*args, **options)

        return call

    monkeypatch.setattr(jax.ffi, "ffi_call", noted)
    common = native.Ground.common(ground).bounded()
    native.walk_all(rays, way_of(common.each(reach_of, rays)), common, None)
    ((target, results, args, options), *_) = called
    assert target == _native.TARGETS[name]
    given = [np.zeros(np.shape(x), x.dtype) for x in args]
    if change == "fewer arrays":
        given.pop()
    if change == "fewer rays":
        given[0] = given[0][:-1]
    if change == "another type":
        given[3] = given[3].astype(np.float32)
    call = jax.jit(lambda *args: usual(target, results)(*args, **options))
    with pytest.raises(jax.errors.JaxRuntimeError, match="arrays of other sizes or types than it takes"):
        jax.block_until_ready(call(*given))


@needs_native
def test_numbers_of_another_kind_are_read_as_what_they_say() -> None:
    """A terrain made by hand may hold its sizes as integers of 64 bits."""
    rays, dem = few_rays()
    by_hand = dataclasses.replace(dem, extent=np.array(POSTS.shape))
    assert_same(rays, by_hand)


@needs_native
def test_it_answers_where_nothing_is_jitted() -> None:
    rays, dem = few_rays(1)
    ray = jax.tree.map(lambda x: x[0], rays)
    with jax.disable_jit():
        found = FirstHit().bracket(ray, dem)
    expected = FirstHit(native=False).bracket(ray, dem)
    assert int(found.status) == int(expected.status)
    np.testing.assert_allclose(found.near, expected.near, atol=1e-6)

"""Opening terrain that stays on disk: what is read and when, what is kept, and what is refused.

Held against: what `read_dem` gives of the same files (see `test_read_dem`). The file of kept bounds is our own, an
`.npz` of NumPy; it is checked, and made anew where it is another's.
"""

from __future__ import annotations

import pathlib
import pickle
import re

import jax
import numpy as np
import pytest
from rasterio.transform import Affine
from support.mosaics import (
    NORTH,
    SIZE,
    STEP,
    WEST,
    corner,
    cut,
    mixed_rays,
    rays_to,
    ridge_before_plain,
    same,
    write_vrt,
)
from support.rasters import hills, write

from jaxgeo import Fix, Ray, Status
from jaxgeo.io import DemError, intersect_files, open_dem, read_dem
from jaxgeo.io.locate_on_disk import _hits
from jaxgeo.io.sightlines import padded_rays

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.mark.costly
def test_only_the_corridor_is_read(ridge: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rays that cross the plain's middle ask nothing of the other tiles: neither their posts nor their bounds."""
    from jaxgeo.io import raster

    opened: list[str] = []
    read_tile = raster.read_tile
    monkeypatch.setattr(raster, "read_tile", lambda tile, *rest: opened.append(tile.path) or read_tile(tile, *rest))
    rays = rays_to(np.full(40, 110.0), np.linspace(100, 120, 40), 110.0, 0.5 * np.pi, np.radians(60.0), 2500.0)
    files = open_dem(ridge / "beside", vertical_datum="ellipsoid")
    assert opened == []
    fix = intersect_files(rays, files)
    assert np.all(np.asarray(fix.ok))
    rows = {re.search(r"n(\d)e", pathlib.Path(path).name).group(1) for path in opened}  # pyright: ignore
    assert rows <= {"4", "5", "6"}
    assert files.posts_loaded < 0.1 * SIZE**2
    assert files.blocks.posts_read < 0.25 * SIZE**2
    assert not files.blocks.is_read.all()


@pytest.mark.costly
def test_twenty_windows_compile_at_most_three_programs(ridge: pathlib.Path) -> None:
    rng = np.random.default_rng(5)
    files = open_dem(ridge / "shared", vertical_datum="ellipsoid")
    before, extents, kinds = _hits._cache_size(), set(), set()  # pyright: ignore[reportAttributeAccessIssue]
    for _ in range(20):
        row, col = rng.uniform(20, 180, (2, 1))
        rows, cols = row + rng.uniform(-8, 8, 30), col + rng.uniform(-15, 15, 30)
        some = rays_to(rows, cols, 110.0, rng.uniform(0, 6.3), 1.0, 2000.0)
        dem = files.corridor(some)
        extents.add(tuple(np.asarray(dem.extent).tolist()))
        kinds.add((jax.tree.structure(dem), tuple(leaf.shape for leaf in jax.tree.leaves(dem))))
        _hits(padded_rays(some), dem)
    print(f"{len(extents)} different windows, {len(kinds)} kinds of arrays")
    assert len(extents) > 15
    assert len(kinds) <= 3
    assert _hits._cache_size() - before <= 3  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
def test_bounds_are_kept_for_the_next_run(ridge: pathlib.Path, tmp_path: pathlib.Path, expected: Fix) -> None:
    cache = tmp_path / "ground.npz"
    first = open_dem(ridge / "shared", vertical_datum="ellipsoid", cache=cache)
    posts = ridge_before_plain()
    assert (first.lowest, first.highest) == (posts.min(), posts.max())
    assert first.blocks.posts_read >= SIZE**2
    again = open_dem(ridge / "shared", vertical_datum="ellipsoid", cache=cache)
    same(intersect_files(mixed_rays(), again), expected)
    assert again.blocks.posts_read == 0
    other = open_dem(ridge / "shared", vertical_datum=10.0, cache=cache)  # understood otherwise: made anew
    assert other.highest == posts.max() + 10.0
    cache.write_bytes(b"something else")
    with pytest.raises(DemError, match=r"ground\.npz: this is not a file of bounds .* Delete it, or name another"):
        open_dem(ridge / "shared", vertical_datum="ellipsoid", cache=cache)


@pytest.mark.costly
def test_a_stated_range_of_heights_spares_the_pass_and_is_checked(ridge: pathlib.Path, expected: Fix) -> None:
    posts, rays = ridge_before_plain(), mixed_rays()
    side = np.flatnonzero(expected.status == Status.leaves_terrain)[:4]
    some = Ray(rays.origin[side], rays.direction[side])
    files = open_dem(
        ridge / "shared", vertical_datum="ellipsoid", height_range=(float(posts.min()), float(posts.max()))
    )
    np.testing.assert_array_equal(intersect_files(some, files).status, expected.status[side])
    assert not files.blocks.is_read.all()
    wrong = open_dem(ridge / "shared", vertical_datum="ellipsoid", height_range=(0.0, 600.0))
    with pytest.raises(DemError, match=r"hold heights of .* beyond the height_range=\(0, 600\)"):
        intersect_files(rays, wrong)


REFUSED = {
    "an empty folder": (
        lambda d: d / "empty", DemError, r"empty: the folder holds no raster by its ending .* no files",
    ),
    "no match": (lambda d: d / "*.hgt", FileNotFoundError, r"\*\.hgt: no file matches this pattern"),
    "two files over the same posts": (
        lambda d: d / "twice", DemError, r"b_num\.tif: it covers the same posts as .*a_dem\.tif\. If both hold heights",
    ),
    "a source is missing": (
        lambda d: d / "missing.vrt", DemError,
        r"missing\.vrt: 1 of the 2 files that it is put together from do not exist, the first is .*gone\.tif",
    ),
    "a source off the grid": (
        lambda d: d / "off.vrt", DemError,
        r"off\.vrt: its source .*a_dem\.tif is not on the grid of the VRT .*column 0\.4",
    ),
    "another spacing": (
        lambda d: [d / "mixed" / "fine.tif", d / "mixed" / "coarse.tif"], DemError,
        r"coarse\.tif: its posts are spaced .*those of .*fine",
    ),
    "a file named twice": (lambda d: [d / "twice" / "a_dem.tif"] * 2, DemError, r"a_dem\.tif: the file is named twice"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_one_terrain_is_refused(tmp_path: pathlib.Path, case: str) -> None:
    for name in ("empty", "twice", "mixed"):
        (tmp_path / name).mkdir()
    a = write(tmp_path / "twice" / "a_dem.tif", np.full((5, 6), 3.0), affine=corner(0, 0))
    write(tmp_path / "twice" / "b_num.tif", np.full((5, 6), 7.0), affine=corner(0, 0))
    gone = write(tmp_path / "gone.tif", np.full((5, 6), 7.0), affine=corner(0, 6))
    write_vrt(tmp_path / "missing.vrt", [a, gone], (5, 12))
    write_vrt(tmp_path / "off.vrt", [a], (5, 7), shift=0.4)
    gone.unlink()
    write(tmp_path / "mixed" / "fine.tif", np.full((5, 6), 3.0), affine=corner(0, 0))
    coarse = Affine(2 * STEP, 0, WEST, 0, -2 * STEP, NORTH)
    write(tmp_path / "mixed" / "coarse.tif", np.full((5, 6), 3.0), affine=coarse)
    paths, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        open_dem(paths(tmp_path), vertical_datum="ellipsoid")
    with pytest.raises(error, match=message):
        read_dem(paths(tmp_path), vertical_datum="ellipsoid")


@pytest.mark.costly
def test_a_damaged_tile_is_named_when_a_ray_needs_it(ridge: pathlib.Path, tmp_path: pathlib.Path) -> None:
    cut(tmp_path / "tiles", ridge_before_plain(), shared=False, compress="deflate")
    bad = tmp_path / "tiles" / "n5e5.tif"
    content = bytearray(bad.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 400] = b"\x5a" * 400
    bad.write_bytes(content)
    files = open_dem(tmp_path / "tiles", vertical_datum="ellipsoid")
    assert np.all(np.asarray(intersect_files(rays_to([30.0], [150.0], 110.0, 0.0, 0.3, 2000.0), files).ok))
    with pytest.raises(DemError, match=r"n5e5\.tif: the file is damaged: the block in row 0 and column 0"):
        intersect_files(rays_to([110.0], [110.0], 110.0, 0.0, 0.3, 2000.0), files)


@pytest.mark.parametrize("name", ["vrt://{}?bands=1", "GTIFF_DIR:1:{}"])
def test_a_part_of_a_file_is_opened_also_from_a_pickle_in_another_folder(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    write(tmp_path / "a.tif", hills((9, 11)))
    monkeypatch.chdir(tmp_path)
    kept = pickle.dumps(open_dem(name.format("a.tif"), vertical_datum="ellipsoid"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert "9 x 11 posts" in repr(pickle.loads(kept))

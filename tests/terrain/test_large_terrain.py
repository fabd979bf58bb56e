"""What 32-bit indices can count: one limit for terrain, however it is made, exact up to its last texel."""

from __future__ import annotations

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from jaxgeo import Dem, Geodetic
from jaxgeo._checks import MOST_INDEXED, check_countable
from jaxgeo.io import DemError, read_dem
from jaxgeo.io.windows import padded_shape
from jaxgeo.ortho.interpolation import Pixels
from jaxgeo.terrain import TangentGrid
from jaxgeo.terrain.pyramid import _level_shapes, check_size, texel_of
from jaxgeo.uncertainty.sampling import Sampling, resolve_sampling

LARGEST = 40_133  # posts a side of a square terrain


def texels(posts: tuple[int, int]) -> int:
    return sum(rows * cols for rows, cols in _level_shapes((posts[0] - 1, posts[1] - 1)))


@pytest.mark.parametrize("posts", [(LARGEST, LARGEST), (2, 1_073_741_000), (1_000_000, 1610), (5, 300_000_000)])
def test_the_largest_terrain_has_every_texel_where_it_belongs(posts: tuple[int, int]) -> None:
    """Against Python's own whole numbers, at the corners of every level."""
    check_size(posts)
    cells = (posts[0] - 1, posts[1] - 1)
    place = jax.jit(lambda level, row, col: texel_of(cells, level, row, col))
    first = 0
    for level, (rows, cols) in enumerate(_level_shapes(cells)):
        for row, col in ((0, 0), (0, cols - 1), (rows - 1, 0), (rows - 1, cols - 1)):
            found = place(*(jnp.asarray(x, jnp.int32) for x in (level, row, col)))
            assert int(found) == first + row * cols + col
        first += rows * cols
    assert first <= MOST_INDEXED


def test_the_limit_is_the_last_size_that_can_be_counted() -> None:
    assert texels((LARGEST, LARGEST)) <= MOST_INDEXED < texels((LARGEST + 1, LARGEST + 1))
    with pytest.raises(ValueError, match=r"40134 x 40134 posts in one terrain .* too many: 2147\d+ to be indexed"):
        check_size((LARGEST + 1, LARGEST + 1))
    with pytest.raises(ValueError, match="too many"):
        check_size((40_200, 40_200))


def test_an_array_that_is_too_large_is_refused_before_memory_is_taken() -> None:
    posts = np.broadcast_to(np.int8(0), (40_200, 40_200))  # of no size in memory
    middle = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(middle, spacing=(1.0, 1.0), shape=(3, 3))
    with pytest.raises(ValueError, match=r"40200 x 40200 posts .* jaxgeo\.io\.open_dem"):
        Dem.from_array(posts, grid)


def test_a_file_that_is_too_large_is_refused_before_it_is_read(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        dtype="int16",
        count=1,
        width=40_200,
        height=40_200,
        crs="EPSG:32631",
        transform=Affine(1.0, 0.0, 4e5, 0.0, -1.0, 5e6),
        sparse_ok=True,
        tiled=True,
        blockxsize=4096,
        blockysize=4096,
    ):
        pass
    assert path.stat().st_size < 1e6
    monkeypatch.setattr("jaxgeo.io._memory_at_hand.memory_at_hand", lambda: 1 << 50)  # bytes: else that is told first
    with pytest.raises(DemError, match=r"large\.tif: 40200 x 40200 posts .* too many.*bounds=.*open_dem"):
        read_dem(path, vertical_datum=50.0)


def test_padding_does_not_make_a_terrain_too_large() -> None:
    assert padded_shape((3000, 3000)) == (3072, 3072)
    assert padded_shape((38_000, 38_000)) == (38_000, 38_000)


def test_images_and_samples_have_the_same_limit() -> None:
    check_countable(MOST_INDEXED, "things", "")
    with pytest.raises(ValueError, match=r"50000 x 50000 pixels in one image are too many"):
        Pixels.of(np.broadcast_to(np.uint8(0), (1, 50_000, 50_000)), None)
    with pytest.raises(ValueError, match=r"4294967296 samples are too many"):
        resolve_sampling(Sampling(count=2**32), 1)

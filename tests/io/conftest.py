"""Terrain that stays on disk, shared by the tests of it."""

from __future__ import annotations

import pathlib

import pytest
from support.mosaics import answers, corner, cut, mixed_rays, ridge_before_plain, whole, write_vrt
from support.rasters import write

from jaxgeo import Fix
from jaxgeo.io import blocks as blocks_module


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 16 cells, so that a small mosaic has as many as a large one has of 256."""
    monkeypatch.setattr(blocks_module, "BLOCK", 16)


@pytest.fixture(scope="session")
def ridge(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The same ground as one file, as tiles with shared borders, as tiles side by side, and as a VRT."""
    folder, posts = tmp_path_factory.mktemp("ridge"), ridge_before_plain()
    write(folder / "whole.tif", posts, affine=corner(0, 0))
    cut(folder / "shared", posts, shared=True)
    cut(folder / "beside", posts, shared=False)
    write_vrt(folder / "mosaic.vrt", sorted((folder / "beside").glob("*.tif")), posts.shape)
    return folder


@pytest.fixture(scope="session")
def expected(ridge: pathlib.Path) -> Fix:
    return answers(mixed_rays(), whole(ridge / "whole.tif"))

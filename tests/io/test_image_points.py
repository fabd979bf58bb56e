"""Image points: what is written reads back, and what cannot be meant is refused with row, image and point.

The format is our own, CSV, described in `read_image_points`; its layouts are those of `test_table_layouts`. Held
against: rows written by hand, apart from our writer.
"""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from jaxgeo.adjust.records import ImagePoints
from jaxgeo.io import TableError, read_image_points, write_image_points

PLAIN = "image,point,u,v\na,p1,10.25,-0.5\na,p2,11,12\nb,p1,1e3,7.125\n"


@pytest.fixture
def table(tmp_path: pathlib.Path):
    """Writes a table and returns its path."""

    def write(content: str) -> pathlib.Path:
        path = tmp_path / "points.csv"
        path.write_text(content, encoding="utf-8")
        return path

    return write


def test_points_are_read(table) -> None:
    points = read_image_points(table(PLAIN))
    assert points.image.tolist() == ["a", "a", "b"]
    assert points.point.tolist() == ["p1", "p2", "p1"]
    np.testing.assert_array_equal(points.uv, [[10.25, -0.5], [11.0, 12.0], [1000.0, 7.125]])
    np.testing.assert_array_equal(points.sigma, 1.0)


def test_standard_deviations(table) -> None:
    one = table("image,point,u,v,sigma_px,by\na,p,1,2,0.25,me\na,q,1,2,0.5,you\n")
    np.testing.assert_array_equal(read_image_points(one).sigma, [[0.25, 0.25], [0.5, 0.5]])
    two = table("sigma_v_px,sigma_u_px,v,u,point,image\n0.5,0.25,2,1,p,a\n")
    np.testing.assert_array_equal(read_image_points(two).sigma, [[0.25, 0.5]])


@pytest.mark.parametrize("sigma", [0.3, [0.1, 0.2, 0.3], [[0.1, 0.2], [0.1, 0.3], [1.0, 1.0]]])
def test_what_is_written_reads_back(tmp_path: pathlib.Path, sigma) -> None:
    uv = np.random.default_rng(3).uniform(-10.0, 20_000.0, (3, 2))
    points = ImagePoints(np.array(["a,1", "é", 'the "third"']), np.array(["1", "1", "2"]), uv, sigma)
    write_image_points(tmp_path / "points.csv", points)
    back = read_image_points(tmp_path / "points.csv")
    for name in ("image", "point", "sigma"):
        np.testing.assert_array_equal(getattr(back, name), getattr(points, name))
    np.testing.assert_allclose(back.uv, uv, atol=5.1e-7, rtol=0)  # px


REFUSED = {
    "missing": (PLAIN.replace("point", "pt"), r"no column point\. The columns needed are image, point, u, v"),
    "word": (PLAIN.replace("12", "twelve"), "row 3, column v: 'twelve' is not a number.* point 'p2' in image 'a'"),
    "nan": (PLAIN.replace("-0.5", "nan"), r"row 2, column v: unknown \(nan\).* It is point 'p1' in image 'a'"),
    "infinite": (PLAIN.replace("1e3", "inf"), "row 4, column u: 'inf' is not a number.* point 'p1' in image 'b'"),
    "twice": (PLAIN.replace("a,p2", "a,p1"), "rows 2 and 3: image a, point p1: measured twice; keep one"),
    "no image": (PLAIN.replace("b,", ","), "row 4, column image: the name is empty"),
    "cells": (PLAIN.replace("11,12", "11"), "row 3: 3 cells, but the header has 4"),
    "no rows": ("image,point,u,v\n", "no rows below the header"),
    "zero sigma": ("image,point,u,v,sigma_px\na,p,1,2,0\n", "column sigma_px: 0 is outside.* point 'p' in image 'a'"),
    "one sigma": ("image,point,u,v,sigma_u_px\na,p,1,2,1\n", "no column sigma_v_px, but sigma_u_px; give both"),
    "two sigmas": ("image,point,u,v,sigma_u_px,sigma_px\na,p,1,2,1,1\n", "sigma_px and sigma_u_px say the same"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_tables(table, case: str) -> None:
    content, words = REFUSED[case]
    with pytest.raises(TableError, match=f"points.csv.*{words}"):
        read_image_points(table(content))


def test_images_of_another_block(table) -> None:
    assert len(read_image_points(table(PLAIN), images=["a", "b", "c"])) == 3
    with pytest.raises(TableError, match=r"row 4, column image: 'b' is none of the 1 images known.* point 'p1'"):
        read_image_points(table(PLAIN), images=["a"])


def test_a_file_that_is_not_there(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no such table of image points"):
        read_image_points(tmp_path / "points.csv")

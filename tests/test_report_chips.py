"""Parts of images beside the map of a report: at the pixel, of bounded size, and none where there is no image."""

from __future__ import annotations

import base64
import io
import pathlib
import re

import numpy as np
import pytest
from PIL import Image
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.report.chips import SIDE, Chip, chip_of

SIZE = (900, 500)  # columns and rows of the camera
PIXELS = [(450.0, 250.0), (0.0, 0.0), (899.0, 499.0), (30.0, 480.0), (-0.5, 499.5)]


@pytest.fixture(scope="module")
def image(tmp_path_factory) -> pathlib.Path:
    """Red is the column and green the row, in steps of four pixels."""
    path = tmp_path_factory.mktemp("chips") / "image.png"
    row, column = np.indices((500, 900))
    Image.fromarray(np.stack([column // 4, row // 4, 0 * row], axis=-1).astype(np.uint8)).save(path)
    return path


def pixels_of(chip: Chip) -> np.ndarray:
    head, _, content = chip.source.partition(",")
    assert head == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(content))), np.float64)


@pytest.mark.parametrize("u, v", PIXELS)
def test_the_mark_is_at_the_pixel(image: pathlib.Path, u: float, v: float) -> None:
    chip = chip_of(image, SIZE, (u, v))
    assert chip is not None
    values = pixels_of(chip)
    assert values.shape == (SIDE, SIDE, 3)
    column = min(int(chip.left / 100.0 * SIDE), SIDE - 1)
    row = min(int(chip.top / 100.0 * SIDE), SIDE - 1)
    there = values[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4].mean(axis=(0, 1))  # JPEG is not exact
    np.testing.assert_allclose(there[:2], [max(u, 0.0) / 4.0, min(v, 499.0) / 4.0], atol=6.0)


def test_a_small_image_is_shown_whole(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "small.png"
    Image.new("RGB", (60, 40), (10, 20, 30)).save(path)
    chip = chip_of(path, (60, 40), (29.5, 9.5))
    assert chip is not None
    assert (chip.width, chip.height, chip.left, chip.top) == (60, 40, 50.0, 25.0)


def test_of_noise_it_is_small_too(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "noise.png"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (500, 900, 3), np.uint8)).save(path)
    chip = chip_of(path, SIZE, (450.0, 250.0))
    assert chip is not None
    assert len(chip.source) < 100_000


def test_there_is_none_without_an_image(tmp_path: pathlib.Path, image: pathlib.Path) -> None:
    """Outside it, of a file that is none, that is missing, and of another shape."""
    text = tmp_path / "text.jpg"
    text.write_text("no image")
    assert chip_of(image, SIZE, (900.0, 10.0)) is None
    assert chip_of(image, (500, 900), (10.0, 10.0)) is None
    assert chip_of(text, SIZE, (10.0, 10.0)) is None
    assert chip_of(tmp_path / "nowhere.jpg", SIZE, (10.0, 10.0)) is None


@pytest.mark.slow
def test_a_report_of_drone_images_shows_them(tmp_path: pathlib.Path) -> None:
    """At most six; of a scene none."""
    prepare(tmp_path, "DJI_0042.JPG scene.toml dem.tif")
    output = tmp_path / "report.html"
    pixels = [word for k in range(8) for word in ("--pixel", f"{2000 + 10 * k},1500")]
    ground = ["--ground", "300", "--details", "8", "-o", str(output)]
    of_image = [str(tmp_path / "DJI_0042.JPG"), "--camera-datum", "ellipsoid", *pixels]
    assert CliRunner().invoke(app, ["report", *of_image, *ground]).exit_code == 0
    page = output.read_text()
    assert len(re.findall('<img src="data:image/jpeg;base64,', page)) == 6
    assert "Fix 1: DJI_0042.JPG, pixel 20" in page
    assert CliRunner().invoke(app, ["report", str(tmp_path / "scene.toml"), *ground]).exit_code == 0
    assert "<img" not in output.read_text()

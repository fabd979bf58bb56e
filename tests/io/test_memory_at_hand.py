"""Rasters larger than memory at hand: told before a value is read, with what to do about it, and what is done works.

Held against: the memory that readings really take, NumPy's own sizes of the arrays that they give, and the limits of
the system as the shell sets them.
"""

from __future__ import annotations

import pathlib
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from jaxgeo.io import DemError, ImageError, open_dem, read_dem, read_image, read_orthoimage
from jaxgeo.io import _memory_at_hand as memory

PART = (9.0, 46.9, 9.001, 46.901)
FREE = 8e9  # bytes


def empty(path: pathlib.Path, side: int, **profile: Any) -> pathlib.Path:
    """A GeoTIFF of `side` x `side` zeros of which hardly anything is stored."""
    made = {"driver": "GTiff", "width": side, "height": side, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
    made |= {"transform": Affine(1, 0, 500_000, 0, -1, 5_200_000), "tiled": True, "sparse_ok": True, "bigtiff": "yes"}
    with rasterio.open(path, "w", **made | profile):
        return path


@pytest.fixture
def large(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.setattr(memory, "memory_at_hand", lambda: FREE)
    return empty(tmp_path / "large.tif", 44_000, blockxsize=1024, blockysize=1024)


def test_a_model_too_large_is_told_with_its_size_and_read_by_bounds(large: pathlib.Path) -> None:
    said = r"large\.tif: too large: 44,000 x 44,000 posts need about 48 GB of memory, and 8 GB are at hand\. .*bounds="
    with pytest.raises(DemError, match=said):
        read_dem(large, vertical_datum=0)
    assert read_dem(large, vertical_datum=0, bounds=PART).posts.size < 1e6
    assert open_dem(large, vertical_datum=0).shape == (44_000, 44_000)


def test_so_is_an_image(large: pathlib.Path) -> None:
    said = r"large\.tif: too large: 44,000 x 44,000 pixels of 1 bands need about 15 GB of memory, and 8 GB are at hand"
    for read in (read_image, read_orthoimage):
        with pytest.raises(ImageError, match=said):
            read(large)
    assert read_orthoimage(large, bounds=PART).shape < (1000, 1000)


def test_a_block_too_large_is_told_before_a_window_of_it_is_read(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = empty(tmp_path / "one_block.tif", 20_000, tiled=False, blockysize=20_000, compress="deflate")
    monkeypatch.setattr(memory, "memory_at_hand", lambda: 1e9)
    said = r"it is stored in blocks of 20,000 x 20,000 values, which each need about 1\.6 GB .*TILED=YES"
    for read in (lambda: read_dem(path, vertical_datum=0, bounds=PART), lambda: read_orthoimage(path, bounds=PART)):
        with pytest.raises((DemError, ImageError), match=said):
            read()


MEASURED = """
import sys, threading, time, rasterio
import jax
jax.config.update("jax_enable_x64", True)
from jaxgeo.io import read_dem, read_image
from jaxgeo.io import _memory_at_hand as memory
resident = lambda: 4096 * int(open("/proc/self/statm").read().split()[1])
read = {"dem": lambda path: read_dem(path, vertical_datum=0), "image": read_image}[sys.argv[1]]
with rasterio.Env(GDAL_CACHEMAX=16):
    read(sys.argv[3])
    needs, before, highest = [], resident(), 0
    memory.check_fits = lambda need, *rest: needs.append(need)
    import jaxgeo.io.dem, jaxgeo.io.images
    jaxgeo.io.dem.check_fits = jaxgeo.io.images.check_fits = memory.check_fits
    def watch():
        global highest
        while True:
            highest = max(highest, resident())
            time.sleep(0.002)
    threading.Thread(target=watch, daemon=True).start()
    answer = read(sys.argv[2])
print(max(needs), highest - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the memory of a process as Linux shows it")
@pytest.mark.parametrize("kind", ["dem", "image"])
@pytest.mark.parametrize("dtype", ["int16", "float32", "float64"])
def test_what_is_said_to_be_needed_is_what_is_taken(tmp_path: pathlib.Path, kind: str, dtype: str) -> None:
    side, files = 5000, []
    for name, n in (("large", side), ("small", 64)):
        path = empty(tmp_path / f"{name}.tif", n, dtype=dtype)
        with rasterio.open(path, "r+") as sink:
            sink.write((np.arange(n * n) % 900).reshape(n, n).astype(dtype), 1)
        files.append(str(path))
    command = [sys.executable, "-c", MEASURED, kind, *files]
    said, taken = map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    assert 0.6 * taken < said < 1.5 * taken


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_memory_at_hand_is_the_least_of_what_the_limits_leave(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = memory.memory_at_hand()
    assert 0.0 < machine <= 4096.0 * 1024.0 * 2**30
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    (tmp_path / "a" / "b").mkdir(parents=True)
    lines = {"/proc/self/cgroup": ["0::/a/b"]}
    plain = memory._lines
    monkeypatch.setattr(memory, "_lines", lambda path: lines.get(str(path)) or plain(path))
    (tmp_path / "a" / "b" / "memory.max").write_text("max\n")
    (tmp_path / "a" / "memory.max").write_text("3000000\n")
    (tmp_path / "a" / "memory.current").write_text("1000000\n")
    (tmp_path / "a" / "memory.stat").write_text("anon 5\ninactive_file 250000\n")
    assert memory._of_container() == 3_000_000 - 750_000
    assert memory.memory_at_hand() == 3_000_000 - 750_000


@pytest.mark.costly
@pytest.mark.skipif(sys.platform != "linux", reason="sets a limit as Linux has it")
def test_a_limit_of_the_process_counts() -> None:
    code = "from jaxgeo.io._memory_at_hand import _of_process as left; print(left())"
    limited = ["sh", "-c", f'ulimit -v {2**26}; exec "$0" "$@"', sys.executable, "-c", code]  # in KiB
    run = subprocess.run(limited, capture_output=True, text=True, check=True)
    assert 0.5 * 2**36 < float(run.stdout) < 2**36

"""Make the data files inside the package, in `jaxgeo/data/`, from their public sources.

    python tools/make_data.py --gtx egm96_15.gtx --jacksboro jacksboro_fault_dem.npz

`egm96_15.gtx` is in Debian's package proj-data (`apt-get download proj-data; dpkg-deb -x proj-data_*.deb .`, then
`usr/share/proj/egm96_15.gtx`). `jacksboro_fault_dem.npz` is in matplotlib's wheel, `mpl-data/sample_data/`; without
`--jacksboro` the installed matplotlib's own copy is taken. Both files are in the public domain at their origin. The
direction numbers of Joe and Kuo are taken from the installed scipy. See `jaxgeo/data/LICENSES.md`.
"""

from __future__ import annotations

import argparse
import pathlib

import numpy as np
import rasterio
from rasterio.transform import Affine

DATA = pathlib.Path(__file__).resolve().parents[1] / "jaxgeo" / "data"
CROSS_MOUNTAIN = (36.19833, -84.23056)  # 36 deg 11' 54" N, 84 deg 13' 50" W, the highest ground of the tile, 1077 m


def make_egm96(gtx: pathlib.Path) -> pathlib.Path:
    """The 15' grid as a GeoTIFF that PROJ selects by its name, with the metadata that PROJ's grid format asks for.

    PROJ's database knows the grid of EPSG:5773 as us_nga_egm96_15.tif; posts are copied, not resampled.
    """
    path = DATA / "us_nga_egm96_15.tif"
    with rasterio.open(gtx) as source:
        undulation, transform = source.read(1), source.transform
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "height": 721, "width": 1440, "crs": "EPSG:4979",
        "transform": transform,
        "compress": "deflate", "predictor": 3, "zlevel": 9, "tiled": True, "blockxsize": 256, "blockysize": 256,
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as sink:
        sink.update_tags(
            AREA_OR_POINT="Point",
            TYPE="VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL",
            target_crs_epsg_code="5773",
            area_of_use="World",
            TIFFTAG_IMAGEDESCRIPTION="WGS 84 (EPSG:4979) to EGM96 height (EPSG:5773), from egm96_15.gtx",
            TIFFTAG_COPYRIGHT="Derived from work by NGA. Public Domain",
        )
        sink.write(undulation, 1)
        sink.set_band_description(1, "geoid_undulation")
        sink.set_band_unit(1, "metre")
    return path


def make_jacksboro(npz: pathlib.Path) -> pathlib.Path:
    """The SRTM tile about the Jacksboro Fault, Tennessee, as a GeoTIFF that states both its datums.

    The archive's `ymax`, 36.44625, is the latitude of the *upper* edge of row 0; its `ymin`, 36.7329, is that plus the
    tile's height, where minus was meant. So the tile spans 36.15958 to 36.44625 deg north, one tile's height south of
    what swapping the two names would give. The ground agrees: the highest post then lies on Cross Mountain (1077 m),
    to the cell, which is checked below, and Jacksboro, Caryville and Norris Dam fall into place.
    """
    path = DATA / "jacksboro.tif"
    archive = np.load(npz)
    posts = archive["elevation"]
    west, north = float(archive["xmin"]), float(archive["ymax"])
    transform = Affine(float(archive["dx"]), 0.0, west, 0.0, -float(archive["dy"]), north)
    top = np.unravel_index(posts.argmax(), posts.shape)
    lon, lat = west + (top[1] + 0.5) * transform.a, north + (top[0] + 0.5) * transform.e
    if max(abs(lat - CROSS_MOUNTAIN[0]), abs(lon - CROSS_MOUNTAIN[1])) > float(archive["dx"]):
        raise ValueError(f"the highest post lies at {lat:.5f}, {lon:.5f}, not on Cross Mountain: {CROSS_MOUNTAIN}")
    profile = {
        "driver": "GTiff", "dtype": "int16", "count": 1, "height": posts.shape[0], "width": posts.shape[1],
        "crs": "EPSG:4326+5773", "transform": transform, "compress": "deflate", "predictor": 2, "zlevel": 9,
        "geotiff_version": "1.1",
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as sink:
        sink.update_tags(
            AREA_OR_POINT="Area",
            TIFFTAG_IMAGEDESCRIPTION="SRTM 3 arc-second heights (EGM96) about the Jacksboro Fault, Tennessee",
            TIFFTAG_COPYRIGHT="NASA/NGA SRTM, public domain; through matplotlib's sample data",
        )
        sink.write(posts, 1)
        sink.set_band_unit(1, "metre")
    return path


def make_direction_numbers(npz: pathlib.Path) -> pathlib.Path:
    """The first 1024 dimensions of new-joe-kuo-6, a line each: primitive polynomial, then its initial values."""
    path = DATA / "joe_kuo_2008.txt"
    archive = np.load(npz)
    lines = [
        "# Direction numbers of Sobol sequences: the first 1024 dimensions of new-joe-kuo-6.21201.",
        "# Copyright (c) 2008, Frances Y. Kuo and Stephen Joe. All rights reserved. Licence: LICENSE-joe-kuo.txt.",
        "# S. Joe and F. Y. Kuo 2008, Constructing Sobol sequences with better two-dimensional projections,",
        "# SIAM J. Sci. Comput. 30, 2635-2654.",
        "# A line for each dimension: the coefficients of its primitive polynomial as bits, then the initial values.",
    ]
    for polynomial, values in zip(archive["poly"][:1024].tolist(), archive["vinit"][:1024].tolist(), strict=True):
        degree = max(polynomial.bit_length() - 1, 1)
        lines.append(" ".join(map(str, [polynomial, *values[:degree]])))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gtx", type=pathlib.Path, help="egm96_15.gtx; without it that file is left alone")
    parser.add_argument("--jacksboro", type=pathlib.Path, help="jacksboro_fault_dem.npz")
    options = parser.parse_args()
    if options.jacksboro is None:
        import matplotlib

        options.jacksboro = pathlib.Path(matplotlib.get_data_path()) / "sample_data" / "jacksboro_fault_dem.npz"
    import scipy.stats

    numbers = pathlib.Path(scipy.stats.__file__).parent / "_sobol_direction_numbers.npz"
    made = [make_jacksboro(options.jacksboro), make_direction_numbers(numbers)]
    if options.gtx is not None:
        made.append(make_egm96(options.gtx))
    for path in made:
        print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()

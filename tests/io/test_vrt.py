"""VRTs: what their sources state is kept or compared, and one that resamples or computes is refused.

Held against: files that GDAL itself writes (`rasterio.shutil.copy`, `WarpedVRT`, `vrt://`), and VRTs laid out as
`gdalbuildvrt` writes them, which drops units and vertical CRS.
"""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import Resampling
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from support.rasters import DEGREE, hills, write

from jaxgeo.io import DemError, open_dem, read_dem
from jaxgeo.io.tiles import read_header

US_FOOT = 1200 / 3937
ROWS, COLS = 6, 8
POSTS = np.round(hills((ROWS, 2 * COLS)), 2)


def build_vrt(
    path: pathlib.Path,
    sources: list[pathlib.Path],
    *,
    crs: str = "EPSG:4326",
    band: str = "",
    inner: str = "",
    kind: str = "SimpleSource",
    nodata: float | None = -32768,
    at: list[tuple[float, float]] | None = None,
    shape: tuple[int, int] = (ROWS, 2 * COLS),
    dtype: str = "Float64",
    attributes: str = "",
) -> pathlib.Path:
    """Files side by side as `gdalbuildvrt` places them: no unit, no vertical CRS; `band` and `inner` add elements."""
    parts = []
    for index, source in enumerate(sources):
        col, row = (index * COLS, 0) if at is None else at[index]
        size = f'xSize="{COLS}" ySize="{ROWS}"'
        name = f'<SourceFilename relativeToVRT="1">{source.name}</SourceFilename><SourceBand>1</SourceBand>'
        rects = f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="{col}" yOff="{row}" {size}/>'
        parts.append(f"<{kind} {attributes}>{name}{rects}{inner}</{kind}>")
    tag = "" if nodata is None else f"<NoDataValue>{nodata}</NoDataValue>"
    path.write_text(
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>{crs}</SRS>'
        f"<GeoTransform>5.0, {DEGREE!r}, 0, 45.0, 0, {-DEGREE!r}</GeoTransform>"
        f'<VRTRasterBand dataType="{dtype}" band="1">{tag}{band}{"".join(parts)}</VRTRasterBand></VRTDataset>'
    )
    return path


def tiles(folder: pathlib.Path, *each: dict[str, Any], heights: np.ndarray = POSTS, **both: Any) -> list[pathlib.Path]:
    """The two halves of `heights` as GeoTIFFs, each with options of `write` of its own."""
    made = []
    for index in range(2):
        options = both | (each[index] if index < len(each) else {})
        affine = Affine(DEGREE, 0, 5.0 + index * COLS * DEGREE, 0, -DEGREE, 45.0)
        part = options.pop("heights", heights[:, index * COLS : (index + 1) * COLS])
        made.append(write(folder / f"{'ab'[index]}.tif", part, affine=affine, **options))
    return made


def heights(path: pathlib.Path | str, **options: Any) -> np.ndarray:
    return np.asarray(read_dem(path, vertical_datum=-30.0, **options).posts) + 30.0


STATED = {
    "unit of the band": ({"unit": "US survey foot"}, US_FOOT),
    "vertical CRS in US survey feet": ({"crs": "EPSG:4326+6360"}, US_FOOT),
    "vertical CRS in feet": ({"crs": "EPSG:4326+8228"}, 0.3048),
    "decimetres": ({"unit": "dm"}, 0.1),
    "nothing": ({}, 1.0),
}


@pytest.mark.parametrize("case", STATED)
def test_a_mosaic_has_the_unit_of_its_sources(tmp_path: pathlib.Path, case: str) -> None:
    options, metres = STATED[case]
    mosaic = build_vrt(tmp_path / "mosaic.vrt", tiles(tmp_path, **options))
    np.testing.assert_allclose(heights(mosaic), POSTS * metres, rtol=0, atol=1e-9)


def test_a_mosaic_of_a_mosaic_keeps_it_too(tmp_path: pathlib.Path) -> None:
    inner = build_vrt(tmp_path / "inner.vrt", tiles(tmp_path, unit="ft"))
    outer = build_vrt(tmp_path / "outer.vrt", [inner]).read_text()
    (tmp_path / "outer.vrt").write_text(outer.replace(f'xSize="{COLS}"', f'xSize="{2 * COLS}"'))
    np.testing.assert_allclose(heights(tmp_path / "outer.vrt"), POSTS * 0.3048, rtol=0, atol=1e-9)
    assert len(read_header(str(tmp_path / "outer.vrt"), 1).sources) == 3


def test_a_mosaic_has_the_vertical_datum_of_its_sources(tmp_path: pathlib.Path) -> None:
    a, b = tiles(tmp_path, crs="EPSG:4326+5773")
    mosaic = build_vrt(tmp_path / "mosaic.vrt", [a, b])
    expected = np.concatenate([np.asarray(read_dem(one).posts) for one in (a, b)], axis=1)
    np.testing.assert_allclose(np.asarray(read_dem(mosaic).posts), expected, rtol=0, atol=1e-9)
    with pytest.raises(DemError, match="measured from 'EGM96 height', the caller says"):
        read_dem(mosaic, vertical_datum="ellipsoid")
    above = build_vrt(tmp_path / "above.vrt", tiles(tmp_path, crs="EPSG:4979"))
    np.testing.assert_allclose(np.asarray(read_dem(above).posts), POSTS, rtol=0, atol=1e-9)


@pytest.mark.parametrize("made_by", ["gdalbuildvrt", "copy", "vrt://"])
def test_a_mosaic_has_the_scale_and_offset_of_its_sources(tmp_path: pathlib.Path, made_by: str) -> None:
    stored = np.round(10.0 * POSTS).astype(np.int16)
    a, b = tiles(tmp_path, heights=stored, scale=0.1, offset=5.0, nodata=-32768)
    expected = stored[:, :COLS] * 0.1 + 5.0
    path: pathlib.Path | str = tmp_path / "one.vrt"
    if made_by == "gdalbuildvrt":
        path, expected = build_vrt(tmp_path / "two.vrt", [a, b], dtype="Int16"), stored * 0.1 + 5.0
    elif made_by == "copy":
        with rasterio.open(a) as data:
            rasterio.shutil.copy(data, path, driver="VRT")
    else:
        path = f"vrt://{a}"
    np.testing.assert_allclose(heights(path), expected, rtol=0, atol=1e-9)


def test_gdals_unscaled_view_is_read_unless_it_rounds(tmp_path: pathlib.Path) -> None:
    stored = np.round(10.0 * POSTS).astype(np.int16)
    a, _ = tiles(tmp_path, heights=stored, scale=0.1, nodata=-32768)
    with pytest.raises(DemError, match=r"holds heights as int16 and rounds those of its source .*a\.tif"):
        read_dem(f"vrt://{a}?unscale=true", vertical_datum=0)
    found = heights(f"vrt://{a}?unscale=true&ot=Float64")
    np.testing.assert_allclose(found, stored[:, :COLS] * 0.1, rtol=0, atol=1e-9)


def test_a_value_that_a_source_marks_as_void_is_void_in_the_mosaic(tmp_path: pathlib.Path) -> None:
    posts = POSTS.copy()
    posts[2, 3] = -5.0
    mosaic = build_vrt(tmp_path / "mosaic.vrt", tiles(tmp_path, heights=posts, nodata=-5.0))
    assert np.argwhere(np.asarray(read_dem(mosaic, vertical_datum=0).void)).tolist() == [[2, 3]]


def test_a_vertical_crs_named_unknown_keeps_its_unit(tmp_path: pathlib.Path) -> None:
    flat = pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL")
    crs = (
        f'COMPD_CS["unknown",{flat},VERT_CS["unknown",VERT_DATUM["unknown",2005],'
        f'UNIT["US survey foot",{US_FOOT!r},AUTHORITY["EPSG","9003"]],AXIS["Up",UP]]]'
    )
    a, b = tiles(tmp_path, crs=crs)
    mosaic = build_vrt(tmp_path / "mosaic.vrt", [a, b])
    (tmp_path / "plain").mkdir()
    stated = build_vrt(tmp_path / "plain" / "stated.vrt", tiles(tmp_path / "plain"), crs=crs.replace('"', "&quot;"))
    for path in (mosaic, stated):
        np.testing.assert_allclose(heights(path), POSTS * US_FOOT, rtol=0, atol=1e-9)
    with pytest.raises(DemError, match="does not state the vertical datum of its heights"):
        read_dem(stated)


SCALED = "<ScaleOffset>0</ScaleOffset><ScaleRatio>0.3048</ScaleRatio>"
SCALED_PAST_VOIDS = f"<NODATA>-9999</NODATA>{SCALED}"
LOOK_UP = "<LUT>0:0,1000:300</LUT>"
REFUSED: dict[str, tuple[dict[str, Any], tuple[dict[str, Any], ...], str]] = {
    "units differ": ({}, ({"unit": "ft"}, {"unit": "m"}), r"a\.tif states ft, .*b\.tif states m"),
    "one in feet, one says nothing": ({}, ({"unit": "ft"},), r"a\.tif states ft, .*b\.tif states no unit"),
    "the VRT says otherwise": (
        {"band": "<UnitType>m</UnitType>"}, ({"unit": "ft"}, {"unit": "ft"}),
        r"states heights in m, its source .* in ft",
    ),
    "datums differ": (
        {}, ({"crs": "EPSG:4326+5773"}, {"crs": "EPSG:4326+3855"}),
        r"a\.tif has heights above 'EGM96 height', its source "
        r".*b\.tif above 'EGM2008 height'",
    ),
    "one states a datum": ({}, ({"crs": "EPSG:4326+5773"},), r"b\.tif above no stated datum"),
    "the VRT states another datum": (
        {"crs": "EPSG:4326+3855"}, ({"crs": "EPSG:4326+5773"}, {}), r"above 'EGM2008 height', its source .*'EGM96",
    ),
    "scales differ": ({}, ({"scale": 0.5},), r"are \(0\.5, 0\.0\) in .*a\.tif and \(1\.0, 0\.0\) in .*b\.tif"),
    "the VRT has another scale": (
        {"band": "<Scale>0.1</Scale>"}, ({"scale": 0.5}, {"scale": 0.5}), r"\(0\.1, 0\.0\) in the VRT and \(0\.5",
    ),
    "voids are scaled": ({"kind": "ComplexSource", "inner": SCALED}, (), r"by 0\.3048 without NODATA, so that voids"),
    "scaled, in what unit": (
        {"kind": "ComplexSource", "inner": SCALED_PAST_VOIDS}, (), r"states the unit of the result",
    ),
    "scaled twice": (
        {"kind": "ComplexSource", "inner": SCALED_PAST_VOIDS}, ({"scale": 0.5}, {"scale": 0.5}),
        r"a scale of 0\.5 itself",
    ),
    "a table": ({"kind": "ComplexSource", "inner": LOOK_UP}, (), r"is computed as it is read \(LUT\)"),
    "averaged": ({"kind": "AveragedSource"}, (), r"is computed as it is read \(AveragedSource\)"),
    "from an overview": (
        {"inner": '<OpenOptions><OOI key="OVERVIEW_LEVEL">0</OOI></OpenOptions>'}, (), r"read \(OVERVIEW_LEVEL\)",
    ),
    "half a cell off": ({"at": [(0, 0), (COLS - 0.5, 0)]}, (), r"is not on the grid of the VRT .*would resample it"),
    "half a cell off, bilinear": (
        {"at": [(0, 0), (COLS - 0.5, 0)], "attributes": 'resampling="bilinear"'}, (), r"is not on the grid of the VRT",
    ),
    "gaps become zero": (
        {"nodata": None, "at": [(0, 0), (COLS - 1, 0)]}, (), r"covered by no source and .*GDAL gives 0",
    ),
    "a mask is left out": (
        {}, ({"mask": np.full((ROWS, COLS), 255, np.uint8)},), r"leaves out the mask of its source .*a\.tif",
    ),
    "voids by two values": (
        {}, ({"nodata": -1.0}, {"nodata": -2.0}), r"different values \(-1 in .*, -2 in .*passes both",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_mosaic_would_lose_is_refused(tmp_path: pathlib.Path, case: str) -> None:
    """And the files themselves are read where the message says so."""
    vrt, each, reason = REFUSED[case]
    found = tiles(tmp_path, *each)
    mosaic = build_vrt(tmp_path / "mosaic.vrt", found, **vrt)
    for reader in (read_dem, open_dem):
        with pytest.raises(DemError, match=r"(?s)mosaic\.vrt: .*" + reason) as refusal:
            reader(mosaic, vertical_datum=-30.0)
    if "Name the files" in str(refusal.value) and len({str(one) for one in each}) < 2 and len(each) != 1:
        read_dem(found, vertical_datum=-30.0)


def test_a_scaled_source_is_read_where_nothing_is_lost(tmp_path: pathlib.Path) -> None:
    posts = POSTS.copy()
    posts[1, 1] = -9999.0
    found = tiles(tmp_path, heights=posts, nodata=-9999.0)
    mosaic = build_vrt(
        tmp_path / "m.vrt", found, kind="ComplexSource", inner=SCALED_PAST_VOIDS, band="<UnitType>m</UnitType>"
    )
    dem = read_dem(mosaic, vertical_datum="ellipsoid")
    known = ~np.asarray(dem.void)
    assert np.argwhere(~known).tolist() == [[1, 1]]
    np.testing.assert_allclose(np.asarray(dem.posts)[known], posts[known] * 0.3048, rtol=0, atol=1e-9)


@pytest.mark.parametrize("resampling", ["nearest", "bilinear"])
def test_a_vrt_that_warps_is_refused(tmp_path: pathlib.Path, resampling: str) -> None:
    a, _ = tiles(tmp_path)
    with (
        rasterio.open(a) as data,
        WarpedVRT(data, crs="EPSG:32631", resampling=Resampling[resampling]) as warped,
    ):
        rasterio.shutil.copy(warped, tmp_path / "warped.vrt", driver="VRT")
    with pytest.raises(DemError, match=r"warped\.vrt: this VRT \(VRTWarpedDataset\) resamples as it is read.*Name"):
        read_dem(tmp_path / "warped.vrt", vertical_datum=0)

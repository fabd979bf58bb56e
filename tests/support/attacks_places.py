"""Rasters that refer to other files or servers: the files of a folder, and the one that a caller names.

A row is a function that writes files into `folder` and returns the name of the one to read. `address` is that of a
server whose requests are counted, `secret` a valid raster elsewhere on the machine. None of the rows may be read; to
add one, add a function to `ATTACKS`. Those of `CRS_ATTACKS` name files in their CRS.
"""

from __future__ import annotations

import pathlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import rasterio

from support.rasters import DEGREE, hills, write

ROWS, COLS = 20, 20
POSTS = np.round(hills((ROWS, COLS)), 2)
Attack = Callable[[pathlib.Path, str, pathlib.Path], str]


# In its own process: GDAL waits for a reply without releasing other threads of this process to send it.
SERVER = """
import http.server, pathlib, sys
folder, told = pathlib.Path(sys.argv[1]), open(sys.argv[2], "a", buffering=1)
class Counting(http.server.SimpleHTTPRequestHandler):
    def do_GET(self):
        told.write(self.path + chr(10))
        file = folder / self.path.partition("?")[0].lstrip("/")
        content = file.read_bytes() if file.is_file() else b""
        self.send_response(200 if content else 404)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)
    do_HEAD = do_POST = do_OPTIONS = do_GET
    def log_message(self, *told):
        pass
server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Counting)
print(server.server_port, flush=True)
server.serve_forever()
"""


class Requests(NamedTuple):
    """The address of a local server, the folder that it serves, and the log file of its requests."""

    address: str
    folder: pathlib.Path
    told: pathlib.Path

    def taken(self) -> list[str]:
        """The requests since the last call."""
        found = self.told.read_text().splitlines()
        self.told.write_text("")
        return found


@contextmanager
def counted_requests(folder: pathlib.Path) -> Iterator[Requests]:
    """A local server that logs its requests; it serves the content of `folder`."""
    told = folder / "requests.txt"
    told.touch()
    command = [sys.executable, "-c", SERVER, str(folder), str(told)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            yield Requests(f"http://127.0.0.1:{int(server.stdout.readline())}", folder, told)
        finally:
            server.kill()


def wms(address: str) -> str:
    """A GDAL document for tiles of a server."""
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{address}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service><DataWindow>'
        "<UpperLeftX>5</UpperLeftX><UpperLeftY>45</UpperLeftY><LowerRightX>6</LowerRightX><LowerRightY>44</LowerRightY>"
        "<TileLevel>1</TileLevel><SizeX>512</SizeX><SizeY>512</SizeY></DataWindow><Projection>EPSG:4326</Projection>"
        "<BandsCount>1</BandsCount><DataType>Float32</DataType></GDAL_WMS>"
    )


def wcs(address: str) -> str:
    """A GDAL document for a coverage; GDAL requests the server's capabilities when opening it."""
    return (
        f"<WCS_GDAL><ServiceURL>{address}/wcs?</ServiceURL><Version>1.0.0</Version><CoverageName>dem</CoverageName>"
        "</WCS_GDAL>"
    )


def wmts(address: str) -> str:
    """A GDAL document for a layer; GDAL requests the capabilities when opening it."""
    return f"<GDAL_WMTS><GetCapabilitiesUrl>{address}/wmts</GetCapabilitiesUrl><Layer>dem</Layer></GDAL_WMTS>"


def stac(address: str) -> str:
    """A collection of items with one asset on a server."""
    return (
        '{"type": "FeatureCollection", "stac_version": "1.0.0", "features": [{"type": "Feature", "stac_version": '
        '"1.0.0", "id": "a", "collection": "c", "properties": {"proj:epsg": 4326, "datetime": "2020-01-01T00:00:00Z"}, '
        '"geometry": null, "links": [], "bbox": [5, 44, 6, 45], "assets": {"dem": {"href": "'
        + address
        + '/dem.tif", "type": "image/tiff; application=geotiff; profile=cloud-optimized", "proj:epsg": 4326, '
        '"proj:bbox": [5, 44, 6, 45], "proj:shape": [20, 20], "proj:transform": [0.05, 0, 5, 0, -0.05, 45]}}}]}'
    )


def band_of(source: str, kind: str = "SimpleSource", more: str = "") -> str:
    """A band of a VRT with one source."""
    return (
        f'<VRTRasterBand dataType="Float64" band="1"><{kind}>{source}<SourceBand>1</SourceBand>{more}</{kind}>'
        "</VRTRasterBand>"
    )


def vrt_of(inside: str, *, srs: str = "EPSG:4326", attributes: str = "") -> str:
    """A VRT of 20 x 20 posts."""
    return (
        f'<VRTDataset rasterXSize="{COLS}" rasterYSize="{ROWS}" {attributes}><SRS>{srs}</SRS><GeoTransform>5.0, '
        f"{DEGREE!r}, 0, 45.0, 0, {-DEGREE!r}</GeoTransform>{inside}</VRTDataset>"
    )


def named(file: str | pathlib.Path, relative: int = 0) -> str:
    """The element of a VRT that names a file."""
    return f'<SourceFilename relativeToVRT="{relative}">{file}</SourceFilename>'


def _text(name: str, content: Callable[[str, pathlib.Path], str]) -> Attack:
    def attack(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
        (folder / name).write_text(content(address, secret))
        return name

    return attack


def _vrt(inside: Callable[[str, pathlib.Path], str], name: str = "dem.vrt", **how: str) -> Attack:
    return _text(name, lambda address, secret: vrt_of(inside(address, secret), **how))


def _with_source(write_source: Callable[[pathlib.Path, str], object], name: str = "a.tif", **band: str) -> Attack:
    """A VRT with a source beside it that must not be opened."""

    def attack(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
        write_source(folder / name, address)
        (folder / "dem.vrt").write_text(vrt_of(band_of(named(name, 1), **band)))
        return "dem.vrt"

    return attack


def _beside(name: str, content: Callable[[str, pathlib.Path], str], also: str = "") -> Attack:
    """A valid GeoTIFF, and a file beside it that GDAL opens too; `also` a document that this names."""

    def attack(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
        write(folder / "dem.tif", POSTS)
        (folder / name).write_text(content(address, secret))
        if also:
            (folder / also).write_text(wcs(address))
        return "dem.tif"

    return attack


def _overviews_in_tag(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
    write(folder / "dem.tif", POSTS)
    with rasterio.open(folder / "dem.tif", "r+") as sink:
        sink.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=f"{folder}/w.xml")
    (folder / "w.xml").write_text(wcs(address))
    return "dem.tif"


def _link_to_secret(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
    (folder / "a.tif").symlink_to(secret)
    (folder / "dem.vrt").write_text(vrt_of(band_of(named("a.tif", 1))))
    return "dem.vrt"


def _nested(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
    (folder / "inner.vrt").write_text(vrt_of(band_of(named(secret))))
    (folder / "dem.vrt").write_text(vrt_of(band_of(named("inner.vrt", 1))))
    return "dem.vrt"


def _overviews(name: str) -> str:
    entry = f'<MDI key="OVERVIEW_FILE">{name}</MDI>'
    return f'<PAMDataset><Metadata domain="OVERVIEWS">{entry}</Metadata></PAMDataset>'


def _raw(name: str, relative: int = 0) -> str:
    return (
        f'<VRTRasterBand dataType="Float64" band="1" subClass="VRTRawRasterBand">{named(name, relative)}'
        f"<ImageOffset>0</ImageOffset><PixelOffset>8</PixelOffset><LineOffset>{8 * COLS}</LineOffset></VRTRasterBand>"
    )


def _python(secret: pathlib.Path) -> str:
    code = f"import numpy as np\ndef f(i, o, *a, **k):\n open('{secret}.touched', 'w').close()\n o[:] = 7.0"
    return (
        '<VRTRasterBand dataType="Float64" band="1" subClass="VRTDerivedRasterBand"><PixelFunctionType>f'
        "</PixelFunctionType><PixelFunctionLanguage>Python</PixelFunctionLanguage><PixelFunctionCode><![CDATA["
        f"{code}]]></PixelFunctionCode></VRTRasterBand>"
    )


_WGS84 = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]{0}],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433]]'
)
CRS_WITH_FILES = {  # opened by PROJ when it transforms, or when it parses the CRS
    "grid of a datum": _WGS84.format(',EXTENSION["PROJ4_GRIDS","SECRET"]').replace("WGS 84", "mine"),
    "grid of a geoid": (
        f'COMPD_CS["c",{_WGS84.format("")},VERT_CS["v",VERT_DATUM["v",2005,EXTENSION["PROJ4_GRIDS","SECRET"]],'
        'UNIT["metre",1],AXIS["Up",UP]]]'
    ),
    "pipeline": (
        f'PROJCS["x",{_WGS84.format("")},PROJECTION["custom_proj4"],UNIT["metre",1],EXTENSION["PROJ4","+proj=pipeline '
        '+step +proj=utm +zone=32 +step +proj=hgridshift +grids=SECRET"]]'
    ),
}


def _crs_of_vrt(text: str) -> Attack:
    def attack(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
        write(folder / "a.tif", POSTS)
        srs = text.replace("SECRET", str(secret)).replace('"', "&quot;")
        (folder / "dem.vrt").write_text(vrt_of(band_of(named("a.tif", 1)), srs=srs))
        return "dem.vrt"

    return attack


def _crs_beside(text: str) -> Attack:
    def attack(folder: pathlib.Path, address: str, secret: pathlib.Path) -> str:
        write(folder / "dem.tif", POSTS, crs=None)
        srs = text.replace("SECRET", str(secret)).replace('"', "&quot;")
        (folder / "dem.tif.aux.xml").write_text(f"<PAMDataset><SRS>{srs}</SRS></PAMDataset>")
        return "dem.tif"

    return attack


PANSHARPENED = (
    "<PansharpeningOptions><PanchroBand>{0}<SourceBand>1</SourceBand></PanchroBand><SpectralBand dstBand='1'>{0}"
    "<SourceBand>1</SourceBand></SpectralBand></PansharpeningOptions>"
)
WARPED = (
    '<VRTRasterBand dataType="Float64" band="1" subClass="VRTWarpedRasterBand"/><BlockXSize>20</BlockXSize><BlockYSize>'
    "20</BlockYSize><GDALWarpOptions><SourceDataset relativeToVRT='0'>{0}</SourceDataset></GDALWarpOptions>"
)
ATTACKS: dict[str, Attack] = {
    "WMS named .tif": _text("dem.tif", lambda address, _: wms(address)),
    "WCS named .tif": _text("dem.tif", lambda address, _: wcs(address)),
    "WMTS named .tif": _text("dem.tif", lambda address, _: wmts(address)),
    "STAC named .tif": _text("dem.tif", lambda address, _: stac(address)),
    "STAC named .json": _text("dem.json", lambda address, _: stac(address)),
    "VRT of a URL": _vrt(lambda address, _: band_of(named(f"/vsicurl/{address}/a.tif"))),
    "VRT of a URL, named .tif": _vrt(lambda address, _: band_of(named(f"/vsicurl/{address}/a.tif")), "dem.tif"),
    "VRT of a URL as it is": _vrt(lambda address, _: band_of(named(f"{address}/a.tif"))),
    "VRT of a WMS by its name": _vrt(lambda address, _: band_of(named(f"WMS:{address}/?LAYERS=a"))),
    "VRT of a WMS in itself": _vrt(lambda address, _: band_of(named(wms(address).replace("<", "&lt;")))),
    "VRT of a VRT in itself": _vrt(
        lambda address, _: band_of(named(vrt_of(band_of(named(f"/vsicurl/{address}/a.tif"))).replace("<", "&lt;")))
    ),
    "VRT of a URL, in an attribute": _vrt(
        lambda address, _: (
            f'<VRTRasterBand dataType="Float64" band="1"><SimpleSource SourceFilename="/vsicurl/{address}/a.tif">'
            "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>"
        )
    ),
    "VRT of a URL, in small letters": _vrt(
        lambda address, _: band_of(f"<sourcefilename>/vsicurl/{address}/a.tif</sourcefilename>")
    ),
    "VRT with a comment in a name": _vrt(
        lambda _, secret: band_of(f"<SourceFilename>{secret}<!-- -->.not</SourceFilename>")
    ),
    "VRT with a mask of a URL": _vrt(
        lambda address, _: f"<MaskBand>{band_of(named(f'/vsicurl/{address}/a.tif'))}</MaskBand>"
    ),
    "VRT with overviews of a URL": _vrt(
        lambda address, _: (
            '<VRTRasterBand dataType="Float64" band="1"><Overview>'
            f"{named(f'/vsicurl/{address}/a.tif')}<SourceBand>1</SourceBand></Overview></VRTRasterBand>"
        )
    ),
    "VRT, pansharpened": _vrt(
        lambda address, _: PANSHARPENED.format(named(f"/vsicurl/{address}/a.tif")),
        attributes='subClass="VRTPansharpenedDataset"',
    ),
    "VRT, warped from elsewhere": _vrt(
        lambda _, secret: WARPED.format(secret), attributes='subClass="VRTWarpedDataset"'
    ),
    "VRT, warped from a URL": _vrt(
        lambda address, _: WARPED.format(f"/vsicurl/{address}/a.tif"), attributes='subClass="VRTWarpedDataset"'
    ),
    "VRT, processed": _vrt(
        lambda address, _: f"<Input>{named(f'/vsicurl/{address}/a.tif')}</Input><ProcessingSteps/>",
        attributes='subClass="VRTProcessedDataset"',
    ),
    "VRT, computed by Python": _vrt(lambda _, secret: _python(secret)),
    "VRT, raw values of a file elsewhere": _vrt(lambda _, secret: _raw(str(secret))),
    "VRT, raw values above": _vrt(lambda _, secret: _raw(f"../{secret.parent.name}/{secret.name}", 1)),
    "VRT of a file elsewhere": _vrt(lambda _, secret: band_of(named(secret))),
    "VRT of a file above": _vrt(lambda _, secret: band_of(named(f"../{secret.parent.name}/{secret.name}", 1))),
    "VRT of a link to a file elsewhere": _link_to_secret,
    "VRT of an archive": _vrt(lambda _, secret: band_of(named(f"/vsizip/{secret}.zip/a.tif"))),
    "VRT of a part by GDAL's name": _vrt(lambda _, secret: band_of(named(f"GTIFF_DIR:1:{secret}"))),
    "VRT of a view": _vrt(lambda _, secret: band_of(named(f"vrt://{secret}"))),
    "VRT in a VRT": _nested,
    "VRT of a WMS beside it": _with_source(lambda path, address: path.write_text(wms(address))),
    "VRT of a WCS beside it": _with_source(lambda path, address: path.write_text(wcs(address))),
    "VRT with options of opening": _with_source(
        lambda path, address: write(path, POSTS), more='<OpenOptions><OOI key="GEOREF_SOURCES">x</OOI></OpenOptions>'
    ),
    "mask beside, a WCS": _beside("dem.tif.msk", lambda address, _: wcs(address)),
    "overviews beside, a WCS": _beside("dem.tif.ovr", lambda address, _: wcs(address)),
    "overviews beside, in capitals": _beside("DEM.TIF.OVR", lambda address, _: wcs(address)),
    "mask of overviews beside, a WCS": _beside("dem.tif.ovr.msk", lambda address, _: wcs(address)),
    "auxiliary XML names overviews": _beside("dem.tif.aux.xml", lambda _, secret: _overviews("w.xml"), also="w.xml"),
    "auxiliary XML names a file elsewhere": _beside("dem.tif.aux.xml", lambda _, secret: _overviews(str(secret))),
    "auxiliary XML names overviews, escaped": _beside(
        "dem.tif.aux.xml", lambda address, _: _overviews(f"/vsicurl/{address}/o.tif").replace("_FILE", "&#95;FILE")
    ),
    "a tag names overviews": _overviews_in_tag,
}
# An image without its map may be read: nothing of its CRS is used.
CRS_ATTACKS: dict[str, Attack] = {
    **{f"of a VRT, {kind}": _crs_of_vrt(text) for kind, text in CRS_WITH_FILES.items()},
    **{f"beside, {kind}": _crs_beside(text) for kind, text in CRS_WITH_FILES.items()},
}

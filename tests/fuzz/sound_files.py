"""Sound files of every kind that is read, made here, and what their answers must be: for `readers`."""

from __future__ import annotations

import pathlib
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from jaxgeo.io import (
    DemError,
    ImageError,
    TableError,
    open_dem,
    read_dem,
)
from jaxgeo.io.acquisitions import Acquisition, read_orthority, read_sbet
from jaxgeo.io.scene import SceneError
from tests.support.drone_image_files import packet, write_image
from tests.support.klv_packets import local_set, usual
from tests.support.rasters import hills, write
from tests.support.transport_streams import muxed

Seeds = Callable[[pathlib.Path], Sequence[bytes]]
TABLE, DEM, IMAGE = (TableError, DemError), (DemError,), (ImageError,)
ACQUISITION = (TableError, DemError, ImageError, SceneError)


def texts(*contents: str) -> Seeds:
    return lambda folder: [content.encode() for content in contents]


def contents(*made: bytes) -> Seeds:
    return lambda folder: made


def files(make: Callable[..., Any], *options: dict[str, Any], ending: str = "") -> Seeds:
    """Files that a function writes to a path, once with each set of options."""

    def seeds(folder: pathlib.Path) -> list[bytes]:
        path, found = folder / f"seed{ending}", []
        for one in options or ({},):
            make(path, **one)
            found.append(path.read_bytes())
            path.unlink()
        return found

    return seeds


def finite(*leaves: Any) -> None:
    for leaf in leaves:
        values = np.asarray(leaf)
        assert values.dtype.kind != "f" or np.isfinite(values).all(), values[~np.isfinite(values)][:3]


def sound(found: Acquisition) -> None:
    """Exposures that are whole: finite, on the Earth, one for each name."""
    assert len(found) > 0
    finite(*jax.tree.leaves((found.sensor, found.shots, found.sources)))
    position = found.shots.pose.position
    assert np.all(np.abs(position.lat) <= np.pi / 2.0)
    assert np.all((position.height >= -5000.0) & (position.height <= 3e6)), position.height


def known(raster: tuple[np.ndarray, np.ndarray]) -> None:
    values, mask = raster
    assert mask.any()
    finite(values)


def on_earth(pose: Any) -> None:
    finite(*jax.tree.leaves(pose))
    assert np.all(np.abs(pose.position.lat) <= np.pi / 2.0)


def positions(table: Any) -> None:
    lat, lon, height = (np.asarray(x) for x in table.position.to_degrees())
    finite(lat, lon, *([height] if table.has_heights else []))
    assert len(table.numbers if table.names is None else table.names) == len(lat) > 0
    assert np.all(np.abs(lat) <= 90.0)


def heights(dem: Any) -> None:
    finite(dem.posts)
    assert np.all(np.abs(np.asarray(dem.posts)) < 13_000.0)


HILLS = hills((9, 11)).astype(np.float32)
RASTERS = (
    {},
    {"compress": "deflate", "predictor": 3},
    {"nodata": -9999.0, "unit": "ft"},
    {"scale": 0.5, "offset": 10.0},
    {"crs": "EPSG:32631"},
    {"crs": "EPSG:2154"},
)


def raster(path: pathlib.Path, **options: Any) -> None:
    made = {"affine": rasterio.Affine(30, 0, 5e5, 0, -30, 5e6)} if "crs" in options else {}
    write(path, HILLS, **made, **options)


def vrt(folder: pathlib.Path) -> list[bytes]:
    """A VRT over a raster beside it."""
    write(folder / "source.tif", HILLS)
    with rasterio.open(folder / "source.tif") as data:
        transform, wkt = ", ".join(str(x) for x in data.transform.to_gdal()), data.crs.to_wkt().replace('"', "&quot;")
    rows, cols = HILLS.shape
    size = f'xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"'
    return [
        f'<VRTDataset rasterXSize="{cols}" rasterYSize="{rows}"><SRS>{wkt}</SRS>'
        f"<GeoTransform>{transform}</GeoTransform>"
        f'<VRTRasterBand dataType="Float32" band="1"><NoDataValue>-9999</NoDataValue><UnitType>m</UnitType>'
        f'<SimpleSource><SourceFilename relativeToVRT="1">source.tif</SourceFilename><SourceBand>1</SourceBand>'
        f"<SrcRect {size}/><DstRect {size}/></SimpleSource></VRTRasterBand></VRTDataset>".encode()
    ]


def ascii_grid(folder: pathlib.Path) -> list[bytes]:
    header = "ncols 11\nnrows 9\nxllcorner 5.0\nyllcorner 45.0\ncellsize 0.01\nNODATA_value -9999\n"
    return [(header + "\n".join(" ".join(f"{x:.1f}" for x in row) for row in HILLS) + "\n").encode()]


def with_crs(path: pathlib.Path) -> Any:
    """An ASCII grid, that knows no CRS, with a file of it beside."""
    path.with_suffix(".prj").write_text(rasterio.CRS.from_epsg(4326).to_wkt())
    return read_dem(path, vertical_datum="ellipsoid")


def geoid_grid(path: pathlib.Path, driver: str) -> None:
    grid = np.linspace(40.0, 50.0, 21 * 21).reshape(21, 21).astype(np.float32)
    transform = rasterio.Affine(0.1, 0, 3.95, 0, -0.1, 46.05)
    profile = {"driver": driver, "dtype": "float32", "count": 1, "height": 21, "width": 21, "transform": transform}
    with rasterio.open(path, "w", crs="EPSG:4326", **profile) as sink:
        sink.write(grid, 1)


def with_geoid(path: pathlib.Path) -> Any:
    sound = path.parent / "ground.tif"
    if not sound.exists():
        write(sound, HILLS)
    return read_dem(sound, vertical_datum=str(path))


def kept_bounds(path: pathlib.Path) -> Any:
    """Terrain on disk with a file of bounds that an earlier run wrote."""
    ground = path.parent / "ground.tif"
    if not ground.exists():
        write(ground, HILLS)
    return open_dem(ground, vertical_datum="ellipsoid", cache=path)


def bounds_file(folder: pathlib.Path) -> list[bytes]:
    path = folder / "kept.npz"
    terrain = kept_bounds(path)
    terrain.blocks.read()
    terrain.blocks.save()
    content = path.read_bytes()
    path.unlink()
    return [content]


def picture(path: pathlib.Path, driver: str = "GTiff", **options: Any) -> None:
    values = np.random.default_rng(1).integers(0, 255, (3, 12, 16)).astype(np.uint8)
    profile = {"driver": driver, "dtype": "uint8", "count": 3, "height": 12, "width": 16, **options}
    if driver == "GTiff":
        profile |= {"crs": "EPSG:4326", "transform": rasterio.Affine(1e-5, 0, 5.0, 0, -1e-5, 45.0)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # of PNG and JPEG
        with rasterio.open(path, "w", **profile) as sink:
            sink.write(values)


DJI = {
    "drone-dji:AbsoluteAltitude": "+153.9", "drone-dji:RelativeAltitude": "+99.9", "drone-dji:GpsLatitude": "+24.68",
    "drone-dji:GpsLongitude": "+120.95", "drone-dji:GimbalYawDegree": "-97.40", "drone-dji:GimbalPitchDegree": "-35.50",
    "drone-dji:GimbalRollDegree": "+0.00", "drone-dji:RtkFlag": "50", "drone-dji:RtkStdLon": "0.0097",
    "drone-dji:RtkStdLat": "0.0093", "drone-dji:RtkStdHgt": "0.0238", "drone-dji:CalibratedFocalLength": "3666.67",
}  # fmt: skip


def photo(path: pathlib.Path, **options: Any) -> None:
    write_image(path, packet(DJI, **options), make="DJI")


KLV = local_set(usual()) + local_set(usual(5, 6, 7, 13, 14, 16, 17, 18, 19, 20, 21, 23, 24, 75, 78))


STREAMED = [KLV, local_set(usual(tag_5=200.0)), KLV]


def transport_stream(path: pathlib.Path) -> None:
    muxed(path, STREAMED)


def trajectory(count: int = 8) -> np.ndarray:
    """Records of an SBET: to the north at 50 m/s, level."""
    records = np.zeros((count, 17))
    times = 0.02 * np.arange(count)
    records[:, 0], records[:, 1], records[:, 2], records[:, 3] = (
        1000.0 + times,
        0.8 + 50.0 * times / 6.367e6,
        0.1,
        900.0,
    )
    records[:, 4], records[:, 9] = 50.0, 0.02
    return records


def errors_of_trajectory() -> np.ndarray:
    records = np.full((4, 10), 0.05)
    records[:, 0] = 999.9 + 0.1 * np.arange(4)
    return records


def with_errors(path: pathlib.Path) -> Any:
    flight = path.parent / "flight.sbet"
    if not flight.exists():
        trajectory().astype("<f8").tofile(flight)
    return read_sbet(flight, errors=path).acquisition()


ORIENTATIONS = (
    "image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,camera,time_s\n"
    "a,43.7,4.6,1800.0,350.0,30.0,-1.5,one,1.0\nb,43.71,4.61,1800.5,10.0,-2.0,1.5,one,2.5\n"
)
OPK = "'filename' 'x' 'y' 'z' 'omega' 'phi' 'kappa'\n'a' 292710.2 2731048.8 186.4 28.8 0.9 1.8\n"
OPK_GON = "image,x,y,z,omega[gon],phi[gon],kappa[gon]\na,292710.2,2731048.8,186.4,1.0,2.0,3.0\n"
PATB = (
    "             101                    292710.20000   2731048.80000       186.40000\n"
    "  0.000000000000 -1.000000000000  0.000000000000  1.000000000000  0.000000000000\n"
    "  0.000000000000  0.000000000000  0.000000000000  1.000000000000\n"
)
BINGO = "* ITERA\nORIA 101 292710.2 2731048.8 186.4 1.0 2.0 3.0 1\nORIA 102 292760.2 2731048.8 186.4 1.0 2.0 199.0 1\n"
CAMERA = {"projection_type": "brown", "width": 800, "height": 600, "focal_x": 0.9, "focal_y": 0.9, "c_x": 0.0,
          "c_y": 0.0, "k1": -0.1, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}  # fmt: skip
SHOT = {"rotation": [2.9, 0.4, -0.2], "translation": [0.0, 5.0, 100.0], "camera": "one", "capture_time": 1.7e9}
RECONSTRUCTION = {
    "cameras": {"one": CAMERA},
    "shots": {"a": SHOT, "b": {**SHOT, "translation": [9.0, 5.0, 99.0]}},
    "points": {"1": {"coordinates": [1.0, 2.0, 3.0], "color": [1, 2, 3]}},
    "reference_lla": {"latitude": 24.6801, "longitude": 120.9512, "altitude": 12.5},
}
INTERIOR = (
    "dmc:\n  type: brown\n  im_size: [640, 1152]\n  focal_len: 120.0\n  sensor_size: [92.16, 165.888]\n"
    "  k1: -0.05\n  cx: 0.001\n"
)
OF_ORTHORITY = {
    "filename": "a",
    "camera": "dmc",
    "xyz": [299_000.0, 6_271_500.0, 5200.0],
    "opk": [-0.006, 0.005, -3.12],
}
EXTERIOR = {
    "type": "FeatureCollection",
    "world_crs": "EPSG:32734",
    "features": [
        {
            "type": "Feature",
            "properties": OF_ORTHORITY,
            "geometry": {"type": "Point", "coordinates": [24.4, -33.7, 5200.0]},
        }
    ],
}


def of_orthority(path: pathlib.Path) -> Acquisition:
    interior = path.parent / "interior.yaml"
    if not interior.exists():
        interior.write_text(INTERIOR)
    return read_orthority(interior, path, height_datum="ellipsoid")


SHOTS = (
    "name,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,u,v\n"
    "0,36.318,-84.105,5500,160,1,-0.5,72,1199.5,2399.5\n1,36.319,-84.105,nan,161,1,-0.5,72,10,20\n"
)
FLIGHT = (
    "time_s,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,velocity_north_mps,velocity_east_mps,"
    "velocity_down_mps\n10,36.3,-84.1,5500,359,1,0,11,0,0\n11,36.3001,-84.1,5500,0,1,0,11,0,0\n"
    "12,36.3002,-84.1,5500,1,1,0,11,0,0\n"
)
GCP = (
    "EPSG:32651\n292710.5 2731048.25 100.0 3044 2622.5 IMG_0525.jpg north\n292800 2731100 90 1606 2763 IMG_0525.jpg\n",
    "WGS84 UTM 51N\n# a remark\n292710.5\t2731048.25\t100.0\t4193 1552 IMG_0585.jpg\n",
)
IMAGE_POINTS = "image,point,u,v,sigma_px\na,p1,10.25,-0.5,0.5\na,p2,11,12,1\nb,p1,1e3,7.125,1\n"
BAL = "1 2 2\n0 0 10.5 -3.25\n0 1 1e1 2\n0.1\n-0.2\n0.05\n1\n2\n3\n500\n-1e-3\n0\n1\n2\n-10\n0\n1\n-9\n"


def whole(problem: Any) -> None:
    finite(problem.uv, problem.points, problem.focal_px)

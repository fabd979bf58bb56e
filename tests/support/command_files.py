"""Small real files with the names used in command examples, all over the packaged elevation model."""

from __future__ import annotations

import functools
import json
import pathlib
import shlex
import shutil
import warnings
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

from jaxgeo import FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.demo import scene_file
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.io import MapRaster, example_dem, read_orthoimage, write_orthoimage
from jaxgeo.io.map_raster import checked_crs
from jaxgeo.ortho.rendering import render
from support.drone_image_files import FULL, packet, write_image
from support.fractal import fractal_posts
from support.klv_packets import local_set, usual

DEM = pathlib.Path(scene_file()).with_name("jacksboro.tif")
LAT, LON = 36.318, -84.105
POSE = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg"
READINGS = "gimbal_outer_deg,gimbal_inner_deg"
SHOTS = ("36.318,-84.105", "36.315,-84.104", "36.312,-84.103")
DJI = {
    "drone-dji:AbsoluteAltitude": "+900.0",
    "drone-dji:RelativeAltitude": "+99.9",
    "drone-dji:GpsLatitude": f"{LAT:+}",
    "drone-dji:GpsLongitude": f"{LON:+}",
    "drone-dji:GimbalYawDegree": "+160.00",
    "drone-dji:GimbalPitchDegree": "-60.00",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:CalibratedFocalLength": "3666.67",
}
OPK = "image,x,y,z,omega,phi,kappa\na,759900.0,4023100.0,3500.0,1.0,-2.0,30.0\n"
RECONSTRUCTION = {
    "cameras": {"one": {"projection_type": "perspective", "width": 800, "height": 600, "focal": 0.9}},
    "shots": {"a": {"rotation": [2.9, 0.4, -0.2], "translation": [0.0, 5.0, 100.0], "camera": "one"}},
    "points": {},
    "reference_lla": {"latitude": LAT, "longitude": LON, "altitude": 800.0},
}
# Ground points of pixels of DJI_0042.JPG, some metres off: name, pixel, latitude, longitude, ellipsoidal height.
CHECKED = (
    "P1,400,500,36.3138834,-84.0987752,285.195",
    "P2,3400,700,36.3122223,-84.1061130,278.477",
    "P3,900,1500,36.3158598,-84.1017404,342.070",
    "P4,2900,1600,36.3149145,-84.1054871,333.124",
    "P5,500,2600,36.3175985,-84.1023704,384.501",
    "P6,3500,2500,36.3161855,-84.1067089,376.841",
)
FOUND = "image,label,u_min,v_min,u_max,v_max\nDJI_0042.JPG,car,1900,1400,1960,1450\nDJI_0043.JPG,hut,100,200,400,500\n"
SMALL = (192, 256)  # rows and columns of the image for rectification and registration
CELL, SIDE, WEST, NORTH = 10.0, 400, 744_100.0, 4_021_600.0  # map: cell size in m, cells, and its corner in UTM zone 16
SMALL_POSE = {"lat": 36.29, "lon": -84.26, "height": 3500.0, "heading": 30.0, "pitch": 1.0, "roll": -2.0}
SMALL_SCENE = """
[camera]
width = 256
height = 192
focal_px = 300.0
[pose]
lat_deg = {lat:.10f}
lon_deg = {lon:.10f}
height_m = {height:.4f}
height_datum = "ellipsoid"
heading_deg = {heading}
pitch_deg = {pitch}
roll_deg = {roll}
"""


def prepare(folder: pathlib.Path, command: str) -> None:
    """Write the known files that a command line names into a folder."""
    words = shlex.split(command, comments=True)
    for word in words:
        name = word.rstrip("/")
        if name in FILES and not (folder / name).exists():
            FILES[name](folder / name)
    if "rectify" in words or "register" in words:
        for name, path in _small_files(is_seen="register" in words).items():
            shutil.copy(path, folder / name)


def _shots(path: pathlib.Path) -> None:
    rows = [f"{k},{place},5500,160,1,-0.5,72,0,{1199.5 + k},2399.5" for k, place in enumerate(SHOTS)]
    path.write_text("\n".join([f"name,{POSE},{READINGS},u,v", *rows]) + "\n")


def _strips(path: pathlib.Path) -> None:
    """Two strips of three images straight down, north and back, 600 m apart."""
    places = [(36.290 + 0.004 * k, -84.250, 0) for k in range(3)]
    places += [(36.298 - 0.004 * k, -84.2433, 180) for k in range(3)]
    rows = [f"{k},{lat:.4f},{lon},5500,{heading},0,0,0,0" for k, (lat, lon, heading) in enumerate(places)]
    path.write_text("\n".join([f"name,{POSE},{READINGS}", *rows]) + "\n")


def _flight(path: pathlib.Path) -> None:
    """Straight and level flight at 170 m/s."""
    lines = [f"time_s,{POSE},{READINGS}"]
    for k in range(41):
        lat, lon = 36.35 - k * 85.0 * 0.866 / 110_940.0, -84.10 + k * 85.0 * 0.5 / 89_640.0
        lines.append(f"{100.0 + 0.5 * k},{lat:.9f},{lon:.9f},5500,150,0,0,30,0")
    path.write_text("\n".join(lines) + "\n")


def _image(path: pathlib.Path) -> None:
    write_image(path, packet(DJI), make="DJI", size=FULL)


def _images(path: pathlib.Path) -> None:
    path.mkdir()
    for number, name in enumerate(("DJI_0042.JPG", "DJI_0043.JPG")):
        _image(path / name)
        with (path / name).open("ab") as file:
            file.write(b"\0" * number)  # no copy of the other


def _telemetry(path: pathlib.Path) -> None:
    place = {"tag_13": LAT, "tag_14": LON, "tag_23": LAT + 0.02, "tag_24": LON + 0.02, "tag_25": 300.0}
    path.write_bytes(local_set(usual(**place)) + local_set(usual(**(place | {"tag_5": 31.0}))))


def _subtitles(path: pathlib.Path) -> None:
    """Of a video of a minute and a half: a record each second."""
    cue = "{0}\n00:{1:02d}:{2:02d},000 --> 00:{1:02d}:{2:02d},033\n{3}\n\n"
    place = f"[latitude: {LAT}] [longitude: {LON}] [rel_alt: 350.000 abs_alt: 900.000]"
    record = f"{place} [gb_yaw: 160.0 gb_pitch: -60.0 gb_roll: 0.0]"
    path.write_text("".join(cue.format(k + 1, *divmod(k, 60), record) for k in range(90)))


def _sbet(path: pathlib.Path) -> None:
    record = np.zeros((3, 17))
    record[:, 0] = [10.0, 11.0, 12.0]
    record[:, 1], record[:, 2] = np.deg2rad(LAT), np.deg2rad(LON + 1e-4 * np.arange(3))
    record[:, 3], record[:, 9] = 5469.0, np.deg2rad(160.0)
    record.astype("<f8").tofile(path)


def _tiles(path: pathlib.Path) -> None:
    path.mkdir()
    shutil.copy(DEM, path / "one.tif")


def _copy(of: pathlib.Path) -> Callable[[pathlib.Path], object]:
    return lambda path: shutil.copy(of, path)


def _points(path: pathlib.Path) -> None:
    header = "image,point,u,v,lat_deg,lon_deg,height_m"
    rows = []
    for number, row in enumerate(CHECKED):
        name, *rest = row.split(",")
        rows.append(",".join([f"DJI_004{2 + number % 2}.JPG", name, *rest]))
    path.write_text("\n".join([header, *rows]) + "\n")


def _gcp_list(path: pathlib.Path) -> None:
    rows = []
    for number, row in enumerate(CHECKED):
        name, u, v, lat, lon, height = row.split(",")
        rows.append(f"{lon} {lat} {height} {u} {v} DJI_004{2 + number % 2}.JPG {name}")
    path.write_text("\n".join(["WGS84", *rows]) + "\n")


FILES: dict[str, Callable[[pathlib.Path], object]] = {
    "scene.toml": _copy(scene_file()),
    "dem.tif": _copy(DEM),
    "tiles": _tiles,
    "shots.csv": _shots,
    "strips.csv": _strips,
    "flight.csv": _flight,
    "DJI_0042.JPG": _image,
    "images": _images,
    "points.csv": _points,
    "gcp_list.txt": _gcp_list,
    "found.csv": lambda path: path.write_text(FOUND),
    "flight.klv": _telemetry,
    "DJI_0001.SRT": _subtitles,
    "mission.sbet": _sbet,
    "opk.csv": lambda path: path.write_text(OPK),
    "reconstruction.json": lambda path: path.write_text(json.dumps([RECONSTRUCTION])),
}


@functools.cache
def _small_files(*, is_seen: bool) -> dict[str, pathlib.Path]:
    """A map, an image (rendered from the map with a known pose if `is_seen`), and a scene with the errors of a
    navigation; created once."""
    import tempfile

    folder = pathlib.Path(tempfile.mkdtemp(prefix="jaxgeo-"))
    found = {name: folder / name for name in ("ortho.tif", "image.tif", "scene.toml")}
    values = fractal_posts(SIDE, spacing=CELL, relief=200.0, exponent=2.2, seed=1).astype(np.float32)
    transform = Affine(CELL, 0.0, WEST, 0.0, -CELL, NORTH)
    raster = MapRaster(checked_crs("map", "EPSG:32616"), transform, (SIDE, SIDE))
    write_orthoimage(found["ortho.tif"], values, raster)
    grey = _image_of(found["ortho.tif"]) if is_seen else np.full((1, *SMALL), 90, np.uint8)
    profile = {"driver": "GTiff", "count": 1, "height": SMALL[0], "width": SMALL[1], "dtype": "uint8"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(found["image.tif"], "w", **profile) as data:
            data.write(grey)
    place = Geodetic.from_degrees(lat=SMALL_POSE["lat"], lon=SMALL_POSE["lon"], height=SMALL_POSE["height"])
    away = WGS84.to_ecef(place) + R_ecef_from_ned(place) @ jnp.array([15.0, -12.0, 8.0])
    moved = dict(zip(("lat", "lon", "height"), map(float, WGS84.to_geodetic(away).to_degrees()), strict=True))
    found["scene.toml"].write_text(SMALL_SCENE.format(**(SMALL_POSE | moved | {"heading": 30.2, "pitch": 0.9})))
    return found


def _image_of(reference: pathlib.Path) -> np.ndarray:
    camera = FrameCamera.from_pixels(focal_px=300.0, width=SMALL[1], height=SMALL[0])
    sensor, shot = Sensor(camera, Gimbal.fixed(), Mount.nadir()), Shot(Pose.from_degrees(**SMALL_POSE))
    return np.rint(render(sensor, shot, read_orthoimage(reference), example_dem()).values).astype(np.uint8)

"""Sound files of photogrammetry programs, autopilots and flight apps, and how they are read: for `programs`."""

from __future__ import annotations

import json
import pathlib
import struct
from collections.abc import Callable
from typing import Any

from support.autopilot_logs import AT, POINTED, dataflash, dataflash_text, ulog

from jaxgeo import FrameCamera
from jaxgeo.io import read_acquisition
from jaxgeo.io.pix4d_camera import pix4d_camera
from tests.fuzz.sound_files import RECONSTRUCTION, Seeds
from tests.support.drone_image_files import packet, write_image

LENS = FrameCamera.from_pixels(focal_px=2600.0, width=3840, height=2160)
UTM, UNDULATION, OFFSET = "EPSG:32616", 20.0, (30.0, -20.0, 500.0)

_PIX4D_IMAGE = (
    "{0} 400 300\n277 0 203.5\n0 277 148\n0 0 1\n-0.05 0.02 -0.003\n0.0012 -0.0007\n750970.25 4020020.5 {1}\n"
    "0.8 0.6 0\n0.36 -0.48 -0.8\n-0.48 0.64 -0.6\n"
)
PIX4D = (
    "fileName imageWidth imageHeight \ncamera matrix K [3x3]\nradial distortion [3x1]\ntangential distortion [2x1]\n"
    "camera position t [3x1]\ncamera rotation R [3x3]\ncamera model m = K [R|-Rt] X\n\n"
    + _PIX4D_IMAGE.format("an image.JPG", 400.5)
    + _PIX4D_IMAGE.format("b.JPG", 401)
)
PIX4D_CAM = (
    "Pix4D camera calibration file 0\n\n#Focal Length mm assuming a sensor width of 2x1.5mm\nF 1.385\n"
    "#Principal Point mm\nPx 1.0175\nPy 0.74\n#Symmetrical Lens Distortion Coeffs\nK1 -0.05\nK2 0.02\nK3 -0.003\n"
    "#Tangential Lens Distortion Coeffs\nT1 0.0012\nT2 -0.0007\n"
)
ENDING, CAM_ENDING = "_calibrated_camera_parameters.txt", "_pix4d_calibrated_internal_camera_parameters.cam"

_POSE = "0.5 0.5 -0.5 0.5 4020000.5 900.125 -751000.25"
CAMERAS_TXT = (
    "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n7 {} 400 300 277 279.5 203.5 148 -0.05 0.02 0.0012 -0.0007\n"
)
IMAGES_TXT = f"# Image list\n3 {_POSE} 7 a/one.jpg\n1.5 2.5 -1 3.0 4.0 7\n5 {_POSE} 7 two of it.jpg\n\n"
LENSES = ("OPENCV", "OPENCV_FISHEYE")

FISHEYES = (
    {"projection_type": "fisheye", "width": 800, "height": 600, "focal": 0.5, "k1": -0.01, "k2": 0.002},
    {"projection_type": "fisheye_opencv", "width": 800, "height": 600, "focal_x": 0.5, "focal_y": 0.51, "c_x": 0.01,
     "c_y": -0.01, "k1": -0.01, "k2": 0.002, "k3": 1e-3, "k4": 1e-4},
)  # fmt: skip
FISHEYE_SHOTS = [json.dumps([RECONSTRUCTION | {"cameras": {"one": one}}]) for one in FISHEYES]

DATAFLASH = (dataflash([AT, AT | {"Img": 8, "Lat": 36.31}]), dataflash([AT], [POINTED]))
DATAFLASH_TEXT = (dataflash_text([AT, AT | {"Img": 8, "Lat": 36.31}]), dataflash_text([AT], [POINTED]))
_TURNED = [0.96, 0.02, -0.03, (1.0 - 0.96**2 - 0.02**2 - 0.03**2) ** 0.5]
ULOG = (ulog([_TURNED] * 2), ulog([_TURNED], gimbal=True))

LITCHI = (
    "latitude,longitude,altitude(m),time(millisecond),datetime(utc),datetime(local),istakingphoto,gimbalPitchRaw,"
    "gimbalRollRaw,gimbalYawRaw\n36.3,-84.2,300,1500,2021-05-04 10:20:31.250,2021-05-04 06:20:31.250,0,-600,20,305\n"
    "36.3002,-84.2001,301.5,2500,2021-05-04 10:20:32.250,2021-05-04 06:20:32.250,1,-605,20,310\n"
)
FLIGHT_READER = (
    "sep=,\nCUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,OSD.longitude,"
    "OSD.height [ft],OSD.altitude [ft],OSD.gpsLevel,GIMBAL.pitch,GIMBAL.roll,GIMBAL.yaw,CAMERA.isPhoto\n"
    "5/4/2021,6:20:31.25 AM,0m 12.5s,12.5,36.3,-84.2,984.252,2952.756,5,-60,2,30.5,False\n"
    "5/4/2021,6:20:32.25 AM,0m 13.5s,13.5,36.3002,-84.2,984.5,2953,5,-60.5,2,31,True\n"
)

BAND = {
    "Camera:PerspectiveFocalLength": "5.45", "Camera:PerspectiveFocalLengthUnits": "mm",
    "Camera:PrincipalPoint": "0.125,0.088", "Camera:PerspectiveDistortion": [-0.1, 0.15, -0.07, 0.0003, -0.0002],
    "Camera:RigRelatives": "0.35, -0.42, 0.17", "Camera:BandName": "NIR", "Camera:ModelType": "perspective",
    "DLS:Yaw": "0.7", "DLS:Pitch": "0.05", "DLS:Roll": "-0.03",
}  # fmt: skip


def band(path: pathlib.Path) -> None:
    from PIL.TiffImagePlugin import IFDRational

    density = {tag: IFDRational(266666667, 1000000) for tag in (0xA20E, 0xA20F)} | {0xA210: 4}
    write_image(path, packet(BAND), make="MicaSense", model="RedEdge-M", exif=density, size=(64, 48))


def read_pix4d(path: pathlib.Path) -> Any:
    path.with_name(path.name.removesuffix(ENDING) + "_offset.xyz").write_text(" ".join(map(str, OFFSET)))
    return read_acquisition(path, crs=UTM, height_datum=UNDULATION)


def read_cam(path: pathlib.Path) -> Any:
    twin = path.with_name(path.name.removesuffix(CAM_ENDING) + CAM_ENDING.replace("_pix4d", ""))
    twin.write_text("camera_calibration_file 0\n\n#Image size 400x300 pixel\n")
    return pix4d_camera(path)


def models(stem: str, ending: str) -> Seeds:
    """Files of COLMAP models, `cameras` or `images`."""
    return lambda folder: [_model(lens)[f"{stem}{ending}"] for lens in LENSES]


def read_model_with(stem: str, ending: str) -> Callable[[pathlib.Path], Any]:
    """A model with the file in it, in a folder of the file's name."""

    def read(path: pathlib.Path) -> Any:
        folder = path.with_name(f"of {path.name}")
        folder.mkdir(exist_ok=True)
        for name, content in _model(LENSES[0]).items():
            if name.endswith(ending):
                (folder / name).write_bytes(path.read_bytes() if name.startswith(stem) else content)
        return read_acquisition(folder, crs=UTM, height_datum=UNDULATION)

    return read


def _model(lens: str) -> dict[str, bytes]:
    parameters = [277.0, 279.5, 203.5, 148.0, -0.05, 0.02, 0.0012, -0.0007]
    pose = [float(word) for word in _POSE.split()]
    images = struct.pack("<Q", 2)
    for number, name, points in ((3, b"a/one.jpg", 2), (5, b"two of it.jpg", 0)):
        images += struct.pack("<I7dI", number, *pose, 7) + name + b"\0" + struct.pack("<Q", points)
        images += struct.pack("<ddQ", 1.5, 2.5, 2**64 - 1) * points
    return {
        "cameras.txt": CAMERAS_TXT.format(lens).encode(),
        "images.txt": IMAGES_TXT.encode(),
        "cameras.bin": struct.pack("<QiiQQ8d", 1, 7, {"OPENCV": 4, "OPENCV_FISHEYE": 5}[lens], 400, 300, *parameters),
        "images.bin": images,
    }

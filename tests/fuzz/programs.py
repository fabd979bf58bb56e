"""Readers of exports of photogrammetry programs, logs of autopilots and apps, and single bands: for `readers`."""

from __future__ import annotations

import pathlib
from typing import Any

import jax

from jaxgeo.io import read_acquisition
from jaxgeo.io.acquisitions import Acquisition
from tests.fuzz.reading import Reader
from tests.fuzz.second import programs, structured
from tests.fuzz.sound_files import ACQUISITION, TABLE, contents, files, finite, sound, texts
from tests.fuzz.sound_programs import (
    CAM_ENDING,
    DATAFLASH,
    DATAFLASH_TEXT,
    ENDING,
    FISHEYE_SHOTS,
    FLIGHT_READER,
    LENS,
    LITCHI,
    PIX4D,
    PIX4D_CAM,
    ULOG,
    band,
    models,
    read_cam,
    read_model_with,
    read_pix4d,
)

TAKEOFF = 600.0  # m
MODELS = [(stem, ending) for stem in ("cameras", "images") for ending in (".txt", ".bin")]


def _log(**how: Any) -> Any:
    def read(path: pathlib.Path) -> Acquisition:
        return read_acquisition(path, **how)

    return read


def _camera(camera: Any) -> None:
    finite(*jax.tree.leaves(camera))


PROGRAMS: tuple[Reader, ...] = (
    Reader(
        "camera parameters of Pix4D",
        ENDING,
        texts(PIX4D),
        read_pix4d,
        ACQUISITION,
        sound,
        text=True,
        second=programs.pix4d,
        tests="pix4d_cameras",
    ),
    Reader(
        "camera of Pix4D",
        CAM_ENDING,
        texts(PIX4D_CAM),
        read_cam,
        TABLE,
        _camera,
        text=True,
        second=programs.cam,
        tests="pix4d_cameras",
    ),
    *(
        Reader(
            f"{stem} of COLMAP, {'text' if ending == '.txt' else 'binary'}",
            ending,
            models(stem, ending),
            read_model_with(stem, ending),
            ACQUISITION,
            sound,
            text=ending == ".txt",
            second=programs.model(stem, ending),
            tests="colmap_models",
        )
        for stem, ending in MODELS
    ),
    Reader(
        "fisheyes of OpenSfM",
        ".json",
        texts(*FISHEYE_SHOTS),
        _log(height_datum="ellipsoid"),
        ACQUISITION,
        sound,
        text=True,
        second=structured.shots_of_opensfm,
        tests="opensfm",
    ),
    Reader(
        "log of ArduPilot, binary",
        ".bin",
        contents(*DATAFLASH),
        _log(height_datum="ellipsoid", cameras=LENS),
        ACQUISITION,
        sound,
        second=programs.dataflash,
        tests="autopilot_logs",
    ),
    Reader(
        "log of ArduPilot, text",
        ".log",
        texts(*DATAFLASH_TEXT),
        _log(takeoff_height=TAKEOFF, cameras=LENS),
        ACQUISITION,
        sound,
        text=True,
        second=programs.dataflash_text,
        tests="autopilot_logs",
    ),
    Reader(
        "log of PX4",
        ".ulg",
        contents(*ULOG),
        _log(height_datum="ellipsoid", cameras=LENS),
        ACQUISITION,
        sound,
        second=programs.px4,
        tests="autopilot_logs",
    ),
    Reader(
        "flight log of Litchi",
        ".csv",
        texts(LITCHI),
        _log(takeoff_height=TAKEOFF),
        ACQUISITION,
        sound,
        text=True,
        second=programs.app_log(
            ("latitude", "longitude", "gimbalyawraw", "gimbalpitchraw", "gimbalrollraw"), "altitude", 0.1, TAKEOFF
        ),
        tests="flight_log_programs",
    ),
    Reader(
        "flight log at a time",
        ".csv",
        texts(LITCHI),
        _log(takeoff_height=TAKEOFF, times=("00:00:00.5",)),
        ACQUISITION,
        sound,
        text=True,
        second=programs.interpolated,
        tests="flight_log_programs",
    ),
    Reader(
        "flight log of Flight Reader",
        ".csv",
        texts(FLIGHT_READER),
        _log(takeoff_height=TAKEOFF),
        ACQUISITION,
        sound,
        text=True,
        second=programs.app_log(
            ("osd.latitude", "osd.longitude", "gimbal.yaw", "gimbal.pitch", "gimbal.roll"), "osd.height", 1.0, TAKEOFF
        ),
        tests="flight_log_programs",
    ),
    Reader(
        "image of a band",
        ".tif",
        files(band, {}, ending=".tif"),
        _log(height_datum="ellipsoid"),
        ACQUISITION,
        sound,
        text=True,
        second=programs.band,
        tests="band_images",
    ),
)

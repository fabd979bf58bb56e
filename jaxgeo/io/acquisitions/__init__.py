"""Readers of exposures: drone images, telemetry, navigation, orientations, reconstructions."""

from __future__ import annotations

from jaxgeo.io.acquisitions.airdata import read_airdata
from jaxgeo.io.acquisitions.ardupilot import read_ardupilot
from jaxgeo.io.acquisitions.blocks import acquisition_of_opensfm, acquisition_of_orientations
from jaxgeo.io.acquisitions.colmap import read_colmap
from jaxgeo.io.acquisitions.detect import read_acquisition
from jaxgeo.io.acquisitions.dji_subtitles import read_dji_subtitles
from jaxgeo.io.acquisitions.dji_videos import read_dji_video
from jaxgeo.io.acquisitions.drone_images import read_drone_images
from jaxgeo.io.acquisitions.flight_reader import read_flight_reader
from jaxgeo.io.acquisitions.litchi import read_litchi
from jaxgeo.io.acquisitions.metashape import read_metashape_cameras
from jaxgeo.io.acquisitions.micmac import read_micmac
from jaxgeo.io.acquisitions.orthority import read_orthority, read_orthority_cameras
from jaxgeo.io.acquisitions.pix4d import read_pix4d
from jaxgeo.io.acquisitions.positions import with_positions
from jaxgeo.io.acquisitions.px4 import read_px4
from jaxgeo.io.acquisitions.record import Acquisition, Reported, UnstatedDatum, for_each
from jaxgeo.io.acquisitions.reported import Comparison, compare_reported
from jaxgeo.io.acquisitions.sbet import SbetRecords, read_sbet
from jaxgeo.io.acquisitions.several import AcquisitionSet, Unread, read_acquisitions
from jaxgeo.io.acquisitions.telemetry import read_telemetry
from jaxgeo.io.acquisitions.usual_errors import with_usual_errors

__all__ = [
    "Acquisition",
    "AcquisitionSet",
    "Comparison",
    "Reported",
    "SbetRecords",
    "Unread",
    "UnstatedDatum",
    "acquisition_of_opensfm",
    "acquisition_of_orientations",
    "compare_reported",
    "for_each",
    "read_acquisition",
    "read_acquisitions",
    "read_airdata",
    "read_ardupilot",
    "read_colmap",
    "read_dji_subtitles",
    "read_dji_video",
    "read_drone_images",
    "read_flight_reader",
    "read_litchi",
    "read_metashape_cameras",
    "read_micmac",
    "read_orthority",
    "read_orthority_cameras",
    "read_pix4d",
    "read_px4",
    "read_sbet",
    "read_telemetry",
    "with_positions",
    "with_usual_errors",
]

"""Drone makers' image tags for camera position and attitude, and their meaning."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._given_angles import PITCH, ROLL, YAW, by_hand
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.errors import TableError


@dataclass(frozen=True)
class Maker:
    """Tag names of one maker. Those without a maker's prefix are EXIF's, common to all makers.

    - `angles`: yaw, pitch and roll of the camera, R_ned_from_head = Rz Ry Rx; at zero it looks `forward` or `down`.
    - `aircraft`: heading, pitch and roll of the aircraft, optional; `lat`, `lon`: the first that is present.
    - `height` above some datum, `relative` to the take-off point; `sigma`: standard deviations north, east, down, m.
    - `datum`: a tag that may state that `height` is ellipsoidal; `evidence`: tags that help a reader to decide.
    - `make`, `model`: prefixes in lower case that alone select the row; `hint`: for a pitch out of range.
    - `in_rad`: the angles are in rad; `note`: an assumption about them.
    """

    form: str
    angles: tuple[str, str, str]
    looks: Literal["forward", "down"] = "forward"
    aircraft: tuple[str, ...] = ()
    lat: tuple[str, ...] = ()
    lon: tuple[str, ...] = ()
    height: str = "EXIF:GPSAltitude"
    relative: str = ""
    sigma: tuple[str, ...] = ()
    datum: str = ""
    evidence: tuple[str, ...] = ("EXIF:GPSAltitudeRef", "EXIF:GPSMapDatum")
    make: str = ""
    model: str = ""
    pitch: Limits = PITCH
    hint: str = ""
    in_rad: bool = False
    note: str = ""


PIX4D_ANGLES = ("Camera:Yaw", "Camera:Pitch", "Camera:Roll")
PIX4D_SIGMA = ("Camera:GPSXYAccuracy", "Camera:GPSXYAccuracy", "Camera:GPSZAccuracy")

PIX4D = Maker("image with Pix4D's camera tags", PIX4D_ANGLES, looks="down", sigma=PIX4D_SIGMA)

# The first row whose angles are in the file is used. Autel's newer files have DJI's tags.
MAKERS = (
    Maker(
        "DJI drone image",
        ("drone-dji:GimbalYawDegree", "drone-dji:GimbalPitchDegree", "drone-dji:GimbalRollDegree"),
        aircraft=("drone-dji:FlightYawDegree", "drone-dji:FlightPitchDegree", "drone-dji:FlightRollDegree"),
        lat=("drone-dji:GpsLatitude", "drone-dji:Latitude"),
        lon=("drone-dji:GpsLongitude", "drone-dji:GpsLongtitude", "drone-dji:Longitude"),
        height="drone-dji:AbsoluteAltitude",
        relative="drone-dji:RelativeAltitude",
        sigma=("drone-dji:RtkStdLat", "drone-dji:RtkStdLon", "drone-dji:RtkStdHgt"),
        evidence=("drone-dji:AltitudeType", "drone-dji:RtkFlag", "drone-dji:GpsStatus", "EXIF:GPSAltitudeRef"),
    ),
    Maker(
        "Skydio drone image",
        (
            "drone-skydio:CameraOrientationNED/Yaw",
            "drone-skydio:CameraOrientationNED/Pitch",
            "drone-skydio:CameraOrientationNED/Roll",
        ),
        lat=("drone-skydio:Latitude",),
        lon=("drone-skydio:Longitude",),
        height="drone-skydio:AbsoluteAltitude",
        relative="drone-skydio:RelativeAltitude",
        datum="drone-skydio:VertCS",
        evidence=("drone-skydio:VertCS", "drone-skydio:GpsMslHeight"),
    ),
    Maker(
        "Parrot drone image",
        ("drone-parrot:CameraYawDegree", "drone-parrot:CameraPitchDegree", "drone-parrot:CameraRollDegree"),
        sigma=PIX4D_SIGMA,
    ),
    Maker("Autel drone image", PIX4D_ANGLES, model="xl715", sigma=PIX4D_SIGMA),  # its pitch is relative to the horizon
    Maker(
        "Autel drone image",
        PIX4D_ANGLES,
        looks="down",
        make="autel",
        sigma=PIX4D_SIGMA,
        pitch=(0.0, 180.0, "deg"),
        hint=" Autel means by it an angle from straight down, but in some models one from the horizon, as this may be; "
        "write the angles as drone-dji:GimbalYawDegree, GimbalPitchDegree, GimbalRollDegree (exiftool).",
    ),
    PIX4D,
    Maker(
        "MicaSense image",
        ("DLS:Yaw", "DLS:Pitch", "DLS:Roll"),
        looks="down",
        make="micasense",
        sigma=PIX4D_SIGMA,
        in_rad=True,
        note="The camera is taken to be turned as its light sensor is (DLS, in rad): mounted with its arrow to the top "
        "of the image, level where the camera looks straight down.",
    ),
)


ANY = replace(PIX4D, form="image with a position in EXIF")  # no maker, angles from the caller


def maker_of(tags: ImageTags, *, angles_are_given: bool = False) -> Maker:
    """The maker of an image's tags; with angles from the caller (relative to the horizon) none is required.

    Raises `TableError` if no tag gives the camera's attitude.
    """
    if angles_are_given:
        prefixes = {name.partition(":")[0] for name in tags.values}
        maker = next((one for one in MAKERS if one.angles[0].partition(":")[0] in prefixes), ANY)
        return replace(maker, looks="forward")
    make, model = (name.lower() for name in tags.camera)
    for maker in MAKERS:
        is_theirs = make.startswith(maker.make) and model.startswith(maker.model)
        there = [name for name in maker.angles if name in tags.values]
        if is_theirs and len(there) == 3:
            return maker
        if is_theirs and there:
            missing = ", ".join(name for name in maker.angles if name not in there)
            raise TableError(
                f"{tags.path}: there is {there[0]}, but no {missing}; all three are needed. {by_hand(tags)}"
            )
    known = ", ".join(dict.fromkeys(maker.angles[0] for maker in MAKERS))
    prefixes = sorted({name.partition(":")[0] for name in tags.values} - {"EXIF"})
    raise TableError(
        f"{tags.path}: nothing says how the camera was turned; expected one of {known}; found XMP of "
        f"{', '.join(prefixes) or 'no kind'}. Take the file as the drone wrote it (editors drop such tags). "
        f"{by_hand(tags)}"
    )


def angles_of(tags: ImageTags, maker: Maker) -> list[float | None]:
    """Yaw, pitch and roll of the camera in deg, as written.

    Raises `TableError`, also if all are zero, which is written for unknown angles.
    """
    if reason := tags.unknown("camera angles", maker.angles):
        raise TableError(f"{tags.path}: how the camera was turned is unknown: {reason}. {by_hand(tags)}")
    try:
        return [
            _angle(tags, name, limits, maker)
            for name, limits in zip(maker.angles, (YAW, maker.pitch, ROLL), strict=True)
        ]
    except TableError as error:
        hint = maker.hint if maker.angles[1] in str(error) else ""
        raise TableError(f"{error}{hint} {by_hand(tags)}") from error


def _angle(tags: ImageTags, name: str, limits: Limits, maker: Maker) -> float | None:
    """An angle in deg."""
    if not maker.in_rad:
        return tags.number(name, limits)
    low, high, _ = limits
    found = tags.number(name, (math.radians(low), math.radians(high), "rad"))
    return None if found is None else math.degrees(found)


def aircraft_of(tags: ImageTags, maker: Maker) -> list[float | None]:
    """Heading, pitch and roll of the aircraft in deg; None if missing or invalid.

    They do not affect lines of sight, so an image is not refused for them.
    """
    try:
        found = [tags.number(name, limits) for name, limits in zip(maker.aircraft, (YAW, PITCH, ROLL), strict=False)]
    except TableError:
        found = []
    return found or [None] * 3

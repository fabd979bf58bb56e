"""What the makers of drones call position and attitude of the camera in an image's tags, and what they mean by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.errors import TableError

YAW: Limits = (-360.0, 360.0, "deg")
PITCH: Limits = (-180.0, 180.0, "deg")
ROLL: Limits = (-180.0, 180.0, "deg")


@dataclass(frozen=True)
class Maker:
    """The names of one maker's tags. Those without a prefix of a maker are EXIF's, for all makers alike.

    - `angles`: yaw, pitch and roll of the camera, R_ned_from_head = Rz Ry Rx; at zero it looks `forward` or `down`.
    - `aircraft`: heading, pitch and roll of the aircraft, perhaps none; `lat`, `lon`: the first that is there.
    - `height` above some datum, `relative` to the point of take-off; `sigma`: standard deviations north, east, down, m.
    - `datum`: the tag that may say that `height` is above the ellipsoid; `evidence`: tags that help a reader to tell.
    - `make`, `model`: beginnings, in small letters, by which alone the row is chosen; `hint`: on a pitch out of range.
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


PIX4D_ANGLES = ("Camera:Yaw", "Camera:Pitch", "Camera:Roll")
PIX4D_SIGMA = ("Camera:GPSXYAccuracy", "Camera:GPSXYAccuracy", "Camera:GPSZAccuracy")

# The first row whose angles are in the file is taken. Autel's newer files carry DJI's tags.
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
    Maker("Autel drone image", PIX4D_ANGLES, model="xl715", sigma=PIX4D_SIGMA),  # its pitch is against the horizon
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
    Maker("image with Pix4D's camera tags", PIX4D_ANGLES, looks="down", sigma=PIX4D_SIGMA),
)


ANY = replace(MAKERS[-1], form="image with a position in EXIF")  # of no maker, its angles given by the caller


def maker_of(tags: ImageTags, given: tuple[float, float, float] | None = None) -> Maker:
    """Whose tags an image has; with angles `given`, from the horizon, in place of those in the file.

    Raises `TableError` where nothing says how the camera was turned.
    """
    if given is not None:
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
                f"{tags.path}: there is {there[0]}, but no {missing}; all three are needed. {_by_hand(tags)}"
            )
    known = ", ".join(dict.fromkeys(maker.angles[0] for maker in MAKERS))
    prefixes = sorted({name.partition(":")[0] for name in tags.values} - {"EXIF"})
    raise TableError(
        f"{tags.path}: nothing says how the camera was turned; expected one of {known}; found XMP of "
        f"{', '.join(prefixes) or 'no kind'}. Take the file as the drone wrote it: editors drop such tags. "
        f"{_by_hand(tags)}"
    )


def _by_hand(tags: ImageTags) -> str:
    """The way out for an image without angles, with the heading of the aircraft if that is told."""
    heading = next((tags.number(one.aircraft[0], YAW) for one in MAKERS if one.aircraft), None) or 0.0
    return (
        f"Or give yaw, pitch and roll of the camera in deg; of one that looked straight down, its top towards "
        f"{heading:g} deg: gimbal_deg=({heading:g}, -90, 0)."
    )


def checked_angles(gimbal_deg: Sequence[float]) -> tuple[float, float, float]:
    """Yaw, pitch and roll in deg as given by a caller. Raises `TableError` for others than three angles."""
    angles = [float(one) for one in gimbal_deg]
    shown = ", ".join(f"{one:g}" for one in angles)
    if len(angles) != 3:
        raise TableError(f"gimbal_deg=({shown}): expected three angles in deg: yaw, pitch, roll.")
    for value, name, (low, high, _) in zip(angles, ("yaw", "pitch", "roll"), (YAW, PITCH, ROLL), strict=True):
        if not low <= value <= high:
            raise TableError(f"gimbal_deg=({shown}): {name} {value:g} is outside [{low:g}, {high:g}] deg.")
    return angles[0], angles[1], angles[2]


def angles_of(tags: ImageTags, maker: Maker) -> list[float | None]:
    """Yaw, pitch and roll of the camera in deg, as they are written.

    Raises `TableError`, also where all are zero, which is written where they are not known.
    """
    if reason := tags.unknown("camera angles", maker.angles):
        raise TableError(f"{tags.path}: how the camera was turned is unknown: {reason}. {_by_hand(tags)}")
    try:
        return [tags.number(name, limits) for name, limits in zip(maker.angles, (YAW, maker.pitch, ROLL), strict=True)]
    except TableError as error:
        hint = maker.hint if maker.angles[1] in str(error) else ""
        raise TableError(f"{error}{hint} {_by_hand(tags)}") from error


def aircraft_of(tags: ImageTags, maker: Maker) -> list[float | None]:
    """Heading, pitch and roll of the aircraft in deg, None where they are not there. Raises `TableError`."""
    found = [tags.number(name, limits) for name, limits in zip(maker.aircraft, (YAW, PITCH, ROLL), strict=False)]
    return found or [None] * 3

"""Detect the kind of a file from its content and read its exposures."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo._record import portable
from jaxgeo._text_numbers import numbers_in
from jaxgeo.io._dialect import header_of
from jaxgeo.io._orientation_columns import KNOWN, meanings
from jaxgeo.io._regular import check_regular
from jaxgeo.io._text import text_of
from jaxgeo.io._triangulation import program_of
from jaxgeo.io.acquisitions._applanix import FIELDS
from jaxgeo.io.acquisitions._by_time import by_time
from jaxgeo.io.acquisitions._camera_checks import with_camera_doubts
from jaxgeo.io.acquisitions._film_errors import with_film_errors
from jaxgeo.io.acquisitions._position_tables import form_of_positions, read_positions
from jaxgeo.io.acquisitions._takeoff import with_takeoff_sigma
from jaxgeo.io.acquisitions.airdata import read_airdata
from jaxgeo.io.acquisitions.ardupilot import BINARY as DATAFLASH
from jaxgeo.io.acquisitions.ardupilot import FORM as ARDUPILOT_FORM
from jaxgeo.io.acquisitions.ardupilot import TEXT as DATAFLASH_TEXT
from jaxgeo.io.acquisitions.ardupilot import read_ardupilot
from jaxgeo.io.acquisitions.blocks import acquisition_of_opensfm, acquisition_of_orientations
from jaxgeo.io.acquisitions.colmap import FORM as COLMAP_FORM
from jaxgeo.io.acquisitions.colmap import files_of_model, is_colmap, read_colmap
from jaxgeo.io.acquisitions.dji_subtitles import CUE, read_dji_subtitles
from jaxgeo.io.acquisitions.dji_videos import FORM as VIDEO_FORM
from jaxgeo.io.acquisitions.dji_videos import STILLS, TYPE, is_video, read_dji_video
from jaxgeo.io.acquisitions.drone_images import read_drone_images
from jaxgeo.io.acquisitions.flight_reader import read_flight_reader
from jaxgeo.io.acquisitions.klv import UAS_LOCAL_SET, other_sets
from jaxgeo.io.acquisitions.litchi import read_litchi
from jaxgeo.io.acquisitions.metashape import read_metashape_cameras
from jaxgeo.io.acquisitions.micmac import FORM as MICMAC_FORM
from jaxgeo.io.acquisitions.micmac import files_of_orientations, read_micmac
from jaxgeo.io.acquisitions.orthority import read_orthority
from jaxgeo.io.acquisitions.pix4d import FORM as PIX4D_FORM
from jaxgeo.io.acquisitions.pix4d import files_of_parameters, read_pix4d
from jaxgeo.io.acquisitions.positions import with_table
from jaxgeo.io.acquisitions.px4 import FORM as PX4_FORM
from jaxgeo.io.acquisitions.px4 import MAGIC, read_px4
from jaxgeo.io.acquisitions.record import Acquisition, for_each
from jaxgeo.io.acquisitions.sbet import read_sbet
from jaxgeo.io.acquisitions.telemetry import read_telemetry
from jaxgeo.io.acquisitions.transport_stream import is_transport_stream
from jaxgeo.io.errors import ImageError, TableError
from jaxgeo.io.given_camera import cameras_by_name, is_a_name, whole_camera
from jaxgeo.io.images import opened
from jaxgeo.io.scene import read_scene

HEAD = 65_536  # bytes read for detection
IMAGES = (b"\xff\xd8\xff", b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")  # JPEG, TIFF and BigTIFF in both orders
PICTURES: dict[str, Callable[[bytes], bool]] = {
    "PNG": lambda head: head.startswith(b"\x89PNG\r\n"),
    "GIF": lambda head: head.startswith((b"GIF87a", b"GIF89a")),
    "WebP": lambda head: head[:4] == b"RIFF" and head[8:12] == b"WEBP",
    "HEIF": lambda head: head[4:8] == TYPE and head[8:12] in STILLS,
}
RECORD = 8 * len(FIELDS)  # bytes of an SBET
TEXT = frozenset(range(32, 256)) | {9, 10, 12, 13}


@portable
class WrongOption(TableError):
    """An option that the reader of a `kind` of file does not accept; `takes` are those it does."""

    def __init__(self, path: str, kind: str, name: str, takes: tuple[str, ...]) -> None:
        super().__init__(
            f"{path}: this is a {kind}, and {name} is no option of it; options are {', '.join(takes) or 'none'}."
        )
        self.path, self.kind, self.name, self.takes = path, kind, name, takes


class Form(NamedTuple):
    """A kind of file: its name, a test of path and first bytes, its reader, the reader's options."""

    name: str
    is_one: Callable[[pathlib.Path, bytes], bool]
    read: Callable[..., Acquisition]
    takes: tuple[str, ...]


def read_acquisition(path: str | os.PathLike[str], **how: Any) -> Acquisition:
    """Read the exposures of a file of any supported kind: a drone image or a folder of them, KLV telemetry (raw or in
    an MPEG transport stream), SBET, an orientation table, Orthority parameters, an OpenSfM reconstruction, a COLMAP
    model, MicMac orientations or Pix4D camera parameters (folder or file), Metashape cameras (XML), DJI videos and
    their subtitles, flight logs (AirData, Litchi, Flight Reader, ArduPilot, PX4), a scene.

    `how` are options of its reader; those that are None are ignored: `height_datum`; `takeoff_height` (drone
    images, videos, subtitles, flight logs), with `takeoff_sigma`, its standard deviation in m, part of the default
    errors of position; `gimbal_deg`, and `positions`, a file for `with_positions` (drone images);
    `image_size`, `upright`, `keep_damaged`, `stream` (telemetry); `times`, such as "00:01:23", "83.5" or
    "2024-05-10T10:20:31Z": exposures at these times, interpolated (telemetry, videos, subtitles, flight logs but those
    of photos); `crs` and `camera`, a camera name (orientations, parameters, reconstructions), or a lens or file as for
    images (telemetry, orientations, logs); `cameras` (the same); `part` (reconstructions); `errors`, the smrmsg, and
    `velocities`, whether they are read (SBET); `interior`, the interior parameters of Orthority. Raises `TableError`
    for an unknown kind of file, and for an option that its reader does not accept; `FileNotFoundError`; and as the
    readers.

    >>> import os, tempfile
    >>> from jaxgeo.demo import drone_image
    >>> folder = tempfile.TemporaryDirectory()
    >>> image = drone_image(os.path.join(folder.name, "drone.jpg"), columns=64).path
    >>> found = jaxgeo.io.read_acquisition(image, height_datum="EPSG:5773")
    >>> print(found.form, found.facts["image size"], np.shape(found.shots.gimbal_readings))
    DJI drone image 64 x 48 pixels (1, 3)
    >>> print(found.assumed[-1])
    No errors of the angles are taken from the files.
    >>> folder.cleanup()
    """
    form = form_of(path)
    given = {name: value for name, value in how.items() if value is not None}
    takeoff_sigma = given.pop("takeoff_sigma", None)
    found = reader_of(form, given)(path, **checked_options(path, form, given))
    return with_takeoff_sigma(found, takeoff_sigma, given.get("takeoff_height"))


def reader_of(form: Form, given: Mapping[str, Any]) -> Callable[..., Acquisition]:
    """The reader of a kind of file; Orthority parameters differ from a table only by the option `interior`."""
    if form is ORTHORITY_OR_TABLE:
        form = ORTHORITY if "interior" in given else ORIENTATIONS
    return with_camera_doubts(with_film_errors(form.read, given.get("camera")))


def checked_options(path: str | os.PathLike[str], form: Form, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options, if the reader accepts all. Raises `WrongOption`."""
    if form is ORTHORITY_OR_TABLE:
        form = ORTHORITY if "interior" in given else ORIENTATIONS
    for name in given:
        if name not in form.takes:
            raise WrongOption(os.fspath(path), form.name, name, form.takes)
    if "cameras" in form.takes and not is_a_name(given.get("camera", "")):
        others = {name: value for name, value in given.items() if name != "camera"}
        by_name = form is ORIENTATIONS
        return others | {"cameras": (cameras_by_name if by_name else whole_camera)(given["camera"])}
    return given


def form_of(path: str | os.PathLike[str]) -> Form:
    """The kind of a file. Raises `TableError` if it is unknown, `FileNotFoundError`."""
    place = pathlib.Path(path)
    if place.is_dir():
        return form_of_folder(place) or DRONE_IMAGES
    check_regular(place, TableError)
    try:
        with open(place, "rb") as file:
            head = file.read(HEAD)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise TableError(f"{path}: it cannot be read: {error.strerror}.") from error
    if not head:
        raise TableError(f"{path}: the file is empty.")
    for form in FORMS:
        if form.is_one(place, head):
            return form
    _refuse_image(path, head)
    _refuse_damaged(path, head)
    _refuse_nameless(path, head)
    kinds = ", ".join(dict.fromkeys(form.name for form in FORMS))
    raise TableError(f"{path}: unrecognised file type. Supported: {kinds}.")


def _refuse_image(path: str | os.PathLike[str], head: bytes) -> None:
    """Raises `TableError` for images of kinds that cameras of drones do not write, and whose metadata are not read."""
    kind = next((name for name, is_one in PICTURES.items() if is_one(head)), None)
    if kind is not None:
        raise TableError(
            f"{path}: no camera metadata are read from a {kind} image. Give the JPEG or TIFF file of the camera, "
            "a table of orientations that names the image, or a scene file with camera and pose: "
            "`jaxgeo demo --write-scene scene.toml` writes one to fill in, for "
            "`jaxgeo locate --scene scene.toml --dem dem.tif --pixel 100,200`."
        )


def _refuse_damaged(path: str | os.PathLike[str], head: bytes) -> None:
    """Raises `TableError` for blanks only, and for text with zero bytes, as in files that were not copied whole."""
    if not head.strip(b"\0\xef\xbb\xbf \t\r\n"):
        raise TableError(f"{path}: the file has only {'zero bytes' if head[0] == 0 else 'blanks'}: copy it again.")
    zero = head.find(b"\0\0\0\0\0\0\0\0")
    if zero > 0 and text_of(head[:zero], is_cut=True) is not None:
        raise TableError(
            f"{path}: it is text up to byte {zero}, and zero bytes from there: it was not written or copied to its "
            f"end. Copy it again, or delete what follows."
        )


def _refuse_nameless(path: str | os.PathLike[str], head: bytes) -> None:
    """Raises `TableError` for rows of an image, a position and three angles without the names of the columns."""
    text = text_of(head, is_cut=True) or ""
    rows = [re.split(r"[,;\s]+", line.strip()) for line in text.splitlines()[:-1] or [text] if line.strip()]
    rows = [row for row in rows if not row[0].startswith("#")][:5]
    if rows and all(len(row) == 7 and numbers_in(row[1:]) is not None for row in rows):
        raise TableError(
            f"{path}: rows of a name and six numbers, but no names of columns, so the order and unit of the angles are "
            f"not stated; write them above, such as image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg (or omega_gon, "
            f"omega_rad)."
        )


def form_of_folder(path: str | os.PathLike[str]) -> Form | None:
    """The kind of a folder that is one block; None for a folder of images."""
    if files_of_model(path) is not None:
        return COLMAP
    if files_of_parameters(path):
        return PIX4D
    return MICMAC if files_of_orientations(path) else None


def _of_scene(path: str | os.PathLike[str]) -> Acquisition:
    """A scene with a pose as one exposure."""
    scene = read_scene(path)
    if scene.shot is None:
        raise TableError(f"{path}: [pose] is missing; the poses of this scene come from a table of shots.")
    sources = () if scene.errors is None else scene.errors.sources
    return Acquisition(
        path=os.fspath(path),
        form="scene file",
        names=np.array([pathlib.Path(path).stem]),
        sensor=for_each(scene.sensor, 1),
        shots=for_each(jax.tree.map(np.asarray, scene.shot), 1),
        sources=for_each(sources, 1),
        assumed=() if sources else ("The scene has no table [errors]: no accuracies are given.",),
        facts={"title": scene.title} if scene.title else {},
    )


def _of_sbet(path: str | os.PathLike[str], **how: Any) -> Acquisition:
    return read_sbet(path, **how).acquisition()


def _of_images(path: str | os.PathLike[str], *, positions: Any = None, crs: Any = None, **how: Any) -> Acquisition:
    """Drone images, optionally with positions from a table: heights are then the table's."""
    if _lies_in_a_map(path):
        raise TableError(
            f"{path}: this raster lies in a map, so it is not as a camera took it; an elevation model is given as one "
            f"(jaxgeo.io.read_dem)."
        )
    if positions is None:
        if crs is not None:
            raise TableError(f"{path}: crs= is of a table of positions; give it too, positions=, or leave crs= out.")
        return read_drone_images(path, **how)
    if how.get("takeoff_height") is None:
        table = read_positions(positions, height_datum=how.get("height_datum"), crs=crs)
        how |= {"height_datum": "ellipsoid"} if table.has_heights else {}
        return with_table(read_drone_images(path, **how), table)
    table = read_positions(positions, height_datum="ellipsoid", crs=crs)
    if table.has_heights:
        raise TableError(f"{path}: the heights are those of {positions}; leave takeoff_height= out.")
    return with_table(read_drone_images(path, **how), table)


def _lies_in_a_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a TIFF with a CRS."""
    if pathlib.Path(path).suffix.lower() not in (".tif", ".tiff") or not os.path.isfile(path):
        return False
    try:
        with opened(os.fspath(path)) as data:
            return data.crs is not None
    except ImageError:
        return False


def _of_positions(path: str | os.PathLike[str], **how: Any) -> Acquisition:
    raise TableError(
        f"{path}: these are positions of images, without angles or a camera; give the images, with this file as "
        f'positions="{path}".'
    )


def _of_orthority(exterior: str | os.PathLike[str], *, interior: Any = None, **how: Any) -> Acquisition:
    if interior is None:
        raise TableError(f"{exterior}: exterior parameters of Orthority need the interior ones, interior=FILE (.yaml).")
    return read_orthority(interior, exterior, **how)


def _is_image(path: pathlib.Path, head: bytes) -> bool:
    return head.startswith(IMAGES)


def _is_colmap(path: pathlib.Path, head: bytes) -> bool:
    return is_colmap(head)


def _is_ardupilot(path: pathlib.Path, head: bytes) -> bool:
    text = text_of(head, is_cut=True)
    return head.startswith(DATAFLASH) or (text is not None and text.startswith(DATAFLASH_TEXT))


def _is_px4(path: pathlib.Path, head: bytes) -> bool:
    return head.startswith(MAGIC)


def _is_telemetry(path: pathlib.Path, head: bytes) -> bool:
    return UAS_LOCAL_SET in head or is_transport_stream(head) or bool(other_sets(head))


def _is_text(head: bytes) -> bool:
    return all(byte in TEXT for byte in head)


def _has(*words: str) -> Callable[[pathlib.Path, bytes], bool]:
    """A test whether a file is text with all the words in its first bytes."""

    def has(path: pathlib.Path, head: bytes) -> bool:
        text = text_of(head, is_cut=True)
        return text is not None and all(word in text for word in words)

    return has


def _is_scene(path: pathlib.Path, head: bytes) -> bool:
    return path.suffix.lower() == ".toml" and _is_text(head)


def _is_reconstruction(path: pathlib.Path, head: bytes) -> bool:
    starts = head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"[", b"{")
    return starts and path.suffix.lower() == ".json" and _is_text(head) and b'"FeatureCollection"' not in head


def _is_positions(path: pathlib.Path, head: bytes) -> bool:
    text = text_of(head, is_cut=True)
    return text is not None and form_of_positions(text) is not None


def _is_subtitles(path: pathlib.Path, head: bytes) -> bool:
    text = text_of(head, is_cut=True)
    return text is not None and CUE.search(text) is not None and ("latitude" in text.lower() or "GPS" in text)


def _is_video(path: pathlib.Path, head: bytes) -> bool:
    return is_video(head)


def _is_log(*columns: str, one_of: tuple[str, ...]) -> Callable[[pathlib.Path, bytes], bool]:
    """A test whether the header of a table has all columns, and one of the others, in any case."""

    def is_log(path: pathlib.Path, head: bytes) -> bool:
        text = text_of(head, is_cut=True)
        if text is None or not text.strip():
            return False
        words = {name.strip(" '\"").lower() for name in header_of(text, set(columns))}
        return set(columns) <= words and bool(set(one_of) & words)

    return is_log


def _is_metashape(path: pathlib.Path, head: bytes) -> bool:
    text = text_of(head, is_cut=True)
    return text is not None and text.lstrip()[:1] == "<" and "<document" in text and "<chunk" in text


def _is_micmac(path: pathlib.Path, head: bytes) -> bool:
    text = text_of(head, is_cut=True)
    return text is not None and text.lstrip()[:1] == "<" and "<OrientationConique" in text


def _is_table(path: pathlib.Path, head: bytes) -> bool:
    """Whether a file is one of PAT-B or BINGO, or its header, which may be a comment, names columns of positions and
    angles."""
    text = text_of(head, is_cut=True)
    if text is None or not text.strip():
        return False
    if program_of(text) is not None:
        return True
    words = {name.strip(" '\"").lower() for name in header_of(text, KNOWN)}
    meant = meanings(words - {"w"})  # alone, it is a width as often
    return bool({"lat_deg", "omega_deg"} & meant) or {"x_m", "y_m", "heading_deg"} <= meant or "f=n" in words


def _is_sbet(path: pathlib.Path, head: bytes) -> bool:
    """Whether the file starts with an SBET record; if its size is no multiple of a record (truncated), with several."""
    whole = len(head) // RECORD
    if not whole or _is_text(head):
        return False
    first = np.frombuffer(head, "<f8", whole * len(FIELDS)).reshape(whole, len(FIELDS))[:4]
    apart = np.diff(first[:, 0])  # s
    if path.stat().st_size % RECORD and not (apart.size and np.all((apart > 0.0) & (apart <= 10.0))):
        return False
    turns = np.abs(first[:, 1:3]) <= [np.pi / 2.0, 2.0 * np.pi]
    return bool(np.all(np.isfinite(first)) and np.all(turns))


TELEMETRY = ("height_datum", "image_size", "upright", "keep_damaged", "stream", "camera", "times")
PLACED = ("height_datum", "crs", "camera")
IMAGES_TAKE = ("height_datum", "takeoff_height", "camera", "gimbal_deg", "positions", "crs")
DRONE_IMAGES = Form("drone image", _is_image, _of_images, IMAGES_TAKE)
COLMAP = Form(COLMAP_FORM, _is_colmap, read_colmap, PLACED)
MICMAC = Form(MICMAC_FORM, _is_micmac, read_micmac, (*PLACED, "cameras"))
PIX4D = Form(PIX4D_FORM, _has("camera matrix K [3x3]"), read_pix4d, PLACED)
# Columns of which one tells a program's log from other tables, with or without those of the gimbal.
OF_AIRDATA = ("gimbal_heading(degrees)", "compass_heading(degrees)", "isphoto", "isvideo", "gpslevel")
OF_LITCHI = ("gimbalyawraw", "gimbalpitchraw", "istakingphoto", "istakingvideo")
OF_FLIGHT_READER = ("gimbal.yaw", "gimbal.pitch", "osd.yaw", "osd.flytime", "custom.updatetime [local]")
PHOTO_LOG = ("height_datum", "takeoff_height", "camera", "cameras")
FLIGHT_LOG = (*PHOTO_LOG, "times")
ORTHORITY = Form("parameter file of Orthority", _has("FeatureCollection"), _of_orthority, (*PLACED, "interior"))
ORIENTATIONS = Form("table of orientations", _is_table, acquisition_of_orientations, (*PLACED, "cameras"))
ORTHORITY_OR_TABLE = ORIENTATIONS._replace(takes=(*ORIENTATIONS.takes, "interior"))
FORMS = (
    DRONE_IMAGES,
    Form(ARDUPILOT_FORM, _is_ardupilot, read_ardupilot, PHOTO_LOG),
    Form(PX4_FORM, _is_px4, read_px4, ("height_datum", "camera", "cameras")),
    Form("MISB ST 0601 telemetry", _is_telemetry, by_time(read_telemetry), TELEMETRY),
    Form("scene file", _is_scene, _of_scene, ()),
    Form("subtitle file of DJI", _is_subtitles, by_time(read_dji_subtitles), FLIGHT_LOG),
    Form(VIDEO_FORM, _is_video, by_time(read_dji_video), FLIGHT_LOG),
    Form(
        "flight log of AirData", _is_log("latitude", "longitude", one_of=OF_AIRDATA), by_time(read_airdata), FLIGHT_LOG
    ),
    Form("flight log of Litchi", _is_log("latitude", "longitude", one_of=OF_LITCHI), by_time(read_litchi), FLIGHT_LOG),
    Form(
        "flight log of Flight Reader",
        _is_log("osd.latitude", "osd.longitude", one_of=OF_FLIGHT_READER),
        by_time(read_flight_reader),
        FLIGHT_LOG,
    ),
    Form("camera file of Metashape", _is_metashape, read_metashape_cameras, ("height_datum", "camera")),
    COLMAP,
    MICMAC,
    PIX4D,
    Form("file of positions", _is_positions, _of_positions, (*IMAGES_TAKE, "cameras")),
    ORTHORITY,
    Form("reconstruction of OpenSfM", _is_reconstruction, acquisition_of_opensfm, (*PLACED, "part")),
    ORTHORITY_OR_TABLE,
    Form("SBET", _is_sbet, _of_sbet, ("height_datum", "errors", "between", "every", "velocities")),
)

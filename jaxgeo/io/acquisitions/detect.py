"""What kind of file it is, told by its content, and the exposures in it."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo.io.acquisitions._applanix import FIELDS
from jaxgeo.io.acquisitions.blocks import acquisition_of_opensfm, acquisition_of_orientations
from jaxgeo.io.acquisitions.drone_images import read_drone_images
from jaxgeo.io.acquisitions.klv import UAS_LOCAL_SET
from jaxgeo.io.acquisitions.orthority import read_orthority
from jaxgeo.io.acquisitions.record import Acquisition, for_each
from jaxgeo.io.acquisitions.sbet import read_sbet
from jaxgeo.io.acquisitions.telemetry import read_telemetry
from jaxgeo.io.acquisitions.transport_stream import is_transport_stream
from jaxgeo.io.errors import TableError
from jaxgeo.io.scene import read_scene

HEAD = 65_536  # bytes by which a file is told
IMAGES = (b"\xff\xd8\xff", b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")  # JPEG, TIFF and BigTIFF in both orders
RECORD = 8 * len(FIELDS)  # bytes of an SBET
TEXT = frozenset(range(32, 256)) | {9, 10, 12, 13}


class WrongOption(TableError):
    """An option that the reader of a `kind` of file does not take; `takes` are those that it does."""

    def __init__(self, path: str, kind: str, name: str, takes: tuple[str, ...]) -> None:
        super().__init__(
            f"{path}: this is a {kind}, and {name} is no option of it; options are {', '.join(takes) or 'none'}."
        )
        self.path, self.kind, self.name, self.takes = path, kind, name, takes


class Form(NamedTuple):
    """A kind of file: its name in words, how it is told by its path and first bytes, its reader, what that takes."""

    name: str
    is_one: Callable[[pathlib.Path, bytes], bool]
    read: Callable[..., Acquisition]
    takes: tuple[str, ...]


def read_acquisition(path: str | os.PathLike[str], **how: Any) -> Acquisition:
    """The exposures of a file, whatever it is: a drone's image or a folder of them, KLV telemetry (raw or in an MPEG
    transport stream), SBET, a table of orientations, parameters of Orthority, a reconstruction of OpenSfM, a scene.

    `how` are options of its reader, those that are None being left out: `height_datum`; `takeoff_height` (drone
    images); `image_size`, `upright`, `keep_damaged`, `stream` (telemetry); `crs` and `camera`, the name of one of
    several (orientations, parameters, reconstructions); `cameras` (orientations); `part` (reconstructions); `errors`,
    the smrmsg of an SBET; `interior`, the interior parameters of Orthority. Raises `TableError` for a file of no known
    kind, and for an option that its reader does not take; `FileNotFoundError`; and as the readers.

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
    return reader_of(form, given)(path, **checked_options(path, form, given))


def reader_of(form: Form, given: Mapping[str, Any]) -> Callable[..., Acquisition]:
    """The reader of a kind of file; parameters of Orthority look like a table but for the option `interior`."""
    if form is ORTHORITY_OR_TABLE:
        return (ORTHORITY if "interior" in given else ORIENTATIONS).read
    return form.read


def checked_options(path: str | os.PathLike[str], form: Form, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options, all of which the reader takes. Raises `WrongOption`."""
    if form is ORTHORITY_OR_TABLE:
        form = ORTHORITY if "interior" in given else ORIENTATIONS
    for name in given:
        if name not in form.takes:
            raise WrongOption(os.fspath(path), form.name, name, form.takes)
    return given


def form_of(path: str | os.PathLike[str]) -> Form:
    """What kind of file it is. Raises `TableError` if it is of none that is known, `FileNotFoundError`."""
    place = pathlib.Path(path)
    if place.is_dir():
        return DRONE_IMAGES
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
    kinds = ", ".join(dict.fromkeys(form.name for form in FORMS))
    raise TableError(f"{path}: unrecognised file type. Supported: {kinds}.")


def _of_scene(path: pathlib.Path) -> Acquisition:
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
        assumed=() if sources else ("The scene has no table [errors], and so says nothing of how it errs.",),
        facts={"title": scene.title} if scene.title else {},
    )


def _of_sbet(path: pathlib.Path, **how: Any) -> Acquisition:
    return read_sbet(path, **how).acquisition()


def _of_orthority(exterior: pathlib.Path, *, interior: Any = None, **how: Any) -> Acquisition:
    if interior is None:
        raise TableError(f"{exterior}: exterior parameters of Orthority need the interior ones, interior=FILE (.yaml).")
    return read_orthority(interior, exterior, **how)


def _is_image(path: pathlib.Path, head: bytes) -> bool:
    return head.startswith(IMAGES)


def _is_telemetry(path: pathlib.Path, head: bytes) -> bool:
    return UAS_LOCAL_SET in head or is_transport_stream(head)


def _is_text(head: bytes) -> bool:
    return all(byte in TEXT for byte in head)


def _has(*words: bytes) -> Callable[[pathlib.Path, bytes], bool]:
    """Whether a file is text with all the words in its first bytes."""
    return lambda path, head: _is_text(head) and all(word in head for word in words)


def _is_scene(path: pathlib.Path, head: bytes) -> bool:
    return path.suffix.lower() == ".toml" and _is_text(head)


def _is_reconstruction(path: pathlib.Path, head: bytes) -> bool:
    starts = head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"[", b"{")
    return starts and path.suffix.lower() == ".json" and _is_text(head) and b'"FeatureCollection"' not in head


def _is_table(path: pathlib.Path, head: bytes) -> bool:
    """Whether the first line names columns of positions and angles."""
    if not _is_text(head):
        return False
    line = head.splitlines()[0].decode("latin-1").lower()
    words = {word.strip(" '\"\ufeff\xef\xbb\xbf") for word in line.replace(";", ",").replace(",", " ").split()}
    on_earth = {"lat_deg", "latitude"} & words
    on_map = {"omega", "omega_deg", "omega_gon", "omega_rad", "o"} & words
    return bool(on_earth or on_map)


def _is_sbet(path: pathlib.Path, head: bytes) -> bool:
    """Whether it begins with a record of an SBET, or, where its size is of none, being cut off, with several."""
    whole = len(head) // RECORD
    if not whole or _is_text(head):
        return False
    first = np.frombuffer(head, "<f8", whole * len(FIELDS)).reshape(whole, len(FIELDS))[:4]
    apart = np.diff(first[:, 0])  # s
    if path.stat().st_size % RECORD and not (apart.size and np.all((apart > 0.0) & (apart <= 10.0))):
        return False
    turns = np.abs(first[:, 1:3]) <= [np.pi / 2.0, 2.0 * np.pi]
    return bool(np.all(np.isfinite(first)) and np.all(turns))


TELEMETRY = ("height_datum", "image_size", "upright", "keep_damaged", "stream")
PLACED = ("height_datum", "crs", "camera")
DRONE_IMAGES = Form("drone image", _is_image, read_drone_images, ("height_datum", "takeoff_height", "camera"))
ORTHORITY = Form("parameter file of Orthority", _has(b"FeatureCollection"), _of_orthority, (*PLACED, "interior"))
ORIENTATIONS = Form("table of orientations", _is_table, acquisition_of_orientations, (*PLACED, "cameras"))
ORTHORITY_OR_TABLE = ORIENTATIONS._replace(takes=(*ORIENTATIONS.takes, "interior"))
FORMS = (
    DRONE_IMAGES,
    Form("MISB ST 0601 telemetry", _is_telemetry, read_telemetry, TELEMETRY),
    Form("scene file", _is_scene, _of_scene, ()),
    ORTHORITY,
    Form("reconstruction of OpenSfM", _is_reconstruction, acquisition_of_opensfm, (*PLACED, "part")),
    ORTHORITY_OR_TABLE,
    Form("SBET", _is_sbet, _of_sbet, ("height_datum", "errors", "between", "every")),
)

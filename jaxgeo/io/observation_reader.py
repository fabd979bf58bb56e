"""Reading of observations: from scenes, acquisitions and tables of shots."""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxgeo._refusals import is_refusal
from jaxgeo.earth import Atmosphere
from jaxgeo.io._orientation_columns import stated_datum
from jaxgeo.io._utc import utc_text
from jaxgeo.io.acquisitions import Acquisition, AcquisitionSet, Unread, for_each, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions._camera_checks import camera_doubts
from jaxgeo.io.acquisitions._exposure_names import number_in_file
from jaxgeo.io.acquisitions.detect import DRONE_IMAGES, Form, form_of
from jaxgeo.io.acquisitions.sentences import merged_sentences
from jaxgeo.io.acquisitions.several import files_of, shard_of
from jaxgeo.io.acquisitions.usual_errors import usual_errors_of
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.given_camera import AS_GIVEN, OWN_CAMERA
from jaxgeo.io.observations import ObservationBatch, Observations, Row, _items, frame_camera_of
from jaxgeo.io.scene import Scene, SceneError, read_scene
from jaxgeo.io.tables import GIMBAL_REFERENCE, ShotTable, read_shots
from jaxgeo.observation import Exposure, Observation
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.uncertainty.sources import (
    AbstractSource,
    Boresight,
    CameraMounting,
    Distortion,
    GimbalAngles,
    GimbalMounting,
    InteriorOrientation,
    LeverArm,
)

Path = str | os.PathLike[str]
CENTRE = ("centre_lat_deg", "centre_lon_deg", "centre_height_m")  # as the file reports it, height above the ellipsoid
MOST_REASONS = 4  # told of files that cannot be read
IMAGE_ENDINGS = (".jpg", ".jpeg", ".tif", ".tiff", ".png", ".jp2", ".webp")  # of images that may be meant by a name


def read_observations(
    paths: Path | Sequence[Path] = (),
    pixels: ArrayLike | None = None,
    *,
    scene: Path | None = None,
    shots: Path | None = None,
    exposures: Sequence[str] = (),
    shard: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
    **how: Any,
) -> Observations:
    """Read pixels of exposures from image, telemetry and navigation files, from a scene, or from a table of shots.

    `pixels` (n, 2), columns and rows, are observed in each exposure; by default the image centre. `paths` are
    - files or folders of `read_acquisitions`, with its options `how`. A `scene` gives a camera to files without one;
      to drone images its camera, lens errors and atmosphere. `exposures` are names, by default all. Files that state
      no errors get default ones (`with_usual_errors`). A file that cannot be read among others is `unread`.
    - or one scene file (.toml, or as `scene`), or a scene with `shots`: a CSV with a shot and a pixel per row.

    A `shard` (number from 1, count) is one of `count` consecutive parts, which together are the whole: of the files if
    there are several, else of the exposures or rows.

    Raises as `read_acquisitions` and `read_scene`; `TableError` if no file can be read, for exposures without a camera,
    a scene for files that have one, an unknown name, and options that contradict each other.

    >>> import os, tempfile
    >>> from jaxgeo.demo import drone_image
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = drone_image(os.path.join(folder.name, "a.jpg"), columns=64).path
    >>> observed = jaxgeo.io.read_observations(folder.name, [(10, 20), (30, 40)], height_datum="EPSG:5773")
    >>> fixes = jaxgeo.io.locate_observations(observed, jaxgeo.ConstantHeight(0.0))
    >>> print([row["name"] for row in observed.columns], fixes.status)
    ['a.jpg', 'a.jpg'] [0 0]
    >>> folder.cleanup()
    """
    files = [pathlib.Path(one) for one in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    if not files or (len(files) == 1 and is_scene_file(files[0])):
        if files and scene is not None:
            raise TableError(f'{files[0]} is itself a scene file; leave out scene="{scene}".')
        path = files[0] if files else scene
        if path is None:
            raise TableError("give a file of exposures, or scene=FILE.")
        for name in (name for name, value in how.items() if value is not None):
            raise TableError(f"{name}= does not apply to scene files; leave it out.")
        if exposures:
            raise TableError("exposures= needs a file of exposures; a scene has only one.")
        return _of_scene(pathlib.Path(path), pixels, shots, shard)
    if shots is not None:
        raise TableError(f'shots="{shots}": use it with scene=, not with {_named(files)}.')
    by_scene = scene is not None and _are_images(files, scene)
    if by_scene and how.get("camera") is not None:
        raise TableError(f'scene="{scene}" and camera="{how["camera"]}": both give a camera; leave one out.')
    is_one = shard is not None and len(files_of(files)[0]) == 1
    if shard is not None and not is_one and exposures:
        raise TableError("exposures= of several files and shard= do not go together; name the files instead.")
    how = how | {"camera": scene} if by_scene else how
    found = read_files(files, shard=None if is_one else shard, progress=progress, **how)
    scene_file = None if scene is None else pathlib.Path(scene)
    return _observed(found, pixels, files, scene_file, exposures, by_scene, shard if is_one else None)


def observations_of(
    found: Acquisition | AcquisitionSet,
    pixels: ArrayLike | None = None,
    *,
    scene: Path | None = None,
    exposures: Sequence[str] = (),
) -> Observations:
    """Pixels of exposures that have been read, as `read_observations`; `scene` gives a camera to those without one."""
    if isinstance(found, Acquisition):
        found = AcquisitionSet((found,), (np.arange(len(found)),), (), found.assumed)
    files = [pathlib.Path(part.path) for part in found.parts]
    return _observed(found, pixels, files, None if scene is None else pathlib.Path(scene), exposures, False)


def read_files(
    files: Sequence[pathlib.Path],
    *,
    shard: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
    **how: Any,
) -> AcquisitionSet:
    """Exposures of files and folders; a single file raises its own error.

    Raises as `read_acquisitions`, and `TableError` if none can be read.
    """
    if len(files) == 1 and not files[0].is_dir():
        one = read_acquisition(files[0], **how)
        return AcquisitionSet((one,), (np.arange(len(one)),), (), one.assumed)
    found = read_acquisitions(files, shard=shard, progress=progress, **how)
    if found.parts:
        return found
    first, *others = sorted(found.unread, key=lambda one: is_refusal(one.error))  # internal errors first
    if not others or not is_refusal(first.error):
        raise first.error
    reasons = reasons_by_count(found.unread)
    raise TableError(f"none of {len(found.unread)} files can be read. {reasons}") from first.error


def reasons_by_count(unread: Sequence[Unread]) -> str:
    """The reasons why files could not be read, most frequent first, each with its number and the first such file.

    Reasons that differ by the file and by numbers only are one.
    """
    kinds: dict[str, list[str]] = {}
    for one in unread:
        kind = re.sub(r"\d+", "0", one.reason.replace(one.path, "").replace(one.name, ""))
        kinds.setdefault(kind, []).append(one.reason)
    several = sorted(kinds.values(), key=len, reverse=True)
    told = [f"{f'{len(some)} of them: ' * (len(several) > 1)}{some[0].rstrip('.')}." for some in several]
    more = [f"And {len(several) - MOST_REASONS} other reasons."] if len(several) > MOST_REASONS else []
    return " ".join(told[:MOST_REASONS] + more)


def is_scene_file(path: Path) -> bool:
    """Whether a file name is that of a scene (.toml)."""
    return pathlib.Path(path).suffix.lower() == ".toml"


def height_datum_of(scene: Scene, path: Path, table: Path) -> str | float:
    """Vertical datum of a table's heights as stated by a scene; raises `SceneError` if it states none."""
    if scene.height_datum is None:
        raise SceneError(
            f"{path}: the vertical datum of the heights in {table} is unknown. State it in the scene file: "
            f'[shots] height_datum = "ellipsoid", "EPSG:5773" (EGM96 mean sea level), or an undulation in m.'
        )
    return scene.height_datum


def datum_of_shots(
    table: ShotTable, path: Path, scene: Scene, of_scene: Path, given: str | float | None = None
) -> str | float:
    """Vertical datum of the heights of a table of shots: of its column `height_datum`, else as `given`, else the
    scene's. Raises as `stated_datum` and `height_datum_of`."""
    cells = [str(row.get("height_datum") or "") for row in table.rows]
    if any(cells):
        return stated_datum(path, cells, given)
    return height_datum_of(scene, of_scene, path) if given is None else given


def check_reference(table: ShotTable, path: Path, gimbal: Gimbal) -> None:
    """Raises `TableError` if a table of shots and its scene disagree on the reference of gimbal angles."""
    for stated in {str(row.get(GIMBAL_REFERENCE) or "") for row in table.rows} - {"", gimbal.reference}:
        raise TableError(
            f"{path}: its gimbal angles are relative to {stated!r} (column {GIMBAL_REFERENCE}), in the scene to "
            f"{gimbal.reference!r}; use a matching scene, or run jaxgeo locate FILE on the original file."
        )


def _of_scene(
    path: pathlib.Path, pixels: ArrayLike | None, shots: Path | None, shard: tuple[int, int] | None
) -> Observations:
    """Observations of a scene's own shot, or of a table of shots."""
    scene = read_scene(path)
    columns: list[Row]
    if shots is None:
        if scene.shot is None:
            raise SceneError(f"{path}: [pose] is missing; pixels= needs it.")
        uv = _pixels(pixels, frame_camera_of(scene.sensor))
        motion = for_each(scene.shot, len(uv))
        columns = [{"u": float(u), "v": float(v)} for u, v in uv]
    else:
        if pixels is not None:
            raise TableError("give either pixels= or shots=FILE, a table with pixels.")
        table = read_shots(shots, scene.sensor.gimbal.names)
        datum = datum_of_shots(table, shots, scene, path)
        check_reference(table, shots, scene.sensor.gimbal)
        try:
            motion, uv = table.as_records(scene.sensor.gimbal.names, datum)
        except (OutsideDatum, VerticalDatumError) as error:
            raise SceneError(f"{path}, with the heights of {shots}: {error}") from error
        columns = table.rows
    if shard is not None:
        rows = np.array(shard_of(len(columns), shard, "rows"))
        motion, uv, columns = _items(motion, rows), np.asarray(uv)[rows], [columns[row] for row in rows]
    sources = () if scene.errors is None else tuple(scene.errors.sources)
    observation = Observation(Exposure(scene.sensor, motion, None, scene.atmosphere), uv)
    batch = ObservationBatch(observation, sources, np.arange(len(uv)), is_one_camera=True)
    assumed = tuple(camera_doubts(frame_camera_of(scene.sensor)))
    return Observations((batch,), columns, assumed=assumed, source=f"{path}")


def _pixels(pixels: ArrayLike | None, camera: FrameCamera) -> np.ndarray:
    """Pixels (n, 2); the image centre if none are given. Raises `ValueError`."""
    if pixels is None:
        return np.array([[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])
    found = np.atleast_2d(np.asarray(pixels, np.float64))
    if found.ndim != 2 or found.shape[1] != 2 or not len(found):
        raise ValueError(f"pixels must be (column, row) of shape (n, 2); got shape {np.shape(pixels)}.")
    return found


def _observed(
    found: AcquisitionSet,
    pixels: ArrayLike | None,
    files: Sequence[pathlib.Path],
    scene_file: pathlib.Path | None,
    exposures: Sequence[str],
    by_scene: bool,
    shard: tuple[int, int] | None = None,
) -> Observations:
    """Pixels of the named exposures; `by_scene`: the camera of drone images was already read from the scene."""
    assumed = found.assumed
    found, scene, held, defaults = _completed(found, files, scene_file, by_scene)
    if by_scene and any(InteriorOrientation in map(type, part.sources) for part in found.parts):
        assumed = tuple(one for one in assumed if not one.startswith(AS_GIVEN))
    where = {int(place): (k, i) for k, part in enumerate(found.places) for i, place in enumerate(part)}
    unread = {one.place: one for one in found.unread}
    uv = [_pixels(pixels, frame_camera_of(part.sensor)) for part in found.parts]
    has_times = any(np.any(np.asarray(part.shots.time) != 0.0) for part in found.parts)
    clocks = (has_times, has_times and any(part.time_is_utc for part in found.parts))
    has_centres = any(_reports_centres(part) for part in found.parts)
    lanes: list[list[tuple[int, int]]] = [[] for _ in found.parts]  # (row, exposure) of each part
    columns: list[Row] = []
    reasons: dict[int, Unread] = {}
    chosen = _chosen(found, exposures, sorted([*where, *unread]))
    if shard is not None:
        chosen = [chosen[k] for k in shard_of(len(chosen), shard, "exposures")]
    for place in chosen:
        if place in unread:
            reasons[len(columns)] = unread[place]
            own = _columns(_name(unread[place], found), math.nan, None, None, clocks)
            columns.append(own | (dict.fromkeys(CENTRE) if has_centres else {}))
            continue
        part, index = where[place]
        for u, v in uv[part].tolist():
            lanes[part].append((len(columns), index))
            name, time = found.parts[part].names[index], found.parts[part].shots.time[index]
            own = _columns(str(name), time, u, v, clocks, found.parts[part].time_is_utc)
            columns.append(own | (_reported_centre(found.parts[part], index) if has_centres else {}))
    if reasons and not any(lanes):
        raise next(iter(reasons.values())).error
    air = None if scene is None else scene.atmosphere
    batches = [_batch(*one, air) for one in zip(found.parts, lanes, uv, strict=True) if one[1]]
    source = _named(files) if len(files) > 1 else f"{files[0]}"
    return Observations(tuple(batches), columns, reasons, (*assumed, *held), defaults, source)


def _batch(
    part: Acquisition, lanes: list[tuple[int, int]], pixels: np.ndarray, atmosphere: Atmosphere | None
) -> ObservationBatch:
    """Pixels of a part, given (row, exposure) of each."""
    rows, index = np.array(lanes).T
    sensor, shots, sources = _items((part.sensor, part.shots, part.sources), index)
    uv = np.tile(pixels, (len(lanes) // len(pixels), 1))
    heights = None if part.reported is None else np.asarray(part.reported.centre.height)[index]
    observation = Observation(Exposure(sensor, shots, None, atmosphere), uv)
    above = None if part.above_takeoff is None else part.above_takeoff[index]
    return ObservationBatch(observation, sources, rows, centre_heights=heights, above_takeoff=above)


def _named(files: Sequence[pathlib.Path]) -> str:
    """The files as named in messages."""
    return f"{files[0]} and {len(files) - 1} more" if len(files) > 1 else f"{files[0]}"


def _name(unread: Unread, found: AcquisitionSet) -> str:
    """Row name of an unread file: its name, or its path if the name is not unique."""
    names = [str(name) for part in found.parts for name in part.names] + [one.name for one in found.unread]
    is_unique = names.count(unread.name) == 1 and unread.name not in found.elsewhere
    return unread.name if is_unique else unread.path


def _columns(
    name: str, time: float, u: float | None, v: float | None, clocks: tuple[bool, bool], is_utc: bool = False
) -> Row:
    """The input columns; `clocks`: whether there are times at all, and times in UTC."""
    is_known = math.isfinite(time) and time != 0.0
    moment: Row = {"time_s": float(time) if is_known else None} if clocks[0] else {}
    if clocks[1]:
        moment["time_utc"] = utc_text(float(time)) if is_known and is_utc else None
    return {"name": name, **moment, "u": u, "v": v}


def _reports_centres(part: Acquisition) -> bool:
    return part.reported is not None and bool(np.isfinite(np.asarray(part.reported.centre.lat)).any())


def _reported_centre(part: Acquisition, index: int) -> Row:
    """The ground position at the image centre as the file reports it; None if it does not."""
    if part.reported is None:
        return dict.fromkeys(CENTRE)
    at = part.reported.centre
    lat, lon, height = (float(np.asarray(x)[index]) for x in (at.lat, at.lon, at.height))
    numbers = (round(math.degrees(lat), 9), round(math.degrees(lon), 9), round(height, 4))
    return {name: x if math.isfinite(x) else None for name, x in zip(CENTRE, numbers, strict=True)}


def _chosen(found: AcquisitionSet, names: Sequence[str], places: list[int]) -> list[int]:
    """Indices of the named exposures; all if no names are given. Raises `TableError`."""
    if not names:
        return places
    known: dict[str, int] = {}
    for part, indices in zip(found.parts, found.places, strict=True):
        known |= {str(name): int(place) for name, place in zip(part.names, indices, strict=True)}
    some = ", ".join(list(known)[:5]) + (" and others" if len(known) > 5 else "")
    known |= {called: one.place for one in found.unread for called in (one.path, one.name) if called not in known}
    chosen = []
    for given in names:
        name = given if given in known else _other_name(given, known) or _record_number(given, found)
        if name not in known:
            raise TableError(f'exposures="{given}": no exposure has this name; known: {some}.')
        chosen.append(known[name])
    return chosen


def _other_name(given: str, known: Iterable[str]) -> str | None:
    """The one name that is the given one but for the suffix of an image, which one of them lacks."""

    def stem(name: str) -> str:
        return os.path.splitext(name)[0] if name.lower().endswith(IMAGE_ENDINGS) else name

    alike = [one for one in known if stem(one) == given or stem(given) == one]
    return alike[0] if len(alike) == 1 else None


def _record_number(name: str, found: AcquisitionSet) -> str:
    """Record number for FILE/NUMBER (its name among several files), if its file is the only one."""
    is_alone = len(found.parts) == 1 and not found.unread
    return (number_in_file(name, found.parts[0].path) if is_alone else None) or name


def _are_images(files: Sequence[pathlib.Path], scene: Path) -> bool:
    """Whether all files are drone images or folders of them, which take only the camera of a scene.

    Raises `TableError` for a mixture. Files of unknown type are left to the reader.
    """
    kinds = {form is DRONE_IMAGES for form in map(_form, files) if form is not None}
    if len(kinds) > 1:
        raise TableError(
            f'scene="{scene}": drone images use only its camera, the other files all of it; locate them separately.'
        )
    return kinds == {True}


def _form(file: pathlib.Path) -> Form | None:
    try:
        return form_of(file)
    except (TableError, OSError):
        return None


def _completed(
    found: AcquisitionSet, files: Sequence[pathlib.Path], scene_file: pathlib.Path | None, by_scene: bool
) -> tuple[AcquisitionSet, Scene | None, tuple[str, ...], tuple[tuple[type[AbstractSource], str], ...]]:
    """(exposures with a camera, the scene's if they have none, and with errors; the scene; assumptions on camera and
    gimbal; those on default errors)."""
    bare = [part for part in found.parts if part.sensor is None]
    if scene_file is not None and not bare and not by_scene:
        if found.unread:  # the scene may be meant for these
            raise found.unread[0].error
        raise TableError(f'scene="{scene_file}": {_named(files)} already has a camera; leave the scene out.')
    if bare and scene_file is None:
        found = _without_bare(found, files)
    scene = None if scene_file is None else read_scene(scene_file)
    stated = () if scene is None or scene.errors is None else tuple(scene.errors.sources)
    held: list[str] = []
    kinds: dict[str, type[AbstractSource]] = {}
    usual: list[list[str]] = []

    def complete(part: Acquisition) -> Acquisition:
        beside: tuple[AbstractSource, ...] = ()
        if part.sensor is None:
            assert scene is not None
            part, beside = _with_sensor(part, scene, scene_file, held), _applicable(part, stated)
            held.extend(camera_doubts(frame_camera_of(scene.sensor)))
        elif by_scene:
            assert scene is not None
            part = _with_lens_errors(part, stated, frame_camera_of(scene.sensor))
            held.append(f"Only the camera, its lens errors and the atmosphere of {scene_file} are used.")
        part, added = _with_errors(part, beside)
        kinds.update({sentence: kind for kind, sentence in added})
        usual.extend([[sentence for _, sentence in added]] * len(part))
        return part

    found = found.with_parts(complete)
    defaults = tuple(
        (next(kind for sentence, kind in kinds.items() if one.startswith(sentence)), one)
        for one in merged_sentences(usual, "exposure")
    )
    return found, scene, tuple(dict.fromkeys(held)), defaults


def _without_bare(found: AcquisitionSet, files: Sequence[pathlib.Path]) -> AcquisitionSet:
    """The exposures with a camera; files without one become unread. Raises `TableError` if none has one."""
    unread, kept = [], []
    for part, places in zip(found.parts, found.places, strict=True):
        if part.sensor is not None:
            kept.append((part, places))
            continue
        lens = f", or {OWN_CAMERA}"
        ways = lens if any(not file.is_dir() and "cameras" in form_of(file).takes for file in files) else ""
        try:  # raised, so that `is_refusal` recognises it
            raise TableError(f'{part.path}: a {part.form} has no camera; give scene="SCENE.toml"{ways}.')
        except TableError as error:
            unread.append(Unread(part.path, error, int(places[0])))
    if not kept:
        raise unread[0].error
    parts, places = zip(*kept, strict=True)
    return dataclasses.replace(found, parts=parts, places=places, unread=(*found.unread, *unread))


def _with_lens_errors(part: Acquisition, stated: tuple[AbstractSource, ...], camera: FrameCamera) -> Acquisition:
    """Exposures with the lens errors a scene states for its `camera`, scaled to pixels of their own images."""
    own = frame_camera_of(part.sensor)
    across, down = own.width / camera.width, own.height / camera.height
    lens = tuple(
        dataclasses.replace(one, sigma=np.asarray(one.sigma) * np.array([across, across, down]))
        if isinstance(one, InteriorOrientation)
        else one
        for one in stated
        if isinstance(one, InteriorOrientation | Distortion)
    )
    return dataclasses.replace(part, sources=(*part.sources, *for_each(lens, len(part))))


def _applicable(part: Acquisition, stated: tuple[AbstractSource, ...]) -> tuple[AbstractSource, ...]:
    """Error sources of a scene that apply: without those of gimbal and mount if the angles are the camera's own."""
    of_mount = (GimbalAngles, GimbalMounting, Boresight, CameraMounting, LeverArm)
    return tuple(one for one in stated if not isinstance(one, of_mount)) if part.of_camera else stated


def _with_sensor(part: Acquisition, scene: Scene, path: Path | None, held: list[str]) -> Acquisition:
    """Exposures with the camera of a scene, its gimbal readings held fixed; adds sentences to `held`."""
    count = len(part)
    if part.of_camera:
        sensor = Sensor(scene.sensor.camera, Gimbal.fixed(), Mount.nadir())
        held.append(f"Only the camera of {path} is used, without gimbal and mount: the file has camera angles.")
        return dataclasses.replace(part, sensor=for_each(sensor, count))
    readings = np.zeros(0) if scene.shot is None else np.asarray(scene.shot.gimbal_readings)
    names = scene.sensor.gimbal.names
    if len(readings) != len(names):
        raise TableError(f"{path}: [pose] and [gimbal] readings are missing; {part.path} has none either.")
    shots = Shot(part.shots.pose, np.broadcast_to(readings, (count, len(names))), part.shots.time)
    held += [f"Gimbal readings are held at those in {path}."] if names else []
    return dataclasses.replace(part, sensor=for_each(scene.sensor, count), shots=shots)


def _with_errors(
    part: Acquisition, stated: tuple[AbstractSource, ...]
) -> tuple[Acquisition, list[tuple[type[AbstractSource], str]]]:
    """(exposures with error sources of the file, then those `stated`, then default ones; classes and sentences of the
    default ones)."""
    own = {type(one) for one in part.sources}
    beside = tuple(one for one in stated if type(one) not in own)
    part = dataclasses.replace(part, sources=(*part.sources, *for_each(beside, len(part))))
    if stated and not part.of_camera:
        return part, []
    usual = usual_errors_of(part)
    added = for_each(tuple(source for source, _ in usual), len(part))
    sentences = [(type(source), sentence) for source, sentence in usual]
    return dataclasses.replace(part, sources=(*part.sources, *added)), sentences

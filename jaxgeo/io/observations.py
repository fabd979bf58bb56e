"""Observations from scenes, acquisitions and tables of shots: pixels of exposures, in batches of one camera."""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxgeo._refusals import is_refusal
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._fix_columns import figures_of, rows_of
from jaxgeo.io.acquisitions import Acquisition, AcquisitionSet, Unread, for_each, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions._exposure_names import number_in_file
from jaxgeo.io.acquisitions.detect import DRONE_IMAGES, Form, form_of
from jaxgeo.io.acquisitions.sentences import merged_sentences
from jaxgeo.io.acquisitions.usual_errors import usual_errors_of
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.given_camera import AS_GIVEN
from jaxgeo.io.scene import Scene, SceneError, read_scene
from jaxgeo.io.tables import GIMBAL_REFERENCE, ShotTable, read_shots
from jaxgeo.observation import Exposure, Observation
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.uncertainty import Accuracy
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
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class ObservationBatch:
    """n pixels whose exposures share one structure: camera model, gimbal axes and kinds of error sources.

    - `observation`: its shots and pixels have a leading axis of n, and so has its sensor unless `is_one_camera`.
    - `sources`: error sources, with a leading axis if the sensor has one.
    - `rows` (n,): the row of each pixel in `Observations`.
    - `centre_heights` (n,): ground heights at the image centres as reported by the file, m, ellipsoidal, or None.
    """

    observation: Observation
    sources: tuple[AbstractSource, ...]
    rows: np.ndarray
    is_one_camera: bool = False
    centre_heights: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def sensor(self) -> Sensor:
        """The sensor, with a leading axis unless `is_one_camera`."""
        return self.observation.exposure.sensor

    @property
    def camera(self) -> FrameCamera:
        """The camera, with a leading axis unless `is_one_camera`."""
        return frame_camera_of(self.sensor)

    @property
    def shots(self) -> Shot:
        """The shots, a batch of n."""
        motion = self.observation.exposure.motion
        assert isinstance(motion, Shot)
        return motion

    @property
    def in_axes(self) -> Any:
        """Axes of `observation` for `jax.vmap`, a tree of 0 for values per pixel and None for shared ones."""
        return axes_of(self.observation, self.is_one_camera)

    @property
    def is_on_image(self) -> np.ndarray:
        """Mask (n,) of pixels on the image, including the outer edges of its pixels."""
        camera, uv = self.camera, np.asarray(self.observation.uv, np.float64)
        return np.all((uv >= -0.5) & (uv <= np.array([camera.width, camera.height]) - 0.5), axis=1)

    def at(self, index: int | np.ndarray) -> tuple[Observation, tuple[AbstractSource, ...]]:
        """(observation, error sources) of one or several of the pixels; what all share is left as it is."""
        exposure = self.observation.exposure
        own = exposure.sensor, self.sources
        sensor, sources = own if self.is_one_camera else _items(own, index)
        shots, uv = _items((self.shots, self.observation.uv), index)
        return Observation(Exposure(sensor, shots, None, exposure.atmosphere), uv), sources


def frame_camera_of(sensor: Sensor | None) -> FrameCamera:
    """The camera of a sensor that was read from a file: always a frame camera."""
    assert sensor is not None
    return cast(FrameCamera, sensor.camera)


def axes_of(observation: Observation, is_one_camera: bool) -> Any:
    """Axes of a batched observation for `jax.vmap`: None for the atmosphere, and for the sensor of one camera."""
    shared = {"sensor", "atmosphere"} if is_one_camera else {"atmosphere"}

    def axis(path: tuple[Any, ...], _: Any) -> int | None:
        return None if any(getattr(key, "name", "") in shared for key in path[1:2]) else 0

    return jax.tree_util.tree_map_with_path(axis, observation)


def _items(tree: Any, index: int | np.ndarray) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


@dataclasses.dataclass(frozen=True)
class Observations:
    """Pixels of exposures read from files, one row each, in batches of one structure.

    - `columns`: for each row its input columns: name, time and pixel, or the cells of a table of shots.
    - `unread`: by row, the files that could not be read; such a row is in no batch.
    - `assumed`: a sentence for each assumption.
    - `assumed_errors`: for each kind of default error source, (its class, a sentence with its numbers).
    - `source`: the files as named in messages.
    """

    batches: tuple[ObservationBatch, ...]
    columns: list[Row]
    unread: Mapping[int, Unread] = dataclasses.field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    assumed_errors: tuple[tuple[type[AbstractSource], str], ...] = ()
    source: str = ""

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.columns)

    @property
    def gimbal_names(self) -> tuple[str, ...]:
        """Names of the gimbal axes of the first exposure."""
        return tuple(self.batches[0].sensor.gimbal.names)

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The atmosphere of all exposures."""
        return self.batches[0].observation.exposure.atmosphere

    @property
    def read_rows(self) -> np.ndarray:
        """Rows whose file was read, in order."""
        return np.sort(np.concatenate([batch.rows for batch in self.batches]))

    @property
    def reasons(self) -> list[str | None] | None:
        """For each row why its file could not be read, or None; None if all were read."""
        return self.reasons_by(lambda one: one.reason)

    def reasons_by(self, words: Callable[[Unread], str]) -> list[str | None] | None:
        """`reasons` in the words of a function."""
        told = {row: words(one) for row, one in self.unread.items()}
        return [told.get(row) for row in range(len(self))] if told else None

    @property
    def position(self) -> Geodetic:
        """Positions of the exposures (n,), NaN for rows whose file could not be read."""
        positions = [batch.shots.pose.position for batch in self.batches]
        rows = np.concatenate([batch.rows for batch in self.batches])

        def spread(*parts: Any) -> np.ndarray:
            whole = np.full(len(self), np.nan)
            whole[rows] = np.concatenate([np.asarray(part) for part in parts])
            return whole

        return jax.tree.map(spread, *positions)

    def place(self, row: int) -> tuple[int, int]:
        """(batch, index in it) of a row. Raises `KeyError` if its file could not be read."""
        for number, batch in enumerate(self.batches):
            for index in np.flatnonzero(batch.rows == row):
                return number, int(index)
        raise KeyError(f"row {row}: {self.unread[row].reason if row in self.unread else 'no such row'}")

    def at(self, row: int) -> tuple[Observation, tuple[AbstractSource, ...]]:
        """(observation, error sources) of a row; raises as `place`."""
        number, index = self.place(row)
        return self.batches[number].at(index)

    def with_atmosphere(self, atmosphere: Atmosphere | None) -> Observations:
        """The same observations in another atmosphere."""

        def changed(batch: ObservationBatch) -> ObservationBatch:
            exposure = dataclasses.replace(batch.observation.exposure, atmosphere=atmosphere)
            return dataclasses.replace(batch, observation=Observation(exposure, batch.observation.uv))

        return dataclasses.replace(self, batches=tuple(map(changed, self.batches)))

    def with_sources(self, each: Sequence[tuple[AbstractSource, ...]]) -> Observations:
        """The same observations with other error sources, a tuple per batch.

        Sources have a leading axis of n, as by `jaxgeo.io.acquisitions.for_each`, unless `is_one_camera`.
        """
        pairs = zip(self.batches, each, strict=True)
        return dataclasses.replace(
            self, batches=tuple(dataclasses.replace(batch, sources=tuple(own)) for batch, own in pairs)
        )

    def add_sources(self, *sources: AbstractSource) -> Observations:
        """The same observations with more error sources, common to all exposures; they replace those of their class."""
        kinds = {type(one) for one in sources}

        def added(batch: ObservationBatch) -> tuple[AbstractSource, ...]:
            kept = tuple(one for one in batch.sources if type(one) not in kinds)
            return *kept, *(sources if batch.is_one_camera else for_each(sources, len(batch)))

        return self.with_sources([added(batch) for batch in self.batches])

    def table(
        self, fixes: Fix, accuracy: Accuracy | None = None, *, reasons: Sequence[str | None] | None = None
    ) -> list[Row]:
        """For each row its input columns, then the columns of `write_fixes` except `index`."""
        figures = figures_of("table", fixes, accuracy, None, None, None)
        rows = rows_of(fixes, figures, self.reasons if reasons is None else reasons)
        pairs = zip(rows, self.columns, strict=True)
        return [own | {name: row[name] for name in row if name != "index"} for row, own in pairs]


def read_observations(
    paths: Path | Sequence[Path] = (),
    pixels: ArrayLike | None = None,
    *,
    scene: Path | None = None,
    shots: Path | None = None,
    exposures: Sequence[str] = (),
    progress: Callable[[int, int], object] | None = None,
    **how: Any,
) -> Observations:
    """Read pixels of exposures from image, telemetry and navigation files, from a scene, or from a table of shots.

    `pixels` (n, 2), columns and rows, are observed in each exposure; by default the image centre. `paths` are
    - files or folders of `read_acquisitions`, with its options `how`. A `scene` gives a camera to files without one;
      to drone images its camera, lens errors and atmosphere. `exposures` are names, by default all. Files that state
      no errors get default ones (`with_usual_errors`). A file that cannot be read among others is `unread`.
    - or one scene file (.toml, or as `scene`), or a scene with `shots`: a CSV with a shot and a pixel per row.

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
        return _of_scene(pathlib.Path(path), pixels, shots)
    if shots is not None:
        raise TableError(f'shots="{shots}": use it with scene=, not with {_named(files)}.')
    by_scene = scene is not None and _are_images(files, scene)
    if by_scene and how.get("camera") is not None:
        raise TableError(f'scene="{scene}" and camera="{how["camera"]}": both give a camera; leave one out.')
    found = read_files(files, progress=progress, **(how | {"camera": scene} if by_scene else how))
    return _observed(found, pixels, files, None if scene is None else pathlib.Path(scene), exposures, by_scene)


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
    files: Sequence[pathlib.Path], *, progress: Callable[[int, int], object] | None = None, **how: Any
) -> AcquisitionSet:
    """Exposures of files and folders; a single file raises its own error.

    Raises as `read_acquisitions`, and `TableError` if none can be read.
    """
    if len(files) == 1 and not files[0].is_dir():
        one = read_acquisition(files[0], **how)
        return AcquisitionSet((one,), (np.arange(len(one)),), (), one.assumed)
    found = read_acquisitions(files, progress=progress, **how)
    if found.parts:
        return found
    first, *others = sorted(found.unread, key=lambda one: is_refusal(one.error))  # internal errors first
    if not others or not is_refusal(first.error):
        raise first.error
    raise TableError(f"none of {len(found.unread)} files can be read. First error: {first.reason}") from first.error


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


def check_stated(table: ShotTable, path: Path, gimbal: Gimbal, height_datum: str | float) -> None:
    """Raises `TableError` if a table of shots and its scene disagree on the gimbal reference or the vertical datum."""
    meant = {GIMBAL_REFERENCE: ("gimbal angles", gimbal.reference), "height_datum": ("heights", height_datum)}
    for name, (what, ours) in meant.items():
        for stated in {str(row.get(name) or "") for row in table.rows} - {"", str(ours)}:
            raise TableError(
                f"{path}: its {what} are relative to {stated!r} (column {name}), in the scene to {str(ours)!r}; use a "
                f"matching scene, or run jaxgeo locate FILE on the original file."
            )


def _of_scene(path: pathlib.Path, pixels: ArrayLike | None, shots: Path | None) -> Observations:
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
        datum = height_datum_of(scene, path, shots)
        table = read_shots(shots, scene.sensor.gimbal.names)
        check_stated(table, shots, scene.sensor.gimbal, datum)
        try:
            motion, uv = table.as_records(scene.sensor.gimbal.names, datum)
        except (OutsideDatum, VerticalDatumError) as error:
            raise SceneError(f"{path}, with the heights of {shots}: {error}") from error
        columns = table.rows
    sources = () if scene.errors is None else tuple(scene.errors.sources)
    observation = Observation(Exposure(scene.sensor, motion, None, scene.atmosphere), uv)
    batch = ObservationBatch(observation, sources, np.arange(len(uv)), is_one_camera=True)
    return Observations((batch,), columns, source=f"{path}")


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
    lanes: list[list[tuple[int, int]]] = [[] for _ in found.parts]  # (row, exposure) of each part
    columns: list[Row] = []
    reasons: dict[int, Unread] = {}
    for place in _chosen(found, exposures, sorted([*where, *unread])):
        if place in unread:
            reasons[len(columns)] = unread[place]
            columns.append(_columns(_name(unread[place], found), math.nan, None, None, has_times))
            continue
        part, index = where[place]
        for u, v in uv[part].tolist():
            lanes[part].append((len(columns), index))
            name, time = found.parts[part].names[index], found.parts[part].shots.time[index]
            columns.append(_columns(str(name), time, u, v, has_times))
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
    return ObservationBatch(observation, sources, rows, centre_heights=heights)


def _named(files: Sequence[pathlib.Path]) -> str:
    """The files as named in messages."""
    return f"{files[0]} and {len(files) - 1} more" if len(files) > 1 else f"{files[0]}"


def _name(unread: Unread, found: AcquisitionSet) -> str:
    """Row name of an unread file: its name, or its path if the name is not unique."""
    names = [str(name) for part in found.parts for name in part.names] + [one.name for one in found.unread]
    return unread.name if names.count(unread.name) == 1 else unread.path


def _columns(name: str, time: float, u: float | None, v: float | None, has_times: bool) -> Row:
    is_known = math.isfinite(time) and time != 0.0
    moment = {"time_s": float(time) if is_known else None} if has_times else {}
    return {"name": name, **moment, "u": u, "v": v}


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
        name = given if given in known else _record_number(given, found)
        if name not in known:
            raise TableError(f'exposures="{given}": no exposure has this name; known: {some}.')
        chosen.append(known[name])
    return chosen


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
        lens = ', or camera="focal=8.8mm,pitch=2.41um,size=5472x3648"'
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

"""Exposures of several files and folders: batched arrays, and a list of unreadable files."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.io.acquisitions._exposure_names import with_file_names
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.io.acquisitions._takeoff import with_takeoff_sigma
from jaxgeo.io.acquisitions.detect import (
    DRONE_IMAGES,
    Form,
    WrongOption,
    checked_options,
    form_of,
    form_of_folder,
    reader_of,
)
from jaxgeo.io.acquisitions.drone_images import ENDINGS
from jaxgeo.io.acquisitions.positions import check_one_flight
from jaxgeo.io.acquisitions.record import Acquisition, Reported, UnstatedDatum
from jaxgeo.io.acquisitions.sentences import merged_sentences
from jaxgeo.io.errors import ImageError, TableError, VerticalDatumError

Path = str | os.PathLike[str]


class Unread(NamedTuple):
    """A file that could not be read: its path, the reader's exception, its index among all exposures."""

    path: str
    error: Exception
    place: int

    @property
    def name(self) -> str:
        """The name of the file."""
        return os.path.basename(self.path)

    @property
    def reason(self) -> str:
        """The reason, in one line."""
        return " ".join(str(self.error).split()) or type(self.error).__name__


@dataclasses.dataclass(frozen=True)
class AcquisitionSet:
    """Exposures of several files: `parts`, each with arrays of one structure, for example of one camera.

    - `places`: for each part an array (n,): the indices of its exposures among all, in the order of the files.
    - `unread`: files that could not be read; each has an index of its own.
    - `assumed`: sentences as in `Acquisition`, each once, with the number of files it applies to if not all.
    - `elsewhere`: names of files in other parts, if these are those of one part.
    """

    parts: tuple[Acquisition, ...]
    places: tuple[np.ndarray, ...]
    unread: tuple[Unread, ...] = ()
    assumed: tuple[str, ...] = ()
    elsewhere: frozenset[str] = frozenset()

    def __len__(self) -> int:
        """Number of exposures and of files that could not be read."""
        return sum(len(part) for part in self.parts) + len(self.unread)

    def with_parts(self, change: Callable[[Acquisition], Acquisition]) -> AcquisitionSet:
        """The set with `change` applied to each part, and parts merged that now share a structure."""
        parts, places = merged([change(part) for part in self.parts], self.places)
        return dataclasses.replace(self, parts=parts, places=places)


def read_acquisitions(
    paths: Path | Sequence[Path],
    *,
    shard: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
    takeoff_sigma: float | None = None,
    **how: Any,
) -> AcquisitionSet:
    """Read the exposures of files and folders of any kinds, cameras and image sizes; a bad file does not stop others.

    `paths` and the options `how` are those of `read_acquisition`; a folder stands for its JPEG and TIFF images, unless
    it holds a COLMAP model, MicMac orientations or Pix4D's camera parameters.
    Each file is read alone: statements of one file (such as standard deviations of its position) are never applied to
    another. With several files, records that have only a number, as in KLV and SBET, are named with their file:
    "video.ts/7". An option applies to the files whose reader accepts it, `takeoff_sigma` to those that take
    `takeoff_height`; with `positions`, an image that is missing in that file is unread. A `shard` (number from 1,
    count) is one of `count` consecutive parts of the files; the parts
    together are the whole. `progress` is called with the number of files read and the total.

    Raises, since these concern all files: `WrongOption` for an option that no file's reader accepts; `UnstatedDatum`
    and `VerticalDatumError`; `TableError` for positions of another flight; `FileNotFoundError` for a missing
    path; `ImageError` for a folder without images.

    >>> import os, tempfile
    >>> from jaxgeo.demo import drone_image
    >>> folder = tempfile.TemporaryDirectory()
    >>> image = drone_image(os.path.join(folder.name, "a.jpg"), columns=64).path
    >>> with open(os.path.join(folder.name, "b.jpg"), "wb") as file:
    ...     size = file.write(b"no image")
    >>> found = jaxgeo.io.read_acquisitions(folder.name, height_datum="EPSG:5773")
    >>> print([str(name) for part in found.parts for name in part.names], [one.name for one in found.unread])
    ['a.jpg'] ['b.jpg']
    >>> folder.cleanup()
    """
    every, left_out = files_of(paths)
    files = every if shard is None else [every[k] for k in shard_of(len(every), shard, "files")]
    forms = [_form(file) for file in files]
    _check_options(files, forms, how)
    kinds = dict(zip(files, forms, strict=True))
    found: list[Acquisition] = []
    starts: list[int] = []
    unread: list[Unread] = []
    place = 0
    for number, (file, form) in enumerate(zip(files, forms, strict=True), 1):
        one = form if isinstance(form, Exception) else _read(file, form, how)
        if isinstance(one, Acquisition) and isinstance(form, Form) and "takeoff_height" in form.takes:
            one = with_takeoff_sigma(one, takeoff_sigma, how.get("takeoff_height"))
        if isinstance(one, Exception):
            unread.append(Unread(file, one, place))
            place += 1
        else:
            found.append(one)
            starts.append(place)
            place += len(one)
        if progress is not None:
            progress(number, len(files))
    images = [one for one in found if kinds[one.path] is DRONE_IMAGES]
    if how.get("positions") is not None and len(images) > 1:
        datum = how.get("height_datum") or "ellipsoid"
        check_one_flight(images, read_positions(how["positions"], height_datum=datum, crs=how.get("crs")))
    notes = merged_sentences([one.assumed for one in found], "file")
    elsewhere = frozenset(os.path.basename(file) for file in set(every) - set(files))
    found = with_file_names(found, elsewhere) if len(every) > 1 else found
    places = [start + np.arange(len(one)) for start, one in zip(starts, found, strict=True)]
    parts, where = merged(found, places)
    return AcquisitionSet(parts, where, tuple(unread), (*notes, *left_out), elsewhere)


def shard_of(total: int, shard: tuple[int, int], what: str) -> range:
    """Indices of part `shard` = (number from 1, count) of `total` items. Raises `TableError` for a part without any."""
    number, count = shard
    if not 1 <= number <= count:
        raise TableError(f"shard must be (number, count) with a number from 1 to the count; got {shard!r}.")
    if count > total:
        raise TableError(f"shard {number}/{count}: more parts than {what} ({total}); use at most {total}.")
    return range((number - 1) * total // count, number * total // count)


def files_of(paths: Path | Sequence[Path]) -> tuple[list[str], list[str]]:
    """(files, each once, those of a folder sorted by name; a sentence on other files in each folder).

    Raises `FileNotFoundError`; `ImageError` for a folder without images.
    """
    names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not names:
        raise TableError("paths: no file is named.")
    found: dict[str, str] = {}
    notes = []
    for name in [os.fspath(one) for one in names]:
        if not os.path.exists(name):
            raise FileNotFoundError(f"{name}: there is no such file.")
        is_images = os.path.isdir(name) and form_of_folder(name) is None
        inside, others = _in_folder(name) if is_images else ([name], [])
        for file in inside:
            found.setdefault(os.path.realpath(file), file)
        if others:
            endings = ", ".join(sorted({pathlib.Path(one).suffix.lower() or "no ending" for one in others})[:5])
            count = f"{len(others)} other file{'s' if len(others) != 1 else ''}"
            notes.append(f"{name}: only its JPEG and TIFF images are read; {count} ({endings}) left out.")
    return list(found.values()), notes


def merged(
    found: Sequence[Acquisition], places: Sequence[np.ndarray]
) -> tuple[tuple[Acquisition, ...], tuple[np.ndarray, ...]]:
    """(acquisitions, places) with those of one structure merged, in order of first occurrence."""
    groups: dict[Any, list[int]] = {}
    for i, one in enumerate(found):
        leaves, structure = jax.tree.flatten((one.sensor, one.shots, one.sources))
        groups.setdefault((structure, one.of_camera, tuple(np.shape(leaf)[1:] for leaf in leaves)), []).append(i)
    parts = tuple(_joined([found[i] for i in group]) for group in groups.values())
    return parts, tuple(np.concatenate([places[i] for i in group]) for group in groups.values())


def _form(file: str) -> Form | Exception:
    try:
        return form_of(file)
    except (TableError, OSError) as error:
        return error


def _check_options(files: Sequence[str], forms: Sequence[Form | Exception], how: Mapping[str, Any]) -> None:
    """Raises `WrongOption` for an option that no file's reader accepts."""
    known = {form.name: form for form in forms if isinstance(form, Form)}
    takes = tuple(dict.fromkeys(one for form in known.values() for one in form.takes))
    for name in [name for name, value in how.items() if value is not None]:
        if known and name not in takes:
            shown = files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
            raise WrongOption(shown, " or ".join(known), name, takes)


def _read(file: str, form: Form, how: Mapping[str, Any]) -> Acquisition | Exception:
    """The exposures of a file, or the exception of its reader."""
    own = {name: value for name, value in how.items() if value is not None and name in form.takes}
    try:
        return reader_of(form, own)(file, **checked_options(file, form, own))
    except (UnstatedDatum, VerticalDatumError, MemoryError):
        raise
    except Exception as error:  # a bug with one file does not stop the others; callers distinguish it from a refusal
        return error


def _in_folder(name: str) -> tuple[list[str], list[str]]:
    """(images, other files) of a folder by name, without hidden ones. Raises `ImageError` if there are no images."""
    inside = sorted(one for one in pathlib.Path(name).iterdir() if not one.name.startswith("."))
    images = [str(one) for one in inside if one.suffix.lower() in ENDINGS and not one.is_dir()]
    if images:
        return images, [str(one) for one in inside if one.is_file() and str(one) not in set(images)]
    below = next((one for one in inside if one.is_dir() and _has_images(one)), None)
    other = next((one for one in inside if one.is_file()), None)
    hint = f" Images are in the folder {below}: name that." if below is not None else (
        f" Other files in it are read by their own names, such as {other}." if other is not None else ""
    )  # fmt: skip
    raise ImageError(f"{name}: there are no images in this folder ({', '.join(ENDINGS)}).{hint}")


def _has_images(folder: pathlib.Path) -> bool:
    try:
        return any(one.suffix.lower() in ENDINGS for one in folder.iterdir())
    except OSError:
        return False


def _joined(found: list[Acquisition]) -> Acquisition:
    """Merge acquisitions of one structure."""
    first = found[0]
    if len(found) == 1:
        return first
    trees = [(one.sensor, one.shots, one.sources) for one in found]
    sensor, shots, sources = jax.tree.map(lambda *leaves: np.concatenate([np.asarray(x) for x in leaves]), *trees)
    has_tags = any(one.tags for one in found)
    return Acquisition(
        path=f"{first.path} and {len(found) - 1} more",
        form=" and ".join(dict.fromkeys(one.form for one in found)),
        names=np.concatenate([one.names for one in found]),
        sensor=sensor,
        shots=shots,
        sources=sources,
        assumed=merged_sentences([one.assumed for one in found], "file"),
        facts=_facts(found),
        reported=_reported(found),
        above_takeoff=_above_takeoff(found),
        tags=tuple(tags for one in found for tags in (one.tags or [{}] * len(one))) if has_tags else (),
        time_is_utc=all(one.time_is_utc for one in found),
        of_camera=first.of_camera,
        takeoff_sigma=max(one.takeoff_sigma for one in found),
    )


def _facts(found: list[Acquisition]) -> dict[str, str]:
    """Each fact once; if it differs between files, the first value and the number of others."""
    names = dict.fromkeys(name for one in found for name in one.facts)
    merged = {}
    for name in names:
        values = list(dict.fromkeys(one.facts[name] for one in found if name in one.facts))
        more = len(values) - 1
        merged[name] = values[0] + (
            f"; and {more} other value{'s' if more != 1 else ''} in other files" if more else ""
        )
    return merged


def _above_takeoff(found: list[Acquisition]) -> np.ndarray | None:
    """The heights above the take-off, NaN for files without."""
    if all(one.above_takeoff is None for one in found):
        return None
    return np.concatenate(
        [np.full(len(one), np.nan) if one.above_takeoff is None else one.above_takeoff for one in found]
    )


def _reported(found: list[Acquisition]) -> Reported | None:
    """The ground positions reported by the files, NaN for files without."""
    if all(one.reported is None for one in found):
        return None
    rows = []
    for one in found:
        if one.reported is None:
            rows.append(np.full((4, len(one)), np.nan))
        else:
            centre = one.reported.centre
            rows.append(np.stack([centre.lat, centre.lon, centre.height, one.reported.slant_range]))
    lat, lon, height, slant_range = np.concatenate(rows, axis=1)
    return Reported(Geodetic(lat=lat, lon=lon, height=height), slant_range)

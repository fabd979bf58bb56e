"""Orthophotos of many frames, a file each, on common cells; with a mosaic and a STAC catalogue."""

from __future__ import annotations

import functools
import os
import pathlib
import re
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo._digest import digest_of
from jaxgeo._parallel import Work
from jaxgeo.cluster.catalogue import (
    CELLS,
    STATUS,
    compute_and_list,
    mosaic_file,
    read_json,
    write_catalogue,
    write_item,
    write_mosaics,
)
from jaxgeo.cluster.frames import Ground, check_seen
from jaxgeo.cluster.parts import Parts, Run, named
from jaxgeo.io.errors import ImageError, NothingSeen, WindowTooLarge
from jaxgeo.io.files import DemFiles
from jaxgeo.io.ground_of_image import image_raster
from jaxgeo.io.images import Bands as ImageBands
from jaxgeo.io.images import check_size, opened
from jaxgeo.io.located import axis_of
from jaxgeo.io.located_over_files import check_straight
from jaxgeo.io.map_raster import MapRaster, checked_crs
from jaxgeo.io.observations import Observations
from jaxgeo.io.rectified import RectifiedFile, rectify_file, status_file
from jaxgeo.io.tiles import stamp_of
from jaxgeo.io.vrt_writer import Bands
from jaxgeo.observation import Exposure
from jaxgeo.ortho import AbstractInterpolation, Bilinear
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain

KIND = "orthophotos"
BILINEAR = Bilinear()
USED = re.compile(
    r"^(mosaic|collection|items|[._].*|)(-\d+)?$|_status$|-\d{5,}$", re.IGNORECASE
)  # by the folder itself
IMAGE, STAMP, REASON = "jaxgeo:image", "jaxgeo:image_stamp", "jaxgeo:reason"

Path = str | os.PathLike[str]


class Cells(NamedTuple):
    """CRS and cell size, (across, down) in its unit, of all frames."""

    crs: Any
    size: tuple[float, float]


class Setting(NamedTuple):
    """What all frames have in common, and the exposure, image and time of each."""

    folder: pathlib.Path
    observed: Observations
    images: tuple[str | None, ...]
    times: tuple[datetime | None, ...]
    ground: Ground
    cells: Cells
    options: dict[str, Any]


def rectify_frames(
    folder: Path,
    images: Path | Sequence[Path],
    observed: Observations,
    terrain: Ground,
    *,
    client: Any = None,
    crs: Any = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    bands: ImageBands = None,
    interpolation: AbstractInterpolation = BILINEAR,
    mask_hidden: bool = True,
    cog: bool = True,
    status: bool = False,
    times: Sequence[datetime | None] | None = None,
    progress: bool = False,
) -> Run:
    """Orthophotos of all frames as GeoTIFFs in `folder`, with a mosaic of them and a STAC catalogue.

    - `images`: the image file of each row of `observed`, which has one pixel per image; or the folder of images whose
      names are those of the rows.
    - `terrain`: one for all frames, or a DEM on disk (`jaxgeo.io.open_dem`), of which each frame reads a window.
    - `client`: a Dask `Client` (`connect`), any `concurrent.futures.Executor`, or None for this process. The results do
      not depend on it, except that rounding may differ between kinds of processors.
    - `crs`, `resolution`: of all frames, as for `rectify_file`; by default those of the first frame that sees ground:
      its UTM zone, and its GSD to three digits. Cells lie on multiples of the resolution in all frames.
    - `bands`, `interpolation`, `mask_hidden`, `cog`, `status`: as for `rectify_file`.
    - `times`: of each frame, with a time zone, for the catalogue.

    The frame of `DJI_0042.JPG` has `DJI_0042.tif` and the STAC item `DJI_0042.json` (`part_names`: what several images
    or the folder itself would be called is followed by the number of the row). A frame without an orthophoto, because
    its image cannot be read or shows no ground, has an item with the reason in `jaxgeo:reason` and no file.
    `collection.json` and `items.json` (a feature collection) list all items. `mosaic.vrt` shows all frames, later ones
    over earlier; frames with other bands than the first are in `mosaic-2.vrt` and so on. A Dask client needs the extra
    `cluster`.

    Workers write into `folder`, which all must see, as the images. A later call with the same arguments computes only
    frames that are missing, or whose image has changed or appeared. `Run.counts` counts frames: `hit` with an
    orthophoto, `file_not_read`, and `ray_misses_terrain` or `leaves_terrain` (its ground takes too large a window).

    Raises `PartsFailed` if frames could not be computed for another reason, such as a missing file of the DEM, after
    the others are; `NothingSeen` if no frame sees ground; `ValueError` for arguments that contradict each other, and a
    folder that holds something else.
    """
    require_x64()
    check_is(interpolation, AbstractInterpolation, "interpolation")
    ground = _checked_ground(observed, terrain)
    files = images_of(images, observed)
    each = (None,) * len(observed) if times is None else tuple(times)
    if len(each) != len(observed) or any(one is not None and one.tzinfo is None for one in each):
        raise ValueError(f"times must be {len(observed)}, one of each frame, each None or with a time zone.")
    where = pathlib.Path(folder).absolute()
    cells = _cells_of(where, observed, files, ground, crs, resolution)
    options = {"bands": bands, "interpolation": interpolation, "mask_hidden": mask_hidden, "cog": cog, "status": status}
    setting = Setting(where, observed, files, each, ground, cells, options)
    called = [file or row.get("name") or "frame" for file, row in zip(files, observed.columns, strict=True)]
    names = part_names(called)
    parts = Parts(where, KIND, _identity(setting), names)
    missing = {*parts.open(), *_outdated(setting, names)}
    given = {name: row for row, name in enumerate(names) if name in missing}
    finish = functools.partial(_finish, where, cells.crs)
    return compute_and_list(parts, given, Work(_frames, setting), client, progress, finish)


def part_names(images: Sequence[Any]) -> tuple[str, ...]:
    """Names of the items of images, by their names: ASCII letters, digits, points and hyphens, and all different.

    Names that differ by capitals only, or that the mosaic, the catalogue or a status file may have, are followed by
    the number of the row.
    """
    stems = [re.sub(r"[^\w.-]", "_", pathlib.PurePath(str(one)).stem, flags=re.ASCII) for one in images]
    count = Counter(stem.lower() for stem in stems)
    plain = [count[stem.lower()] == 1 and USED.search(stem) is None for stem in stems]
    numbered = named("-", len(stems), "")
    return tuple(f"{stem}{'' if ok else end}.json" for stem, ok, end in zip(stems, plain, numbered, strict=True))


def images_of(images: Path | Sequence[Path], observed: Observations) -> tuple[str | None, ...]:
    """The image file of each row; None for a row whose file could not be read.

    Raises `ValueError` for another number of images, and for rows that share an image or have no name.
    """
    names = [row.get("name") for row in observed.columns]
    if isinstance(images, str | os.PathLike):
        unnamed = next((number for number, name in enumerate(names) if not name), None)
        if unnamed is not None:
            raise ValueError(
                f"images: row {unnamed} of observed has no name; give the list of images in place of a folder."
            )
        files = [os.path.join(os.path.abspath(images), str(name)) for name in names]
    else:
        files = [os.path.abspath(one) for one in images]
    if len(files) != len(observed):
        raise ValueError(f"images must be one for each of {len(observed)} rows of observed; got {len(files)}.")
    known = [None if row in observed.unread else file for row, file in enumerate(files)]
    read = [one for one in known if one is not None]
    if len(set(read)) < len(read):
        twice = next(one for one in read if read.count(one) > 1)
        raise ValueError(
            f"images: several rows of observed are of {twice}; read observations with one pixel per image."
        )
    return tuple(known)


def _checked_ground(observed: Observations, terrain: Any) -> Ground:
    if not observed.batches:
        raise ValueError("observed has no frame that could be read.")
    if not isinstance(terrain, AbstractTerrain | DemFiles):
        raise TypeError(f"terrain must be a terrain, or a DEM on disk (open_dem); got {type(terrain).__name__}.")
    if isinstance(terrain, AbstractTerrain) and axis_of(terrain) == 0:
        raise ValueError("terrain must be one for all frames; got one with a leading axis.")
    check_straight(terrain, observed.atmosphere)
    return terrain


def _exposure(observed: Observations, row: int) -> Exposure:
    return observed.at(row)[0].exposure


def _raster(
    name: str, exposure: Exposure, ground: Ground, crs: Any, resolution: Any
) -> tuple[MapRaster, AbstractTerrain]:
    """The cells of a frame, and the ground that it needs."""
    how = {"atmosphere": exposure.atmosphere}
    return image_raster(name, exposure.sensor, exposure.motion, ground, crs, resolution, how)


def _cells_of(
    folder: pathlib.Path,
    observed: Observations,
    images: Sequence[str | None],
    ground: Ground,
    crs: Any,
    resolution: Any,
) -> Cells:
    """The given CRS and resolution; what is missing is that of the first frame that sees ground."""
    asked = None if crs is None else checked_crs(f"{folder}", crs)
    if asked is not None and resolution is not None:
        across, down = (float(x) for x in np.broadcast_to(resolution, 2))
        if not (0.0 < across < np.inf and 0.0 < down < np.inf):
            raise ValueError(f"resolution must be positive and finite, in the unit of the CRS; got {resolution!r}.")
        return Cells(asked, (across, down))
    reason: Exception | None = None
    for row in observed.read_rows.tolist():
        try:
            found, _ = _raster(f"{images[row]}", _exposure(observed, row), ground, asked, resolution)
            return Cells(found.crs, (found.transform.a, -found.transform.e))
        except (NothingSeen, WindowTooLarge) as error:
            reason = reason or error
    assert reason is not None
    missing = " and ".join(f"{name}=" for name, value in (("crs", crs), ("resolution", resolution)) if value is None)
    raise NothingSeen(
        f"no frame sees any ground, which would determine {missing}; state it. The first: {reason}"
    ) from reason


def _identity(setting: Setting) -> dict[str, str]:
    """What results depend on, by name."""
    observed, ground, cells = setting.observed, setting.ground, setting.cells
    batches = [(one.observation, one.rows, one.is_one_camera) for one in observed.batches]
    return {
        "frames": digest_of((batches, len(observed), observed.reasons)),
        "images": digest_of(setting.images),
        "times": digest_of([one and one.isoformat() for one in setting.times]),
        "terrain": digest_of(ground.identity if isinstance(ground, DemFiles) else ground),
        "crs": cells.crs.to_string(),
        "resolution": " x ".join(f"{size!r}" for size in cells.size),
        "output": digest_of(setting.options),
    }


def _outdated(setting: Setting, names: Sequence[str]) -> list[str]:
    """Parts whose image has changed or appeared, or whose orthophoto is gone; their items are removed."""
    found = []
    for name, image in zip(names, setting.images, strict=True):
        path = setting.folder / name
        if not path.exists():
            continue
        item = read_json(path)
        stamp = _stamp(image)
        files = [setting.folder / asset["href"] for asset in item["assets"].values()]
        if item["properties"].get(STAMP) != stamp or not all(file.exists() for file in files):
            path.unlink()
            found.append(name)
    return found


def _stamp(image: str | None) -> list[int] | None:
    """Time and size of an image; None if it is not there."""
    stamp = None if image is None else stamp_of(image)
    return None if stamp is None else list(stamp)


def _frames(setting: Setting) -> Callable[[tuple[str, int]], dict[str, int]]:
    return functools.partial(_rectify_frame, setting)


def _rectify_frame(setting: Setting, item: tuple[str, int]) -> dict[str, int]:
    """Compute and write a frame's orthophoto, then its item; returns its status."""
    name, row = item
    check_seen(setting.folder)
    image, cog = setting.images[row], bool(setting.options["cog"])
    path = setting.folder / name
    told: dict[str, Any] = {IMAGE: image, STAMP: _stamp(image)}
    told |= {} if image is None else {"title": pathlib.Path(image).name}
    assets: dict[str, tuple[str, Bands]] = {}
    raster, status = None, Status.hit
    try:
        done = _rectified(setting, path.with_suffix(".tif"), row)
    except _NoOrthophoto as error:
        status = error.status
        told[REASON] = f"{error}"
    else:
        raster, files = done.raster, {"orthophoto": pathlib.Path(done.path)}
        files |= {"status": status_file(files["orthophoto"])} if setting.options["status"] else {}
        assets = {key: (file.name, _bands_of(file)) for key, file in files.items()}
        told[CELLS] = {one.name: count for one, count in done.counts.items()}
    write_item(path, assets, raster, told | {STATUS: status.name}, setting.times[row], cog=cog)
    return {status.name: 1}


class _NoOrthophoto(Exception):
    """Why a frame can have none: its status, and the reason."""

    def __init__(self, status: Status, reason: object) -> None:
        super().__init__(f"{reason}")
        self.status = status


def _rectified(setting: Setting, path: pathlib.Path, row: int) -> RectifiedFile:
    """Write the orthophoto of a frame. Raises `_NoOrthophoto`, and what a later call may do without."""
    image, cells = setting.images[row], setting.cells
    if image is None:
        raise _NoOrthophoto(Status.file_not_read, setting.observed.unread[row].reason)
    exposure = _exposure(setting.observed, row)
    try:
        with opened(image) as data:
            check_size(image, data.shape, exposure.sensor.camera)
    except (ImageError, FileNotFoundError) as error:
        raise _NoOrthophoto(Status.file_not_read, error) from error
    try:
        raster, ground = _raster(image, exposure, setting.ground, cells.crs, cells.size)
        air = exposure.atmosphere
        return rectify_file(
            path, image, exposure.sensor, exposure.motion, ground, like=raster, atmosphere=air, **setting.options
        )
    except ImageError as error:
        raise _NoOrthophoto(Status.file_not_read, error) from error
    except NothingSeen as error:
        raise _NoOrthophoto(Status.ray_misses_terrain, error) from error
    except WindowTooLarge as error:
        raise _NoOrthophoto(Status.leaves_terrain, error) from error


def _bands_of(file: pathlib.Path) -> Bands:
    with opened(f"{file}") as data:
        return Bands(data.count, data.dtypes[0], data.nodata)


def _finish(folder: pathlib.Path, crs: Any, names: Sequence[str]) -> None:
    """Write the catalogue and the mosaics."""
    items = write_catalogue(folder, names, "Orthophotos by jaxgeo, one for each frame.")
    write_mosaics(folder, [found for one in items if (found := mosaic_file(one, "orthophoto", crs)) is not None])

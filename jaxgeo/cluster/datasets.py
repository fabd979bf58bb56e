"""Fixes of observations in an xarray dataset, lazily where its arrays are those of Dask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Atmosphere
from jaxgeo.io._csv import POSE_COLUMNS, gimbal_columns
from jaxgeo.io.files import DemFiles
from jaxgeo.io.geoid import degrees_of
from jaxgeo.io.located import axis_of, locate_observations
from jaxgeo.io.located_over_files import check_straight, locate_over_files
from jaxgeo.io.observations import ObservationBatch, Observations
from jaxgeo.io.tables import PIXEL_COLUMNS, poses_of, readings_of
from jaxgeo.observation import Exposure, Observation
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain

if TYPE_CHECKING:
    import xarray

FOUND = {
    "fix_lat_deg": "deg",
    "fix_lon_deg": "deg",
    "fix_height_m": "m",
    "slant_range_m": "m",
    "incidence_surface_deg": "deg",
}
STATUS = "status"
GIVEN = "given "  # before the names of variables, which may be those of dimensions
UNITS = {
    "deg": ("deg", "degree", "degrees", "degree_north", "degrees_north", "degree_east", "degrees_east"),
    "m": ("m", "metre", "metres", "meter", "meters"),
    "pixel": ("pixel", "pixels", "px", "1"),
}


def locate_dataset(
    dataset: xarray.Dataset,
    sensor: Sensor,
    terrain: AbstractTerrain | DemFiles,
    *,
    atmosphere: Atmosphere | None = None,
) -> xarray.Dataset:
    """Fixes of the observations of one sensor, as a dataset with the dimensions of their variables.

    `dataset` has the variables `lat_deg`, `lon_deg`, `height_m` (above the ellipsoid), `heading_deg`, `pitch_deg`,
    `roll_deg`, `gimbal_<axis>_deg` for each axis of the gimbal, and the pixel `u`, `v`; they are broadcast against each
    other. The result has `fix_lat_deg`, `fix_lon_deg`, `fix_height_m` above the ellipsoid, `slant_range_m`,
    `incidence_surface_deg`, NaN without a fix, and `status`, the code of a `Status`, named in its attributes.

    Chunks of Dask are located one by one when the result is computed (`xarray.map_blocks`), by whatever scheduler Dask
    then has; other arrays at once. Raises `ValueError` for missing variables, other units in their attribute `units`,
    and an atmosphere over a DEM on disk; `ImportError` without the extra.
    """
    require_x64()
    xarray = _xarray()
    check_straight(terrain, atmosphere)
    if isinstance(terrain, AbstractTerrain) and axis_of(terrain) == 0:
        raise ValueError("terrain must be one for all observations; got heights of several.")
    wanted = (*POSE_COLUMNS, *gimbal_columns(sensor.gimbal.names), *PIXEL_COLUMNS)
    if missing := [name for name in wanted if name not in dataset.variables]:
        raise ValueError(f"dataset has no {', '.join(missing)}; its variables must be {', '.join(wanted)}.")
    for name in wanted:
        unit = "pixel" if name in PIXEL_COLUMNS else name.rpartition("_")[2]
        if (given := str(dataset[name].attrs.get("units", unit))) not in UNITS[unit]:
            raise ValueError(f"dataset: {name} is in {given!r} by its attribute units; convert it to {unit}.")
    arrays = xarray.broadcast(*(dataset[name].reset_coords(drop=True) for name in wanted))
    given = {GIVEN + name: array.variable for name, array in zip(wanted, arrays, strict=True)}
    coords = {name: x for name, x in dataset.coords.items() if {*x.dims} <= {*arrays[0].dims}}
    whole = xarray.Dataset(given, coords).unify_chunks()
    setting = (sensor, terrain, atmosphere)
    if not whole.chunks:
        return _located(whole, *setting)
    whole = whole.chunk({dim: whole.chunks.get(dim, -1) for dim in arrays[0].dims})
    like = whole[GIVEN + wanted[0]]
    template = xarray.Dataset({name: xarray.zeros_like(like, dtype) for name, dtype in _dtypes().items()})
    return xarray.map_blocks(_located, whole, args=setting, template=_described(template))


def _dtypes() -> dict[str, Any]:
    return {**dict.fromkeys(FOUND, np.float64), STATUS: np.int8}


def _located(block: xarray.Dataset, sensor: Sensor, terrain: Any, atmosphere: Atmosphere | None) -> xarray.Dataset:
    """The fixes of a block, in memory."""
    xarray = _xarray()
    first = next(iter(block.data_vars.values()))
    given = {str(name).removeprefix(GIVEN): values for name, values in block.data_vars.items()}
    numbers = {name: np.asarray(values, np.float64).ravel() for name, values in given.items()}
    numbers["lat_deg"] = np.where(np.abs(numbers["lat_deg"]) <= 90.0, numbers["lat_deg"], np.nan)
    count = first.size
    with jax.enable_x64(True):
        gimbal = readings_of(numbers, sensor.gimbal.names, count)
        shots = Shot(poses_of(numbers, "ellipsoid"), gimbal, np.zeros(count))
        uv = np.stack([numbers[name] for name in PIXEL_COLUMNS], axis=-1)
        observation = Observation(Exposure(sensor, shots, None, atmosphere), uv)
        batch = ObservationBatch(observation, (), np.arange(count), is_one_camera=True)
        observed = Observations((batch,), [{} for _ in range(count)], source="dataset")
        if isinstance(terrain, DemFiles):
            fixes = locate_over_files(observed, terrain).fixes
        else:
            fixes = locate_observations(observed, terrain)
    lat, lon, height = degrees_of(fixes.position)
    columns = (lat, lon, height, fixes.slant_range, np.degrees(np.asarray(fixes.incidence_surface)), fixes.status)
    found = {
        name: (first.dims, np.asarray(values, dtype).reshape(first.shape))
        for (name, dtype), values in zip(_dtypes().items(), columns, strict=True)
    }
    return _described(xarray.Dataset(found, block.coords))


def _described(found: xarray.Dataset) -> xarray.Dataset:
    for name, unit in FOUND.items():
        found[name].attrs = {"units": unit}
    codes = list(Status)
    meanings = " ".join(one.name for one in codes)
    found[STATUS].attrs = {"flag_values": [int(one) for one in codes], "flag_meanings": meanings}
    return found


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        raise ImportError("datasets need the library xarray: pip install 'jaxgeo[xarray]'.") from None
    return xarray

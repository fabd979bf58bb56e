"""Which images are of one camera, and which cameras are on one gimbal head."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo.adjust.records import Names, as_names
from jaxgeo.observation import Exposure
from jaxgeo.sensor import FrameCamera, Sensor


def cameras_of(exposures: Sequence[Exposure], by_sensor: bool) -> tuple[Names, dict[str, FrameCamera]]:
    """(name of each image's camera, cameras by name): equal ones are one, by their lenses or by their whole sensors."""
    cameras: dict[str, FrameCamera] = {}
    known: dict[str, Any] = {}
    names = []
    for exposure in exposures:
        camera = exposure.sensor.camera
        assert isinstance(camera, FrameCamera)
        key = exposure.sensor if by_sensor else camera
        same = next((name for name, one in known.items() if one is key or are_equal(one, key)), None)
        if same is None:
            same = str(len(cameras) + 1)
            cameras[same], known[same] = camera, key
        names.append(same)
    return np.array(names), cameras


def named_cameras(names: Names, exposures: Sequence[Exposure], camera: Any) -> tuple[Names, dict[str, FrameCamera]]:
    """(name of each image's camera, cameras by name), as given. Raises `ValueError` for unlike cameras of one name."""
    given = as_names(camera, "camera")
    if len(given) != len(exposures):
        raise ValueError(f"camera must be one name for each of {len(exposures)} images; got {len(given)}.")
    cameras: dict[str, FrameCamera] = {}
    first: dict[str, int] = {}
    for row, (one, exposure) in enumerate(zip(given.tolist(), exposures, strict=True)):
        own = exposure.sensor.camera
        assert isinstance(own, FrameCamera)
        known = cameras.setdefault(one, own)
        before = first.setdefault(one, row)
        if known is not own and not are_equal(known, own):
            raise ValueError(
                f"images {names[before]} and {names[row]} are of camera {one!r}, but their focal length, principal "
                f"point, lens or size differ; name them as two cameras."
            )
    return given, cameras


def mounts_of(sensors: Sequence[Sensor], camera: np.ndarray) -> np.ndarray:
    """(n,) for each image the names of the cameras on its gimbal head, joined: those with the same gimbal on the same
    place of the body."""
    found: list[tuple[Any, list[str]]] = []
    which = []
    for sensor, name in zip(sensors, camera.tolist(), strict=True):
        head = sensor.gimbal, sensor.mount.R_body_from_base, sensor.mount.lever_body
        k = next((k for k, (one, _) in enumerate(found) if are_equal(one, head)), len(found))
        if k == len(found):
            found.append((head, []))
        if name not in found[k][1]:
            found[k][1].append(name)
        which.append(k)
    names = [" and ".join(each) for _, each in found]
    doubled = [name if names.count(name) == 1 else f"{name} on mount {k + 1}" for k, name in enumerate(names)]
    return np.array([doubled[k] for k in which])


def are_equal(one: Any, other: Any) -> bool:
    """Whether two records have the same structure and numbers."""
    a, b = jax.tree.leaves(one), jax.tree.leaves(other)
    if jax.tree.structure(one) != jax.tree.structure(other):
        return False
    return all(np.array_equal(np.asarray(x), np.asarray(y)) for x, y in zip(a, b, strict=True))

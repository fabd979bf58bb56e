"""Sensor calibration from an adjustment, as sensor and error source for single-image fixes."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.ray_effects import READOUT, REFRACTION
from jaxgeo.sensor import Sensor
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight
from jaxgeo.uncertainty.sources import (
    AbstractSource,
    Boresight,
    CameraMounting,
    Correlated,
    Distortion,
    InteriorOrientation,
    LeverArm,
)

INTERIOR = {"focal": "focal length", "principal column": "principal column", "principal row": "principal row"}
TURNS = {"boresight z": "heading", "boresight y": "pitch", "boresight x": "roll"}
LEVEL_TURNS = {"boresight x": "forward", "boresight y": "right", "boresight z": "down"}
LEVERS = {"lever arm x": "forward", "lever arm y": "right", "lever arm z": "down"}


class Calibration(NamedTuple):
    """A calibrated sensor and the source of its remaining errors for an `ErrorModel`; the source is None if no
    sensor parameter was unknown."""

    sensor: Sensor
    source: Correlated | None


def calibration(
    adjustment: Adjustment,
    sensor: Sensor | None = None,
    *,
    camera: str | None = None,
    mount: str | None = None,
    scaled: bool = True,
    sharing: AbstractSharing | None = None,
) -> Calibration:
    """The adjusted camera and mount on the gimbal of `sensor`, and their errors with all correlations as one source.

    `camera` and `mount` are names; they may be omitted where there is only one. Covariances are those of the
    adjustment, times `sigma0` squared if `scaled`. `sharing` is the correlation of the errors between images, by
    default per flight. Readout and refraction are not part of it: a rolling shutter is a camera of its own
    (`RollingShutterCamera.from_readout` of the adjusted camera and `Adjustment.readouts`), refraction is of the air.
    Raises `ValueError` for unknown names, for a gimbal whose angle reference differs from that of the block, for an
    unknown pixel aspect (error models do not support it), and for `scaled` without redundancy, where `sigma0` is
    undefined.
    """
    camera = _one(camera, list(adjustment.cameras), "camera")
    found = Sensor(adjustment.cameras[camera]) if sensor is None else sensor
    found = eqx.tree_at(lambda s: s.camera, found, adjustment.cameras[camera])
    if adjustment.mounts:
        mount = _one(mount, list(adjustment.mounts), "mount")
        _check_reference(adjustment, mount, found)
        found = eqx.tree_at(lambda s: s.mount, found, adjustment.mounts[mount])
    owners = f"camera {camera}", f"mount {mount}"
    chosen = [
        (i, p) for i, p in enumerate(adjustment.parameters) if p.whose in owners and p.name not in (READOUT, REFRACTION)
    ]
    if any(p.name == "aspect" for _, p in chosen):
        raise ValueError(f"the aspect of camera {camera} was unknown; adjust with aspect=Fixed() for an error model.")
    if not chosen:
        return Calibration(found, None)
    if scaled and not adjustment.redundancy > 0:
        raise ValueError("the block has no redundancy, and so no sigma0 to scale by; give scaled=False.")
    sigma = {p.name: p.sigma * (adjustment.sigma0 if scaled else 1.0) for _, p in chosen}
    level = found.gimbal.reference == "level"
    parts, order = _sources(sigma, level)
    at = {p.name: i for i, p in chosen}
    correlation = np.eye(sum(len(part.axes) for part in parts))
    known = [(row, at[name]) for row, name in enumerate(order) if name in at]
    for row, i in known:
        for column, j in known:
            correlation[row, column] = adjustment.correlations[i, j]
    sharing = PerFlight() if sharing is None else sharing
    return Calibration(found, Correlated.of(*parts, correlation=correlation, sharing=sharing))


def _sources(sigma: dict[str, float], level: bool) -> tuple[list[AbstractSource], list[str]]:
    """Sources of the unknown parameters, and the parameter names in the order of their axes."""
    parts: list[AbstractSource] = []
    order: list[str] = []
    turns = LEVEL_TURNS if level else TURNS
    for names, source in (
        (INTERIOR, InteriorOrientation),
        (turns, CameraMounting if level else Boresight),
        (LEVERS, LeverArm),
    ):
        if any(name in sigma for name in names):
            parts.append(source(np.array([sigma.get(name, 0.0) for name in names])))
            order += list(names)
    known = {*INTERIOR, *turns, *LEVERS}
    coefficients = tuple(name for name in sigma if name not in known)
    if coefficients:
        parts.append(Distortion(np.array([sigma[name] for name in coefficients]), coefficients=coefficients))
        order += coefficients
    return parts, order


def _check_reference(adjustment: Adjustment, mount: str, sensor: Sensor) -> None:
    assert adjustment.block.navigation is not None
    level = adjustment.block.navigation.mounts[mount][1]
    if level != (sensor.gimbal.reference == "level"):
        there, here = ("local level", "the body") if level else ("the body", "local level")
        raise ValueError(
            f"the gimbal of mount {mount} reports in {there}, that of the sensor in {here}; give the sensor that was "
            f"flown."
        )


def _one(name: str | None, names: list[str], what: str) -> str:
    if name is None and len(names) == 1:
        return names[0]
    if name not in names:
        raise ValueError(f"{what}={name!r}: say which {what}; there are {', '.join(names)}.")
    return name

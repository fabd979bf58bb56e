"""Effects on the rays of a block, and their unknowns, as arrays in layout order."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust.block import Block
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.layout import Layout, Order
from jaxgeo.adjust.ray_effects import READOUT, REFRACTION, RayEffects
from jaxgeo.adjust.readout import camera_motion, has_readout, shares_of
from jaxgeo.adjust.unknowns import Unknowns, spread
from jaxgeo.adjust.values import Values, names_of_interior


class Entry(NamedTuple):
    """A number that each camera has beside its interior orientation and lens: values to start from and prior standard
    deviations (cameras,), zero if fixed and infinite if free."""

    name: str
    start: np.ndarray
    sigma: np.ndarray


def entries_of(block: Block, cameras: tuple[str, ...], unknowns: Unknowns) -> list[Entry]:
    """Readout and refraction of each camera, where the block has them or they are unknown.

    Raises `ValueError` for an unknown refraction of a block without `atmosphere`.
    """
    readout, refraction = (
        spread(choice, cameras, 1, what)[:, 0]
        for choice, what in ((unknowns.readout, READOUT), (unknowns.refraction, REFRACTION))
    )
    found = []
    if has_readout(block) or np.any(readout > 0.0):
        found.append(Entry(READOUT, np.array([block.readout.get(name, 0.0) for name in cameras]), readout))
    if block.atmosphere is not None:
        found.append(Entry(REFRACTION, np.ones(len(cameras)), refraction))
    elif np.any(refraction > 0.0):
        raise ValueError(
            "Unknowns.refraction is a factor on the bending of rays in an atmosphere, which the block does not have; "
            "give Block(atmosphere=jaxgeo.Atmosphere()), or one that was measured."
        )
    return found


def effects_of(block: Block, layout: Layout, order: Order, entries: list[Entry], start: Values) -> RayEffects:
    """The effects at the values to start from. Raises `ValueError` for a readout without the motion of the images."""
    names, first = [one.name for one in entries], len(names_of_interior(next(iter(block.cameras.values()))))
    velocity = turn_rate = share = bending = frame = None
    if READOUT in names:
        one = entries[names.index(READOUT)]
        cameras = dict.fromkeys(block.images.camera.tolist())
        moving = dict(zip(cameras, (one.start != 0.0) | (one.sigma > 0.0), strict=True))
        rows = np.array([moving[name] for name in block.images.camera.tolist()])
        velocity, turn_rate = map(jnp.asarray, camera_motion(block, rows, "A readout"))
        image = block.images.rows_of(block.observations.image)
        in_order = np.zeros(layout.image.shape[0])
        in_order[order.place] = shares_of(block, image, block.observations.uv[:, 1])
        share = jnp.asarray(in_order)
    if REFRACTION in names:
        assert isinstance(block.frame, LocalFrame)
        frame, bending = block.frame, jnp.zeros((3, layout.image.shape[0]))
    return RayEffects(velocity, turn_rate, share, bending, block.atmosphere, frame, first).bent(layout, start)

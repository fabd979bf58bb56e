"""Where a camera is, and where points seem to be, at the time of a pixel in an adjusted image."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import quick_filter_jit
from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.ray_effects import READOUT, REFRACTION, shift_of
from jaxgeo.adjust.readout import shares_of
from jaxgeo.earth import Atmosphere

CHUNK = 32  # points per call: multiples of one size, so that other counts need no compilation


class Seen(NamedTuple):
    """Perspective centres (k, 3) in m, orientations (k, 3, 3), and apparent places (k, 3) in m of the points of pixels,
    frame axes; `by_entries` (k, e, 3) are the shifts of the places that change their pixels as the entries of
    `RayEffects` do, per unit of each."""

    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    place: np.ndarray
    by_entries: np.ndarray


def seen_at(found: Adjustment, image: np.ndarray, row: np.ndarray, place: np.ndarray) -> Seen:
    """By pixels in `row` (k,) px of the adjusted images `image` (k,), of points at `place` (k, 3) in m."""
    centre, R = found.images.centre[image], found.images.R_frame_from_camera[image]
    problem, values = found.prepared.problem, found.solution.values
    effects, camera = problem.effects, np.asarray(problem.layout.camera)[image]
    if effects is None:
        return Seen(centre, R, place, np.zeros((len(image), 0, 3)))
    bend = np.zeros(place.shape)
    if effects.bending is not None:
        assert effects.frame is not None
        assert effects.air is not None
        bend = _shifts(effects.frame, effects.air, centre, place)
        place = place + effects.entry(values, REFRACTION)[camera, None] * bend
    by_entries = []
    if effects.share is not None:
        velocity, turn_rate = (np.asarray(x)[image] for x in (effects.velocity, effects.turn_rate))
        share = shares_of(found.block, image, row)[:, None]
        seconds = effects.entry(values, READOUT)[camera, None] * share
        centre, R = centre + seconds * velocity, _rotations(seconds * turn_rate) @ R
        by_entries.append(-share * (velocity + np.cross(turn_rate, place - centre)))
    if effects.bending is not None:
        by_entries.append(bend)
    return Seen(centre, R, place, np.stack(by_entries, axis=1))


def _rotations(vectors: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vectors).as_matrix()


def _shifts(frame: LocalFrame, air: Atmosphere, centre: np.ndarray, place: np.ndarray) -> np.ndarray:
    size = -(-len(place) // CHUNK) * CHUNK
    c, p = (jnp.asarray(np.resize(np.asarray(x, float), (size, 3))) for x in (centre, place))
    return np.asarray(_bent(frame, air, c, p))[: len(place)]


@quick_filter_jit
def _bent(
    frame: LocalFrame, air: Atmosphere, centre: Float[Array, "k 3"], place: Float[Array, "k 3"]
) -> Float[Array, "k 3"]:
    one = jax.vmap(lambda c, p: shift_of(c, p, air))
    return one(frame.to_ecef(centre), frame.to_ecef(place)) @ frame.R_ecef_from_local

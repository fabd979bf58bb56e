"""Images of one exposure: cameras on one platform share the errors of its observed position and attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.navigation import Navigation
from jaxgeo.adjust.records import as_names

LEAST_POSITION, LEAST_ATTITUDE = 1e-4, 1e-6  # m, rad: lower bounds of standard deviations of each image
FARTHEST = 5.0  # m: observed positions of one exposure that are farther apart are of several exposures
AXES = ("east", "north", "up", "x", "y", "z")


def share_exposures(block: Block, exposure: Any) -> Block:
    """The block whose images of one exposure share the errors of their observed position and attitude.

    `exposure` (n,) names or numbers the exposure of each of the block's images, in their order: images of one exposure
    are of several cameras on one platform at one instant. Its observed position and attitude then err once, by the
    standard deviations of its first image, as six numbers of `Navigation.common` ("position east, exposure 7",
    "attitude x, exposure 7", about the axes of the reference of that image's angles). What the cameras' mounts do not
    explain, the relative orientation of the images does not either: free the boresights of the mounts, each camera
    with one of its own (`Unknowns.boresight`), to estimate it. Images alone in their exposure stay as they are.

    Raises `ValueError` for a block without navigation, a wrong number of exposures, two images of one mount in one
    exposure, observed positions of one exposure more than 5 m apart, and an exposure whose position or attitude is not
    observed.
    """
    check_is(block, Block, "block")
    navigation, names = block.navigation, block.images.name
    if navigation is None:
        raise ValueError("the block has no navigation, whose errors images of one exposure could share.")
    numbers = as_names([str(one) for one in np.asarray(exposure).ravel().tolist()], "exposure")
    if len(numbers) != len(names):
        raise ValueError(f"exposure must be one name or number for each of {len(names)} images; got {len(numbers)}.")
    position, attitude = navigation.information_position.copy(), navigation.information_attitude.copy()
    common = dict(navigation.common)
    for one in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero(numbers == one)
        if len(rows) > 1:
            _check(navigation, names, rows, one)
            common |= _shared(navigation, names, rows, one)
            position[rows], attitude[rows] = np.eye(3) / LEAST_POSITION, np.eye(3) / LEAST_ATTITUDE
    shared = replace(navigation, information_position=position, information_attitude=attitude, common=common)
    return replace(block, navigation=shared)


def _shared(navigation: Navigation, names: np.ndarray, rows: np.ndarray, exposure: str) -> dict[str, np.ndarray]:
    """What one standard deviation of each shared number does to all images (n, 6), by name."""
    first = int(rows[0])
    roots = []
    for what, W in (("position", navigation.information_position), ("attitude", navigation.information_attitude)):
        if np.linalg.matrix_rank(W[first]) < 3:
            raise ValueError(
                f"the {what} of image {names[first]} is not observed in all axes, so that the images of exposure "
                f"{exposure} cannot share its errors; give finite standard deviations, large ones if need be."
            )
        values, vectors = np.linalg.eigh(np.linalg.inv(W[first].T @ W[first]))
        roots.append((vectors * np.sqrt(values)) @ vectors.T)
    found = {}
    R = navigation.R_frame_from_reference
    for axis, name in enumerate(AXES):
        effects = np.zeros((len(names), 6))
        if axis < 3:
            effects[rows, :3] = roots[0][:, axis]
        else:
            effects[rows, 3:] = np.swapaxes(R[rows], 1, 2) @ R[first] @ roots[1][:, axis - 3]
        found[f"{'position' if axis < 3 else 'attitude'} {name}, exposure {exposure}"] = effects
    return found


def _check(navigation: Navigation, names: np.ndarray, rows: np.ndarray, exposure: str) -> None:
    """Raises `ValueError` for images that cannot be of one exposure."""
    mounts, first = navigation.mount[rows], int(rows[0])
    for k in range(1, len(rows)):
        same = np.flatnonzero(mounts[:k] == mounts[k])
        if len(same):
            raise ValueError(
                f"images {names[rows[same[0]]]} and {names[rows[k]]} of exposure {exposure} are both of mount "
                f"{mounts[k]}, whose camera takes one image of an exposure; name the mounts apart, by "
                f"Block.from_shots(camera=...), or the exposures."
            )
        away = float(np.linalg.norm(navigation.position[rows[k]] - navigation.position[first]))
        if away > FARTHEST:
            raise ValueError(
                f"images {names[first]} and {names[rows[k]]} are both of exposure {exposure}, but their observed "
                f"positions are {away:.3g} m apart; are images mixed up? Those of one exposure are taken at once, on "
                f"one platform."
            )

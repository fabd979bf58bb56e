"""Cameras on one platform in a block: the errors of its navigation are one for each exposure."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.rig_flight import ATTITUDE, LEVER, MOUNTING, POSITION, SENSORS, Rig, drawn, measured

from jaxgeo.adjust import Adjustment, Block, Prior, Unknowns, adjust, share_exposures
from jaxgeo.ties import Views

SEEDS = 8
UNKNOWNS = Unknowns(boresight=Prior(MOUNTING), lever=Prior(LEVER))


def block_of(rig: Rig, seed: int) -> Block:
    """The wide camera's images, then the infrared one's, each camera with its mount; not yet of one exposure."""
    views: Views = rig.views()
    seen, parts = measured(rig, views, seed), []
    for letter, sensor in zip("WT", SENSORS, strict=True):
        rows = np.flatnonzero(rig.camera == letter)
        names = np.array(rig.names)[rows]
        batch = jax.tree.map(
            lambda *x: np.stack([np.asarray(one) for one in x]), *[rig.exposures[k].motion for k in rows]
        )
        points = seen.of(np.isin(seen.image, names)).seen_often()
        parts.append(
            Block.from_shots(
                sensor, names, batch, points, frame=views.frame, camera=letter, sigma_position=np.hypot(1.0, POSITION),
                sigma_attitude=ATTITUDE,
            )
        )  # fmt: skip
    return parts[0].with_block(parts[1])


def exposures_of(block: Block) -> list[str]:
    return [name.split("_")[1] for name in block.images.name.tolist()]


def relative(rig: Rig, found: Adjustment) -> tuple[np.ndarray, np.ndarray]:
    """Error (3,) and covariance (3, 3) of the boresight of the infrared camera against that of the wide one, rad."""
    wide, infrared = (found.mounts[letter].R_body_from_base for letter in "WT")
    R = [one.mount.R_head_from_camera for one in SENSORS]
    adjusted = (np.asarray(wide) @ R[0]).T @ np.asarray(infrared) @ R[1]
    true = rig.R_frame_from_camera[0].T @ rig.R_frame_from_camera[1]
    off = Rotation.from_matrix(adjusted @ true.T).as_rotvec()
    names = found.prepared.names.columns(found.prepared.problem)
    at = {
        one: [k for k, (whose, what) in enumerate(names) if whose == f"mount {one}" and "boresight" in what]
        for one in "WT"
    }
    J = np.zeros((3, len(names)))
    J[:, at["T"]], J[:, at["W"]] = R[0].T, -R[0].T
    return off, J @ found.covariance_of_shared @ J.T


def test_an_exposure_errs_once() -> None:
    """The joint covariance of the observed positions and attitudes is that of one aircraft."""
    block = block_of(drawn(0), 0)
    shared = share_exposures(block, exposures_of(block)).navigation
    assert shared is not None
    assert block.navigation is not None
    names = exposures_of(block)
    whole = shared.common_errors
    for first, second in ((3, 17), (3, 18)):
        assert (names[first] == names[second]) == (second == 17)
        expected = np.zeros((6, 6))
        if second == 17:
            R = block.navigation.R_frame_from_reference
            W = block.navigation.information_attitude[first]
            expected[:3, :3] = (1.0 + POSITION**2) * np.eye(3)
            expected[3:, 3:] = np.linalg.inv(W.T @ W) @ R[first].T @ R[second]
        assert np.allclose(whole[first] @ whole[second].T, expected, rtol=0.0, atol=1e-9)
    alone = share_exposures(block, np.arange(len(block.images))).navigation
    assert alone is not None
    assert not alone.common
    assert np.array_equal(alone.information_attitude, block.navigation.information_attitude)


@pytest.mark.costly
def test_the_relative_boresight_of_two_cameras_is_found_to_its_sigma() -> None:
    """Over several draws; far better than by navigation of their own for each camera's images."""
    squares, ratios = 0.0, np.zeros(3)
    for seed in range(SEEDS):
        rig = drawn(seed)
        block = block_of(rig, seed)
        found = adjust(share_exposures(block, exposures_of(block)), UNKNOWNS)
        off, covariance = relative(rig, found)
        squares += off @ np.linalg.solve(covariance, off)
        if seed == 0:
            apart = relative(rig, adjust(block, UNKNOWNS))[1]
            ratios = np.sqrt(np.diagonal(apart) / np.diagonal(covariance))
            pairs = np.array(
                [[block.images.name.tolist().index(f"image_{k:02d}_{one}") for one in "WT"] for k in range(14)]
            )
            R = found.images.R_frame_from_camera[pairs]
            turns = Rotation.from_matrix(np.swapaxes(R[:, 0], 1, 2) @ R[:, 1])
            assert np.max((turns * turns[0].inv()).magnitude()) < 1e-5
    assert abs(squares - 3 * SEEDS) < 3.0 * np.sqrt(6.0 * SEEDS)
    assert np.all(ratios > 1.2)


@pytest.mark.parametrize(
    "change, words",
    [
        ("count", "one name or number for each of 28 images; got 3"),
        ("mount", "image_00_W and image_01_W of exposure 0 are both of mount W"),
        ("place", r"image_00_W and image_01_T are both of exposure 0, but their observed positions are 30.* m apart"),
        ("unknown", "the attitude of image image_00_W is not observed in all axes"),
        ("none", "the block has no navigation"),
    ],
)
def test_what_cannot_be_one_exposure_is_refused(change: str, words: str) -> None:
    block = block_of(drawn(0), 0)
    exposures = exposures_of(block)
    if change == "count":
        exposures = exposures[:3]
    if change == "mount":
        exposures = ["0" if one in ("00", "01") else one for one in exposures]
    if change == "place":
        exposures[0] = exposures[15] = "0"
    if change == "unknown":
        assert block.navigation is not None
        block = replace(block, navigation=replace(block.navigation, information_attitude=np.zeros((28, 3, 3))))
    if change == "none":
        block = replace(block, navigation=None)
    with pytest.raises(ValueError, match=words):
        share_exposures(block, exposures)

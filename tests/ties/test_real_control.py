"""Control and check points of a real block, five frames over Strasbourg, with a drawn navigation: surveyed check points
and the published block against what is predicted."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support import blocks

from jaxgeo import Exposure, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import GroundPoints, ImagePoints, LocalFrame, adjust
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.studies.gu2017.scene import moved
from jaxgeo.ties import Control, Correction, Views, correct
from jaxgeo.uncertainty import PerFlight, sources

pytestmark = pytest.mark.costly
CHECK = ("351", "410")
MOUNT = Mount.nadir()
OFFSET, POSITION, ATTITUDE = 4.0, 1.0, np.deg2rad(0.05)  # drawn errors of the navigation
ERRORS = (
    sources.Position(np.full(3, POSITION)),
    sources.Position(np.full(3, OFFSET), sharing=PerFlight()),
    sources.Attitude(np.full(3, ATTITUDE)),
)


@dataclass(frozen=True)
class Real:
    """Views with a drawn navigation about the published block, its tie points, its control with the check points, and
    the perspective centres of the published block (n, 3) in the frame of the views."""

    views: Views
    ties: ImagePoints
    control: Control
    centre: np.ndarray


@pytest.fixture(scope="module")
def real(jaxgeo_test_data: pathlib.Path) -> Real:
    given = blocks.strasbourg(jaxgeo_test_data)
    block, found = given.block, adjust(given.block, given.unknowns)
    assert block.control is not None
    assert given.checks is not None
    images, middle = found.images, block.control.place.mean(axis=0) * [1.0, 1.0, 0.0]
    frame = LocalFrame(
        Geodetic.from_degrees(lat=48.58, lon=7.75, height=0.0)
    )  # of a Cartesian block: any place will do
    rng = np.random.default_rng(2)
    offset, exposures = OFFSET * rng.normal(size=3), []
    sensor = Sensor(block.cameras["camera"], Gimbal.fixed(), MOUNT)
    down = np.asarray(MOUNT.R_body_from_base) @ np.asarray(MOUNT.R_head_from_camera)
    for centre, R in zip(images.centre - middle, images.R_frame_from_camera, strict=True):
        position = jax.tree.map(lambda x: x[0], frame.to_geodetic(centre[None]))
        turn = np.asarray(R_ecef_from_ned(position)).T @ np.asarray(frame.R_ecef_from_local) @ R @ down.T
        shot = Shot(Pose(position, *heading_pitch_roll_from_R(jnp.asarray(turn))), np.zeros(0))
        errors = offset + POSITION * rng.normal(size=3), ATTITUDE * rng.normal(size=3)
        exposures.append(Exposure(sensor, moved(shot, *errors)))
    views = Views.of(images.name, exposures, [ERRORS] * len(exposures))
    seen, every = block.observations, GroundPoints(
        np.concatenate([block.control.name, given.checks.name]),
        np.concatenate([block.control.place, given.checks.place]) - middle,
        np.concatenate([block.control.sigma, given.checks.sigma]),
    )  # fmt: skip
    own = np.isin(seen.point, every.name)
    every = every.of([name for name in every.name.tolist() if name in set(seen.point.tolist())])
    control = Control(every.name, frame.to_geodetic(every.place), every.sigma, seen.of(own), CHECK)
    centre = np.asarray(views.frame.from_ecef(np.asarray(frame.to_ecef(images.centre - middle))))
    return Real(views, seen.of(~own).seen_often(), control, centre)


@pytest.fixture(scope="module")
def found(real: Real) -> Correction:
    return correct(real.views, real.ties, control=real.control)


def test_check_points_are_off_as_predicted(real: Real, found: Correction) -> None:
    """Pixels of this block are measured less well than the 0.5 px that are stated, which their residuals show. One of
    six coordinates is off by 4.2 standard deviations: its point is marked 4 px from where all others have it."""
    assert not found.blunders
    assert 0.7 < found.excess_of_control < 1.4  # px
    residuals = found.control_residuals
    assert residuals is not None
    own = residuals.role == "check"
    assert sorted(residuals.name[own].tolist()) == sorted(CHECK)
    normal = np.abs(residuals.enu[own] / residuals.sigma_enu[own])
    assert np.sort(normal.ravel())[-2] < 2.0
    assert np.max(normal) < 4.5
    assert np.all(residuals.sigma_enu[own] < [0.15, 0.15, 0.5])  # m
    assert np.all(np.abs(residuals.enu[own]) < 0.35)  # m
    of_no_weight = 1e4 * np.asarray(real.control.sigma_enu)  # in a problem of the same shape
    loose = Control(real.control.name, real.control.position, of_no_weight, real.control.marks, CHECK)
    alone = correct(real.views, real.ties, control=loose).control_residuals
    assert alone is not None
    assert np.linalg.norm(alone.rms_enu()) > 5.0 * np.linalg.norm(residuals.rms_enu())


def test_images_come_to_lie_where_the_published_block_has_them(real: Real, found: Correction) -> None:
    rows = [real.views.name.tolist().index(name) for name in found.names]
    away = found.adjustment.images.centre - real.centre[rows]
    before = real.views.centre[rows] - real.centre[rows]
    assert np.sqrt(np.mean(before**2)) > 1.5
    assert np.all(np.abs(away) < 3.5 * found.adjustment.sigma_of_images[:, :3])
    assert np.sqrt(np.mean(away**2)) < 0.3 * np.sqrt(np.mean(before**2))


def test_a_blunder_among_real_control_is_named(real: Real) -> None:
    """One point 3 m too high."""
    name = next(one for one in real.control.name.tolist() if one not in CHECK)
    height = np.asarray(real.control.position.height) + 3.0 * (real.control.name == name)
    position = Geodetic(lat=real.control.position.lat, lon=real.control.position.lon, height=height)
    control = Control(real.control.name, position, real.control.sigma_enu, real.control.marks, CHECK)
    found = correct(real.views, real.ties, control=control)
    assert [one.point for one in found.blunders] == [name]

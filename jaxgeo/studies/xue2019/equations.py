"""Eqs 1 to 5 of Xue et al. (2019) as printed, in NumPy, compared with the package's functions at the same inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Adjustment, forward_intersection
from jaxgeo.adjust.navigation import sights_of
from jaxgeo.sensor import Bauer, FrameCamera
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.in_numpy import R_ecef_from_ned, R_ned_from_body, ecef
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.simulation import LEVER, Simulated

if TYPE_CHECKING:
    from jaxgeo.studies.xue2019.report import Report

PAPER = "Xue 2019"
SHOTS = (3, 40, 77)  # image indices for Eqs 1, 3 and 4
BELOW = np.array([[60.0, -80.0, -520.0], [-150.0, 40.0, -480.0], [5.0, 120.0, -500.0]])  # m, points below a camera
BAUER = (2.0e-7, 3.0e-5, -5.0e-5)  # mm^-2, 1, 1: additional parameters for Eq. 1
R0 = 20.0  # mm
TO_IMAGE = np.diag([1.0, -1.0, -1.0])  # the paper's image axes (right, up, back) by the camera's (right, down, forward)


def equations(report: Report) -> list[Claim]:
    """A claim for each numbered equation, two for Eq. 5."""
    block = report.block
    return [
        collinearity(block),
        intersection(block),
        orientation(block),
        position(block),
        sum_of_squares(report.cases.adjustment, block),
        normal_equations(report.cases.adjustment, block),
    ]


def collinearity(block: Simulated) -> Claim:
    """Eq. 1, with Bauer's additional parameters as its dx and dy."""
    f, x0, y0 = printed.INTERIORS["Brown"]
    lens = Bauer.from_image_plane(BAUER, focal_length=f, half_side=0.5 * side(), y_up=True, r0=R0)
    camera = FrameCamera.from_metric(
        focal_length=1e-3 * f,
        pixel_pitch=1e-3 * printed.PIXEL_PITCH,
        width=printed.COLUMNS,
        height=printed.ROWS,
        principal_point=(1e-3 * x0, -1e-3 * y0),
        distortion=lens,
    )
    centre, R = orientations(block)
    wanted, found = [], []
    for S, R_camera, below in zip(centre, R, BELOW, strict=True):
        P = S + below
        (a1, a2, a3), (b1, b2, b3), (c1, c2, c3) = R_camera @ TO_IMAGE
        X, Y, Z = P - S
        # x - x0 + dx = -f (a1 (X - XS) + b1 (Y - YS) + c1 (Z - ZS)) / (a3 (X - XS) + b3 (Y - YS) + c3 (Z - ZS))
        right = -f * (a1 * X + b1 * Y + c1 * Z) / (a3 * X + b3 * Y + c3 * Z)
        up = -f * (a2 * X + b2 * Y + c2 * Z) / (a3 * X + b3 * Y + c3 * Z)
        x, y = right, up
        for _ in range(30):  # dx and dy are functions of the measured x and y
            dx, dy = bauer(x, y)
            x, y = right - dx, up - dy
        wanted += [x + x0, y + y0]
        uv, _ = camera.project(jnp.asarray(R_camera.T @ (P - S)))
        found += in_mm(np.asarray(uv)).tolist()
    return Claim(
        PAPER,
        "Eq. 1",
        "collinearity: x, y of three points in three images, with Bauer's parameters",
        wanted,
        found,
        tolerance=1e-8,
        unit="mm",
        function="jaxgeo.sensor.FrameCamera.project",
        digits=".4f",
    )


def intersection(block: Simulated) -> Claim:
    """Eq. 2, with the coefficients that make Eq. 1 linear in the point: l1 = f a1 + (x - x0) a3 and so on."""
    f, x0, y0 = printed.CALIBRATED
    sensor, at = block.given, jnp.array([3, 4, 5])
    shots = jax.tree.map(lambda x: jnp.asarray(x)[at], block.shots)
    centre, R = sights_of(block.frame, sensor, shots)
    point = centre.mean(axis=0) + BELOW[0]
    rows, sides, pixels = [], [], []
    for S, R_camera in zip(centre, R, strict=True):
        uv, _ = sensor.camera.project(jnp.asarray(R_camera.T @ (point - S)))
        x, y = in_mm(np.asarray(uv))
        a, b, c = R_camera @ TO_IMAGE
        # l1 X + l2 Y + l3 Z - lx = 0, l4 X + l5 Y + l6 Z - ly = 0
        for offset, axis in ((x - x0, 0), (y - y0, 1)):
            row = np.array([f * line[axis] + offset * line[2] for line in (a, b, c)])
            rows.append(row)
            sides.append(row @ S)
        pixels.append(np.asarray(uv))
    wanted = np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)[0]
    found = forward_intersection(sensor, shots, np.array(pixels), sigma=0.3)
    return Claim(
        PAPER,
        "Eq. 2",
        "intersection of three rays: X, Y, Z in the block's frame",
        wanted.tolist(),
        np.asarray(block.frame.from_ecef(found.p_ecef)).tolist(),
        tolerance=1e-5,
        unit="m",
        function="jaxgeo.adjust.forward_intersection",
        reason="The paper refers to a textbook for l1 to l6: they follow from Eq. 1.",
        digits=".3f",
    )


def orientation(block: Simulated) -> Claim:
    """Eq. 3: R_c^m (omega, phi, kappa) = R_E^m R_n^E (B, L) R_b^n (Psi, Theta, Phi) R_c^b (ex, ey, ez)."""
    _, R = orientations(block)
    wanted = [angles_of(by_eq_3(block, i)) for i in SHOTS]
    found = [angles_of(R_camera @ TO_IMAGE) for R_camera in R]
    return Claim(
        PAPER,
        "Eq. 3",
        "omega, phi, kappa of three images from heading, pitch, roll and boresight",
        np.concatenate(wanted).tolist(),
        np.concatenate(found).tolist(),
        tolerance=1e-9,
        unit="deg",
        function="jaxgeo.sensor.Sensor.sight",
        reason="m is east, north, up at the block's origin; the sense of ex, ey, ez is not printed.",
        digits=".4f",
    )


def position(block: Simulated) -> Claim:
    """Eq. 4: XS = R_E^m (X_IMU + R_n^E R_b^n (x, y, z of the lever arm))."""
    centre, _ = orientations(block)
    lat, lon, _ = geodetic(block.frame.origin)
    R_m_from_ecef = R_ecef_from_ned(lat, lon)[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    wanted, of_origin = [], R_m_from_ecef.T @ ecef(*geodetic(block.frame.origin))
    for i in SHOTS:
        lat, lon, height = geodetic(block.shots.pose.position, i)
        lever = R_ecef_from_ned(lat, lon) @ R_ned_from_body(*angles(block, i)) @ np.array(LEVER)
        wanted.append(R_m_from_ecef.T @ (ecef(lat, lon, height) + lever))
    right = (np.array(wanted) - of_origin).ravel().tolist()
    return Claim(
        PAPER,
        "Eq. 4",
        "perspective centres of three images from the IMU's and the lever arm",
        np.ravel(wanted).tolist(),
        centre.ravel().tolist(),
        tolerance=1e-6,
        unit="m",
        function="jaxgeo.sensor.Sensor.sight",
        explanation=Explanation(
            "Eq. 4 turns geocentric coordinates into m and does not take off the origin of m; that done",
            right,
            centre.ravel().tolist(),
            1e-6,
        ),
        reason="The text has the vector run from camera to IMU; what Eq. 4 adds runs from IMU to camera.",
        digits=".2f",
    )


def sum_of_squares(adjustment: Adjustment, block: Simulated) -> Claim:
    """Eq. 5: V'PV over its five groups, at the adjusted values."""
    groups = weighted_squares(adjustment, block)
    return Claim(
        PAPER,
        "Eq. 5",
        "V'PV of image points, control, additional parameters, positions and attitudes together",
        sum(groups),
        2.0 * adjustment.cost,
        tolerance=2e-4 * sum(groups),
        function="jaxgeo.adjust.adjust",
        reason=(
            f"By groups {', '.join(f'{group:.1f}' for group in groups)}. The second line prints ls for lc. Attitudes "
            "are compared as angles here and as rotation vectors there, which differ in the fourth digit."
        ),
        digits=".2f",
    )


def normal_equations(adjustment: Adjustment, block: Simulated) -> Claim:
    """Eq. 5: at the adjusted values V'PV is stationary in interior orientation and boresight."""
    sigma = {p.name: p.sigma for p in adjustment.parameters}
    names = ("focal", "principal column", "principal row", "boresight x", "boresight y", "boresight z")
    slopes = []
    for k, name in enumerate(names):
        step = np.zeros(6)
        step[k] = sigma[name]
        ahead, behind = (sum(weighted_squares(adjustment, block, sign * step)) for sign in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * (ahead + behind - 2.0 * sum(weighted_squares(adjustment, block)))))
    return Claim(
        PAPER,
        "Eq. 5",
        "least of V'PV along f, xp, yp and the boresight, off the adjusted values, standard deviations",
        [0.0] * 6,
        slopes,
        tolerance=0.01,
        function="jaxgeo.adjust.adjust",
        reason="By central differences of V'PV as printed, the other unknowns held.",
        digits=".4f",
    )


def weighted_squares(adjustment: Adjustment, block: Simulated, step: np.ndarray | None = None) -> list[float]:
    """V'PV of each group of Eq. 5, with f, xp, yp (px) and the boresight (rad, body axes) offset by a `step` (6,)."""
    step = np.zeros(6) if step is None else step
    seen, images, places = adjustment.block.observations, adjustment.images, adjustment.places
    at = {name: i for i, name in enumerate(images.name.tolist())}
    image = np.array([at[name] for name in seen.image.tolist()])
    points = np.array([places[name] for name in seen.point.tolist()])
    camera = adjustment.cameras["camera"]
    p = np.einsum("nji,nj->ni", images.R_frame_from_camera[image], points - images.centre[image])
    uv = (np.asarray(camera.focal_px) + step[0]) * distorted(camera, p[:, :2] / p[:, 2:])
    uv = uv + np.asarray(camera.principal_px) + step[1:3]
    by_image = float(np.sum(((uv - seen.uv) / seen.sigma) ** 2))
    control = adjustment.block.control
    assert control is not None
    found = np.array([places[name] for name in control.name.tolist()])
    by_control = float(np.sum(((found - control.place) / control.sigma) ** 2))
    known = [p for p in adjustment.parameters if np.isfinite(p.prior)]
    by_parameters = float(sum((p.value / p.prior) ** 2 for p in known))
    by_position, by_attitude = by_navigation(adjustment, block, step[3:])
    return [by_image, by_control, by_parameters, by_position, by_attitude]


def by_navigation(adjustment: Adjustment, block: Simulated, turn: np.ndarray) -> tuple[float, float]:
    """V'PV of positions and of attitudes."""
    images, mount = adjustment.images, adjustment.mounts["camera"]
    lat, lon, _ = geodetic(block.frame.origin)
    R_frame_from_ecef = (R_ecef_from_ned(lat, lon)[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])).T
    origin = ecef(*geodetic(block.frame.origin))
    R_body_from_camera = small(turn) @ np.asarray(mount.R_body_from_base) @ np.asarray(mount.R_head_from_camera)
    positions, attitudes = 0.0, 0.0
    for i, (centre, R) in enumerate(zip(images.centre, images.R_frame_from_camera, strict=True)):
        lat, lon, height = geodetic(block.shots.pose.position, i)
        R_frame_from_body = R @ R_body_from_camera.T
        observed = R_frame_from_ecef @ (ecef(lat, lon, height) - origin)
        off = centre - R_frame_from_body @ np.asarray(mount.lever_body) - observed
        positions += float(np.sum((off / printed.SIGMA_POSITION) ** 2))
        R_ned = (R_frame_from_ecef @ R_ecef_from_ned(lat, lon)).T @ R_frame_from_body
        found = np.array(
            [np.arctan2(R_ned[1, 0], R_ned[0, 0]), -np.arcsin(R_ned[2, 0]), np.arctan2(R_ned[2, 1], R_ned[2, 2])]
        )
        off = (found - angles(block, i) + np.pi) % (2.0 * np.pi) - np.pi
        attitudes += float(np.sum((off / np.deg2rad(printed.SIGMA_ATTITUDE)) ** 2))
    return positions, attitudes


def distorted(camera: FrameCamera, ideal: np.ndarray) -> np.ndarray:
    """Image coordinates of ideal directions (n, 2) with additional parameters: x + dx = ideal, by iteration."""
    lens = camera.distortion
    scale, x = float(np.asarray(lens.scale)), ideal  # type: ignore[attr-defined]
    for _ in range(8):
        x = ideal - scale * np.stack(lens.polynomial(*jnp.asarray(x / scale).T), axis=1)  # type: ignore[attr-defined]
    return np.asarray(x)


def orientations(block: Simulated) -> tuple[np.ndarray, np.ndarray]:
    """(centres, R_frame_from_camera) of `SHOTS` from the package, with the true boresight."""
    shots = jax.tree.map(lambda x: jnp.asarray(x)[jnp.asarray(SHOTS) % len(block.image)], block.shots)
    return sights_of(block.frame, block.true, shots)


def by_eq_3(block: Simulated, i: int) -> np.ndarray:
    """R_c^m of an image, Eq. 3."""
    lat, lon, _ = geodetic(block.frame.origin)
    R_ecef_from_m = R_ecef_from_ned(lat, lon)[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    lat, lon, _ = geodetic(block.shots.pose.position, i)
    roll, pitch, heading = np.deg2rad(np.array(printed.BORESIGHT) / 60.0)
    R_body_from_c = R_ned_from_body(heading, pitch, roll).T @ np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    return R_ecef_from_m.T @ R_ecef_from_ned(lat, lon) @ R_ned_from_body(*angles(block, i)) @ R_body_from_c


def angles(block: Simulated, i: int) -> np.ndarray:
    """Heading, pitch and roll of an image, rad."""
    pose, i = block.shots.pose, i % len(block.image)
    return np.array([float(np.asarray(x)[i]) for x in (pose.heading, pose.pitch, pose.roll)])


def geodetic(position: object, i: int | None = None) -> tuple[float, float, float]:
    """Latitude and longitude in rad and height in m, of a single position or of the i-th of a batch."""
    values = [np.asarray(getattr(position, name)) for name in ("lat", "lon", "height")]
    lat, lon, height = (float(x if i is None else x[i % len(x)]) for x in values)
    return lat, lon, height


def small(turn: np.ndarray) -> np.ndarray:
    """Rotation matrix of a small rotation vector."""
    x, y, z = turn
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + W + 0.5 * W @ W


def angles_of(R: np.ndarray) -> np.ndarray:
    """Omega, phi and kappa in deg of R = Rx(omega) Ry(phi) Rz(kappa)."""
    omega, phi, kappa = np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])
    return np.rad2deg([omega, phi, kappa])


def bauer(x: float, y: float) -> tuple[float, float]:
    """dx and dy by `BAUER`, mm."""
    a1, a2, a3 = BAUER
    radial = a1 * (x * x + y * y - R0 * R0)
    return x * radial - a3 * x, y * radial + a2 * x + a3 * y


def in_mm(uv: np.ndarray) -> np.ndarray:
    """Pixels as x, y of the image plane, y up, mm."""
    middle = np.array([printed.COLUMNS - 1, printed.ROWS - 1]) / 2.0
    return (uv - middle) * np.array([1.0, -1.0]) * printed.PIXEL_PITCH


def side() -> float:
    """The image's longer side, mm."""
    return printed.COLUMNS * printed.PIXEL_PITCH

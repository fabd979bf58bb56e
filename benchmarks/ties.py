"""Mutual correction of real images, held against published orientations, beside COLMAP on the same images.

Run: python benchmarks/ties.py [--points 300] [--blocks drone large] [--seeds 3] [--control 6] [--json out.json]
Two blocks of the folder JAXGEO_TEST_DATA:

- drone: four oblique images, 60 deg below horizontal, that look at one village from four sides. Their navigation is
  that of the tags: RTK positions, gimbal angles assumed good to 1 and 0.5 deg; the reference is the reconstruction of
  OpenSfM.
- large: four frames of a large-format camera in two strips, 5 km above ground, reduced to 640 x 1152 px of 6 m. Their
  orientations are those of the published block; these are the reference, and the navigation is *simulated*: the
  reference with drawn errors, of POS AV 310 SPS (1.5, 3 m; 0.03, 0.1 deg) and of a poor navigation (10 m, 0.3 deg).

Reported: tie points, residuals in px with the orientations of the navigation and the adjusted ones; differences of
positions (m) and attitudes (deg) from the reference; and how far neighbouring images, rectified on the elevation model
to one grid, are apart (m): RMS and median of shifts measured by correlation of blocks in both; the same between each
rectified image and the two orthophotos of the large block's publisher, at 10 m; and heights of the tie points above the
surface model (m). The same for COLMAP
(pycolmap: features, exhaustive matching, mapping with the reference's camera, aligned to the positions of the
navigation by a similarity), and the agreement by the reference's orientations themselves. With --control, the same once
more with control: points drawn on the elevation model, as the reference has them in two images or more, with errors of
3 cm and 0.5 px; every third is a check point. A turn common to all cameras
about their own axes acts as a shift of the principal point; attitudes are also compared without it. Times are of the
processor, with compilation.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from peers.colmap_ties import reconstructed
from scipy.spatial.transform import Rotation

import jaxgeo
from jaxgeo import Exposure, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import ImagePoints, LocalFrame, Prior, Unknowns
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.io import read_dem, read_observations, read_opensfm, read_orientations, read_orthoimage
from jaxgeo.io.images import read_image
from jaxgeo.ortho import Orthoimage, rectify
from jaxgeo.register import match_blocks
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.studies.gu2017.scene import moved
from jaxgeo.terrain import AbstractTerrain, TangentGrid
from jaxgeo.ties import (
    Control,
    Correction,
    Matching,
    Pictures,
    TieOutcome,
    Ties,
    Views,
    candidate_pairs,
    correct,
    find_ties,
)
from jaxgeo.ties.ground import ground_of
from jaxgeo.uncertainty import sources

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
MOUNT = Mount.nadir()
BLOCK = 32  # cells: side of the blocks whose shifts are measured between rectified images
SEARCH = 8.0  # cells: standard deviation of these shifts
LARGEST = 480  # cells: largest side of a grid of rectified images
PIXELS = 2.0  # of an image on a cell of rectified images
SCORE = 0.6  # least correlation of a block


@dataclass(frozen=True)
class Poses:
    """Orientations of images by name, in a frame: centres (n, 3) in m, R_frame_from_camera, and their camera."""

    name: list[str]
    frame: LocalFrame
    centre: np.ndarray
    R: np.ndarray
    camera: FrameCamera

    def of(self, frame: LocalFrame) -> Poses:
        """The same in another frame."""
        turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(self.frame.R_ecef_from_local)
        centre = np.asarray(frame.from_ecef(np.asarray(self.frame.to_ecef(self.centre))))
        return Poses(self.name, frame, centre, turn @ self.R, self.camera)

    def exposure(self, name: str) -> Exposure:
        """The exposure of an image, by a camera that looks down from the body."""
        row = self.name.index(name)
        position = jax.tree.map(lambda x: x[0], self.frame.to_geodetic(self.centre[row : row + 1]))
        R_body_from_camera = np.asarray(MOUNT.R_body_from_base) @ np.asarray(MOUNT.R_head_from_camera)
        R_ecef = np.asarray(self.frame.R_ecef_from_local) @ self.R[row]
        R = np.asarray(R_ecef_from_ned(position)).T @ R_ecef @ R_body_from_camera.T
        pose = Pose(position, *heading_pitch_roll_from_R(jnp.asarray(R)))
        return Exposure(Sensor(self.camera, Gimbal.fixed(), MOUNT), Shot(pose, np.zeros(0)))


@dataclass(frozen=True)
class Real:
    """A block: files, terrain with its height sigma (m), the reference, and views of the navigation by label, with what
    is unknown of the camera."""

    folder: pathlib.Path
    files: list[str]
    terrain: AbstractTerrain
    height_sigma: float
    reference: Poses
    cases: dict[str, tuple[Views, Unknowns | None]]
    orthophotos: tuple[Orthoimage, ...] = ()

    def read(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        return read_image(self.folder / self.files[row])

    def rectified(
        self, poses: Poses, row: int, name: str, grid: Any, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(grey values, mask) of an image on a grid."""
        exposure, (values, known) = poses.exposure(name), self.read(row)
        found = rectify(exposure.sensor, exposure.motion, values, self.terrain, grid, shape, known=known).orthoimage
        return np.asarray(found.values, float).mean(axis=0), np.asarray(found.known)


def drone() -> Real:
    """Four images of a village."""
    folder, undulation = DATA / "odm_miaoli", 19.6  # m: cameras and surface have the same heights
    observed = read_observations([folder / "images"], height_datum=undulation)
    files = [str(row["name"]) for row in observed.columns]
    each = [observed.at(row) for row in range(len(observed))]
    terrain = read_dem(folder / "dsm.tif", vertical_datum=undulation)
    found = read_opensfm(folder / "opensfm" / "reconstruction.json", height_datum=undulation, crs="EPSG:32651")
    (camera,) = {str(name): found.cameras[str(name)] for name in found.camera}.values()
    rows = [found.names.tolist().index(name.removesuffix(".tif")) for name in files]
    assert found.reference is not None
    reference = Poses(files, LocalFrame(found.reference), found.centres[rows], found.R_enu_from_camera[rows], camera)
    errors = [one for _, one in each]
    given = Views.of(files, [one.exposure for one, _ in each], errors)
    with_camera = [eqx.tree_at(lambda e: e.sensor.camera, one.exposure, camera) for one, _ in each]
    return Real(
        folder / "images",
        files,
        terrain,
        2.0,
        reference,
        {
            "camera table": (given, None),
            "self-calibration": (given, Unknowns(focal=Prior(3.0), principal=Prior(1.5))),
            "camera of the reference": (Views.of(files, with_camera, errors), None),
        },
    )


def large(seeds: int) -> Real:
    """Four frames of a large-format camera, with drawn errors of the navigation."""
    folder, undulation = DATA / "ngi_block", 28.3  # m: cameras and ground are above one geoid, which is level here
    crs = json.loads((folder / "io" / "ngi_ext_param.geojson").read_text())["world_crs"]
    table = read_orientations(folder / "io" / "ngi_xyz_opk.csv", height_datum=undulation, crs=crs)
    camera = FrameCamera.from_metric(focal_length=0.120, pixel_pitch=144e-6, width=640, height=1152)
    sensor = Sensor(camera, Gimbal.fixed(), MOUNT)
    files = [f"{name}.tif" for name in table.names]
    shots = [Shot(jax.tree.map(lambda x, row=row: x[row], table.pose)) for row in range(len(files))]
    exact = [Exposure(sensor, shot) for shot in shots]
    cases: dict[str, tuple[Views, Unknowns | None]] = {}
    for label, plane, height, level, heading in (("SPS", 1.5, 3.0, 0.03, 0.1), ("poor", 10.0, 10.0, 0.3, 0.3)):
        errors = (
            sources.Position.from_ned(north=plane, east=plane, down=height),
            sources.Attitude.from_degrees(heading=heading, pitch=level, roll=level),
        )
        for seed in range(seeds):
            rng = np.random.default_rng([seed, 5])
            drawn = [rng.normal(size=6) * [plane, plane, height, *np.deg2rad([heading, level, level])] for _ in shots]
            off = [moved(shot, one[:3], one[3:]) for shot, one in zip(shots, drawn, strict=True)]
            views = Views.of(files, [Exposure(sensor, one) for one in off], [errors] * len(off))
            cases[f"{label}, seed {seed}"] = views, None
    of = Views.of(files, exact, [errors] * len(exact))
    reference = Poses(files, of.frame, of.centre, of.R_frame_from_camera, camera)
    terrain = read_dem(folder / "dem.tif", vertical_datum=undulation)
    orthophotos = tuple(read_orthoimage(one).coarser(2) for one in sorted((folder / "reference_ortho").glob("*.tif")))
    return Real(folder / "images", files, terrain, 10.0, reference, cases, orthophotos)


def differences(poses: Poses, reference: Poses) -> dict[str, float]:
    """RMS differences of orientations from those of the reference."""
    true = reference.of(poses.frame)
    rows = [true.name.index(name) for name in poses.name]
    angles = np.rad2deg(Rotation.from_matrix(np.swapaxes(true.R[rows], 1, 2) @ poses.R).as_rotvec())
    return {
        "position_rms_m": _rms(poses.centre - true.centre[rows]),
        "attitude_rms_deg": _rms(angles),
        "attitude_less_common_rms_deg": _rms(angles - angles.mean(axis=0)),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


class Neighbours:
    """Pairs of neighbouring images, with one grid for each, on which both are rectified."""

    def __init__(self, block: Real, views: Views) -> None:
        self.block, self.pairs = block, []
        for pair in candidate_pairs(views, block.terrain):
            camera = views.camera_of(pair.first)
            u, v = np.meshgrid(*((np.arange(24) + 0.5) / 24 * side for side in (camera.width, camera.height)))
            ground, hit = ground_of(views, pair.first, np.stack([u.ravel(), v.ravel()], axis=1), block.terrain)
            there = (ground - views.centre[pair.second]) @ views.R_frame_from_camera[pair.second]
            uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]
            both = hit & np.all((uv > 0.0) & (uv < [camera.width, camera.height]), axis=1) & (there[:, 2] > 0.0)
            seen = ground[both]
            low, high = np.quantile(seen[:, :2], [0.05, 0.95], axis=0)
            distance = np.median(np.linalg.norm(seen - views.centre[pair.first], axis=1))
            cell = PIXELS * float(distance / np.min(np.asarray(camera.focal_px)))
            side = [int(min(max(length / cell, 3 * BLOCK), LARGEST)) // 2 * 2 for length in (high - low)[::-1]]
            middle = views.frame.to_geodetic(np.append(0.5 * (low + high), 0.0)[None])
            place = Geodetic(lat=middle.lat[0], lon=middle.lon[0], height=jnp.zeros(()))
            grid = TangentGrid.centred(place, spacing=(cell, cell), shape=(side[0], side[1]))
            self.pairs.append((pair, grid, (side[0], side[1]), cell))

    def apart(self, poses: Poses) -> dict[str, Any]:
        """Shifts in m of blocks between rectified neighbours: RMS and median length, and the number of blocks."""
        shifts, by_pair = [], {}
        for pair, grid, shape, cell in self.pairs:
            names = [self.block.files[row] for row in pair[:2]]
            if not set(names) <= set(poses.name):
                continue
            both = []
            for row, name in zip(pair[:2], names, strict=True):
                both.append(self.block.rectified(poses, row, name, grid, shape))
            own = _shifts(both) * cell
            shifts.append(own)
            by_pair["-".join(name.removesuffix(".tif")[-8:] for name in names)] = [len(own), _length(own)]
        return _summary(shifts) | {"blocks_and_rms_of_pairs": by_pair}


def off_orthophotos(block: Real, poses: Poses) -> dict[str, Any]:
    """Shifts in m of blocks between rectified images and orthophotos."""
    shifts = []
    for ortho in block.orthophotos:
        map_of = np.asarray(ortho.values, float).mean(axis=0), np.asarray(ortho.known)
        for name in poses.name:
            image = block.rectified(poses, block.files.index(name), name, ortho.grid, ortho.shape)
            if np.sum(image[1] & map_of[1]) > BLOCK**2:
                shifts.append(_shifts([map_of, image]) * ortho.ground_sampling)
    return _summary(shifts)


def _summary(shifts: list[np.ndarray]) -> dict[str, Any]:
    """RMS and median length, and the number, of shifts in m."""
    every = np.concatenate(shifts)
    median = float(np.median(np.linalg.norm(every, axis=1)))
    return {"rms_m": _rms(every), "median_m": median, "blocks": len(every)}


def above_surface(block: Real, found: Correction) -> dict[str, float]:
    """Heights of the adjusted tie points above the surface model, m: median, and 1.4826 times the median deviation."""
    place = found.views.frame.to_geodetic(found.adjustment.points.place)
    heights = np.asarray(place.height) - np.asarray(jax.jit(jax.vmap(block.terrain.height_at))(place))
    heights = heights[np.isfinite(heights)]
    middle = float(np.median(heights))
    return {"median_m": middle, "nmad_m": 1.4826 * float(np.median(np.abs(heights - middle))), "points": len(heights)}


def drawn_control(block: Real, views: Views, count: int) -> Control:
    """Control and half as many check points on the terrain, far from each other, and their pixels in those images of
    the reference that see the point itself."""
    reference, rng = block.reference.of(views.frame), np.random.default_rng(0)
    exposures = [block.reference.exposure(name) for name in reference.name]
    seen = Views.of(reference.name, exposures, [(sources.Position(np.ones(3)), sources.Attitude(np.full(3, 0.01)))] * 4)
    frame, camera = seen.frame, reference.camera
    size = np.array([camera.width, camera.height])
    candidates = []
    for row in range(len(seen)):
        ground, hit = ground_of(seen, row, rng.uniform(30.0, size - 30.0, (400, 2)), block.terrain)
        candidates.append(ground[hit])
    place = np.concatenate(candidates)
    uv, visible = np.zeros((len(place), len(seen), 2)), np.zeros((len(place), len(seen)), bool)
    for row in range(len(seen)):
        away = (place - seen.centre[row]) @ seen.R_frame_from_camera[row]
        u, v, _ = camera.project_many(*jnp.asarray(away.T))
        uv[:, row] = np.stack([u, v], axis=1)
        inside = (away[:, 2] > 0.0) & np.all((uv[:, row] > 10.0) & (uv[:, row] < size - 10.0), axis=1)
        there, hit = ground_of(seen, row, np.where(inside[:, None], uv[:, row], 0.5 * size), block.terrain)
        visible[:, row] = inside & hit & (np.linalg.norm(there - place, axis=1) < 0.3)
    chosen: list[int] = []
    for index in np.argsort(-visible.sum(axis=1), kind="stable"):
        far = all(np.linalg.norm(place[index, :2] - place[other, :2]) > 25.0 for other in chosen)
        if visible[index].sum() >= 2 and far and len(chosen) < count + count // 2:
            chosen.append(int(index))
    names = [f"point {k}" for k in range(len(chosen))]
    rows = [
        (reference.name[i], names[k], uv[one, i]) for k, one in enumerate(chosen) for i in np.flatnonzero(visible[one])
    ]
    image, point, pixel = zip(*rows, strict=True)
    marks = ImagePoints(list(image), list(point), np.array(pixel) + 0.5 * rng.normal(size=(len(rows), 2)), 0.5)
    position = frame.to_geodetic(place[chosen] + 0.03 * rng.normal(size=(len(chosen), 3)))
    return Control(names, position, 0.03, marks, names[2::3])


def of_control(found: Correction) -> dict[str, Any]:
    """Residuals of check points and what is predicted for them, RMS of east, north and up in m, and of pixels."""
    residuals = found.control_residuals
    assert residuals is not None
    return {
        "points": {role: int(np.sum(residuals.role == role)) for role in ("control", "check", "left out")},
        "check_rms_m": residuals.rms_enu().tolist(),
        "predicted_rms_m": residuals.rms_sigma_enu().tolist(),
        "check_rms_px": residuals.rms_px(),
        "predicted_rms_px": residuals.rms_sigma_px(),
    }


def _length(shifts: np.ndarray) -> float:
    return _rms(shifts) if len(shifts) else float("nan")


def _shifts(both: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Shifts (n, 2) in cells of blocks that correlate between two images and back."""
    (one, known), (other, known_other) = ((np.where(known, grey, 0.0), known) for grey, known in both)
    rows, cols = (np.arange(BLOCK, side - BLOCK // 2, BLOCK // 2) for side in one.shape)
    centres = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2) - 0.5
    covariance = np.broadcast_to(SEARCH**2 * np.eye(2), (len(centres), 2, 2))
    options: Any = {"size": BLOCK, "peaks": 1, "least_score": SCORE}
    found = match_blocks(one, known, other, known_other, centres, covariance, **options)
    back = match_blocks(other, known_other, one, known, centres, covariance, **options)
    good = np.asarray(found.is_candidate)[:, 0] & np.asarray(back.is_candidate)[:, 0]
    shift, backwards = np.asarray(found.shift)[:, 0], np.asarray(back.shift)[:, 0]
    # Blocks of shifted places overlap partly: the way back agrees to a few cells.
    with np.errstate(invalid="ignore"):
        good &= np.linalg.norm(shift + backwards, axis=1) < np.maximum(1.0, 0.2 * np.linalg.norm(shift, axis=1))
    return shift[good]


def mutual(
    block: Real, views: Views, unknowns: Unknowns | None, points: int
) -> tuple[Correction, Ties, dict[str, Any]]:
    """Our matching and adjustment."""
    began = time.process_time()
    ties = find_ties(
        views, block.terrain, Pictures(block.read), Matching(sigma_height=block.height_sigma), points=points
    )
    matched = time.process_time()
    result = correct(views, ties, unknowns)
    counts = {one.name: sum(pair.counts.get(one, 0) for pair in ties.pairs) for one in TieOutcome}
    return (
        result,
        ties,
        {
            "tie_points": len(np.unique(result.adjustment.block.observations.point)),
            "measurements": len(result.adjustment.block.observations),
            "left_out": result.left_out,
            "points_by_outcome": counts,
            "unconnected": result.unconnected,
            "residual_before_px": result.rms_before,
            "residual_after_px": result.rms_after,
            "excess_px": result.excess,
            "matching_s": matched - began,
            "adjustment_s": time.process_time() - matched,
        },
    )


def run(block: Real, points: int, control: int) -> dict[str, Any]:
    """All cases of a block."""
    first = next(iter(block.cases.values()))[0]
    neighbours = Neighbours(block, first)
    reference, theirs = neighbours.apart(block.reference), {}
    found: dict[str, Any] = {"reference": {"agreement": reference}}
    if block.orthophotos:
        found["reference"]["off_orthophotos"] = off_orthophotos(block, block.reference)
    print(json.dumps(found, indent=1), flush=True)
    for label, (views, unknowns) in block.cases.items():
        result, ties, figures = mutual(block, views, unknowns, points)
        before = Poses(
            [str(name) for name in views.name], views.frame, views.centre, views.R_frame_from_camera, views.camera_of(0)
        )
        after = adjusted_poses(result)
        figures |= {
            "before": differences(before, block.reference),
            "after": differences(after, block.reference),
            "agreement_before": neighbours.apart(before),
            "agreement_after": neighbours.apart(after),
            "tie_points_above_surface": above_surface(block, result),
        }
        if block.orthophotos:
            figures |= {
                "off_orthophotos_before": off_orthophotos(block, before),
                "off_orthophotos_after": off_orthophotos(block, after),
            }
        if control:
            held = correct(views, ties, unknowns, control=drawn_control(block, views, control))
            poses = adjusted_poses(held)
            figures["control"] = of_control(held) | {
                "after": differences(poses, block.reference),
                "agreement_after": neighbours.apart(poses),
            }
        place = views.centre.tobytes()
        if place not in theirs:  # COLMAP depends on the positions of the navigation alone
            theirs[place] = colmap(block, views, neighbours)
            figures["colmap"] = theirs[place]
        found[label] = figures
        print(label)
        print(json.dumps(figures, indent=1), flush=True)
    return found


def adjusted_poses(found: Correction) -> Poses:
    """The adjusted orientations and camera."""
    images, (camera,), given = found.adjustment.images, found.adjustment.cameras.values(), found.views.camera_of(0)
    camera = FrameCamera(camera.focal_px, camera.principal_px, camera.distortion, given.width, given.height)
    return Poses(found.names, found.views.frame, images.centre, images.R_frame_from_camera, camera)


def colmap(block: Real, views: Views, neighbours: Neighbours) -> dict[str, Any] | str:
    """COLMAP on the same images, with the camera of the reference."""
    camera = block.reference.camera
    names = [str(name) for name in views.name]
    try:
        found = reconstructed(block.folder, names, camera, views.centre)
    except ImportError as error:
        return f"not run: pycolmap is not installed ({error})."
    except RuntimeError as error:
        return f"no result: {error}"
    poses = Poses(found.name, views.frame, found.centre, found.R_frame_from_camera, camera)
    return {
        "version": found.version,
        "images": len(found.name),
        "points": found.points,
        "measurements": found.measurements,
        "residual_px": found.residual_px,
        "after": differences(poses, block.reference),
        "agreement": neighbours.apart(poses),
        **({"off_orthophotos": off_orthophotos(block, poses)} if block.orthophotos else {}),
        "matching_s": found.matching_s,
        "adjustment_s": found.mapping_s,
    }


def main() -> None:
    """Match, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=300, help="points of each image")
    parser.add_argument("--blocks", nargs="+", choices=("drone", "large"), default=("drone", "large"))
    parser.add_argument("--seeds", type=int, default=3, help="navigations of the large-format block")
    parser.add_argument("--control", type=int, default=0, help="control points drawn for the drone block")
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    makers: dict[str, Callable[[], Real]] = {"drone": drone, "large": lambda: large(given.seeds)}
    found = {name: run(makers[name](), given.points, given.control) for name in given.blocks}
    if given.json is not None:
        given.json.write_text(json.dumps({"device": os.uname().machine, **found}, indent=1))


if __name__ == "__main__":
    main()

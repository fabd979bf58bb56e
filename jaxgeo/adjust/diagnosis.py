"""Diagnosis of an adjustment that did not converge: residuals, image moves and control, by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxgeo.adjust.block import Block
from jaxgeo.adjust.equations import known_points
from jaxgeo.adjust.kept import control_of
from jaxgeo.adjust.measurements import image_residuals
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT, Screen, Screened, screen
from jaxgeo.adjust.solve import Solution
from jaxgeo.adjust.unknowns import Unknowns

MOST = 5  # entries listed per kind
FAR, TURNED = 10.0, 0.1  # m and rad: image moves reported as large
SUSPECT = 10.0  # standard deviations: disagreement with the consensus at the start
OFF = 5.0  # standard deviations: smallest residual reported


@dataclass(frozen=True)
class Misfit:
    """A residual at the last iteration: of an `image point` or a `control point` (then `image` is empty), its row of
    the observations or of the control, and its length in standard deviations of the measurement."""

    kind: str
    image: str
    point: str
    row: int
    sigmas: float

    def __str__(self) -> str:
        where = f" in image {self.image}" if self.image else ""
        return f"{self.kind} {self.point}{where} (row {self.row}): {self.sigmas:.3g}"


@dataclass(frozen=True)
class Move:
    """Displacement of an image from its start: m, and rad."""

    image: str
    distance: float
    turn: float

    def __str__(self) -> str:
        return f"{self.image} by {self.distance:.3g} m and {np.rad2deg(self.turn):.3g} deg"


@dataclass(frozen=True)
class Diagnosis:
    """Outliers at the last iteration of an adjustment that did not converge, each list the worst first.

    `largest`: largest residuals of image points and control; `moved`: images with the largest displacements; `control`:
    control that disagrees; `suspects`: adjusted measurements that already disagreed with the consensus of all others
    before the first iteration; `doubtful`: images most of whose rays missed the others then.
    """

    largest: tuple[Misfit, ...]
    moved: tuple[Move, ...]
    control: tuple[Misfit, ...]
    suspects: tuple[Screened, ...] = ()
    doubtful: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = []
        if self.suspects:
            shown = "; ".join(map(str, self.suspects[:MOST]))
            parts.append(f"Against the consensus of the others, before the first iteration: {shown}.")
        if self.largest:
            parts.append("Largest residuals, in standard deviations: " + "; ".join(map(str, self.largest)) + ".")
        if self.control:
            parts.append("Control that disagrees: " + ", ".join(one.point for one in self.control) + ".")
        if self.moved:
            parts.append("Images that moved most: " + "; ".join(map(str, self.moved)) + ".")
        if self.doubtful:
            parts.append("Images most of whose rays missed the others: " + ", ".join(self.doubtful[:MOST]) + ".")
        parts.append(self.advice)
        return " ".join(parts)

    @property
    def advice(self) -> str:
        """Recommended next step, as text."""
        advice = []
        if self.suspects or self.control or self.largest:
            first = (*self.suspects, *self.control, *self.largest)[0]
            what = "its coordinates, its name, and the zone they are in"
            if first.image:
                what = f"where it was measured in image {first.image}, and its name"
            advice.append(f"Check {first.kind} {first.point} first: {what}.")
        far = [one.image for one in self.moved if one.distance > FAR or one.turn > TURNED]
        image = (*self.doubtful, *far)[0] if self.doubtful or far else ""
        if image:
            advice.append(f"Check the orientation from which image {image} starts, and that it is of its own camera.")
        advice.append("without_blunders(block) leaves out what disagrees and names it.")
        advice.append("For more iterations give solver=Solver(most=...).")
        return " ".join(advice)


def diagnosed(block: Block, unknowns: Unknowns, ready: Prepared, solution: Solution, screened: Screen) -> Diagnosis:
    """Diagnosis of iterations that did not converge; `ready` and `block` as they were adjusted."""
    values, observations = solution.values, block.observations
    residual = np.asarray(image_residuals(ready.problem, values)).T[ready.order.place]
    sizes = np.nan_to_num(np.linalg.norm(residual, axis=1), nan=np.inf)
    points = [
        Misfit(IMAGE_POINT, str(observations.image[i]), str(observations.point[i]), int(i), float(sizes[i]))
        for i in np.argsort(-sizes, kind="stable")[:MOST]
    ]
    control = _of_control(block, ready, solution)
    both = sorted((*points, *control), key=lambda one: -one.sigmas)
    largest = tuple(one for one in both[:MOST] if one.sigmas > OFF)
    wrong = tuple(one for one in control if one.sigmas > OFF)[:MOST]
    moved = _moves(block, solution)
    suspects, doubtful = _before(block, unknowns, screened)
    return Diagnosis(largest, moved, wrong, suspects, doubtful)


def _before(block: Block, unknowns: Unknowns, screened: Screen) -> tuple[tuple[Screened, ...], tuple[str, ...]]:
    """Measurements that disagree at the start but were below the screening limit or not screened."""
    try:
        found = screen(block, unknowns, SUSPECT)
    except ValueError:  # screened before, or the screening itself would raise this
        return (), screened.doubtful
    return found.aside, found.doubtful or screened.doubtful


def _of_control(block: Block, ready: Prepared, solution: Solution) -> list[Misfit]:
    control = control_of(block)
    off = np.asarray(known_points(ready.problem, solution.values))
    row_of = dict(zip(ready.names.point.tolist(), ready.order.row_of_point.tolist(), strict=True))
    found = []
    for i, name in enumerate(control.name.tolist()):
        if name in row_of:
            size = float(np.nan_to_num(np.linalg.norm(off[row_of[name]]), nan=np.inf))
            found.append(Misfit(CONTROL_POINT, "", name, i, size))
    return sorted(found, key=lambda one: -one.sigmas)


def _moves(block: Block, solution: Solution) -> tuple[Move, ...]:
    centre, R = np.asarray(solution.values.centre), np.asarray(solution.values.R_frame_from_camera)
    distance = np.linalg.norm(centre - block.images.centre, axis=1)
    trace = np.einsum("nij,nij->n", block.images.R_frame_from_camera, R)
    turn = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    size = np.nan_to_num(distance / FAR + turn / TURNED, nan=np.inf)
    names = block.images.name
    return tuple(Move(str(names[i]), float(distance[i]), float(turn[i])) for i in np.argsort(-size)[:MOST])

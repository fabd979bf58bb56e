"""Text summary of an adjustment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxgeo.adjust.adjustment import Adjustment, Parameter

MINUTES = 60.0  # of arc in a degree


def summary(adjustment: Adjustment) -> str:
    """Counts, sigma0, residuals, accuracy of orientations and points, and every parameter with its sigma.

    Standard deviations are of unit weight; angles of orientations in deg, of the boresight in minutes of arc.
    """
    block, log = adjustment.block, adjustment.log
    residuals = np.sqrt(np.mean(adjustment.residuals**2, axis=0))
    images, points = adjustment.sigma_of_images, adjustment.points.sigma
    lines = [
        f"{len(block.images)} images, {len(adjustment.points)} points, {len(block.observations)} image points",
        f"{adjustment.observations} observations, {adjustment.unknown_count} unknowns, redundancy "
        f"{adjustment.redundancy}; sigma0 {adjustment.sigma0:.4f}",
        f"{len(log) - 1} iterations, cost {log[0].cost:.6g} -> {adjustment.cost:.6g}",
        f"image residuals, rms: {residuals[0]:.3f} px along columns, {residuals[1]:.3f} px along rows",
        "standard deviations, median: "
        f"perspective centres {_lengths(images[:, :3])}, "
        f"omega, phi, kappa {_numbers(np.rad2deg(images[:, 3:]), '.5f')} deg, points {_lengths(points)}",
    ]
    lines += [f"set aside before the first iteration: {one}" for one in adjustment.screened]
    if adjustment.parameters:
        lines += ["", f"{'':<34}{'value':>16}{'sigma':>13}{'known to':>13}"]
        lines += [_row(parameter) for parameter in adjustment.parameters]
    return "\n".join(lines)


def _row(parameter: Parameter) -> str:
    times, unit = (np.rad2deg(1.0) * MINUTES, "'") if parameter.unit == "rad" else (1.0, parameter.unit)
    name = f"{parameter.whose}: {parameter.name}" + (f", {unit}" if unit != "1" else "")
    value, sigma = parameter.value * times, parameter.sigma * times
    prior = f"{parameter.prior * times:13.4g}" if np.isfinite(parameter.prior) else f"{'–':>13}"
    return f"{name:<34}{value:16.{_decimals(sigma)}f}{sigma:13.3g}{prior}"


def _decimals(sigma: float) -> int:
    """Decimals that resolve a hundredth of the standard deviation."""
    return int(np.clip(2 - np.floor(np.log10(sigma)), 0, 12)) if sigma > 0.0 else 6


def _lengths(sigma: np.ndarray) -> str:
    return f"{_numbers(sigma, '.4f')} m"


def _numbers(values: np.ndarray, spec: str) -> str:
    return ", ".join(format(x, spec) for x in np.median(values, axis=0))

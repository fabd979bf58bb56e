"""One-page summary figure of a registration."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.plot.legends import legend
from jaxgeo.plot.registration import checkerboard, circles_on_map, shifts, ties_on_map
from jaxgeo.plot.style import PAGE, style
from jaxgeo.register.passes import Pass
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.registration import LIMITS, Registration
from jaxgeo.uncertainty import Propagation

SIZE = (11.7, 8.3)  # inches: A4 landscape
COLUMN = 62  # characters of a line of text
DETAIL = 210  # cells per side of the before/after detail


def registration_figure(
    registration: Registration,
    reference: Orthoimage,
    *,
    places: BlockPlaces | None = None,
    before: Orthoimage | None = None,
    after: Orthoimage | None = None,
    direct: Propagation | None = None,
    updated: Propagation | None = None,
    covariance: Any = None,
) -> Figure:
    """One-page summary of a registration: results as text, shifts, tie points, fixes of one pixel, before and after.

    `places` come from `places_of_blocks`; `before` and `after` are the image rectified onto the cells of `reference`
    with the navigation and with the registration; `direct` and `updated` are fixes of one pixel; `covariance` is that
    of the errors before (`Prior.covariance`). Missing inputs have no panel. For an image that is not registered the
    page shows the attempted passes and the outcome.
    """
    with mpl.rc_context(style(PAGE)):
        figure = Figure(figsize=SIZE, layout="constrained")
        FigureCanvasAgg(figure)
        axes: list[Axes] = list(np.ravel(figure.subplots(2, 3)))
        figure.suptitle(registration.outcome.name.replace("_", " "), fontsize="x-large")
        _words(registration, axes[0])
        shown = telling_pass(registration)
        if shown is not None and shown.matches.is_candidate.any():
            number = registration.passes.index(shown) + 1
            _framed(f"Shifts of blocks, pass {number}", shifts(shown, axes[1], covariance=covariance, legend=False))
        else:
            axes[1].set_axis_off()
        if places is not None:
            _framed("Blocks of the last pass", ties_on_map(reference, registration, places, axes[2], legend=False))
        else:
            axes[2].set_axis_off()
        _boards(reference, before, after, axes[3:5])
        if direct is not None:
            drawn = circles_on_map(reference, after or before, direct, updated, axes[5], legend=False)
            _framed("A pixel's fix, and where it is with 90 %", drawn)
        else:
            axes[5].set_axis_off()
    return figure


def telling_pass(registration: Registration) -> Pass | None:
    """The first pass with significant agreement (the widest search); else the last; None if there is no pass."""
    sure = [one for one in registration.passes if one.false_alarms <= LIMITS.false_alarms]
    return (sure or [*registration.passes[-1:]] or [None])[0]


def _boards(reference: Orthoimage, before: Orthoimage | None, after: Orthoimage | None, axes: Sequence[Axes]) -> None:
    if before is not None and after is not None:
        _before_after(reference, before, after, axes)
        return
    for ax, image in zip(axes, (before, after), strict=True):
        if image is None:
            ax.set_axis_off()
            continue
        checkerboard(reference, image, ax)
        ax.set_title("By the navigation, beside the reference")


def _before_after(reference: Orthoimage, before: Orthoimage, after: Orthoimage, axes: Sequence[Axes]) -> None:
    """Checkerboards of the reference with the image, before and after registration.

    For large images only a central part, `DETAIL` cells per side.
    """
    names = ("Before: by the navigation", "After: registered")
    both = np.asarray(before.known) & np.asarray(after.known) & np.asarray(reference.known)
    row, col = (int(np.median(x)) for x in np.nonzero(both)) if both.any() else (n // 2 for n in reference.shape)
    part = min(DETAIL, reference.shape[0]), min(DETAIL, reference.shape[1])
    middle = np.array([row, col]) - np.array(part) // 2
    corner = [int(x) for x in np.clip(middle, 0, np.array(reference.shape) - np.array(part))]
    for ax, image, name in zip(axes, (before, after), names, strict=True):
        checkerboard(reference.window(corner[0], corner[1], part), image.window(corner[0], corner[1], part), ax)
        ax.set_title(name)


def _framed(title: str, ax: Axes) -> None:
    """Add a title above and a legend below the axes."""
    ax.set_title(title)
    legend(ax)


def _words(registration: Registration, ax: Axes) -> None:
    """Print the outcome, the passes, and the standard deviations before and after."""
    ax.set_axis_off()
    lines = textwrap.wrap(registration.outcome.message, COLUMN)
    for number, one in enumerate(registration.passes, 1):
        lines += ["", *textwrap.wrap(f"{number}. {one}", COLUMN, subsequent_indent="   ")]
    text: dict[str, Any] = {"fontsize": "small", "transform": ax.transAxes}
    ax.text(0.0, 1.0, "\n".join(lines), va="top", **text)
    ax.text(0.0, 0.0, "\n".join(_table(registration)), va="bottom", **{**text, "family": "monospace", "fontsize": 6.2})


def _table(registration: Registration) -> list[str]:
    """The correction and standard deviations of each parameter, as lines of equal width."""
    update = registration.update
    if update is None:
        return []
    before, after = (np.sqrt(np.diagonal(np.asarray(x))) for x in (update.prior.covariance, update.covariance))
    units = [unit for source in update.errors.sources for unit in [source.unit] * len(source.axes)] + ["m", "m"]
    found = np.concatenate([np.asarray(update.error), np.asarray(update.shift)])
    rows = [("", "change", "sigma", "left")]
    for name, unit, value, old, new in zip(update.axes, units, found, before, after, strict=True):
        scale, unit = (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit)
        rows.append((f"{name}, {unit}", f"{scale * value:.4g}", f"{scale * old:.3g}", f"{scale * new:.3g}"))
    width = max(len(row[0]) for row in rows)
    return [f"{name:{width}}{change:>11}{old:>7}{new:>9}" for name, change, old, new in rows]

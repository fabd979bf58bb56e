"""All that a registration found, on one page."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxgeo.plot.registration import before_after, checkerboard, circles_on_map, shifts, ties_on_map
from jaxgeo.register.orthoimage import Orthoimage
from jaxgeo.register.passes import Pass
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.registration import LIMITS, Registration
from jaxgeo.uncertainty import Propagation

SIZE = (15.0, 10.2)  # inches, as an A4 page lies on its side
COLUMN = 62  # characters of a line of text


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
    """One page of a registration: its figures in words, shifts, ties, fixes of one pixel, before and after.

    `places` are those of `places_of_blocks`, `before` and `after` the image rectified onto the cells of `reference`
    from the navigation and as registered, `direct` and `updated` fixes of one pixel, `covariance` that of the errors
    before (`Prior.covariance`). What is left out, or never came to be, has no picture: of an image that is not
    registered the page shows what was tried, and says what became of it.
    """
    figure = Figure(figsize=SIZE, layout="constrained")
    axes: list[Axes] = list(np.ravel(figure.subplots(2, 3)))
    figure.suptitle(registration.outcome.name.replace("_", " "), fontsize=13)
    _words(registration, axes[0])
    shown = telling_pass(registration)
    if shown is not None and shown.matches.is_candidate.any():
        number = registration.passes.index(shown) + 1
        _framed(axes[1], f"shifts of blocks, pass {number}", shifts(shown, axes[1], covariance=covariance))
    else:
        axes[1].set_axis_off()
    if places is not None:
        _framed(axes[2], "blocks of the last pass", ties_on_map(reference, registration, places, axes[2]))
    else:
        axes[2].set_axis_off()
    _boards(reference, before, after, axes[3:5])
    if direct is not None:
        title = "a pixel's fix, and where it is with 90 %"
        _framed(axes[5], title, circles_on_map(reference, after or before, direct, updated, axes[5]))
    else:
        axes[5].set_axis_off()
    return figure


def telling_pass(registration: Registration) -> Pass | None:
    """The first pass whose agreement is no chance, which searched farthest; else the last; None where there is none."""
    sure = [one for one in registration.passes if one.false_alarms <= LIMITS.false_alarms]
    return (sure or [*registration.passes[-1:]] or [None])[0]


def _boards(reference: Orthoimage, before: Orthoimage | None, after: Orthoimage | None, axes: Sequence[Axes]) -> None:
    if before is not None and after is not None:
        before_after(reference, before, after, axes)
        return
    for ax, image in zip(axes, (before, after), strict=True):
        if image is None:
            ax.set_axis_off()
            continue
        checkerboard(reference, image, ax)
        ax.set_title("by the navigation, beside the reference", loc="left", fontsize=10)


def _framed(ax: Axes, title: str, handles: list[Line2D]) -> None:
    """A title above, a legend below the axes."""
    ax.set_title(title, loc="left", fontsize=10)
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=1, fontsize=8.5, frameon=False)


def _words(registration: Registration, ax: Axes) -> None:
    """What became of it: the outcome, the passes, and the standard deviations before and after."""
    ax.set_axis_off()
    lines = textwrap.wrap(registration.outcome.message, COLUMN)
    for number, one in enumerate(registration.passes, 1):
        lines += ["", *textwrap.wrap(f"{number}. {one}", COLUMN, subsequent_indent="   ")]
    text: dict[str, Any] = {"fontsize": 8.5, "va": "top", "transform": ax.transAxes}
    ax.text(0.0, 1.0, "\n".join(lines), **text)
    ax.text(
        0.0, 0.0, "\n".join(_table(registration)), **{**text, "va": "bottom", "family": "monospace", "fontsize": 7.5}
    )


def _table(registration: Registration) -> list[str]:
    """Each error's correction and standard deviations, as lines of one width."""
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

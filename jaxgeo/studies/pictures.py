"""Plot style and output of the studies' pictures. Needs matplotlib."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def draw_all(pictures: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]], folder: pathlib.Path) -> None:
    """Draw pictures into a folder: file name to (drawing function, figure size in inches)."""
    with mpl.rc_context(STYLE):
        for name, (draw, size) in pictures.items():
            figure = Figure(figsize=size, layout="constrained")
            FigureCanvasAgg(figure)
            draw(figure)
            figure.savefig(folder / name, dpi=160)

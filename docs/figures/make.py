"""Draw the gallery of jaxgeo.plot: `python docs/figures/make.py [folder [names]]`, by default all of it.

Each figure is drawn over a page and as wide as a column of 80 mm, with type of the size that is read: `budget.png` is
for the page, `budget_column.png` for the column. What they show is made by `gallery.py`: the demonstration's camera and
terrain, which come with the package, a registration, and a small block that is simulated.
"""

from __future__ import annotations

import pathlib
import sys

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_disable_most_optimizations", True)

import matplotlib as mpl  # noqa: E402
from gallery import FIGURES, Drawing  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from PIL import Image  # noqa: E402

from jaxgeo import plot  # noqa: E402
from jaxgeo.plot.style import COLUMN, PAGE, style  # noqa: E402

DPI = 130
COLOURS, LARGE = (256, 128, 64), 145_000  # of a PNG's palette, and bytes from which on it has one
SIZES = {"": PAGE, "_column": COLUMN}


def drawn(drawing: Drawing, width: float) -> Figure:
    """One drawing, so many inches wide."""
    tall = drawing.tall if width < PAGE else drawing.wide
    with mpl.rc_context(style(width)):
        figure = Figure(figsize=(width, tall * width), layout="constrained")
        FigureCanvasAgg(figure)
        drawing.draw(figure)
        figure.draw_without_rendering()  # axes of equal scales come to rest the second time they are laid out
    return figure


def save(figure: Figure, path: pathlib.Path) -> None:
    """A PNG, with a palette if it is large."""
    figure.savefig(path, dpi=DPI if figure.get_figwidth() <= PAGE else DPI * PAGE / figure.get_figwidth())
    picture = Image.open(path).convert("RGB")
    picture.save(path, optimize=True)
    for colours in COLOURS:
        if path.stat().st_size > LARGE:
            picture.quantize(colours, kmeans=8, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def main() -> None:
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    names = sys.argv[2:] or [*FIGURES, "registration", "conventions"]
    for name in names:
        for ending, width in SIZES.items():
            path = folder / f"{name}{ending}.png"
            if name == "conventions":
                save(plot.conventions_figure(width), path)
            elif name == "registration" and not ending:
                from gallery import registration_page

                save(registration_page(), path)
            elif name in FIGURES:
                save(drawn(FIGURES[name], width), path)


if __name__ == "__main__":
    main()

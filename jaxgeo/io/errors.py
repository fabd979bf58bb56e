"""What the readers of this package raise when they refuse a file."""

from __future__ import annotations


class DemError(ValueError):
    """An elevation file that cannot be used as it stands: the message names the file, the place and the reason."""


class VerticalDatumError(DemError):
    """Heights whose vertical datum is unknown, contradictory, or not reachable with the grids that are here."""


class OutsideDatum(ValueError):
    """A position that a vertical datum's grid does not reach; the readers that meet it name the file."""


class TableError(ValueError):
    """A table that cannot be read; the message names the file, the row and the column."""


class ImageError(ValueError):
    """An image or an orthoimage that cannot be used as it stands: the message names the file, the place, the reason."""

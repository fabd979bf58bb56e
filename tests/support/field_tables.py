"""Right answers for the tables of the folder `field`."""

from __future__ import annotations

from tests.support.field import FieldFile

ROWS: tuple[FieldFile, ...] = ()

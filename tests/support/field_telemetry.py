"""Right answers for the telemetry of the folder `field`."""

from __future__ import annotations

from tests.support.field import FieldFile

ROWS: tuple[FieldFile, ...] = ()

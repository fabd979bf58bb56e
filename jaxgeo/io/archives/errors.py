"""Exceptions of reading archives."""

from __future__ import annotations

from jaxgeo.io.errors import DemError


class ArchiveError(DemError):
    """An archive of elevation tiles that cannot be read; the message says what is missing and what to do."""


class NotAtHand(ArchiveError):
    """Something that is not on this machine and cannot be fetched now."""


class MissingGrid(NotAtHand):
    """A geoid grid that is not on this machine, or does not reach where it is needed."""


class Unreachable(NotAtHand):
    """A server that gives no usable answer."""

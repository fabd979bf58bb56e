"""Identity of a sampling: digests of all that was sampled, so that only parts of one sampling are merged."""

from __future__ import annotations

from typing import Any

from jaxgeo._digest import digest_of


class Origin:
    """What was sampled, by name: equal if all values and their structure are.

    Compared by digests, which are computed when first needed; until then the values are kept. They are the same in
    every process.
    """

    def __init__(self, **values: Any) -> None:
        self._values: dict[str, Any] = values
        self._digests: dict[str, str] = {}

    @property
    def digests(self) -> dict[str, str]:
        """A digest of each value. Raises `TypeError` for values that neither records, arrays nor pickle hold."""
        if self._values:
            try:
                self._digests = {name: digest_of(value) for name, value in self._values.items()}
            except TypeError as error:
                raise TypeError(f"samples cannot be merged or pickled here: {error}") from error
            self._values = {}
        return self._digests

    def value(self, name: str) -> Any:
        """A value; None if it is not known, as after the digests were computed (by a merge or a pickle)."""
        return self._values.get(name)

    def differences(self, other: Origin) -> list[str]:
        """Names of the values that differ."""
        theirs = other.digests
        return [name for name, digest in self.digests.items() if theirs.get(name) != digest]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin) and self.digests == other.digests

    def __hash__(self) -> int:
        return hash(tuple(self.digests.items()))

    def __repr__(self) -> str:
        return f"Origin({', '.join([*self._values, *self._digests])})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _loaded, (self.digests,)


def _loaded(digests: dict[str, str]) -> Origin:
    origin = Origin()
    origin._digests = digests
    return origin

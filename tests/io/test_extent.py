"""What is said of a place beside an elevation model."""

from __future__ import annotations

import pytest

import jaxgeo
from jaxgeo.io.extent import place_beside

EXCHANGED = "(with latitude and longitude exchanged it would be on it)"


@pytest.mark.parametrize(
    "lat, lon, is_exchanged", [(-84.2, 36.3, True), (36.3, -80.0, False), (-84.2, 40.0, False), (36.3, 275.8, None)]
)
def test_exchanged_coordinates_are_told_from_others(lat: float, lon: float, is_exchanged: bool | None) -> None:
    said = place_beside(jaxgeo.io.example_dem(), lat, lon, "the target")
    if is_exchanged is None:
        assert said is None, "a longitude may be counted through a full turn"
    else:
        assert said is not None
        assert said.endswith(f"km beside it {EXCHANGED}" if is_exchanged else "km beside it")

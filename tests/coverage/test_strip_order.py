"""Order of the images of one strip, and images that are not on its line."""

from __future__ import annotations

import numpy as np
import pytest

from jaxgeo import Pose, Shot
from jaxgeo.coverage._strip_order import NotOnLine, strip_order

NORTH, EAST = 111_178.0, 76_056.0  # m per deg at 47 deg, by the series of Helmert (1880) for WGS 84


def shots(north: np.ndarray, east: np.ndarray) -> list[Shot]:
    return [
        Shot(Pose.from_degrees(lat=47.0 + y / NORTH, lon=11.0 + x / EAST, height=1000.0))
        for y, x in zip(north.tolist(), east.tolist(), strict=True)
    ]


ALONG = 250.0 * np.arange(10)
COURSE = np.deg2rad(35.0)


def strip(across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (
        ALONG * np.cos(COURSE) - across * np.sin(COURSE),
        ALONG * np.sin(COURSE) + across * np.cos(COURSE),
    )


def test_images_in_order_stay_so_in_either_direction() -> None:
    given = shots(*strip(np.zeros(10)))
    assert strip_order(given) == list(range(10))
    assert strip_order(given[::-1]) == list(range(10))


def test_images_out_of_order_are_sorted_in_the_direction_of_most() -> None:
    given = shots(*strip(np.zeros(10)))
    order = [9, 8, 7, 5, 6, 4, 3, 2, 1, 0]
    assert [order[k] for k in strip_order([given[k] for k in order])] == list(range(10))[::-1]


def test_a_strip_along_a_curve_is_one() -> None:
    """Along an arc that turns by 40 deg, and with drift to either side."""
    turned = np.deg2rad(np.linspace(-20.0, 20.0, 10))
    curve = 250.0 * np.cumsum(np.stack([np.cos(turned), np.sin(turned)]), axis=1)
    assert strip_order(shots(*curve)) == list(range(10))
    assert strip_order(shots(*strip(60.0 * np.resize([1.0, -1.0, 0.0], 10)))) == list(range(10))


@pytest.mark.parametrize("wrong", [0, 4, 9])
def test_an_image_of_another_strip_is_named(wrong: int) -> None:
    with pytest.raises(NotOnLine) as caught:
        strip_order(shots(*strip(np.where(np.arange(10) == wrong, 600.0, 0.0))))
    assert caught.value.index == wrong
    assert caught.value.off == pytest.approx(600.0, abs=150.0)  # the course is turned a little by the image itself


def test_lines_to_and_fro_are_not_one_strip() -> None:
    there = np.concatenate([ALONG, ALONG[::-1]])
    with pytest.raises(NotOnLine):
        strip_order(shots(there, np.repeat([0.0, 800.0], 10)))

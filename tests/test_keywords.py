"""Keyword arguments by another name: refusals name the argument meant, or the constructor that takes it."""

from __future__ import annotations

import inspect
import re
from typing import Any

import pytest

import jaxgeo
from jaxgeo._keywords import SAME, keywords_of
from jaxgeo.uncertainty import sources
from tests.test_records import every_record

PLACE = {"lat": 47.0, "lon": 11.0, "height": 600.0}
MEANT: list[tuple[Any, dict[str, Any], str]] = [
    (jaxgeo.Pose.from_degrees, PLACE | {"yaw": 1.0}, "'yaw'; did you mean 'heading'?"),
    (jaxgeo.Pose.from_degrees, PLACE | {"heading_deg": 1.0}, "did you mean 'heading'?"),
    (jaxgeo.Pose.from_degrees, {"lat": 47.0, "lng": 11.0, "height": 600.0}, "'lng'; did you mean 'lon'?"),
    (jaxgeo.Geodetic.from_degrees, {"latitude": 47.0, "lon": 11.0, "height": 0.0}, "did you mean 'lat'?"),
    (jaxgeo.Geodetic.from_degrees, {"lat": 47.0, "lon": 11.0, "alt": 0.0}, "'alt'; did you mean 'height'?"),
    (jaxgeo.Geodetic, {"lat": 47.0, "lon": 11.0, "altitude": 0.0}, "did you mean 'height'?"),
    (jaxgeo.Pose, PLACE, "'lat'; call Pose.from_degrees(lat=...)."),
    (jaxgeo.ConstantHeight, {"elevation": 300.0}, "did you mean 'height'?"),
    (jaxgeo.FrameCamera.from_metric, {"f": 0.05}, "did you mean 'focal_length'?"),
    (jaxgeo.FrameCamera.from_metric, {"focal_px": 3700.0}, "call FrameCamera.from_pixels(focal_px=...)."),
    (jaxgeo.FrameCamera.from_pixels, {"fx": 3700.0}, "did you mean 'focal_px'?"),
    (jaxgeo.FrameCamera.from_pixels, {"focal_length": 0.05}, "call FrameCamera.from_metric(focal_length=...)."),
    (jaxgeo.Sensor, {"cam": None}, "did you mean 'camera'?"),
    (jaxgeo.Shot, {"gimbal": None}, "did you mean 'gimbal_readings'?"),
    (sources.Attitude, {"heading": 0.05}, "'heading'; call Attitude.from_degrees(heading=...)."),
    (sources.Attitude.from_degrees, {"yaw": 0.05}, "did you mean 'heading'?"),
    (sources.Position, {"north": 3.0}, "call Position.from_ned(north=...)."),
    (sources.Position, {"std": 3.0}, "did you mean 'sigma'?"),
    (sources.TerrainHeight, {"metres": 5.0}, "it takes sigma, "),
    (jaxgeo.Shot, {"colour": None}, "it takes pose, gimbal_readings, time."),
]


@pytest.mark.parametrize("call, given, words", MEANT, ids=[f"{call.__qualname__} {words}" for call, _, words in MEANT])
def test_another_name_is_told_with_the_one_meant(call: Any, given: dict[str, Any], words: str) -> None:
    with pytest.raises(TypeError, match="got an unexpected keyword argument") as refused:
        call(**given)
    assert words in str(refused.value)
    assert str(refused.value).startswith(f"{call.__qualname__}()")


@pytest.mark.parametrize("record", every_record(), ids=lambda one: one.__qualname__)
def test_every_record_names_only_arguments_that_there_are(record: Any) -> None:
    """For each name of a quantity that is none of its arguments."""
    known = keywords_of(record.__init__, record)
    if known is None:
        return
    for wrong in {name for group in SAME for name in group} - known:
        with pytest.raises(TypeError, match="unexpected keyword argument") as refused:
            record(**{wrong: None})
        said = str(refused.value)
        meant = re.search(r"did you mean '(\w+)'", said)
        if meant is not None:
            assert meant[1] in known
        called = re.search(r"; call \w+\.(\w+)\((\w+)=", said)
        if called is not None:
            assert called[2] in inspect.signature(getattr(record, called[1])).parameters or called[2] in known


def test_a_batch_of_names_is_checked_at_the_first_that_is_unknown() -> None:
    with pytest.raises(TypeError, match=r"'speed'; it takes lat, lon, height, heading, pitch, roll, deflection\."):
        jaxgeo.Pose.from_degrees(**PLACE, speed=3.0, mach=0.1)  # pyright: ignore


def test_constructors_keep_their_signatures() -> None:
    assert list(inspect.signature(jaxgeo.Pose.from_degrees).parameters)[:3] == ["lat", "lon", "height"]
    assert jaxgeo.Pose.from_degrees.__doc__.startswith("Pose from degrees")  # pyright: ignore

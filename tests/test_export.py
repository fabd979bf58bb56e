"""Records within exported functions: serialised with their class and static fields, and nothing else."""

from __future__ import annotations

import enum
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import jaxgeo
from jaxgeo._export import _CLASSES, _decoded, _encoded, _from_json, _to_json
from jaxgeo._record import Record
from tests.support import looks

EVERYTHING = (looks.sensor(), looks.shot(), looks.trajectory(), looks.dem(), looks.all_sources(), looks.AIR)


class OfKind(Record):
    kind: Any = eqx.field(static=True)
    size: Any = 1.0


class Colour(enum.Enum):
    red = 1


def registered(structure: Any) -> set[type]:
    """Classes of the records in a tree."""
    data = structure.node_data()
    own = {data[0]} if data is not None and isinstance(data[0], type) and issubclass(data[0], Record) else set()
    return own.union(*map(registered, structure.children()))


def test_every_record_of_an_observation_is_registered() -> None:
    classes = registered(jax.tree.structure(EVERYTHING))
    assert {jaxgeo.Sensor, jaxgeo.Dem, jaxgeo.Trajectory} < classes
    assert classes <= set(_CLASSES.values())


def test_records_without_numbers_are_serialised() -> None:
    """`NoDistortion` has neither leaves nor static fields, a gimbal has names, a projection an ellipsoid."""
    pytest.importorskip("flatbuffers")
    sensor = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000))
    for record in (sensor, *EVERYTHING):
        record = jax.tree.map(jnp.asarray, record)
        exported = jax.export.export(jax.jit(lambda x: x))(record)
        again = jax.export.deserialize(exported.serialize())
        assert again.in_tree == exported.in_tree == jax.tree.structure(((record,), {}))
    assert eqx.tree_equal(again.call(record), record)


@pytest.mark.parametrize("value", [None, True, 3, 2.5, "ned", (1, ("a", None)), (), jaxgeo.WGS84])
def test_static_fields(value) -> None:
    again = _decoded(_encoded(value))
    assert again == value
    assert type(again) is type(value)
    _, (mark, *_) = (None, (object(),))
    assert _from_json(_to_json((mark, value, 1))) == [value, 1]


@pytest.mark.parametrize("value", [Colour.red, jaxgeo.Status.hit, float, len, [1], {"a": 1}])
def test_static_fields_of_other_kinds_are_refused_in_words(value) -> None:
    with pytest.raises(TypeError, match="a static field of a record cannot be serialised: it is a"):
        _encoded(value)

"""Every outcome has a code that fits a byte and a sentence that stands alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.status import Status, count_statuses, first_failure, status_where


@pytest.mark.parametrize("status", list(Status))
def test_every_status_is_a_full_sentence(status):
    assert status.message[0].isupper()
    assert status.message.endswith(".")
    assert len(status.message.split()) >= 5


def test_sentences_and_codes_are_distinct():
    assert len({status.message for status in Status}) == len(Status)
    assert sorted(Status) == list(range(len(Status)))


@pytest.mark.parametrize("status", list(Status))
def test_codes_are_bytes_that_lead_back(status):
    assert status.code.dtype == jnp.int8
    assert status.code.shape == ()
    assert Status(int(status.code)) is status


def test_the_first_failure_wins():
    hit, void, late = Status.hit.code, Status.hits_void.code, Status.not_converged.code
    assert int(first_failure(hit, hit)) == Status.hit
    assert int(first_failure(hit, void, late)) == Status.hits_void
    assert int(first_failure(late, void)) == Status.not_converged
    assert int(first_failure(void)) == Status.hits_void
    assert first_failure(hit, void).dtype == jnp.int8


def test_status_where_chooses_under_vmap():
    codes = jax.jit(jax.vmap(lambda bad: status_where(bad, Status.invalid_input, Status.hit.code)))(
        jnp.array([True, False])
    )
    assert codes.dtype == jnp.int8
    assert codes.tolist() == [Status.invalid_input, Status.hit]


def test_counting_lists_only_what_occurs():
    codes = np.array([0, 3, 3, 0, 0], np.int8)
    assert count_statuses(codes) == {Status.hit: 3, Status.hits_void: 2}
    assert count_statuses(np.array([], np.int8)) == {}

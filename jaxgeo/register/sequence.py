"""Images one after the other: what an update of one says of the errors of the next."""

from __future__ import annotations

import jax.numpy as jnp

from jaxgeo._checks import check_is
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior
from jaxgeo.uncertainty.sharing import Occasion


def propagate_prior(update: Update, here: Occasion, there: Occasion) -> Prior:
    """What is known of the errors of the image taken `there` from the update of the one taken `here`.

    Each source's error there is D e + w, with D its correlation between the two (its `sharing`) and w drawn anew with
    the covariance S - D S D that keeps its own, S: so the mean is D e, the covariance D P D + S - D S D with the
    posterior P. An error of `PerFlight` or `Systematic` is carried over whole, one of `PerImage` begins anew, one that
    is `TimeCorrelated` fades; the map's shift is the same one. e is along the axes of the error model, about the
    navigation's orientation of each image; pass that of the next unchanged, with the prior, to `update_orientation`.

    Exact for errors that are constant, independent, or fade as exp(-dt/T), whose past says no more than their present:
    the images one after the other then are one least squares adjustment of all, so far as that is linear. With other
    `alpha`, `beta` or `strength` what lies before the last image is passed on by way of it only. Raises `TypeError`
    for what is no update.
    """
    check_is(update, Update, "update")
    model = update.errors
    shares = [jnp.full(len(source.axes), source.sharing.correlation(here, there)) for source in model.sources]
    rho = jnp.concatenate([*shares, jnp.ones(2)])
    mean = jnp.concatenate([update.error, update.shift])
    own = jnp.zeros_like(update.covariance).at[:-2, :-2].set(model.covariance())
    own = own.at[-2:, -2:].set(update.cov_shift)
    both = rho[:, None] * rho[None, :]
    return Prior(rho * mean, both * update.covariance + (1.0 - both) * own)

"""Sequential registration: the prior of the next image from the update of the last."""

from __future__ import annotations

import jax.numpy as jnp

from jaxgeo._checks import check_is
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior
from jaxgeo.uncertainty.sharing import Occasion


def propagate_prior(update: Update, here: Occasion, there: Occasion) -> Prior:
    """Prior of the errors of the image taken `there` from the update of the image taken `here`.

    Each source's error there is D e + w, with D its correlation between the two (its `sharing`) and w independent with
    covariance S - D S D, which preserves its covariance S. The mean is thus D e, the covariance D P D + S - D S D with
    the posterior P. `PerFlight` and `Systematic` errors carry over in full, `PerImage` errors are drawn anew,
    `TimeCorrelated` errors decay; the map shift is unchanged. e is along the axes of the error model, relative to the
    navigation's orientation of each image: pass that of the next image, uncorrected, with the prior to
    `update_orientation`.

    Exact for errors that are constant, independent, or decay as exp(-dt/T) (Markov processes): up to linearisation,
    sequential updates then equal one joint least-squares adjustment. With other `alpha`, `beta` or `strength`,
    information from earlier images passes through the last image only. Raises `TypeError` for anything but an update.
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

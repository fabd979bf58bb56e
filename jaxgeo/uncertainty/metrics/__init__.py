"""Accuracy metrics: CE, LE and SE at a probability, error ellipses, classical approximations and standards."""

from jaxgeo.uncertainty.metrics.classical import CLASSICAL, Classical, Comparison, compare_classical
from jaxgeo.uncertainty.metrics.ellipse import ErrorEllipse, drms, error_ellipse, rms_3d, two_drms
from jaxgeo.uncertainty.metrics.exact import (
    circular_error,
    circular_probability,
    linear_error,
    linear_probability,
    spherical_error,
    spherical_probability,
)
from jaxgeo.uncertainty.metrics.from_samples import (
    failed_share,
    radial_errors,
    sample_mean,
    sample_quantile,
    sample_rms,
    share_within,
)
from jaxgeo.uncertainty.metrics.standards import (
    asprs_3d,
    asprs_class,
    asprs_horizontal,
    asprs_vertical,
    categorise,
    decode_misb_error,
    encode_misb_error,
    nssda_horizontal,
    nssda_vertical,
)

__all__ = [
    "CLASSICAL",
    "Classical",
    "Comparison",
    "ErrorEllipse",
    "asprs_3d",
    "asprs_class",
    "asprs_horizontal",
    "asprs_vertical",
    "categorise",
    "circular_error",
    "circular_probability",
    "compare_classical",
    "decode_misb_error",
    "drms",
    "encode_misb_error",
    "error_ellipse",
    "failed_share",
    "linear_error",
    "linear_probability",
    "nssda_horizontal",
    "nssda_vertical",
    "radial_errors",
    "rms_3d",
    "sample_mean",
    "sample_quantile",
    "sample_rms",
    "share_within",
    "spherical_error",
    "spherical_probability",
    "two_drms",
]

"""Accuracy of fixes: error sources, linear propagation, Monte Carlo, sigma points, error budgets, design, tracks."""

from jaxgeo._renamed import renamed
from jaxgeo.uncertainty import datasheet, distributions, metrics, presets, sources
from jaxgeo.uncertainty._accuracy import accuracy
from jaxgeo.uncertainty._accuracy_map import AccuracyMap, accuracy_map
from jaxgeo.uncertainty._budget import Budget, budget
from jaxgeo.uncertainty._calibrate import calibrate_errors
from jaxgeo.uncertainty._compare import Comparison, compare
from jaxgeo.uncertainty._deprecated import accuracy_of_each as accuracy_of_each
from jaxgeo.uncertainty._deprecated import accuracy_of_pixels as accuracy_of_pixels
from jaxgeo.uncertainty._deprecated import assess as assess
from jaxgeo.uncertainty._design import Design, InverseCost, Outcome, certified_design, design
from jaxgeo.uncertainty._error_samples import ErrorSamples, error_samples
from jaxgeo.uncertainty._gauss_helmert import gauss_helmert
from jaxgeo.uncertainty._height_errors import HeightErrors, height_errors
from jaxgeo.uncertainty._second_order import Moments, second_order, sigma_points
from jaxgeo.uncertainty._simulate_looks import SimulatedLooks, simulate_looks
from jaxgeo.uncertainty._track import track
from jaxgeo.uncertainty._validate import validate
from jaxgeo.uncertainty.accuracy_check import AccuracyCheck, check_accuracy
from jaxgeo.uncertainty.accuracy_record import Accuracy
from jaxgeo.uncertainty.calibration import Calibration
from jaxgeo.uncertainty.check_points import CheckPoints
from jaxgeo.uncertainty.draws import AbstractDraws, Random, Sobol
from jaxgeo.uncertainty.histogram import RadiusHistogram
from jaxgeo.uncertainty.intervals import Share
from jaxgeo.uncertainty.joint import JointFixes, joint_covariance
from jaxgeo.uncertainty.linear import Propagation, propagate
from jaxgeo.uncertainty.looks import Looks
from jaxgeo.uncertainty.method_selection import NO_FIX, Diagnostics, Method
from jaxgeo.uncertainty.metrics import circular_error, error_ellipse, linear_error, spherical_error
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.regions import Mode, ProbabilityMap, Region
from jaxgeo.uncertainty.sampled import sample
from jaxgeo.uncertainty.sampled_record import Quantile, Sampled
from jaxgeo.uncertainty.sampling import Sampling
from jaxgeo.uncertainty.sensitivity import SobolIndices, sobol_indices
from jaxgeo.uncertainty.sharing import PerFlight, PerImage, PerMeasurement, Systematic, TimeCorrelated
from jaxgeo.uncertainty.slopes import Facet, Footprint, Level
from jaxgeo.uncertainty.target_motion import AtRest, ConstantVelocity
from jaxgeo.uncertainty.track_record import TargetState, Track
from jaxgeo.uncertainty.validation import Validation

__all__ = [
    "NO_FIX",
    "AbstractDraws",
    "Accuracy",
    "AccuracyCheck",
    "AccuracyMap",
    "AtRest",
    "Budget",
    "Calibration",
    "CheckPoints",
    "Comparison",
    "ConstantVelocity",
    "Design",
    "Diagnostics",
    "ErrorModel",
    "ErrorSamples",
    "Facet",
    "Footprint",
    "HeightErrors",
    "InverseCost",
    "JointFixes",
    "Level",
    "Looks",
    "Method",
    "Mode",
    "Moments",
    "Outcome",
    "PerFlight",
    "PerImage",
    "PerMeasurement",
    "ProbabilityMap",
    "Propagation",
    "Quantile",
    "RadiusHistogram",
    "Random",
    "Region",
    "Sampled",
    "Sampling",
    "Share",
    "SimulatedLooks",
    "Sobol",
    "SobolIndices",
    "Systematic",
    "TargetState",
    "TimeCorrelated",
    "Track",
    "Validation",
    "accuracy",
    "accuracy_map",
    "budget",
    "calibrate_errors",
    "certified_design",
    "check_accuracy",
    "circular_error",
    "compare",
    "datasheet",
    "design",
    "distributions",
    "error_ellipse",
    "error_samples",
    "gauss_helmert",
    "height_errors",
    "joint_covariance",
    "linear_error",
    "metrics",
    "presets",
    "propagate",
    "sample",
    "second_order",
    "sigma_points",
    "simulate_looks",
    "sobol_indices",
    "sources",
    "spherical_error",
    "track",
    "validate",
]

DEPRECATED = {
    "AccuracyOfEach": "Accuracy",
    "Assessment": "Accuracy",
    "EachFlight": "PerFlight",
    "EachMeasurement": "PerMeasurement",
    "EachShot": "PerImage",
    "Everywhere": "Systematic",
    "InTime": "TimeCorrelated",
    "Signs": "Diagnostics",
    "Trust": "Method",
    "jointly": "joint_covariance",
}
__getattr__ = renamed(__name__, DEPRECATED)

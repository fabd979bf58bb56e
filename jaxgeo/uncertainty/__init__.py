"""How sure a fix is: error sources, and every way of pushing chance through the one map from pixel to ground."""

from jaxgeo.uncertainty import metrics, presets, sources
from jaxgeo.uncertainty.accuracy import Accuracy, accuracy
from jaxgeo.uncertainty.accuracy_map import AccuracyMap, accuracy_map, accuracy_of_pixels
from jaxgeo.uncertainty.accuracy_of_each import AccuracyOfEach, accuracy_of_each
from jaxgeo.uncertainty.assess import NO_FIX, Assessment, assess
from jaxgeo.uncertainty.budget import Budget, budget
from jaxgeo.uncertainty.compare import Comparison, compare
from jaxgeo.uncertainty.design import Design, InverseCost, Outcome, certified_design, design
from jaxgeo.uncertainty.draws import AbstractDraws, Random, Sobol
from jaxgeo.uncertainty.gauss_helmert import gauss_helmert
from jaxgeo.uncertainty.joint import JointFixes, jointly
from jaxgeo.uncertainty.linear import Propagation, propagate
from jaxgeo.uncertainty.metrics import circular_error, error_ellipse, linear_error, spherical_error
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sampled import Quantile, Sampled, sample
from jaxgeo.uncertainty.second_order import Moments, second_order, sigma_points
from jaxgeo.uncertainty.sensitivity import SobolIndices, sobol_indices
from jaxgeo.uncertainty.sharing import EachFlight, EachMeasurement, EachShot, Everywhere, InTime
from jaxgeo.uncertainty.slopes import Facet, Footprint, Level
from jaxgeo.uncertainty.verdict import Signs, Trust

__all__ = [
    "NO_FIX",
    "AbstractDraws",
    "Accuracy",
    "AccuracyMap",
    "AccuracyOfEach",
    "Assessment",
    "Budget",
    "Comparison",
    "Design",
    "EachFlight",
    "EachMeasurement",
    "EachShot",
    "ErrorModel",
    "Everywhere",
    "Facet",
    "Footprint",
    "InTime",
    "InverseCost",
    "JointFixes",
    "Level",
    "Moments",
    "Outcome",
    "Propagation",
    "Quantile",
    "Random",
    "Sampled",
    "Signs",
    "Sobol",
    "SobolIndices",
    "Trust",
    "accuracy",
    "accuracy_map",
    "accuracy_of_each",
    "accuracy_of_pixels",
    "assess",
    "budget",
    "certified_design",
    "circular_error",
    "compare",
    "design",
    "error_ellipse",
    "gauss_helmert",
    "jointly",
    "linear_error",
    "metrics",
    "presets",
    "propagate",
    "sample",
    "second_order",
    "sigma_points",
    "sobol_indices",
    "sources",
    "spherical_error",
]

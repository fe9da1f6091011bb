"""Estimators of pose and twist: ground truth, odometry, or odometry with pose fixes (ESTIMATORS.md).

May import: `core`. Estimators are pure: they get received data and have no clock.
To add an estimator: one file here and its name in `choice.py`. To add an option: the dataclass of its table.
"""

from hil.estimation.choice import EstimatorOptions, make_estimator
from hil.estimation.fused import FilterOptions, FusedEstimator
from hil.estimation.measurement import LOST, Estimator, Measurement
from hil.estimation.odometry import OdometryEstimator
from hil.estimation.truth import TruthEstimator

__all__ = [
    "LOST",
    "Estimator",
    "EstimatorOptions",
    "FilterOptions",
    "FusedEstimator",
    "Measurement",
    "OdometryEstimator",
    "TruthEstimator",
    "make_estimator",
]

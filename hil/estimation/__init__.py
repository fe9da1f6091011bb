"""Where the robot is: by ground truth, by odometry, or by odometry and pose fixes together (ESTIMATORS.md).

May import: `core`. Estimators are pure: they are given what was received, and hold no clock.
To add an estimator: one file here and a row in `choice.py`.
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

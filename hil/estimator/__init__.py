"""Where the robot is: by ground truth, by odometry, or by odometry and pose fixes together (ESTIMATORS.md).

The estimators are pure: they are given what was received and hold no clock.
"""

from hil.estimator.choice import EstimatorOptions, make_estimator
from hil.estimator.fused import FusedEstimator, FusedOptions
from hil.estimator.measurement import LOST, Estimator, Measurement
from hil.estimator.odometry import OdometryEstimator
from hil.estimator.truth import TruthEstimator

__all__ = [
    "LOST",
    "Estimator",
    "EstimatorOptions",
    "FusedEstimator",
    "FusedOptions",
    "Measurement",
    "OdometryEstimator",
    "TruthEstimator",
    "make_estimator",
]

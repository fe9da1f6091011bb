"""Where the robot is: by ground truth, or by odometry (ESTIMATORS.md).

The estimators are pure: they are given what was received and hold no clock.
"""

from hil.estimator.choice import make_estimator
from hil.estimator.measurement import Estimator, Measurement
from hil.estimator.odometry import OdometryEstimator
from hil.estimator.truth import TruthEstimator

__all__ = ["Estimator", "Measurement", "OdometryEstimator", "TruthEstimator", "make_estimator"]

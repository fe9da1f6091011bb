"""Names of the estimators, as a scenario's [estimator] has them."""

from typing import NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.model import RobotModel
from hil.core.types import Pose
from hil.estimation.fused import FusedEstimator, FusedOptions
from hil.estimation.measurement import Estimator
from hil.estimation.odometry import OdometryEstimator
from hil.estimation.truth import TruthEstimator

SOURCES = ("truth", "odometry", "fused")
TWISTS = ("source", "wheels")


class EstimatorOptions(NamedTuple):
    """``[estimator]`` of a scenario, as far as it concerns the estimator itself."""

    source: str
    twist: str
    slip_threshold_m_s: float
    filter: FusedOptions


def make_estimator(options: EstimatorOptions, model: RobotModel, start: Pose, counts_per_revolution: int) -> Estimator:
    """Return the estimator that a scenario's ``estimator.source`` names. Raises BadInputError for a name that is none.

    Raises BadInputError as ``MotionReader`` for the counts.
    """
    if options.twist not in TWISTS:
        raise BadInputError(f"estimator.twist = {options.twist!r}: unknown{nearest(options.twist, TWISTS)}")
    if options.source == "truth":
        return TruthEstimator(model, options.twist)
    if options.source == "odometry":
        return OdometryEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s)
    if options.source == "fused":
        return FusedEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s, options.filter)
    raise BadInputError(f"estimator.source = {options.source!r}: unknown{nearest(options.source, SOURCES)}")

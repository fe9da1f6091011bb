"""Names of the estimators, as a scenario's [estimator] has them."""

from hil.errors import BadInputError, nearest
from hil.estimator.measurement import Estimator
from hil.estimator.odometry import OdometryEstimator
from hil.estimator.truth import TruthEstimator
from hil.model import RobotModel
from hil.types import Pose

SOURCES = ("truth", "odometry")
TWISTS = ("source", "wheels")


def make_estimator(
    source: str, model: RobotModel, start: Pose, counts_per_revolution: int, *, twist: str = "source"
) -> Estimator:
    """Return the estimator that a scenario's ``estimator.source`` names; ``twist`` is ``estimator.twist``.

    Raises BadInputError for a name that is none.
    """
    if twist not in TWISTS:
        raise BadInputError(f"estimator.twist = {twist!r}: unknown{nearest(twist, TWISTS)}")
    if source == "truth":
        return TruthEstimator(model, twist)
    if source == "odometry":
        return OdometryEstimator(model, start, counts_per_revolution)
    raise BadInputError(f"estimator.source = {source!r}: unknown{nearest(source, SOURCES)}")

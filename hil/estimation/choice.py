"""``[estimator]`` of a scenario, and the estimator that it names."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.options import Range
from hil.core.types import Pose
from hil.estimation.fused import FilterOptions, FusedEstimator
from hil.estimation.localisation.message import parse_address
from hil.estimation.localisation.simulated import SimulatedOptions
from hil.estimation.measurement import Estimator
from hil.estimation.odometry import OdometryEstimator
from hil.estimation.truth import TruthEstimator


def _reachable(fix: str) -> str:
    if fix != "simulated":
        try:
            parse_address(fix)
        except BadInputError as error:
            raise ValueError(str(error).removeprefix(f"estimator.fix = {fix!r}: ")) from error
    return fix


@dataclass(frozen=True)
class EstimatorOptions:
    """``[estimator]``: the source of the state that the controller acts on."""

    source: Annotated[
        Literal["truth", "odometry", "fused"], "true pose, wheels and gyro alone, or these with pose fixes"
    ] = "truth"
    twist: Annotated[
        Literal["source", "wheels"], "the source's own, or that of wheels and gyro even where the truth has one"
    ] = "source"
    slip_threshold_m_s: Annotated[
        float, Range(gt=0, le=100), "contradiction of wheels, gyro and accelerometer that is slip"
    ] = 0.05
    fix: Annotated[str, _reachable, 'pose fixes of "fused": simulated, or udp://127.0.0.1:PORT'] = "simulated"
    filter: FilterOptions = field(default_factory=FilterOptions)
    simulated_fix: SimulatedOptions = field(default_factory=SimulatedOptions)


def make_estimator(options: EstimatorOptions, model: RobotModel, start: Pose, counts_per_revolution: int) -> Estimator:
    """Return the estimator of a scenario. Raises BadInputError as ``MotionReader`` for the counts."""
    if options.source == "truth":
        return TruthEstimator(model, options.twist)
    if options.source == "odometry":
        return OdometryEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s)
    return FusedEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s, options.filter)

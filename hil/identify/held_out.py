"""How well a plant predicts a drive that no fit has seen: the pose after a second, from the measured currents alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.core.model import RobotModel
from hil.identify.floor import TWIST
from hil.identify.recorded import Array, Drive
from hil.identify.windows import rolled, twists
from hil.plant.mapping import SignalMap
from hil.plant.signals import POSE
from hil.plant.start import Value
from hil.plant.windows import WindowStepper

WINDOW_S = 1.0
_APART_S = 0.25
_SMOOTHED_S = 0.025


class Prediction(NamedTuple):
    """The error of the predicted position at the ends of windows of one second.

    Attributes:
        rms_m: root mean square over the windows.
        time_s: (W,) the beginning of each window.
        error_m: (W,) the distance between the predicted and the measured end.
        against: what it was measured against: "truth", or "wheels and gyro".
    """

    rms_m: float
    time_s: Array
    error_m: Array
    against: str


def predict(
    drive: Drive,
    robot: RobotModel,
    gyro_bias_rad_s: float,
    fmu: Path,
    start: Mapping[str, Value],
    torque_constant_n_m_a: float,
    mapping: SignalMap | None = None,
) -> Prediction:
    """Predict a drive by an FMU with these start values, from many starts.

    ``robot`` has the best known geometry: by it the twist at the start of a window is taken from the wheels, and, in a
    recording without the truth, the pose with which the prediction is compared.

    Raises BadInputError as ``WindowStepper``, DeviceError when the FMU fails.
    """
    rows = round(WINDOW_S / drive.period_s)
    margin = max(2, round(_SMOOTHED_S / drive.period_s))
    first = np.arange(margin, len(drive.time_s) - rows - margin, max(1, round(_APART_S / drive.period_s)))
    places = first[:, None] + np.arange(-margin, margin + 1)
    begin = twists(drive.speed_rad_s[places].mean(axis=1), robot)
    if drive.has_gyro:
        begin[:, 2] = drive.yaw_rate_rad_s[places].mean(axis=1) - gyro_bias_rad_s
    torque = drive.current_a[first[:, None] + 1 + np.arange(rows)] * torque_constant_n_m_a
    with WindowStepper(fmu, start, mapping, varied=TWIST, outputs=POSE, step_ns=round(drive.period_s * 1e9)) as stepper:
        ends = stepper.run(torque, np.arange(len(first)), begin)[:, -1]
    pose, against = (drive.truth, "truth") if drive.has_truth else (rolled(drive, robot, gyro_bias_rad_s), _WHEELS)
    moved = pose[first + rows] - pose[first]
    c, s = np.cos(pose[first, 2]), np.sin(pose[first, 2])
    x, y = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
    error = np.hypot(ends[:, 0] - x, ends[:, 1] - y)
    return Prediction(float(np.sqrt(np.mean(error**2))), drive.time_s[first], error, against)


_WHEELS = "wheels and gyro"

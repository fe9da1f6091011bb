"""What is fitted, and what is known of it before the dynamics: from kinematics, blocks, commands and experience."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hil.core.model import RobotModel
from hil.identify.blocks import BlocksFit
from hil.identify.floor import GAINS, GYRO_BIAS, OFFSETS, STRETCH, Parameter, variable
from hil.identify.gauss_newton import Knowledge, inverted
from hil.identify.kinematics import Kinematics
from hil.identify.recorded import Array

ROLLERS = "roller_friction_coefficient"
"""Often next to zero, so it is not a logarithm."""
RIGID = (
    variable("mass_kg"),
    variable("inertia_kg_m2"),
    variable("wheel_inertia_kg_m2"),
    variable("com_x_m", 0.05),
    variable("com_y_m", 0.05),
    variable("friction_coefficient"),
    variable("viscous_n_m_s_rad"),
)
STIFFNESS = "roller_stiffness_n_m"
"""It is one of forces, so what is right for it depends on the torque constant that is believed."""
SLIP = (*RIGID, variable("grip_coefficient"), variable(ROLLERS, 0.01), variable(STIFFNESS))
LENGTHS = ("wheel_radius_m", "lever_m")
"""They are found by the kinematics, and held in the dynamics."""
_FIRST = {"friction_coefficient": 0.02, "viscous_n_m_s_rad": 0.02, "grip_coefficient": 0.7,
          ROLLERS: 0.01, STIFFNESS: 2e5, "com_x_m": 0.0, "com_y_m": 0.0, STRETCH.name: 0.0}  # fmt: skip
_GRIP_SIGMA = 0.3  # of its logarithm: rubber on floors
_ROLLER_SIGMA = 1.0  # of 0.01
_STIFFNESS_SIGMA = 0.7  # of its logarithm: hard and soft rubber
_LENGTH_SIGMA = 0.02  # of half the length and half the width, as somebody measured them
_GAIN_SIGMA = 0.02  # by which the current sensors of the four wheels differ
_LEAST_GAIN_SIGMA = 1e-4  # of what they share: it is in the torque constant
_OFFSET_SIGMA = 0.01  # of a current sensor, relative to the usual current


class Before(NamedTuple):
    """What is known before the dynamics are fitted.

    Attributes:
        robot: as it is believed, with the radius and the lever that were found.
        torque_constant_n_m_a: the believed one.
        kinematics, blocks: what was found.
        gain_variance: (4,) of the logarithms of the currents' gains, where commands tell the currents.
        usual_current_a: (4,) root mean squares over the drives on the floor.
    """

    robot: RobotModel
    torque_constant_n_m_a: float
    kinematics: Kinematics
    blocks: BlocksFit | None
    gain_variance: Array
    usual_current_a: Array

    def parameters(self, contact: str) -> tuple[Parameter, ...]:
        """Return what is fitted, with the lengths, and last the gyro's bias."""
        shares = {name: getattr(self.robot, name) / self.robot.lever_m for name in ("half_length_m", "half_width_m")}
        lengths = (variable("wheel_radius_m"), Parameter("lever_m", shares))
        return (*(RIGID if contact == "rigid" else SLIP), STRETCH, *lengths, *GAINS, *OFFSETS, GYRO_BIAS)

    def point(self, parameters: Sequence[Parameter], fitted: Mapping[str, float]) -> Array:
        """Return the numbers with which a fit begins; ``fitted`` are values of a simpler model."""
        robot = self.robot
        first = {name: getattr(robot, name) for name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", *LENGTHS)}
        first |= {one.name: 1.0 for one in GAINS} | {one.name: 0.0 for one in OFFSETS}
        first |= {**_FIRST, GYRO_BIAS.name: self.kinematics.gyro_bias_rad_s, **fitted}
        if self.blocks is not None:
            first |= {
                "wheel_inertia_kg_m2": self.blocks.inertia_kg_m2,
                "viscous_n_m_s_rad": self.blocks.viscous_n_m_s_rad,
            }
        return np.array([one.internal(first[one.name]) for one in parameters])

    def knowledge(self, parameters: Sequence[Parameter]) -> Knowledge:
        """Return what is known of the parameters; lengths are held."""
        names, robot = [one.name for one in parameters], self.robot
        known = Knowledge.none(len(names))._replace(mean=self.point(parameters, {}))
        held = [names.index(name) for name in LENGTHS]
        known.held[held] = True
        known.held_covariance[np.ix_(held, held)] = self.kinematics.covariance
        gains, offsets = ([names.index(one.name) for one in ones] for ones in (GAINS, OFFSETS))
        apart = np.eye(len(gains)) - 1.0 / len(gains)
        doubt = np.diag(self.gain_variance + _LEAST_GAIN_SIGMA**2) + _GAIN_SIGMA**2 * apart
        known.information[np.ix_(gains, gains)] = inverted(doubt)
        known.information[offsets, offsets] = [
            one.internal(_OFFSET_SIGMA * usual_a) ** -2
            for one, usual_a in zip(OFFSETS, self.usual_current_a, strict=True)
        ]
        if self.blocks is not None:
            # Both are in proportion to the mean of the currents' gains.
            places = [*(names.index(name) for name in ("wheel_inertia_kg_m2", "viscous_n_m_s_rad")), *gains]
            rows = np.concatenate([np.eye(2), np.full((2, len(gains)), -1.0 / len(gains))], axis=1)
            known.information[np.ix_(places, places)] += (
                rows.T @ inverted(self.blocks.covariance_of_logarithms()) @ rows
            )
        place = names.index(STRETCH.name)
        sigma_m = np.sqrt(2.0) * _LENGTH_SIGMA * robot.half_length_m * robot.half_width_m / robot.lever_m
        known.information[place, place] = (STRETCH.internal(1.0) * sigma_m) ** -2
        if "grip_coefficient" in names:
            known.information[(names.index("grip_coefficient"),) * 2] = _GRIP_SIGMA**-2
            known.information[(names.index(ROLLERS),) * 2] = _ROLLER_SIGMA**-2
            known.information[(names.index(STIFFNESS),) * 2] = _STIFFNESS_SIGMA**-2
        return known

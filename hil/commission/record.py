"""What one drive of commissioning saw, and what is known of the encoders."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Record(NamedTuple):
    """What one drive saw: a row a period, a column a channel; NaN for what is not measured.

    Attributes:
        t_s: since its beginning.
        torque_n_m: commanded for the period that begins then (in mode SPEED: the speeds).
        turned_rad: angle since the beginning, by the encoders' inputs and the believed counts.
        speed_rad_s: as the robot reports it.
        current_a: likewise.
        acceleration_m_s2: of the IMU's three axes.
        yaw_rate_rad_s: about the IMU's third axis.
        was_cut: whether a limit ended it early.
    """

    t_s: Array
    torque_n_m: Array
    turned_rad: Array
    speed_rad_s: Array
    current_a: Array
    acceleration_m_s2: Array
    yaw_rate_rad_s: Array
    was_cut: bool

    @property
    def fastest_rad_s(self) -> float:
        """The largest speed of any wheel."""
        return float(np.abs(self.speed_rad_s).max(initial=0.0))


class Encoders:
    """What is known of the encoders: for each channel its input, and its sign against the channel's motor."""

    def __init__(self, inputs: Sequence[int | None] = (None,) * 4, signs: Sequence[int] = (1,) * 4) -> None:
        self.inputs = list(inputs)
        self.signs = list(signs)

    def of_motors(self, by_input: Sequence[float]) -> list[float]:
        """Return values of the encoders' inputs, as the channels' motors count them; 0 for one that is not known."""
        pairs = zip(self.inputs, self.signs, strict=True)
        return [0.0 if place is None else sign * by_input[place] for place, sign in pairs]

    def input_of(self, channel: int) -> int:
        """Return the input of a channel's encoder, which must be known."""
        place = self.inputs[channel]
        assert place is not None
        return place

"""What Nguyen Minh et al. 2023 print of their results, and what follows from it by their own equations.

"An Adaptive Fuzzy Dynamic Surface Control Tracking Algorithm for Mecanum Wheeled Mobile Robot", section IV. The four
figures are all the numbers that the section has; they can be compared to within one unit of the last printed digit.
"""

import math
from typing import NamedTuple

import numpy as np

from hil.laws.afdsc import K1_1_S, K2_1_S, RULES


class Printed(NamedTuple):
    """A figure of the paper.

    ``law`` is the law's registered name, ``figure`` the name of our figure (``hil.judge.figures``). ``digit`` is one
    unit of the last printed digit, in the figure's unit: 0.1 for 0.6.
    """

    law: str
    figure: str
    value: float
    digit: float


DSC_TRACKED = Printed("dsc", "tracked_s", 1.1, 0.1)
AFDSC_TRACKED = Printed("afdsc", "tracked_s", 0.6, 0.1)
DSC_STEADY = Printed("dsc", "steady_rms_m", 0.00079, 0.00001)
AFDSC_STEADY = Printed("afdsc", "steady_rms_m", 0.00038, 0.00001)
FIGURES = (DSC_TRACKED, AFDSC_TRACKED, DSC_STEADY, AFDSC_STEADY)
"""Section IV.A: when the laws are on the trajectory, and what then remains of the error."""

DSC_GAINS = (15.0, 40.0)
"""Table V: K1 and K2 [1/s]."""
FUZZY_CENTRE = (K1_1_S["M"], K2_1_S["M"])
"""K1 and K2 [1/s] of Tables III and IV where error and rate are zero."""

RADIUS_M, PERIOD_S = 1.0, 15.0
"""Section IV.A, Table V: the circle."""

SILENT_FROM_S, SILENT_TO_S = 30.0, 37.0
"""Section IV.B, Fig. 11: no control signal between these times."""
TRANSITION_S, TRANSITION_DIGIT_S = 4.0, 1.0
"""Section IV.B: "a transition that takes about 4 seconds"."""


def steady_error_m(filter_s: float, k1_1_s: float) -> float:
    """Return the steady error of dynamic surface control on the circle [m], for a filter constant ς and a gain K1.

    Where the inner surface holds q̇ = x2d, equation 17 with x̄2 = q̇_d - K1 e reads ς (ë + q̈_d) + ė + K1 e = 0. On a
    circle of rate ω and radius r0 its periodic solution is ς ω² r0 / abs(K1 - ς ω² + j ω), next to ς ω² r0 / K1.
    """
    rate = math.tau / PERIOD_S
    return filter_s * rate**2 * RADIUS_M / abs(complex(k1_1_s - filter_s * rate**2, rate))


def filter_for(steady_m: float, k1_1_s: float) -> float:
    """Return the filter constant ς [s] that leaves this steady error at a gain K1: e K1 / (ω² r0)."""
    return steady_m * k1_1_s / ((math.tau / PERIOD_S) ** 2 * RADIUS_M)


def gain_for(steady_m: float, filter_s: float) -> float:
    """Return the gain K1 [1/s] that leaves this steady error with a filter constant ς."""
    return filter_s * (math.tau / PERIOD_S) ** 2 * RADIUS_M / steady_m


def stiffest_rule_1_s2() -> float:
    """Return the largest K1 K2 [1/s²] that a rule of Tables III and IV gives, as printed or corrected.

    A constant disturbance d leaves an error of d / (K1 K2), which matters for causes other than the filter.
    """
    return max(
        K1_1_S[first] * K2_1_S[second]
        for k1_rules, k2_rules in RULES.values()
        for k1_row, k2_row in zip(k1_rules, k2_rules, strict=True)
        for first, second in zip(k1_row, k2_row, strict=True)
    )


COMMON_FILTER_S = round(filter_for(DSC_STEADY.value, DSC_GAINS[0]), 4)
"""The filter constant that DSC's steady error asks for, here for both laws."""
SHORT_FILTER_S = round(filter_for(AFDSC_STEADY.value, FUZZY_CENTRE[0]), 4)
"""The filter constant that AFDSC's steady error asks for."""


class DelayMargin(NamedTuple):
    """The latency at which the loop is on the edge of stability, and the frequency at which it then swings."""

    latency_s: float
    frequency_hz: float


def delay_margin(k1_1_s: float, k2_1_s: float, filter_s: float, period_s: float = 0.0) -> DelayMargin:
    """Return the delay margin of one axis.

    With equation 17 the requested acceleration is u = s x2d - K2 (s e - x2d), x2d = -K1 e / (1 + ς s). The robot
    answers with s² e = u. So the open loop is ((s + K2) K1 / (1 + ς s) + K2 s) / s². The delay of a controller that
    holds its command, half of ``period_s``, is subtracted.
    """

    def loop(rate_rad_s: float) -> complex:
        s = complex(0.0, rate_rad_s)
        return ((s + k2_1_s) * k1_1_s / (1.0 + filter_s * s) + k2_1_s * s) / s**2

    # The gain falls below 1 for good somewhere here: above, it goes with (K1 / ς + K2 s) / s² at most.
    rates = np.geomspace(1e-2, 1e4, 4000)
    above = np.flatnonzero([abs(loop(rate)) > 1.0 for rate in rates])
    low, high = float(rates[above[-1]]), float(rates[above[-1] + 1])
    for _ in range(60):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(loop(middle)) > 1.0 else (low, middle)
    at = loop(low)
    phase_rad = math.atan2(-at.imag, -at.real) % math.tau
    return DelayMargin(phase_rad / low - period_s / 2.0, low / math.tau)

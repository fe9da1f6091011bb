"""Values with intervals, and what each is worth: identified, effective, measured by hand, or only believed."""

from typing import Literal, NamedTuple

import numpy as np

from hil.addons.identify.before import STIFFNESS
from hil.addons.identify.fit import Result
from hil.addons.identify.robust_statistics import Z_95
from hil.addons.identify.windows import NUISANCES

_MASSES = ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", "viscous_n_m_s_rad")
SCALED = (*_MASSES, STIFFNESS)  # what drives tell only over the torque constant: all of them in proportion to it
SHARED = (*_MASSES, "friction_coefficient")  # what mass and wheels share, and drives on the floor hardly tell apart
TORQUE_CONSTANT = "torque_constant_n_m_a"
_WITHOUT_BLOCKS = 2.5  # intervals of ``SHARED`` are wider by this without blocks; from random robots
Status = Literal["identified", "effective", "weighed", "believed"]
_WIDE = 0.1  # half a 95 % interval of a logarithm beyond which a value is only effective
_WIDE_M = 0.01


class Estimate(NamedTuple):
    """One value, in the unit that its name ends in.

    Attributes:
        name: as in [robot] or [plant.start], or ``torque_constant_n_m_a`` or ``lever_m``.
        value: the estimate. low, high: its interval of 95 %; equal to it where nothing was measured.
        status: "identified"; "effective": right for predictions with the other values, not on its own; "weighed": by
            hand; "believed": the drives do not tell it.
        why: the reason of the status, or the measurement that would change it.
    """

    name: str
    value: float
    low: float
    high: float
    status: Status
    why: str


def estimates(result: Result, weighed_kg: float | None = None) -> tuple[Estimate, ...]:
    """Return the values of the chosen model. ``weighed_kg`` is the mass on a scale: it gives the torque constant.

    Intervals are sandwiches over windows. Those of ``SHARED`` are widened without blocks.
    """
    model, constant = result.chosen, result.torque_constant_n_m_a
    names = [one.name for one in model.parameters]
    values = model.values
    mass, covariance = names.index("mass_kg"), model.solution.covariance
    factor = 1.0 if weighed_kg is None else weighed_kg / values["mass_kg"]
    without = 1.0 if result.blocks is not None else _WITHOUT_BLOCKS
    found = []
    for place, parameter in enumerate(model.parameters):
        if parameter in NUISANCES:
            continue
        name, variance, value = parameter.name, covariance[place, place], values[parameter.name]
        if weighed_kg is not None and name in SCALED:
            value *= factor
            variance += covariance[mass, mass] - 2.0 * covariance[place, mass]
        half = Z_95 * (without if name in SHARED else 1.0) * float(np.sqrt(max(variance, 0.0)))
        if parameter.unit is None:
            low, high, wide = value * np.exp(-half), value * np.exp(half), half > _WIDE
        else:
            half *= parameter.unit
            low, high, wide = value - half, value + half, half > _WIDE_M
        status, why = _judged(name, result, weighed=weighed_kg is not None, wide=bool(wide))
        if status in ("weighed", "believed"):
            low = high = value
        found.append(Estimate(name, float(value), float(low), float(high), status, why))
    half = Z_95 * without * float(np.sqrt(covariance[mass, mass]))
    if weighed_kg is None:
        words = "weigh the robot (--mass-kg): it settles the scale of mass, inertias and friction"
        found.append(Estimate(TORQUE_CONSTANT, constant, constant, constant, "believed", words))
    else:
        kappa = constant * factor
        low, high = kappa * float(np.exp(-half)), kappa * float(np.exp(half))
        status, why = _judged(TORQUE_CONSTANT, result, weighed=True, wide=half > _WIDE)
        found.append(Estimate(TORQUE_CONSTANT, kappa, low, high, status, why))
    return tuple(found)


def _judged(name: str, result: Result, *, weighed: bool, wide: bool) -> tuple[Status, str]:
    """Return the status of a value and its reason."""
    if name == "mass_kg" and weighed:
        return "weighed", "by a scale"
    if name == "wheel_radius_m" and not result.kinematics.scale_known:
        return "believed", "the scale of length needs pose fixes, or hil commission, which measures the radius"
    if name == "grip_coefficient" and result.grip is None:
        return "effective", "squeeze the wheels (--squeeze)"
    if name in SCALED and not weighed:
        return "effective", "over the torque constant; weigh the robot (--mass-kg)"
    if name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", TORQUE_CONSTANT) and result.blocks is None:
        return "effective", "mass and wheels are hardly told apart; spin the wheels on blocks (--blocks)"
    if wide:
        return "effective", "its interval is wide"
    return "identified", ""

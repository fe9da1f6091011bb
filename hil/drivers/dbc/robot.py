"""Checks that a mapping fits the robot, and the conversion of its units for the robot."""

from collections.abc import Callable, Mapping

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.drivers.dbc.file import Signal
from hil.drivers.dbc.mapping import Bound
from hil.drivers.dbc.settings import Plan, Settings
from hil.drivers.dbc.units import SI, Place
from hil.drivers.port import RobotFacts, torques_dropped

_KEY = "device.motors"
_WHOLE = 1e-9

Gain = Callable[[Bound], float]
"""Returns the size of one unit of a signal in the SI unit of its dimension, with its sign."""


def gains(settings: Settings, wheel_radius_m: float, torque_constant_n_m_a: float) -> Gain:
    """Return the gains of a mapping on a robot; the torque constant is that at the wheel."""
    at_wheel: Mapping[Place, tuple[float, float]] = {
        "wheel": (1.0, 1.0),
        "shaft": (1.0, settings.gear_ratio),
        "shaft torque": (settings.gear_ratio, 1.0),
        "ground": (1.0, wheel_radius_m),
        "phase": (torque_constant_n_m_a, 1.0),
    }

    def gain(bound: Bound) -> float:
        multiplier, divisor = at_wheel[bound.unit.place]
        return bound.sign * bound.unit.factor * multiplier / divisor

    return gain


def check_wheels(plan: Plan, robot: RobotFacts) -> None:
    """Raise BadInputError if [device] gives an order or direction of the wheels, which the mapping already gives."""
    names = [WHEEL_NAMES[wheel] for wheel in robot.wheel_of_channel]
    if names != list(WHEEL_NAMES):
        raise BadInputError(
            f"device.wheels = {names}: {_KEY} names the signals of each wheel itself; remove device.wheels, and "
            "give each wheel its signals there"
        )
    if (plan.motion == "twist" or plan.measures_twist) and -1 in robot.sign_of_channel:
        raise BadInputError(
            "device.reversed is not empty: controllers that take or report a body twist know the direction of their "
            "wheels; remove it"
        )


def check_limits(plan: Plan, robot: RobotFacts, gain: Gain) -> None:
    """Raise BadInputError if a commanded signal cannot carry a limit of the robot, or zero."""
    ground_m_s = robot.speed_limit_rad_s * robot.wheel_radius_m
    limits = {
        "speed": ("robot.speed_limit_rad_s", robot.speed_limit_rad_s),
        "torque": ("firmware.torque_limit_n_m", robot.torque_limit_n_m),
        "velocity": ("robot.speed_limit_rad_s", ground_m_s),
        "yaw rate": ("robot.speed_limit_rad_s", ground_m_s / robot.lever_m),
    }
    for bound in (bound for quantity in plan.commands.values() for bound in quantity.bounds):
        name, limit = limits[bound.dimension]
        signal = bound.signal
        _check_zero(signal)
        low, high = sorted(gain(bound) * signal.physical(raw) for raw in (signal.low, signal.high))
        if -limit < low or limit > high:
            raise BadInputError(
                f"{_KEY}.command: {signal} goes from {low:.4g} to {high:.4g} {SI[bound.dimension]}, and {name} "
                f"asks for {limit:.4g} both ways; lower that, or correct unit, scale or gear_ratio"
            )


def _check_zero(signal: Signal) -> None:
    """Raise BadInputError if a signal has no raw number for zero: the nearest one would be a motion."""
    zero = -signal.offset / signal.factor
    if signal.is_float or abs(zero - round(zero)) <= _WHOLE * max(1.0, abs(zero)):
        return
    raise BadInputError(
        f"{_KEY}.command: {signal} goes in steps of {signal.factor:g} from an offset of {signal.offset:g}, and so has "
        f"no zero: the nearest is {signal.physical(round(zero)):.4g}, by which a robot at rest would creep; take a "
        "signal that has one, or correct factor and offset in the DBC"
    )


def watchdog_raw(plan: Plan, robot: RobotFacts, gain: Gain) -> float:
    """Return the raw value that sets the watchdog to the robot's time; 0 if no signal sets it.

    Raises BadInputError if the signal cannot carry it.
    """
    bound = plan.watchdog.set
    if bound is None:
        return 0.0
    signal = bound.signal
    exact = (robot.watchdog_s / gain(bound) - signal.offset) / signal.factor
    raw = exact if signal.is_float else round(exact)
    if not signal.low <= raw <= signal.high:
        raise BadInputError(
            f"{_KEY}.watchdog: {signal} takes {signal.limits()}, and firmware.watchdog_s = {robot.watchdog_s:g} is "
            "outside; change that, or correct unit or scale"
        )
    return raw


def warnings(plan: Plan, robot: RobotFacts) -> tuple[str, ...]:
    """Return the sentences that the user must know before anything moves."""
    found = []
    timeout_s = plan.watchdog.timeout_s
    if timeout_s is None and plan.watchdog.set is None:
        found.append(
            f"{_KEY}.watchdog is empty: nothing that is known stops the wheels when commands end; keep an e-stop that "
            "cuts the motors' power within reach"
        )
    elif timeout_s is not None and timeout_s > robot.watchdog_s:
        found.append(
            f"when commands end the wheels go on for {timeout_s:g} s ({_KEY}.watchdog.timeout_s), longer than the "
            f"{robot.watchdog_s:g} s of firmware.watchdog_s"
        )
    if not plan.armed_when:
        found.append(f"{_KEY}.armed_when is empty: whether the controllers follow commands is not known")
    if plan.motion == "twist":
        found.append(torques_dropped(f"a base of {plan.dbc.name}"))
    elif plan.motion == "speed" and "feedforward" not in plan.commands:
        found.append(torques_dropped(f"{_KEY}.command without feedforward"))
    return tuple(found)

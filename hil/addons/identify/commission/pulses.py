"""Pulses of torque, and what is read from them: a doublet on blocks, a +, -, -, + on the floor, and a small move.

All are open-loop. A pulse grows until something moves, is cut at ``CUT_RAD_S``, and moves the robot by less than
``MOST_M``.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.addons.identify.commission.commission_session import Array, Record, Session
from hil.addons.identify.commission.wirings import response
from hil.core.errors import HilError
from hil.robot.snapshot import Feedback

CUT_RAD_S = 5.0  # wheel speed at which a pulse is cut
MOST_M = 0.1  # way of a wheel's rim at which a pulse is cut
_FIRST_SHARE = 0.02  # of the torque limit, on blocks
_MOST_SHARE = 0.6
_GROWS = 1.5
_UP_S = 0.1
_LEAST_COUNTS = 4
_ALONE = 4.0  # the encoder of a channel must turn this many times further than the others
_PULSE_S = 0.15
_WANTED_RAD_S = 2.5  # of the pulsed wheel, by the believed mass
_LEAST_RAD_S = 2.0  # below it friction counts too much
_MOVE_M_S2 = 0.5
_MOVE_S = 0.25
_MOVE_M = 0.01
_LEAST_SHARE = 0.2  # of the first torque: with less the wheels slip, or the robot is far lighter than believed
_SPINS_PART = 0.12
_LATE = 12  # periods that feedback may be late
_DEAD_SHARE = 0.2  # of the expected current


class StepError(HilError):
    """A step of commissioning has failed; the message is one sentence for the user."""

    exit_code = 1


class Turned(NamedTuple):
    """The response of a channel on blocks: the encoder input that moved, its sign against the motor, and current.

    ``current_part`` is measured over expected; NaN where no current is measured.
    """

    input: int
    sign: int
    torque_n_m: float
    current_part: float


def turn_channel(session: Session, channel: int) -> Turned:
    """Turn the motor of a channel back and forth on blocks, harder each time, until an encoder has seen it.

    Each time it is driven one way and then, until it stands, the other. A wheel that no encoder sees is driven as long
    back as forth, so it cannot run away. Raises StepError when no wheel, or more than one, turns.
    """
    robot, firmware = session.scenario.robot, session.scenario.firmware
    limit = session.torque_limit_n_m
    least_rad = _LEAST_COUNTS * math.tau / firmware.counts_per_revolution
    cut_rad_s = min(CUT_RAD_S, robot.speed_limit_rad_s)
    torque = _FIRST_SHARE * limit
    while True:
        up_s = min(_UP_S, 0.5 * robot.speed_limit_rad_s * max(robot.wheel_inertia_kg_m2, 1e-4) / torque)
        record = _doublet(session, channel, torque, max(up_s, 3 * session.period_s), cut_rad_s)
        way = np.abs(record.turned_rad).max(axis=0)
        seen = int(np.argmax(way))
        if way[seen] >= least_rad:
            break
        if torque >= _MOST_SHARE * limit:
            raise StepError(_nothing_turned(session, channel, record, torque))
        torque = min(_GROWS * torque, _MOST_SHARE * limit)
    others = np.delete(way, seen)
    if others.max() * _ALONE > way[seen]:
        second = int(np.argsort(way)[-2])
        raise StepError(
            f"output {channel + 1} turned the wheels of the encoders {seen + 1} and {second + 1}: only one may turn; "
            "look whether all four wheels are off the ground, and nothing else turns them"
        )
    peak = record.turned_rad[int(np.argmax(np.abs(record.turned_rad[:, seen]))), seen]
    return Turned(seen, 1 if peak > 0 else -1, torque, _current_part(session, channel, record, torque))


def _doublet(session: Session, channel: int, torque: float, up_s: float, cut_rad_s: float) -> Record:
    first: tuple[int, ...] | None = None
    braked = False

    def command(t_s: float, feedback: Feedback) -> Sequence[float]:
        nonlocal braked, first
        first = first or feedback.encoder_count
        values = [0.0] * 4
        if t_s < up_s:
            values[channel] = torque
        elif t_s < 2 * up_s + session.delay_s and not braked:
            is_still = max(map(abs, feedback.speed_rad_s)) < 0.1
            braked = t_s > up_s + session.delay_s and is_still and feedback.encoder_count != first
            values[channel] = 0.0 if braked or t_s >= 2 * up_s else -torque
        return values

    return session.drive(command, 2 * up_s + 0.1, cut_rad_s=cut_rad_s)


def _current_part(session: Session, channel: int, record: Record, torque: float) -> float:
    expected = torque / session.scenario.firmware.torque_constant_n_m_a
    measured = record.current_a[:, channel]
    return float(np.nanmax(np.abs(measured)) / expected) if np.isfinite(measured).any() else math.nan


def is_dead(current_part: float) -> bool:
    """Whether a current sensor showed almost no current while its motor turned a wheel."""
    return current_part < _DEAD_SHARE


def _nothing_turned(session: Session, channel: int, record: Record, torque: float) -> str:
    name, part = f"output {channel + 1}", _current_part(session, channel, record, torque)
    if math.isnan(part):
        return (
            f"{name} turned nothing with {torque:.2g} N·m: its wheel is blocked, or its motor or its encoder is not "
            "connected"
        )
    if is_dead(part):
        return f"{name} draws no current and turns nothing: look at the cable of its motor"
    return f"{name} draws its current, but no encoder turns: its wheel is blocked, or its encoder is not connected"


class Shaken(NamedTuple):
    """What pulses on the floor did, for one newton metre: by the IMU's axes, its yaw rate, and the encoders' inputs."""

    acceleration_m_s2: Array
    yaw_rad_s2: float
    wheels_rad_s2: Array


def shake(session: Session, proportions: Sequence[float], expected_rad_s2: float) -> Shaken:
    """Give the channels a torque +, -, -, + in these proportions, and fit what followed.

    ``expected_rad_s2`` is what one newton metre should do to the driven wheels. The torque grows by half while the
    wheels hardly turn, and is halved when they turn too fast. Raises StepError when neither helps.
    """
    robot = session.scenario.robot
    limit = session.torque_limit_n_m
    cut_rad_s = min(CUT_RAD_S, robot.speed_limit_rad_s)
    torque = min(_WANTED_RAD_S / _PULSE_S / expected_rad_s2, limit)
    first = torque
    driven = [i for i, part in enumerate(proportions) if part]
    was_cut = False
    for _ in range(12):

        def command(t_s: float, _: Feedback, torque: float = torque) -> Sequence[float]:
            return [torque * part * _sign_at(t_s) for part in proportions]

        record = session.drive(command, 4 * _PULSE_S + 0.1, cut_rad_s=cut_rad_s, cut_rad=MOST_M / robot.wheel_radius_m)
        if record.was_cut:
            was_cut = True
            torque *= 0.5
            if torque < _LEAST_SHARE * first:
                break
        else:
            found = _fitted(session, record, torque, driven)
            inputs = [session.encoders.input_of(channel) for channel in driven]
            slowest = float(np.abs(record.speed_rad_s).max(axis=0)[inputs].min())
            is_enough = slowest >= _LEAST_RAD_S or (slowest > 0.1 * _LEAST_RAD_S and (was_cut or torque >= limit))
            if is_enough and not _spins(found.wheels_rad_s2, inputs):
                return found
            if was_cut or torque >= limit:
                break
            torque = min(_GROWS * torque, limit)
        session.rest()
    if was_cut:
        raise StepError(
            "the wheels slip or spin before the robot moves, or one does not turn: choose a floor with more grip, and "
            "look whether all four wheels stand on it, each is driven and counted, and robot.mass_kg is right"
        )
    raise StepError(
        f"the wheels do not turn with {torque:.2g} N·m on the floor, the limit: look at robot.torque_limit_n_m, "
        "robot.mass_kg, and what brakes them"
    )


def _spins(wheels_rad_s2: Array, driven: Sequence[int]) -> bool:
    """Return whether a wheel that is driven alone turns without the robot; else another turns a third as fast."""
    if len(driven) > 1:
        return False
    others = float(np.abs(np.delete(wheels_rad_s2, driven)).max())
    return others < _SPINS_PART * abs(float(wheels_rad_s2[driven[0]]))


def _sign_at(t_s: float) -> float:
    return (1.0, -1.0, -1.0, 1.0, 0.0)[min(int(t_s / _PULSE_S + 1e-6), 4)]


def _fitted(session: Session, record: Record, torque: float, driven: Sequence[int]) -> Shaken:
    """Fit angles, yaw rate and accelerations by what pulses do to a mass, as late as fits the driven wheels best."""
    dt = session.period_s
    push = np.array([_sign_at(t_s) for t_s in record.t_s])
    speed = (np.cumsum(push) - 0.5 * push) * dt
    angle = (np.cumsum(speed)) * dt
    own = record.turned_rad[:, [session.encoders.input_of(channel) for channel in driven]].sum(axis=1)
    late = max(range(_LATE), key=lambda lag: _fit(_late(angle, lag), own, drifts=True)[1])
    wheels = [_fit(_late(angle, late), record.turned_rad[:, i], drifts=True)[0] for i in range(4)]
    acceleration = [_fit(_late(push, late), record.acceleration_m_s2[:, i])[0] for i in range(3)]
    yaw = _fit(_late(speed, late), record.yaw_rate_rad_s)[0]
    return Shaken(np.array(acceleration) / torque, yaw / torque, np.array(wheels) / torque)


def _late(values: Array, periods: int) -> Array:
    return np.concatenate([np.zeros(periods), values[: len(values) - periods]])


def _fit(shape: Array, measured: Array, *, drifts: bool = False) -> tuple[float, float]:
    """Fit measurements by a shape, an offset and a drift; return the shape's factor and the share it explains."""
    if not np.isfinite(measured).all():
        return math.nan, 0.0
    one = np.ones_like(shape)
    base = np.column_stack([shape, one, np.arange(len(shape))] if drifts else [shape, one])
    found, *_ = np.linalg.lstsq(base, measured, rcond=None)
    left = measured - base @ found
    whole = measured - measured.mean()
    return float(found[0]), 1.0 - float(left @ left) / max(float(whole @ whole), 1e-30)


def expected_rad_s2(session: Session, by_wheel: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> float:
    """Return what one newton metre, in these proportions on FL, FR, RR and RL, does to FL by the believed mass."""
    robot = session.scenario.robot
    _, rims = response(robot, "x")
    return abs(float(np.array(by_wheel) @ rims[:, 0])) / robot.wheel_radius_m


def move(session: Session, torques: Sequence[float]) -> float:
    """Move the robot a few centimetres by torques in these proportions, and stop it; return the way of the rims [m].

    Raises StepError when it does not move.
    """
    robot = session.scenario.robot
    limit = session.torque_limit_n_m
    torque = min(_MOVE_M_S2 * robot.wheel_radius_m * robot.effective_mass_kg / 4, limit)
    while True:
        was_there = False

        def command(t_s: float, feedback: Feedback, torque: float = torque) -> Sequence[float]:
            nonlocal was_there
            speeds = session.encoders.of_motors(feedback.speed_rad_s)
            along = sum(speed * part for speed, part in zip(speeds, torques, strict=True)) / 4
            if t_s < _MOVE_S:
                return [torque * part for part in torques]
            was_there = was_there or along < 0.1
            return [0.0 if was_there else -torque * part for part in torques]

        record = session.drive(command, 3 * _MOVE_S, cut_rad_s=CUT_RAD_S, cut_rad=0.7 * MOST_M / robot.wheel_radius_m)
        session.rest()
        way_m = float(np.abs(record.turned_rad[-1]).mean()) * robot.wheel_radius_m
        if way_m >= _MOVE_M:
            return way_m
        if record.was_cut or torque >= limit:
            raise StepError(f"the robot does not move with {torque:.2g} N·m on each wheel: look at what brakes it")
        torque = min(_GROWS * torque, limit)

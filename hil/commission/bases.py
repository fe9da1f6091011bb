"""Commissioning of boards that take velocities of the body and close the loops of their wheels themselves.

Nothing here can drive one wheel, or without a loop: each motion has a small speed and ends after a limited time, and a
wheel that is faster than it may be ends it at once. What needs torque is not identifiable.
"""

from collections.abc import Callable, Sequence

import numpy as np

from hil.commission.findings import Findings
from hil.commission.person import Person
from hil.commission.pulses import CUT_RAD_S, StepError
from hil.commission.record import Encoders, Record
from hil.commission.session import Session
from hil.commission.wirings import DIRECTIONS, PLAIN, TRIED, Direction, pattern
from hil.core.types import WHEEL_NAMES

_RIM_M_S = 0.08
_LASTS_S = 0.8
_FOLLOWS = 0.3  # of the commanded speed must a wheel reach


def blocks(session: Session, person: Person, findings: Findings, say: Callable[[str], None]) -> None:
    """Turn all four wheels slowly forward on blocks. Raises StepError when one does not follow, or runs away."""
    person.confirm(
        "blocks",
        "blocks: this board closes the loops of its wheels itself. Put the robot on blocks, all four wheels free. "
        f"They turn forward at {_RIM_M_S:g} m/s for {_LASTS_S:g} s; the drives are switched off if one is faster than "
        "5 rad/s.",
    )
    session.lift(lifted=True)
    session.encoders = Encoders((0, 1, 2, 3))
    record = _driven(session, "forward")
    wanted = _RIM_M_S / session.scenario.robot.wheel_radius_m
    reached = record.speed_rad_s[len(record.t_s) // 2 :].mean(axis=0)
    for wheel, speed in zip(WHEEL_NAMES, reached, strict=True):
        if speed < _FOLLOWS * wanted:
            raise StepError(
                f"the board says that {wheel} turns at {speed:.1f} rad/s where {wanted:.1f} was commanded: look at "
                "its motor, its encoder, and what brakes it"
            )
    if person.choose("all_forward", "Did all four wheels turn forward?", ("yes", "no")) == "no":
        raise StepError("a wheel turned backward, or none: connect the motors as the manual of the board says")
    findings.saw(session.encoders, "fl", "forward")
    say("wheels, motors and encoders agree with the board; torque, current and friction are not identifiable")


def floor(session: Session, person: Person, findings: Findings, say: Callable[[str], None]) -> None:
    """Drive a few centimetres forward, to the left and round; the person says where it went."""
    person.confirm(
        "floor", "floor: put the robot on a level floor, 0.5 m free on each side; it moves three times, slowly."
    )
    session.lift(lifted=False)
    turn = 0.0
    for direction in TRIED:
        key = direction.replace(" ", "_")
        person.confirm(f"move_{key}", "Look where the robot goes.")
        record = _driven(session, direction)
        went = person.choose(f"moved_{key}", "Where did it go?", DIRECTIONS)
        if went != direction:
            raise StepError(
                f"told to go {direction}, the robot went {went}: a motor is on another output of the board, or the "
                "wheels form an O; connect them as the manual of the board says"
            )
        if direction == "turned left":
            turn = float(np.nanmean(record.yaw_rate_rad_s)) if np.isfinite(record.yaw_rate_rad_s).any() else 0.0
    findings.decided(PLAIN, None)
    if turn:
        imu = ("x", "y", "z") if turn > 0 else ("x", "-y", "-z")
        findings.values["device.imu"] = imu
        say(
            f"the gyro's axis points {'up' if turn > 0 else 'down'}; where the accelerometer points is not identifiable"
        )
    for name in ("device.wheels", "device.reversed"):
        findings.values.pop(name)  # the board knows them


def check(say: Callable[[str], None]) -> None:
    """Say that the three motions were the check."""
    say("check: done by the three motions")


def _driven(session: Session, direction: Direction) -> Record:
    radius_m = session.scenario.robot.wheel_radius_m
    speeds = [_RIM_M_S / radius_m * part for part in pattern(PLAIN, direction)]

    def command(t_s: float, _: object) -> Sequence[float]:
        return speeds if t_s < _LASTS_S else (0.0,) * 4

    with session.armed():
        record = session.drive(command, _LASTS_S + 0.2, cut_rad_s=CUT_RAD_S)
        if record.was_cut:
            raise StepError(
                "a wheel ran away: its motor or its encoder is connected the wrong way round, so that the board's own "
                "loop drives it ever faster; the drives are off"
            )
    return record

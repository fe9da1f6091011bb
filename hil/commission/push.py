"""The last step of commissioning: the motors are off, a person pushes the robot along a tape, the encoders count."""

import math
from collections.abc import Callable

from hil.commission.findings import Findings, plausible_counts
from hil.commission.hand import push_by_hand
from hil.commission.person import Person
from hil.commission.pulses import StepError
from hil.commission.session import Session
from hil.core.kinematics import body_twist
from hil.core.types import CommandMode
from hil.scenario.commission import UNUSED

_MOST_SCALE = 0.15


def push(session: Session, person: Person, findings: Findings, say: Callable[[str], None]) -> None:
    """Find counts, radius, lever and the scale of the way to the left; each may be left out.

    Raises StepError where the wheels and the tape do not go together.
    """
    robot = session.scenario.robot
    firmware = session.scenario.firmware
    forward = _pushed(session, person, findings, "forward", 0)
    if forward is None:
        say("left out: the wheel radius and the counts stay as they were believed")
        return
    way_m, true_m = forward
    counts = plausible_counts(firmware.counts_per_revolution, way_m / true_m)
    if counts is None:
        raise StepError(
            f"by the wheels the robot went {way_m:.3f} m, by the tape {true_m:.3f} m: no usual encoder or gear "
            f"explains a factor of {way_m / true_m:.2f}; look at robot.wheel_radius_m, counts_per_revolution and "
            "the gear ratio"
        )
    factor = counts / firmware.counts_per_revolution
    scale = true_m * factor / way_m
    values: dict[str, object] = {"robot.wheel_radius_m": _rounded(robot.wheel_radius_m * scale)}
    if factor != 1.0:
        values["firmware.counts_per_revolution"] = counts
    say(f"wheel radius {values['robot.wheel_radius_m']} m, {counts} counts a turn of a wheel")
    if (left := _pushed(session, person, findings, "left", 1)) is not None:
        lateral = left[1] * factor / left[0] / scale
        findings.lateral(_rounded(lateral))
        say(f"to the left the robot goes {lateral:.3f} times as far as its wheels say (commission.lateral_scale):")
        say(f"  {UNUSED}")
    if (turn := _pushed(session, person, findings, "turns", 2)) is not None:
        lever = turn[0] * scale / factor / (turn[1] * math.tau)
        if abs(lever - 1.0) > _MOST_SCALE:
            raise StepError(
                f"the robot turned {turn[1]:.3f} times and its wheels say "
                f"{turn[0] * scale / factor / math.tau:.3f}: look at robot.half_length_m and robot.half_width_m"
            )
        values |= {
            "robot.half_length_m": _rounded(robot.half_length_m * lever),
            "robot.half_width_m": _rounded(robot.half_width_m * lever),
        }
        say(f"half length and half width together {robot.lever_m * lever:.4f} m")
    findings.values |= values


def _pushed(session: Session, person: Person, findings: Findings, what: str, axis: int) -> tuple[float, float] | None:
    """Let the person push the robot; return the way by the wheels and by the tape, or None where it is left out."""
    candidate = findings.candidate
    assert candidate is not None
    ways = {
        "forward": "push the robot 0.5 to 1 m straight forward along the tape",
        "left": "push it 0.5 to 1 m to its left, without turning it",
        "turns": "turn it to the left by hand, one whole turn or a few",
    }
    before = session.angles()
    sentence = f"push: the motors are off. First mark where the robot stands; then {ways[what]}."
    session.listen_while(lambda: person.confirm(f"push_{what}", sentence))
    push_by_hand(session, axis)
    by_input = [now - then for now, then in zip(session.angles(), before, strict=True)]
    by_motor = session.encoders.of_motors(by_input)
    wheels = [0.0] * 4
    for turned, wheel, sign in zip(by_motor, candidate.wheels, candidate.signs, strict=True):
        wheels[wheel] = sign * turned
    robot = session.scenario.robot
    fl, fr, rr, rl = wheels
    way = abs(body_twist((fl, fr, rr, rl), robot.wheel_radius_m, robot.lever_m)[axis])
    unit = "How many turns?" if what == "turns" else "How far by the tape, in m?"
    true = person.measure(f"pushed_{what}" if what == "turns" else f"pushed_{what}_m", unit)
    if true is None:
        return None
    if way < 0.05 and session.scenario.controller.mode is CommandMode.SPEED:
        return None  # a board that brakes wheels, or does not count them, while it is not driven
    if way < 0.05:
        raise StepError("the encoders hardly saw the robot move; were the wheels on the floor?")
    return way, true


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")

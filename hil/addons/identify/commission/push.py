"""The last step of commissioning: the motors are off, a person pushes the robot along a tape, the encoders count."""

import math
from collections.abc import Callable
from dataclasses import replace

from hil.addons.identify.commission.commission_findings import Findings
from hil.addons.identify.commission.commission_session import Session
from hil.addons.identify.commission.person import Person
from hil.addons.identify.commission.pulses import StepError
from hil.core.kinematics import body_twist
from hil.core.model import GRAVITY_M_S2
from hil.robot.driver import clamp

_MOST_SCALE = 0.15

_PUSHES = ("push.force_x_n", "push.force_y_n", "push.moment_n_m")
_HAND_M, _HAND_RAD, _HAND_SPEED, _HAND_STEPS = 0.6, math.tau, 0.4, 1200


def push_by_hand(session: Session, axis: int) -> None:
    """Push a virtual robot in this process forward, to the left or round (axis 0 to 2), as a hand would.

    A real robot is pushed by the person. Raises BadInputError for a plant that cannot be pushed.
    """
    local, truth = session.bench.local, session.bench.truth
    if local is None or truth is None:
        return
    robot = session.scenario.robot
    start = truth.poll()
    assert start is not None
    begin, wanted, force = start.pose, _HAND_M if axis < 2 else _HAND_RAD, 0.0
    c, s = math.cos(begin.heading_rad), math.sin(begin.heading_rad)
    along = ((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0))[axis]
    heavy = (robot.effective_mass_kg, robot.effective_mass_kg, robot.effective_inertia_kg_m2)[axis]
    arm_m = 1.0 if axis < 2 else robot.lever_m
    for _ in range(_HAND_STEPS):
        fix = truth.poll()
        assert fix is not None
        way = sum(part * (now - then) for part, now, then in zip(along, fix.pose, begin, strict=True))
        speed = sum(part * now for part, now in zip(along, fix.twist, strict=True))
        if way >= wanted and abs(speed) < 0.02:
            break
        target = _HAND_SPEED if way < wanted else 0.0
        # A hand pushes harder until it moves: the friction is not known.
        force += heavy * (target - speed) * (1.0 if target > speed else 0.0)
        push = heavy * (target - speed) * 4.0 + (force if target else 0.0)
        limit = robot.mass_kg * GRAVITY_M_S2 * arm_m * 0.3
        push = clamp(push, limit)
        local.set_variables(dict(zip(_PUSHES, (push * part for part in along), strict=True)))
        session.listen(0.05)
    local.set_variables(dict.fromkeys(_PUSHES, 0.0))
    session.listen(1.0)


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
    counts = _plausible_counts(firmware.counts_per_revolution, way_m / true_m)
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
        findings.table = replace(findings.table, lateral_scale=_rounded(lateral))
        say(f"to the left the robot goes {lateral:.3f} times as far as its wheels say (commission.lateral_scale):")
        say("  nothing uses it yet: odometry and laws believe the wheels")
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
    if way < 0.05:
        raise StepError("the encoders hardly saw the robot move; were the wheels on the floor?")
    return way, true


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def _plausible_counts(believed: int, ratio: float) -> int | None:
    """Return the counts of a turn nearest to ``ratio`` times those believed, of their doubles and halves.

    Decoding of one, two or four edges and usual gears differ by such factors. None where none is within 8 %.
    """
    power = round(math.log2(ratio))
    if abs(power) > 4 or abs(ratio / 2.0**power - 1.0) > 0.08:
        return None
    counts = believed * 2.0**power
    return int(counts) if counts == int(counts) and 4 <= counts <= 32768 else None

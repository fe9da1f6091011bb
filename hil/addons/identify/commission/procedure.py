"""The steps of commissioning, in order. Each is announced, confirmed, small, and kept once it is done."""

import math
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from hil.addons.identify.commission.commission_findings import STEPS, Findings
from hil.addons.identify.commission.commission_session import Array, Encoders, Session
from hil.addons.identify.commission.person import Person
from hil.addons.identify.commission.pulses import (
    StepError,
    Turned,
    expected_rad_s2,
    is_dead,
    move,
    shake,
    turn_channel,
)
from hil.addons.identify.commission.push import push
from hil.addons.identify.commission.wirings import (
    DIRECTIONS,
    FITS,
    PLAIN,
    TRIED,
    Decision,
    Evidence,
    MotionSeen,
    Responses,
    decide,
    laid_upright,
    named_direction,
    pattern,
    telling,
    turned_axes,
    yaw_lever_m,
)
from hil.core.errors import apart
from hil.core.model import GRAVITY_M_S2
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import ImuMount
from hil.scenario.values import Wheel

_ROLLS_RAD = 0.05
_SLOPE_M_S2 = 0.35
_MOST_QUESTIONS = 3


class Procedure:
    """Commissions a robot whose session is connected.

    ``say`` gets each sentence for the user, ``save`` each finished step. ``run`` raises StepError for a failed step,
    and DeviceError or LinkError for a lost robot. Finished steps stay saved.
    """

    def __init__(
        self,
        session: Session,
        person: Person,
        findings: Findings,
        say: Callable[[str], None],
        save: Callable[[str], None],
    ) -> None:
        self._session, self._person, self._findings = session, person, findings
        self._say, self._save = say, save
        self._model = session.scenario.robot
        self._upright: tuple[str, str, str] | None = None
        self._level = np.zeros(2)
        session.encoders = findings.encoders

    def run(self) -> None:
        """Do the steps that are left."""
        self._look_at_rest()
        for name, step in zip(STEPS, (self._blocks, self._floor, self._check, self._push), strict=True):
            if name in self._findings.table.steps:
                self._say(f"{name}: done before")
                continue
            if self._findings.table.todo:
                return
            step()
            self._save(name)

    # At rest

    def _look_at_rest(self) -> None:
        self._say("rest: nothing moves, the sensors are read for a second")
        record = self._session.listen(1.0)
        if np.abs(record.turned_rad).max() > _ROLLS_RAD:
            raise StepError(
                "the wheels turn although nothing drives them: put the robot where the floor does not slope, and hold "
                "it still"
            )
        gravity = record.acceleration_m_s2.mean(axis=0)
        if np.isfinite(gravity).all():
            self._upright = laid_upright(tuple(gravity))
            if self._upright is None:
                raise StepError(
                    f"the accelerometer shows ({gravity[0]:.1f}, {gravity[1]:.1f}, {gravity[2]:.1f}) m/s²: none of its "
                    "axes is upright, so that it cannot be used; mount it square to the robot, or level the robot"
                )
            self._level = self._in_level(gravity)
            if "z" not in self._upright[2]:
                self._say("the third axis of the IMU is not upright: there is no yaw rate")
        else:
            self._say("no accelerometer: more questions will be asked")

    def _in_level(self, vector: Array) -> Array:
        x, y, _ = ImuMount(self._upright or ("x", "y", "z")).to_body((vector[0], vector[1], vector[2]))
        return np.array([x, y])

    # On blocks

    def _blocks(self) -> None:
        session = self._session
        self._person.confirm(
            "blocks",
            "blocks: put the robot on blocks, all four wheels off the ground and free. Each motor output is driven "
            "back and forth by open-loop torque, harder until its wheel has moved a little; it is cut at 5 rad/s. "
            "Look at the wheel that moves first.",
        )
        session.lift(lifted=True)
        encoders = session.encoders = Encoders()
        self._turn(0)
        choices = (*WHEEL_NAMES, "again")
        while (answer := self._person.choose("first_wheel", "Which wheel moved?", choices)) == "again":
            self._turn(0)
        ways = ("forward", "backward", "again")
        question = "Which way did it turn first: forward, as when the robot drives forward, or backward?"
        while (way := self._person.choose("first_way", question, ways)) == "again":
            self._turn(0)
        self._person.confirm("blocks_others", "Now the other three outputs, one after the other.")
        for channel in (1, 2, 3):
            self._turn(channel)
        places = [encoders.input_of(channel) for channel in range(4)]
        if sorted(places) != [0, 1, 2, 3]:
            raise StepError(
                f"the outputs 1 to 4 turn the encoders {', '.join(str(place + 1) for place in places)}: expected each "
                "once; look whether two motors are connected to one wheel"
            )
        self._findings.saw(encoders, cast(Wheel, answer), "forward" if way == "forward" else "backward")

    def _turn(self, channel: int) -> Turned:
        session = self._session
        with session.armed():
            turned = turn_channel(session, channel)
            session.encoders.inputs[channel], session.encoders.signs[channel] = turned.input, turned.sign
        against = "" if turned.sign > 0 else ", against the motor"
        self._say(f"output {channel + 1}: encoder {turned.input + 1} moved{against}, at {turned.torque_n_m:.2g} N·m")
        if is_dead(turned.current_part):
            raise StepError(
                f"output {channel + 1} turns its wheel, but its current sensor shows nothing: it is dead, or not "
                "connected"
            )
        return turned

    # On the floor

    def _floor(self) -> None:
        session, person = self._session, self._person
        person.confirm(
            "floor",
            "floor: put the robot on a level floor, 0.5 m free on each side. Each output gets pulses of torque of "
            "0.15 s, there and back: the robot twitches by a few centimetres at most.",
        )
        session.lift(lifted=False)
        self._look_for_slope()
        expected = expected_rad_s2(session)
        acceleration, yaw, wheels = np.zeros((4, 2)), np.zeros(4), np.zeros((4, 4))
        for channel in range(4):
            with session.armed():
                shaken = shake(session, [float(i == channel) for i in range(4)], expected)
            acceleration[channel] = self._in_level(shaken.acceleration_m_s2)
            yaw[channel] = ImuMount(self._upright or ("x", "y", "z")).yaw_rate(shaken.yaw_rad_s2)
            wheels[channel] = session.encoders.of_motors(list(shaken.wheels_rad_s2))
            self._say(f"output {channel + 1}: the robot answered")
        decision = self._decide(Responses(acceleration, yaw, wheels))
        best = decision.best
        imu = None if self._upright is None else turned_axes(self._upright, best.quarter_turns)
        self._findings.decided(best, imu)
        mounted = ", ".join(imu) if imu else "none"
        self._say(f"wheels of the outputs: {best.words}; IMU: {mounted} (score {decision.score:.3f})")

    def _look_for_slope(self) -> None:
        session = self._session
        record = session.listen(0.5)
        if self._upright is not None:
            tilt = self._in_level(record.acceleration_m_s2.mean(axis=0)) - self._level
            if np.hypot(*tilt) > _SLOPE_M_S2:
                degrees = math.degrees(math.asin(min(1.0, np.hypot(*tilt) / GRAVITY_M_S2)))
                raise StepError(
                    f"the floor slopes by {degrees:.1f} degrees against where the robot stood: choose a level one"
                )
        with session.armed():
            record = session.drive(lambda _t, _f: (0.0,) * 4, 0.4, cut_rad_s=5.0)
            if np.abs(record.turned_rad).max() > _ROLLS_RAD:
                raise StepError("the robot rolls by itself: the floor slopes; choose a level one")

    def _decide(self, seen: Responses) -> Decision:
        told = self._findings.told
        assert told is not None
        evidence: list[Evidence] = [told]
        decision = self._decided(seen, evidence)
        for number in range(1, 1 + _MOST_QUESTIONS):
            torques = None if decision.is_clear else telling(self._model, decision)
            if torques is None:
                break
            self._person.confirm(
                f"move_{number}",
                "The sensors alone cannot tell. The robot will move by a few centimetres; look where to.",
            )
            with self._session.armed():
                move(self._session, torques)
            answer = self._person.choose(f"moved_{number}", "Where did it move?", DIRECTIONS)
            evidence.append(MotionSeen(torques, DIRECTIONS[DIRECTIONS.index(answer)]))
            decision = self._decided(seen, evidence)
        if decision.is_clear or (decision.fits and decision.rollers == "o"):
            return decision
        if not decision.fits:
            if self._decided(seen._replace(yaw_rad_s2=-seen.yaw_rad_s2), evidence).fits:
                raise StepError(
                    "the gyro turns against what accelerometer and encoders saw: it is not mounted as the "
                    "accelerometer is, or the wheel that moved first was the one diagonally opposite to that answered"
                )
            raise StepError(
                f"no wiring explains what the sensors saw (the best scores {apart(decision.score, FITS)}, expected at "
                f"least {FITS:g}): look whether the robot stands free, whether all four wheels are Mecanum wheels, and "
                "whether [robot] has its mass and size"
            )
        raise StepError(
            f"the wiring cannot be decided: the wheels of the outputs are {decision.best.words}, or "
            f"{decision.rivals[0].words}; correct mass, inertia and size in [robot]"
        )

    def _decided(self, seen: Responses, evidence: Sequence[Evidence]) -> Decision:
        try:
            return decide(self._model, seen, evidence)
        except ValueError as error:
            raise StepError(f"{error}: answer again, with the same command") from error

    # All four wheels

    def _check(self) -> None:
        session, candidate = self._session, self._findings.candidate
        assert candidate is not None
        self._person.confirm(
            "check",
            "check: the robot twitches forward, then to the left, then turns to the left, with the wiring that was "
            "found.",
        )
        session.lift(lifted=False)
        imu = ImuMount(self._findings.imu)
        for direction in TRIED:
            torques = pattern(candidate, direction)
            with session.armed():
                shaken = shake(session, torques, expected_rad_s2(session, pattern(PLAIN, direction)))
            turned = session.encoders.of_motors(list(shaken.wheels_rad_s2))
            if not all(speed * torque > 0.0 for speed, torque in zip(turned, torques, strict=True)):
                raise StepError(f"driven {direction}, not every wheel turned as it should: commission the robot anew")
            saw = self._direction_by_imu(imu, shaken.acceleration_m_s2, shaken.yaw_rad_s2)
            if saw is not None and saw != direction:
                raise StepError(f"driven {direction}, the IMU saw the robot go {saw}: commission the robot anew")
            self._say(f"{direction}: all wheels turned as they should{'' if saw is None else ', and the IMU agrees'}")

    def _direction_by_imu(self, imu: ImuMount, acceleration: Array, yaw: float) -> str | None:
        x, y, _ = imu.to_body((acceleration[0], acceleration[1], acceleration[2]))
        turn = imu.yaw_rate(yaw) * yaw_lever_m(self._model)
        return named_direction((x, y, turn)) if np.isfinite((x, y, turn)).all() else None

    def _push(self) -> None:
        push(self._session, self._person, self._findings, self._say)

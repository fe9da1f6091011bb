"""The limits of time of a served robot's phases, and what is said when one is over; in lockstep."""

from typing import Any

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service.messages import Phase
from hil.core.errors import BadInputError
from hil.scenario.laws import Laws
from tests.support.pilot_bench import PilotBench, armed_pilot


def shows(bench: PilotBench, state: RobotState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the robot's feedback have this state from now on, whatever the robot does."""
    device = bench.bench.device
    poll = device.poll

    def polled() -> Any:
        feedback = poll()
        return feedback and feedback._replace(state=state)

    monkeypatch.setattr(device, "poll", polled)


def ticks_until(bench: PilotBench, done: Any) -> int:
    """Return how many ticks of 10 ms pass until it is done."""
    before = len(bench.rows)
    while not done():
        bench.run(0.01)
        assert len(bench.rows) - before < 1000
    return len(bench.rows) - before


def test_a_robot_that_does_not_arm_in_4_s_is_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    with PilotBench() as bench:
        bench.run_until(Phase.DISARMED)
        monkeypatch.setattr(bench.bench.device, "armed", lambda: False)
        bench.pilot.arm()
        assert ticks_until(bench, lambda: bench.pilot.phase is not Phase.ARMING) == 401
        assert bench.pilot.phase is Phase.STOPPING
        assert str(bench.pilot.why).startswith("the robot did not become ACTIVE: it is IDLE; ")
        bench.run_until(Phase.DISARMED)
        with pytest.raises(BadInputError, match=r"^the robot is disarmed; there is nothing to clear$"):
            bench.pilot.clear()


def test_a_robot_that_does_not_come_to_rest_in_5_s_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with armed_pilot() as bench:
        shows(bench, RobotState.STOPPING, monkeypatch)
        bench.pilot.disarm()
        assert ticks_until(bench, lambda: bench.pilot.why) == 501
        assert bench.pilot.why == "the robot did not come to rest within 5 s: it is STOPPING"
        assert bench.pilot.phase is Phase.STOPPING


def test_a_robot_that_stays_latched_for_2_s_after_a_clear_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with armed_pilot() as bench:
        bench.pilot.estop()
        assert bench.pilot.why == "an e-stop was asked for"
        shows(bench, RobotState.ESTOP, monkeypatch)
        bench.run(0.5)
        bench.pilot.clear()
        assert ticks_until(bench, lambda: "refused" in str(bench.pilot.why)) == 201
        assert str(bench.pilot.why).startswith("clearing was refused: the robot did not become ACTIVE: it is ")
        assert bench.pilot.phase is Phase.ESTOP


def test_a_robot_that_another_host_has_armed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with PilotBench() as bench:
        bench.run_until(Phase.DISARMED)
        shows(bench, RobotState.ARMED, monkeypatch)
        bench.run(0.02)
        assert bench.pilot.why == "another host has armed the robot; stop that host first"
        assert bench.pilot.phase is Phase.DISARMED


def test_an_e_stop_of_a_robot_that_is_away_says_what_becomes_of_it() -> None:
    with PilotBench() as bench:
        before = bench.pilot.motion_requests
        bench.pilot.estop()
        assert bench.pilot.motion_requests == before + 1
        assert str(bench.pilot.why).startswith(
            "an e-stop was asked for; the robot is away: it is sent now without an answer, and again as soon"
        )


class Noting:
    """A law that notes the times that it is told to have passed, None for a reset."""

    def __init__(self, law: Any) -> None:
        self._law = law
        self.gains = law.gains
        self.told: list[float | None] = []

    def reset(self, state: Any, reference: Any) -> None:
        self.told.append(None)
        self._law.reset(state, reference)

    def update(self, reference: Any, state: Any, applied: Any, dt_s: float) -> Any:
        self.told.append(dt_s)
        return self._law.update(reference, state, applied, dt_s)


def test_a_law_is_told_how_long_ago_it_was_called_and_begins_anew_in_another_s_place() -> None:
    with armed_pilot() as bench:
        law = Noting(bench.made.laws.controller)
        bench.pilot.use(Laws(law))
        bench.run(0.02)
        bench.stand_still(0.02)
        bench.run(0.02)
        assert law.told == [None, *(pytest.approx(dt_s) for dt_s in (0.01, 0.01, 0.03, 0.01))]
        bench.pilot.use(Laws(law))
        law.told.clear()
        bench.run(0.01)
        assert law.told == [None, pytest.approx(0.01)]

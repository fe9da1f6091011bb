"""Orders at the handler of a service: short ones, long ones, and long ones that became outdated."""

import itertools
import json
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service import orders
from hil.addons.service.messages import MOVING, Action, Answer, Order, Phase, Task
from hil.addons.service.orders import OrderHandler
from hil.addons.service.records import Records
from hil.core.types import NO_GAINS
from hil.laws.law_registry import law_sha256
from hil.record.reader import read
from hil.runtime.provenance import ingredients
from hil.scenario import load
from hil.scenario.laws import Laws
from tests.support.pilot_bench import PilotBench


class Beside(Executor):
    """Does nothing until the test says so, so that the test decides the order."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, do: Callable[..., Any], /, *given: Any, **__: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, partial(do, *given)))
        return future

    def work(self) -> None:
        for future, do in self.waiting:
            try:
                future.set_result(do())
            except Exception as error:  # noqa: BLE001 - as an executor does
                future.set_exception(error)
        self.waiting.clear()


class Served(PilotBench):
    """A pilot with its handler."""

    def __init__(self) -> None:
        super().__init__()
        self._numbers = itertools.count(1)
        self.beside = Beside()
        self.answers: dict[int, Answer] = {}
        self.config = load("circle_speed")
        self.records = Records(None)
        signals = self.made.laws.signals
        self.handler = OrderHandler(
            self.config,
            ingredients(self.config) | {"law_sha256": "as it was made"},
            signals,
            self.pilot,
            self.records,
            self._answer,
            self.beside,
        )

    def _answer(self, answer: Answer) -> None:
        self.answers[answer.number] = answer

    def order(self, action: Action, *, stalled: bool = False, **arguments: Any) -> int:
        number = next(self._numbers)
        self.handler.handle([Order(number, action, arguments)], 0.0, stalled=stalled)
        return number

    def finish(self) -> None:
        self.beside.work()
        self.handler.handle([], 0.0)

    def refusal(self, number: int) -> str:
        return str(self.answers[number].refused)


TRACK: dict[str, Any] = {"reference": None, "here": True}


def test_a_path_is_followed_when_it_has_been_read() -> None:
    with Served() as served:
        served.armed()
        number = served.order(Action.TRACK, **TRACK)
        assert number not in served.answers
        served.finish()
        assert served.answers[number].result == {"kind": "circle"}
        assert served.pilot.tasks.task is Task.TRACK


@pytest.mark.parametrize("meanwhile", [Action.STOP, Action.DISARM, Action.ESTOP])
def test_a_path_that_was_read_too_late_is_not_followed(meanwhile: Action) -> None:
    with Served() as served:
        served.armed()
        number = served.order(Action.TRACK, **TRACK)
        served.order(meanwhile)
        served.run(1.0)
        if served.pilot.phase is Phase.ESTOP:
            served.order(Action.CLEAR)
            served.run_until(Phase.DISARMED)
        if served.pilot.phase is Phase.DISARMED:
            served.armed()
        served.finish()
        assert "came before the path was read" in served.refusal(number)
        served.run(0.5)
        assert served.pilot.tasks.task is Task.HOLD


@pytest.mark.parametrize("action", sorted(MOVING))
def test_an_order_that_waited_through_a_stall_moves_nothing(action: Action) -> None:
    with Served() as served:
        served.run_until(Phase.DISARMED)
        number = served.order(action, stalled=True)
        assert "stalled while this order waited" in served.refusal(number)


def test_a_path_that_was_being_read_when_the_service_stood_still_is_not_followed() -> None:
    with Served() as served:
        served.armed()
        number = served.order(Action.TRACK, **TRACK)
        served.beside.work()
        served.handler.handle([], 0.0, stalled=True)
        assert "stalled while this order waited" in served.refusal(number)
        served.finish()
        assert served.pilot.tasks.task is Task.HOLD


def test_a_second_recording_is_refused_whenever_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Served() as served:
        first = served.order(Action.RECORD, name="one.mcap")
        served.beside.work()  # it has been started, and nobody has taken note yet
        second = served.order(Action.RECORD, name="two.mcap")
        assert "is being written" in served.refusal(second)
        assert served.answers[first].result["path"] == str(Path("runs/one.mcap"))
        end = served.order(Action.STOP_RECORDING)
        again = served.order(Action.STOP_RECORDING)
        served.finish()
        assert served.answers[end].result["complete"]
        assert served.refusal(again) == "nothing is being recorded"


ELSEWHERE = ["../one.mcap", "/tmp/one.mcap", "runs/one.mcap"]
NO_NAMES = ["\x1b[2Jone.mcap", "a\n.mcap", f"{'n' * 300}.mcap"]


@pytest.mark.parametrize("name", [*ELSEWHERE, *NO_NAMES, "link.mcap", "there.mcap"])
def test_a_recording_is_a_new_file_of_the_service_s_own_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    runs = tmp_path / "runs"
    runs.mkdir()
    (runs / "there.mcap").write_text("evidence")
    (runs / "link.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    with Served() as served:
        number = served.order(Action.RECORD, name=name)
        served.finish()
        refusal = served.refusal(number)
    if name in (*ELSEWHERE, *NO_NAMES):
        assert refusal == (
            f"recording {name[:200]!r}: expected a file's name of at most 200 bytes that begins with a letter, a digit "
            "or _ and has only these and . , - + = @ in it; this service records to runs (service.recordings)"
        )
    else:
        there = str(Path("runs", name))
        assert refusal == f"recording {there!r}: the file exists, and a service replaces none; choose another name"
    assert refusal.isprintable()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["link.mcap", "runs", "there.mcap"]
    assert (runs / "there.mcap").read_text() == "evidence"


def test_a_recording_names_the_code_that_is_served_and_not_the_files_of_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Served() as served:
        for name in ("before.mcap", "after.mcap"):
            served.order(Action.RECORD, name=name)
            served.finish()
            served.order(Action.STOP_RECORDING)
            served.finish()
            served.order(Action.GAINS, gains={"k1_1_s": 7.0})  # the law is made anew
            served.finish()
    before, after = (read(tmp_path / "runs" / name).properties for name in ("before.mcap", "after.mcap"))
    assert before["law_sha256"] == "as it was made"
    assert after["law_sha256"] == law_sha256("dsc", tmp_path)
    assert (json.loads(before["gains"])["k1_1_s"], json.loads(after["gains"])["k1_1_s"]) == (8.0, 7.0)
    assert before["fmu_sha256"] == after["fmu_sha256"]


def test_a_recording_that_is_being_started_at_the_end_is_one_that_can_be_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Served() as served:
        served.order(Action.RECORD, name="one.mcap")
        served.beside.work()
        served.handler.end()
        recording = served.records.end()
        assert recording is not None
        assert recording.finish({}).complete


def test_an_emergency_stop_that_waited_is_done() -> None:
    with Served() as served:
        served.armed()
        served.order(Action.ESTOP, stalled=True)
        assert served.pilot.phase is Phase.ESTOP


@pytest.mark.parametrize(
    ("action", "arguments", "why"),
    [
        (Action.GAINS, {"gains": {"k1_1_s": 10**400}}, "expected a finite number"),
        (
            Action.GAINS,
            {"gains": {"k1_1_s": 1e6}},
            "k1_1_s = 1000000.0; expected a number greater than 0 and at most 1000",
        ),
        (Action.GAINS, {"gains": {"k3": 1.0}}, "unknown key controller.gains.k3; known: "),
        (
            Action.TRACK,
            {"here": True, "reference": {"kind": "rounded_square", "side_m": 1e308}},
            "expected a size of at most 1e+30",
        ),
        (
            Action.TRACK,
            {"here": False, "reference": {"kind": "circle", "radius_m": 50.0, "period_s": 1.0}},
            "the path reaches 314 m/s at t = 0 s, and service.speed_m_s is 0.5; make it slower",
        ),
        (Action.TRACK, {"here": True, "reference": {"kind": "waypoints", "file": "none.csv"}}, "none.csv"),
        (
            Action.WHEELS,
            {"command": "torque", "values": [1.0, 1.0, 1.0, 1.0], "sequence": 1},
            "command = 'torque': this service commands speed; it is fixed by its scenario",
        ),
    ],
)
def test_an_order_that_cannot_be_carried_out_is_refused_and_the_robot_goes_on(
    action: Action, arguments: dict[str, Any], why: str
) -> None:
    with Served() as served:
        served.armed()
        number = served.order(action, **arguments)
        served.finish()
        assert why in served.refusal(number)
        served.run(0.2)
        assert served.pilot.phase is Phase.ACTIVE


def test_gains_are_changed_one_order_at_a_time() -> None:
    with Served() as served:
        served.armed()
        first = served.order(Action.GAINS, gains={"k1_1_s": 5.0})
        second = served.order(Action.GAINS, gains={"filter_s": 0.02})
        assert "being changed by another order" in served.refusal(second)
        served.finish()
        assert served.answers[first].result["gains"]["k1_1_s"] == 5.0
        again = served.order(Action.GAINS, gains={"filter_s": 0.02})
        served.finish()
        assert served.answers[again].result["gains"].items() >= {"k1_1_s": 5.0, "filter_s": 0.02}.items()


_RECORDS_MORE = """
class Law:
    signals, telemetry = ("own.number",), (1.0,)

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        pass
"""


def test_gains_that_change_what_the_law_records_are_refused(tmp_path: Path) -> None:
    with Served() as served:
        law = tmp_path / "law.py"
        law.write_text(_RECORDS_MORE)  # changed since the service began
        table = replace(served.config.controller, law=f"{law}:Law", gains={})
        served.handler.scenario = replace(served.config, controller=table)
        number = served.order(Action.GAINS, gains={})
        served.finish()
        why = "these gains change what the law records; restart the service to use them"
        assert served.refusal(number) == why


class Broken:
    """A law that works for a while; then even its gains fail."""

    def __init__(self, law: Any) -> None:
        self._law = law
        self.left = 20

    @property
    def gains(self) -> Any:
        return NO_GAINS if self.left else 1 / 0

    def reset(self, state: Any, reference: Any) -> None:
        self._law.reset(state, reference)

    def update(self, *arguments: Any) -> Any:
        self.left -= 1
        return self._law.update(*arguments) if self.left else 1 / 0


def test_a_law_that_fails_ends_in_a_disarmed_robot_that_can_be_armed_again(tmp_path: Path) -> None:
    with Served() as served:
        served.armed()
        broken = Broken(served.made.laws.controller)
        served.pilot.use(Laws(broken))
        served.order(Action.GO, x_m=1.0, y_m=0.0, heading_rad=0.0)
        served.run_until(Phase.DISARMED)
        assert "the law or the path: a tick failed at " in str(served.pilot.why)
        assert ": ZeroDivisionError" in str(served.pilot.why)
        served.pilot.use(served.made.laws)
        served.armed()


def test_a_law_that_fails_keeps_neither_the_robot_away_nor_an_emergency_stop_from_it() -> None:
    with Served() as served:
        broken = Broken(served.made.laws.controller)
        broken.left = 0
        served.pilot.use(Laws(broken))
        served.run_until(Phase.DISARMED)
        served.pilot.use(served.made.laws)
        served.armed()
        served.pilot.use(Laws(broken))
        served.order(Action.ESTOP)
        served.run(0.5)
        assert served.phases[-2:] == [Phase.ACTIVE, Phase.ESTOP]
        assert not served.pilot.emergency.pending
        assert served.last("robot.state") == RobotState.ESTOP


def test_a_path_is_not_read_for_a_robot_that_is_not_armed() -> None:
    with Served() as served:
        served.run_until(Phase.DISARMED)
        number = served.order(Action.TRACK, **TRACK)
        assert served.answers[number].refused
        assert served.beside.waiting == []


@pytest.mark.parametrize("policy", ["stop_robot", "stop_recording"])
def test_a_recording_that_cannot_be_written_stops_the_robot_or_itself(
    policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[object] = []
    monkeypatch.setattr(orders, "finished", told.append)
    recording = object()
    with Served() as served:
        served.handler._policy = policy  # type: ignore[assignment]
        why: list[str | None] = [None]
        records = SimpleNamespace(watch=lambda _: why[0], end=lambda: recording if told == [] else None)
        served.handler.records = records  # type: ignore[assignment]
        served.armed()
        served.handler.watch_recording()
        served.beside.work()
        assert (served.pilot.phase, told) == (Phase.ACTIVE, [])
        why[0] = "the disk is full"
        served.handler.watch_recording()
        served.beside.work()
        served.handler.watch_recording()  # it has ended, or the robot stops already
        served.beside.work()
        assert told == ([recording] if policy == "stop_recording" else [])
        served.run(1.0)
        assert served.pilot.phase is (Phase.ACTIVE if policy == "stop_recording" else Phase.DISARMED)
        if policy == "stop_robot":
            assert str(served.pilot.why).endswith("its recording cannot be written: the disk is full")


def test_a_robot_is_not_armed_while_its_recording_cannot_be_written() -> None:
    """Unless the recording, and not the robot, is what then stops."""
    for policy, trouble, path, may in (
        ("stop_robot", "the disk is full", "a.rrd", False),
        ("stop_robot", None, "a.rrd", True),
        ("stop_robot", "the disk is full", None, True),
        ("stop_recording", "the disk is full", "a.rrd", True),
    ):
        with Served() as served:
            served.run_until(Phase.DISARMED)
            served.handler._policy = policy  # type: ignore[assignment]
            records = SimpleNamespace(path=path, trouble=trouble)
            served.handler.records = records  # type: ignore[assignment]
            number = served.order(Action.ARM)
            assert (served.answers[number].refused is None) is may
            if not may:
                assert served.refusal(number) == (
                    "the recording cannot be written (the disk is full), and service.when_full is stop_robot; make "
                    "room, or end the recording"
                )

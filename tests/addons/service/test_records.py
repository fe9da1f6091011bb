"""The recordings of a service and its emergency stop, without a robot: what is counted, told, and confirmed."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service import logs
from hil.addons.service.logs import Rate
from hil.addons.service.pilot import EmergencyStop
from hil.addons.service.records import Records


class Recording:
    """A recording that takes rows and events, with counts as the test sets them."""

    def __init__(self, name: str, dropped: int = 0, lost: int = 0) -> None:
        self.path = Path(f"{name}.mcap")
        self.part = Path(f"{name}-2.mcap")
        self.rows_dropped, self.rows_lost = dropped, lost
        self.failing: str | None = None
        self.troubles: list[str] = []
        self.report: object | None = None
        self.rows: list[bytes] = []
        self.events: list[tuple[float, str, str]] = []
        self.put = self.rows.append

    def event(self, t_s: float, level: str, text: str) -> None:
        self.events.append((t_s, level, text))


def records(live: Recording | None = None) -> Any:
    return Records(live)  # type: ignore[arg-type]


def test_rows_that_are_gone_are_summed_over_all_recordings_whatever_became_of_them() -> None:
    kept, first, second = records(), Recording("a", 3, 40), Recording("b", 5, 60)
    assert (kept.path, kept.rows_dropped, kept.rows_lost) == (None, 0, 0)
    kept.begin(first)
    assert (kept.path, kept.rows_dropped, kept.rows_lost) == (Path("a-2.mcap"), 3, 40)
    assert kept.end() is first
    assert kept.end() is None
    first.rows_dropped += 1  # while it is finished
    assert (kept.path, kept.rows_dropped, kept.rows_lost) == (None, 4, 40)
    kept.begin(second)
    assert (kept.rows_dropped, kept.rows_lost) == (9, 100)
    kept.end()
    first.report = object()
    kept.begin(Recording("c", 7, 80))
    first.rows_dropped = 1000  # nobody asks one that is finished
    assert (kept.rows_dropped, kept.rows_lost) == (16, 180)


def test_rows_and_events_go_to_the_recording_and_the_viewers() -> None:
    live, one = Recording("live", 100, 200), Recording("a")
    kept = records(live)
    kept.put(b"1")
    kept.begin(one)
    kept.put(b"2")
    kept.note(1.5, "info", "so it is")
    kept.end()
    kept.put(b"3")
    assert (live.rows, one.rows) == ([b"1", b"2", b"3"], [b"2"])
    assert live.events == one.events == [(1.5, "info", "so it is")]
    assert (kept.rows_dropped, kept.rows_lost) == (0, 0), "viewers may miss rows"


def test_a_recording_that_cannot_be_written_is_told_when_that_begins_and_ends() -> None:
    kept, one = records(), Recording("a", 0, 9)
    assert kept.watch(1.0) is None
    kept.begin(one)
    assert (kept.watch(2.0), kept.trouble) == (None, None)
    one.failing = "the disk is full"
    assert [kept.watch(3.0), kept.watch(4.0), kept.trouble] == ["the disk is full"] * 3
    one.failing = None
    assert (kept.watch(5.0), kept.trouble) == (None, None)
    one.troubles.append("killed")
    kept.watch(6.0)
    one.troubles.append("killed again")
    kept.watch(7.0)
    kept.watch(8.0)
    assert one.events == [
        (3.0, "error", "recording cannot be written: the disk is full"),
        (5.0, "warning", "recording is written again"),
        (6.0, "warning", "recorder ended: killed"),
        (7.0, "warning", "recorder ended: killed again"),
    ]


def test_the_recorder_of_the_viewers_that_ends_is_told_without_a_recording() -> None:
    live = Recording("live")
    kept = records(live)
    live.troubles.append("killed")
    assert kept.watch(1.0) is None
    assert live.events == [(1.0, "warning", "recorder ended: killed")]


def test_an_emergency_stop_is_sent_for_as_long_as_older_feedback_may_be_on_its_way() -> None:
    stop = EmergencyStop()
    assert not stop.must_send(RobotState.ACTIVE, 1.0)
    assert stop.may_clear()
    stop.request(10.0)
    assert stop.must_send(RobotState.ESTOP, 10.299)
    assert not stop.may_clear()
    assert not stop.pop_clear(), "not before it is confirmed"
    assert not stop.may_clear()
    assert stop.must_send(RobotState.ACTIVE, 99.0), "however long the robot takes"
    assert not stop.must_send(RobotState.ESTOP, 10.3)
    assert stop.pop_clear()
    assert not stop.pop_clear(), "once"
    stop.request(20.0)
    assert not stop.may_clear()
    stop.drop_clear()
    assert not stop.must_send(RobotState.ESTOP, 21.0)
    assert not stop.pop_clear()
    stop.request(30.0)
    stop.may_clear()
    stop.request(31.0)
    assert not stop.must_send(RobotState.ESTOP, 32.0)
    assert not stop.pop_clear(), "a later stop drops it"


def test_a_rate_is_kept_on_average_and_more_may_come_at_once_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(logs, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    rate = Rate(2.0, 5.0)

    def taken(at_s: float, *numbers: float) -> list[bool]:
        clock.now_s = at_s
        return [rate.take(number) for number in numbers]

    assert taken(100.0, 1.0, 3.0, 1.5, 1.0, 0.5) == [True, True, False, True, False]
    assert taken(100.75, 2.0, 1.5, 0.5) == [False, True, False]
    assert taken(1000.0, 5.5, 5.0, 0.5) == [False, True, False]

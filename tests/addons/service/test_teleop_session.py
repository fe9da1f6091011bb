"""What teleop orders and shows, step by step, with a terminal and a service that the test plays."""

import contextlib
import math
import os
import pty
import signal
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

if sys.platform == "win32":
    pytest.skip("teleop needs a terminal as POSIX has it", allow_module_level=True)

from hil.addons.service.messages import Action
from hil.addons.service.teleop import drive
from hil.addons.service.teleop.operator import Speeds
from hil.addons.service.teleop.terminal import LostTerminalError, Terminal
from hil.core.errors import LinkError, RunInterruptedError

STATUS = {
    "phase": "active", "task": "twist", "why": "it was slow",
    "twist": (0.1, 0.2, -0.3), "pose": (1.0, 2.0, math.pi / 2),
    "twist_age_s": 0.0121, "feedback_age_ms": 3.4,
}  # fmt: skip


class Played:
    """Terminal, signals, service and clock at once. Each step takes 1/30 s, or the time at its place in ``takes_s``.

    ``keys`` has those of each step; ``answers`` says what becomes of an order.
    """

    fd = 0

    def __init__(self, keys: Sequence[Sequence[str]], **takes_s: float) -> None:
        self.now_s = 100.0
        self._keys = iter(keys)
        self._step = -1
        self._takes_s = takes_s
        self.orders: list[tuple[int, Action, Any]] = []
        self.shown: list[list[str]] = []
        self.messages: list[Any] = []
        self.answers: dict[Action, str | None] = {}
        self.is_silent = False
        self.signals: set[int] = set()
        self.left = self.forgot = 0

    def monotonic(self) -> float:
        return self.now_s

    def enter(self) -> None:
        """Nothing to set."""

    def leave(self) -> None:
        self.left += 1

    def wait(self, until_s: float, fd: int) -> bool:
        self._step += 1
        self.now_s = max(until_s, self.now_s) + self._takes_s.get(f"at_{self._step}", 0.0)
        return bool(self.signals)

    def received(self) -> set[int]:
        return self.signals

    def forget(self) -> None:
        self.forgot += 1

    def read(self) -> Sequence[str]:
        return next(self._keys, ["q"])

    def show(self, lines: list[str]) -> None:
        self.shown.append(lines)

    @contextlib.contextmanager
    def live(self) -> Iterator["Played"]:
        yield self

    def __enter__(self) -> "Played":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to restore."""

    def order(self, action: Action, arguments: Any = None) -> int:
        number = 10 + len(self.orders)
        self.orders.append((self._step, action, arguments))
        if not self.is_silent:
            self.messages.append({"answer": {"number": number, "refused": self.answers.get(action)}})
        return number

    def receive(self, timeout_s: float) -> Any:
        if self.messages:
            return self.messages.pop(0)
        self.now_s += timeout_s
        return None

    def play(self, monkeypatch: pytest.MonkeyPatch) -> str:
        for name in ("Terminal", "Signals"):
            monkeypatch.setattr(drive, name, lambda: self)
        monkeypatch.setattr(drive, "time", self)
        return drive.teleop(self, Speeds(0.5, 2.0), gamepad=False)  # type: ignore[arg-type]


def ordered(played: Played) -> list[tuple[int, str]]:
    return [(step, action.value) for step, action, _ in played.orders]


def test_a_key_drives_by_its_direction_until_it_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played([["u"], *[[]] * 19, ["s"], ["s"], *[[]] * 6])
    played.messages.append({"status": STATUS | {"phase": "disarmed"}})
    told = played.play(monkeypatch)
    assert told == "the robot was told to stop; it is disarmed"
    slant = 0.5**0.5 * 0.5 * 0.5  # half of the speed, along both axes
    twists = [(step, arguments) for step, action, arguments in played.orders if action is Action.TWIST]
    assert twists[0] == (0, pytest.approx({"vx_m_s": slant, "vy_m_s": slant, "yaw_rate_rad_s": 0.0}))
    turns = {step: arguments["yaw_rate_rad_s"] for step, arguments in twists if arguments["yaw_rate_rad_s"]}
    assert turns == pytest.approx({20: 1.0, 21: 2.0, 22: 2.0, 23: 2.0, 24: 2.0, 25: 2.0})
    stops = [step for step, action in ordered(played) if action == "stop"]
    assert stops == [19, 26, 28], "when a key is let go, and at the end"
    assert [step for step, _ in twists] == [*range(19), *range(20, 26)]
    assert played.left == 1


def test_what_was_typed_while_nobody_looked_stops_but_does_not_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played([["i"], ["i"], ["i", "d"], [], []], at_2=0.26)
    told = played.play(monkeypatch)
    assert told == "the robot was told to stop; it is of unknown phase"
    assert ordered(played) == [(0, "twist"), (1, "twist"), (2, "disarm"), (2, "stop"), (5, "stop")]
    in_time = Played([["i"], ["i"], ["i"]], at_2=0.21)
    in_time.play(monkeypatch)
    assert ordered(in_time) == [(0, "twist"), (1, "twist"), (2, "twist"), (3, "stop"), (3, "stop")]


def test_a_refused_twist_lets_go_and_another_refusal_is_only_told(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played([["i"], [], [], ["c"], [], []])
    played.answers = {Action.TWIST: "arm it first", Action.CLEAR: "there is nothing to clear"}
    played.play(monkeypatch)
    assert ordered(played) == [(0, "twist"), (1, "stop"), (3, "clear"), (6, "stop")]
    assert played.shown[1][-1] == "refused: arm it first"
    assert played.shown[4][-1] == "refused: there is nothing to clear"


def test_a_service_that_does_not_answer_the_last_stop_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played([[]])
    played.is_silent = True
    with pytest.raises(LinkError, match="did not answer that it stops the robot"):
        played.play(monkeypatch)
    assert played.now_s == pytest.approx(100.0 + 1.0 / 30.0 + 2.0, abs=0.04)


@pytest.mark.parametrize(
    ("received", "error", "forgot", "why"),
    [
        (signal.SIGHUP, LostTerminalError, 1, "the terminal is gone; the robot was told to stop"),
        (signal.SIGTERM, RunInterruptedError, 0, "interrupted; the robot was told to stop"),
    ],
)
def test_a_signal_ends_it_with_a_stop(
    monkeypatch: pytest.MonkeyPatch, received: int, error: type[Exception], forgot: int, why: str
) -> None:
    played = Played([])
    played.signals = {received}
    with pytest.raises(error) as ended:
        played.play(monkeypatch)
    assert (str(ended.value), played.forgot) == (why, forgot)
    assert ordered(played) == [(0, "stop")]


def test_whatever_is_done_with_a_terminal_that_was_closed_it_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, inner = pty.openpty()
    with open(inner, closefd=False) as end:
        for name in ("stdin", "stdout", "stderr"):
            monkeypatch.setattr(sys, name, end)
        terminal = Terminal()
    terminal.enter()
    os.close(ours)
    for do in (terminal.read, lambda: terminal.show(["a line"]), terminal.enter):
        with pytest.raises(LostTerminalError, match="the terminal is gone"):
            do()
    terminal.leave()
    os.close(inner)


def test_the_screen_shows_what_was_asked_for_and_what_came_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played([["a"], ["s"], []])
    played.messages.append({"status": STATUS})
    told = played.play(monkeypatch)
    assert told == "the robot was told to stop; it is active; 'hil ctl disarm' disarms it"
    assert played.shown[0][-1] == "Enter arms the robot; any other key leaves it as it is"
    lines = played.shown[2]
    shown = {
        line[:10].strip(): line[10:] for line in lines if line[:10].strip() in ("phase", "age", "asked", "got", "speed")
    }
    assert shown == {
        "phase": "active, twist (it was slow)",
        "age": "twist 12 ms, feedback 3 ms, status 67 ms",
        "asked": " 0.000 m/s forward,  0.000 m/s to the left,  1.000 rad/s",
        "got": " 0.200 m/s forward, -0.100 m/s to the left, -0.300 rad/s",
        "speed": "0.50 m/s, 2.00 rad/s",
    }
    nothing = Played([[], []])
    nothing.play(monkeypatch)
    assert "phase     not known yet" in nothing.shown[0]
    assert "asked     nothing: nobody holds a key or the button" in nothing.shown[0]
    assert "got       not known" in nothing.shown[0]

"""Teleop: reads keys and the gamepad; sends twists 30 times a second while a dead-man switch is held, then a stop.

The robot stops in two ways. This program orders a stop when a key or the button is released, and whenever it ends. If
it hangs or is killed, the twists cease, and the service stops the robot.
"""

import contextlib
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hil.addons.service.client import STOP_UNANSWERED, Client, Live
from hil.addons.service.messages import Action
from hil.addons.service.teleop.gamepad import Gamepads
from hil.addons.service.teleop.operator import FIRST_S, FIRST_SHARE, REPEAT_S, Operator, Speeds, Wish
from hil.addons.service.teleop.terminal import LostTerminalError, Signals, Terminal
from hil.core.errors import LinkError, RunInterruptedError
from hil.core.kinematics import BodyTwist, to_body
from hil.core.types import Twist

PERIOD_S = 1.0 / 30.0
_STANDSTILL_S = 0.25
"""After this long without reading keys, what was typed is too old to drive by; it may still stop the robot."""
_STOPPED_S = 2.0

_REPEATS = (
    f"A press drives for {FIRST_S:g} s at {FIRST_SHARE:.0%} of the speed, and on as long as the key repeats;",
    f"the robot is stopped {REPEAT_S:g} s after the last repeat. One key at a time.",
)
_HELP = (
    "Space Esc k  stop    e  EMERGENCY STOP    c  clear it    d  disarm    q  quit",
    "  u  i  o            a, then Enter  arm",
    "  j  k  l  drive     s f  turn left, right",
    "  m  ,  .            + -  faster, slower      arrows drive too",
)


def teleop(client: Client, speeds: Speeds, *, gamepad: bool) -> str:
    """Drive a served robot until the operator quits; return a sentence on its final state.

    At the end, also after an error, the robot is ordered to stop if it can be reached, and the terminal is restored.
    Raises BadInputError, LostTerminalError, LinkError for a lost service, RunInterruptedError for SIGINT and SIGTERM.
    """
    terminal = Terminal()
    try:
        with contextlib.ExitStack() as resources:
            gamepads = resources.enter_context(contextlib.closing(Gamepads())) if gamepad else None
            live, signals = resources.enter_context(client.live()), resources.enter_context(Signals())
            resources.callback(terminal.leave)
            terminal.enter()
            return _Session(live, terminal, signals, gamepads, Operator(speeds)).run()
    except LostTerminalError:
        terminal.forget()
        raise


@dataclass
class _Session:
    _live: Live
    _terminal: Terminal
    _signals: Signals
    _gamepads: Gamepads | None
    _operator: Operator

    def __post_init__(self) -> None:
        self._requested: BodyTwist | None = None
        self._status: dict[str, Any] | None = None
        self._received_s = self._seen_s = self._due_s = time.monotonic()
        self._orders: dict[int, Action] = {}
        self._gamepad: str | None = None
        self._message = ""
        self._quits = False

    def run(self) -> str:
        try:
            while not self._quits:
                self._step()
        finally:
            self._stop()
        phase = "of unknown phase" if self._status is None else self._status["phase"]
        return f"the robot was told to stop; it is {phase}" + ("; 'hil ctl disarm' disarms it" * (phase == "active"))

    def _step(self) -> None:
        if self._terminal.wait(self._due_s, self._signals.fd):
            self._handle_signals()
        now_s = time.monotonic()
        late = now_s - self._seen_s > _STANDSTILL_S
        if late:
            self._let_go("teleop stalled for a while; press again")
        self._seen_s = now_s
        self._handle_keys(now_s, late=late)
        if now_s >= self._due_s:
            self._handle_gamepad()
        while (message := self._live.receive(0.0)) is not None:
            self._handle(message, now_s)
        self._drive(now_s)
        if now_s >= self._due_s:
            self._due_s = now_s + PERIOD_S
            self._terminal.show(self._screen(now_s))

    def _handle_signals(self) -> None:
        received = self._signals.received()
        _end_for(received)
        if signal.SIGTSTP in received:
            self._stop()
            self._terminal.leave()
            self._signals.suspend()
            _end_for(self._signals.received())
        elif signal.SIGCONT in received:  # after a SIGSTOP, which cannot be handled
            self._terminal.leave()
        else:
            return
        self._terminal.enter()
        self._let_go("continued; press again")
        self._seen_s = time.monotonic()

    def _handle_keys(self, now_s: float, *, late: bool) -> None:
        for key in self._terminal.read():
            self._do(self._operator.on_late_key(key) if late else self._operator.on_key(key, now_s))
        if self._operator.may_arm:
            self._message = "Enter arms the robot; any other key leaves it as it is"

    def _handle_gamepad(self) -> None:
        if self._gamepads is None:
            return
        pad = self._gamepads.poll()
        self._do(self._operator.on_pad(pad))
        self._gamepad = (
            "none; plug one in, or press a button on it"
            if pad is None
            else f"{self._gamepads.name}: hold the left shoulder to run; B, east, is the emergency stop"
        )

    def _do(self, wish: Wish | None) -> None:
        if wish is None:
            return
        self._message = ""
        if isinstance(wish, Action):
            self._order(wish)
            self._message = f"{wish.value} was ordered"
            if wish in (Action.STOP, Action.ESTOP):
                self._requested = None
        else:
            self._quits = True

    def _let_go(self, why: str) -> None:
        self._operator.release()
        self._message = why

    def _drive(self, now_s: float) -> None:
        requested = self._operator.twist(now_s)
        if requested is None:
            if self._requested is not None:
                self._order(Action.STOP)
        elif requested != self._requested or now_s >= self._due_s:
            self._order(Action.TWIST, dict(zip(("vx_m_s", "vy_m_s", "yaw_rate_rad_s"), requested, strict=True)))
        self._requested = requested

    def _order(self, action: Action, arguments: dict[str, float] | None = None) -> int:
        number = self._live.order(action, arguments)
        self._orders[number] = action
        return number

    def _handle(self, message: dict[str, Any], now_s: float) -> None:
        if "status" in message:
            self._status, self._received_s = message["status"], now_s
            return
        answer = message["answer"]
        action = self._orders.pop(answer["number"], None)
        if answer["refused"] is not None:
            # Otherwise the robot would start by itself if it is armed meanwhile.
            if action is Action.TWIST:
                self._operator.release()
            self._message = f"refused: {answer['refused']}"

    def _stop(self) -> None:
        """Order a stop, and wait for the answer; a robot that is not active refuses the order."""
        number = self._order(Action.STOP)
        self._requested = None
        end_s = time.monotonic() + _STOPPED_S
        while number in self._orders:
            message = self._live.receive(max(end_s - time.monotonic(), 0.0))
            if message is None:
                raise LinkError(STOP_UNANSWERED)
            self._handle(message, time.monotonic())

    def _screen(self, now_s: float) -> list[str]:
        status, speeds = self._status, self._operator.speeds
        requested = "nothing: nobody holds a key or the button" if self._requested is None else _twist(self._requested)
        actual = "not known"
        if status is not None and status["twist"] is not None and status["pose"] is not None:
            actual = _twist(to_body(Twist(*status["twist"]), status["pose"][2]))
        return [
            "hil teleop: hold a key to run, let go to stop",
            *_HELP,
            "",
            *(["phase     not known yet"] if status is None else _status(status, now_s - self._received_s)),
            f"asked     {requested}",
            f"got       {actual}",
            f"speed     {speeds.speed_m_s:.2f} m/s, {speeds.yaw_rate_rad_s:.2f} rad/s",
            *([] if self._gamepad is None else [f"gamepad   {self._gamepad}"]),
            "",
            *_REPEATS,
            "",
            self._message,
        ]


def _status(status: Mapping[str, Any], age_s: float) -> list[str]:
    task = "" if status["task"] is None else f", {status['task']}"
    why = f" ({status['why']})" if status["why"] else ""
    twist_ms = None if status["twist_age_s"] is None else 1e3 * status["twist_age_s"]
    ages = {"twist": twist_ms, "feedback": status["feedback_age_ms"], "status": 1e3 * age_s}
    return [
        f"phase     {status['phase']}{task}{why}",
        f"age       {', '.join(f'{name} {age:.0f} ms' for name, age in ages.items() if age is not None)}",
    ]


def _twist(twist: BodyTwist) -> str:
    forward, left, yaw_rate = (value if abs(value) >= 0.0005 else 0.0 for value in twist)  # never -0.000
    return f"{forward:6.3f} m/s forward, {left:6.3f} m/s to the left, {yaw_rate:6.3f} rad/s"


def _end_for(received: set[int]) -> None:
    if signal.SIGHUP in received:
        raise LostTerminalError("the terminal is gone; the robot was told to stop")
    if signal.SIGINT in received or signal.SIGTERM in received:
        raise RunInterruptedError("interrupted; the robot was told to stop")

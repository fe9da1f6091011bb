"""Teleop: reads keys and the gamepad; sends twists 30 times a second while a dead-man switch is held, then a stop.

The robot stops in two ways. This program orders a stop when a key or the button is released, and whenever it ends. If
it hangs or is killed, the twists cease, and the service stops the robot.
"""

import os
import signal
import time
from typing import Any

from hil.core.errors import LinkError, RunInterruptedError
from hil.core.kinematics import BodyTwist
from hil.service.client import STOP_UNANSWERED, Client, Live
from hil.service.messages import Action
from hil.service.teleop.gamepad import Gamepads
from hil.service.teleop.held import Heartbeat, ReleasingKeys, RepeatedKeys
from hil.service.teleop.keys import Flags, Focus, Key
from hil.service.teleop.operator import Operator, Speeds, Wish
from hil.service.teleop.screen import View, lines
from hil.service.teleop.terminal import LostTerminalError, Signals, Terminal

PERIOD_S = 1.0 / 30.0
_STANDSTILL_S = 0.25
"""After this long without reading keys, what was typed is too old to drive by; it may still stop the robot."""
_STOPPED_S = 2.0
_ORDERS = {
    Wish.STOP: Action.STOP,
    Wish.ESTOP: Action.ESTOP,
    Wish.ARM: Action.ARM,
    Wish.DISARM: Action.DISARM,
    Wish.CLEAR: Action.CLEAR,
}


def teleop(client: Client, speeds: Speeds, *, gamepad: bool, dead_zone: float, expo: float) -> str:
    """Drive a served robot until the operator quits; return a sentence on its final state.

    Raises LostTerminalError, LinkError when the service is lost, RunInterruptedError for SIGINT and SIGTERM, and
    BadInputError. In any case the robot was told to stop, if it could be reached, and the terminal is restored.
    """
    terminal = Terminal()
    gamepads = Gamepads() if gamepad else None
    try:
        with client.live() as live, Signals() as signals:
            try:
                terminal.enter()
                keys = ReleasingKeys() if terminal.reports_releases else RepeatedKeys()
                operator = Operator(keys, speeds, dead_zone, expo)
                return _Session(live, terminal, signals, gamepads, operator).run()
            finally:
                terminal.leave()
    except LostTerminalError:
        terminal.forget()
        raise
    finally:
        if gamepads is not None:
            gamepads.close()


class _Session:
    def __init__(
        self, live: Live, terminal: Terminal, signals: Signals, gamepads: Gamepads | None, operator: Operator
    ) -> None:
        self._live = live
        self._terminal = terminal
        self._signals = signals
        self._gamepads = gamepads
        self._operator = operator
        self._heartbeat = Heartbeat()
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
        self._check_terminal(now_s)
        self._receive(now_s)
        self._drive(now_s)
        if now_s >= self._due_s:
            self._due_s = now_s + PERIOD_S
            self._show(now_s)

    def _handle_signals(self) -> None:
        came = self._signals.received()
        _end_for(came)
        if signal.SIGTSTP in came:
            self._stop()
            self._terminal.leave()
            self._signals.suspend()
            _end_for(self._signals.received())
            self._come_back()
        elif signal.SIGCONT in came:  # after a SIGSTOP, which cannot be handled
            self._terminal.leave()
            self._come_back()

    def _come_back(self) -> None:
        self._terminal.enter()
        self._heartbeat = Heartbeat()
        self._let_go("continued; press again")
        self._seen_s = time.monotonic()

    def _handle_keys(self, now_s: float, *, late: bool) -> None:
        for event in self._terminal.read():
            if isinstance(event, Flags):
                self._heartbeat.answered()
            elif isinstance(event, Focus) and not event.gained:
                self._let_go("the window has lost the focus, and gets no releases")
            elif isinstance(event, Key):
                self._do(self._operator.on_late_key(event) if late else self._operator.on_key(event, now_s))
        if self._operator.may_arm:
            self._message = "Enter arms the robot; any other key leaves it as it is"

    def _handle_gamepad(self) -> None:
        if self._gamepads is None:
            return
        pad = self._gamepads.poll()
        self._do(self._operator.on_pad(pad))
        if pad is None:
            self._gamepad = "none; plug one in, or press a button on it"
        else:
            self._gamepad = f"{self._gamepads.name}: hold the left shoulder to run; B, east, is the emergency stop"

    def _do(self, wish: Wish | None) -> None:
        if wish is None:
            return
        self._message = ""
        if wish is Wish.QUIT:
            self._quits = True
        elif wish is Wish.SUSPEND:
            os.kill(0, signal.SIGTSTP)  # as the terminal does, for its whole foreground group
        else:
            self._order(_ORDERS[wish])
            self._message = f"{wish.value} was ordered"
            if wish in (Wish.STOP, Wish.ESTOP):
                self._requested = None

    def _check_terminal(self, now_s: float) -> None:
        """Query a terminal that reports releases while the robot drives."""
        if not self._terminal.reports_releases or self._requested is None:
            return
        if self._heartbeat.due(now_s):
            self._terminal.query()
        if self._heartbeat.is_lost(now_s):
            self._let_go("the terminal does not answer, and could not report a release; press again")

    def _let_go(self, why: str) -> None:
        self._operator.release()
        self._message = why

    def _drive(self, now_s: float) -> None:
        requested = self._operator.twist(now_s)
        if requested is None:
            if self._requested is not None:
                self._order(Action.STOP)
                self._heartbeat = Heartbeat()
        elif requested != self._requested or now_s >= self._due_s:
            forward_m_s, left_m_s, yaw_rate_rad_s = requested
            self._order(Action.TWIST, {"vx_m_s": forward_m_s, "vy_m_s": left_m_s, "yaw_rate_rad_s": yaw_rate_rad_s})
        self._requested = requested

    def _order(self, action: Action, arguments: dict[str, float] | None = None) -> int:
        number = self._live.order(action, arguments)
        self._orders[number] = action
        return number

    def _receive(self, now_s: float) -> None:
        while (message := self._live.receive(0.0)) is not None:
            self._handle(message, now_s)

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

    def _show(self, now_s: float) -> None:
        view = View(
            self._status,
            now_s - self._received_s,
            self._requested,
            self._operator.speeds,
            self._terminal.reports_releases,
            self._gamepad,
            self._message,
        )
        self._terminal.show(lines(view))


def _end_for(came: set[int]) -> None:
    if signal.SIGHUP in came:
        raise LostTerminalError("the terminal is gone; the robot was told to stop")
    if signal.SIGINT in came or signal.SIGTERM in came:
        raise RunInterruptedError("interrupted; the robot was told to stop")

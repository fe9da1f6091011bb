"""The API process's end of the pipe to the control process: orders go, answers and the status come."""

import asyncio
import math
import secrets
import threading
import time
from collections.abc import Mapping
from typing import Any

from hil.core.json_lines import LineReader, LineWriter
from hil.service.messages import LONG, MOVING, SILENT_S, Action, Answer, Order, Status, from_line, to_line

ANSWER_S = 1.0
"""How long an order waits for its answer, and how old a status may be."""

LONG_ANSWER_S = 30.0
"""How long one of ``LONG`` does."""

LIFE_PERIOD_S = 0.1
_CATCHING_UP_S = 0.3

# Orders that the control process has not answered. With so many short lines a pipe is never full, so that an emergency
# stop, which does not count, is never kept waiting behind them.
_MOST_OPEN = 64


class NoAnswerError(Exception):
    """The control process does not answer in time; the text is a sentence."""


class BusyError(Exception):
    """The control process has not answered what it was asked before, or has gone; the text is a sentence."""


class Control:
    """Orders to the control process and what it tells, for the tasks of one event loop.

    Attributes:
        status: the newest, as JSON has it (no NaN: null), or None before the first; taken: the same as it was sent.
        gone: set when the control process has ended.
        orders: how many orders were accepted, refused and unanswered, by action and outcome.
    """

    def __init__(self, lines: LineReader, writer: LineWriter, twist_timeout_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._writer = writer
        # Not from 1: an answer that was meant for the process before this one must find nobody.
        self._number = secrets.randbits(48)
        self._open: dict[int, asyncio.Future[Answer]] = {}
        self._watchers: set[asyncio.Event] = set()
        self._heard_s = time.monotonic()
        self.taken: Status | None = None
        self.status: dict[str, Any] | None = None
        self.gone = asyncio.Event()
        self._turned_s = time.monotonic()  # when the event loop was last seen to turn
        self._twist_stall_s = min(SILENT_S, twist_timeout_s + LIFE_PERIOD_S)
        self._refuse_until_s = self._refuse_twists_until_s = -math.inf
        self.orders: dict[tuple[Action, str], int] = {}
        # Any pipe can be read by a thread; only some can by an event loop, and on Windows none.
        threading.Thread(target=self._read, args=(lines,), name="lines", daemon=True).start()

    @property
    def status_age_s(self) -> float:
        """Age of the newest status, and before the first one that of this object."""
        return time.monotonic() - self._heard_s

    def fresh_status(self) -> dict[str, Any]:
        """Return the newest status. Raises NoAnswerError when the control process has sent none for a second."""
        if self.status is None or self.status_age_s > ANSWER_S:
            raise NoAnswerError(f"the control process has sent no status for {self.status_age_s:.1f} s")
        return self.status

    def watch(self, event: asyncio.Event) -> None:
        """Set an event at each new status, until ``unwatch``."""
        self._watchers.add(event)

    def unwatch(self, event: asyncio.Event) -> None:
        """Set it no more."""
        self._watchers.discard(event)

    @property
    def watchers(self) -> int:
        """How many watch the status."""
        return len(self._watchers)

    def submit(self, action: Action, arguments: Mapping[str, Any]) -> "asyncio.Future[Answer]":
        """Send an order, and return what its answer will come to. Raises BusyError; never for an emergency stop."""
        if self.gone.is_set():
            raise BusyError("the service is ending")
        if action in MOVING and self._has_stalled(action):
            self._count(action, "unanswered")
            raise BusyError("the API stood still while this order waited; give it again")
        if len(self._open) >= _MOST_OPEN and action is not Action.ESTOP:
            self._count(action, "unanswered")
            raise BusyError(f"the control process has {len(self._open)} orders to answer; only estop is taken now")
        self._number += 1
        future: asyncio.Future[Answer] = self._loop.create_future()
        self._open[self._number] = future
        self._writer.send(to_line(Order(self._number, action, arguments)), always=True)
        return future

    async def answer(self, action: Action, sent: "asyncio.Future[Answer]") -> Answer:
        """Wait for the answer to an order. Raises NoAnswerError after its time, BusyError when the service ends."""
        patience_s = LONG_ANSWER_S if action in LONG else ANSWER_S
        try:
            # The future stays open when the wait is over: the control process still has the order.
            answer = await asyncio.wait_for(asyncio.shield(sent), patience_s)
        except TimeoutError:
            self._count(action, "unanswered")
            raise NoAnswerError(
                f"the control process has not answered {action.value} within {patience_s:g} s; "
                "it may still carry it out"
            ) from None
        self._count(action, "accepted" if answer.refused is None else "refused")
        return answer

    async def live(self) -> None:
        """Tell the control process that this event loop turns, and notice when it has not, until cancelled."""
        while True:
            await asyncio.sleep(LIFE_PERIOD_S)
            self._notice_stall()
            self._writer.send({"alive": True})

    def _has_stalled(self, action: Action) -> bool:
        """Whether an order of this kind may have waited too long: this process was stopped, or its event loop kept."""
        return self._notice_stall() < (self._refuse_twists_until_s if action is Action.TWIST else self._refuse_until_s)

    def _notice_stall(self) -> float:
        """See for how long the event loop has not turned; return the time."""
        now_s = time.monotonic()
        stood_s = now_s - self._turned_s
        # What has waited comes within the next turns.
        if stood_s > self._twist_stall_s:
            self._refuse_twists_until_s = now_s + _CATCHING_UP_S
        if stood_s > SILENT_S:
            self._refuse_until_s = now_s + _CATCHING_UP_S
        self._turned_s = now_s
        return now_s

    def _count(self, action: Action, outcome: str) -> None:
        self.orders[action, outcome] = self.orders.get((action, outcome), 0) + 1

    def _read(self, lines: LineReader) -> None:
        record: dict[str, Any] | None = {}
        while record is not None:
            record = lines.read()
            self._loop.call_soon_threadsafe(self._heard, record)

    def _heard(self, record: dict[str, Any] | None) -> None:
        self._writer.flush()
        if record is None:
            self._end()
            return
        message = from_line(record)
        if isinstance(message, Answer):
            future = self._open.pop(message.number, None)
            if future is not None and not future.done():
                future.set_result(message)
        elif isinstance(message, Status):
            self.taken, self.status = message, _finite(record["status"])
            self._heard_s = time.monotonic()
            for event in self._watchers:
                event.set()

    def _end(self) -> None:
        self.gone.set()
        for future in self._open.values():
            if not future.done():
                future.set_exception(BusyError("the service has ended"))
                future.exception()  # nobody may be waiting for it any more
        self._open.clear()


def _finite(value: Any) -> Any:
    """Return a value as JSON has it, which knows neither NaN nor infinity: null stands for them."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

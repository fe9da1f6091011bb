"""The API process's end of the pipe to the control process: sends orders, receives answers and the status."""

import asyncio
import math
import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from hil.addons.service.api.access import NEEDED, UNLIMITED, Client
from hil.addons.service.api.audit import Audit
from hil.addons.service.messages import LONG, MOVING, SILENT_S, STREAMED, Action, Answer, Order, to_line
from hil.core.json_lines import LineReader, LineWriter, json_safe
from hil.core.printable import printable

ANSWER_S = 1.0
"""Timeout of an order's answer, and the greatest age of a status."""

LONG_ANSWER_S = 30.0
"""Timeout of the answer to an order of ``LONG``."""

LIFE_PERIOD_S = 0.1
_CATCHING_UP_S = 0.3
_QUIET_TURNS = 20  # of the event loop: an order that waited at a socket is here within a few

# Orders without an answer so far. This many short lines never fill the pipe, so that an emergency stop, which is exempt
# from the limit, never waits behind them.
_MOST_OPEN = 64


class NotDoneError(Exception):
    """An order was not sent (``http_status`` 403, 429 or 503), or was not answered in time (504)."""

    def __init__(self, sentence: str, http_status: int = 503) -> None:
        super().__init__(sentence)
        self.http_status = http_status
        self.outcome = {403: "forbidden", 429: "too_many"}.get(http_status, "unanswered")


class Control:
    """Sends orders to the control process and receives its answers and statuses, for the tasks of one event loop.

    Attributes:
        audit: notes the orders.
        status: the newest, as a JSON object with null in place of NaN; None before the first.
        gone: set when the control process has ended.
        motion: the newest motion, as a JSON object; None while no client asks for it.
        watchers: events that are set at each new status.
        outcomes: number of orders by action and outcome: accepted, refused by the control process, unanswered, invalid,
            forbidden to the client, or too_many.
    """

    def __init__(self, lines: LineReader, writer: LineWriter, twist_timeout_s: float, audit: Audit) -> None:
        self._loop = asyncio.get_running_loop()
        self._writer = writer
        self.audit = audit
        # Random, so that an answer for an earlier API process matches no order.
        self._number = secrets.randbits(48)
        self._open: dict[int, asyncio.Future[Answer]] = {}
        self.watchers: set[asyncio.Event] = set()
        self._received_s = time.monotonic()
        self.status: dict[str, Any] | None = None
        self.motion: dict[str, Any] | None = None
        self._motion_hz: dict[asyncio.Event, float] = {}
        self.gone = asyncio.Event()
        self._turned_s = time.monotonic()  # last time at which the event loop was seen running
        self._twist_stall_s = min(SILENT_S, twist_timeout_s + LIFE_PERIOD_S)
        self._refuse_until_s = self._refuse_twists_until_s = -math.inf
        self.outcomes: Counter[tuple[Action, str]] = Counter()
        # A thread can read any pipe; an event loop cannot on Windows.
        threading.Thread(target=self._read, args=(lines,), name="lines", daemon=True).start()

    @property
    def status_age_s(self) -> float:
        """Age of the newest status; before the first one, the age of this object."""
        return time.monotonic() - self._received_s

    def fresh_status(self) -> dict[str, Any]:
        """Return the newest status. Raises NotDoneError when the control process has sent none for a second."""
        if self.status is None or self.status_age_s > ANSWER_S:
            raise NotDoneError(f"the control process has sent no status for {self.status_age_s:.1f} s", 504)
        return self.status

    async def order(self, action: Action, arguments: Mapping[str, Any], client: Client) -> Answer:
        """Send a client's order, and return the control process's answer; the audit log has both.

        Raises NotDoneError. An emergency stop is always sent, unless the service is ending.
        """
        self._number += 1
        in_series = action in STREAMED or action in UNLIMITED
        note = partial(self.audit.note, client, action, number=self._number, in_series=in_series)
        try:
            answer = await self._order(action, arguments, client, note)
        except NotDoneError as error:
            self.outcomes[action, error.outcome] += 1
            note(error.outcome, why=str(error), in_series=in_series or error.http_status != 504)
            raise
        outcome = "accepted" if answer.refused is None else "refused"
        self.outcomes[action, outcome] += 1
        note(outcome, why=answer.refused)
        return answer

    async def _order(
        self, action: Action, arguments: Mapping[str, Any], client: Client, note: Callable[..., None]
    ) -> Answer:
        if not client.may(action):
            raise NotDoneError(
                f"{action.value} needs the role {NEEDED[action]}, which the token {client.name!r} lacks", 403
            )
        if self.gone.is_set():
            raise NotDoneError("the service is ending")
        busy = None
        if action in MOVING and self._has_stalled(action):
            busy = "the API stalled while this order waited; give it again"
        elif len(self._open) >= _MOST_OPEN and action is not Action.ESTOP:
            busy = f"the control process has {len(self._open)} orders to answer; only estop is accepted now"
        if busy is not None:
            raise NotDoneError(busy)
        number = self._number
        future: asyncio.Future[Answer] = self._loop.create_future()
        self._open[number] = future
        if action is not Action.ESTOP:
            note("given", arguments=arguments)
        self._writer.send(to_line(Order(number, action, arguments)), always=True)
        if action is Action.ESTOP:
            note("given")
        timeout_s = LONG_ANSWER_S if action in LONG else ANSWER_S
        try:
            # The future is kept when the wait is over: the control process still has the order.
            return await asyncio.wait_for(asyncio.shield(future), timeout_s)
        except TimeoutError:
            why = f"has not answered {action.value} within {timeout_s:g} s; it may still carry it out"
            raise NotDoneError(f"the control process {why}", 504) from None

    def not_sent(self, client: Client, action: Action, outcome: str, why: str) -> None:
        """Count and note an order that was refused before it came here."""
        self.outcomes[action, outcome] += 1
        self.audit.note(client, action, outcome, why=why, in_series=True)

    def ask_for_motion(self, news: asyncio.Event, rate_hz: float) -> None:
        """Set ``news`` at each new motion, at least ``rate_hz`` times a second if the ticks allow it; 0 ends that."""
        self._motion_hz[news] = rate_hz
        if not rate_hz:
            del self._motion_hz[news]
        self._writer.send({"motion_hz": max(self._motion_hz.values(), default=0.0)}, always=True)

    async def live(self) -> None:
        """Send signs of life to the control process, and notice stalls of this event loop, until cancelled."""
        while True:
            await asyncio.sleep(LIFE_PERIOD_S)
            self._notice_stall()
            self._writer.send({"alive": True})
            if math.inf in (self._refuse_until_s, self._refuse_twists_until_s) and await self._is_quiet():
                until_s = time.monotonic() + _CATCHING_UP_S
                self._refuse_until_s = min(self._refuse_until_s, until_s)
                self._refuse_twists_until_s = min(self._refuse_twists_until_s, until_s)

    async def _is_quiet(self) -> bool:
        """Return whether no order came during some turns of the event loop: none of those that waited is left."""
        before = self.outcomes.total()
        for _ in range(_QUIET_TURNS):
            await asyncio.sleep(0.0)
        return self.outcomes.total() == before

    def _has_stalled(self, action: Action) -> bool:
        """Whether an order of this kind may have waited too long because this process or its event loop stalled."""
        return self._notice_stall() < (self._refuse_twists_until_s if action in STREAMED else self._refuse_until_s)

    def _notice_stall(self) -> float:
        """Measure how long the event loop did not run; return the present time."""
        now_s = time.monotonic()
        stood_s = now_s - self._turned_s
        # Until ``live`` sees that the orders that waited meanwhile have come.
        if stood_s > self._twist_stall_s:
            self._refuse_twists_until_s = math.inf
        if stood_s > SILENT_S:
            self._refuse_until_s = math.inf
        self._turned_s = now_s
        return now_s

    def _read(self, lines: LineReader) -> None:
        record: dict[str, Any] | None = {}
        while record is not None:
            record = lines.read()
            self._loop.call_soon_threadsafe(self._on_record, record)

    def _on_record(self, record: dict[str, Any] | None) -> None:
        self._writer.flush()
        if record is None:
            self._end()
            return
        record = _shown(json_safe(record))
        if (status := record.get("status")) is not None:
            self.status = status
            self._received_s = time.monotonic()
            for event in self.watchers:
                event.set()
        elif (motion := record.get("motion")) is not None:
            self.motion = motion
            for event in self._motion_hz:
                event.set()
        else:
            answer = Answer(**record["answer"])
            future = self._open.pop(answer.number, None)
            if future is not None and not future.done():
                future.set_result(answer)

    def _end(self) -> None:
        self.gone.set()
        for future in self._open.values():
            if not future.done():
                future.set_exception(NotDoneError("the service has ended"))
                future.exception()  # marks it as read, because perhaps nobody waits for it
        self._open.clear()


def _shown(value: Any) -> Any:
    """Return what the control process says with all texts made ``printable``: a device, a law or a path is in them."""
    if isinstance(value, dict):
        return {key: _shown(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shown(item) for item in value]
    return printable(value) if isinstance(value, str) else value

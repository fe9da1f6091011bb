"""Connects the client in C with a link: sends its frames, gives it received ones, makes feedback of snapshots.

``open_channel`` chooses the class of channel for a link, once.
"""

import time
from collections.abc import Callable
from typing import Any

from firmware_protocol.client import Client
from firmware_protocol.codec import Message, decode
from firmware_protocol.framing import packed_frame
from firmware_protocol.host_line import packed_of
from hil.core.errors import RobotStoppedError
from hil.core.ports import Received
from hil.robot.direct import DirectLink
from hil.robot.handshake import RETRY_NS, SILENCE_NS
from hil.robot.link_times import RoundTrip
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink

_MOST_FRAMES = 200  # that one call takes; a robot sends some ten a tick at most
_FULL = 512  # bytes of waiting frames, from which on ``PlainDirectChannel`` sends them before the next step
_STEP_AWAITED, _STEP_ELSEWHERE = 1, 3  # WHEEL_STEP_... of wheel_client.h


class Channel:
    """Exchanges frames between ``client`` and the robot at the other end of ``link``, whatever that is.

    ``on_message`` gets every message that is not part of a snapshot, with its time of arrival.

    Attributes:
        is_carried: whether the next step carries waiting frames, so that ``flush`` is not needed.
    """

    is_carried = False

    def __init__(self, link: ConditionedLink, client: Client, on_message: Callable[[Message, int], None]) -> None:
        self._link = link
        self._client = client
        self._on_message = on_message
        self._round_trips_seen = 0
        self._round_trip = RoundTrip()

    # What is sent

    def flush(self, *, everything: bool = False) -> None:
        """Send what waits in the client. Raises LinkError when the link is lost; what waited is then forgotten.

        If the next step carries frames (``is_carried``) they stay there, unless many wait or ``everything`` is true.
        """
        client = self._client
        view = client.view
        try:
            if view.out_bytes:
                self._link.send_all(client.out())
                client.sent()
        except BaseException:
            client.unsent()
            raise
        self._empty_log_if_due()

    def step(self, ticks: int) -> None:
        """Lockstep: run the robot for a number of ticks, and take all that it sends; 0 only asks for its tick.

        Raises RobotStoppedError when it does not answer within 2 s of wall-clock time, or is at another tick,
        ValueError for more than 1000 ticks.
        """
        self._client.step(ticks)
        self.flush()
        self._await_step()

    def _await_step(self) -> None:
        view = self._client.view
        begin_ns = sent_ns = time.monotonic_ns()
        while view.step == _STEP_AWAITED:
            received = self._link.receive(RETRY_NS)
            if received is not None:
                self.take(received)
            now_ns = time.monotonic_ns()
            if now_ns - begin_ns > SILENCE_NS:
                raise RobotStoppedError("the robot did not answer STEP within 2 s of wall-clock time; it was lost")
            if received is None and now_ns - sent_ns > RETRY_NS:
                self._client.step_again()
                self.flush(everything=True)
                sent_ns = now_ns

    # What arrives

    def receive(self) -> int | None:
        """Real time: take received frames, then send those that are due.

        Return the time at which nothing was left to read. None if there may be more, which is read in the next tick: a
        host that is slower than its robot would never finish.
        """
        taken = 0
        while taken < _MOST_FRAMES and (received := self._link.receive(0)) is not None:
            self.take(received)
            taken += len(received.frames)
        now_ns = self._link.session_clock.now_ns()
        if self._client.poll(now_ns):
            self.flush()
        return now_ns if taken < _MOST_FRAMES else None

    def take(self, received: Received) -> None:
        """Process frames that arrived together. Raises RobotStoppedError for a step that ended at a wrong tick."""
        frames, stamp_ns = received
        self._take_from(packed_of(frames), 0, stamp_ns)

    def _take_from(self, packed: bytes, at: int, stamp_ns: int) -> None:
        while at < len(packed):
            at = self._client.take(packed, at, stamp_ns)
            self._attend(packed, stamp_ns)

    def _attend(self, packed: Any, stamp_ns: int) -> None:
        """Do what the client in C leaves to Python: hash a full log, pass on a message, report a wrong tick."""
        view = self._client.view
        if view.log_is_due:
            self._empty_log()
        if view.message_id:
            frame, _ = packed_frame(packed, view.message_at)
            if (message := decode(frame)) is not None:
                self._on_message(message, stamp_ns)
        elif view.step == _STEP_ELSEWHERE:
            raise RobotStoppedError(
                f"the robot is at tick {view.step_done_tick} where {view.step_target} was expected; it was reset "
                "or is stepped by another host"
            )

    # The client's log of frames, and counters

    def _empty_log_if_due(self) -> None:
        if self._client.view.log_is_due and not self._client.view.out_bytes:  # what waits may still be unsent
            self._empty_log()

    def _empty_log(self) -> None:
        """Hash the client's log, and note its round trips before they are overwritten."""
        self._note_round_trips()
        self._client.hash_log()

    def _note_round_trips(self) -> None:
        self._round_trip.add(self._client.round_trips_ns(self._round_trips_seen))
        self._round_trips_seen = self._client.view.round_trips

    @property
    def round_trip(self) -> RoundTrip:
        self._note_round_trips()
        return self._round_trip

    def rejected(self) -> dict[str, int]:
        """Return the number of received frames that this side dropped, by cause."""
        view = self._client.view
        return self._link.rejected() | {"range": view.out_of_range, "incomplete_snapshot": view.incomplete}


class LineChannel(Channel):
    """Over a serial line without conditions: bytes pass between stream and client within the C library."""

    def __init__(self, link: ConditionedLink, client: Client, on_message: Callable[[Message, int], None]) -> None:
        super().__init__(link, client, on_message)
        assert isinstance(link.transport, StreamLink)
        self._line = link.transport
        self._line.serve(client, link.session_clock, self._attend_from)

    def flush(self, *, everything: bool = False) -> None:
        try:
            self._line.send_waiting()
        except BaseException:
            self._client.unsent()
            raise
        self._empty_log_if_due()

    def receive(self) -> int | None:
        return self._line.receive_waiting()

    def _attend_from(self, packed: bytes, at: int, stamp_ns: int) -> None:
        if at:
            self._attend(packed, stamp_ns)
        self._take_from(packed, at, stamp_ns)
        self._client.poll(stamp_ns)
        self.flush()


class DirectChannel(Channel):
    """To a robot in this thread, over a link that may have conditions."""

    def __init__(self, link: ConditionedLink, client: Client, on_message: Callable[[Message, int], None]) -> None:
        super().__init__(link, client, on_message)
        assert isinstance(link.transport, DirectLink)
        self._direct = link.transport
        self._direct.serve(client)

    def step(self, ticks: int) -> None:
        ready = self._link.exchange(self._direct, ticks)
        view = self._client.view
        while ready and view.step == _STEP_AWAITED:
            self.take(ready.popleft())
        if view.step == _STEP_AWAITED:
            self._await_step()


class PlainDirectChannel(DirectChannel):
    """To a robot in this thread without conditions: a step is one call into the C library, with the waiting frames."""

    is_carried = True

    def flush(self, *, everything: bool = False) -> None:
        if everything or self._client.view.out_bytes >= _FULL:
            super().flush()
        else:
            self._empty_log_if_due()

    def step(self, ticks: int) -> None:
        direct = self._direct
        rest = direct.step(ticks)
        if rest is not None:  # go on where the client has stopped
            self._attend(direct.answer, rest.stamp_ns)
            self.take(rest)
            self._await_step()


def open_channel(link: ConditionedLink, client: Client, on_message: Callable[[Message, int], None]) -> Channel:
    kind: type[Channel] = Channel
    if isinstance(link.transport, DirectLink) and link.may_exchange:
        kind = PlainDirectChannel if link.is_plain else DirectChannel
    elif isinstance(link.transport, StreamLink) and link.is_plain:
        kind = LineChannel
    return kind(link, client, on_message)

"""The robot of a recorded run: it tells a controller again what the recorded one was told, and compares what it sends.

It is driven by the journal of the recording (``hil.record.journal``). In lockstep an answer is given when the clock has
reached its time. In real time the clock is the journal's too: each wait of the controller ends when the recorded one
did, and in between it is told what the recorded controller read between the same two waits.

Frames are compared by the moment at which they were sent, the time in lockstep and the number of the wait in real time,
and there by their identifiers: a heartbeat that goes out before the command in place of after it is no difference.
"""

import itertools
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from firmware_protocol.codec import decode, encode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import PackedFrames
from hil.core.clock import TICK_NS
from hil.core.errors import LinkError
from hil.core.link_protocol import LinkProtocol
from hil.core.ports import Clock, FixSource, Link, PoseSource, Received
from hil.core.types import MeasuredPose, PoseFix
from hil.record.journal import Entry, JournalDamagedError, Kind, entries, fixes_of, frames_of, logs_of, truth_of
from hil.wire.conditions import ConditionedLink

_STEP, _STEP_DONE, _ASKS_HELLO = m.Step.ID, m.StepDone.ID, m.HelloRequest.ID
_HELLO = range(0x701, 0x710)  # the robot's answers
_NOT_COMPARED = (_STEP, _ASKS_HELLO)  # latency divides steps; how often it asks depends on the wall clock
_SOURCES = (Kind.TRUTH, Kind.FIXES)
_COMMANDS = (m.Estop.ID, m.TorqueFeedforward.ID, m.WheelCommand.ID, m.TorqueCommand.ID)
_SLACK_NS = 50_000_000
_END = "the recording ends here"


class _Event(NamedTuple):
    """An entry of the link, with its frames, or with its text."""

    kind: Kind
    time_ns: int
    other_ns: int
    frames: Sequence[Frame] = ()
    body: bytes = b""
    after_ns: int = 0


def _event(entry: Entry) -> _Event:
    kind, time_ns, other_ns, body = entry
    if kind is Kind.WAITED:
        return _Event(kind, time_ns, other_ns, after_ns=int.from_bytes(body, "little", signed=True))
    if kind in (Kind.LOST, *_SOURCES):
        return _Event(kind, time_ns, other_ns, body=body)
    return _Event(kind, time_ns, other_ns, frames_of(body))


class FrameDifference(NamedTuple):
    """A frame that differs, with its time [s] on the run's clock: the recorded one and the new one; None for none."""

    t_s: float
    recorded: Frame | None
    sent: Frame | None
    is_ours: bool

    @property
    def words(self) -> str:
        """A sentence on it."""
        recorded, sent = (_words(frame, is_ours=self.is_ours) for frame in (self.recorded, self.sent))
        if self.sent is None:
            return f"{recorded} was recorded, and is not sent now"
        if self.recorded is None:
            return f"{sent} is sent now, and was not recorded"
        return f"{sent} is sent now where {recorded} was recorded"


def _words(frame: Frame | None, *, is_ours: bool) -> str:
    if frame is None:
        return ""
    message = decode(frame) if is_ours else None
    if message is None:
        return f"frame {frame.id:#05x} with {frame.payload.hex() or 'no data'}"
    fields = ", ".join(f"{name} {getattr(message, name)}" for name in message.FIELDS)
    return f"{message.NAME} ({fields})" if fields else message.NAME


class SentFrames:
    """Compares what the controller sends with what the recorded one sent.

    In real time (``slack_ns`` above 0) what a timer sends, such as a heartbeat, may come this much earlier or later.
    ``is_ours``: the frames are of our own protocol.

    Attributes:
        equal: number of frames that were the same.
        first: the first difference, or None.
        differences: number of frames that differ, were not sent or were not recorded.
    """

    def __init__(self, slack_ns: int, *, is_ours: bool) -> None:
        self._slack_ns = slack_ns
        self._is_ours = is_ours
        self._not_compared = _NOT_COMPARED if is_ours else ()
        self._at_once = _COMMANDS if is_ours else ()
        self._expected: dict[int, list[Frame]] = {}
        self._last = 0  # the newest moment that was recorded; what closes a session comes after the recording
        self._times_ns: dict[int, int] = {}
        self._early: deque[tuple[int, Frame]] = deque()  # sent, and perhaps recorded a little later
        self._late: deque[tuple[int, Frame]] = deque()  # recorded, and perhaps sent a little later
        self.equal = self.differences = 0
        self.first: FrameDifference | None = None

    def expect(self, moment: int, time_ns: int, frames: Sequence[Frame]) -> None:
        """Add recorded frames."""
        self._last = max(self._last, moment)
        self._times_ns.setdefault(moment, time_ns)
        self._expected.setdefault(moment, []).extend(frame for frame in frames if frame.id not in self._not_compared)

    def sent(self, moment: int, time_ns: int, frame: Frame) -> None:
        """Compare a frame that is sent now."""
        if frame.id in self._not_compared:
            return
        self.pass_to(moment)
        time_ns = self._times_ns.get(moment, time_ns)
        expected = self._expected.get(moment, [])
        if frame in expected:
            expected.remove(frame)
            self.equal += 1
        elif not self._is_among(self._late, time_ns, frame) and moment < self._last:
            recorded = next((one for one in expected if one.id == frame.id), None)
            if recorded is not None:
                expected.remove(recorded)
                self._differs(time_ns, recorded, frame)
            elif self._slack_ns and frame.id not in self._at_once:
                self._early.append((time_ns, frame))
            else:
                self._differs(time_ns, None, frame)

    def pass_to(self, moment: int) -> None:
        """Tell the frames of earlier moments that were not sent."""
        for at in list(itertools.takewhile(lambda at: at < moment, self._expected)):
            time_ns = self._times_ns[at]
            for frame in self._expected.pop(at):
                if self._is_among(self._early, time_ns, frame):
                    continue
                if self._slack_ns and frame.id not in self._at_once:
                    self._late.append((time_ns, frame))
                else:
                    self._differs(time_ns, frame, None)
            while self._late and self._late[0][0] < time_ns - self._slack_ns:
                self._differs(self._late[0][0], self._late.popleft()[1], None)
            while self._early and self._early[0][0] < time_ns - self._slack_ns:
                self._differs(self._early[0][0], None, self._early.popleft()[1])

    def _is_among(self, waiting: deque[tuple[int, Frame]], time_ns: int, frame: Frame) -> bool:
        near_ns = self._slack_ns
        found = next((one for one in waiting if one[1] == frame and abs(one[0] - time_ns) <= near_ns), None)
        if found is None:
            return False
        waiting.remove(found)
        self.equal += 1
        return True

    def _differs(self, time_ns: int, recorded: Frame | None, frame: Frame | None) -> None:
        self.differences += 1
        if self.first is None or time_ns * 1e-9 < self.first.t_s:
            self.first = FrameDifference(time_ns * 1e-9, recorded, frame, self._is_ours)


class RecordedRobot:
    """Takes the place of a robot in a run (``hil.runtime.run_options.Replayed``). It is used for one run.

    Attributes:
        frames: the comparison of what is sent.
        damage: why the journal could not be read to its end, or None.
    """

    clock: Clock

    advance: Callable[[int], None] | None
    _end: "_End"

    def __init__(self, pieces: Sequence[str], *, is_lockstep: bool, is_ours: bool) -> None:
        self.frames = SentFrames(0 if is_lockstep else _SLACK_NS, is_ours=is_ours)
        self.advance = (lambda _: None) if is_lockstep else None
        self.damage: str | None = None
        self._is_lockstep, self._is_ours = is_lockstep, is_ours
        of_link: list[_Event] = []
        self._kinds: set[Kind] = set()
        self._steps = steps = _Steps()
        for entry in self._entries(pieces):
            self._kinds.add(entry.kind)
            if entry.kind is Kind.LOGS:
                of_link += steps.add(*logs_of(entry.body))
            else:
                of_link.append(_event(entry))
        self._of_link = of_link
        self.nonces = _nonces(of_link)
        if not is_lockstep:
            self._end = end = _RecordedTime(of_link, self.frames)
            self.clock = _Clock(end.read_clock, end.wait_until)

    def _entries(self, pieces: Sequence[str]) -> Iterator[Entry]:
        try:
            yield from entries(pieces)
        except JournalDamagedError as damage:
            self.damage = str(damage)

    def link(self, clock: Clock) -> Link:
        if self._is_lockstep:
            kind = _StepLink if self._is_ours else _TimedLink
            self._end = kind(clock, self._of_link, self._steps.hello, self.frames)
        return self._end

    def conditioned(self, link: Link, clock: Clock, protocol: LinkProtocol) -> ConditionedLink:
        return _RepeatedLink(self._end, clock, protocol=protocol)

    def truth(self) -> PoseSource | None:
        return _Truths(self._told) if Kind.TRUTH in self._kinds else None

    def fixes(self) -> FixSource | None:
        return _Fixes(self._told) if Kind.FIXES in self._kinds else None

    def _told(self, kind: Kind) -> Sequence[_Event]:
        """Return what a source had told at this time."""
        return self._end.told(kind)


class _RepeatedLink(ConditionedLink):
    """A link that has passed latency and faults already. It is lost when the recorded one was, also while it waited."""

    def __init__(self, link: "_End", clock: Clock, *, protocol: LinkProtocol) -> None:
        super().__init__(link, clock, protocol=protocol)
        self._end = link
        self.is_plain, self.may_hold = False, True

    def _send(self, frames: Sequence[Frame]) -> None:
        self._put(frames)

    def service(self, *, everything: bool = False) -> None:
        self._end.reopen()

    def hand_over_until(self, clock: Clock, t_ns: int) -> None:
        self._end.reopen()


class _Steps:
    """Makes events of the client's logs in C, which have no times: a STEP tells how much time passes until its end."""

    def __init__(self) -> None:
        self._sent: deque[Frame] = deque()
        self._received: deque[Frame] = deque()
        self._time_ns = 0
        self.hello: deque[list[Frame]] = deque()

    def add(self, sent: bytes, received: bytes) -> Iterator[_Event]:
        """Add the next logs, and yield the events of the steps that are whole by now."""
        frames = list(PackedFrames(received))
        if frames and frames[0].id in _HELLO:  # the answer to a question that these logs do not have
            self.hello.append(frames)
            return
        self._sent.extend(PackedFrames(sent))
        self._received.extend(frames)
        while (asked := _until(self._sent, _STEP)) and (answer := _until(self._received, _STEP_DONE)):
            for _ in asked:
                self._sent.popleft()
            for _ in answer:
                self._received.popleft()
            step = decode(asked[-1])
            assert isinstance(step, m.Step)
            yield _Event(Kind.SENT, self._time_ns, 0, asked[:-1])
            self._time_ns += step.substeps * TICK_NS
            yield _Event(Kind.SENT, self._time_ns, 0, asked[-1:])
            yield _Event(Kind.RECEIVED, self._time_ns, self._time_ns, answer)


def _until(frames: Sequence[Frame], number: int) -> list[Frame]:
    """Return the frames up to the first with this identifier; none if there is no such frame yet."""
    for count, frame in enumerate(frames, 1):
        if frame.id == number:
            return list(itertools.islice(frames, count))
    return []


def _nonces(of_link: Sequence[_Event]) -> Iterator[int]:
    """Yield the session nonces that were used, in order, then others."""
    before = None
    for event in of_link:
        for frame in event.frames if event.kind is Kind.SENT else ():
            message = decode(frame) if frame.id == m.HostHeartbeat.ID else None
            if isinstance(message, m.HostHeartbeat) and message.nonce != before:
                before = message.nonce
                yield before
    yield from itertools.cycle(range(1, 0xFFFF))


class _End(ABC):
    """The robot's end of a link, and its sensors. The statistics of a run are not compared."""

    def __init__(self) -> None:
        self.sent_frames = self.received_frames = 0

    def byte_counts(self) -> tuple[float, float]:
        return 0.0, 0.0

    def begin_byte_counts(self) -> None: ...  # noqa: B027 - it counts nothing

    def rejected(self) -> dict[str, int]:
        return {}

    @abstractmethod
    def send(self, frame: Frame) -> None:
        """Compare a frame."""

    @abstractmethod
    def receive(self, timeout_ns: int) -> Received | None:
        """Return what the recorded controller received at this time."""

    @abstractmethod
    def reopen(self) -> None:
        """Raise LinkError if the recorded link was lost at this time."""

    @abstractmethod
    def told(self, kind: Kind) -> Sequence[_Event]:
        """Return what a source of poses told at this time."""

    def describe(self) -> str:
        return "a recording"

    def close(self) -> None: ...  # noqa: B027 - it holds nothing


class _TimedLink(_End):
    """The link of a run in lockstep: what was received is received again when the clock shows the same time."""

    def __init__(self, clock: Clock, of_link: Sequence[_Event], hello: deque[list[Frame]], sent: SentFrames) -> None:
        super().__init__()
        self._clock = clock
        self._hello = hello
        self._sent = sent
        self._waiting: deque[_Event] = deque()
        self._sources: dict[Kind, deque[_Event]] = {kind: deque() for kind in _SOURCES}
        self._end_ns = of_link[-1].time_ns if of_link else 0
        for event in of_link:
            if event.kind is Kind.SENT:
                sent.expect(event.time_ns, event.time_ns, event.frames)
            elif event.kind in _SOURCES:
                self._sources[event.kind].append(event)
            elif event.kind is not Kind.EMPTY:
                self._waiting.append(event)

    def told(self, kind: Kind) -> Sequence[_Event]:
        found, now_ns, waiting = [], self._clock.now_ns(), self._sources[kind]
        while waiting and waiting[0].time_ns <= now_ns:
            found.append(waiting.popleft())
        return found

    def send(self, frame: Frame) -> None:
        now_ns = self._clock.now_ns()
        self._raise_if_lost(now_ns)
        self.sent_frames += 1
        self._sent.sent(now_ns, now_ns, frame)

    def receive(self, timeout_ns: int) -> Received | None:
        now_ns = self._clock.now_ns()
        self._raise_if_lost(now_ns)
        self._raise_if_over(now_ns)
        if not self._waiting or self._waiting[0].time_ns > now_ns:
            return None
        event = self._waiting.popleft()
        return self._receive(event, event.frames)

    def reopen(self) -> None:
        self._raise_if_lost(self._clock.now_ns())

    def _receive(self, event: _Event, frames: Sequence[Frame]) -> Received:
        self.received_frames += len(frames)
        return Received(frames, event.other_ns)

    def _raise_if_over(self, now_ns: int) -> None:
        if not self._waiting and now_ns > self._end_ns:
            raise LinkError(_END)

    def _raise_if_lost(self, now_ns: int) -> None:
        if self._waiting and self._waiting[0].kind is Kind.LOST and self._waiting[0].time_ns <= now_ns:
            raise LinkError(self._waiting.popleft().body.decode())


class _StepLink(_TimedLink):
    """The same with our protocol: an answer to STEP comes once it was sent."""

    _is_asked = False  # whether a STEP was sent and not answered
    _done: _Event | None = None  # the newest end of a step

    def send(self, frame: Frame) -> None:
        if frame.id == _STEP:
            self._is_asked = True
        elif frame.id == _ASKS_HELLO and self._hello:
            now_ns = self._clock.now_ns()
            self._waiting.appendleft(_Event(Kind.RECEIVED, now_ns, now_ns, self._hello.popleft()))
        super().send(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        now_ns, waiting = self._clock.now_ns(), self._waiting
        self._raise_if_lost(now_ns)
        while waiting and waiting[0].time_ns <= now_ns and waiting[0].kind is not Kind.LOST:
            event = waiting.popleft()
            frames = event.frames
            if frames[-1].id == _STEP_DONE:
                self._done = event
                if self._is_asked and event.time_ns == now_ns:
                    self._is_asked = False
                else:
                    frames = frames[:-1]
            if frames:
                return self._receive(event, frames)
        self._raise_if_over(now_ns)
        if not self._is_asked or self._done is None:
            return None
        self._is_asked = False
        return Received([self._step_done(now_ns, self._done)], now_ns)

    def _step_done(self, now_ns: int, newest: _Event) -> Frame:
        """Return the end of a step, which need not be one that was recorded: latency divides steps."""
        done = decode(newest.frames[-1])
        assert isinstance(done, m.StepDone)
        return encode(m.StepDone(done.tick + max(0, now_ns - newest.time_ns) // TICK_NS))


class _Clock(NamedTuple):
    """The clock of a run in real time. A link has a clock of its own, which the bench sets."""

    now_ns: Callable[[], int]
    wait_until: Callable[[int], int]


class _RecordedTime(_End):
    """The clock and the link of a run in real time."""

    def __init__(self, of_link: Sequence[_Event], sent: SentFrames) -> None:
        super().__init__()
        self._sent = sent
        self._now_ns = 0
        self._moment = 0
        self._waits: list[_Event] = []
        pieces: list[deque[_Event]] = [deque()]
        for event in of_link:
            if event.kind is Kind.WAITED:
                self._waits.append(event)
                pieces.append(deque())
            elif event.kind is Kind.SENT:
                sent.expect(len(self._waits), event.time_ns, event.frames)
                pieces[-1].append(event)
            else:
                pieces[-1].append(event)
        self._pieces = pieces
        self._finish_piece()

    # The clock

    def read_clock(self) -> int:
        """Return the time that the recorded controller read here; the newest known one where it did not read it."""
        piece = self._pieces[self._moment]
        if piece and piece[0].kind is Kind.READ:
            self._now_ns = piece.popleft().time_ns
        return self._now_ns

    def wait_until(self, t_ns: int) -> int:
        """End the wait when the recorded one ended. A wait that was not recorded ends on time."""
        while (wait := self._next_wait(t_ns + 1)) is not None:
            self._pass(wait)
            if wait.other_ns == t_ns:
                break
        else:
            if self._moment == len(self._waits):
                raise LinkError(_END)
        self._now_ns = max(self._now_ns, t_ns)
        return self._now_ns - t_ns

    def _next_wait(self, before_ns: int) -> _Event | None:
        """Return the next recorded wait, if it was for an earlier time than this."""
        wait = self._waits[self._moment] if self._moment < len(self._waits) else None
        return wait if wait is not None and wait.other_ns < before_ns else None

    def _pass(self, wait: _Event) -> None:
        """Let the next recorded wait end. What was not read before it can be read after it."""
        left = [
            event._replace(kind=Kind.RECEIVED) if event.kind is Kind.ARRIVED else event
            for event in self._pieces[self._moment]
            if event.kind in (Kind.RECEIVED, Kind.ARRIVED, Kind.LOST, *_SOURCES)
        ]
        self._moment += 1
        self._sent.pass_to(self._moment)
        self._pieces[self._moment].extendleft(reversed(left))
        self._now_ns = wait.after_ns

    # The link

    def reopen(self) -> None:
        piece = self._pieces[self._moment]
        if piece and piece[0].kind is Kind.LOST:
            raise LinkError(piece.popleft().body.decode())

    def send(self, frame: Frame) -> None:
        self.reopen()
        self.sent_frames += 1
        self._sent.sent(self._moment, self._now_ns, frame)
        event = next((one for one in self._pieces[self._moment] if one.kind is Kind.SENT), None)
        if event is not None and any(one.id == frame.id for one in event.frames):
            if len(event.frames) == 1 or frame == event.frames[-1]:
                self._skip_to(event)
            self._now_ns = max(self._now_ns, event.time_ns)
        self._finish_piece()

    def receive(self, timeout_ns: int) -> Received | None:
        event = self._next_arrival()
        if event is None or (event.kind is Kind.ARRIVED and not timeout_ns):
            self._now_ns += timeout_ns
            return None
        self._skip_to(event)
        self._now_ns = max(self._now_ns, event.time_ns)
        self._finish_piece()
        if event.kind is Kind.LOST:
            raise LinkError(event.body.decode())
        if event.kind is Kind.EMPTY:
            return None
        self.received_frames += len(event.frames)
        return Received(event.frames, event.other_ns)

    def _next_arrival(self) -> _Event | None:
        others = (Kind.SENT, Kind.READ, *_SOURCES)
        return next((event for event in self._pieces[self._moment] if event.kind not in others), None)

    def _skip_to(self, event: _Event) -> None:
        """Remove an event, and what the recorded controller read from its clock before it."""
        piece = self._pieces[self._moment]
        place = next(i for i, one in enumerate(piece) if one is event)
        self._pieces[self._moment] = deque(one for i, one in enumerate(piece) if i > place or one.kind is not Kind.READ)
        self._pieces[self._moment].remove(event)

    def told(self, kind: Kind) -> Sequence[_Event]:
        piece = self._pieces[self._moment]
        found = [event for event in piece if event.kind is kind]
        for event in found:
            self._skip_to(event)
        self._finish_piece()
        return found

    def _finish_piece(self) -> None:
        """After all of a piece the time is that at which the recorded controller began its next wait."""
        if not self._pieces[self._moment] and self._moment < len(self._waits):
            wait = self._waits[self._moment]
            # It chose that wait before this time: the tick that it waited for was not over yet.
            self._now_ns = max(self._now_ns, min(wait.time_ns, wait.other_ns))


class _Truths:
    """The true poses of a run."""

    def __init__(self, told: Callable[[Kind], Sequence[_Event]]) -> None:
        self._told = told
        self._newest: PoseFix | None = None

    def poll(self) -> PoseFix | None:
        if told := self._told(Kind.TRUTH):
            self._newest = truth_of(told[-1].body)
        return self._newest

    def close(self) -> None: ...


class _Fixes:
    """The pose fixes of a run."""

    def __init__(self, told: Callable[[Kind], Sequence[_Event]]) -> None:
        self._told = told
        self._count = 0

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        found = [fix for event in self._told(Kind.FIXES) for fix in fixes_of(event.body)]
        self._count += len(found)
        return found

    def skip(self) -> None: ...

    def restart(self) -> None: ...

    def figures(self) -> dict[str, int]:
        return {"received": self._count}

    def close(self) -> None: ...

"""One run of the catalogue in a worker process, with the safety judge around the robot.

The outcome holds the judge's findings, how the run ended, and what its recording lacks.
"""

import array
import math
import uuid
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, cast

import numpy as np

from firmware_protocol.extension import library
from firmware_protocol.framer import Deframer
from firmware_protocol.framing import Frame
from firmware_protocol.host import HostNode
from hil.addons.batch.catalogue.fault_cases import Ending
from hil.addons.batch.catalogue.safety import Limits, MotorsJudge, SafetyJudge, Tick
from hil.addons.batch.job import FAILED, PASSED, Job, Outcome
from hil.addons.batch.run import attempt
from hil.core.outputs import claim
from hil.record import viewing
from hil.record.contents import DamagedError
from hil.record.decode import decode
from hil.record.recording import Recording, RecordingReport
from hil.robot.virtual import EmulatedDevice
from hil.runtime.assembly import RunOptions, RunResult
from hil.runtime.robots import node_maker
from hil.scenario import Scenario

# Long enough to measure a speed by counts: with 4096 a turn, one in 10 ms is 0.15 rad/s.
_SPEED_TICKS = 10


class WatchedNode(HostNode):
    """A ``HostNode`` for one life of the firmware, from power on to power off, with the same arguments and errors.

    Bytes are passed on frame by frame: the judge gets each frame before the ticks that a following STEP starts. The
    firmware gets the same bytes.
    """

    def __init__(
        self,
        judge: SafetyJudge,
        values: Mapping[str, float],
        exchange_address: int,
        context_address: int,
        **options: Any,
    ) -> None:
        ffi, _ = library()
        self._judge = judge
        self._deframer = Deframer()
        self._plant = ffi.cast("wheel_plant_exchange", exchange_address)
        self._plant_context = ffi.cast("void *", context_address)
        self._no_drive = ffi.NULL
        self._watch = ffi.callback(
            "int(void *, const wheel_drive *, wheel_sense *)", self._exchange, error=1, onerror=self._fail
        )
        self._error: BaseException | None = None
        self._rad_s_a_count = 2.0 * math.pi / values["counts_per_revolution"] * 1000.0
        self._n_m_a = values["torque_constant_n_m_a"]
        self._counts: deque[tuple[int, ...]] = deque(maxlen=_SPEED_TICKS + 1)
        self._motor_n_m = (0.0,) * 4
        watchdog_ticks, ramp_ticks = (round(values[name] * 1000.0) for name in ("watchdog_s", "ramp_s"))
        judge.power_on(Limits(watchdog_ticks, ramp_ticks, values["torque_limit_n_m"]))
        super().__init__(values, int(ffi.cast("uintptr_t", self._watch)), 0, **options)

    def feed(self, data: bytes) -> None:
        start = 0
        while start < len(data):
            end = data.find(b"\0", start) + 1 or len(data)
            piece = data[start:end]
            for frame in self._deframer.feed(piece):
                self._judge.observe(frame)
            super().feed(piece)
            self._check()
            start = end

    def receive(self, frame: Frame) -> None:
        self._judge.observe(frame)
        super().receive(frame)
        self._check()

    def run(self, ticks: int) -> None:
        super().run(ticks)
        self._check()

    def _exchange(self, _context: object, drive: Any, sense: Any) -> int:
        failed: int = self._plant(self._plant_context, drive, sense)
        if drive != self._no_drive:
            given = (self.look().set_point_rad_s, tuple(drive.torque_n_m), tuple(drive.duty))
            self._judge.hold(Tick(bool(drive.enabled), *given, self._speeds_rad_s(), self._motor_n_m))
        self._counts.append(tuple(sense.count))
        self._motor_n_m = tuple(self._n_m_a * current_a for current_a in sense.current_a)
        return failed

    def _speeds_rad_s(self) -> tuple[float, ...]:
        """Return the mean speeds over the newest ticks from the encoders' counts, which wrap at 16 bits."""
        if len(self._counts) < 2:
            return (0.0,) * 4
        factor = self._rad_s_a_count / (len(self._counts) - 1)
        pairs = zip(self._counts[0], self._counts[-1], strict=True)
        return tuple(((new - old + 0x8000 & 0xFFFF) - 0x8000) * factor for old, new in pairs)

    def _fail(self, _kind: type[BaseException], error: BaseException, _trace: object) -> None:
        self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error


# Longer than the drives may hold the wheels after the ramp.
_LEFT_ALONE_TICKS = 1100
_HINT = "set loop.rearm = true"


class RecordingHere:
    """A recording that is written in this process when the run is over, by the recorder's own writer.

    A recorder process takes half a second and more to start, and the file is the same. For lockstep, where the run
    waits for it. Raises BadInputError when the file exists or cannot be written.
    """

    rows_dropped = 0
    path: Path

    def __init__(
        self,
        path: Path,
        *,
        properties: Mapping[str, str],
        signals: Sequence[str],
        **_of_a_process: object,
    ) -> None:
        import rerun as rr

        from hil.record.stream import Stream

        self.path = claim("recording", path)
        self._rows = array.array("d")
        self._width = len(signals)
        self._stream = Stream(
            rr.FileSink(self.path),
            recording_id=str(uuid.uuid4()),
            signals=signals,
            properties=properties,
            make_drawing=viewing.part("drawing"),
            path=self.path,
        )

    def put(self, row: bytes) -> None:
        self._rows.frombytes(row)

    def event(self, t_s: float, level: str, text: str) -> None:
        self._stream.event(t_s, level, text)

    def finish(self, summary: Mapping[str, object], *, keep_live: bool = False) -> RecordingReport:
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, self._width)
        if len(rows):
            self._stream.rows(rows)
        self._stream.finish(summary, {"rows_written": len(rows), "rows_dropped": 0})
        self._stream.close()
        return RecordingReport(self.path, len(rows), len(rows), 0, 0, 0, None, (self.path,))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release nothing; a recording that was not finished is of no use."""


def run(job: Job, scenario: Scenario) -> Outcome:
    """Do a trial and judge it. Its recording is removed when nothing is wrong."""
    robot = _Motors(scenario) if scenario.device.is_makers else _Watched()
    recording = Path(job.recording)

    def judge(result: RunResult) -> Outcome:
        problems = [*robot.unsafe(result), *_wrong(job.options, result), *_unrecorded(result, recording)]
        if not problems:
            recording.unlink()
        figures = {
            "applied": [row["applied"] for row in result.metrics["fault"]],
            "recoveries": len(result.metrics["recoveries"]),
            "silent_rad_s": robot.judge.silent_rad_s,
            "silent_ticks": robot.judge.silent_ticks,
        }
        status, kept = (FAILED, job.recording) if problems else (PASSED, None)
        details = {"ending": _ending(result)}
        return Outcome(job.key, status, "; ".join(problems) or None, figures, details, recording=kept)

    options = RunOptions(
        record=recording,
        make_node=robot.power_on,
        make_recording=RecordingHere if job.options["records_here"] else Recording,
        linger=robot.left_alone,
    )
    return attempt(job, scenario, judge, options)


class _Motors:
    """Third-party motor controllers, with their judge at the plant port; used like ``_Watched``."""

    def __init__(self, scenario: Scenario) -> None:
        self._make = node_maker(scenario.device)
        self.judge = MotorsJudge(scenario.firmware, scenario.controller.mode)
        self._node: EmulatedDevice | None = None

    def power_on(self, *arguments: Any, **options: Any) -> EmulatedDevice:
        node = self._node = cast(EmulatedDevice, self._make(*arguments, **options))
        node.on_tick = self.judge.hold
        return node

    def left_alone(self) -> None:
        assert self._node is not None
        self._node.run(self.judge.left_alone_ticks)

    def unsafe(self, result: RunResult) -> Iterator[str]:
        return (f"unsafe: {complaint}" for complaint in self.judge.complaints(result.signals))


class _Watched:
    """The robot of a run, with the judge around its firmware, also after a reset."""

    def __init__(self) -> None:
        self.judge = SafetyJudge()
        self._node: WatchedNode | None = None
        self._ticks = 0

    def power_on(self, values: Mapping[str, float], *plant: int, **options: Any) -> WatchedNode:
        """Make a firmware; the arguments are those of ``HostNode``."""
        self._node = WatchedNode(self.judge, values, *plant, **options)
        self._ticks = round((values["watchdog_s"] + values["ramp_s"]) * 1000.0) + _LEFT_ALONE_TICKS
        return self._node

    def left_alone(self) -> None:
        """Let the robot run on without a host: it has to stop on its own."""
        assert self._node is not None
        self._node.run(self._ticks)

    def unsafe(self, _result: RunResult) -> Iterator[str]:
        """Yield what the judge found."""
        if self.judge.violations:
            yield f"unsafe in {self.judge.violation_ticks} ticks: {self.judge.violations[0]}"
        if not (self.judge.driven_ticks and self.judge.silent_ticks):
            yield "the robot was never driven or never left alone, so nothing is shown"


def _ending(result: RunResult) -> str:
    """Return how a run came out: an ``Ending``, or its exit code where there is none for it."""
    if result.failure is None:
        return Ending.REARMS if result.metrics["recoveries"] else Ending.GOES_ON
    return Ending.ENDS if result.exit_code == 3 else f"exit code {result.exit_code}"


def _wrong(trial: Mapping[str, Any], result: RunResult) -> Iterator[str]:
    found, metrics, failure = _ending(result), result.metrics, result.failure
    if found not in trial["allowed"]:
        yield f"expected {' or '.join(trial['allowed'])}, but it {found}"
        if failure is not None:
            yield str(failure)
    if failure is None and metrics["commands_refused"]:
        yield f"the law gave no number {metrics['commands_refused']} times"
    # In real time a busy machine stalls runs as short as these.
    if failure is None and metrics["mode"] == "lockstep":
        yield from (row["text"] for row in metrics["allow"] if not row["passed"])
    for row in metrics["fault"]:
        if not row["applied"] and (failure is None or row["start_s"] < _last_s(result)):
            yield f"{row['text']} was never applied"
    lost = [(recovery["why"], trial["causes"]) for recovery in metrics["recoveries"]]
    for why, causes in lost if failure is None else [*lost, (str(failure), trial["causes_of_end"])]:
        if not any(cause in why for cause in causes):
            yield f"the robot was lost, but not for {' or '.join(causes) or 'any fault'}: {why}"
    if failure is not None and not trial["rearm"] and _HINT not in str(failure):
        yield f"it ended without the word that loop.rearm would help: {failure}"


def _last_s(result: RunResult) -> float:
    return float(result.signals["loop.t_s"][-1]) if result.metrics["ticks"] else 0.0


def _unrecorded(result: RunResult, recording: Path) -> Iterator[str]:
    """Yield the missing parts of the recording, read back from its file."""
    try:
        held, _ = decode(recording)
    except (DamagedError, OSError) as error:
        yield f"the recording does not open: {error}"
        return
    ticks, dropped = result.metrics["ticks"], result.metrics["recorded"]["dropped"]  # in real time rows may be
    if held["rows"] + dropped != ticks:
        yield f"the recording has {held['rows']} rows of {ticks}, {dropped} dropped"
    texts = [text for _, _, text in held["events"]]
    for row in result.metrics["fault"]:
        if row["start_s"] <= _last_s(result) and f"fault begins: {row['text']}" not in texts:
            yield f"the recording has no event of {row['text']}"
    if result.failure is not None and str(result.failure) not in texts:
        yield "the recording has no event of what ended the run"

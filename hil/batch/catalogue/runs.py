"""One run of the catalogue in a worker process, with the safety judge around the robot.

The outcome holds the judge's findings, how the run ended, and what its recording lacks.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.batch.catalogue.judge import SafetyJudge
from hil.batch.catalogue.motors import MotorsJudge
from hil.batch.catalogue.recording import RecordingHere
from hil.batch.catalogue.watched import WatchedNode
from hil.batch.job import FAILED, PASSED, Job, Outcome
from hil.batch.run import attempt
from hil.drivers.emulated import EmulatedMotors
from hil.faults.cases import Outcome as Ending
from hil.record import Recording
from hil.review.contents import DamagedError
from hil.review.decode import decode
from hil.runtime.assembly import RunOptions, RunResult
from hil.runtime.robots import node_maker
from hil.scenario import Scenario

# Longer than the drives may hold the wheels after the ramp.
_LEFT_ALONE_TICKS = 1100
_HINT = "set loop.rearm = true"


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
        self._node: EmulatedMotors[Any] | None = None

    def power_on(self, *arguments: Any, **options: Any) -> EmulatedMotors[Any]:
        node = self._make(*arguments, **options)
        assert isinstance(node, EmulatedMotors)
        node.on_tick = self.judge.hold
        self._node = node
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
        """Let the robot run on without a host: it has to come to rest by itself."""
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
    """Yield what is wrong with how the run ended and with the reasons in its messages."""
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
    """Return the scenario's time at the end of a run."""
    return float(result.signals["loop.t_s"][-1]) if result.metrics["ticks"] else 0.0


def _unrecorded(result: RunResult, recording: Path) -> Iterator[str]:
    """Yield what is missing in the recording, as it is read back from the file."""
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

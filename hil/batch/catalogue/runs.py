"""One run of the catalogue: a scenario with faults, the safety judge around the robot, and what to say of it."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from hil.batch.catalogue.judge import SafetyJudge
from hil.batch.catalogue.motors import MotorsJudge
from hil.batch.catalogue.watched import WatchedNode
from hil.batch.old_pool import Work
from hil.batch.recording import RecordingHere
from hil.core.errors import HilError
from hil.core.types import CommandMode
from hil.drivers.emulated_motors import EmulatedMotors
from hil.faults.cases import DURATION_S, Outcome, Row
from hil.record import Recording
from hil.review.contents import DamagedError
from hil.review.decode import decode
from hil.runtime.assembly import RunOptions, RunResult, run_scenario
from hil.runtime.robots import node_maker
from hil.scenario import Scenario, format_value, load

OK = "ok"

# What a case says of the speed command is meant of the torque command where the law gives torques.
_IN_TORQUE_MODE = {
    "WHEEL_COMMAND": "TORQUE_COMMAND",
    "wheel.fl.speed_command_rad_s": "wheel.fl.torque_command_n_m",
}
# Longer than the drives may hold the wheels after the ramp.
_LEFT_ALONE_TICKS = 1100
_OPTION = "--set"
_HINT = "set loop.rearm = true"


class Job(NamedTuple):
    """A run to do; plain values, for it goes to a worker as JSON.

    ``causes`` are words of which one is in each sentence that tells why the robot was lost, ``causes_of_end`` those for
    what ends the run. ``recording`` is the file to record to; with ``records_here`` the process of the run writes it
    itself.
    """

    fault: str
    link: str
    mode: str
    scenario: str
    sets: Sequence[str]
    rows: Sequence[Row]
    rearm: bool
    allowed: Sequence[str]
    causes: Sequence[str]
    causes_of_end: Sequence[str]
    recording: str
    records_here: bool


class Verdict(NamedTuple):
    """What became of a job. ``verdict`` is "ok" or what is wrong; ``silent_rad_s`` is the greatest set point that was
    seen where it has to be zero, in ``silent_ticks`` ticks. What a run that never ended did not tell is None.
    """

    fault: str
    link: str
    mode: str
    rearm: bool
    verdict: str
    outcome: str | None
    applied: Sequence[int] | None
    recoveries: int | None
    silent_rad_s: float | None
    silent_ticks: int | None
    wall_s: float
    recording: str | None

    @property
    def is_ok(self) -> bool:
        """Whether the run was as it should be."""
        return self.verdict == OK


class _Robot(Protocol):
    """The robot of a run with its judge."""

    def power_on(self, *arguments: Any, **options: Any) -> Any:
        """Make its firmware, or its motor controllers."""

    def left_alone(self) -> None:
        """Let the robot's time go on without a host, in which all has to come to rest by itself."""

    def unsafe(self, result: RunResult) -> Iterator[str]:
        """Say what the judge found."""

    def silence(self) -> tuple[float | None, int | None]:
        """Return the greatest set point that was seen where it has to be zero, and in how many ticks."""


class _Motors:
    """Motor controllers of another maker, with their judge at the plant port."""

    def __init__(self, scenario: Scenario) -> None:
        self._make = node_maker(scenario)
        self._judge = MotorsJudge(scenario)
        self._node: EmulatedMotors | None = None

    def power_on(self, *arguments: Any, **options: Any) -> EmulatedMotors:
        node = self._make(*arguments, **options)
        assert isinstance(node, EmulatedMotors)
        node.on_tick = self._judge.hold
        self._node = node
        return node

    def left_alone(self) -> None:
        assert self._node is not None
        self._node.run(self._judge.left_alone_ticks)

    def unsafe(self, result: RunResult) -> Iterator[str]:
        yield from (f"unsafe: {complaint}" for complaint in self._judge.complaints(result.signals))

    def silence(self) -> tuple[None, None]:
        return None, None


class _Watched:
    """The robot of a run, with the judge around each of its lives."""

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
        """Let the robot's time go on without a host, in which all has to come to rest by itself."""
        assert self._node is not None
        self._node.run(self._ticks)

    def unsafe(self, _result: RunResult) -> Iterator[str]:
        judge = self.judge
        if judge.violations:
            yield f"unsafe in {judge.violation_ticks} ticks: {judge.violations[0]}"
        if not (judge.driven_ticks and judge.silent_ticks):
            yield "the robot was never driven or never left alone, so nothing is shown"

    def silence(self) -> tuple[float, int]:
        return self.judge.silent_rad_s, self.judge.silent_ticks


def lost(job: Job, verdict: str, wall_s: float) -> Verdict:
    """Return the verdict on a run that told nothing."""
    return Verdict(job.fault, job.link, job.mode, job.rearm, verdict, None, None, None, None, None, wall_s, None)


WORK = Work("hil.batch.catalogue.worker", Verdict, lost)
"""What the pool is told of a run of the catalogue."""


def perform(job: Job) -> Verdict:
    """Do a run and judge it. Whatever is no HilError is raised: it is a defect of ours."""
    began = time.monotonic()
    recording = Path(job.recording)
    try:
        chosen = scenario(job)
        robot: _Robot = _Motors(chosen) if chosen.device.is_makers else _Watched()
        result = run_scenario(
            chosen,
            RunOptions(
                record=recording,
                make_node=robot.power_on,
                make_recording=RecordingHere if job.records_here else Recording,
                linger=robot.left_alone,
            ),
        )
    except HilError as error:
        return lost(job, f"refused: {error}", time.monotonic() - began)
    problems = [*robot.unsafe(result), *_wrong(job, result), *_unrecorded(result, recording)]
    if not problems:
        recording.unlink()
    return Verdict(
        job.fault,
        job.link,
        job.mode,
        job.rearm,
        "; ".join(problems) or OK,
        outcome(result),
        [row["applied"] for row in result.metrics["fault"]],
        len(result.metrics["recoveries"]),
        *robot.silence(),
        time.monotonic() - began,
        str(recording) if problems else None,
    )


def scenario(job: Job) -> Scenario:
    """Return the job's scenario. Raises BadInputError."""
    changes = [
        *job.sets,
        "expect=[]",
        f"loop.duration_s={DURATION_S}",
        f"loop.rearm={format_value(job.rearm)}",
    ]
    base = load(job.scenario, set=[*changes, "fault=[]"], mode=job.mode, link=job.link)
    if base.plant.fmu == "mecanum":
        # What the faults of floor and battery need of the shipped plant.
        changes += ["plant.start.contact=slip", "plant.start.drive=current"]
    rows: list[Row] = list(job.rows)
    if base.controller.mode is CommandMode.TORQUE:
        rows = [{**row, "target": _IN_TORQUE_MODE.get(str(row["target"]), row["target"])} for row in rows]
    faulty = load(job.scenario, set=[*changes, f"fault={format_value(rows)}"], mode=job.mode, link=job.link)
    return _without_gains_of_another_law(faulty)


def _without_gains_of_another_law(scenario: Scenario) -> Scenario:
    """Where the law was given by an option, leave only the gains that were too: the file's are of the file's law."""
    table, where = scenario.controller, scenario.provenance
    if where["controller.law"] != _OPTION:
        return scenario
    gains = {name: value for name, value in table.gains.items() if where[f"controller.gains.{name}"] == _OPTION}
    return replace(scenario, controller=replace(table, gains=gains))


def outcome(result: RunResult) -> str:
    """Return how a run came out, as ``Outcome`` has it, or its exit code where it has no word for that."""
    if result.failure is None:
        return Outcome.REARMS if result.metrics["recoveries"] else Outcome.GOES_ON
    return Outcome.ENDS if result.exit_code == 3 else f"exit code {result.exit_code}"


def _wrong(job: Job, result: RunResult) -> Iterator[str]:
    """Say what is wrong with how the run came out and with what it says."""
    found, metrics, failure = outcome(result), result.metrics, result.failure
    if found not in job.allowed:
        yield f"expected {' or '.join(job.allowed)}, but it {found}"
        if failure is not None:
            yield str(failure)
    if failure is None and metrics["commands_refused"]:
        yield f"the law gave no number {metrics['commands_refused']} times"
    if failure is None and job.mode == "lockstep":  # in real time a busy machine stalls runs as short as these
        yield from (row["text"] for row in metrics["allow"] if not row["passed"])
    last_s = _last_s(result)
    for row in metrics["fault"]:
        if not row["applied"] and (failure is None or row["start_s"] < last_s):
            yield f"{row['text']} was never applied"
    for recovery in metrics["recoveries"]:
        yield from _unexplained(recovery["why"], job.causes)
    if failure is not None:
        yield from _unexplained(str(failure), job.causes_of_end)
        if not job.rearm and _HINT not in str(failure):
            yield f"it ended without the word that loop.rearm would help: {failure}"


def _last_s(result: RunResult) -> float:
    """Return the scenario's time at the end of a run."""
    return float(result.signals["loop.t_s"][-1]) if result.metrics["ticks"] else 0.0


def _unexplained(why: str, causes: Sequence[str]) -> Iterator[str]:
    """Say when a sentence that tells why the robot was lost names none of the causes."""
    if not any(cause in why for cause in causes):
        yield f"the robot was lost, but not for {' or '.join(causes) or 'any fault'}: {why}"


def _unrecorded(result: RunResult, recording: Path) -> Iterator[str]:
    """Say what is missing in the recording, read back from the file."""
    try:
        held, _ = decode(recording)
    except (DamagedError, OSError) as error:
        yield f"the recording does not open: {error}"
        return
    ticks, dropped = result.metrics["ticks"], result.metrics["recorded"]["dropped"]  # in real time rows may be
    if held["rows"] + dropped != ticks:
        yield f"the recording has {held['rows']} rows of {ticks}, {dropped} dropped"
    texts = [text for _, _, text in held["events"]]
    last_s = _last_s(result)
    for row in result.metrics["fault"]:
        if row["start_s"] <= last_s and f"fault begins: {row['text']}" not in texts:
            yield f"the recording has no event of {row['text']}"
    if result.failure is not None and str(result.failure) not in texts:
        yield "the recording has no event of what ended the run"

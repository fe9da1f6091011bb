"""The whole controller, as it is now, repeated on a recorded run: does it do the same again?

Client, freshness, estimator, reference, law and guard get what the recorded ones got, tick by tick, from the recorded
robot (``recorded_robot.py``). What they compute and send is compared with the recording. Its robot does not follow:
once a command differs, its answers belong to the old commands, and later differences show no more than a direction.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.addons.replay.recorded_robot import FrameDifference, RecordedRobot
from hil.core.errors import BadInputError, OverdueError
from hil.judge.recorded import recorded_scenario, scenario_of
from hil.record.contents import Series
from hil.record.reader import RecordedRun
from hil.runtime.assembly import run_scenario
from hil.runtime.run_options import RunOptions
from hil.scenario import Scenario
from hil.scenario.load import from_values, key_and_value

PARTS: Mapping[str, Sequence[str]] = {
    "feedback": ("wheel.*.speed_rad_s", "wheel.*.current_a", "wheel.*.temperature_degc", "robot.*", "battery.*"),
    "freshness": ("link.feedback_age_ms", "link.lost", "link.latency_ms", "guard.held"),
    "estimate": ("estimator.*", "pose.*", "twist.*"),
    "reference": ("reference.*",),
    "law": ("gain.*",),
    "guard": ("guard.saturated", "guard.limit", "guard.taken_n_m"),
    "command": ("wheel.*.speed_command_rad_s", "wheel.*.torque_command_n_m"),
    "client": ("link.rtt_ms", "link.clock_*"),
    "row": ("truth.*", "error.*", "loop.t_s"),
}
"""The parts of a controller in the order in which data flow through them, each with its signals. A law's own signals
belong to it."""
_OF_MACHINE = ("loop.lateness_us", "loop.tick_us", "loop.deadline_misses", "link.*bytes", "link.load_percent")
_OF_CLOCK = ("link.feedback_age_ms", "link.rtt_ms", "link.clock_*")
"""Signals of a run in real time that depend on the instant at which a line of code was reached."""
_NOT_COMPARED = ("loop.tick", "link.rejected", "link.sent", "link.received")


class SignalDifference(NamedTuple):
    """A signal that differs: its part, its name, the first such tick with its time [s] and both values, and the most.

    ``most`` is the largest absolute difference from then on, at ``most_s``; NaN where only one of both has a value.
    """

    part: str
    signal: str
    tick: int
    t_s: float
    recorded: float
    now: float
    most: float
    most_s: float


@dataclass(frozen=True, slots=True)
class Replay:
    """The comparison of a controller with a recorded run.

    Attributes:
        ticks: number of ticks that were compared.
        frames: number of frames that were the same.
        frames_differ: number of frames that differ, were not sent, or were not recorded.
        first_frame: the first of these, or None.
        signals: those that differ by more than was allowed, in the order of their first difference and of the parts.
        part: the part that differs first; None if all is equal.
        open_s: the time from which on the recorded robot does not belong to the commands any more; None without one.
        notes: sentences on what was not compared, and why.
        result: the run of the controller as it is now, for a look.
    """

    ticks: int
    frames: int
    frames_differ: int
    first_frame: FrameDifference | None
    signals: Sequence[SignalDifference]
    part: str | None
    open_s: float | None
    notes: Sequence[str]
    result: Any

    @property
    def is_equal(self) -> bool:
        return not self.signals and self.first_frame is None


def replay(
    run: RecordedRun,
    *,
    scenario: Scenario | None = None,
    tolerances: Mapping[str, float] | None = None,
    record: Path | None = None,
    force: bool = False,
) -> Replay:
    """Repeat a recorded run with the controller of this version; ``run`` was read with its journal.

    ``scenario`` takes the place of the recorded one. ``tolerances`` are absolute, by signal or pattern. ``record`` is
    the file for a recording of the replay. Raises BadInputError for a recording without journal or scenario, and as
    ``run_scenario``; OverdueError for a law that does not return.
    """
    if not run.journal:
        raise BadInputError(
            f"{run.path}: it does not hold what its controller was told, so only a law can be replayed (--law LAW); "
            "record it again, without record.frames = false"
        )
    notes = list(run.notes)
    if scenario is None:
        scenario, lacks = recorded_scenario(run)
        if scenario is None:
            raise BadInputError(f"{run.path}: {lacks[0]}; give the scenario with --scenario FILE")
    is_lockstep = scenario.loop.mode == "lockstep"
    if run.properties.get("mode", scenario.loop.mode) != scenario.loop.mode:
        raise BadInputError(
            f"{run.path} is of mode {run.properties['mode']}, and the scenario of mode {scenario.loop.mode}; a replay "
            "has the mode of its recording"
        )
    robot = RecordedRobot(run.journal, is_lockstep=is_lockstep, is_ours=not scenario.device.is_makers)
    # The recorded robot is here, whatever link led to it.
    scenario = replace(scenario, link=replace(scenario.link, url="memory:"))
    options = RunOptions(replayed=robot, record=record, existing="replace" if force else "refuse", lenient=True)
    result = run_scenario(scenario, options)
    if isinstance(result.failure, OverdueError):
        raise result.failure
    ticks, differ, open_s = _compared(run, result.signals, tolerances or {}, is_lockstep=is_lockstep)
    recorded_ticks = len(run.signals["loop.tick"])
    if robot.damage is not None:
        notes.append(f"{robot.damage}; the run was repeated up to there")
    if ticks < recorded_ticks:
        why = "" if result.failure is None else f": {str(result.failure).partition(';')[0]}"
        notes.append(f"{recorded_ticks - ticks} of its {recorded_ticks} ticks were not repeated{why}")
    first = robot.frames.first
    return Replay(
        ticks,
        robot.frames.equal,
        robot.frames.differences,
        first,
        differ,
        _part(differ, first),
        open_s,
        notes,
        result,
    )


def changed(run: RecordedRun, sets: Sequence[str]) -> RecordedRun:
    """Return a run whose recorded scenario has other values, given as KEY=VALUE. Raises BadInputError."""
    values = scenario_of(run) | dict(map(key_and_value, sets))
    from_values(run.properties.get("scenario_name", ""), values, {})  # it raises for a value that is none
    return replace(run, properties=run.properties | {"scenario": json.dumps(values)})


def _compared(
    run: RecordedRun, now: Mapping[str, Series], tolerances: Mapping[str, float], *, is_lockstep: bool
) -> tuple[int, list[SignalDifference], float | None]:
    """Return how many ticks both have, the signals that differ there, and from when on commands do."""
    _, here, there = np.intersect1d(run.signals["loop.tick"], now["loop.tick"], return_indices=True)
    tick, t_s = run.signals["loop.tick"][here], run.signals["loop.t_s"][here]
    left_out = [*_OF_MACHINE, *_NOT_COMPARED, *(() if is_lockstep else _OF_CLOCK)]
    order = list(PARTS)
    found = []
    for name, series in run.signals.items():
        if name not in now or any(fnmatchcase(name, pattern) for pattern in left_out):
            continue
        old, new = series[here], now[name][there]
        allowed = max((most for pattern, most in tolerances.items() if fnmatchcase(name, pattern)), default=0.0)
        apart = np.abs(new - old)
        differs = (apart > allowed) | (np.isnan(old) != np.isnan(new))
        if differs.any():
            place = int(np.argmax(differs))
            most = int(np.nanargmax(apart)) if not np.isnan(apart).all() else place
            found.append(
                SignalDifference(
                    part_of(name),
                    name,
                    int(tick[place]),
                    float(t_s[place]),
                    float(old[place]),
                    float(new[place]),
                    float(apart[most]),
                    float(t_s[most]),
                )
            )
    found.sort(key=lambda one: (one.tick, order.index(one.part)))
    open_s = next((one.t_s for one in found if one.part == "command"), None)
    return len(tick), found, open_s


def part_of(signal: str) -> str:
    """Return the part of a controller to which a signal belongs."""
    for part, patterns in PARTS.items():
        if any(fnmatchcase(signal, pattern) for pattern in patterns):
            return part
    return "law"


def _part(differ: Sequence[SignalDifference], frame: FrameDifference | None) -> str | None:
    """Return the part that differs first.

    A command that differs although the inputs of the law are the same is the guard's if it was at a limit, else the
    law's. A frame that differs although no signal does is the client's.
    """
    if not differ:
        return None if frame is None else "client"
    first = differ[0]
    return "law" if first.part == "command" else first.part


def lines(run: RecordedRun, found: Replay) -> Iterator[str]:
    """Yield the lines of a comparison for a terminal."""
    from hil.cli.output import table

    words = f"{found.ticks} ticks, {found.frames} frames"
    if found.is_equal:
        yield f"equal: {words} are as in {run.path}"
    else:
        yield f"different: {found.part} first; {words} were compared with {run.path}"
    if found.first_frame is not None:
        more = f", and {found.frames_differ - 1} more frames" * (found.frames_differ > 1)
        yield f"first frame: {found.first_frame.words}{more}"
    if found.signals:
        yield ""
        head = ("part", "signal", "first at tick", "t [s]", "recorded", "now", "most", "at t [s]")
        shown = [
            (one.part, one.signal, str(one.tick), f"{one.t_s:.3f}", f"{one.recorded:.9g}", f"{one.now:.9g}",
             f"{one.most:.3g}", f"{one.most_s:.3f}")
            for one in found.signals
        ]  # fmt: skip
        yield from table([head, *shown])
    if found.open_s is not None:
        yield ""
        yield (
            f"from t = {found.open_s:.3f} s on the commands differ: the recorded robot followed the old ones, so what "
            "differs later shows no more than a direction"
        )
    yield from (f"note: {note}" for note in found.notes)


def as_json(run: RecordedRun, found: Replay) -> dict[str, Any]:
    """Return a comparison as JSON values."""
    frame = found.first_frame
    return {
        "recording": str(run.path),
        "equal": found.is_equal,
        "part": found.part,
        "ticks": found.ticks,
        "frames": {
            "equal": found.frames,
            "differ": found.frames_differ,
            "first": None if frame is None else {"t_s": frame.t_s, "text": frame.words},
        },
        "signals": [one._asdict() for one in found.signals],
        "open_s": found.open_s,
        "notes": list(found.notes),
    }

"""Replay: another law computed afterwards from a recording. Open loop: its commands never drove the robot.

The law gets the inputs of the law that drove the robot, tick by tick: the reference, the state, the command applied at
the last tick and its latency. It is called and reset in the same ticks. The guard limits its commands, which are
compared with the recorded ones. The law that made the run reproduces its own commands.
"""

import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import BadInputError, DeviceError, OverdueError
from hil.core.guard import Guard
from hil.core.outputs import Existing
from hil.core.ports import Controller
from hil.core.signals import pack_row
from hil.core.tick_watch import TickOverdue, TickWatch
from hil.core.types import NAN, WHEEL_NAMES, ZERO_WHEELS, Applied, CommandMode, WheelCommand
from hil.judge.shadows import CommandDifference, command_difference
from hil.judge.words import with_page
from hil.laws.registry import make_controller
from hil.laws.shadows import QUANTITY, short_name
from hil.record import Recording, check_output_path
from hil.review import RecordedRun
from hil.review.replay.recorded import Series, check_signals, model_of, recorded_gains, rows, scenario_of, tuples
from hil.scenario.toml_text import parse_value

__all__ = ["Replay", "replay", "write_replay"]

_LABEL = "open loop: computed afterwards from the recorded states; it never drove the robot"


@dataclass(frozen=True, slots=True)
class Replay:
    """The commands that a law would have given at each tick of a run.

    Attributes:
        path: the recording.
        law: as it was given, without its gains.
        recorded_law: the law that drove the robot.
        mode: the recording's command mode, in which the law is replayed.
        gains: the gains set for the law; the others have their defaults.
        ticks: number of ticks of the recording.
        asked: number of ticks in which the law was called.
        commands_refused: number of replayed commands that were not finite.
        commands: by the name of the recorded signal, NaN where the law was not called, each of shape (ticks,).
        differences: by the name of the recorded signal.
        notes: sentences on inputs of the recorded law that this one did not get.
    """

    path: Path
    law: str
    recorded_law: str
    mode: CommandMode
    gains: Mapping[str, object]
    ticks: int
    asked: int
    commands_refused: int
    commands: Mapping[str, Series]
    differences: Mapping[str, CommandDifference]
    notes: tuple[str, ...]

    def figures(self) -> dict[str, Any]:
        """Return the figures, as ``hil replay --json`` prints them."""
        return {
            "open_loop": True,
            "label": _LABEL,
            "recording": str(self.path),
            "law": self.law,
            "gains": dict(self.gains),
            "recorded_law": self.recorded_law,
            "command": self.mode.name.lower(),
            "ticks": self.ticks,
            "asked": self.asked,
            "commands_refused": self.commands_refused,
            "difference": {name: difference._asdict() for name, difference in self.differences.items()},
            "notes": list(self.notes),
        }


def replay(run: RecordedRun, text: str) -> Replay:
    """Run the law that ``text`` names, as LAW or LAW,KEY=VALUE,... (``dsc,k1_1_s=8``), on a recording's inputs.

    The robot's model is the recording's. If the law drove the recorded run, or was one of its shadows, its recorded
    gains apply; gains in the text replace them. Raises BadInputError for a recording that lacks an input of a law, for
    a wrong law or gains (see ``make_controller``), and when a third-party law raises; OverdueError when a call of the
    law takes longer than the recording's ``loop.tick_limit_s``. A law that never returns ends the process, as in
    ``hil.run``.
    """
    check_signals(run)
    scenario = scenario_of(run)
    spec, *assignments = text.split(",")
    mode = CommandMode[str(scenario["controller.command"]).upper()]
    gains = recorded_gains(scenario, spec) | _given(text, assignments)
    model = model_of(run, scenario)
    law = make_controller(spec, Path.cwd(), model, mode, gains, law_key="--law", gains_key=f"--law {spec}")
    guard = Guard(model.speed_limit_rad_s, model.torque_limit_n_m)
    names = _compared(mode)
    values = array.array("d")
    t_s = run.signals["loop.t_s"]
    watch = TickWatch(
        float(scenario.get("loop.tick_limit_s", 0.0)), lambda: float(t_s[len(values) // len(names)]), lambda _: None
    )
    try:
        with watch:
            for command in _commands(run, law, guard, mode, scenario, watch):
                values.extend(_flat(command, mode))
    except TickOverdue as overdue:
        raise OverdueError(str(overdue)) from None
    table = np.frombuffer(values, dtype=np.float64).reshape(-1, len(names))
    asked = np.isfinite(table[:, 0])
    if not asked.any():
        raise BadInputError(f"{run.path}: the law was called in no tick; nothing can be replayed")
    commands = dict(zip(names, table.T, strict=True))
    return Replay(
        path=run.path,
        law=spec,
        recorded_law=str(scenario["controller.law"]),
        mode=mode,
        gains=gains,
        ticks=len(table),
        asked=int(asked.sum()),
        commands_refused=guard.refused,
        commands=commands,
        differences={
            name: command_difference(t_s[asked], run.signals[name][asked], commands[name][asked]) for name in names
        },
        notes=tuple(_notes(run, scenario)),
    )


def write_replay(run: RecordedRun, replayed: Replay, path: Path, existing: Existing = "refuse") -> None:
    """Record the run again with the replayed commands and their differences beside the recorded ones.

    They are signals ``replay.LAW.wheel.fl.torque_command_n_m`` and ``..._difference_n_m``. ``existing`` says what to do
    if the file exists. Raises BadInputError for a path that cannot be written, or is the recording's own, DeviceError
    when not all could be recorded.
    """
    if path.resolve() == run.path.resolve():
        raise BadInputError(f"--record {path}: this is the recording that is replayed; choose another name")
    check_output_path("recording", path, existing)
    prefix = f"replay.{short_name(replayed.law)}"
    signals = {name: series for name, series in run.signals.items() if not name.startswith(f"{prefix}.")}
    for name, series in replayed.commands.items():
        signals[f"{prefix}.{name}"] = series
        signals[f"{prefix}.{name.replace('_command_', '_difference_')}"] = series - run.signals[name]
    about = f"{replayed.law}, {_LABEL}; it replays {run.path.name}"
    properties = dict(run.properties) | {"replay": about}
    with Recording(path, properties=properties, blocking=True, signals=tuple(signals), existing=existing) as recording:
        for event in run.events:
            recording.event(event.t_s, event.severity, event.text)
        for sentence in (about, *replayed.notes):
            recording.event(float(run.signals["loop.t_s"][0]), "warning", sentence)
        for row in tuples(list(signals.values())):
            recording.put(pack_row(row))
        report = recording.finish(with_page(run.summary) if run.summary else {})
    if not report.complete:
        why = report.error or "not all rows or events could be passed on"
        raise DeviceError(f"recording {path} is incomplete: {why}; {report.rows_written} rows are safe in it")


def _given(text: str, assignments: Sequence[str]) -> dict[str, object]:
    gains: dict[str, object] = {}
    for assignment in assignments:
        key, equals, value = assignment.partition("=")
        if not (key.strip() and equals):
            raise BadInputError(f"--law {text}: {assignment!r} is not a gain; expected key=value, as in dsc,k1_1_s=8")
        gains[key.strip()] = parse_value(value.strip())
    return gains


def _commands(
    run: RecordedRun, law: Controller, guard: Guard, mode: CommandMode, scenario: Mapping[str, Any], watch: TickWatch
) -> Iterator[WheelCommand | None]:
    """Yield the law's command at each tick, after the guard; None where the recorded law was not called."""
    period_ns = 1_000_000_000 // int(scenario["loop.rate_hz"])
    stale_ns = round(1e9 * float(scenario["firmware.watchdog_s"]))
    rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
    latency_s = sum(float(scenario.get(f"link.{way}_latency_s", 0.0)) for way in ("command", "feedback"))
    applied = Applied(rest, False, latency_s)
    before: int | None = None  # number of the last tick in which the law was called
    for row in rows(run, mode):
        if row.is_away:
            yield None
            before = None
            applied = Applied(rest, False, row.applied.latency_s)
            continue
        if row.is_held:
            before = None  # after a hold the law is reset
            yield None
        else:
            watch.turn += 1
            if before is None or (row.tick - before) * period_ns > stale_ns:
                law.reset(row.state, row.reference)  # as hil.runtime.tick does after so many skipped ticks
                before = row.tick - 1
            dt_s = (row.tick - before) * period_ns * 1e-9
            command, _ = guard.apply(law.update(row.reference, row.state, applied, dt_s))
            watch.turn += 1
            yield command
            before = row.tick
        applied = row.applied


def _compared(mode: CommandMode) -> list[str]:
    """Return the signals of a command: in speed mode the torque feedforward is part of it."""
    quantities = [QUANTITY[CommandMode.SPEED]] * (mode is CommandMode.SPEED) + [QUANTITY[CommandMode.TORQUE]]
    return [f"wheel.{wheel}.{quantity}" for quantity in quantities for wheel in WHEEL_NAMES]


def _flat(command: WheelCommand | None, mode: CommandMode) -> tuple[float, ...]:
    if command is None:
        return (NAN,) * len(_compared(mode))
    speed: tuple[float, ...] = command.speed_rad_s if mode is CommandMode.SPEED else ()
    return speed + command.torque_n_m


def _notes(run: RecordedRun, scenario: Mapping[str, Any]) -> Iterator[str]:
    ticks, misses = run.signals["loop.tick"], run.signals["loop.deadline_misses"]
    if ticks[0] > 0.0:
        yield f"the recording begins at tick {ticks[0]:.0f}: the law was reset there, and not where the run began"
    missing = int(ticks[-1] - ticks[0] - (len(ticks) - 1) - (misses[-1] - misses[0]))
    if missing > 0:
        yield f"{missing} ticks were not recorded: the recorded law got more inputs than this one"
    for key, target in scenario.items():
        if key.startswith("fault.") and key.endswith(".target") and "_command_" in str(target):
            yield f"the run had a fault of {target}, which changed the applied command, not the law's output"

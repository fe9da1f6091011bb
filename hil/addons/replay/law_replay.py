"""Replay: another law computed afterwards from a recording. Open loop: its commands never drove the robot.

The law gets the inputs of the law that drove the robot, tick by tick: the reference, the state, the command applied at
the last tick and its latency. It is called and reset in the same ticks. The guard limits its commands, which are
compared with the recorded ones. The law that made the run reproduces its own commands.
"""

import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from math import isnan
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError, OverdueError
from hil.core.guard import Guard
from hil.core.model import RobotModel
from hil.core.ports import Controller
from hil.core.signals import QUANTITY
from hil.core.tick_watch import TickOverdue, TickWatch
from hil.core.types import (
    NAN,
    WHEEL_NAMES,
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.judge.recorded import scenario_of
from hil.laws.law_registry import make_controller
from hil.record.reader import RecordedRun
from hil.scenario.toml_text import parse_value

_Series = npt.NDArray[np.float64]
LABEL = "open loop: computed afterwards from the recorded states; it never drove the robot"
_ROWS_AT_ONCE = 10_000  # as Python's floats they take four times the memory
_POSE, _TWIST = ("x_m", "y_m", "heading_rad"), ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
_ACCELERATION = ("ax_m_s2", "ay_m_s2", "yaw_acceleration_rad_s2")
_INPUTS = (
    *("loop.tick", "guard.held", "guard.saturated", "link.latency_ms"),
    *(f"reference.{name}" for name in (*_POSE, *_TWIST, *_ACCELERATION)),
    *(f"pose.{name}" for name in _POSE),
    *(f"twist.{name}" for name in _TWIST),
    *(f"wheel.{wheel}.{quantity}" for quantity in QUANTITY.values() for wheel in WHEEL_NAMES),
)


class CommandDifference(NamedTuple):
    """Set points of another law minus the recorded ones, of one wheel, in the unit of the signal.

    ``max`` is the largest absolute difference, at ``max_s`` of the run; ``recorded_rms`` is the size of the commands.
    """

    rms: float
    max: float
    max_s: float
    recorded_rms: float


@dataclass(frozen=True, slots=True)
class Replay:
    """The commands that a law would have given at each tick of a run.

    Attributes:
        law: as it was given, without its gains.
        recorded_law: the law that drove the robot.
        gains: the gains set for the law; the others have their defaults.
        asked: number of ticks in which the law was called.
        commands_refused: number of replayed commands that were not finite.
        commands: by the name of the recorded signal, NaN where the law was not called, each of shape (ticks,).
        differences: by the name of the recorded signal.
    """

    law: str
    recorded_law: str
    gains: Mapping[str, object]
    asked: int
    commands_refused: int
    commands: Mapping[str, npt.NDArray[np.float64]]
    differences: Mapping[str, CommandDifference]


def replay(run: RecordedRun, text: str) -> Replay:
    """Run the law that ``text`` names, as LAW or LAW,KEY=VALUE,... (``dsc,k1_1_s=8``), on a recording's inputs.

    The robot's model is the recording's. If the law drove the recorded run, its recorded gains apply; gains in the text
    replace them. Raises BadInputError for a recording that lacks an input of a law, for a wrong law or gains (see
    ``make_controller``), and when a third-party law raises; OverdueError when a call of the law takes longer than the
    recording's ``loop.tick_limit_s``. A law that never returns ends the process, as in ``hil.run``.
    """
    for name in _INPUTS:
        if name not in run.signals:
            raise BadInputError(f"{run.path}: it has no signal {name!r}, which a law needs; record the run again")
    scenario = scenario_of(run)
    spec, *assignments = text.split(",")
    try:
        mode = CommandMode[scenario["controller.command"].upper()]
        model = RobotModel(**_below(scenario, "robot"))
        gains = _recorded_gains(scenario, spec) | _given(text, assignments)
        if not (int(scenario["loop.rate_hz"]) > 0 and float(scenario["firmware.watchdog_s"]) > 0.0):
            raise ValueError("loop.rate_hz and firmware.watchdog_s are more than 0")
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadInputError(
            f"{run.path}: it does not hold the scenario of its run, or that of another version ({error!r}); replay "
            "needs a recording made by 'hil run'"
        ) from error
    law = make_controller(spec, Path.cwd(), model, mode, gains, law_key="--law", gains_key=f"--law {spec}")
    guard = Guard(model.speed_limit_rad_s, model.torque_limit_n_m)
    t_s, values = run.signals["loop.t_s"], array.array("d")  # eight of a tick: speeds and torques
    limit_s = float(scenario.get("loop.tick_limit_s", 0.0))
    watch = TickWatch(limit_s, lambda: float(t_s[len(values) // 8]), lambda _: None)
    try:
        with watch:
            for command in _commands(run, law, guard, mode, scenario, watch):
                values.extend((NAN,) * 8 if command is None else command.speed_rad_s + command.torque_n_m)
    except TickOverdue as overdue:
        raise OverdueError(str(overdue)) from None
    names = [f"wheel.{wheel}.{QUANTITY[one]}" for one in CommandMode for wheel in WHEEL_NAMES]
    table = np.frombuffer(values).reshape(-1, 8)
    if mode is CommandMode.TORQUE:  # in speed mode the torque feedforward is part of the command
        names, table = names[4:], table[:, 4:]
    asked = np.isfinite(table[:, 0])
    if not asked.any():
        raise BadInputError(f"{run.path}: the law was called in no tick; nothing can be replayed")
    commands = dict(zip(names, table.T, strict=True))
    differences = {name: _difference(t_s[asked], run.signals[name][asked], commands[name][asked]) for name in names}
    recorded_law = str(scenario["controller.law"])
    return Replay(spec, recorded_law, gains, int(asked.sum()), guard.refused, commands, differences)


def _difference(t_s: _Series, recorded: _Series, other: _Series) -> CommandDifference:
    """Compare set points at the times ``t_s`` [s], all of shape (n,); ticks where one has no value are left out."""
    known = np.isfinite(other - recorded)
    t_s, recorded, apart = t_s[known], recorded[known], np.abs(other - recorded)[known]
    most = int(np.argmax(apart))
    rms, recorded_rms = (float(np.sqrt(np.mean(one**2))) for one in (apart, recorded))
    return CommandDifference(rms, float(apart[most]), float(t_s[most]), recorded_rms)


def _below(scenario: Mapping[str, Any], table: str) -> dict[str, Any]:
    """Return the values of a table by their keys; JSON's lists are arrays again."""
    values = {key.removeprefix(f"{table}."): value for key, value in scenario.items() if key.startswith(f"{table}.")}
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}


def _recorded_gains(scenario: Mapping[str, Any], spec: str) -> dict[str, object]:
    """Return the gains that the recording has for a law."""
    if _is_same(spec, scenario["controller.law"]):
        return _below(scenario, "controller.gains")
    return {}


def _is_same(spec: str, other: str) -> bool:
    """Tell whether two texts name the same law; of a file only its name counts: paths start from different folders."""
    (file, _, name), (other_file, _, other_name) = spec.rpartition(":"), other.rpartition(":")
    return (PurePath(file).name, name) == (PurePath(other_file).name, other_name)


def _given(text: str, assignments: list[str]) -> dict[str, object]:
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
    rest_command = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
    latency_s = sum(float(scenario.get(f"link.{way}_latency_s", 0.0)) for way in ("command", "feedback"))
    applied = Applied(rest_command, False, latency_s)
    before: float | None = None  # number of the last tick in which the law was called
    table = np.column_stack([run.signals[name] for name in _INPUTS])
    pieces = (table[start : start + _ROWS_AT_ONCE].tolist() for start in range(0, len(table), _ROWS_AT_ONCE))
    for tick, held, saturated, latency_ms, *rest in chain.from_iterable(pieces):
        reference = Reference(Pose(*rest[0:3]), Twist(*rest[3:6]), Acceleration(*rest[6:9]))
        state = State(Pose(*rest[9:12]), Twist(*rest[12:15]))
        is_away = isnan(rest[19])  # its link was lost, and nothing was commanded
        if is_away or held:
            before = None  # afterwards the law is reset
            yield None
        else:
            watch.turn += 1
            if before is None or (tick - before) * period_ns > stale_ns:
                law.reset(state, reference)  # as hil.runtime.tick does after so many skipped ticks
                before = tick - 1
            dt_s = (tick - before) * period_ns * 1e-9
            command, _ = guard.apply(law.update(reference, state, applied, dt_s))
            watch.turn += 1
            yield command
            before = tick
        speed_rad_s = ZERO_WHEELS if mode is CommandMode.TORQUE else Wheels(*rest[15:19])
        recorded = rest_command if is_away else WheelCommand(mode, speed_rad_s, Wheels(*rest[19:23]))
        applied = Applied(recorded, bool(saturated) and not is_away, latency_ms / 1e3)

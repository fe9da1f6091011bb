"""The catalogue's cases: every kind of fault with typical numbers, and the outcome that a run with it must have.

Disturbances begin at 0.15 s, and faults that stop the robot later, so that in a pair both happen. Windows end early
enough for a robot to be back before the end of a run of ``DURATION_S``.
"""

from collections.abc import Mapping, Set
from enum import StrEnum
from typing import NamedTuple

DURATION_S = 1.3

# Reasons in messages: the host got no feedback, or the robot got no commands.
NO_FEEDBACK = "no feedback"
SILENCE = "COMMAND_TIMEOUT"

Row = Mapping[str, str | float]


class Ending(StrEnum):
    """The outcome of a run, the best first."""

    GOES_ON = "goes on"
    REARMS = "re-arms"  # it stops; with loop.rearm it comes back, without it the run ends with an error
    ENDS = "ends"  # with an error and exit code 3, also with loop.rearm


class Case(NamedTuple):
    """A fault as the catalogue runs it: rows of ``[[fault]]``; the last row's kind is the kind of the case.

    ``cause`` must be in the message that says why the robot was lost. ``realtime``: the case is also run in real time.
    ``rules``: the rules of PROTOCOL.md that the outcome depends on.
    """

    name: str
    rows: tuple[Row, ...]
    outcome: Ending
    cause: str | None = None
    in_pairs: bool = True
    realtime: bool = False
    rules: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """The kind of the fault."""
        return str(self.rows[-1]["kind"])


_GOES_ON, _REARMS, _ENDS = Ending.GOES_ON, Ending.REARMS, Ending.ENDS
_SHORT = {"start_s": 0.15, "end_s": 0.35}
_LONG = {"start_s": 0.15, "end_s": 0.55}
_LATER = {"start_s": 0.2, "end_s": 0.6}  # longer than a watchdog of 0.1 s and a ramp of 0.2 s


def _case(
    kind: str,
    target: str,
    outcome: Ending,
    *,
    window: Mapping[str, float],
    cause: str | None = None,
    in_pairs: bool = True,
    realtime: bool = False,
    rules: tuple[str, ...] = (),
    **numbers: float,
) -> Case:
    row: Row = {"kind": kind, "target": target, **window, **numbers}
    return Case(f"{kind} {target}", (row,), outcome, cause, in_pairs, realtime, rules)


CASES: tuple[Case, ...] = (
    _case("drop", "command", _GOES_ON, window=_LONG, value=0.3, rules=("R-CMD-4",), realtime=True),
    _case("drop", "feedback", _GOES_ON, window=_LONG, value=0.3, rules=("R-SNAP-5",), in_pairs=False),
    _case("burst_loss", "command", _GOES_ON, window=_LONG, value=0.3, burst_frames=4.0, rules=("R-CMD-4",)),
    _case("burst_loss", "feedback", _GOES_ON, window=_LONG, value=0.3, burst_frames=4.0, rules=("R-SNAP-5",),
          in_pairs=False),
    _case("delay", "command", _GOES_ON, window=_LONG, value=0.02, realtime=True),
    _case("delay", "feedback", _GOES_ON, window=_LONG, value=0.02, in_pairs=False),
    _case("jitter", "command", _GOES_ON, window=_LONG, value=0.02, in_pairs=False),
    _case("jitter", "feedback", _GOES_ON, window=_LONG, value=0.02),
    _case("duplicate", "command", _GOES_ON, window=_LONG, rules=("R-CMD-5",)),
    _case("reorder", "command", _GOES_ON, window=_LONG, value=0.3, rules=("R-CMD-5",)),
    _case("bit_errors", "command", _GOES_ON, window=_LONG, value=0.002, rules=("R-GEN-1", "R-SER-5")),
    _case("bit_errors", "feedback", _GOES_ON, window=_LONG, value=0.001, rules=("R-GEN-1", "R-SER-5"), in_pairs=False),
    _case("truncation", "command", _GOES_ON, window=_LONG, value=0.2, rules=("R-TRN-1", "R-SER-5")),
    _case("truncation", "feedback", _GOES_ON, window=_LONG, value=0.1, rules=("R-TRN-1", "R-SER-5"), in_pairs=False),
    _case("disconnect", "link", _REARMS, cause="the fault disconnect", window={"start_s": 0.25, "end_s": 0.35},
          realtime=True, rules=("R-WD-2", "R-ARM-4")),
    _case("mute", "WHEEL_COMMAND", _REARMS, cause=SILENCE, window=_LATER, rules=("R-WD-2", "R-ARM-4"), realtime=True),
    _case("mute", "TICK", _REARMS, cause=NO_FEEDBACK, window=_LATER, in_pairs=False),
    _case("mute", "HOST_HEARTBEAT", _GOES_ON, window=_LONG, rules=("R-GEN-3",), in_pairs=False),
    _case("freeze", "command", _REARMS, cause=SILENCE, window=_LATER, rules=("R-CMD-5", "R-WD-2")),
    _case("freeze", "feedback", _REARMS, cause=NO_FEEDBACK, window=_LATER, in_pairs=False),
    _case("babble", "command", _GOES_ON, window=_LONG, value=200.0, rules=("R-GEN-1", "R-CNT-6"), realtime=True),
    _case("babble", "feedback", _GOES_ON, window=_LONG, value=200.0, rules=("R-GEN-1",), in_pairs=False),
    _case("estop", "command", _ENDS, cause="it is ESTOP", window={"start_s": 0.2}, rules=("R-STATE-8", "R-STOP-1")),
    _case("reset", "robot", _REARMS, cause="it was reset", window={"start_s": 0.25}, realtime=True,
          rules=("R-RESET-2", "R-ARM-4")),
    _case("stuck_encoder", "fl", _ENDS, cause="ENCODER_STUCK", window=_LATER, rules=("R-FAULT-7", "R-STATE-10")),
    _case("lost_counts", "rl", _GOES_ON, window=_LONG, value=0.1),
    _case("dead_motor", "rr", _GOES_ON, window=_LONG, rules=("R-FAULT-11",), realtime=True),
    _case("low_battery", "battery", _GOES_ON, window=_LONG, value=15.0),
    _case("gyro_bias", "gyro", _GOES_ON, window=_LONG, value=0.5),
    _case("slow_clock", "clock", _GOES_ON, window=_LONG, value=50_000.0),
    _case("parameter", "friction_coefficient", _GOES_ON, window=_LONG, value=0.5),
    _case("push", "force_y_n", _GOES_ON, window=_SHORT, value=60.0),
    _case("payload", "robot", _GOES_ON, window=_LONG, value=8.0, x_m=0.1, y_m=-0.05),
    _case("lifted_wheel", "fl", _GOES_ON, window=_LONG),
    _case("slip_patch", "floor", _GOES_ON, window=_LONG, value=0.05),
    _case("bias", "truth.x_m", _GOES_ON, window=_LONG, value=0.05),
    _case("override", "wheel.fl.speed_command_rad_s", _GOES_ON, window=_SHORT, value=3.0),
    Case(
        "reset truth.y_m",
        (
            {"kind": "bias", "target": "truth.y_m", "start_s": 0.15, "value": 0.05},
            {"kind": "reset", "target": "truth.y_m", "start_s": 0.2},
        ),
        _GOES_ON,
    ),
)  # fmt: skip


MOTORS_CAUSES = ("no feedback", "left closed loop", "reported", "the fault disconnect", "bus-off")
"""One of these is part of the message that says why a robot with third-party motor controllers was lost."""
_ALL = 1.0
_OF_OUR_MESSAGES = ("mute", "estop")
# Third-party controllers do not recognise an old command by a sequence number, or latch faults from which our firmware
# recovers.
_OTHERWISE = {
    "freeze command": {_GOES_ON, _REARMS, _ENDS},
    "freeze feedback": {_GOES_ON, _REARMS},
    "bit_errors command": {_GOES_ON, _REARMS, _ENDS},
    "bit_errors feedback": {_GOES_ON, _REARMS, _ENDS},
    "disconnect link": {_REARMS, _ENDS},
    "reset robot": {_REARMS, _ENDS},
    "stuck_encoder fl": {_GOES_ON, _ENDS},
    "low_battery battery": {_GOES_ON, _ENDS},
    "no command": {_REARMS, _ENDS},
    "no feedback": {_REARMS, _ENDS},
}
MOTORS_CASES: tuple[tuple[Case, Set[Ending]], ...] = tuple(
    (case, _OTHERWISE.get(case.name, {case.outcome}))
    for case in (
        *(case for case in CASES if case.kind not in _OF_OUR_MESSAGES),
        _case("drop", "command", _REARMS, window=_LATER, value=_ALL)._replace(name="no command"),
        _case("drop", "feedback", _REARMS, window=_LATER, value=_ALL)._replace(name="no feedback"),
    )
)
"""The cases for third-party motor controllers with their outcomes: some latch faults from which others recover."""


class Pair(NamedTuple):
    """Two cases whose joint outcome is not the worse of their own: the joint outcome, its cause, and why."""

    outcome: Ending
    cause: str | None
    why: str


_EXPECTS_NOTHING = "a robot that ramps to zero expects no wheel to turn, so nothing is found before the window is over"

PAIRS: Mapping[tuple[str, str], Pair] = {
    ("disconnect link", "stuck_encoder fl"): Pair(
        _ENDS,
        "it is FAULT because of ENCODER_STUCK of wheel fl",
        "the robot finds its encoder stuck while nobody hears it, and is latched",
    ),
    ("mute WHEEL_COMMAND", "stuck_encoder fl"): Pair(_REARMS, SILENCE, _EXPECTS_NOTHING),
    ("freeze command", "stuck_encoder fl"): Pair(_REARMS, SILENCE, _EXPECTS_NOTHING),
}
"""The pairs whose outcome is not the worse of their two, by the names of their cases in the order of ``CASES``."""

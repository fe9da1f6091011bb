"""Two made-up runs with a little of everything, each value of each signal and figure another one; no process made them.

The first one failed and ended early, the second one passed.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.core.ports import Event
from hil.core.signals import SIGNAL_NAMES
from hil.judge.figures import figures
from hil.judge.judged_run import (
    Counts,
    ExpectationResult,
    Failure,
    FaultResult,
    Identity,
    JudgedRun,
    LimitResult,
    Verdict,
)
from hil.record.reader import RecordedRun

RATE_HZ = 100
_SCENARIO: Mapping[str, Any] = {
    "controller.law": "dsc", "loop.duration_s": 2.5, "loop.rate_hz": RATE_HZ, "loop.seed": 1,
    "robot.mass_kg": 20.0, "robot.wheel_radius_m": 0.075, "robot.half_length_m": 0.3, "robot.half_width_m": 0.2,
    "robot.torque_limit_n_m": 5.5, "robot.speed_limit_rad_s": 31.0, "firmware.torque_constant_n_m_a": 0.6,
    "firmware.current_limit_a": 8.0, "plant.fmu": None, "link.url": "memory:",
    "expect.1.signal": "error.planar_m", "expect.1.from_s": 0.5, "expect.1.to_s": 1.5, "expect.1.below": 0.02,
    "expect.2.signal": "truth.x_m", "expect.2.of": "reference.x_m", "expect.2.within": [-50.0, 60.0],
    "expect.3.figure": "effort_n_m_s", "expect.3.below": 9.0,
    "expect.4.signal": "error.y_m", "expect.4.from_s": 1.0, "expect.4.above": -0.5, "expect.4.below": 0.25,
    "fault.1.kind": "push", "fault.1.target": "force_x_n", "fault.1.value": 60.0, "fault.1.start_s": 0.6,
    "fault.1.end_s": 0.8,
    "fault.2.kind": "estop", "fault.2.target": "command", "fault.2.start_s": 2.2,
}  # fmt: skip


class MadeRun(NamedTuple):
    """A run as it was recorded, and as it was judged."""

    run: RecordedRun
    judged: JudgedRun


def _signals(count: int, shift: float) -> dict[str, Any]:
    """Return series that differ from each other everywhere; the times begin before t = 0."""
    ticks = np.arange(count)
    found = {
        name: np.round((number + shift) * 0.01 + np.sin(0.05 * ticks + number + shift) * 0.3, 4)
        for number, name in enumerate(SIGNAL_NAMES, start=1)
    }
    planar = np.where((ticks >= 80) & (ticks < 90), 0.03, 0.01) + 1e-5 * ticks
    return found | {"loop.t_s": (ticks - 2) / RATE_HZ, "loop.tick": ticks * 1.0, "error.planar_m": planar}


def _figures(shift: float) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for number, figure in enumerate(figures(), start=1):
        table, _, key = figure.name.partition(".")
        value = (number + shift * (number % 3 - 1)) / (4.0 * figure.scale)
        if key:
            made.setdefault(table, {})[key] = value
        else:
            made[table] = value
    made["frames"] = {"sent": 400, "received": 1000 + shift, "rejected": {"crc": 2}}
    made["tick_us"] = {"p50": 40.0 + shift, "p99": 90.0}
    made["lateness_us"] = {"p50": 1.0, "p99": 2.0 + shift, "p99.9": 3.0, "max": 4.0}
    made["link_statistics"] = {
        "sent": {"frames": 400, "bytes": 4000}, "lost": {"snapshots": 3}, "round_trip_ms": {"p50": 1.25, "p99": 2.5},
    }  # fmt: skip
    return made


@cache
def _made() -> tuple[MadeRun, MadeRun]:
    properties = {
        "scenario_name": "made", "law": "dsc", "law_sha256": "ab" * 32, "gains": '{"k1_1_s": 3.0}', "machine": "one",
        "scenario": json.dumps(_SCENARIO),
        "scenario_sources": json.dumps({"loop.seed": "made.toml:4", "link.url": "-"}),
        "cosim_sha256": "11" * 32, "cosim_sources_sha256": "12" * 32, "wheel_host_sha256": "21" * 32,
        "wheel_host_sources_sha256": "22" * 32,
    }  # fmt: skip
    events = (
        Event(0.0, "INFO", "robot: made"), Event(0.6, "WARN", "fault begins: push"), Event(1.97, "ERROR", "<gone>"),
    )  # fmt: skip
    expect = (
        ExpectationResult("error.planar_m", passed=False, violation_s=0.78, violation_value=0.0308, worst_s=0.87,
                          worst_value=0.0309, violated_s=0.1, margin=-0.0109,
                          text="error.planar_m below 0.02 from 0.5 s to 1.5 s: failed, 0.0308 at t = 0.78 s"),
        ExpectationResult("truth.x_m", passed=True, margin=0.5,
                          text="truth.x_m minus reference.x_m within -50 to 60: held"),
        ExpectationResult(figure="effort_n_m_s", passed=None, text="effort_n_m_s below 9: not judged"),
        ExpectationResult("error.y_m", passed=None, text="error.y_m above -0.5 below 0.25 from 1 s: not judged"),
    )  # fmt: skip
    faults = (
        FaultResult("push", "force_x_n", "push force_x_n 60 from 0.6 s to 0.8 s", 20, "ticks", 0.6, 0.8, 60.0),
        FaultResult("estop", "command", "estop command from 2.2 s", 0, "commands", 2.2, None, None),
    )
    one = MadeRun(
        RecordedRun(Path("one.rrd"), _signals(200, 0.0), events, properties, None, 0),
        JudgedRun(
            identity=Identity("made", "dsc", "lockstep", "speed", "memory:", 1), verdict=Verdict.FAILED,
            figures=_figures(0.0), counts=Counts(1, 2, 3, 4, 5, 0, 6), expect=expect, faults=faults,
            failure=Failure("the link is gone", "LinkError", 1.97), recording="one.rrd", events=events,
            allow=(LimitResult("stale_ticks", False, 2, 2, 0, -2.0, "stale ticks: 2, allowed 0"),),
            made={"command": "speed", "started": "2026-01-02", "mecanum_hil": "0.3", "commit": "abc", "machine": "one"},
            notes=("a note with <tags>",),
        ),
    )  # fmt: skip
    changed = _SCENARIO | {"controller.law": "pid", "loop.seed": 2, "link.url": "udp:", "robot.mass_kg": 21.0}
    changed |= {"plant.fmu": "x" * 60, "expect.1.below": 0.04}
    other = properties | {"law": "pid", "law_sha256": "cd" * 32, "gains": '{"kp": 3.0}', "machine": "two"}
    other |= {"scenario": json.dumps(changed), "cosim_sha256": "13" * 32, "cosim_sources_sha256": "14" * 32}
    other |= {"wheel_host_sha256": "23" * 32}
    signals = _signals(260, 0.37) | {"error.planar_m": np.full(260, 0.015)}
    passed = tuple(
        row._replace(passed=True, violation_s=None, worst_s=None, text=f"{row.claim}: held") for row in expect
    )
    two = MadeRun(
        RecordedRun(Path("two.rrd"), signals, events[:2], other, {"passed": True}, 0),
        replace(
            one.judged, identity=Identity("made", "pid", "lockstep", "speed", "udp:", 2), verdict=Verdict.PASSED,
            figures={name: value for name, value in _figures(4.0).items() if name != "tracked_s"}, expect=passed,
            reasons={"tracked_s": "it never was"}, faults=faults[:1], failure=None, recording="two.rrd",
            events=events[:2], allow=(), made={"command": "speed"}, notes=(), counts=Counts(1, 0, 3, 4, 5, 0, 6),
        ),
    )  # fmt: skip
    return one, two


def made_runs() -> tuple[MadeRun, MadeRun]:
    """Return the runs, of which a test may change what it likes."""
    first, second = (
        MadeRun(
            replace(made.run, signals={name: series.copy() for name, series in made.run.signals.items()}), made.judged
        )
        for made in _made()
    )
    return first, second

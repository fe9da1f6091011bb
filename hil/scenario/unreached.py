"""Finds the parts of a scenario without effect: rows after its end, and values that nothing reads."""

import math
from collections.abc import Iterator, Mapping

from hil.core.types import WHEEL_NAMES
from hil.faults.kinds import find
from hil.scenario.plant import SHIPPED_FMUS
from hil.scenario.scenario import Scenario
from hil.scenario.tables import Tables
from hil.scenario.trial import span_s
from hil.scenario.values import StartValue

_TICK_SHARE = 1e-6
"""Of a tick: a time that is nearer to one is that tick's."""
_OURS = ("mecanum", "mecanum_fmi3")
"""The FMUs of our plant in C; MuJoCo's reads other start values."""


def beyond_the_end(tables: Tables) -> Iterator[tuple[str, str]]:
    """Yield key and message of each row that no tick of the run reaches: a run fails by it, or never does it.

    It is no error of the tables: a run may be shortened to look at its beginning.
    """
    ticks = math.ceil(tables.loop.duration_s * tables.loop.rate_hz - _TICK_SHARE)
    ends = f"the run ends at loop.duration_s = {tables.loop.duration_s:g}"
    for i, row in enumerate(tables.expect, start=1):
        if row.figure is not None:
            continue
        key = f"expect.{i}.from_s" if row.after_fault is None else f"expect.{i}.within_s"
        try:
            from_s, to_s = span_s(row, tables.fault)
        except ValueError:  # refused by ``check``
            continue
        first = math.ceil(from_s * tables.loop.rate_hz - _TICK_SHARE)
        if first >= ticks:
            yield key, f"it is judged from {from_s:g} s on, but {ends}; expected an earlier time, or a longer run"
        elif row.is_of_signals and first > to_s * tables.loop.rate_hz + _TICK_SHARE:
            yield f"expect.{i}.to_s", f"no tick of {tables.loop.rate_hz} Hz is from {from_s:g} s to {to_s:g} s"
    for i, fault in enumerate(tables.fault, start=1):
        if fault.start_s * tables.loop.rate_hz > ticks - 1 + _TICK_SHARE:
            yield f"fault.{i}.start_s", f"{ends}, so that it would never act; expected an earlier time, or a longer run"
    estimator, fix = tables.estimator, tables.estimator.simulated_fix
    is_simulated = estimator.source == "fused" and estimator.fix == "simulated"
    if is_simulated and fix.gap_end_s > fix.gap_start_s >= tables.loop.duration_s:
        yield "estimator.simulated_fix.gap_start_s", f"{ends}, before this gap; expected an earlier time"
    rest_s = tables.reference.options.get("rest_s", 0.0)
    if isinstance(rest_s, int | float) and rest_s >= tables.loop.duration_s:
        yield "reference.rest_s", f"{ends}, so that the robot would never move; expected less"


def without_effect(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield key and reason of each value that is given and that no part of this scenario's runs reads."""
    rules = dict(_unread(scenario))
    for key, where in scenario.provenance.items():
        if where != "default" and (why := next((rules[one] for one in rules if key.startswith(one)), None)):
            yield key, why


def _unread(tables: Tables) -> Iterator[tuple[str, str]]:
    """Yield the beginning of the keys that nothing reads, and why; tests/scenario/test_plausible.py changes each."""
    estimator = tables.estimator
    if estimator.source != "fused":
        yield from ((f"estimator.{one}", 'estimator.source = "fused" alone reads it') for one in ("filter.", "fix"))
    if estimator.source != "fused" or estimator.fix != "simulated":
        yield "estimator.simulated_fix.", "only simulated fixes of a fused estimator read it"
    yield "commission.lateral_scale", "it was measured, and nothing uses it yet: odometry and laws believe the wheels"
    if estimator.source == "truth":
        yield "estimator.slip_threshold_m_s", "the true pose is not estimated"
    if not tables.device.is_makers:
        yield "device.guardian_s", "our firmware has a watchdog of its own, and no guardian"
    else:
        for name in ("current_limit_a", "encoder_fault_s", "undervoltage_v"):
            yield f"firmware.{name}", "only our firmware reads it: other motor controllers are set with their tools"
    if tables.loop.mode == "lockstep":
        yield "realtime.", 'loop.mode = "realtime" alone reads it'
    if tables.controller.command == "speed":
        yield "limiter.", 'controller.command = "torque" alone is limited so'
    if tables.plant.fmu in SHIPPED_FMUS:
        for key in ("timeout_s", "memory_limit_mb"):
            yield f"plant.{key}", "a shipped FMU runs in the robot's own process"
    # A fault whose targets are not listed sets any variable of the FMU, and so one that makes it read the others.
    if tables.plant.fmu in _OURS and all(find(row.kind, row.target).targets for row in tables.fault):
        yield from _unread_by_our_plant(tables.plant.start)


def _unread_by_our_plant(start: Mapping[str, StartValue]) -> Iterator[tuple[str, str]]:
    """Yield the start values that our plant does not read with its contact, drive and slope."""
    if start.get("contact", "rigid") in ("rigid", 1.0):
        grips = ("grip_coefficient", "roller_", *(f"wheel.{wheel}.grip_factor" for wheel in WHEEL_NAMES))
        yield from ((f"plant.start.{name}", 'wheels slip only with plant.start.contact = "slip"') for name in grips)
    if start.get("drive", "torque") in ("torque", 1.0):
        for name in ("current_limit_a", "motor_inductance_h"):
            yield f"plant.start.{name}", 'plant.start.drive = "torque" takes torques as they are'
    if not start.get("slope_rad"):
        yield "plant.start.slope_direction_rad", "the ground is level: plant.start.slope_rad is 0"
    if not start.get("gyro_noise_rad_s") and not start.get("accelerometer_noise_m_s2"):
        yield from (
            (f"plant.start.{name}", "it is of the sensors' noise, which is 0") for name in ("seed", "imu_rate_hz")
        )

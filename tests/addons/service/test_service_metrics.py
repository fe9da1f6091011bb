"""The metrics of a service: each value of its status in its own family and in base units."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.addons.service import COMMANDS
from hil.addons.service.api.control import Control
from hil.addons.service.api.routes import _ServiceMetrics
from hil.addons.service.messages import Action
from tests.support.addon_commands import flags_that_are_on

STATUS: dict[str, Any] = {
    "scenario": "circle", "law": "dsc", "command": "speed", "link": "a line", "phase": "active", "task": "go",
    "ticks": 1001, "deadline_misses": 12, "recoveries": 3, "rows_dropped": 4, "rows_lost": 5,
    "frames": {"sent": 600, "received": 700, "rejected": {"length": 8, "crc": 9}},
    "feedback_age_ms": 1.5, "round_trip_ms": 2.5, "battery_v": 24.5, "twist_age_s": 0.25, "power_stage": False,
    "recording": "a.rrd", "recording_trouble": None, "lateness_us": {"p50": 20.0, "p99": 300.0, "p99.9": None},
}  # fmt: skip


def values(status: dict[str, Any] | None) -> dict[str, float]:
    control = SimpleNamespace(
        status_age_s=0.125,
        watchers=["one", "two"],
        outcomes={(Action.GO, "accepted"): 6, (Action.ARM, "refused"): 7},
        audit=SimpleNamespace(failures=11),
        status=status,
    )
    text = _ServiceMetrics(cast("Control", control), {"late": 13, "flood": 14}).text().decode()
    rows = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in rows}


OF_THE_API = {
    "hil_status_age_seconds": 0.125, "hil_api_live_clients": 2.0,
    'hil_api_orders_total{action="go",outcome="accepted"}': 6.0,
    'hil_api_orders_total{action="arm",outcome="refused"}': 7.0,
    **{f'hil_api_connections_dropped_total{{cause="{cause}"}}': number for cause, number in
       (("late", 13.0), ("crowded", 0.0), ("flood", 14.0), ("unknown", 0.0), ("not_accepted", 0.0))},
    "hil_api_audit_failures_total": 11.0,
}  # fmt: skip


def test_before_the_first_status_there_are_those_of_the_api_alone() -> None:
    assert values(None) == OF_THE_API


def test_each_value_of_a_status_is_there_in_base_units() -> None:
    found = values(STATUS)
    states = {name: value for name, value in found.items() if name.startswith(("hil_phase", "hil_task"))}
    assert {name for name, value in states.items() if value} == {
        'hil_phase{hil_phase="active"}',
        'hil_task{hil_task="go"}',
    }
    assert len(states) > 8
    expected = OF_THE_API | {
        'hil_service_info{command="speed",law="dsc",link="a line",scenario="circle"}': 1.0,
        "hil_ticks_total": 1001.0, "hil_deadline_misses_total": 12.0, "hil_recoveries_total": 3.0,
        "hil_rows_dropped_total": 4.0, "hil_rows_lost_total": 5.0, "hil_frames_sent_total": 600.0,
        "hil_frames_received_total": 700.0, 'hil_frames_rejected_total{cause="crc"}': 9.0,
        'hil_frames_rejected_total{cause="length"}': 8.0, "hil_feedback_age_seconds": 0.0015,
        "hil_round_trip_seconds": 0.0025, "hil_battery_volts": 24.5, "hil_twist_age_seconds": 0.25,
        "hil_power_stage": 0.0, "hil_recording": 1.0, "hil_recording_trouble": 0.0,
        'hil_lateness_seconds{quantile="0.5"}': 20e-6, 'hil_lateness_seconds{quantile="0.99"}': 300e-6,
        "hil_lateness_seconds_count": 1001.0,
    }  # fmt: skip
    assert {name: value for name, value in found.items() if name not in states} == pytest.approx(expected)


def test_what_is_not_known_is_left_out() -> None:
    unknown = dict.fromkeys(("feedback_age_ms", "round_trip_ms", "battery_v", "twist_age_s", "power_stage"))
    found = values(STATUS | unknown | {"recording": None, "recording_trouble": "the disk is full"})
    names = ("feedback_age_seconds", "round_trip_seconds", "battery_volts", "twist_age_seconds", "power_stage")
    assert not {f"hil_{name}" for name in names} & set(found)
    assert (found["hil_recording"], found["hil_recording_trouble"]) == (0.0, 1.0)


def test_no_flag_of_the_services_commands_is_on_by_itself() -> None:
    assert flags_that_are_on(COMMANDS) == []

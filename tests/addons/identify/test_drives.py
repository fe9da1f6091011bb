"""What hil identify reads of a recording: angles without the filter's delay, whole rows, fixes; and what it refuses."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.addons.identify import drives
from hil.addons.identify.drives import Drive, drive_of
from hil.core.errors import BadInputError
from hil.core.signals import TRUE_POSE, WHEEL_SPEEDS
from hil.core.types import WHEEL_NAMES
from hil.record.reader import RecordedRun

PERIOD_S = 0.005
VALUES: Mapping[str, Any] = {
    "robot.mass_kg": 14.0, "robot.inertia_kg_m2": 0.7, "robot.wheel_radius_m": 0.06, "robot.half_length_m": 0.24,
    "robot.half_width_m": 0.17, "robot.wheel_inertia_kg_m2": 0.004, "robot.friction_coefficient": 0.02,
    "robot.torque_limit_n_m": 2.0, "robot.speed_limit_rad_s": 30.0, "firmware.tracking_bandwidth_rad_s": 125.0,
}  # fmt: skip
AT_FIRST = np.array([1.0, -2.0, 3.0, 0.5])
RATE = np.array([0.3, 0.7, -0.4, 1.1])


def signals(rows: int = 500, begin_s: float = 3.0) -> dict[str, np.ndarray]:
    """Return a recording in which every signal is a line of its own."""
    time_s = begin_s + PERIOD_S * np.arange(rows)
    since_s = (time_s - begin_s)[:, None]
    speeds, currents = AT_FIRST + RATE * since_s, np.array([0.1, 0.2, 0.3, 0.4]) - 0.1 * since_s
    commands = np.array([0.5, -0.6, 0.7, -0.8]) + 0.0 * since_s
    poses = np.array([1.0, 2.0, 0.3]) + np.array([0.1, -0.2, 0.05]) * since_s
    found = {"robot.time_s": time_s, "robot.yaw_rate_rad_s": 0.2 + 0.1 * since_s[:, 0]}
    for names, table in (
        (WHEEL_SPEEDS, speeds),
        ([f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES], currents),
        ([f"wheel.{wheel}.torque_command_n_m" for wheel in WHEEL_NAMES], commands),
        (TRUE_POSE, poses),
    ):
        found |= dict(zip(names, table.T, strict=True))
    return found


def read(rows: Mapping[str, np.ndarray], **values: Any) -> Drive:
    return drive_of(Path("floor.rrd"), {**VALUES, **{key.replace("__", "."): one for key, one in values.items()}}, rows)


def only(rows: Mapping[str, np.ndarray], kept: Any) -> dict[str, np.ndarray]:
    return {name: series[kept] for name, series in rows.items()}


def test_angles_are_those_before_the_filter_of_our_firmware_alone() -> None:
    since_s = PERIOD_S * np.arange(500)[:, None]
    speed, filtered = AT_FIRST + RATE * since_s, AT_FIRST * since_s + RATE * since_s**2 / 2.0
    before = filtered + (2.0 / 125.0 - 0.0005) * speed + (1.0 / 125.0**2 - 0.002 / 125.0) * RATE
    drive = read(signals())
    assert drive.angle_rad == pytest.approx(before, abs=1e-12)
    assert drive.speed_rad_s[1:-1] == pytest.approx(speed[1:-1] + RATE * (2.0 / 125.0 - 0.0005), abs=1e-9)
    assert read(signals(), device__driver="odrive").angle_rad == pytest.approx(filtered, abs=1e-12)
    assert read(signals(), firmware__tracking_bandwidth_rad_s=None).angle_rad == pytest.approx(filtered, abs=1e-12)


def test_each_signal_comes_as_it_was_recorded_and_commands_as_our_wire_carried_them() -> None:
    rows = signals()
    drive = read(rows)
    assert drive.period_s == pytest.approx(PERIOD_S)
    assert np.array_equal(drive.time_s, rows["robot.time_s"])
    assert np.array_equal(drive.yaw_rate_rad_s, rows["robot.yaw_rate_rad_s"])
    for place, wheel in enumerate(WHEEL_NAMES):
        assert np.array_equal(drive.current_a[:, place], rows[f"wheel.{wheel}.current_a"])
        command = rows[f"wheel.{wheel}.torque_command_n_m"]
        assert np.array_equal(drive.torque_command_n_m[:, place], np.round(command * 256.0) / 256.0)
        others = read(rows, device__driver="odrive")
        assert np.array_equal(others.torque_command_n_m[:, place], command)
    assert np.array_equal(drive.truth, np.stack([rows[name] for name in TRUE_POSE], axis=1))
    assert (drive.robot.mass_kg, drive.robot.half_length_m, drive.robot.half_width_m) == (14.0, 0.24, 0.17)
    assert drive.unused_s == pytest.approx(0.0, abs=1e-9)
    assert (drive.has_currents, drive.has_truth) == (True, True)


def test_what_was_not_measured_is_not_there() -> None:
    rows = signals()
    poor = read({name: series for name, series in rows.items() if "current" not in name and "truth" not in name})
    assert (poor.has_currents, poor.has_truth) == (False, False)
    assert np.isnan(poor.current_a).all()
    zeros = {name: series * (0.0 if "current" in name else 1.0) for name, series in rows.items()}
    assert not read(zeros).has_currents
    rows["wheel.rr.current_a"][3] = rows["truth.y_m"][7] = np.nan
    assert (read(rows).has_currents, read(rows).has_truth) == (False, False)


def test_fixes_are_those_that_are_whole_in_the_order_of_their_stamps() -> None:
    rows = signals()
    fixes = np.full((500, 4), np.nan)
    fixes[10], fixes[20], fixes[30], fixes[40] = (
        (3.4, 1.0, 2.0, 0.1), (3.2, 3.0, 4.0, 0.2), (3.3, np.nan, 6.0, 0.3), (3.2, 7.0, 8.0, 0.4)
    )  # fmt: skip
    names = ("fix_time_s", "fix_x_m", "fix_y_m", "fix_heading_rad")
    rows |= {f"estimator.{name}": series for name, series in zip(names, fixes.T, strict=True)}
    assert read(rows).fixes.tolist() == [[3.2, 3.0, 4.0, 0.2], [3.2, 7.0, 8.0, 0.4], [3.4, 1.0, 2.0, 0.1]]


@pytest.mark.parametrize("lost", [1, 3])
def test_up_to_three_feedbacks_that_are_missing_are_interpolated(lost: int) -> None:
    whole = read(signals())
    kept = np.delete(np.arange(500), np.arange(200, 200 + lost))
    few = read(only(signals(), kept))
    for name in ("time_s", "angle_rad", "current_a", "yaw_rate_rad_s", "truth"):
        assert getattr(few, name) == pytest.approx(getattr(whole, name), abs=1e-9), name
    assert few.unused_s == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("first_lost", "begins", "ends"), [(410, 0, 409), (80, 84, 499)])
def test_four_that_are_missing_end_a_stretch_and_the_longest_is_taken(first_lost: int, begins: int, ends: int) -> None:
    rows = signals()
    found = read(only(rows, np.delete(np.arange(500), np.arange(first_lost, first_lost + 4))))
    assert (found.time_s[0], found.time_s[-1]) == (rows["robot.time_s"][begins], rows["robot.time_s"][ends])
    assert len(found.angle_rad) == ends - begins + 1
    assert found.unused_s == pytest.approx((499 - (ends - begins)) * PERIOD_S)


@pytest.mark.parametrize(("late_periods", "rows"), [(0.09, 500), (0.11, 410)])
def test_a_clock_that_jumps_by_a_tenth_of_a_period_ends_a_stretch(late_periods: float, rows: int) -> None:
    jumped = signals()
    jumped["robot.time_s"][410:] += late_periods * PERIOD_S
    assert len(read(jumped).time_s) == rows


def test_ticks_without_new_feedback_and_before_the_first_are_left_out() -> None:
    rows = signals()
    repeated = only(rows, np.sort(np.append(np.arange(500), [100, 100, 101])))
    nothing = {name: np.full(3, np.nan) for name in rows}
    nothing["robot.time_s"] = np.array([np.nan, 2.0, 2.1])
    later = {name: np.concatenate([nothing[name], repeated[name]]) for name in rows}
    later["wheel.fl.speed_rad_s"][1] = 1.0
    found = read(later)
    assert np.array_equal(found.time_s, rows["robot.time_s"])
    assert np.array_equal(found.angle_rad, read(rows).angle_rad)
    assert found.unused_s == pytest.approx(0.0, abs=1e-9)


def test_a_recording_without_a_signal_is_refused_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {name: series for name, series in signals().items() if name not in WHEEL_SPEEDS[1:]}
    monkeypatch.setattr(drives, "read", lambda path, _: RecordedRun(path, rows, (), {}, None, 0))
    told = f"floor.rrd: it lacks the signal {WHEEL_SPEEDS[1]}; expected a recording of hil run"
    with pytest.raises(BadInputError, match=f"^{told}$"):
        drives.read_drive(Path("floor.rrd"))


def test_what_is_no_drive_is_refused_with_what_it_lacks() -> None:
    rows = signals(401, 0.0)
    assert len(read(rows).time_s) == 401
    with pytest.raises(BadInputError, match=r"^floor.rrd: .* gap in the feedback is 1\.995 s; expected at least 2 s$"):
        read(only(rows, slice(400)))
    for few in ([5], np.zeros(0, dtype=int), [5, 5]):
        with pytest.raises(BadInputError, match=r"^floor.rrd: it has no feedback of the robot$"):
            read(only(rows, few))
    with pytest.raises(BadInputError, match=r"gap in the feedback is 0\.005 s; expected at least 2 s$"):
        read(only(rows, [5, 6]))
    with pytest.raises(BadInputError, match=r"^floor.rrd: the robot has no gyro; hil identify needs one"):
        read({name: series for name, series in rows.items() if "yaw_rate" not in name})
    with pytest.raises(BadInputError, match=r"^floor.rrd: it does not say the robot's robot.inertia_kg_m2; it is no"):
        drive_of(Path("floor.rrd"), {key: one for key, one in VALUES.items() if "inertia_kg" not in key}, rows)

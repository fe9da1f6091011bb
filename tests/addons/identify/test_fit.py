"""The fit of hil identify to drives of our plant without noise finds the plant's own values; and how it is judged."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

import plant_fmu
from hil.addons.identify.drives import Drive
from hil.addons.identify.fit import Result, fit, predict
from hil.addons.identify.windows import GAINS as GAIN_PARAMETERS
from hil.addons.identify.windows import GYRO_BIAS, OFFSETS, Floor, Windows, cut, mean_of_samples, variable
from hil.core.errors import BadInputError
from hil.core.plant_signals import POSE, SPEEDS
from hil.plant.window_stepper import WindowStepper
from tests.addons.identify.test_before import INERTIA, VISCOUS, on_blocks
from tests.support.formula_drives import PERIOD_S, ROBOT, Tones, formula_drive, wheel_angles

CONSTANT, BIAS_RAD_S = 1.3, 0.008
TRUE = {
    "mass_kg": 15.2, "inertia_kg_m2": 0.63, "wheel_radius_m": 0.06, "half_length_m": 0.243, "half_width_m": 0.167,
    "wheel_inertia_kg_m2": float(INERTIA.mean()), "com_x_m": 0.012, "com_y_m": -0.007, "friction_coefficient": 0.025,
    "viscous_n_m_s_rad": float(VISCOUS.mean()),
}  # fmt: skip
GAINS, OFFSETS_A = np.array([1.01, 0.98, 1.02, 0.99]), np.array([0.01, -0.02, 0.015, -0.005])


def driven(seconds: float, seed: int, **plant: Any) -> Drive:
    """Return what sensors with gains, offsets and a bias see of our plant under currents that are tones."""
    time_s = PERIOD_S * np.arange(round(seconds / PERIOD_S) + 1)
    current = Tones.of(seed, [1.6, 1.5, 1.7, 1.4], 0.15, 1.7, 6).at(time_s)
    start = TRUE | {"contact": "rigid", "drive": "torque", "longest_step_s": 0.01} | plant
    outputs = (*SPEEDS, "gyro.z_rad_s", *POSE)
    with WindowStepper(plant_fmu.path(2), start, varied=(), outputs=outputs, step_ns=5_000_000) as stepper:
        (seen,) = stepper.run((CONSTANT * current[1:])[None], [0], np.zeros((1, 0)))
    angle = cumulative_trapezoid(seen[:, :4], dx=PERIOD_S, axis=0, initial=0.0)
    measured = (current - OFFSETS_A) / GAINS
    return formula_drive(angle, current_a=measured, yaw_rate_rad_s=seen[:, 4] + BIAS_RAD_S, truth=seen[:, 5:])


@pytest.fixture(scope="module")
def result() -> Result:
    return fit(driven(8.0, 1), driven(4.0, 2), blocks=on_blocks(), contacts=["rigid"])


def test_the_plant_s_own_values_are_found_with_gains_and_bias_of_the_sensors(result: Result) -> None:
    values = result.chosen.values
    lengths = ("wheel_radius_m", "half_length_m", "half_width_m")
    for name in TRUE.keys() - {*lengths, "com_x_m", "com_y_m"}:
        assert values[name] == pytest.approx(TRUE[name], rel=2e-3), name
    for name in ("com_x_m", "com_y_m"):
        assert values[name] == pytest.approx(TRUE[name], abs=2e-5), name
    assert values["lever_m"] == pytest.approx(0.41, rel=1e-4)
    assert (result.robot.half_length_m, result.robot.half_width_m) == pytest.approx((0.243, 0.167), abs=1e-3)
    assert values["gyro_bias_rad_s"] == pytest.approx(BIAS_RAD_S, abs=1e-5)
    gains = np.array([values[f"current_gain.{wheel}"] for wheel in ("fl", "fr", "rr", "rl")])
    assert gains == pytest.approx(GAINS, rel=2e-3)
    # A common offset is hardly told from friction, the differences are.
    offsets = np.array([values[f"current_offset.{wheel}_a"] for wheel in ("fl", "fr", "rr", "rl")])
    off = offsets - OFFSETS_A
    assert off @ [1.0, 1.0, -1.0, -1.0] == pytest.approx(0.0, abs=0.02)
    assert result.torque_constant_n_m_a == CONSTANT


def test_what_was_found_predicts_and_what_was_believed_does_not(result: Result) -> None:
    assert result.chosen.held_out.rms_m < 1e-3 < 0.05 < result.before.rms_m
    assert result.chosen.held_out.against == result.before.against == "truth"
    assert result.chosen.start["mass_kg"] == pytest.approx(TRUE["mass_kg"], rel=2e-3)
    assert (result.chosen.contact, result.unknown, result.grip) == ("rigid", (), None)
    assert result.notes[-1] == (
        "the current sensors differ; true current over measured, against the mean of the four: fl 1.010, fr 0.980, "
        "rr 1.020, rl 0.990"
    )


def test_a_floor_that_slopes_is_named() -> None:
    sloping = driven(4.1, 1, slope_rad=0.06, slope_direction_rad=1.0)
    with pytest.raises(BadInputError, match=r"^floor.rrd: something pushed the robot .* slopes by 2\.\d degrees"):
        fit(sloping, driven(2.5, 2), contacts=["rigid"])


def test_a_drive_that_shows_a_broken_robot_or_too_little_is_not_fitted() -> None:
    """In any of the drives; and a circle at one speed on the floor."""
    sound, blocks = driven(2.5, 2), on_blocks()
    dead = {name: replace(one, current_a=one.current_a * [1.0, 0.01, 1.0, 1.0], path=Path(f"{name}.rrd"))
            for name, one in (("floor", sound), ("held_out", sound), ("blocks", blocks))}  # fmt: skip
    for name in dead:
        every = {"floor": sound, "held_out": sound, "blocks": blocks, name: dead[name]}
        with pytest.raises(BadInputError, match=f"^{name}.rrd: wheel fr turned, but its current sensor shows next to"):
            fit(every["floor"], every["held_out"], blocks=every["blocks"])
    circle = replace(coasting((0.3, 0.2, 0.8)), current_a=np.random.default_rng(1).normal(size=(1201, 4)))
    with pytest.raises(BadInputError, match="a circle or a line at one speed does not"):
        fit(circle, sound)


def coasting(twist: tuple[float, float, float], scale: float = 1.0) -> Drive:
    """Return a robot that rolls on without friction, and turns evenly; its true ways are ``scale`` times as long."""
    time_s = PERIOD_S * np.arange(1201)
    vx, vy, rate = twist
    way = (vx + 1j * vy) * (np.exp(1j * rate * time_s) - 1.0) / (1j * rate)
    place = 3.0 - 1.0j + scale * way * np.exp(0.7j)
    truth = np.stack([place.real, place.imag, 0.7 + rate * time_s], axis=1)
    angle = wheel_angles(np.outer(time_s, twist), 0.06, 0.41)
    return formula_drive(angle, yaw_rate_rad_s=np.full(1201, rate + BIAS_RAD_S), truth=truth)


# Where the wheels' spin turns with the body, the plant is driven off a circle: so wheels without inertia.
ROLLING: dict[str, Any] = {
    "contact": "rigid", "drive": "torque", "wheel_inertia_kg_m2": 0.0, "wheel_radius_m": 0.06,
    "half_length_m": 0.24, "half_width_m": 0.17,
}  # fmt: skip


def test_a_prediction_is_judged_by_where_the_robot_is_after_a_second() -> None:
    drive = coasting((0.3, 0.2, 0.8))
    chord = float(np.hypot(0.3, 0.2)) * 2.0 * float(np.sin(0.4)) / 0.8
    for scale in (1.0, 1.1):
        found = predict(coasting((0.3, 0.2, 0.8), scale), ROBOT, BIAS_RAD_S, ROLLING, CONSTANT)
        straight = float(np.hypot(0.3, 0.2))
        # A body without wheels keeps its velocity in the room, however it turns.
        end = straight * np.exp(1j * np.arctan2(0.2, 0.3))
        there = scale * chord * np.exp(1j * (np.arctan2(0.2, 0.3) + 0.4))
        assert found.rms_m == pytest.approx(abs(end - there), rel=1e-3)
        assert found.against == "truth"
    unseen = replace(drive, truth=np.full((1201, 3), np.nan))
    by_wheels = predict(unseen, ROBOT, BIAS_RAD_S, ROLLING, CONSTANT)
    assert by_wheels.against == "wheels and gyro"
    assert by_wheels.rms_m == pytest.approx(predict(drive, ROBOT, BIAS_RAD_S, ROLLING, CONSTANT).rms_m, rel=1e-3)


def test_currents_move_a_prediction_as_torques_of_the_wheels() -> None:
    """A robot that stood still, by a force of 4 κ i / r for a second."""
    still = formula_drive(np.zeros((1201, 4)), current_a=np.full((1201, 4), 0.2), truth=np.zeros((1201, 3)))
    found = predict(still, ROBOT, 0.0, ROLLING | {"mass_kg": 16.0}, CONSTANT)
    assert found.rms_m == pytest.approx(0.5 * 4.0 * CONSTANT * 0.2 / 0.06 / 16.0, rel=0.01)


# Windows


def test_windows_follow_one_another_and_have_what_was_measured_in_each_bin() -> None:
    time_s = PERIOD_S * np.arange(431)
    tones = Tones.of(3, [8.0, 9.0, 7.0, 6.0, 0.5], 0.3, 1.0)
    angle, yaw_rate = tones.at(time_s, -1)[:, :4], tones.at(time_s)[:, 4]
    current = np.arange(431)[:, None] + np.array([0.1, 0.2, 0.3, 0.4])
    drive = formula_drive(angle, current_a=current, yaw_rate_rad_s=yaw_rate)
    windows = cut(drive, ROBOT)
    assert windows.first.tolist() == [1, 101, 201, 301]
    assert (windows.rows_a_bin, windows.period_s, windows.measured.shape) == (10, PERIOD_S, (4, 10, 5))
    for place, first in enumerate(windows.first):
        assert np.array_equal(windows.current_a[place], current[first + 1 : first + 101])
        for one in range(10):
            rows = slice(first + 10 * one, first + 10 * one + 11)
            assert windows.measured[place, one, :4] == pytest.approx(np.ptp(time_s[rows]) ** -1 * (
                angle[rows][-1] - angle[rows][0]
            ))  # fmt: skip
            assert windows.measured[place, one, 4] == pytest.approx(np.trapezoid(yaw_rate[rows], dx=0.1))
        fl, fr, rr, rl = (angle[first + 1] - angle[first - 1]) / (2.0 * PERIOD_S)
        guess = (0.015 * (fl + fr + rr + rl), 0.015 * (-fl + fr - rr + rl), 0.015 / 0.41 * (-fl + fr + rr - rl))
        assert windows.twist[place] == pytest.approx(guess)
    settled = cut(drive, ROBOT, 0.2, settling_bins=2)
    assert settled.first.tolist() == [1, 61, 121, 181, 241, 301, 361]
    assert settled.measured.shape == (7, 4, 5)
    assert settled.current_a.shape == (7, 60, 4)
    assert settled.measured[0] == pytest.approx(windows.measured[0, 2:6])
    assert len(cut(replace(drive, time_s=drive.time_s[:202], angle_rad=angle[:202]), ROBOT).first) == 1
    assert len(cut(replace(drive, time_s=drive.time_s[:203], angle_rad=angle[:203]), ROBOT).first) == 2


@pytest.mark.parametrize(("count", "kept"), [(10, range(7)), (7, range(7)), (3, (0, 3, 6)), (2, (0, 6))])
def test_windows_are_thinned_evenly(count: int, kept: Any) -> None:
    each = np.arange(7)
    tables = (np.repeat(each, size).reshape(7, *shape) for size, shape in ((8, (2, 4)), (5, (1, 5)), (3, (3,))))
    every = Windows(*tables, each, 2, 0.1)
    found = every.thinned(count)
    assert found.first.tolist() == list(kept)
    for series in (found.current_a[:, 0, 0], found.measured[:, 0, 0], found.twist[:, 0]):
        assert series.tolist() == list(kept)
    assert (found.rows_a_bin, found.period_s) == (2, 0.1)


def test_a_sample_between_two_bins_counts_half_in_each() -> None:
    samples = np.array([[[1.0], [2.0], [4.0], [8.0], [16.0]]])
    assert mean_of_samples(samples, 2).tolist() == [[[2.25], [9.0]]]


def test_windows_are_predicted_with_the_gains_and_offsets_of_currents_and_the_bias_of_the_gyro() -> None:
    """As those of a robot whose current sensors are corrected beforehand, and which has no gyro's bias."""
    windows = cut(driven(2.0, 1), ROBOT)
    lengths = {name: value for name, value in TRUE.items() if name != "mass_kg"}
    start = {**lengths, "contact": "rigid", "drive": "torque", "longest_step_s": 0.01}
    mass, parameters = variable("mass_kg"), [variable("mass_kg"), GYRO_BIAS, *GAIN_PARAMETERS, *OFFSETS]
    true = [mass.internal(TRUE["mass_kg"]), GYRO_BIAS.internal(BIAS_RAD_S), *np.log(GAINS), *(OFFSETS_A / 0.1)]
    twist = np.zeros((2, len(windows.first), 3))
    with Floor(start, parameters, windows, CONSTANT) as floor:
        plain = np.array([true[0], 0.0, *np.zeros(8)])
        seen = floor.predict(np.array([true, plain]), twist).reshape(2, -1, 10, 5)
    currents = windows.current_a * GAINS + OFFSETS_A
    with Floor(start, [mass], windows._replace(current_a=currents), CONSTANT) as floor:
        corrected = floor.predict(np.array([[true[0]], [true[0] + 0.1]]), twist).reshape(2, -1, 10, 5)
    assert seen[0, ..., :4] == pytest.approx(corrected[0, ..., :4], abs=1e-5)
    assert seen[0, ..., 4] == pytest.approx(corrected[0, ..., 4] + BIAS_RAD_S, abs=1e-6)
    assert np.abs(seen[1] - seen[0]).max() > 0.02
    assert np.abs(corrected[1] - corrected[0]).max() > 0.1, "a heavier robot is slower"


def test_the_noise_of_what_is_left_is_that_of_the_wheels_and_that_of_the_gyro() -> None:
    windows = cut(driven(2.0, 1), ROBOT)
    with Floor({}, [variable("mass_kg")], windows, CONSTANT) as floor:
        random = np.random.default_rng(1)
        left = random.normal(size=(len(windows.first), 10, 5)) * [0.2, 0.2, 0.2, 0.2, 0.01]
        found = floor.sigmas(left.reshape(len(left), -1)).reshape(10, 5)
        wheels, gyro = (1.4826 * np.median(np.abs(one)) for one in (left[..., :4], left[..., 4]))
        assert found == pytest.approx(np.tile([wheels, wheels, wheels, wheels, gyro], (10, 1)))
        least = floor.sigmas(0.0 * left.reshape(len(left), -1)).reshape(10, 5)
        assert least == pytest.approx(np.tile([3e-3, 3e-3, 3e-3, 3e-3, 1e-3], (10, 1)))
        sensors = floor.least_sigmas.reshape(10, 5)
        assert sensors == pytest.approx(np.tile([0.015, 0.015, 0.015, 0.015, 0.004], (10, 1)))

"""Kinematics of hil identify on motions that are formulas: radius, lever, scales, and what drives must show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from hil.addons.identify.drive_checks import check_excitation, check_level, check_motors
from hil.addons.identify.drives import Drive
from hil.addons.identify.fit_kinematics import Kinematics, fit_kinematics, with_geometry
from hil.addons.identify.windows import cut, rolled
from hil.core.errors import BadInputError
from hil.core.kinematics import wheel_speeds
from tests.support.formula_drives import PERIOD_S, ROBOT, Tones, formula_drive, wheel_angles

RADIUS_M, LEVER_M, SIDEWAYS, BIAS_RAD_S, LATE_S = 0.0615, 0.43, 0.985, 0.012, 0.03
SECONDS = 50.0


def moved(seconds: float = SECONDS, sideways: float = SIDEWAYS) -> Drive:
    """Return a drive on all axes at once, with the true poses."""
    time_s = PERIOD_S * np.arange(round(seconds / PERIOD_S) + 1)
    tones = Tones.of(11, [0.5, 0.4, 0.9], 0.05, 0.7)
    ways, twist = tones.at(time_s, -1), tones.at(time_s)
    heading = ways[:, 2] - ways[0, 2] + 2.9
    along, aside = np.stack([np.cos(heading), np.sin(heading)]), np.stack([-np.sin(heading), np.cos(heading)])
    place = cumulative_simpson(twist[:, 0] * along + twist[:, 1] * aside, dx=PERIOD_S, initial=0.0)
    angle = wheel_angles(ways / [1.0, sideways, 1.0], RADIUS_M, LEVER_M)
    truth = np.stack([place[0] + 1.0, place[1] - 2.0, heading], axis=1)
    return formula_drive(angle - angle[0], yaw_rate_rad_s=twist[:, 2] + BIAS_RAD_S, truth=truth)


def with_fixes(drive: Drive, every: int = 20, late_s: float = LATE_S) -> Drive:
    """Return the drive with a fix every so many feedbacks, whose stamps are late, and headings that wrap."""
    rows = np.arange(60, len(drive.time_s) - 60, every)
    heading = np.angle(np.exp(1j * drive.truth[rows, 2]))
    columns = (drive.time_s[rows] + late_s, drive.truth[rows, 0], drive.truth[rows, 1], heading)
    return replace(drive, fixes=np.stack(columns, axis=1))


def test_radius_lever_scale_bias_and_delay_are_those_of_the_motion() -> None:
    found = fit_kinematics(with_fixes(moved()))
    assert found.scale_known
    assert found.radius_m == pytest.approx(RADIUS_M, rel=1e-4)
    assert found.lever_m == pytest.approx(LEVER_M, rel=1e-4)
    # It is believed to be 1, give or take 1 %, but these fixes know better.
    assert found.sideways == pytest.approx(SIDEWAYS, abs=2e-4)
    assert found.gyro_bias_rad_s == pytest.approx(BIAS_RAD_S, abs=1e-6)
    assert found.delay_s == pytest.approx(LATE_S, abs=1e-4)
    early = fit_kinematics(with_fixes(moved(26.0), late_s=-0.02))
    assert early.delay_s == pytest.approx(-0.02, abs=1e-3)


def test_the_doubt_of_the_radius_is_at_least_that_of_white_fixes() -> None:
    """Plain least squares on the way between the first fix of a window and each other one would know no more."""
    drive = with_fixes(moved(26.0), late_s=0.0)
    noisy = drive.fixes.copy()
    noisy[:, 1:3] += np.random.default_rng(2).normal(0.0, 0.02, (len(noisy), 2))
    found = fit_kinematics(replace(drive, fixes=noisy))
    assert found.radius_m == pytest.approx(RADIUS_M, rel=5.0 * float(np.sqrt(found.covariance[0, 0])))
    away = noisy[:, 1:3] - noisy[:, 1:3].mean(axis=0)
    white = 0.02 / float(np.sqrt(np.sum(away**2)))
    assert white < np.sqrt(found.covariance[0, 0]) < 2.0 * white
    assert found.covariance[0, 1] == pytest.approx(found.covariance[0, 0]), "the lever follows from the radius"
    assert found.covariance[1, 1] > found.covariance[0, 0]
    assert 0.5 * white < found.sideways_sigma < 0.02, "it was believed to be known to 0.01"


@pytest.mark.parametrize(("count", "is_known"), [(40, True), (39, False)])
def test_forty_fixes_give_the_scale_of_length(count: int, is_known: bool) -> None:
    drive = with_fixes(moved(26.0))
    found = fit_kinematics(replace(drive, fixes=drive.fixes[:count]))
    assert found.scale_known is is_known
    assert (found.radius_m == ROBOT.wheel_radius_m) is not is_known
    if not is_known:
        assert found.lever_m == pytest.approx(ROBOT.wheel_radius_m * LEVER_M / RADIUS_M, rel=1e-5)
        assert found.sideways == 1.0
        assert np.isnan([found.sideways_sigma, found.delay_s]).all()
        assert found.covariance[0, 0] == 0.0


def test_the_doubt_of_the_ratio_is_that_of_the_gyro_s_noise() -> None:
    drive = replace(moved(), fixes=np.zeros((0, 4)))
    noise = np.random.default_rng(4).normal(0.0, 0.05, len(drive.time_s))
    found = fit_kinematics(replace(drive, yaw_rate_rad_s=drive.yaw_rate_rad_s + noise))
    turns = np.diff(drive.truth[1:-1:200, 2])
    expected = 0.05 * np.sqrt(PERIOD_S) / float(np.sqrt(np.sum((turns - turns.mean()) ** 2)))
    assert np.sqrt(found.covariance[1, 1]) == pytest.approx(expected, rel=0.4)


def test_lengths_grow_with_the_lever_and_keep_their_shares() -> None:
    found = Kinematics(0.05, 0.82, 0.0, 1.0, 0.0, 0.0, np.zeros((2, 2)), True)
    assert with_geometry(ROBOT, found) == pytest.approx(
        {"wheel_radius_m": 0.05, "half_length_m": 0.48, "half_width_m": 0.34}
    )


def test_a_robot_that_hardly_turned_or_whose_gyro_is_reversed_is_refused() -> None:
    drive = moved(26.0)
    straight = replace(drive, angle_rad=drive.angle_rad @ np.full((4, 4), 0.25))
    with pytest.raises(BadInputError, match=r"^floor.rrd: the robot hardly turned; expected turns of 1 rad in all"):
        fit_kinematics(straight)
    with pytest.raises(BadInputError, match=r"^floor.rrd: gyro and wheels turn in opposite directions; hil commission"):
        fit_kinematics(replace(drive, yaw_rate_rad_s=-drive.yaw_rate_rad_s))


@pytest.mark.parametrize(("turned_rad", "is_enough"), [(0.98, False), (1.02, True)])
def test_turns_of_a_radian_in_all_are_enough(turned_rad: float, is_enough: bool) -> None:
    """To either side, counted from second to second; the first and the last row have no speed and do not count."""
    time_s = PERIOD_S * np.arange(1003)
    heading = turned_rad * np.interp(time_s - time_s[1], np.arange(6), [0.0, 0.3, 0.2, 0.4, 0.2, 0.4])
    ways = np.stack([0.0 * time_s, 0.0 * time_s, heading], axis=1)
    drive = formula_drive(
        wheel_angles(ways, ROBOT.wheel_radius_m, ROBOT.lever_m), yaw_rate_rad_s=np.gradient(heading, PERIOD_S)
    )
    if is_enough:
        assert fit_kinematics(drive).lever_m == pytest.approx(ROBOT.lever_m, rel=0.01)
        return
    with pytest.raises(BadInputError, match="hardly turned"):
        fit_kinematics(drive)


def test_wheels_and_gyro_give_the_pose_since_the_start() -> None:
    drive = moved(20.0, sideways=1.0)
    robot = replace(ROBOT, wheel_radius_m=RADIUS_M)
    poses = rolled(drive, robot, BIAS_RAD_S)
    x, y, heading = (drive.truth - drive.truth[0]).T
    c, s = np.cos(drive.truth[0, 2]), np.sin(drive.truth[0, 2])
    assert poses == pytest.approx(np.stack([c * x + s * y, c * y - s * x, heading], axis=1), abs=2e-4)


# What a drive must show


def test_motors_that_do_a_tenth_of_the_others_are_not_taken_for_broken() -> None:
    drive = moved(5.0)
    turning = replace(drive, current_a=np.gradient(drive.angle_rad, axis=0) + 3.0)
    check_motors(turning)
    for wheel, name in enumerate(("fl", "fr", "rr", "rl")):
        for quantity, words in (
            ("angle_rad", f"^floor.rrd: wheel {name} turned next to nothing while the others did: it is blocked"),
            ("current_a", f"^floor.rrd: wheel {name} turned, but its current sensor shows next to nothing: it is dead"),
        ):
            series = getattr(turning, quantity)
            usual = np.median(np.std(np.diff(series, axis=0) if quantity == "angle_rad" else series, axis=0))
            own = np.std(np.diff(series[:, wheel]) if quantity == "angle_rad" else series[:, wheel])
            for share, is_sound in ((0.13, True), (0.06, False)):
                other = series.copy()
                other[:, wheel] *= share * usual / own
                changed = replace(turning, **{quantity: other})
                if is_sound:
                    check_motors(changed)
                else:
                    with pytest.raises(BadInputError, match=words):
                        check_motors(changed)
    with pytest.raises(BadInputError, match=r"^floor.rrd: the robot measured no currents. Without them mass"):
        check_motors(drive)


@pytest.mark.parametrize(
    ("axis", "least", "words"),
    [
        (0, 0.1, r"the forward speed usually changes by 0\.09\d* m/s2; expected at least 0.1 m/s2, .* tell mass_kg"),
        (1, 0.1, r"the sideways speed usually changes by 0\.09\d* m/s2; expected at least 0.1 m/s2, .* tell mass_kg"),
        (2, 0.3, r"the turning speed usually changes by 0\.2\d* rad/s2; expected at least 0.3 rad/s2, .* inertia_kg"),
    ],
)
def test_a_drive_must_change_the_speed_of_each_axis(axis: int, least: float, words: str) -> None:
    """By accelerations to and fro, of which the median is 1.4826 times as large where each is as large."""
    time_s = PERIOD_S * np.arange(1201)
    swing = np.abs((time_s - 0.005) % 2.0 - 1.0) - 0.5  # ± 1 per second, and its kinks are at the ends of bins

    def drive(*accelerations: float) -> Drive:
        twist = np.outer(swing, accelerations) / 1.4826
        angle = np.cumsum([wheel_speeds(tuple(row), 0.06, 0.41) for row in twist], axis=0) * PERIOD_S
        return formula_drive(angle, yaw_rate_rad_s=twist[:, 2])

    enough = [0.5, 0.5, 1.0]
    enough[axis] = 1.05 * least
    check_excitation(drive(*enough))
    enough[axis] = 0.95 * least
    with pytest.raises(BadInputError, match=f"^floor.rrd: {words}"):
        check_excitation(drive(*enough))


@pytest.mark.parametrize(("forward", "left"), [(0.3, 0.0), (0.0, -0.3), (0.24, 0.18)])
def test_what_pushes_a_robot_one_way_in_the_room_is_a_slope(forward: float, left: float) -> None:
    """The robot turns meanwhile, so that its own axes see it from all sides."""
    drive = replace(moved(12.0), yaw_rate_rad_s=np.full(2401, 0.5), path=Path("floor.rrd"))
    windows = cut(drive, ROBOT)
    middles = 0.05 * (np.arange(10) + 0.5)

    def left_over(size: float) -> np.ndarray:
        heading = 0.5 * (windows.first * PERIOD_S)
        along, aside = (
            size * (forward * np.cos(heading) + left * np.sin(heading)),
            size * (left * np.cos(heading) - forward * np.sin(heading)),
        )
        rows = [
            [[*wheel_speeds((one * t, other * t, 0.0), ROBOT.wheel_radius_m, ROBOT.lever_m), 0.0] for t in middles]
            for one, other in zip(along, aside, strict=True)
        ]
        return np.array(rows).reshape(len(windows.first), -1) + 0.7

    # sin(slope) times gravity; the median of pushes that are all alike is each of them.
    with pytest.raises(BadInputError, match=r"^floor.rrd: something pushed .* slopes by 1\.8 degrees or more; drive"):
        check_level(drive, windows, left_over(1.0), ROBOT)
    check_level(drive, windows, left_over(0.059 / 0.3), ROBOT)
    with pytest.raises(BadInputError, match=r"slopes by 0\.4 degrees"):
        check_level(drive, windows, left_over(0.061 / 0.3), ROBOT)
    # What scatters from window to window as widely is chance.
    chance = np.random.default_rng(1).normal(0.0, 1.0, (len(windows.first), 1))
    scatter = np.tile([1.0, 1.0, 1.0, 1.0, 0.0], 10) * np.repeat(middles, 5) * chance
    check_level(drive, windows, left_over(1.0) + 20.0 * scatter, ROBOT)
    with pytest.raises(BadInputError, match="slopes by"):
        check_level(drive, windows, left_over(1.0) + 2.0 * scatter, ROBOT)

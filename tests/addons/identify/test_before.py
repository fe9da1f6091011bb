"""What hil identify knows before the dynamics: wheels on blocks, whose motion is a formula, and what is believed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import huber

from hil.addons.identify.before import Before, BlocksFit, fit_blocks
from hil.addons.identify.drives import Drive
from hil.addons.identify.fit_kinematics import Kinematics
from hil.addons.identify.robust_statistics import huber_loss, huber_weights, regression, sigma
from hil.core.errors import BadInputError
from tests.support.formula_drives import PERIOD_S, ROBOT, Tones, formula_drive

CONSTANT = 1.3
INERTIA, VISCOUS = np.array([4e-3, 5e-3, 3.6e-3, 4.4e-3]), np.array([0.012, 0.02, 0.016, 0.018])
COULOMB, OFFSET = np.array([0.04, 0.05, 0.06, 0.03]), np.array([0.01, -0.02, 0.03, 0.005])


def on_blocks(seconds: float = 12.0, noise_a: float = 0.0, seed: int = 5) -> Drive:
    """Return wheels that turn freely, and the mean current over each period that this takes."""
    time_s = PERIOD_S * np.arange(round(seconds / PERIOD_S) + 1)
    tones = Tones.of(seed, [9.0, 11.0, 10.0, 12.0], 0.2, 0.9)
    angle, speed = tones.at(time_s, -1), tones.at(time_s)
    impulse = INERTIA * np.diff(speed, axis=0) + VISCOUS * np.diff(angle, axis=0)
    impulse += PERIOD_S * (COULOMB * np.sign(0.5 * (speed[1:] + speed[:-1])) + OFFSET)
    current = np.concatenate([np.zeros((1, 4)), impulse / (CONSTANT * PERIOD_S)])
    current += np.random.default_rng(seed).normal(0.0, noise_a, current.shape) if noise_a else 0.0
    return formula_drive(angle, current_a=current, path=Path("blocks.rrd"))


def test_wheels_on_blocks_give_the_means_of_inertia_and_friction_as_they_are() -> None:
    found = fit_blocks(on_blocks(), CONSTANT)
    assert found.inertia_kg_m2 == pytest.approx(INERTIA.mean(), rel=2e-4)
    assert found.viscous_n_m_s_rad == pytest.approx(VISCOUS.mean(), rel=2e-3)
    twice = fit_blocks(on_blocks(), 2.0 * CONSTANT)
    assert twice.inertia_kg_m2 == pytest.approx(2.0 * found.inertia_kg_m2, rel=1e-9)
    assert found.covariance[0, 0] < (1e-5 * INERTIA.mean()) ** 2, "nothing was noisy"


def test_the_doubt_of_wheels_on_blocks_is_the_scatter_of_what_is_found() -> None:
    fits = [fit_blocks(on_blocks(30.0, 0.3, seed), CONSTANT) for seed in range(10)]
    off = np.array([(one.inertia_kg_m2, one.viscous_n_m_s_rad) for one in fits]) - [INERTIA.mean(), VISCOUS.mean()]
    scaled = off / np.sqrt([np.diag(one.covariance) for one in fits])
    assert np.sqrt(np.mean(scaled**2, axis=0)) == pytest.approx([1.0, 1.0], abs=0.4)
    logarithms = fits[0].covariance_of_logarithms()
    shares = fits[0].covariance[0] / fits[0].inertia_kg_m2 / [fits[0].inertia_kg_m2, fits[0].viscous_n_m_s_rad]
    assert logarithms[0] == pytest.approx(shares)
    assert logarithms[1, 1] == pytest.approx(fits[0].covariance[1, 1] / fits[0].viscous_n_m_s_rad ** 2)


def test_a_wheel_that_hardly_turned_on_blocks_is_named_with_its_time() -> None:
    drive = on_blocks()
    slow = drive.angle_rad * [1.0, 1.0, 0.02, 1.0]
    with pytest.raises(BadInputError, match=r"^blocks.rrd: wheel rr turned next to nothing while the others did"):
        fit_blocks(replace(drive, angle_rad=slow), CONSTANT)
    time_s = PERIOD_S * np.arange(2000)[:, None]
    angle = np.where(time_s < 3.6, 8.0 * time_s, 28.8) * [1.0, 1.0, 1.0, -1.0]
    turned = replace(formula_drive(angle), current_a=on_blocks().current_a[:2000])
    # Bins of 0.1 s in which the mean speed over 40 ms is never below 0.3 rad/s, and none at the edge of the recording.
    with pytest.raises(BadInputError, match=r": wheel fl turned for 3\.5 s; expected at least 4 s on blocks, .* 0\.3"):
        fit_blocks(turned, CONSTANT)


@pytest.mark.parametrize(("errors", "is_none"), [(-2.5, True), (-3.5, False)])
def test_a_friction_below_zero_by_three_errors_is_none_and_by_more_a_wrong_sign(errors: float, is_none: bool) -> None:
    drive = on_blocks(noise_a=0.1)
    sound = fit_blocks(drive, CONSTANT)
    error = float(np.sqrt(sound.covariance[1, 1]))
    less = (sound.viscous_n_m_s_rad - errors * error) / CONSTANT * np.gradient(drive.angle_rad, PERIOD_S, axis=0)
    other = replace(drive, current_a=drive.current_a - less)
    if is_none:
        assert fit_blocks(other, CONSTANT).viscous_n_m_s_rad == pytest.approx(error, rel=0.02)
        return
    words = r"inertia came out as 0\.004\d* kg m2 and their viscous friction as -\S+ N m s/rad; expected positive"
    with pytest.raises(BadInputError, match=words):
        fit_blocks(other, CONSTANT)


KINEMATICS = Kinematics(0.061, 0.42, 0.013, 1.0, 0.0, 0.0, np.array([[4e-6, 1e-6], [1e-6, 9e-6]]), True)
BLOCKS = BlocksFit(4.2e-3, 0.017, np.array([[1e-9, -2e-9], [-2e-9, 1.6e-8]]))
VARIANCE, USUAL_A = np.array([1e-6, 2e-6, 3e-6, 4e-6]), np.array([1.0, 1.2, 0.8, 1.5])


def before(blocks: BlocksFit | None = None) -> Before:
    return Before(ROBOT, CONSTANT, KINEMATICS, blocks, VARIANCE, USUAL_A)


@pytest.mark.parametrize("blocks", [None, BLOCKS])
@pytest.mark.parametrize("contact", ["rigid", "slip"])
def test_a_fit_begins_where_the_robot_is_believed_to_be(contact: str, blocks: BlocksFit | None) -> None:
    parameters = before(blocks).parameters(contact)
    point = before(blocks).point(parameters, {"mass_kg": 15.0, "com_x_m": 0.02})
    values = {one.name: float(one.value(number)) for one, number in zip(parameters, point, strict=True)}
    expected = {
        "mass_kg": 15.0, "inertia_kg_m2": 0.7, "wheel_inertia_kg_m2": 0.004, "com_x_m": 0.02, "com_y_m": 0.0,
        "friction_coefficient": 0.02, "viscous_n_m_s_rad": 0.02, "stretch_m": 0.0, "wheel_radius_m": 0.06,
        "lever_m": 0.41, "gyro_bias_rad_s": 0.013,
        **{f"current_gain.{wheel}": 1.0 for wheel in ("fl", "fr", "rr", "rl")},
        **{f"current_offset.{wheel}_a": 0.0 for wheel in ("fl", "fr", "rr", "rl")},
    }  # fmt: skip
    if contact == "slip":
        expected |= {"grip_coefficient": 0.7, "roller_friction_coefficient": 0.01, "roller_stiffness_n_m": 2e5}
    if blocks is not None:
        expected |= {"wheel_inertia_kg_m2": 4.2e-3, "viscous_n_m_s_rad": 0.017}
    assert values == pytest.approx(expected)
    assert parameters[-1].name == "gyro_bias_rad_s"


def known_of(names: list[str], blocks: BlocksFit | None = None, contact: str = "slip") -> np.ndarray:
    """Return the information on these parameters alone."""
    parameters = before(blocks).parameters(contact)
    places = [[one.name for one in parameters].index(name) for name in names]
    return before(blocks).knowledge(parameters).information[np.ix_(places, places)]


def test_what_is_believed_of_each_value_has_its_doubt() -> None:
    wheels = ("fl", "fr", "rr", "rl")
    gains, offsets = [f"current_gain.{one}" for one in wheels], [f"current_offset.{one}_a" for one in wheels]
    # Their mean is in the torque constant: it is known to 1e-4, and differences to 2 %.
    covariance = np.linalg.inv(known_of(gains))
    mean, difference = np.full(4, 0.25), np.array([0.5, -0.5, 0.5, -0.5])
    assert mean @ covariance @ mean == pytest.approx((VARIANCE + 1e-8) @ mean**2)
    apart = difference @ covariance @ difference
    assert apart == pytest.approx(0.02**2 + (VARIANCE + 1e-8).sum() / 4.0)
    assert known_of(offsets) == pytest.approx(np.diag((0.1 / (0.01 * USUAL_A)) ** 2))
    # Half the length and half the width are known to 2 % each, and only their sum is measured.
    length, width = ROBOT.half_length_m, ROBOT.half_width_m
    stretches = [one - length / (length + width) * (one + other) for one, other in (
        (1.02 * length, width), (length, 1.02 * width))]  # fmt: skip
    assert known_of(["stretch_m"])[0, 0] == pytest.approx(0.05**2 / np.sum(np.square(stretches)))
    rubber = ["grip_coefficient", "roller_friction_coefficient", "roller_stiffness_n_m"]
    assert known_of(rubber) == pytest.approx(np.diag([0.3**-2, 1.0, 0.7**-2]))
    assert not known_of(["mass_kg", "inertia_kg_m2", "com_x_m", "com_y_m", "wheel_inertia_kg_m2"]).any()


def test_lengths_are_held_with_the_doubt_of_the_kinematics() -> None:
    parameters = before().parameters("rigid")
    known = before().knowledge(parameters)
    assert [one.name for one, is_held in zip(parameters, known.held, strict=True) if is_held] == [
        "wheel_radius_m", "lever_m"
    ]  # fmt: skip
    assert known.held_covariance[np.ix_(known.held, known.held)] == pytest.approx(KINEMATICS.covariance)
    assert np.count_nonzero(known.held_covariance) == 4
    assert np.array_equal(known.mean, before().point(parameters, {}))


def test_blocks_tell_wheels_in_proportion_to_the_gains_of_the_current_sensors() -> None:
    """The doubt of the logarithms of inertia and friction, with that of the mean gain on top in both."""
    wheels = ["wheel_inertia_kg_m2", "viscous_n_m_s_rad"]
    gains = [f"current_gain.{one}" for one in ("fl", "fr", "rr", "rl")]
    covariance = np.linalg.inv(known_of([*wheels, *gains], BLOCKS))
    alone = BLOCKS.covariance / np.outer([4.2e-3, 0.017], [4.2e-3, 0.017])
    mean_gain = (VARIANCE + 1e-8).sum() / 16.0
    assert covariance[:2, :2] == pytest.approx(alone + mean_gain, rel=1e-6)
    assert covariance[:2, 2:].sum(axis=1) / 4.0 == pytest.approx([mean_gain] * 2, rel=1e-5)


# Robust statistics, against SciPy and plain loops


def test_huber_s_loss_is_scipy_s_and_its_weights_are_its_slope_over_the_residual() -> None:
    residual = np.array([-9.0, -1.6, -1.5, -1.4, -0.2, 0.3, 1.4, 1.6, 40.0])
    assert huber_loss(residual) == pytest.approx(huber(1.5, residual))
    slope = (huber(1.5, residual + 1e-6) - huber(1.5, residual - 1e-6)) / 2e-6
    assert huber_weights(residual) == pytest.approx(slope / residual, abs=1e-6)
    assert sigma(np.array([-3.0, 1.0, 2.0, -2.0, 50.0])) == pytest.approx(1.4826 * 2.0)


def test_a_robust_regression_and_its_sandwich_are_those_of_plain_loops() -> None:
    random = np.random.default_rng(3)
    design = random.normal(size=(240, 2)) * [1.0, 3.0]
    instrument = design + random.normal(size=design.shape)
    clusters = np.repeat(np.arange(60), 4)
    shared = np.repeat(random.normal(size=60), 4)
    values = design @ [0.7, -0.2] + 0.3 * shared + random.normal(0.0, 0.1, 240)
    values[::17] += 30.0
    found, covariance = regression(design, values, instrument, clusters)
    assert found == pytest.approx([0.7, -0.2], abs=0.1)
    left = values - design @ found
    scale = 1.4826 * float(np.median(np.abs(left)))
    weights = np.minimum(1.0, 1.5 * scale / np.abs(left))
    # Where it ends, the instruments see nothing in what is left.
    assert np.abs(instrument.T @ (weights * left)).max() < 0.02 * np.abs(instrument.T @ left).max()
    bread = np.linalg.inv(sum(w * np.outer(z, x) for w, z, x in zip(weights, instrument, design, strict=True)))
    meat = np.zeros((2, 2))
    for one in range(60):
        rows = slice(4 * one, 4 * one + 4)
        score = sum(w * r * z for w, r, z in zip(weights[rows], left[rows], instrument[rows], strict=True))
        meat += np.outer(score, score)
    assert covariance == pytest.approx(bread @ meat @ bread.T, rel=1e-6)


def test_a_regression_of_exact_numbers_is_exact() -> None:
    design = np.arange(12.0).reshape(6, 2) ** 1.5
    found, covariance = regression(design, design @ [2.0, -3.0], design, np.arange(6))
    assert found == pytest.approx([2.0, -3.0], rel=1e-9)
    assert np.abs(covariance).max() < 1e-15

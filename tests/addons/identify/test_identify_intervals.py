"""Intervals of hil identify against fits that leave out a window, and what drives cannot tell in exact figures."""

from dataclasses import replace

import numpy as np
import pytest

from hil.addons.identify.currents import quiet
from hil.addons.identify.drive_checks import Unknown, outlook
from hil.addons.identify.gauss_newton import Knowledge, information_of, solve
from hil.addons.identify.windows import GYRO_BIAS, Parameter
from hil.core.errors import BadInputError
from tests.addons.identify.test_identify_currents import NOISE_A, drive_of_torques
from tests.addons.identify.test_identify_solver import MEASURED, PARAMETERS, SIGMA, WIDE, WINDOWS, Linear


def tame(seed: int) -> Linear:
    """Return windows whose noise is within a standard deviation, so that Huber's loss is a square."""
    one = Linear(seed)
    clean = one.by_parameters @ one.true + np.einsum("wms,ws->wm", one.by_start, one.own)
    one.measured = clean + SIGMA * np.random.default_rng(seed).uniform(-0.9, 0.9, clean.shape)
    return one


def normal(one: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Return what each window adds to the normal equations of the parameters once its own start is eliminated."""
    matrices, vectors = np.zeros((WINDOWS, 3, 3)), np.zeros((WINDOWS, 3))
    for window in range(WINDOWS):
        a, b, y = one.by_parameters[window] / SIGMA, one.by_start[window] / SIGMA, one.measured[window] / SIGMA
        without = np.eye(MEASURED) - b @ np.linalg.inv(b.T @ b) @ b.T
        matrices[window], vectors[window] = a.T @ without @ a, a.T @ without @ y
    return matrices, vectors


@pytest.mark.parametrize("known_sigma", [None, 0.002])
def test_the_covariance_is_that_of_fits_without_each_window(known_sigma: float | None) -> None:
    """The jackknife, done in full; knowledge from elsewhere has its own covariance and is never left out."""
    one = tame(11)
    known = Knowledge.none(PARAMETERS)
    if known_sigma is not None:
        known.information[0, 0], known.mean[0] = known_sigma**-2, 0.405
    found = solve(one, one.true, bounds=WIDE, known=known)
    matrices, vectors = normal(one)
    whole, aim = matrices.sum(axis=0) + known.information, vectors.sum(axis=0) + known.information @ known.mean
    best = np.linalg.solve(whole, aim)
    # A step of less than a hundredth of a standard deviation ends a fit.
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs((found.parameters - best) / sigma).max() < 0.05
    without = np.array([
        np.linalg.solve(whole - matrix, aim - vector) for matrix, vector in zip(matrices, vectors, strict=True)
    ]) - best  # fmt: skip
    inverse = np.linalg.inv(whole)
    expected = without.T @ without + inverse @ known.information @ inverse
    scale = np.sqrt(np.diag(expected))
    assert found.covariance / np.outer(scale, scale) == pytest.approx(expected / np.outer(scale, scale), abs=0.02)
    assert found.information == pytest.approx(matrices.sum(axis=0), rel=1e-3, abs=1.0)
    assert information_of(one, one.true) == pytest.approx(matrices.sum(axis=0), rel=1e-6, abs=1e-3)
    for window in (0, 17):
        a, b = one.by_parameters[window], one.by_start[window]
        start = np.linalg.lstsq(b, one.measured[window] - a @ found.parameters, rcond=None)[0]
        assert found.starts[window] == pytest.approx(start, abs=0.02 * SIGMA)


def test_a_parameter_stays_within_its_bounds() -> None:
    one = tame(12)
    least, most = one.true - [1.0, 1.0, 0.0], one.true + np.array([-0.1, 1.0, 1.0])
    found = solve(one, one.true - [0.5, 0.0, 0.0], bounds=(least, most))
    assert found.parameters[0] == pytest.approx(one.true[0] - 0.1, abs=1e-9)
    assert (found.parameters >= least).all()


class Apart:
    """Windows in which each parameter, or direction of two, has a measurement of its own, and the start another."""

    def __init__(self, sizes: list[float], turned_rad: float = 0.0) -> None:
        self.matrix = np.zeros((len(sizes) + 1, len(sizes)))
        self.matrix[:-1] = np.diag(sizes)
        c, s = np.cos(turned_rad), np.sin(turned_rad)
        self.matrix[:2, :2] = np.diag(sizes[:2]) @ [[c, -s], [s, c]]
        self.starts, self.start_steps = np.zeros((25, 1)), np.array([1e-3])
        self.measured, self.least_sigmas = np.zeros((25, len(sizes) + 1)), np.full(len(sizes) + 1, 0.2)

    def predict(self, parameters: np.ndarray, starts: np.ndarray) -> np.ndarray:
        seen = np.repeat((parameters @ self.matrix.T)[:, None], 25, axis=1)
        seen[..., -1] += starts[..., 0]
        return seen

    def sigmas(self, residual: np.ndarray) -> np.ndarray:
        return self.least_sigmas


def size_for(sigma: float) -> float:
    """Return how much a parameter must do to be known to ``sigma`` by 25 windows, with four times the noise of 0.2."""
    return 4.0 * 0.2 / (5.0 * sigma)


def told(names: list[str], sigmas: list[float], turned_rad: float = 0.0) -> tuple[Unknown, ...]:
    parameters = [Parameter(name, {name: 1.0}) for name in names]
    known = Knowledge.none(len(names))
    return outlook(Apart([size_for(one) for one in sigmas], turned_rad), parameters, np.zeros(len(names)), known)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("grip_coefficient", "squeeze the wheels against one another until they slip (hil identify drive)"),
        ("roller_stiffness_n_m", "drive to and fro faster; it matters little elsewhere"),
        ("roller_friction_coefficient", "coast along the rollers; it matters little elsewhere"),
        ("wheel_inertia_kg_m2", "spin the wheels on blocks (hil identify drive, --blocks)"),
        ("viscous_n_m_s_rad", "spin the wheels on blocks (hil identify drive, --blocks)"),
        ("com_x_m", "turn while driving"),
        ("com_y_m", "turn while driving"),
        ("inertia_kg_m2", "turn to and fro while driving: hil identify drive does so on all axes at once"),
        ("mass_kg", "accelerate to and fro on all axes at once, as hil identify drive does"),
        ("friction_coefficient", "drive at speeds from slow to fast"),
        ("something_else", "drive on all axes at once"),
    ],
)
def test_a_value_that_is_known_poorly_has_its_deviation_and_its_remedy(name: str, remedy: str) -> None:
    assert told(["a", name], [0.01, 0.0995]) == ()
    (one,) = told(["a", name], [0.01, 0.234])
    assert one.names == (name,)
    assert one.sigma == pytest.approx(0.234, rel=1e-6)
    assert one.sentence == f"{name} is known to 23% at best; {remedy}"


def test_values_that_are_told_apart_poorly_are_named_by_their_share() -> None:
    for turned_rad, names in ((0.29, ("com_x_m",)), (0.32, ("com_x_m", "grip_coefficient"))):
        (one,) = told(["com_x_m", "grip_coefficient"], [0.2, 0.001], turned_rad)
        assert one.names == names
    assert one.sentence.startswith("com_x_m, grip_coefficient are told apart to 20% at best; squeeze the wheels")
    (one,) = told(["com_x_m", "grip_coefficient"], [0.2, 0.001], np.pi / 2.0 - 0.32)
    assert one.names == ("grip_coefficient", "com_x_m"), "the largest share first"
    assert told(["a", "com_x_m"], [0.01, 33.0])[0].sentence.startswith("com_x_m is known to 999% at best")


@pytest.mark.parametrize("name", ["mass_kg", "inertia_kg_m2", "friction_coefficient"])
def test_without_mass_inertia_or_friction_no_prediction_is_worth_anything(name: str) -> None:
    assert [one.names for one in told(["a", name], [0.01, 0.49])] == [(name,)]
    with pytest.raises(BadInputError, match=f"^these recordings cannot tell {name}: {name} is known to 51% at best; "):
        told(["a", name], [0.01, 0.51])
    with pytest.raises(
        BadInputError, match=r"^these recordings cannot tell mass_kg and inertia_kg_m2: .*; .* at best; "
    ):
        told(["mass_kg", "inertia_kg_m2"], [0.6, 0.7])
    assert len(told(["a", "com_x_m"], [0.01, 0.6])) == 1, "without it they may be"


def test_what_is_held_or_a_nuisance_or_known_from_elsewhere_is_not_asked_for() -> None:
    parameters = [Parameter("mass_kg", {}), Parameter("wheel_radius_m", {}), GYRO_BIAS]
    experiment = Apart([size_for(3.0), size_for(4.0), size_for(5.0)])
    known = Knowledge.none(3)
    known.held[1] = True
    known.information[0, 0] = 0.25**-2
    (one,) = outlook(experiment, parameters, np.zeros(3), known)
    assert one.names == ("mass_kg",)
    assert one.sigma == pytest.approx((3.0**-2 + 0.25**-2) ** -0.5)


# Currents by their commands


@pytest.mark.parametrize(("rows", "is_used"), [(1007, True), (1006, False)])
def test_a_thousand_rows_of_commands_tell_the_currents(rows: int, is_used: bool) -> None:
    drive, _ = drive_of_torques(3)
    names = ("time_s", "current_a", "torque_command_n_m", "angle_rad", "yaw_rate_rad_s", "truth")
    short = replace(drive, **{name: getattr(drive, name)[:rows] for name in names})
    found = quiet([drive], short)
    # Two rows have no command, and each current has six.
    assert np.array_equal(found.drives[1].current_a[:7], short.current_a[:7])
    assert (not np.array_equal(found.drives[1].current_a[7:], short.current_a[7:])) is is_used
    assert len(found.sentences) == (0 if is_used else 1)


@pytest.mark.parametrize(("left_a", "is_explained"), [(1.5e-3, True), (8e-3, False)])
def test_what_is_left_is_white_or_below_what_the_wire_resolves(left_a: float, is_explained: bool) -> None:
    drive, true = drive_of_torques(4)
    hum = left_a * np.sqrt(2.0) * np.sin(0.05 * np.arange(len(true)))[:, None]
    found = quiet([replace(drive, current_a=true + hum)], drive)
    assert (found.sentences == ()) is is_explained
    if is_explained:
        assert found.drives[0].current_a[10:] == pytest.approx(true[10:], abs=0.5 * left_a)


def test_offsets_of_drives_are_their_own_and_the_judge_is_not_asked() -> None:
    (first, true), (judge, true_judge) = drive_of_torques(1), drive_of_torques(3)
    found = quiet([first], replace(judge, current_a=judge.current_a + 0.2))
    assert (found.drives[0].current_a - true)[10:].mean() == pytest.approx(0.0, abs=4.0 * NOISE_A / np.sqrt(24_000))
    assert (found.drives[1].current_a - true_judge)[10:].mean() == pytest.approx(0.2, abs=0.002)
    wild = replace(judge, current_a=np.random.default_rng(1).normal(size=judge.current_a.shape).cumsum(axis=0))
    other = quiet([first], wild)
    assert np.array_equal(other.drives[0].current_a, found.drives[0].current_a)
    assert np.array_equal(other.drives[1].current_a, wild.current_a)

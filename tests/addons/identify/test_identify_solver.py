"""The solver of hil identify against plain linear algebra, and its report on directions that data leave open."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import plant_fmu
from hil.addons.identify.drive_checks import outlook
from hil.addons.identify.gauss_newton import Knowledge, _covariance, information_of, inverted, solve
from hil.addons.identify.robust_statistics import HUBER
from hil.addons.identify.windows import Parameter
from hil.core.errors import BadInputError
from hil.plant.description import start_defaults
from hil.scenario import load
from tests.support.hidden_robots import hidden_robot, write_scenario
from tools.identify_robots import NAMES, mujoco_text, shortfalls, table

WINDOWS, MEASURED, PARAMETERS = 60, 12, 3
SIGMA = 0.05
WIDE = (np.full(PARAMETERS, -50.0), np.full(PARAMETERS, 50.0))


class Linear:
    """Windows that are linear in the parameters and in a start of their own."""

    def __init__(self, seed: int, *, blind: bool = False) -> None:
        random = np.random.default_rng(seed)
        self.by_parameters = random.normal(size=(WINDOWS, MEASURED, PARAMETERS))
        if blind:  # the second parameter acts just as the first
            self.by_parameters[..., 1] = self.by_parameters[..., 0]
        self.by_start = random.normal(size=(WINDOWS, MEASURED, 2))
        self.true = np.array([0.4, -0.8, 1.5])
        self.own = random.normal(size=(WINDOWS, 2))
        noise = random.normal(0.0, SIGMA, (WINDOWS, MEASURED))
        self.measured = self.by_parameters @ self.true + np.einsum("wms,ws->wm", self.by_start, self.own) + noise
        self.starts, self.start_steps = np.zeros((WINDOWS, 2)), np.array([1e-3, 1e-3])
        self.least_sigmas = np.full(MEASURED, SIGMA)

    def predict(self, parameters: np.ndarray, starts: np.ndarray) -> np.ndarray:
        by_start = np.einsum("wms,kws->kwm", self.by_start, starts)
        return np.einsum("wmp,kp->kwm", self.by_parameters, parameters) + by_start

    def sigmas(self, residual: np.ndarray) -> np.ndarray:
        return np.full(MEASURED, SIGMA)

    def joint(self) -> np.ndarray:
        """Return the parameters by one regression over all windows and starts at once."""
        design = np.zeros((WINDOWS * MEASURED, PARAMETERS + 2 * WINDOWS))
        design[:, :PARAMETERS] = self.by_parameters.reshape(-1, PARAMETERS)
        for window in range(WINDOWS):
            rows = slice(window * MEASURED, (window + 1) * MEASURED)
            design[rows, PARAMETERS + 2 * window : PARAMETERS + 2 * window + 2] = self.by_start[window]
        return np.linalg.lstsq(design, self.measured.ravel(), rcond=None)[0][:PARAMETERS]


def test_projecting_the_starts_away_equals_one_joint_regression() -> None:
    one = Linear(1)
    found = solve(one, np.zeros(PARAMETERS), bounds=WIDE)
    # Huber's loss differs from squares by what lies beyond 1.5 standard deviations.
    assert found.parameters == pytest.approx(one.joint(), abs=5e-3)
    assert found.starts == pytest.approx(one.own, abs=6 * SIGMA)


def test_parameters_and_starts_end_at_one_optimum_of_huber_s_loss_from_any_start() -> None:
    """Outliers everywhere: a step that weighs them for the parameters and not for the starts would end on the way."""
    one = Linear(8)
    one.measured += SIGMA * np.random.default_rng(8).standard_t(1.5, one.measured.shape)
    found, other = (solve(one, np.full(PARAMETERS, start), bounds=WIDE) for start in (0.0, 5.0))
    assert other.parameters == pytest.approx(found.parameters, abs=1e-3)
    residual = one.measured - one.predict(found.parameters[None], found.starts[None])[0]
    pulls = np.clip(residual / SIGMA, -HUBER, HUBER)
    by_parameters = np.einsum("wm,wmp->p", pulls, one.by_parameters)
    assert np.abs(by_parameters).max() < 0.05 * np.sqrt(
        np.einsum("wmp,wmp->p", one.by_parameters, one.by_parameters).min()
    )


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    held = []
    for seed in range(80):
        one = Linear(seed)
        found = solve(one, one.true, bounds=WIDE)
        held.append(np.abs(found.parameters - one.true) < 1.96 * np.sqrt(np.diag(found.covariance)))
    assert 0.92 < np.mean(held) < 0.98


class Bent(Linear):
    """Windows that answer to the arc tangent of their start: a whole step from far away goes further away."""

    def predict(self, parameters: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return super().predict(parameters, np.arctan(starts))


def test_a_window_whose_step_goes_astray_takes_a_shorter_one() -> None:
    one = Bent(9)
    one.measured += np.einsum("wms,ws->wm", one.by_start, np.arctan(one.own) - one.own)
    one.starts = one.own.copy()
    one.starts[:20] = 2.5 * np.sign(one.own[:20])
    near = solve(one, one.true, bounds=WIDE)
    assert near.starts[:20] == pytest.approx(one.own[:20], abs=20 * SIGMA)
    assert near.parameters == pytest.approx(one.true, abs=0.02)


def test_windows_that_went_wrong_do_no_harm() -> None:
    one = Linear(2)
    clean = solve(one, np.zeros(PARAMETERS), bounds=WIDE).parameters
    one.measured[:3] += 100.0
    assert solve(one, np.zeros(PARAMETERS), bounds=WIDE).parameters == pytest.approx(clean, abs=0.03)


class Jumping(Linear):
    """A first window that jumps wherever the first parameter goes, by a standard deviation."""

    def predict(self, parameters: np.ndarray, starts: np.ndarray) -> np.ndarray:
        seen = super().predict(parameters, starts)
        seen[:, 0] += SIGMA * np.sin(13.0 * np.floor(parameters[:, :1] / 5e-4))
        return seen


def test_a_window_that_jumps_does_not_hold_the_others_back() -> None:
    """Its derivative is huge by chance: each step was too short, and the fit ended on the way."""
    for seed in range(8):
        found, clean = (solve(one, one.true + 0.05, bounds=WIDE) for one in (Jumping(seed), Linear(seed)))
        off = (found.parameters - clean.parameters) / np.sqrt(np.diag(clean.covariance))
        assert np.abs(off).max() < 0.5, seed


def test_another_measurement_settles_what_the_windows_leave_open() -> None:
    one = Linear(3, blind=True)
    open_ = solve(one, np.zeros(PARAMETERS), bounds=WIDE)
    assert open_.covariance[0, 0] > 1e6, "the sum is known, the parts are not"
    known = Knowledge.none(PARAMETERS)
    known.information[1, 1], known.mean[1] = 0.01**-2, one.true[1]
    settled = solve(one, np.zeros(PARAMETERS), bounds=WIDE, known=known)
    assert settled.parameters == pytest.approx(one.true, abs=0.05)
    assert np.sqrt(settled.covariance[0, 0]) == pytest.approx(0.01, rel=0.5)


def test_a_parameter_that_is_held_gives_the_others_its_doubt() -> None:
    one = Linear(4, blind=True)
    known = Knowledge.none(PARAMETERS)
    known.held[1], known.held_covariance[1, 1] = True, 0.3**2
    first = np.array([0.0, one.true[1], 0.0])
    found = solve(one, first, bounds=WIDE, known=known)
    assert found.parameters[1] == one.true[1]
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.3, rel=0.05)
    assert found.covariance[0, 1] == pytest.approx(-(0.3**2), rel=0.05)


@pytest.mark.parametrize("held", [(), (0,), (1, 2)])
def test_a_covariance_is_the_sandwich_of_what_is_fitted_and_the_doubt_of_what_is_held(held: tuple[int, ...]) -> None:
    """By plain inverses."""
    random = np.random.default_rng(7)
    root, other, before, doubt = (random.normal(size=(PARAMETERS, PARAMETERS)) for _ in range(4))
    information, scatter = root @ root.T + np.eye(PARAMETERS), other @ other.T
    known = Knowledge(before @ before.T, np.zeros(PARAMETERS), np.isin(np.arange(PARAMETERS), held), doubt @ doubt.T)
    free = [place for place in range(PARAMETERS) if place not in held]
    whole, inner = information + known.information, np.ix_(free, free)
    inverse = np.linalg.inv(whole[inner])
    expected = np.zeros((PARAMETERS, PARAMETERS))
    expected[inner] = inverse @ (scatter + known.information)[inner] @ inverse
    carried = np.eye(PARAMETERS)
    carried[np.ix_(free, free)] = 0.0
    carried[np.ix_(free, list(held))] = -inverse @ whole[np.ix_(free, list(held))]
    held_doubt = np.where(np.outer(known.held, known.held), known.held_covariance, 0.0)
    found = _covariance(information, scatter, known._replace(held_covariance=held_doubt))
    assert found == pytest.approx(expected + carried @ held_doubt @ carried.T, rel=1e-9)


def test_what_cannot_be_told_is_said_with_the_measurement_that_settles_it() -> None:
    names = ("mass_kg", "wheel_inertia_kg_m2", "com_x_m")
    parameters = [Parameter(name, {name: 1.0}) for name in names]
    point, nothing = np.zeros(PARAMETERS), Knowledge.none(PARAMETERS)
    seen = outlook(Linear(5), parameters, point, nothing)
    assert seen == ()
    with pytest.raises(BadInputError, match=r"cannot tell mass_kg: .*told apart.*spin the wheels on blocks"):
        outlook(Linear(5, blind=True), parameters, point, nothing)
    nothing.information[1, 1] = 0.2**-2
    (left,) = outlook(Linear(5, blind=True), parameters, point, nothing)
    assert set(left.names) == {"mass_kg", "wheel_inertia_kg_m2"}
    assert "--blocks" in left.sentence


def test_an_inverse_of_what_is_not_there_is_huge_and_finite() -> None:
    information = information_of(Linear(6, blind=True), np.zeros(PARAMETERS))
    inverse = inverted(information)
    assert np.isfinite(inverse).all()
    assert inverse[0, 0] > 1e6
    assert inverse[2, 2] < 1e-3


def test_the_tool_s_table_has_errors_intervals_and_predictions_by_plant() -> None:
    def row(seed: int, plant: str, error: float) -> dict[str, Any]:
        errors = {"inertia_kg_m2": error, "com_x_m": error / 10}
        held = {"inertia_kg_m2": abs(error) < 0.02, "com_x_m": True}
        more = {"before_m": 0.1, "rigid_m": 0.002, "slip_m": 0.001, "fit_s": 7.0}
        return {"seed": seed, "plant": plant, "chosen": "slip", "error": errors, "held": held, **more}

    rows = [row(1, "rigid", 0.01), row(2, "rigid", -0.03), row(1, "slip", 0.01)]
    lines = list(table(rows))
    assert lines[0] == "| | rigid, 2 robots | slip, 1 robots |"
    assert "| inertia, % | 2 \\| 2.9, 50% | 1 \\| 1, 100% |" in lines
    assert "| centre of mass, x, mm | 2 \\| 2.9, 100% | 1 \\| 1, 100% |" in lines
    assert "| grip, % |  |  |" in lines
    assert "| held-out drive, before the fit, mm | 1e+02 \\| 1e+02 | 1e+02 \\| 1e+02 |" in lines


def robots(count: int, held: int, error: float = 1e-4, off_m: float = 0.001) -> list[dict[str, Any]]:
    """Return rows of ``count`` robots without slip; for ``held`` of them the intervals hold the true values."""
    return [
        {
            "seed": place, "plant": "rigid", "rigid_m": off_m, "slip_m": 0.02,
            "error": dict.fromkeys(NAMES, error), "held": dict.fromkeys(NAMES, place < held),
        }
        for place in range(count)
    ]  # fmt: skip


def test_the_tool_says_which_figure_falls_short() -> None:
    assert list(shortfalls(robots(300, 285))) == []
    assert list(shortfalls(robots(40, 35))) == [], "88 % of so few is no news"
    narrow = list(shortfalls(robots(300, 255)))
    assert len(narrow) == len(NAMES)
    assert "rigid, inertia: 85% of 300 intervals hold the true value; expected 90% to 98%" in narrow
    assert len(list(shortfalls(robots(300, 300)))) == len(NAMES), "intervals that always hold are too wide"
    wrong = list(shortfalls(robots(300, 285, error=0.0045)))
    assert wrong == [
        "rigid, centre of mass, x: the 95th percentile is 4.5 mm; expected at most 1 mm",
        "rigid, centre of mass, y: the 95th percentile is 4.5 mm; expected at most 1 mm",
        "rigid, wheel radius: the 95th percentile is 0.45 %; expected at most 0.4 %",
        "rigid, lever: the 95th percentile is 0.45 %; expected at most 0.4 %",
    ]
    assert list(shortfalls(robots(300, 285, off_m=0.002))) == [
        "rigid: the held-out drive is predicted to 2 mm; expected at most 1.5 mm"
    ]


def test_hidden_robots_are_never_default_and_mujoco_s_scenario_loads(tmp_path: Path) -> None:
    defaults = start_defaults(plant_fmu.path(2))
    robot = hidden_robot(1)
    assert all(abs(value / (float(defaults[name]) or 1.0) - 1.0) > 1e-3 for name, value in robot.true.items())
    path = write_scenario(tmp_path, robot, {}, 1)
    path.write_text(mujoco_text(path.read_text("utf-8")), encoding="utf-8")
    scenario = load(path)
    assert scenario.plant.fmu == "mecanum_mujoco"
    assert scenario.plant.start["mass_kg"] == pytest.approx(robot.true["mass_kg"])

"""What a comparison shows: its notes, tables and pictures, on made-up runs; the settings of its conditions."""

import math
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
import pytest
from typer.testing import CliRunner

from hil.addons.batch.columns import shown_columns
from hil.addons.batch.comparison import comparison, comparison_page
from hil.addons.batch.comparison.comparison import (
    Compared,
    Comparison,
    Condition,
    Entry,
    Request,
    Row,
    Variation,
    compare,
    conditions,
    variations,
)
from hil.addons.batch.comparison.comparison_page import results
from hil.addons.batch.comparison.random_cases import RandomCase, cases
from hil.addons.batch.comparison.robust import Tried, verdict_of
from hil.addons.batch.comparison.robust import results as results_of_cases
from hil.addons.batch.job import ENDED, FAILED, LOST, PASSED, REFUSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.cli.main import app
from hil.cli.output import RunsProgress, next_command
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.references import make_reference
from hil.scenario import load
from hil.scenario.tables import LimiterTable

SHOWN = {  # figure: head, unit, scale, decimals; made-up value
    "t10_s": ("t10 s", 1.0, 3, 1.2346),
    "tracked_s": ("tracked s", 1.0, 3, 2.5),
    "steady_rms_m": ("rms mm", 1e3, 3, 0.0012346),
    "steady_max_m": ("max mm", 1e3, 3, 0.004),
    "overshoot_m": ("overshoot mm", 1e3, 1, 0.01234),
    "effort_n_m_s": ("effort N·m·s", 1.0, 1, 33.36),
    "torque_variation_n_m_per_s": ("variation N·m/s", 1.0, 2, 7.006),
    "saturation_s": ("saturated s", 1.0, 2, 0.5),
}
FIGURES = {name: value for name, (*_, value) in SHOWN.items()}
GAINS: dict[CommandMode, dict[str, object]] = {CommandMode.SPEED: {"k1_1_s": 8.0}, CommandMode.TORQUE: {"k1_1_s": 15.0}}
FIRST, SECOND = (Condition(torque_n_m, "motors", None, None) for torque_n_m in (5.0, 1.8))


def entry(label: str) -> Entry:
    return Entry(label, label, GAINS, {CommandMode.SPEED: {"filter_s": 0.5}, CommandMode.TORQUE: {}})


def done(times: float = 1.0, *, mass: float = 1.0, friction: float | None = None, without: str = "") -> Compared:
    figures = {name: None if name in without.split() else times * value for name, value in FIGURES.items()}
    reasons = dict.fromkeys(without.split(), "it never came")
    return Compared(Variation(mass, friction), Outcome("", PASSED, None, figures, {"reasons": reasons}))


def not_done(status: str, reason: str, *, mass: float = 1.0) -> Compared:
    return Compared(Variation(mass), Outcome("", status, reason, {"ticks": 3}))


def curves(start: float) -> dict[str, np.ndarray]:
    names = ("loop.t_s", "error.planar_m", "truth.x_m", "truth.y_m", "reference.x_m", "reference.y_m")
    return {name: start + number + np.arange(1.0, 4.0) for number, name in enumerate(names)}


def compared() -> Comparison:
    """Three laws at two limits: the second lacks figures in runs, the third fails in one."""
    good = [done(), done(2.0, mass=0.8), done(0.5, friction=0.08), done(3.0, mass=1.2, friction=0.08)]
    lacking = [done(), done(2.0, mass=0.8, without="t10_s tracked_s"), done(4.0, friction=0.03, without="t10_s")]
    failed = [done(), not_done(LOST, "hung", mass=0.8), not_done(LOST, "hung", mass=1.2), not_done(FAILED, "beyond")]
    rows = [
        Row(entry("good"), FIRST, good, curves(0.0)),
        Row(entry("lacking"), FIRST, [*lacking, done(1.5, mass=1.2)], None),
        Row(entry("failed"), FIRST, failed, curves(50.0)),
        Row(entry("good"), SECOND, [not_done(REFUSED, "no torque")] * 4, None),
        Row(entry("lacking"), SECOND, good, curves(90.0)),
    ]
    return Comparison("circle", 7, rows, "the limiter")


def test_a_table_has_the_nominal_run_and_the_worst_of_each_law_in_the_units_shown() -> None:
    page = results(compared())
    assert (page.title, page.verdict) == ("Laws compared under circle, seed 7", "3 of 20 runs failed")
    assert not page.passed
    assert page.about == [
        "the limiter",
        "nominal / worst over mass (times 0.8 and 1.2) and friction (0.03 and 0.08) of the plant; less is better in "
        "every column",
    ]
    first, second = page.tables
    assert (first.title, second.title) == ("5 N·m, motors, speed commands", "1.8 N·m, motors, speed commands")
    assert list(first.rows[0]) == ["law", *(head for head, *_ in SHOWN.values())]
    assert list(first.numbers) == list(range(1, 9))
    both = [
        f"{value * scale:.{digits}f} / {3 * value * scale:.{digits}f}" for _, scale, digits, value in SHOWN.values()
    ]
    assert first.rows[1] == ("good (filter_s = 0.5)", *both)
    assert first.rows[2][1:4] == ("1.235 / -", "2.500 / -", "1.235 / 4.938")
    assert first.rows[3][1:3] == ("1.235 / -", "2.500 / -")
    assert second.rows[1] == ("good (filter_s = 0.5)", *["- / -"] * 8)
    assert first.about.startswith("t10: ")
    assert first.about.count("; ") >= 7
    assert second.about == "", "what figures mean is said once"
    assert first.notes == [
        "lacking: no t10, tracked in 2 of 4 runs, first with mass x 0.8: it never came",
        "failed: failed (mass x 0.8): hung",
        "failed: failed (nominal): beyond",
    ]
    assert second.notes == ["good: refused: no torque"]


def test_with_nominal_runs_alone_a_cell_has_one_figure() -> None:
    page = results(Comparison("circle", 1, [Row(entry("one"), FIRST, [done(without="t10_s")])], "the limiter"))
    assert (page.verdict, page.passed, page.about) == ("1 runs, none of which failed", True, ["the limiter"])
    assert page.tables[0].rows[1][1:4] == ("-", "2.500", "1.235")
    assert page.tables[0].notes == ["one: no t10: it never came"]


def test_the_json_has_the_worst_over_mass_apart_and_every_run() -> None:
    good, lacking, failed, refused, _ = compared().plain()["rows"]
    assert good["nominal"] == pytest.approx(FIGURES)
    assert good["worst_over_mass"] == pytest.approx({name: 2.0 * value for name, value in FIGURES.items()})
    assert good["worst"] == pytest.approx({name: 3.0 * value for name, value in FIGURES.items()})
    assert (good["law"], good["title"], good["gains"]) == ("good", "good (filter_s = 0.5)", {"k1_1_s": 8.0})
    assert good["condition"] == {"torque_n_m": 5.0, "drive": "motors", "estimator": None, "contact": None}
    assert [run["mass_factor"] for run in good["runs"]] == [1.0, 0.8, 1.0, 1.2]
    assert [run["friction"] for run in good["runs"]] == [None, None, 0.08, 0.08]
    assert lacking["runs"][1]["reasons"] == dict.fromkeys(("t10_s", "tracked_s"), "it never came")
    assert [run["failed"] for run in failed["runs"]] == [None, "hung", "hung", "beyond"]
    assert [run["figures"] is None for run in failed["runs"]] == [False, True, True, True]
    assert (refused["refused"], failed["refused"]) == ("no torque", None)
    assert set(refused["nominal"].values()) == {None}


def test_pictures_have_path_and_error_of_laws_in_colours_of_their_own() -> None:
    first, second = results(compared()).plots
    assert (first.name, second.name) == ("error-5nm-motors", "error-1.8nm-motors")

    def drawn(plot: Any) -> tuple[Any, Any]:
        axes = list(matplotlib.figure.Figure().subplots(plot.rows, plot.columns).flat)
        plot.draw(axes)
        return axes[0], axes[1]

    path, error = drawn(first)
    for panel, x, y, scale in ((path, "truth.x_m", "truth.y_m", 1.0), (error, "loop.t_s", "error.planar_m", 1e3)):
        lines = {line.get_label(): line for line in panel.get_lines()}
        for label, start in (("good", 0.0), ("failed", 50.0)):
            assert list(lines[label].get_xdata()) == list(curves(start)[x])
            assert list(lines[label].get_ydata()) == list(scale * curves(start)[y])
    reference = next(line for line in path.get_lines() if line.get_label() == "reference")
    assert list(reference.get_xdata()) == list(curves(0.0)["reference.x_m"])
    assert list(reference.get_ydata()) == list(curves(0.0)["reference.y_m"])
    of = {line.get_label(): line.get_color() for line in error.get_lines()}
    (other,) = [line.get_color() for line in drawn(second)[1].get_lines() if line.get_label() == "lacking"]
    assert len({of["good"], of["failed"], other}) == 3


def test_curves_are_thinned_to_the_points_of_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "_MOST_POINTS", 4)
    file = tmp_path / "signals.npz"
    job = Job("", "", {}, {}, signals_file=str(file))
    assert comparison._curves(job) is None, "the run did not get as far"
    for points, kept in ((4, [0, 1, 2, 3]), (5, [0, 2, 4]), (8, [0, 2, 4, 6]), (9, [0, 3, 6]), (0, [])):
        np.savez(file, a=np.arange(points))
        found = comparison._curves(job)
        assert found is not None
        assert list(found["a"]) == kept


def test_conditions_and_robots_set_what_they_say() -> None:
    sets = ["limiter.slip_m_s=0.5"]
    request = Request(["dsc"], "circle_speed", sets, None, [5.0, 1.8], ["ideal", "motors"], ["truth-wheels"], ["rigid"])
    ideal, motors, *_ = conditions(request)
    shared = {"estimator.source": "truth", "estimator.twist": "wheels", "plant.start.contact": "rigid"}
    limits = {"robot.torque_limit_n_m": 5.0, "firmware.torque_limit_n_m": 5.0}
    current = {"plant.start.drive": "current", "plant.start.current_limit_a": 4.0, "firmware.current_limit_a": 4.0}
    assert ideal.sets() == {**shared, **limits, "controller.command": "torque", "plant.start.drive": "torque"}
    assert motors.sets() == {**shared, **limits, "controller.command": "speed", **current}
    assert motors.slug == "5nm-motors-truth-wheels-rigid"
    assert [one.words for one in variations(quick=False)] == [
        *("nominal", "friction 0.03", "friction 0.08"),
        *("mass x 0.8", "mass x 0.8, friction 0.03", "mass x 0.8, friction 0.08"),
        *("mass x 1.2", "mass x 1.2, friction 0.03", "mass x 1.2, friction 0.08"),
    ]
    assert variations(quick=True) == [Variation()]
    assert Variation(1.2, 0.03).sets(25.0) == {"plant.start.mass_kg": 30.0, "plant.start.friction_coefficient": 0.03}
    assert Variation().sets(25.0) == {}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (LimiterTable(), "torques fade before the robot's overspeed, and wheels slip at most 0.3 m/s."),
        (LimiterTable("limit", 0.5), "torques fade before robot.speed_limit_rad_s, and wheels slip at most 0.5 m/s."),
        (
            LimiterTable("off", math.inf),
            "no wheel speed is kept (limiter.torque_speed is off), and slip is not limited.",
        ),
    ],
)
def test_the_limiter_is_told_with_its_values(table: LimiterTable, words: str) -> None:
    assert comparison._limiter_words(table) == f"The limiter between law and wheels: {words}"


@pytest.mark.parametrize("sources", [[], ["truth"], ["odometry"], ["truth", "odometry"]])
def test_it_is_told_that_slip_is_not_limited_with_odometry(sources: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "run_jobs", lambda jobs, *_: [Outcome(job.key, FAILED, "not run") for job in jobs])
    request = Request(["dsc"], "circle_speed", [], None, [5.0], ["ideal"], quick=True, estimators=sources)
    more = " With odometry, which takes the wheels' word, slip is not limited." if "odometry" in sources else ""
    assert compare(request).limiter.endswith(f", and wheels slip at most 0.3 m/s.{more}")


def test_the_command_compares_what_is_asked_and_else_both_torques_and_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[Request, dict[str, Any]]] = []

    def asked(request: Request, **options: Any) -> None:
        told.append((request, options))
        raise BadInputError("enough")

    monkeypatch.setattr(comparison_page, "compare", asked)
    runner = CliRunner()
    for words in (
        "",
        "--torque 3 --drive ideal --estimator odometry --contact slip --quick --jobs 2 --limit 9 --seed 4",
    ):
        assert str(runner.invoke(app, ["compare", "dsc", "pid", "circle_speed", *words.split()]).exception) == "enough"
    (own, _), (few, options) = told
    assert (own.torques_n_m, own.drives, own.estimators, own.contacts) == ((5.0, 1.8), ["ideal", "motors"], [], [])
    assert (own.laws, own.scenario, own.seed, own.quick, own.curves) == (
        ["dsc", "pid"],
        "circle_speed",
        None,
        False,
        False,
    )
    assert (few.torques_n_m, few.drives, few.estimators, few.contacts) == ([3.0], ["ideal"], ["odometry"], ["slip"])
    assert (few.seed, few.quick) == (4, True)
    assert isinstance(options.pop("on_progress"), RunsProgress)
    assert options == {"workers": 2, "limit_s": 9.0}


def test_runs_of_a_comparison_have_the_workers_and_the_limit_that_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Any] = []

    def run_jobs(jobs: list[Job], workers: int, on_progress: Any) -> list[Outcome]:
        told.extend([{job.limit_s for job in jobs}, workers, on_progress])
        return [Outcome(job.key, FAILED, "not run") for job in jobs]

    def progress(*_: object) -> None: ...

    monkeypatch.setattr(comparison, "run_jobs", run_jobs)
    request = Request(["dsc"], "circle_speed", [], None, [5.0], ["ideal"], quick=True)
    compare(request, workers=3, limit_s=7.0, on_progress=progress)
    assert told == [{7.0}, 3, progress]


def test_a_law_among_sets_or_in_the_place_of_the_scenario_is_refused() -> None:
    for sets, words in ((["loop.mode=realtime"], "sets loop.mode itself; it runs in lockstep over memory"),
                        (["link.url=serial:pty"], "sets link.url itself"),
                        (["controller.law=dsc"], "laws and gains are named together, as in: hil compare dsc,k1_1_s=8"),
                        ):  # fmt: skip
        with pytest.raises(BadInputError, match=words):
            compare(Request(["dsc"], "circle_speed", sets, None, [5.0], ["ideal"]))
    with pytest.raises(BadInputError, match=r"scenario laws\.py:Law: this is a law; the last argument is the scenario"):
        compare(Request(["dsc"], "laws.py:Law", [], None, [5.0], ["ideal"]))


# Random cases


def tried(law: str, number: int, status: str, error_m: float | None = None, *, can_follow: bool = True) -> Tried:
    figures: dict[str, Any] = {}
    if error_m is not None:
        figures = {"error_m": error_m, "told_m": 0.0, "variation": 1.0, "needed": 1.0}
        figures["verdict"] = verdict_of(figures)
    row = {"outcome": status, "reason": None if status == PASSED else f"{status} so", **figures}
    if number == 3:
        row["reason"] = "diverged; lost"
    case = RandomCase(number, {}, can_follow, {"mass_factor": 1.5})
    return Tried(entry(law), case, make_job(load("compare_circle")), ("hil", law), row)


def test_a_table_of_random_cases_counts_verdicts_and_has_median_and_worst() -> None:
    page = results_of_cases(
        load("compare_circle", seed=9),
        [
            tried("one", 0, PASSED, 0.001),
            tried("one", 1, PASSED, 0.0025),
            tried("one", 2, PASSED, 0.009),
            tried("one", 3, PASSED, 0.2),
            tried("one", 4, ENDED),
            tried("one", 5, PASSED, math.nan, can_follow=False),
            tried("two", 0, LOST),
            tried("two", 1, REFUSED),
            tried("two", 2, PASSED)._replace(row=None),
        ],
        Path("out"),
    )
    assert page.title == "Laws in random cases of compare_circle, seed 9"
    assert page.verdict == "1 of 8 runs failed (1 of 9 are not done yet)"
    assert not page.passed
    (table,) = page.tables
    assert table.rows == [
        ("law", "the wheels", "cases", "held", "over bound", "limit cycle", "diverged", "stopped", "failed", "refused",
         "rms mm, median", "worst"),
        ("one", "can follow", "5", "2", "1", "0", "1", "1", "0", "0", "5.750", "200"),
        ("one", "cannot", "1", "0", "0", "0", "1", "0", "0", "0", "-", "-"),
        ("two", "can follow", "2", "0", "0", "0", "0", "0", "1", "1", "-", "-"),
    ]  # fmt: skip
    assert list(table.numbers) == list(range(2, 11))
    assert page.about[-2:] == ["each run is a line of out/cases.csv", next_command("hil", "campaign", "report", "out")]
    assert page.about[:-2:2] == [
        "one, case 2, over bound",
        "one, case 3, diverged; lost",
        "one, case 4, stopped: ended so",
        "one, case 5 (which wheels cannot follow), diverged",
        "two, case 0, failed: lost so",
        "two, case 1, refused: refused so",
    ]
    plain = page.plain["trials"][4]
    assert plain == {
        "law": "one",
        "case": 4,
        "can_follow": True,
        "verdict": "stopped",
        "reason": "ended so",
        "error_m": None,
        "told_m": None,
        "variation": None,
        "needed": None,
        "mass_factor": 1.5,
        "repeat": "hil one",
    }


BRIEF = {"loop.duration_s": 0.05, "expect": []}
"""What a case can follow is looked at for so long."""
GIVEN = ("controller", "robot", "firmware", "plant", "loop", "link", "device", "reference", "fault", "estimator")
OMEGA = 2.0 * math.pi / 3.0


@pytest.mark.parametrize(
    ("change", "is_grip"), [({}, False), ({"plant.start.contact": "slip", "plant.start.grip_coefficient": 0.5}, True)]
)
def test_a_case_can_be_followed_with_four_fifths_of_torque_or_grip(change: dict[str, Any], is_grip: bool) -> None:
    """A circle of 1 m in 3 s, whose torque is as in the formula of the acceleration; the wheels turn with it."""

    def follows(mass_kg: float, torque_n_m: float, **more: float) -> bool:
        own = {"reference": {"kind": "circle", "radius_m": 1.0, "period_s": 3.0}, "loop.duration_s": 1.0, **change}
        own |= {f"plant.start.{name}": value for name, value in more.items()}
        own |= {"plant.start.mass_kg": mass_kg, "robot.torque_limit_n_m": torque_n_m, "robot.speed_limit_rad_s": 60.0}
        own |= {"firmware.torque_limit_n_m": torque_n_m, "plant.start.friction_coefficient": 0.0}
        (case,) = cases(load("compare_circle", set=own), 1, 1, GIVEN)
        assert case.sets == {}
        return case.can_follow

    robot = load("compare_circle").robot
    radius_m, wheels_kg = robot.wheel_radius_m, robot.wheels_mass_kg
    if is_grip:  # more mass, more load on the wheels: what counts is the wheels' own inertia
        needed = [math.sqrt(2.0) / 4.0 * radius_m * (mass + wheels_kg) * OMEGA**2 for mass in (20.0, 25.0)]
        holds = [0.8 * 0.5 * mass * 9.81 * radius_m / (4.0 * math.sqrt(2.0)) for mass in (20.0, 25.0)]
        assert [follows(mass, 15.0) for mass in (20.0, 25.0)] == [n <= h for n, h in zip(needed, holds, strict=True)]
        for mass, n, h in zip((20.0, 25.0), needed, holds, strict=True):
            grip = 0.5 * n / h
            assert not follows(mass, 15.0, grip_coefficient=0.98 * grip)
            assert follows(mass, 15.0, grip_coefficient=1.02 * grip)
        return
    needed_n_m = math.sqrt(2.0) / 4.0 * radius_m * (25.0 + wheels_kg) * OMEGA**2
    assert not follows(25.0, 0.98 * needed_n_m / 0.8)
    assert follows(25.0, 1.02 * needed_n_m / 0.8)
    assert follows(24.0, 0.98 * needed_n_m / 0.8), "it is the true mass that counts"


def test_cases_are_drawn_all_over_their_ranges() -> None:
    base = load("compare_circle", set=BRIEF)
    drawn = cases(base, 150, 2, ())
    robot = base.robot

    def every(key: str) -> list[Any]:
        return [case.sets[key] for case in drawn if key in case.sets]

    def is_all_over(values: list[float], low: float, high: float, digits: int) -> None:
        assert any(round(value, digits - 1) != value for value in values)
        assert low <= min(values) < low + 0.11 * (high - low)
        assert high - 0.11 * (high - low) < max(values) <= high
        assert all(round(value, digits) == value for value in values)

    is_all_over(every("robot.torque_limit_n_m"), 1.5, 5.0, 2)
    assert every("firmware.torque_limit_n_m") == every("robot.torque_limit_n_m")
    is_all_over(every("link.command_latency_s"), 0.0, 0.01, 3)
    is_all_over(every("link.feedback_latency_s"), 0.0, 0.01, 3)
    assert every("link.command_latency_s") != every("link.feedback_latency_s")
    is_all_over(every("plant.start.grip_coefficient"), 0.3, 1.0, 2)
    is_all_over([rows[0]["value"] for rows in every("fault")], 0.001, 0.02, 3)
    frictions = [math.log(one / robot.friction_coefficient) for one in every("plant.start.friction_coefficient")]
    assert min(frictions) == pytest.approx(math.log(0.2), abs=0.2)
    assert max(frictions) == pytest.approx(math.log(4.0), abs=0.2)
    assert abs(np.mean(frictions) - math.log(0.2 * 4.0) / 2.0) < 0.25, "a half is as likely as twice"
    for case in drawn:
        sets = case.sets
        mass = sets["plant.start.mass_kg"] / robot.mass_kg
        assert sets["plant.start.inertia_kg_m2"] == pytest.approx(mass * robot.inertia_kg_m2, abs=1e-4)
        if sets["plant.start.drive"] != "torque":
            amperes = sets["robot.torque_limit_n_m"] / base.firmware.torque_constant_n_m_a
            assert sets["plant.start.current_limit_a"] == sets["firmware.current_limit_a"] == round(amperes, 3)
    assert set(every("loop.rate_hz")) == {100, 200, 250, 500, 1000}
    assert set(every("plant.start.drive")) == {"torque", "current", "voltage"}
    assert 0.4 * 150 < len(every("device.driver")) < 0.6 * 150
    assert set(every("device.driver")) == {"odrive", "vesc"}, "our own is that of the scenario"
    far, apart_rad = [], []
    for case in drawn:
        options = dict(case.sets["reference"])
        pose = make_reference(options.pop("kind"), options).at(0.0).pose
        start = [case.sets[f"plant.start.start_{name}"] for name in ("x_m", "y_m", "heading_rad")]
        far.append(math.hypot(start[0] - pose.x_m, start[1] - pose.y_m))
        apart_rad.append(math.remainder(start[2] - pose.heading_rad, 2.0 * math.pi))
        assert abs(start[2]) <= math.pi + 1e-4
    assert 1.4 < max(far) < 1.501
    assert (min(apart_rad), max(apart_rad)) == pytest.approx((-math.pi, math.pi), abs=0.25)


def test_references_of_cases_have_the_size_and_speed_that_were_drawn() -> None:
    """By the way around them, summed up in chords."""
    seen: dict[str, list[float]] = {}
    for case in cases(load("compare_circle", set=BRIEF), 120, 3, ()):
        options = dict(case.sets["reference"])
        kind = options.pop("kind")
        if kind == "spin":
            assert options["path"] == "circle"
            speed_m_s, size_m = options["speed_m_s"], options["radius_m"]
            seen.setdefault("yaw", []).append(options["yaw_rate_rad_s"])
        else:
            source, period_s = make_reference(kind, options), options["period_s"]
            xy = np.array([source.at(t_s).pose[:2] for t_s in np.linspace(0.0, period_s, 200)])
            speed_m_s = float(np.hypot(*np.diff(xy, axis=0).T).sum()) / period_s
            size_m = options.get("radius_m") or options.get("half_length_m") or options["side_m"] / 2.0
            assert options.get("corner_m", 0.6 * size_m) == pytest.approx(0.6 * size_m, abs=1e-3)
            seen.setdefault("heading", []).append(options["heading_rad"])
        slower = 0.8 if kind == "rounded_square" else 0.99  # its corners are cut
        assert slower * 0.1 <= speed_m_s <= 0.601
        assert 0.5 <= size_m <= 1.5
        seen.setdefault(kind, []).append(speed_m_s)
        seen.setdefault("size", []).append(size_m)
    assert {kind: len(some) > 15 for kind, some in seen.items()} == dict.fromkeys(seen, True)
    assert len(seen) == 4 + 3
    for kind in ("circle", "figure_eight", "spin"):
        assert min(seen[kind]) < 0.2
        assert max(seen[kind]) > 0.5
    assert (min(seen["size"]), max(seen["size"])) == pytest.approx((0.5, 1.5), abs=0.05)
    assert (min(seen["yaw"]), max(seen["yaw"])) == pytest.approx((-0.8, 0.8), abs=0.2)
    assert (min(seen["heading"]), max(seen["heading"])) == pytest.approx((-math.pi, math.pi), abs=0.4)


def test_every_figure_of_a_table_is_tried_here() -> None:
    assert [column.name for column in shown_columns()] == list(SHOWN)

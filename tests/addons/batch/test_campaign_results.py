"""A campaign's report: every figure that it shows, on made-up rows, by another way of calculating it."""

import itertools
import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
import pandas
import pytest
from scipy import stats

from hil.addons.batch.campaign import campaign_page, judged
from hil.addons.batch.campaign.campaign import Campaign
from hil.addons.batch.campaign.campaign_file import load_plan, points
from hil.addons.batch.campaign.judged import (
    COMPARED,
    Duel,
    Interval,
    Judged,
    Rate,
    duel_words,
    paired_difference,
    percent,
)
from hil.addons.batch.columns import KEY, MACHINE
from hil.addons.batch.results_page import Page
from hil.addons.batch.store import RECORDINGS, Store
from tests.support.campaigns import write_plan

PLAN = 'laws = ["afdsc", "dsc"]\nsamples = 7\nkeep = "none"'
TABLES = """
[[fault]]
name = "calm"
[[fault]]
name = "lossy"
rows = [{ kind = "drop", target = "command", value = 0.1 }]
[axes]
estimator.source = { grid = ["truth", "odometry"] }
robot.mass_kg = { list = [16.5] }
plant.start.friction_coefficient = { log_uniform = [0.01, 0.3] }
"""
FRICTION = "plant.start.friction_coefficient"
SHOWN = {
    "steady_rms_m": ("steady rms [mm]", 1e3),
    "steady_max_m": ("steady max [mm]", 1e3),
    "t10_s": ("to 10 mm [s]", 1.0),
    "overshoot_m": ("overshoot [mm]", 1e3),
    "effort_n_m_s": ("effort [N·m·s]", 1.0),
}
"""The figures in detail, in their order, with title and scale."""
WHY = {"failed": "too far", "ended": "the law raised an error", "lost": "hung"}


def made_up(number: int, law: str, chance: random.Random) -> dict[str, Any]:
    """The figures and the outcome of a run; some have no t10, and some did not pass."""
    size = 1.0 if law == "afdsc" else 1.4
    outcome = {3: "failed", 11: "ended", 17: "failed", 23: "lost", 31: "failed", 40: "failed"}.get(number, "passed")
    reason = WHY.get(outcome) if number != 40 else "too late"
    figures: dict[str, Any] = {name: size * chance.uniform(0.5, 2.0) * 1e-3 for name in SHOWN}
    if number % 5 == 1:
        figures["t10_s"] = None
    return {"outcome": outcome, "reason": reason, **figures}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return Campaign(write_plan(tmp_path_factory.mktemp("campaign"), PLAN, TABLES))


@pytest.fixture(scope="module")
def rows(campaign: Campaign) -> list[dict[str, Any]]:
    """The runs that are done: all but the last three, one of them by another commit."""
    chance = random.Random(3)
    made = [
        {**made_up(number, run.point.law, chance), **campaign.row(run), f"{MACHINE}commit": "b" if number == 9 else "a"}
        for number, run in enumerate(campaign.runs)
    ]
    return made[:-3]


@pytest.fixture(scope="module")
def folder(campaign: Campaign, rows: list[dict[str, Any]]) -> Path:
    """Their results; one has a recording."""
    folder = campaign.plan.file.folder
    with Store(folder) as store:
        store.append(rows[::-1])
        store.begin(campaign.kept.about)
    (folder / RECORDINGS / f"{rows[3][KEY]}.rrd").touch()
    return folder


@pytest.fixture(scope="module")
def found(folder: Path) -> Judged:
    return Judged(folder)


@pytest.fixture(scope="module")
def frame(rows: list[dict[str, Any]]) -> pandas.DataFrame:
    """The same as a table, in the order of the plan; runs that ended early have no figures."""
    frame = pandas.DataFrame(rows)
    frame.loc[~frame.outcome.isin(["passed", "failed"]), list(SHOWN)] = math.nan
    return frame.astype(dict.fromkeys(SHOWN, float))


def cells(table: Any) -> list[tuple[str, ...]]:
    return [tuple(row) for row in table.rows[1:]]


def tables(found: Judged) -> Mapping[str, Any]:
    return {
        table.title: table for table in campaign_page.results(found, Page(Path("page.html"), None, "refuse")).tables
    }


def wilsons(share: float, trials: int) -> tuple[float, float]:
    """The two shares that lie just 1.96 standard deviations of their own away (Wilson 1927), as roots."""
    z2 = stats.norm.ppf(0.975) ** 2 / trials
    low, high = sorted(np.roots([1.0 + z2, -(2.0 * share + z2), share**2]).real)
    return float(low), float(high)


def test_pass_rates_are_those_of_the_runs_with_each_value(found: Judged, frame: pandas.DataFrame) -> None:
    groups = [("all", "", frame)]
    for axis in ("estimator.source", "robot.mass_kg", "law", "fault"):
        groups += [(axis, f"{value}", some) for value, some in frame.groupby(axis, sort=False)]
    expected = []
    for axis, value, some in groups:
        share = (some.outcome == "passed").mean()
        expected.append((axis, value, len(some), (some.outcome == "passed").sum(), 7, share, *wilsons(share, 7)))
    assert len(expected) == 8
    for rate, row, shown in zip(found.rates, expected, cells(tables(found)["Pass rates"]), strict=True):
        assert rate[:5] == row[:5]
        assert rate.share == pytest.approx(row[5:])
        assert shown[:5] == tuple(map(str, row[:5]))
        low, high = (f"{100.0 * end:.3g}" for end in row[6:])
        assert shown[5] == f"{100.0 * row[5]:.4g} % (95 %: {low} to {high} %)"


def test_figures_of_a_law_are_spread_over_the_runs_that_have_them(found: Judged, frame: pandas.DataFrame) -> None:
    expected, shown = [], []
    for (figure, (title, scale)), law in itertools.product(SHOWN.items(), ("afdsc", "dsc")):
        some = frame[frame.law == law][figure].dropna()
        assert 15 < len(some) < 28
        spread = (some.quantile(0.5), some.quantile(0.95), some.max())
        expected.append((figure, law, len(some), pytest.approx(spread)))
        shown.append((title, law, str(len(some)), *(f"{scale * one:.4g}" for one in spread)))
    assert [
        (one["figure"], one["law"], one["runs"], (one["median"], one["p95"], one["worst"])) for one in found.spreads()
    ] == expected
    assert cells(tables(found)["Figures of each law"]) == shown


def test_laws_are_compared_in_runs_that_differ_in_the_law_alone(found: Judged, frame: pandas.DataFrame) -> None:
    same = ["fault", "seed", "sample", "estimator.source", "robot.mass_kg", FRICTION]
    paired = frame.pivot(index=same, columns="law")
    both_done = paired["outcome"].notna().all(axis=1).sum()
    shown = cells(tables(found)["Law against law"])
    for duel, (figure, (title, scale)), row in zip(found.duels, SHOWN.items(), shown, strict=True):
        less = (paired[figure]["afdsc"] - paired[figure]["dsc"]).dropna()
        of_units = less.groupby("sample").mean()
        assert duel[:6] == ("afdsc", "dsc", figure, len(less), both_done - len(less), len(of_units))
        assert duel.left_out > 0
        assert duel.difference.value == pytest.approx(of_units.mean())
        less = less.sort_index(level="sample", sort_remaining=False)
        units = less.index.get_level_values("sample").tolist()
        assert duel.difference == pytest.approx(paired_difference(units, less.to_numpy()))
        assert duel.first_less == pytest.approx((less < 0.0).mean())
        assert 0.0 < duel.first_less < 1.0
        scaled = duel._replace(difference=Interval(*(scale * end for end in duel.difference if end is not None)))
        counts = map(str, duel[3:6])
        assert row == (title, duel_words(scaled), f"{100.0 * (less < 0.0).mean():.3g} %", *counts)


def test_the_worst_runs_are_first_those_that_did_not_pass_and_then_by_the_figure(
    found: Judged, frame: pandas.DataFrame, folder: Path
) -> None:
    keys = {True: [], False: []}
    for row in frame.sort_values("steady_rms_m", ascending=False, na_position="first", kind="stable").to_dict(
        "records"
    ):
        keys[row["outcome"] == "passed"].append(row[KEY])
    assert [row[KEY] for row in found.worst] == [*keys[False], *keys[True]][:20]
    of_key = {row[KEY]: row for row in frame.to_dict("records")}
    plan = {row[KEY]: row["repeat"] for row in found.plan}
    shown = cells(tables(found)["The worst runs"])
    for row, (figure, outcome, words, repeat, recording) in zip(found.worst, shown, strict=True):
        run = of_key[row[KEY]]
        assert figure == ("-" if math.isnan(run["steady_rms_m"]) else f"{1e3 * run['steady_rms_m']:.3f}")
        assert outcome == (run["outcome"] if run["outcome"] == "passed" else f"{run['outcome']}: {run['reason']}")
        axes = f"estimator.source = {run['estimator.source']}, robot.mass_kg = 16.5, {FRICTION} = {run[FRICTION]:g}"
        assert words == f"{run['law']}, {axes}, fault {run['fault']}, seed {run['seed']}"
        assert repeat == plan[row[KEY]]
        kept = folder / RECORDINGS / f"{row[KEY]}.rrd"
        assert recording == (str(kept) if run["reason"] == "too far" and kept.exists() else "-")
    plain = found.plain()["worst"]
    assert [row["recording"] is not None for row in plain] == [row[4] != "-" for row in shown]
    assert sum(row["recording"] is not None for row in plain) == 1


def test_a_report_says_what_is_done_why_runs_did_not_pass_and_by_which_commits(found: Judged) -> None:
    results = campaign_page.results(found, Page(Path("page.html"), "svg", "refuse"))
    assert (results.verdict, results.passed) == ("47 of 53 runs passed", False)
    rms = next(duel for duel in found.duels if duel.figure == "steady_rms_m")
    assert results.about[:3] == [
        "53 runs: 47 passed, 4 failed, 1 ended, 1 lost (3 of 56 are not done yet)",
        f"pass rate {percent(found.rates[0])}",
        f"steady_rms_m: {duel_words(rms)}",
    ]
    assert results.about[4:] == [
        "the runs were done by several commits: a, b",
        "page.html",
        "distributions.svg",
        "effects.svg",
    ]
    reasons = [("failed", 3, "too far"), ("ended", 1, WHY["ended"]), ("lost", 1, "hung"), ("failed", 1, "too late")]
    assert cells(tables(found)["Why runs did not pass"]) == [(outcome, str(n), why) for outcome, n, why in reasons]
    plain = found.plain()
    assert plain["reasons"] == [{"outcome": one, "reason": why, "runs": count} for one, count, why in reasons]
    assert (plain["runs"], plain["passed"], plain["outcomes"]["passed"]) == (53, False, 47)
    assert {name: plain["campaign"][name] for name in ("name", "seeds", "samples", "runs", "laws", "faults")} == {
        "name": "plan",
        "seeds": 1,
        "samples": 7,
        "runs": 56,
        "laws": ["afdsc", "dsc"],
        "faults": ["calm", "lossy"],
    }
    assert results.plain == {"html": "page.html", "pictures": ["distributions.svg", "effects.svg"], **plain}


def test_reasons_beyond_the_first_are_counted(found: Judged, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_page, "_REASONS", 3)
    table = tables(found)["Why runs did not pass"]
    assert (len(table.rows), table.notes) == (1 + 3, ["and 1 more reasons"])
    monkeypatch.setattr(campaign_page, "_REASONS", 4)
    assert not tables(found)["Why runs did not pass"].notes


def test_pictures_have_the_runs_of_each_law(
    found: Judged, frame: pandas.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign_page, "_SCATTERED", 9)
    monkeypatch.setattr(campaign_page, "_LETTERS", 10)
    distributions, effects = campaign_page.plots(found)
    assert (distributions.rows, distributions.columns, effects.rows, effects.columns) == (3, 2, 2, 2)

    def drawn(plot: Any) -> list[Any]:
        axes = list(matplotlib.figure.Figure().subplots(plot.rows, plot.columns).flat)
        plot.draw(axes)
        return axes

    axes = drawn(distributions)
    assert [panel.get_visible() for panel in axes] == [True] * 5 + [False]
    for panel, (figure, (title, scale)) in zip(axes, SHOWN.items(), strict=False):
        assert (panel.get_xlabel(), panel.get_ylabel()) == (title, "share of runs")
        assert [line.get_label() for line in panel.get_lines()] == ["afdsc", "dsc"]
        for line in panel.get_lines():
            values = np.sort(frame[frame.law == line.get_label()][figure].dropna())
            assert line.get_xdata() == pytest.approx(scale * values)
            assert line.get_ydata() == pytest.approx(stats.ecdf(values).cdf.evaluate(values))
            assert line.get_drawstyle() == "steps-post"
    axes = drawn(effects)
    assert [panel.get_xlabel() for panel in axes] == ["estimator.source", "robot.mass_kg", FRICTION, "fault"]
    assert [panel.get_xscale() for panel in axes] == ["linear", "linear", "log", "linear"]
    assert [label.get_text() for label in axes[0].get_xticklabels()] == ["truth", "odometry"]
    turned = [[label.get_rotation() for label in axes[place].get_xticklabels()] for place in (0, 3)]
    assert turned == [[45.0, 45.0], [0.0, 0.0]], "13 letters are too many here, calm and lossy are not"
    place = {"truth": 0, "odometry": 1, "calm": 0, "lossy": 1}
    for panel in axes:
        assert panel.get_ylabel() == "steady rms [mm]"
        for line in panel.get_lines():
            some = frame[(frame.law == line.get_label()) & frame.steady_rms_m.notna()]
            some = some[:: math.ceil(len(some) / 9)]
            assert line.get_xdata() == pytest.approx([place.get(x, x) for x in some[panel.get_xlabel()]])
            assert line.get_ydata() == pytest.approx(1e3 * some.steady_rms_m.to_numpy())


def test_without_runs_a_report_says_so_and_with_all_passed_it_passes(tmp_path: Path) -> None:
    campaign = Campaign(write_plan(tmp_path, "seeds = 2"))
    page = Page(Path("page.html"), None, "refuse")
    for done, verdict, passed in ((0, "no run is done yet", False), (1, "1 of 1 runs passed", True)):
        with Store(tmp_path) as store:
            store.append([{"outcome": "passed", "reason": None, **campaign.row(run)} for run in campaign.runs[:done]])
            store.begin(campaign.kept.about)
        results = campaign_page.results(Judged(tmp_path), page)
        assert (results.verdict, results.passed) == (verdict, passed)
        assert results.about[0] == f"{done} runs: {'1 passed' if done else 'none'} ({2 - done} of 2 are not done yet)"
        assert not results.plain["passed"], "not all of the campaign is done"
        assert [table.title for table in results.tables if len(table.rows) > 2] == []


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        (Interval(0.25, None, None), "one - two = +0.25, from 3 draws: too few for an interval"),
        (Interval(0.25, -0.5, 1.0), "one - two = +0.25 (95 %: -0.5 to +1): no difference shown"),
        (Interval(0.5, 0.0, 1.0), "one - two = +0.5 (95 %: +0 to +1): no difference shown"),
        (Interval(-0.5, -1.0, 0.0), "one - two = -0.5 (95 %: -1 to +0): no difference shown"),
        (Interval(-0.25, -0.5, -0.125), "one - two = -0.25 (95 %: -0.5 to -0.125): one is less"),
        (Interval(0.25, 0.125, 0.5), "one - two = +0.25 (95 %: +0.125 to +0.5): two is less"),
    ],
)
def test_a_difference_is_told_by_its_interval(interval: Interval, words: str) -> None:
    assert duel_words(Duel("one", "two", "steady_rms_m", 4, 1, 3, interval, 0.5)) == words


def test_a_share_of_one_draw_has_no_interval_in_words() -> None:
    assert percent(Rate("law", "dsc", 8, 2, 1, Interval(0.25, None, None))) == (
        "25 % (from 1 draw: too few for an interval)"
    )


@pytest.mark.parametrize("freedom", [5, 6, 8, 12, 30])
def test_students_quantile_is_that_of_scipy_as_near_as_it_says(freedom: int) -> None:
    near = 0.003 if freedom < 8 else 0.0005
    assert judged._student(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), abs=near)


@pytest.mark.parametrize("count", [6, 12, 60])
def test_the_interval_of_a_difference_is_as_wide_as_students(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of normal differences a bootstrap that is expanded for few units comes to Student's interval."""
    values = stats.norm.ppf((np.arange(count) + 0.5) / count) + 0.3
    monkeypatch.setattr(judged, "_MOST_AT_ONCE", 700 * count + 1)  # so that 4000 are drawn in six pieces, one shorter
    found = [paired_difference(range(count), values, seed=seed) for seed in range(5)]
    low, high = np.mean([one[1:] for one in found], axis=0)
    student = stats.t.interval(0.95, count - 1, loc=values.mean(), scale=stats.sem(values))
    assert (low, high) == pytest.approx(student, abs=0.035 * (student[1] - student[0]))


def test_random_axes_have_numbers_of_their_own_all_over_their_ranges(tmp_path: Path) -> None:
    kinds = {"robot.mass_kg": ("uniform", 16.0, 24.0), "plant.start.mass_kg": ("uniform", 10.0, 11.0)}
    kinds[FRICTION] = ("log_uniform", 0.01, 0.3)
    axes = "\n".join(f"{key} = {{ {kind} = [{low}, {high}] }}" for key, (kind, low, high) in kinds.items())
    runs = list(points(load_plan(write_plan(tmp_path, "samples = 300", f"[axes]\n{axes}"))))
    assert [run.sample for run in runs] == list(range(300))
    shares = []
    for key, (kind, low, high) in kinds.items():
        given = np.array([run.axes[key] for run in runs])
        logs = np.log([low, high]) if kind == "log_uniform" else np.array([low, high])
        share = ((np.log(given) if kind == "log_uniform" else given) - logs[0]) / (logs[1] - logs[0])
        assert stats.kstest(share, "uniform").pvalue > 0.01
        assert min(share) >= 0.0
        assert max(share) <= 1.0
        shares.append(share)
    apart = np.abs(np.corrcoef(shares) - np.eye(3))
    assert apart.max() < 0.15, "no axis draws the numbers of another"


def test_a_seed_gives_the_same_draws_in_every_version(tmp_path: Path) -> None:
    axes = "[axes]\nrobot.mass_kg = { uniform = [16, 24] }\nrobot.inertia_kg_m2 = { log_uniform = [0.1, 1] }"
    runs = list(points(load_plan(write_plan(tmp_path, "samples = 2\nseed = 4", axes))))
    drawn = [tuple(round(one, 9) for one in run.axes.values()) for run in runs]
    assert drawn == [(17.749818352, 0.443752917), (19.927126288, 0.101472441)]


def test_an_interval_does_not_depend_on_how_much_is_drawn_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = paired_difference(range(12), np.arange(12.0) ** 2)
    monkeypatch.setattr(judged, "_MOST_AT_ONCE", 700 * 12)  # as of a campaign with many draws
    assert paired_difference(range(12), np.arange(12.0) ** 2) == whole


def test_of_two_laws_that_are_equal_in_a_run_neither_has_less() -> None:
    judged = object.__new__(Judged)
    judged.about = {"laws": ["a", "b"], "axes": {}, "samples": 1, "seeds": 4}
    judged._unit = "seed"
    judged.rows = [
        {"law": law, "fault": "none", "seed": seed, "sample": 0, **dict.fromkeys(COMPARED, value)}
        for law, values in (("a", (1.0, 2.0, 3.0, 4.0)), ("b", (1.0, 2.0, 5.0, 1.0)))
        for seed, value in enumerate(values)
    ]
    assert {duel.first_less for duel in judged.duels} == {0.25}

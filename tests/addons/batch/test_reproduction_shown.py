"""What a reproduction sets and shows: settings of its runs, figures of signals, sentences, tables, pictures."""

import math
from typing import Any

import matplotlib.figure
import numpy as np
import pytest

from hil.addons.batch.reproduction import paper_claims as claims
from hil.addons.batch.reproduction import section_iv_page as page
from hil.addons.batch.reproduction.published import delay_margin
from hil.addons.batch.reproduction.reproduction import oscillation, signal_figures
from hil.addons.batch.reproduction.section_iv import PaperRun, Result, assumptions, cases
from hil.scenario import load

FASTEST_S = {"dsc": 1.08, "afdsc": 0.62, "constant": 0.9, "corrected": 0.71}
STEADY_M = {"dsc": 0.000795, "afdsc": 0.0012, "constant": 0.0011, "corrected": 0.0013}
LATER_S = {"together": 0.0, "each": 0.3, "grip": 1.1}
GRIP = "1.8 N·m, four wheels scaled together"
GAINS = "controller.gains."


def figures(case: PaperRun) -> dict[str, float | None]:
    """Made-up figures, of which no two runs have the same; at the limit of grip AFDSC is the later one."""
    row = case.row
    if case.group == "circle":
        law, short = str(row["law"]), row["filter"] == "short"
        tracked = FASTEST_S[law] + LATER_S[str(row["limit"])] * (2.0 if law == "afdsc" else 1.0) + 0.05 * short
        steady = {"steady_rms_m": STEADY_M[law] / (3.2 if short else 1.0), "steady_max_m": 0.002}
        return {"tracked_s": tracked, "t10_s": tracked + 0.4, **steady, "heading_rad": 0.003 + 0.001 * (law != "dsc")}
    late_s, number = float(row.get("latency_ms", 0.0)) / 1000.0, sum(map(ord, case.name)) % 97
    swing = {"amplitude_m": 0.0004 + late_s**2, "frequency_hz": 3.0 + 10.0 * late_s, "steady_rms_m": 0.003 + late_s}
    moved = {"driven_s": 7.25, "from_m": 1.02, "transition_s": 5.6 + 0.1 * number * (case.group == "transition")}
    return {**swing, "steady_max_m": 0.004 + late_s, **moved}


def results(**failed: str) -> claims.CaseResults:
    return claims.CaseResults(
        [Result(case, figures(case), failed.get(case.name.replace(" ", "_"))) for case in cases()]
    )


OURS = "the initial pose and the torque limit, which the paper leaves out, are ours"
NEAR = f"{OURS}, chosen so that both times come near: this shows nothing; with each motor limited by itself"
VERDICTS = [
    ("IV.A, Fig. 8", "DSC tracks after", "s", 1.1, 1.08, 0.1, "fitted", f"{NEAR} 1.38 s"),
    ("IV.A, Fig. 8", "AFDSC tracks after", "s", 0.6, 0.62, 0.1, "fitted", f"{NEAR} 1.22 s"),
    ("IV.A, Fig. 8", "DSC steady error", "m", 0.00079, 0.000795, 1e-5, "fitted",
     "the filter constant of 0.0675 s, which the paper leaves out, was chosen for it: this shows nothing"),
    ("IV.A, Fig. 8", "AFDSC steady error", "m", 0.00038, 0.0012, 1e-5, "does not come out",
     "with this filter it needs K1 = 31 1/s, and Table II ends at 15; at the 10 of Table III for zero error the "
     "equations leave 1.2 mm"),
    ("IV.A, Fig. 8", "AFDSC steady error, with a filter of its own", "m", 0.00038, 0.000375, 1e-5, "fitted",
     "the filter was chosen for it, 3.1 times as fast as DSC's; AFDSC then tracks after 0.67 s; DSC with that filter "
     "too leaves 0.25 mm"),
    ("IV.A", "AFDSC tracks sooner than DSC, by", "s", 0.5, 0.46, None, "fitted",
     "the initial pose was chosen for both times, so the size shows nothing; not in every condition run: with 0.0675 s "
     f"and {GRIP} -0.64 s, with 0.0217 s and {GRIP} -0.64 s"),
    ("IV.A", "AFDSC's steady error is smaller than DSC's, by", "m", 0.00041, -0.000405, None, "does not come out",
     "of a filter's lag the error goes with 1 / K1, and K1 is 10 1/s at zero error against 15; of a disturbance it "
     "goes with 1 / (K1 K2), at most 200 1/s² by any rule against 600: no cause that both laws share makes AFDSC the "
     "more exact"),
    ("IV.A", "the fuzzy tuner makes it sooner than its middle gains held constant, by", "s", None, 0.28, 0.1,
     "comes out", "tracked: constant gains 0.90 s, AFDSC 0.62 s, AFDSC with corrected tables 0.71 s; the same figure "
     f"with 5 N·m, each motor by itself -0.02 s, with {GRIP} -0.82 s"),
    ("IV.A, Fig. 8 (d)", "the heading converges with both laws", "rad", None, 0.004, 0.01, "comes out",
     "the largest heading error of the last 5 s of either law; the paper gives no number"),
    ("IV.B, Fig. 11", "no control signal for", "s", 7.0, 7.25, 1.0, "fitted",
     "imposed: nobody is on the line until then, and the host that comes connects and arms before it commands"),
    ("IV.B, Fig. 10", "the transition takes about", "s", 4.0, 5.6, 1.0, "does not come out",
     "ours is from 1.02 m, until within 2 % of that; the paper gives neither pose nor top speed; {transitions}"),
    ("IV.B, Fig. 10", "then it stays on the reference", "m", None, 0.004, 0.01, "comes out",
     "the largest error of the last 5 s, with slip, motors and friction; the paper gives no number"),
    ("IV.B", "a slight oscillation from the delay", "m", None, 0.0013, None, "cannot be compared",
     "0.4 mm without latency, 1.3 mm at 30 ms and 3.3 Hz; by the equations AFDSC's gains at zero error swing from 54 "
     "ms on, at 3.3 Hz; every loop swings once it is late enough, and the paper gives neither amplitude nor delay"),
]  # fmt: skip


def test_every_verdict_has_its_numbers_and_its_sentence() -> None:
    transitions = "; ".join(
        f"{case.name}, AFDSC, {'torque' if case.name.startswith('from') else 'speed'}: "
        f"{figures(case)['transition_s']:.1f} s"
        for case in cases()
        if case.group == "transition"
    )
    assert transitions.count("; ") == 5
    for found, expected in zip(claims.judge(results()), VERDICTS, strict=True):
        *words, ours, tolerance, verdict, why = expected
        assert (found.place, found.claim, found.unit, found.paper) == tuple(words)
        assert found.ours == pytest.approx(ours)
        assert (found.tolerance, found.verdict) == (tolerance, verdict)
        assert found.why == why.format(transitions=transitions)


def test_a_sentence_leaves_out_what_was_not_run_or_failed() -> None:
    """Also at which latencies, and which condition has no lead."""
    failed = {f"{law}_{name}_{limit}": "hung" for law in ("dsc", "constant") for name in ("common", "short")
              for limit in ("each", "grip")}  # fmt: skip
    failed |= {"dsc_short_together": "hung", "afdsc_torque_40_ms": "hung", "corrected_common_together": "hung"}
    whys = {one.claim: one.why for one in claims.judge(results(**failed))}
    assert whys["DSC tracks after"].endswith("come near: this shows nothing")
    assert whys["AFDSC steady error, with a filter of its own"].endswith("AFDSC then tracks after 0.67 s")
    assert whys["AFDSC tracks sooner than DSC, by"].endswith("the size shows nothing; run in one condition only")
    assert whys["the fuzzy tuner makes it sooner than its middle gains held constant, by"] == (
        "tracked: constant gains 0.90 s, AFDSC 0.62 s"
    )
    assert "at 30 ms and 3.3 Hz; the run did not end at 40 ms; by" in whys["a slight oscillation from the delay"]
    both = {f"{law}_{name}_grip": "hung" for law in ("dsc",) for name in ("common", "short")}
    (sooner,) = (one.why for one in claims.judge(results(**both)) if one.claim == "AFDSC tracks sooner than DSC, by")
    assert sooner.endswith("; the same sign in all 4 conditions run")


def test_runs_of_the_paper_have_its_settings() -> None:
    runs = {case.name: case for case in cases()}
    count = {group: sum(one.group == group for one in runs.values()) for group in ("circle", "delay", "transition")}
    assert count == {"circle": 3 * 2 * 4, "delay": 8 + 5 + 4, "transition": 3 + 3}
    for case in runs.values():
        assert (case.sets["limiter.torque_speed"], case.sets["limiter.slip_m_s"]) == ("off", math.inf)
        assert case.sets.get("expect") == (None if case.records else [])
    each = runs["constant short each"].sets
    torque_n_m = load("paper_circle").robot.torque_limit_n_m
    assert torque_n_m == 5.0
    constant = load("paper_circle_dsc", set=each)
    assert constant.firmware.torque_constant_n_m_a * float(each["plant.start.current_limit_a"]) == torque_n_m  # type: ignore[arg-type]
    assert constant.controller.gains == {**constant.controller.gains, "k1_1_s": 10.0, "k2_1_s": 20.0}
    assert (each["robot.torque_limit_n_m"], each["firmware.torque_limit_n_m"]) == (15.99, 15.99)
    assert (each["plant.start.drive"], each["plant.start.battery_voltage_v"]) == ("current", 200.0)
    assert (each[f"{GAINS}filter_s"], each["loop.duration_s"]) == (0.0217, 10.0)
    grip = runs["corrected common grip"].sets
    carried = 0.7 * 20.0 * 9.81 / 4.0 * 0.075 / math.sqrt(2.0)
    assert grip["robot.torque_limit_n_m"] == grip["firmware.torque_limit_n_m"] == round(carried, 1)
    assert (grip["controller.law"], grip[f"{GAINS}filter_s"]) == ("afdsc_corrected", 0.0675)
    for case in (one for one in runs.values() if one.group == "delay"):
        ways = [float(case.sets[f"link.{way}_latency_s"]) for way in ("command", "feedback")]  # type: ignore[arg-type]
        assert ways[0] == ways[1]
        assert 1000.0 * sum(ways) == pytest.approx(float(case.row["latency_ms"]))
    latencies = [case.row["latency_ms"] for case in runs.values() if case.row.get("driven") == "dsc torque"]
    assert latencies == [0, 20, 30, 40, 60]
    assert [one.row["latency_ms"] for one in runs.values() if one.name.startswith("afdsc torque")] == [
        *range(0, 71, 10)
    ]
    assert [one.sets["plant.start.start_x_m"] for one in runs.values() if one.name.startswith("from")] == [0, 1, 2]
    top = [one.sets["robot.speed_limit_rad_s"] for one in runs.values() if one.name.startswith("at most")]
    assert top == [20, 12, 9]
    assert {one.sets["loop.duration_s"] for one in runs.values() if one.group == "transition"} == {17.0}


def test_a_quick_reproduction_is_of_few_short_runs() -> None:
    quick = {
        case.name: (case.sets.get("loop.duration_s"), case.sets.get("fault"), case.records)
        for case in cases(quick=True)
    }
    assert quick == {
        "dsc common together": (7.0, None, False),
        "afdsc common together": (7.0, None, True),
        "afdsc short together": (7.0, None, False),
        "experiment": (17.0, None, True),
        "afdsc torque 0 ms": (18.0, [], False),
        "afdsc torque 70 ms": (18.0, [], False),
    }


def test_what_the_paper_leaves_out_is_told_with_our_values() -> None:
    told = {(row["place"], row["what"]): row["value"] for row in assumptions()}
    assert told["IV.A", "the filter constant"] == "filter_s = 0.0675"
    assert told["IV.A", "the torque limit"] == "robot.torque_limit_n_m = 5.0"
    limiter = {row["what"]: (row["value"], row["why"]) for row in assumptions()}[
        "a limiter of the wheels' speed and slip"
    ]
    assert limiter[0] == 'off: limiter.torque_speed = "off", limiter.slip_m_s = inf'
    assert limiter[1].startswith("ours would keep the robot from its overspeed and from slip")
    assert told["IV.A", "how the rules are weighed"].startswith("product and weighted average")
    assert told["IV.B", "what is commanded"] == 'controller.command = "torque"'
    experiment = load("paper_experiment")
    assert told["IV.B", "the delay"] == "link.command_latency_s = 0.003, link.feedback_latency_s = 0.002"
    assert f"fault.1.end_s = {experiment.fault[0].end_s}" in told["IV.B", "how nothing is commanded"]


def test_figures_of_signals_are_of_the_last_5_s_and_from_the_last_silence_on() -> None:
    t_s = np.arange(0.0, 20.0, 0.1)
    heading = np.where(t_s < 14.95, 0.5, 0.002)
    heading[-3] = -0.004
    torque = np.where((t_s > 1.0) & (t_s < 6.95), math.nan, 1.0)  # driven from 7 s on
    planar = np.where(t_s < 7.0, 3.0, np.maximum(2.0 - 0.5 * (t_s - 7.0), 0.0))
    signals = {"loop.t_s": t_s, "error.planar_m": planar, "error.heading_rad": heading}
    signals |= {"wheel.fl.torque_command_n_m": torque, "error.x_m": planar, "error.y_m": planar}
    found = signal_figures(signals, 50.0)
    assert found == {
        "heading_rad": 0.004,
        "driven_s": pytest.approx(7.0),
        "from_m": pytest.approx(2.0),
        "transition_s": pytest.approx(4.0),
        "amplitude_m": None,
        "frequency_hz": None,
    }
    swinging = signal_figures({**signals, "error.planar_m": np.full(len(t_s), 2.0)}, 50.0)
    assert (swinging["from_m"], swinging["transition_s"]) == (2.0, None), "it never came to the path"
    there = signal_figures({**signals, "error.planar_m": np.where(t_s < 6.95, 3.0, 0.0)}, 50.0)
    assert there["transition_s"] is None, "what begins on the path has no distance to come from"
    silent = signal_figures({**signals, "wheel.fl.torque_command_n_m": np.full(len(t_s), math.nan)}, 50.0)
    assert (silent["heading_rad"], silent["driven_s"], silent["from_m"]) == (0.004, None, None)
    driven = signal_figures({**signals, "wheel.fl.torque_command_n_m": np.ones(len(t_s))}, 15.0)
    assert (driven["driven_s"], driven["from_m"]) == (0.0, 3.0)
    assert driven["amplitude_m"] is not None


def test_an_oscillation_of_an_earlier_lap_is_none_of_the_last() -> None:
    t_s = np.arange(0.0, 20.0, 0.02)
    swing = 0.005 * np.sin(2.0 * math.pi * 3.0 * t_s)
    zero = np.zeros_like(t_s)
    signals = {"loop.t_s": t_s, "error.x_m": np.where(t_s < 9.9, swing, 0.0), "error.y_m": zero}
    early = oscillation(signals, 10.0)
    late = oscillation({**signals, "error.x_m": zero, "error.y_m": np.where(t_s < 9.9, 0.0, swing)}, 10.0)
    assert early is not None
    assert late is not None
    assert early[0] < 1e-6
    assert late == pytest.approx((0.005, 3.0), rel=0.05)
    assert oscillation({name: one[:0] for name, one in signals.items()}, 10.0) is None


def summary() -> dict[str, Any]:
    """A summary of one row a table, and of one that failed."""
    row = {"failure": None, "name": "from x = 1 m", "driven": "dsc torque", "latency_ms": 40.0}
    circle = {"failure": None, "law": "dsc", "filter": "common", "limit": "together", "tracked_s": 1.234, "t10_s": 1.5}
    other = circle | {"filter": "short", "limit": "each", "steady_rms_m": None}
    swing = {"amplitude_m": 0.0123, "frequency_hz": 3.26, "steady_rms_m": 0.004, "steady_max_m": 0.005}
    printed = {"tracked_s": 1.1, "steady_rms_m": 0.00079}
    return {
        "paper": [{"law": "dsc", "figure": figure, "value": value} for figure, value in printed.items()],
        "circle": [circle | {"steady_rms_m": 0.000791}, other, other | {"failure": "hung"}],
        "delay": [row | swing | {"transition_s": 4.567}],
        "transition": [row | {"from_m": 2.3456, "transition_s": None}, row | {"from_m": None, "transition_s": 3.0}],
        "verdicts": [
            claims.Claim("IV", "that", "rad", 0.0015, 0.002, None, "fitted", "so")._asdict(),
        ],
        "assumptions": [{"place": "IV.A", "what": "a", "value": "", "why": "b"}],
    }  # fmt: skip


def test_tables_show_figures_in_their_units_and_a_run_that_failed_by_its_reason() -> None:
    verdicts, circle, delay, transition, assumed = page.tables(summary())
    each = ("DSC, K1 = 15, K2 = 40", "0.0217 s", "5 N·m, each motor by itself")
    assert circle.rows[1:] == [
        ("DSC, K1 = 15, K2 = 40", "0.0675 s", "5 N·m, four wheels scaled together",
         "1.23 s", "1.1 s", "0.79 mm", "0.79 mm", "1.50 s"),
        (*each, "1.23 s", "", "-", "", "1.50 s"),
        (*each, "hung", "", "", "", ""),
    ]  # fmt: skip
    assert delay.rows[1:] == [("DSC, torque", "40 ms", "12.30 mm", "3.3 Hz", "4.00 mm", "5.00 mm", "4.57 s")]
    assert transition.rows[1:] == [
        ("DSC, torque", "from x = 1 m", "2.35 m", "-"),
        ("DSC, torque", "from x = 1 m", "-", "3.00 s"),
    ]
    assert verdicts.rows[1:] == [("IV", "that", "1.50 mrad", "2.00 mrad", "-", "fitted", "so")]
    assert assumed.rows[1:] == [("IV.A", "a", "-", "b")]
    assert page.markdown({**summary(), "circle": [], "delay": [], "transition": [], "assumptions": []}) == (
        "### Verdicts\n\n| place | result | the paper | ours | tolerance | verdict | why |\n" + "|---" * 7 + "|\n"
        "| IV | that | 1.50 mrad | 2.00 mrad | - | fitted | so |\n"
    )


def made_up(start: float) -> dict[str, np.ndarray]:
    """Signals of a run of 8 s, each unlike the others."""
    t_s = np.arange(0.0, 8.0, 0.5)
    names = [f"{what}.{axis}_m" for what in ("reference", "truth", "error") for axis in "xy"]
    names += ["error.heading_rad", "error.planar_m"]
    names += [f"wheel.{wheel}.torque_command_n_m" for wheel in ("fl", "fr", "rr", "rl")]
    return {"loop.t_s": t_s, **{name: start + number + 0.1 * t_s for number, name in enumerate(names)}}


def lines(panel: Any) -> dict[str, tuple[list[float], list[float]]]:
    return {line.get_label(): (list(line.get_xdata()), list(line.get_ydata())) for line in panel.get_lines()}


def test_pictures_have_the_signals_of_their_runs() -> None:
    runs = {"dsc common together": made_up(0.0), "afdsc common together": made_up(50.0), "experiment": made_up(90.0)}
    drawn = {}
    for plot in page.plots(results(), runs):
        axes = list(matplotlib.figure.Figure().subplots(plot.rows, plot.columns, squeeze=False).flat)
        plot.draw(axes)
        drawn[plot.name] = axes
    assert list(drawn) == ["figure_8", "figure_10", "figure_11", "delay"]
    path, *errors = drawn["figure_8"]
    own = {"DSC": runs["dsc common together"], "AFDSC": runs["afdsc common together"]}
    shown = lines(path)
    for label, run in own.items():
        assert shown[label] == (list(run["truth.x_m"]), list(run["truth.y_m"]))
    assert shown["reference"] == (list(own["DSC"]["reference.x_m"]), list(own["DSC"]["reference.y_m"]))
    for panel, (name, words) in zip(
        errors, {"x_m": "[mm]", "y_m": "[mm]", "heading_rad": "[mrad]"}.items(), strict=True
    ):
        assert words in panel.get_ylabel()
        (late,) = panel.child_axes
        for place, (label, run) in enumerate(own.items()):
            assert lines(panel)[label] == (list(run["loop.t_s"]), list(1e3 * run[f"error.{name}"]))
            line = late.get_lines()[place]
            assert list(line.get_xdata()) == [5.0, 5.5, 6.0, 6.5, 7.0, 7.5]
            assert list(line.get_ydata()) == list(1e3 * run[f"error.{name}"][10:])
    run = runs["experiment"]
    plane = lines(drawn["figure_10"][0])
    assert plane["robot"] == (list(run["truth.x_m"]), list(run["truth.y_m"]))
    assert plane["reference"] == (list(run["reference.x_m"]), list(run["reference.y_m"]))
    above, below = drawn["figure_11"]
    for wheel in ("fl", "fr", "rr", "rl"):
        assert list(run[f"wheel.{wheel}.torque_command_n_m"]) in [ys for _, ys in lines(above).values()]
    ((since_s, error_m),) = [one for one in lines(below).values() if len(one[0]) == 16]
    assert (since_s[0], since_s[-1], error_m) == (30.0, 37.5, list(run["error.planar_m"]))
    assert above.get_xlim() == below.get_xlim() == (30.0, 37.5)
    spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in below.patches]
    assert spans == [(30.0, 37.0), (37.0, 41.0)]


def test_the_picture_of_the_delay_has_each_law_over_latency_and_where_it_becomes_unstable() -> None:
    (plot,) = page.plots(results(afdsc_torque_40_ms="hung"), {})
    axes = list(matplotlib.figure.Figure().subplots(1, 2).flat)
    plot.draw(axes)
    expected = {
        "AFDSC, torque": (0, 10, 20, 30, 40, 50, 60, 70),
        "DSC, torque": (0, 20, 30, 40, 60),
        "AFDSC, speed": (0, 20, 40, 60),
    }
    for panel, scale, figure in ((axes[0], 1e3, lambda s: 0.0004 + s**2), (axes[1], 1.0, lambda s: 3.0 + 10.0 * s)):
        shown = lines(panel)
        for label, latencies in expected.items():
            assert tuple(shown[label][0]) == latencies
            values = [scale * figure(ms / 1000.0) for ms in latencies]
            if label == "AFDSC, torque":
                values[4] = math.nan
            assert shown[label][1] == pytest.approx(values, nan_ok=True)
    margins = [delay_margin(10.0, 20.0, 0.0675, 0.005), delay_margin(15.0, 40.0, 0.0675, 0.005)]
    unstable = [line.get_xdata()[0] for line in axes[0].get_lines() if line.get_linestyle() == ":"]
    assert unstable == pytest.approx([1e3 * one.latency_s for one in margins])
    assert axes[0].get_ylim()[1] == 1e3
